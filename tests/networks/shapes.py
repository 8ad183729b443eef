"""Blocks of photos that are not aerial strips, with control, from a seed."""

from __future__ import annotations

import numpy as np

from factorgraph_adj import without
from factorgraph_adj.models.image import depth
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Direction, ImagePoint, SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.types import Array
from factorgraph_adj.units import CC

FOCAL, HALF = 30.0, 12.0
"""Principal distance and half the side of the square image, mm."""


def block(
    name: str, centres: Array, targets: Array, points: Array, *, reach: float, per_photo: bool
) -> Network:
    """Return photos that look at targets, and measure the points that they see.

    Args:
        name: name of the network.
        centres: projection centres, (n, 3), metres.
        targets: what each photo looks at, (n, 3).
        points: object points, (p, 3); every seventh one is control of 5 mm.
        reach: largest distance at which a point is seen.
        per_photo: whether each photo has its own calibration.
    """
    network = Network(name)
    free = ("c",) if per_photo else ("c", "x0", "y0", "k1")
    network.add_camera(
        "camera", BrownLens(), {"c": FOCAL}, free=free, per_photo=per_photo, sigma={"c": 0.05}
    )
    for i, at in enumerate(points):
        sigma = (0.005,) * 3 if i % 7 == 0 else None
        network.add_point(f"P{i}", tuple(at), sigma=sigma)
    for i, (centre, target) in enumerate(zip(centres, targets, strict=True)):
        rotation = look_at(centre, target)
        network.add_photo(f"F{i}", "camera", position=tuple(centre), rotation=rotation)
        rays = points - centre
        x, y, z = (rays @ rotation).T
        pose = np.concatenate([rotation.ravel(), centre])[None].repeat(len(points), axis=0)
        sees = (depth(pose, points) > 0.5) & (np.linalg.norm(rays, axis=1) < reach)
        sees &= (np.abs(x) * FOCAL < HALF * z) & (np.abs(y) * FOCAL < HALF * z)
        for k in np.flatnonzero(sees):
            network.add(ImagePoint(f"F{i}", f"P{k}", 0.0, 0.0, sigma=0.003))
    seen = network.images.columns()[1]
    few = np.bincount(seen, minlength=len(points)) < 2
    return without(network, [], points=[f"P{k}" for k in np.flatnonzero(few)])


def ring(seed: int) -> Network:
    """Ninety photos around a column, which see a third of it each."""
    rng = np.random.default_rng(seed)
    around, height = rng.uniform(0, 2 * np.pi, 160), rng.uniform(0, 6, 160)
    points = np.stack([3 * np.cos(around), 3 * np.sin(around), height], 1)
    t = np.linspace(0, 2 * np.pi, 90, endpoint=False)
    centres = np.stack([14 * np.cos(t), 14 * np.sin(t), 3 + np.sin(5 * t)], 1)
    targets = np.broadcast_to([0.0, 0.0, 3.0], (90, 3))
    network = block("ring", centres, targets, points, reach=11.5, per_photo=False)
    return measure(network, seed=seed)


def corridor(seed: int) -> Network:
    """Sixty photos along a road, each with a calibration of its own."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-8, -6, -1], [186, 6, 1], (300, 3))
    x = np.arange(0.0, 180.0, 3.0)
    centres = np.stack([x, np.sin(x / 9), np.full(60, 14.0) + np.cos(x)], 1)
    targets = centres * [1.0, 0.0, 0.0] + [0.3, 0.2, 0.0]
    return measure(
        block("corridor", centres, targets, points, reach=20.0, per_photo=True), seed=seed
    )


def unordered(seed: int) -> Network:
    """Thirty-five photos of a box from anywhere: everything sees everything."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-2, 2, (60, 3))
    away = rng.normal(size=(35, 3))
    centres = 12.0 * away / np.linalg.norm(away, axis=1)[:, None] * rng.uniform(0.8, 1.2, (35, 1))
    targets = rng.normal(size=(35, 3)) * 0.2
    return measure(
        block("unordered", centres, targets, points, reach=40, per_photo=False), seed=seed
    )


def tied(seed: int) -> Network:
    """The road with two total stations, which sight points far apart that photos see too."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-8, -6, -1], [186, 6, 1], (300, 3))
    x = np.arange(0.0, 180.0, 3.0)
    centres = np.stack([x, np.sin(x / 9), np.full(60, 14.0) + np.cos(x)], 1)
    targets = centres * [1.0, 0.0, 0.0] + [0.3, 0.2, 0.0]
    network = block("tied", centres, targets, points, reach=20.0, per_photo=False)
    for station, at in (("S1", (60.0, 40.0, 5.0)), ("S2", (120.0, 40.0, 5.0))):
        network.add_point(station, at)
        network.set_orientation(station, value=0.3)
        for name in list(network.points)[seed % 5 : 240 : 20]:
            if name in ("S1", "S2"):
                continue
            network.add(
                Direction(station, name, 0.0, sigma=5 * CC),
                ZenithAngle(station, name, 1.5, sigma=8 * CC),
                SlopeDistance(station, name, 1.0, sigma=0.002),
            )
    return measure(network, seed=seed)


def far_points(seed: int) -> Network:
    """The road with points at up to 10⁵ bases, whose pivots are small."""
    network = corridor(seed)
    rng = np.random.default_rng(seed + 100)
    for i, away in enumerate((1e3, 1e4, 1e5, 3e5)):
        at = np.array([90.0, 0.0, 0.0]) + away * np.array([0.02, 0.01, -1.0])
        network.add_point(f"far{i}", tuple(at + rng.normal(size=3)))
        for photo in ("F29", "F30", "F31"):
            network.add(ImagePoint(photo, f"far{i}", 0.0, 0.0, sigma=0.003))
    return measure(network, seed=seed)


SHAPES = {f.__name__: f for f in (ring, corridor, unordered, tied, far_points)}
