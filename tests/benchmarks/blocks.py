"""Aerial blocks for comparisons: photos alone, as pycolmap adjusts them too, and total stations."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from factorgraph_adj.models.lens import BrownForwardLens, NormalisedLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ControlPoint, Direction, SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import SimulatedNetwork, disturb, measure
from factorgraph_adj.simulation.simulated_blocks import (
    AERIAL_CALIBRATION,
    AERIAL_CAMERA,
    SIGMA_IMAGE_MM,
    simulate_aerial_block,
)

from .grids import SIGMA_ANGLE, SIGMA_DISTANCE

OVERLAPS = {"70/40": (0.4, 0.7), "80/60": (0.6, 0.8)}
"""Overlaps across and along the strip by name: per cent along and across."""
RADIAL = {"c": 35.1, "k1": -0.07, "k2": 0.03}
"""True calibration of photos alone: principal distance, mm, and distortion, dimensionless."""
SIGHTS = 12
"""Points that a total station measures."""
NEAREST, REACH = 20.0, 500.0
"""Shortest and longest sight, metres."""


def simulate_photos_alone(seed: int, *, image_points: int, overlap: str = "80/60") -> Network:
    """Simulate image coordinates of an aerial block without any other observation.

    The block is that of `simulate_aerial_block`, with the lens of COLMAP's RADIAL camera (c, k1
    and k2 are free), so that both programs minimise the same sum of squares. Datum: free network.
    """
    made = simulate_aerial_block(seed, image_points=image_points, overlap=OVERLAPS[overlap])
    plan = Network(f"{len(made.truth.photos)} photos alone, {overlap}, simulated", datum="free")
    plan.add_camera(AERIAL_CAMERA, NormalisedLens(), RADIAL, free=RADIAL)
    _add_photos(plan, made)
    return _measured(plan, seed)


def simulate_tied(seed: int, *, photos: int, stations: int, points_per_photo: int = 200) -> Network:
    """Simulate an aerial block that total stations tie together.

    The block is that of `simulate_aerial_block` without its positions of the photos. Each station
    measures directions, zenith angles and slope distances to `SIGHTS` points of the photos, up to
    `REACH` away. Four control points at the corners are the datum.
    """
    size = photos * points_per_photo
    made = simulate_aerial_block(seed, image_points=size, points_per_photo=points_per_photo)
    plan = Network(f"{photos} photos tied by {stations} total stations, simulated")
    plan.add_camera(AERIAL_CAMERA, BrownForwardLens(), AERIAL_CALIBRATION, free=AERIAL_CALIBRATION)
    _add_photos(plan, made)
    for observation in made.network.observations.values():
        if isinstance(observation, ControlPoint):
            plan.add(observation)
    rng = np.random.default_rng([photos, stations])
    names, ground = list(made.truth.points), np.array(list(made.truth.points.values()))
    low, high = ground[:, :2].min(axis=0), ground[:, :2].max(axis=0)
    for number in range(stations):
        station = f"station {number}"
        at = rng.uniform(low, high)
        away = np.linalg.norm(ground[:, :2] - at, axis=1)
        near = np.flatnonzero((away > NEAREST) & (away < REACH))
        height = ground[np.argmin(away), 2] + 10.0
        plan.add_point(station, (*at.tolist(), height))
        plan.set_orientation(station, value=float(rng.uniform(0.0, 6.0)))
        for k in rng.choice(near, SIGHTS, replace=False).tolist():
            plan.add(
                Direction(station, names[k], 0.0, sigma=SIGMA_ANGLE),
                ZenithAngle(station, names[k], 0.0, sigma=SIGMA_ANGLE),
                SlopeDistance(station, names[k], 0.0, sigma=SIGMA_DISTANCE),
            )
    return _measured(plan, seed)


def _add_photos(plan: Network, made: SimulatedNetwork) -> None:
    """Add the points and photos of a simulated block to a plan, with their true values."""
    names = list(made.truth.points)
    plan.add_points(names, np.array(list(made.truth.points.values())))
    photo, point, _, _ = made.network.images.columns()
    for number, (name, true) in enumerate(made.truth.photos.items()):
        plan.add_photo(name, AERIAL_CAMERA, position=true.position, rotation=true.rotation)
        chosen = [names[k] for k in point[photo == number].tolist()]
        plan.add_image_points(name, chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE_MM)


def _measured(plan: Network, seed: int) -> Network:
    """Return a plan measured, with approximate values; of the camera only c is known."""
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=1.0, centres=1.0, attitudes=np.deg2rad(1.0)
    )
    camera = network.cameras[AERIAL_CAMERA]
    values = tuple(35.0 if name == "c" else 0.0 for name in camera.lens.names)
    network.cameras = {AERIAL_CAMERA: replace(camera, values=values)}
    return network
