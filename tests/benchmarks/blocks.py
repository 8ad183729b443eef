"""Aerial blocks for comparisons: photos alone, as pycolmap adjusts them too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factorgraph_adj.models.lens import NormalisedLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.simulation.aerial_block import CAMERA, SIGMA_IMAGE, simulate_aerial_block
from factorgraph_adj.simulation.simulate import disturb, measure

OVERLAPS = {"70/40": (0.4, 0.7), "80/60": (0.6, 0.8)}
"""Overlaps across and along the strip by name: per cent along and across."""
RADIAL = {"c": 35.1, "k1": -0.07, "k2": 0.03}
"""True calibration of photos alone: principal distance, mm, and distortion, dimensionless."""


def simulate_photos_alone(seed: int, *, image_points: int, overlap: str = "80/60") -> Network:
    """Simulate image coordinates of an aerial block without any other observation.

    The block is that of `simulate_aerial_block`, with the lens of COLMAP's RADIAL camera (c, k1
    and k2 are free), so that both programs minimise the same sum of squares. Datum: free network.
    """
    made = simulate_aerial_block(seed, image_points=image_points, overlap=OVERLAPS[overlap])
    plan = Network(f"{len(made.truth.photos)} photos alone, {overlap}, simulated", datum="free")
    plan.add_points(list(made.truth.points), np.array(list(made.truth.points.values())))
    plan.add_camera(CAMERA, NormalisedLens(), RADIAL, free=RADIAL)
    photo, point, _, _ = made.network.images.columns()
    names = np.array(list(made.truth.points), dtype=object)
    for number, (name, true) in enumerate(made.truth.photos.items()):
        plan.add_photo(name, CAMERA, position=true.position, rotation=true.rotation)
        chosen = names[point[photo == number]].tolist()
        plan.add_image_points(name, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE)
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=1.0, centres=1.0, attitudes=np.deg2rad(1.0)
    )
    network.cameras = {CAMERA: replace(network.cameras[CAMERA], values=(35.0, *(0.0,) * 7))}
    return network
