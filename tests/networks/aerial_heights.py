"""A simulated aerial block with statoscope, profile recorder, lake and horizon camera, 1 : 10 000.

Strips run along X, every second one flown back; photos look down from 1500 m above a terrain with
100 m of relief. The block is a plan: given values are true, readings are zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import TURN_ABOUT_X, world_R_camera
from factorgraph_adj.types import Array

FOCAL, FORMAT = 150.0, 230.0
"""Millimetres."""
HEIGHT, BASE, ACROSS, SPACING = 1500.0, 900.0, 1700.0, 430.0
"""Flying height, base, distance of strips, distance of points, metres."""
SIGMA_IMAGE, SIGMA_CONTROL = 0.006, 0.1
"""Millimetres; metres."""
SIGMA_STATOSCOPE, SIGMA_APR, SIGMA_SHORE = 0.3, 0.2, 0.1
"""Metres."""
SIGMA_TILT = np.radians(0.01)
LAKE = 12.0
"""Height of the lake, metres."""
CARRIED = (0.3, -0.2, 0.6)
"""Arm of the statoscope, metres, photogrammetric axes."""
SUN = np.array((0.48, -0.6, 0.64))
KILOMETRE = 1000.0


@dataclass(frozen=True)
class Aerial:
    """What a block has."""

    strips: int = 3
    photos: int = 5
    control: str = "corners"
    """Control points: at the corners, or in plan alone (plan), or none."""
    statoscope: tuple[str, ...] = ()
    """Free components of the profile of each strip."""
    lake: bool = False
    """Whether points of the shore of a lake are known to have one height, which is free."""
    gauge: float | None = None
    """Standard deviation of the level that a gauge gives, metres; None: the level is free."""
    recorder: tuple[str, ...] = ()
    """Free components of the profile of an airborne profile recorder along the first strip."""
    tilts: tuple[str, ...] | None = None
    """Free components of the mount of a horizon camera; None: there is none."""
    sights: tuple[str, ...] | None = None
    """Free components of the mount of a star tracker; None: there is none."""


def terrain(x: Array) -> Array:
    """Return the height of the terrain at places (n, 2); it has a lake in the middle."""
    rise = 50.0 * np.sin(x[:, 0] / 700.0) * np.cos(x[:, 1] / 600.0) + 60.0
    return np.where(shore(x), LAKE, rise)


def shore(x: Array) -> Array:
    """Return whether places (n, 2) are at the shore of the lake, which spreads over the block."""
    middle = np.array([0.5 * 4 * BASE, 0.5 * ACROSS])
    return np.asarray(np.linalg.norm((x - middle) / (1600.0, 900.0), axis=1) < 1.0)


def plan_of(aerial: Aerial) -> fga.Network:
    """Return a block as a plan, whose given values are true."""
    rng = np.random.default_rng(2)
    datum = "free" if aerial.control == "none" else "given"
    network = fga.Network("aerial block", datum=datum)
    network.add_camera("RMK", NoDistortion(), {"c": FOCAL})
    length, width = (aerial.photos - 1) * BASE, (aerial.strips - 1) * ACROSS
    xs = np.arange(-BASE, length + BASE + 1, SPACING)
    ys = np.arange(-0.6 * ACROSS, width + 0.6 * ACROSS + 1, SPACING)
    grid = np.stack(np.meshgrid(xs, ys, indexing="ij"), axis=-1).reshape(-1, 2)
    grid += rng.uniform(-60.0, 60.0, grid.shape)
    points = np.column_stack([grid, terrain(grid)])
    seen: dict[str, list[int]] = {}
    for strip in range(aerial.strips):
        for i in range(aerial.photos):
            at = np.array([i * BASE, strip * ACROSS, HEIGHT]) + rng.normal(0, (20, 20, 15))
            turn = np.pi * (strip % 2) + rng.normal(0, 0.03)
            rotation = world_R_camera(*rng.normal(0, 0.02, 2), turn)
            name = f"{strip}{i}"
            network.add_photo(name, "RMK", position=at, rotation=rotation)
            p = (points - at) @ rotation
            inside = np.all(np.abs(p[:, :2] / p[:, 2:]) < FORMAT / 2 / FOCAL, axis=1)
            seen[name] = np.flatnonzero(inside).tolist()
    rays = np.bincount(np.concatenate([*seen.values()]).astype(int), minlength=len(points))
    used = np.flatnonzero(rays >= 2).tolist()
    for i in used:
        network.add_point(f"P{i}", points[i])
    for photo, which in seen.items():
        names = [f"P{i}" for i in which if rays[i] >= 2]
        network.add_image_points(photo, names, np.zeros((len(names), 2)), sigma=SIGMA_IMAGE)
    _add_control(network, aerial, points, used)
    _add_heights(network, aerial, points, used)
    _add_directions(network, aerial)
    return network


def _add_control(network: fga.Network, aerial: Aerial, points: Array, used: list[int]) -> None:
    if aerial.control == "none":
        return
    corners = {
        max(used, key=lambda i, a=a, b=b: a * points[i, 0] + b * points[i, 1])
        for a in (-1, 1)
        for b in (-1, 1)
    }
    axes = "xy" if aerial.control == "plan" else "xyz"
    for i in sorted(corners):
        at = tuple(points[i, : len(axes)].tolist())
        network.add(o.ControlPoint(f"P{i}", at, axes=axes, sigma=(SIGMA_CONTROL,) * len(axes)))


def _add_heights(network: fga.Network, aerial: Aerial, points: Array, used: list[int]) -> None:
    middle = 0.5 * (aerial.photos - 1) * BASE
    if aerial.statoscope:
        for strip in range(aerial.strips):
            values = {"height": 3.0 - 2.0 * strip, "height_t": 0.4 * strip - 0.3}
            values = {n: v for n, v in values.items() if n in aerial.statoscope}
            network.set_profile(f"strip {strip}", free=aerial.statoscope, values=values)
        for name, photo in network.photos.items():
            assert photo.position is not None
            network.add(
                o.ProfileHeight(
                    None,
                    0.0,
                    photo=name,
                    profile=f"strip {name[0]}",
                    time=(photo.position[0] - middle) / KILOMETRE,
                    lever_arm=CARRIED,
                    sigma=SIGMA_STATOSCOPE,
                    id=f"statoscope {name}",
                )
            )
    at_shore = shore(points[:, :2])
    if aerial.lake:
        sigma = aerial.gauge
        network.set_level("lake", LAKE, sigma=sigma)
        for i in used:
            if at_shore[i]:
                network.add(o.LevelHeight(f"P{i}", "lake", sigma=SIGMA_SHORE, id=f"shore {i}"))
    if aerial.recorder:
        values = {"height": -4.0, "height_t": 0.6}
        values = {n: v for n, v in values.items() if n in aerial.recorder}
        network.set_profile("recorder", free=aerial.recorder, values=values)
        for i in used:
            if abs(points[i, 1] - 0.5 * ACROSS) < 0.5 * SPACING:
                t = (points[i, 0] - middle) / KILOMETRE
                name = f"recorder {i}"
                network.add(
                    o.ProfileHeight(
                        f"P{i}", 0.0, profile="recorder", time=t, sigma=SIGMA_APR, id=name
                    )
                )


def _add_directions(network: fga.Network, aerial: Aerial) -> None:
    both = (("horizon camera", aerial.tilts), ("star tracker", aerial.sights))
    turns = {"rx": 0.01, "ry": -0.02, "rz": 0.03}
    for name, free in both:
        if free is not None:
            network.set_mount(name, free=free, values={n: turns[n] for n in free})
    for photo, f in network.photos.items():
        assert f.rotation is not None
        if aerial.tilts is not None:
            sigma = (SIGMA_TILT,) * 2
            network.add(
                o.PhotoTilt(
                    photo, (0.0, 0.0), sigma=sigma, mount="horizon camera", id=f"tilt {photo}"
                )
            )
        if aerial.sights is not None:
            seen = tuple((TURN_ABOUT_X @ f.rotation.T @ SUN).tolist())
            sun, sigma = tuple(SUN.tolist()), (SIGMA_TILT,) * 2
            network.add(
                o.PhotoSight(photo, sun, seen, sigma=sigma, mount="star tracker", id=f"sun {photo}")
            )


def errors(solution: fga.Solution, plan: fga.Network, kind: str) -> dict[str, float]:
    """Return the errors of all free components of a kind in units of their σ, by their names."""
    out = {}
    for name, p in plan.of_kind(kind).items():
        e = solution.unknown(kind, name)
        for j, held in enumerate(p.fixed):
            if not held:
                out[f"{name} {e.names[j]}"] = float((e.values[j] - p.values[j]) / e.sigmas[j])
    return out


def unknown_values(network: fga.Network) -> fga.Network:
    """Return a measured network whose levels are to be found, and whose profiles start at zero."""
    out = network.copy()
    for name, p in network.levels.items():
        if np.isinf(p.sigma[0]):
            out.levels[name] = replace(p, values=(np.nan,))
    for kind in ("profile", "mount"):
        for name, p in network.of_kind(kind).items():
            values = tuple(v if h else 0.0 for v, h in zip(p.values, p.fixed, strict=True))
            out.of_kind(kind)[name] = replace(p, values=values)
    return out
