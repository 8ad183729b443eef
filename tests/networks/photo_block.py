"""A close-range block: photos from all sides of points in a box, control at its corners."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.simulation.measurement import disturb, look_at, measure

POINTS, PHOTOS = 24, 8
"""Numbers of points and photos."""
BOX = (8.0, 8.0, 3.0)
"""Size of the box, metres."""
CONTROL = 5
"""Number of held points, the first ones."""
FOCAL, HALF_FORMAT = 28.0, (18.0, 12.0)
"""Principal distance and half the format, mm."""
SIGMA = 0.003
"""Standard deviation of image coordinates, mm."""
HIDDEN = 0.2
"""Fraction of the sights that is hidden."""


def plan(seed: int, sigma: float = SIGMA) -> Network:
    """Return the block with its true values; σ of image coordinates in mm."""
    rng = np.random.default_rng([seed, 7])
    network = Network("close-range block")
    points = rng.uniform(-0.5, 0.5, (POINTS, 3)) * BOX
    points[:4, :2] = 0.5 * np.array([[-8.0, -8.0], [8.0, -8.0], [8.0, 8.0], [-8.0, 8.0]])
    names = [f"P{i}" for i in range(POINTS)]
    for i, (name, at) in enumerate(zip(names, points.tolist(), strict=True)):
        network.add_point(name, tuple(at), fixed="xyz" if i < CONTROL else "")
    values = {"c": FOCAL, "x0": 0.05, "y0": -0.08, "k1": 1e-5}
    network.add_camera("C", BrownLens(), values, free=("c", "x0", "y0", "k1"))
    for i in range(PHOTOS):
        turn = 2 * np.pi * (i + rng.uniform(-0.2, 0.2)) / PHOTOS
        away = rng.uniform(11.0, 15.0)
        at = np.array([away * np.cos(turn), away * np.sin(turn), rng.uniform(2.0, 8.0)])
        about = exp_rotation(np.array([0.0, 0.0, rng.choice([0.0, 0.5 * np.pi])]))
        rotation = look_at(at, rng.normal(0.0, 0.3, 3)) @ about
        photo = f"F{i + 1}"
        network.add_photo(photo, "C", position=tuple(at.tolist()), rotation=rotation)
        seen = (points - at) @ rotation
        xy = FOCAL * seen[:, :2] / seen[:, 2:]
        inside = (np.abs(xy) < HALF_FORMAT).all(axis=1) & (rng.random(POINTS) > HIDDEN)
        for j in np.flatnonzero(inside).tolist():
            network.add(ImagePoint(photo, names[j], 0.0, 0.0, sigma=sigma))
    return network


def block(seed: int, sigma: float = SIGMA) -> Network:
    """Return the block with measuring errors and approximate values."""
    return disturb(
        measure(plan(seed, sigma), seed=seed),
        seed=seed,
        points=0.05,
        centres=0.2,
        attitudes=float(np.deg2rad(1.0)),
    )
