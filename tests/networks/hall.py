"""A hall in one free network: scans, trackers, a model, a rig, shapes, water, and their sizes."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import TURN_ABOUT_X, exp_rotation, world_R_camera
from factorgraph_adj.simulation.measurement import measure

MM, ARCSEC = 1e-3, np.pi / 180 / 3600
EVERY = ("rx", "ry", "rz", "x", "y", "z")
MOUNT = dict(zip(EVERY, (0.02, 1.1, -0.05, 0.4, 0.02, 0.03), strict=True))
FLOOR, PIPE = (0.01, -0.02), (0.4, 0.1)
"""Small turns of the floor and of the pipe."""


def hall(seed: int = 1, *, level: bool = True) -> fga.Network:
    """Return a measured network without datum.

    Args:
        seed: of the points and of the errors.
        level: whether water and a levelled scanner tell the horizon.
    """
    rng = np.random.default_rng(seed)
    network = fga.Network("hall", datum="free")
    for i in range(14):
        network.add_point(f"P{i}", rng.uniform((-8, -6, 0.5), (8, 6, 5)))
    names = list(network.points)
    _instruments(network, names, rng, level)
    _shapes(network, rng)
    _rig(network, rng)
    if level:
        network.set_level("water", 1.3)
        for name in ("P0", "P3", "P6", "P9"):
            height = network.points[name].coordinates[2] - 1.3
            network.add(o.LevelHeight(name, "water", height, sigma=MM))
    return measure(network, seed=seed)


def _instruments(
    network: fga.Network, names: list[str], rng: np.random.Generator, level: bool
) -> None:
    """Add a scan, a model with a scale, a tracker, and a levelled scanner above a point."""
    turned = dict(zip(EVERY[:3], (0.3, -0.2, 1.4), strict=True))
    network.add_frame("scan", free=EVERY, values={**turned, "x": 1.0, "y": 2.0, "z": -1.0})
    free = (*EVERY, "ln_scale")
    network.add_frame(
        "model",
        free=free,
        values={**turned, "rz": 2.0, "x": 3.0, "y": 0.0, "z": 1.0, "ln_scale": -0.7},
    )
    network.add_frame("tracker", free=EVERY, values={**turned, "x": 4.0, "y": -3.0, "z": -1.5})
    network.add_point("T", (0.5, -0.5, 1.6))
    network.add_frame("tripod", free=("rz",), values={"rz": 0.7}, origin="T", level=level)
    network.set_distance_meter("meter", zero=0.002, free=("zero",))
    zero = (0.0, 0.0, 0.0)
    for name in names:
        network.add(
            o.FrameCoordinate("scan", name, zero, sigma=(MM, MM, 2 * MM)),
            o.FrameCoordinate("model", name, zero, sigma=(3 * MM,) * 3),
            o.FrameDirection("tracker", name, 0.0, sigma=2 * ARCSEC),
            o.FrameZenith("tracker", name, 1.0, sigma=2 * ARCSEC),
            o.FrameDistance("tracker", name, 1.0, sigma=0.05 * MM, instrument="meter"),
        )
        if level:
            network.add(o.FrameCoordinate("tripod", name, zero, sigma=(2 * MM,) * 3))
    if not level:
        for name in names[:4]:
            network.add(o.SlopeDistance("T", name, 1.0, sigma=MM))
        del network.frames["tripod"]


def _shapes(network: fga.Network, rng: np.random.Generator) -> None:
    """Add a floor, a pipe and a ball, whose points the scan and the tracker see."""
    tilt = exp_rotation(np.array([[*FLOOR, 0.0]]))[0]
    along = exp_rotation(np.array([[*PIPE, 0.0]]))[0]
    network.add_shape("floor", "plane", origin=(0, 0, 0), values=_turns(FLOOR))
    network.add_shape("pipe", "cylinder", origin=(3, 2, 2), values=_turns(PIPE))
    network.add_shape("ball", "sphere", origin=(-4, 1, 2), values=_turns((0.0, 0.0)))
    network.set_size("pipe", 0.6)
    network.set_size("ball", 0.8)
    for i in range(7):
        angle, height = rng.uniform(0, 2 * np.pi), rng.uniform(-2, 2)
        ray = rng.normal(size=3)
        round_pipe = np.array([0.6 * np.cos(angle), 0.6 * np.sin(angle), height])
        for name, at, on in (
            (f"F{i}", tilt @ [*rng.uniform(-6, 6, 2), 0.0], o.OnPlane("floor", f"F{i}", sigma=MM)),
            (f"C{i}", along @ round_pipe + [3, 2, 2], o.OnCylinder("pipe", f"C{i}", sigma=MM)),
            (
                f"B{i}",
                0.8 * ray / np.linalg.norm(ray) + [-4, 1, 2],
                o.OnSphere("ball", f"B{i}", sigma=MM),
            ),
        ):
            network.add_point(name, tuple(np.asarray(at).tolist()))
            network.add(
                on,
                o.FrameCoordinate("scan", name, (0.0, 0.0, 0.0), sigma=(MM, MM, 2 * MM)),
                o.FrameDirection("tracker", name, 0.0, sigma=2 * ARCSEC),
            )


def _turns(tilts: tuple[float, float]) -> dict[str, float]:
    return dict(zip(EVERY, (*tilts, 0.0, 0.0, 0.0, 0.0), strict=True))


def _rig(network: fga.Network, rng: np.random.Generator) -> None:
    """Add two cameras on a rod at three places."""
    network.add_camera("camera", NoDistortion(), {"c": 12.0})
    network.set_mount("rod", free=EVERY, values=MOUNT)
    values = list(MOUNT.values())
    turn = TURN_ABOUT_X @ exp_rotation(np.array([values[:3]]))[0] @ TURN_ABOUT_X
    points = {n: p.coordinates for n, p in network.points.items()}
    names, x = list(points), np.array(list(points.values()))
    for k in range(3):
        at = np.array([6.0 * (k - 1), -16.0, 2.0]) + rng.normal(0, 0.3, 3)
        r = world_R_camera(np.pi / 2 + rng.normal(0, 0.05), rng.normal(0, 0.1) - 0.5, 0.0)
        network.add_photo(f"{k}", "camera", position=at, rotation=r)
        arm = r @ TURN_ABOUT_X @ values[3:]
        network.add_photo(
            f"{k} right",
            "camera",
            position=at + arm,
            rotation=r @ turn,
            carrier=f"{k}",
            mount="rod",
            play=(1e-5, 1e-4),
        )
    for name, photo in network.photos.items():
        p = (x - photo.position) @ photo.rotation
        on = np.flatnonzero((p[:, 2] > 1) & (np.abs(p[:, :2] / p[:, 2:]) < 0.9).all(axis=1))
        chosen = [names[i] for i in on]
        network.add_image_points(name, chosen, np.zeros((len(on), 2)), sigma=0.002)
