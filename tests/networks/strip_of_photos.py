"""A strip of photos that fly over hills, as plan with true values; every ray is in a unit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.observations import Correlated, FrameDirection, FrameZenith
from factorgraph_adj.rotation import log_rotation, world_R_camera
from factorgraph_adj.simulation.measurement import Seed, disturb, measure
from factorgraph_adj.types import Array

FOCAL, HALF = 153.0, 105.0
"""Principal distance and half the side of a photo, millimetres."""
HEIGHT, RELIEF = 1500.0, 120.0
"""Flying height and amplitude of the terrain, metres."""
SIGMA_IMAGE = 0.005
"""Standard deviation of image coordinates, millimetres."""
SIDE = 2 * HALF * HEIGHT / FOCAL
"""Side of the ground in a photo, metres."""


def units(photos: int, size: int) -> list[tuple[str, ...]]:
    """Return units of photos that follow one another and share none."""
    return [tuple(f"{i + j}" for j in range(size)) for i in range(0, photos - size + 1, size)]


def strip_plan(
    photos: int = 6,
    *,
    overlap: float = 0.8,
    whole: Sequence[Sequence[str]] = (),
    rows: int = 5,
    spacing: float = 250.0,
) -> fga.Network:
    """Return a plan: photos along x, control held in the corners and in the middle.

    Args:
        photos: number of photos.
        overlap: overlap of two photos that follow one another.
        whole: units; a ray of a point that only one photo of a unit sees is left out.
        rows: number of rows of points along the strip.
        spacing: distance of points along the strip, metres.
    """
    rng = np.random.default_rng(1980)
    base = SIDE * (1 - overlap)
    xs = np.arange(-0.45 * SIDE, base * (photos - 1) + 0.45 * SIDE, spacing)
    ys = np.linspace(-0.4, 0.4, rows) * SIDE
    ground = [(x, y) for x in xs for y in ys] + rng.uniform(-40, 40, (len(xs) * rows, 2))
    heights = RELIEF * np.sin(ground[:, 0] / 400.0) * np.cos(ground[:, 1] / 500.0)
    points = np.column_stack([ground, heights])
    network = fga.Network("strip of photos")
    network.add_camera("camera", NoDistortion(), {"c": FOCAL})
    seen: dict[str, dict[int, Array]] = {}
    for k in range(photos):
        at = np.array([k * base, 0.0, HEIGHT]) + rng.normal(0.0, 15.0, 3)
        rotation = world_R_camera(*rng.normal(0.0, np.deg2rad(2.0), 3))
        network.add_photo(f"{k}", "camera", position=at.tolist(), rotation=rotation)
        p = (points - at) @ rotation
        xy = FOCAL * p[:, :2] / p[:, 2:] * [1.0, -1.0]
        seen[f"{k}"] = {i: xy[i] for i in np.flatnonzero(np.abs(xy).max(axis=1) < HALF).tolist()}
    for unit in whole:
        count = np.zeros(len(points), dtype=int)
        for f in unit:
            count[list(seen[f])] += 1
        for f in unit:
            seen[f] = {i: xy for i, xy in seen[f].items() if count[i] >= 2}
    every = sorted({i for found in seen.values() for i in found if _rays(seen, i) >= 2})
    control = _control(points[every])
    for n, i in enumerate(every):
        held = "xyz" if n in control else ""
        network.add_point(f"P{i}", points[i].tolist(), fixed=held)
    for f, found in seen.items():
        chosen = [i for i in found if i in every]
        network.add_image_points(
            f, [f"P{i}" for i in chosen], np.array([found[i] for i in chosen]), sigma=SIGMA_IMAGE
        )
    return network


def measured_strip(plan: fga.Network, seed: Seed, *, noise: bool = True) -> fga.Network:
    """Return the plan with measured image coordinates and rough approximate values."""
    read = measure(plan, seed=seed, noise=noise)
    return disturb(read, seed=seed, points=5.0, centres=5.0, attitudes=np.deg2rad(0.5))


def _rays(seen: dict[str, dict[int, Array]], i: int) -> int:
    return sum(i in found for found in seen.values())


def _control(points: Array) -> set[int]:
    """Return the numbers of the points nearest to the corners and the middles of the long sides."""
    low, high = points.min(axis=0)[:2], points.max(axis=0)[:2]
    wanted = [
        (x, y) for x in (low[0], 0.5 * (low[0] + high[0]), high[0]) for y in (low[1], high[1])
    ]
    return {int(np.argmin(np.sum((points[:, :2] - w) ** 2, axis=1))) for w in wanted}


TO_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation from the axes of the theodolite to those of the camera."""


def as_sights(photos: fga.Network, focal: float, sigma: float) -> fga.Network:
    """Return a block with each photo as a frame and each image point as two angles.

    Args:
        photos: without distortion.
        focal: principal distance, mm.
        sigma: of image coordinates, mm.
    """
    network = fga.Network("sights")
    for p in photos.points.values():
        network.add_point(p.name, p.coordinates, fixed=p.held)
    for f in photos.photos.values():
        assert f.rotation is not None
        assert f.position is not None
        turn = log_rotation((f.rotation @ TO_CAMERA)[None])[0].tolist()
        values = dict(zip(("rx", "ry", "rz"), turn, strict=True)) | dict.fromkeys("xyz", 0.0)
        network.add_frame(f.name, values=values, origin=f.position)
    for o in photos.image_points():
        far = np.hypot(focal, o.x)
        square = far**2 + o.y**2
        slopes = np.array([[focal / far**2, 0.0], [o.x * o.y / (far * square), -far / square]])
        direction = float(np.arctan2(o.x, focal) % (2 * np.pi))
        zenith = float(np.pi / 2 - np.arctan2(o.y, far))
        both = (
            FrameDirection(o.photo, o.point, direction, sigma=1.0),
            FrameZenith(o.photo, o.point, zenith, sigma=1.0),
        )
        network.add(Correlated(both, sigma**2 * slopes @ slopes.T))
    return network
