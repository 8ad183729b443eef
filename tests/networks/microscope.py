"""A specimen under a scanning electron microscope, tilted between the images."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.models.place_lens import ParallelLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.rotation import exp_rotation, world_R_camera

SCALE = 2.0e7
"""Image units per metre: a pixel of 50 nm."""
TILTS = (-20.0, -5.0, 10.0, 25.0)
"""Tilts about the x axis of the stage, degrees."""
SIZE = np.array([40e-6, 30e-6, 12e-6])
"""Extent of the specimen, metres."""
POINTS, CONTROL = 24, 5
SIGMA = 0.3
"""Standard deviation of image coordinates, px."""


def microscope(unit: float = 1.0) -> Network:
    """Return a plan: four tilted images of points, five of them known from another instrument.

    Args:
        unit: length of the unit of coordinates, metres: 1e-6 has them in micrometres.
    """
    rng = np.random.default_rng(12)
    network = Network("microscope")
    for i, at in enumerate((rng.uniform(-0.5, 0.5, (POINTS, 3)) * SIZE / unit).tolist()):
        network.add_point(f"P{i}", tuple(at), fixed="xyz" if i < CONTROL else "")
    network.add_camera(
        "SEM",
        ParallelLens(),
        {"c": SCALE * unit, "k1": 2e-8, "p1": 3e-7, "b1": 0.004, "b2": -0.002},
        free=("c",),
        sigma={"k1": 1e-9, "b1": 2e-4, "b2": 2e-4},
        unit="px",
        format=(1200, 900),
    )
    for i, tilt in enumerate(TILTS):
        rotation = exp_rotation(np.array([np.radians(tilt), 0.0, 0.0])) @ world_R_camera(0, 0, 0.1)
        at = np.array([1e-6, -2e-6, 0.0]) / unit
        network.add_photo(f"T{i}", "SEM", position=at, rotation=rotation)
        xy = np.zeros((POINTS, 2))
        network.add_image_points(f"T{i}", list(network.points), xy, sigma=SIGMA)
    return network
