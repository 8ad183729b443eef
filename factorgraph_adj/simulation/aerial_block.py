"""Simulated aerial block of any size, for experiments and for the growth of time and memory.

Vertical photos 150 m above a terrain with 20 m of relief, 70 % overlap along and 40 % across
unless another overlap is asked for, every second strip flown backwards; with this overlap points
are seen in five to six photos on average. The datum comes from GNSS positions of the photos and
four control points; the camera is self-calibrated.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..models.lens import BrownForwardLens
from ..network.network import Network
from ..observations import ControlPoint, PhotoPosition
from ..rotation import world_R_camera
from ..types import Array, Index
from .generate.patterns import corners
from .simulate import Seed, SimulatedNetwork, Truth, disturb, measure

GEOMETRY = 2000
"""Seed of the geometry; blocks of equal size are equal."""
HEIGHT = 150.0
"""Flying height, metres."""
RELIEF = 10.0
"""Amplitude of the terrain, metres."""
SENSOR = (36.0, 24.0)
"""Width of the sensor across and along the strip, mm."""
OVERLAP = (0.4, 0.7)
"""Overlap of the photos across and along the strip, where no other one is asked for."""
CAMERA = "camera"
CALIBRATION = {"c": 35.1, "x0": 0.04, "y0": -0.03, "k1": -6e-5, "k2": 2e-8, "p1": 3e-6, "p2": 2e-6}
"""True calibration, mm; all of it is free."""
SIGMA_IMAGE = 2e-3
"""Standard deviation of image coordinates, mm."""
SIGMA_GNSS = (0.02, 0.02, 0.04)
"""Standard deviations of the photos' GNSS positions, X, Y, Z, metres."""
SIGMA_CONTROL = (0.01, 0.01, 0.01)
"""Standard deviations of control points, X, Y, Z, metres."""


def simulate_aerial_block(
    seed: Seed,
    *,
    image_points: int = 10_000,
    points_per_photo: int = 1000,
    overlap: tuple[float, float] = OVERLAP,
) -> SimulatedNetwork:
    """Simulate the measurements of an aerial block.

    Args:
        seed: seed of measuring errors and approximate values.
        image_points: approximate number of image points, with 2 coordinates each.
        points_per_photo: approximate number of image points in one photo.
        overlap: overlap of the photos across and along the strip, as parts of a photo.

    Returns:
        The network with approximate values (errors of 1 m for points, 1 m and 1° for photos; only
        c for the camera), and the truth.
    """
    photos = round(image_points / points_per_photo)
    if photos < 4 or points_per_photo < 20:
        raise InputError(
            f"{image_points} image points, {points_per_photo} in a photo, make {photos} photos; "
            "a block needs 4 photos with 20 points"
        )
    c = CALIBRATION["c"]
    footprint = HEIGHT / c * np.array(SENSOR)
    base = footprint * (1 - np.array(overlap))
    # The block is as square as possible; the strips run along Y.
    strips = max(1, round(np.sqrt(photos * base[1] / base[0])))
    in_strip = [len(part) for part in np.array_split(np.arange(photos), strips)]
    spacing = float(np.sqrt(footprint.prod() / points_per_photo))
    grid = _terrain(spacing, base * [strips - 1, max(in_strip) - 1], footprint)

    plan = Network(f"aerial block of {photos} photos, simulated")
    rng = np.random.default_rng([GEOMETRY, photos, points_per_photo])
    poses: list[tuple[Array, Array]] = []
    for strip, n in enumerate(in_strip):
        for k in range(n):
            at = np.array([strip * base[0], k * base[1], HEIGHT])
            at += rng.normal(0.0, [3.0, 3.0, 2.0])
            omega, phi, turn = rng.normal(0.0, np.deg2rad(2.0), 3)
            poses.append((at, world_R_camera(omega, phi, turn + np.pi * (strip % 2))))
    seen = [_seen(grid, spacing, footprint, *pose) for pose in poses]
    rays = np.bincount(np.concatenate(seen), minlength=grid.size // 3)
    used = np.flatnonzero(rays >= 2)
    names = np.array([f"{i}" for i in range(len(rays))], dtype=object)
    points = grid.reshape(-1, 3)
    plan.add_points(names[used].tolist(), points[used])
    plan.add_camera(CAMERA, BrownForwardLens(), CALIBRATION, free=CALIBRATION)
    for i, ((at, rotation), inside) in enumerate(zip(poses, seen, strict=True)):
        chosen = names[inside[rays[inside] >= 2]].tolist()
        photo = f"photo {i}"
        plan.add_photo(photo, CAMERA, position=at.tolist(), rotation=rotation)
        plan.add_image_points(photo, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE)
        plan.add(PhotoPosition(photo, (0.0, 0.0, 0.0), sigma=SIGMA_GNSS))
    for corner in used[corners(points[used, :2])].tolist():
        plan.add(ControlPoint(names[corner], tuple(points[corner].tolist()), sigma=SIGMA_CONTROL))
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=1.0, centres=1.0, attitudes=np.deg2rad(1.0)
    )
    del network.cameras[CAMERA]
    network.add_camera(CAMERA, BrownForwardLens(), {"c": 35.0}, free=CALIBRATION)
    return SimulatedNetwork(network, Truth.of(plan))


def _terrain(spacing: float, extent: Array, footprint: Array) -> Array:
    """Return a jittered grid of points (columns, rows, 3), metres, under the whole block."""
    first = -footprint / 2
    columns, rows = np.ceil((extent + footprint) / spacing).astype(int) + 1
    rng = np.random.default_rng([GEOMETRY, columns, rows])
    x = first[0] + spacing * np.arange(columns)[:, None]
    y = first[1] + spacing * np.arange(rows)[None, :]
    x, y = (a + rng.uniform(-0.3, 0.3, (columns, rows)) * spacing for a in (x, y))
    z = RELIEF * np.sin(x / 60.0) * np.cos(y / 45.0) + rng.uniform(0.0, 2.0, x.shape)
    return np.stack([x, y, z], axis=2)


def _seen(grid: Array, spacing: float, footprint: Array, at: Array, rotation: Array) -> Index:
    """Return the numbers of the grid points that are on a photo."""
    rows = grid.shape[1]
    # Only the part of the grid near the photo is projected.
    reach = 0.8 * footprint
    low = np.floor((at[:2] - reach + footprint / 2) / spacing).astype(int).clip(0)
    high = np.ceil((at[:2] + reach + footprint / 2) / spacing).astype(int) + 1
    window = grid[low[0] : high[0], low[1] : high[1]]
    p = (window - at) @ rotation
    t = np.abs(p[..., :2] / p[..., 2:])
    i, j = np.nonzero(np.all(t < np.array(SENSOR) / 2 / CALIBRATION["c"], axis=2))
    return np.asarray((i + low[0]) * rows + (j + low[1]), dtype=np.intp)
