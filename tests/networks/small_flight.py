"""A simulated photo flight: strips to and fro over terrain with relief, with true values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.frames import Frame, LocalFrame, TopocentricFrame
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array

TURNS, OFFSETS = ("rx", "ry", "rz"), ("x", "y", "z")
EVERY = (*TURNS, *OFFSETS)
SHIFT, RATE = OFFSETS, ("x_t", "y_t", "z_t")
HEIGHT, BASE, SPACING = 1000.0, 300.0, 550.0
"""Flying height, distance of exposures and of strips, metres."""
SPEED = 60.0
"""Metres per second."""
SIGMA_IMAGE, FOCAL = 0.004, 100.0
"""Millimetres."""
SIGMA_GNSS, SIGMA_CONTROL = 0.05, 0.03
"""Metres."""
SIGMA_ATTITUDE = np.radians(0.005)
ARM = (0.25, -0.4, 1.2)
"""True lever arm, metres."""
BORESIGHT = (0.004, -0.003, 0.006)
"""True boresight, radians."""
TILTED = TopocentricFrame(np.radians(43.6), np.radians(4.5), 50.0)
"""A frame in which horizons differ."""
FLAT = LocalFrame()


@dataclass(frozen=True)
class Plan:
    """What is observed and unknown."""

    frame: Frame = FLAT
    strips: int = 2
    exposures: int = 4
    """Exposures of a strip."""
    to_and_fro: bool = True
    """Whether every second strip is flown back."""
    crossing: int = 0
    """Number of further strips across."""
    control: int = 4
    """Number of control points, in the corners first."""
    positions: bool = True
    attitudes: type[o.PhotoAttitude] | None = o.PhotoAttitude
    mount: Sequence[str] = ()
    """Free components of the mount."""
    drift: Sequence[str] = ()
    """Free components of the shift and drift of each strip."""
    one_drift: bool = False
    """Whether all strips share the shift and drift."""
    turning: Sequence[str] = ()
    """Free components of the drift of the attitudes of each strip."""
    shutter: bool = False
    calibration: Sequence[str] = ()
    """Free parameters of the camera."""
    points: int = 6
    """Points along each strip; there are as many rows as strips and one more."""
    relief: float = 80.0
    """Standard deviation of the terrain, metres."""
    half_format: float = 62.0
    """Half the side of the image, millimetres."""
    extra: Sequence[str] = field(default=())
    """Further kinds: photo_angle, photo_range, photo_base, antenna_vector."""


def plan_of(plan: Plan, seed: int = 5) -> fga.Network:
    """Return the network with true values; readings are zero."""
    rng = np.random.default_rng(seed)
    network = fga.Network("flight", frame=plan.frame)
    network.add_camera("camera", NoDistortion(), {"c": FOCAL}, free=plan.calibration)
    flown = [e for i in range(plan.strips + plan.crossing) for e in _fly(network, plan, i, rng)]
    _add_points(network, plan, rng)
    _state_unknowns(network, plan, rng)
    for exposure in flown:
        _observe(network, plan, *exposure)
    return network


def _add_points(network: fga.Network, plan: Plan, rng: np.random.Generator) -> None:
    """Add the points that two photos see, control in the corners, and the image points."""
    length, width = BASE * (plan.exposures - 1), SPACING * (plan.strips - 1)
    xs = np.linspace(-150.0, length + 150.0, plan.points)
    ys = np.linspace(-350.0, width + 350.0, plan.strips + 2)
    ground = np.array([(x, y, rng.normal(0.0, plan.relief)) for x in xs for y in ys])
    seen = {n: _images(p, ground, plan.half_format) for n, p in network.photos.items()}
    rays = np.sum([inside for _, inside in seen.values()], axis=0)
    chosen = np.flatnonzero(rays >= 2)
    for i in chosen.tolist():
        network.add_point(f"P{i}", ground[i])
    corners = np.array([[x, y] for x in xs[[0, -1]] for y in ys[[0, -1]]])
    off = np.linalg.norm(ground[chosen, None, :2] - corners, axis=2)
    best = [*dict.fromkeys(chosen[np.argmin(off, axis=0)].tolist()), *chosen[1::5].tolist()]
    for i in list(dict.fromkeys(best))[: plan.control]:
        at = tuple(ground[i].tolist())
        network.add(o.ControlPoint(f"P{i}", at, sigma=(SIGMA_CONTROL,) * 3, id=f"control P{i}"))
    for name, (xy, inside) in seen.items():
        for i in chosen[inside[chosen]].tolist():
            network.add(o.ImagePoint(name, f"P{i}", *xy[i].tolist(), sigma=SIGMA_IMAGE))


def _images(photo: fga.Photo, ground: Array, half_format: float) -> tuple[Array, Array]:
    """Return the image coordinates (n, 2) of points, and whether they are in the image."""
    assert photo.rotation is not None
    assert photo.position is not None
    x, y, z = photo.rotation.T @ (ground - photo.position).T
    xy = FOCAL * np.stack([x / z, -y / z], axis=1)
    return xy, (z > 0) & (np.abs(xy).max(axis=1) < half_format)


def _state_unknowns(network: fga.Network, plan: Plan, rng: np.random.Generator) -> None:
    values = dict(zip(EVERY, (*BORESIGHT, *ARM), strict=True))
    network.set_mount("imu", free=plan.mount, values={n: values[n] for n in plan.mount})
    for strip in range(plan.strips + plan.crossing):
        drawn = {n: float(rng.normal(0.0, 0.1)) for n in plan.drift}
        if strip == 0 or not plan.one_drift:
            network.set_drift(f"strip {strip}", free=plan.drift, values=drawn)
        drawn = {n: float(rng.normal(0.0, 1e-3)) for n in plan.turning}
        network.set_attitude_drift(f"strip {strip}", free=plan.turning, values=drawn)
    if plan.shutter:
        network.set_shutter("shutter", error=0.008)
    network.set_distance_meter("ranger")


def _fly(
    network: fga.Network, plan: Plan, strip: int, rng: np.random.Generator
) -> list[tuple[int, str, float, Array, str]]:
    """Add the photos of a strip; return strip, name, time, direction and the photo before."""
    across = strip >= plan.strips
    back = plan.to_and_fro and strip % 2 == 1
    kappa = (np.pi / 2 if across else 0.0) + (np.pi if back else 0.0) - np.pi / 2
    along = np.array([np.cos(kappa + np.pi / 2), np.sin(kappa + np.pi / 2), 0.0])
    length, width = BASE * (plan.exposures - 1), SPACING * (plan.strips - 1)
    middle = np.array([length / 2, SPACING * strip, HEIGHT])
    if across:
        place = (strip - plan.strips + 0.5) / plan.crossing
        middle = np.array([length * place, width / 2, HEIGHT])
    out, before = [], ""
    for i in range(plan.exposures):
        name, time = f"{strip}{chr(ord('a') + i)}", i - (plan.exposures - 1) / 2
        at = middle + BASE * time * along + rng.normal(0.0, 5.0, 3)
        turn = world_R_camera(*rng.normal(0.0, 0.03, 2), kappa + rng.normal(0.0, 0.02))
        network.add_photo(name, "camera", position=at, rotation=turn)
        out.append((strip, name, time, along, before))
        before = name
    return out


def _observe(
    network: fga.Network,
    plan: Plan,
    strip: int,
    name: str,
    time: float,
    along: Array,
    before: str,
) -> None:
    own = f"strip {strip}"
    zero = (0.0, 0.0, 0.0)
    if plan.positions:
        moving = {"shutter": "shutter", "velocity": tuple((SPEED * along).tolist())}
        network.add(
            o.PhotoPosition(
                *(name, zero),
                sigma=(SIGMA_GNSS,) * 3,
                mount="imu",
                drift="strip 0" if plan.one_drift else own,
                time=time,
                id=f"GNSS {name}",
                **(moving if plan.shutter else {}),
            )
        )
    if plan.attitudes is not None:
        sigma = (SIGMA_ATTITUDE, SIGMA_ATTITUDE, 2 * SIGMA_ATTITUDE)
        network.add(
            plan.attitudes(
                *(name, zero), sigma=sigma, mount="imu", drift=own, time=time, id=f"INS {name}"
            )
        )
    if "photo_angle" in plan.extra:
        for angle in ("roll", "pitch", "heading"):
            network.add(o.PhotoAngle(name, 0.0, angle=angle, sigma=SIGMA_ATTITUDE, mount="imu"))
    if "photo_range" in plan.extra:
        for point in list(network.points)[::5]:
            network.add(o.PhotoRange(point, name, 1.0, sigma=0.05, mount="imu"))
    if "photo_base" in plan.extra and before:
        network.add(o.PhotoBase(before, name, 1.0, sigma=0.05, mount="imu", instrument="ranger"))
    if "antenna_vector" in plan.extra:
        arm = (3.0, 0.5, 0.2)
        network.add(o.AntennaVector(name, zero, sigma=(0.005,) * 3, lever_arm=arm))


def observed(plan: fga.Network, seed: int) -> fga.Network:
    """Return the plan with drawn observations; free unknowns of the flight start at zero."""
    network = measure(plan, seed=seed)
    for kind in ("mount", "drift", "attitude_drift", "shutter"):
        for name, p in network.of_kind(kind).items():
            values = tuple(v if f else 0.0 for v, f in zip(p.values, p.fixed, strict=True))
            network.of_kind(kind)[name] = replace(p, values=values)
    return network


def errors(solution: fga.Solution, plan: fga.Network) -> dict[str, float]:
    """Return the errors of all free unknowns of a flight in units of their σ, by name."""
    out = {}
    for kind in ("mount", "drift", "attitude_drift", "shutter"):
        for name, p in plan.of_kind(kind).items():
            e = solution.unknown(kind, name)
            for i, free in enumerate(~np.array(p.fixed)):
                if free:
                    label = f"{kind} {name} {i}"
                    out[label] = float((e.values[i] - p.values[i]) / e.sigmas[i])
    return out
