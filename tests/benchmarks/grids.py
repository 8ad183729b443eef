"""Networks of any size: total stations on a grid, alone and together with photos."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.models.lens import BrownForwardLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle
from factorgraph_adj.simulation.measurement import (
    SimulatedNetwork,
    Truth,
    disturb,
    look_at,
    measure,
)
from factorgraph_adj.units import ARCSEC

SPACING = 60.0
RELIEF = 8.0
SIGMA_DISTANCE = 1e-3
SIGMA_ANGLE = 2.0 * ARCSEC

EVERY = 3
"""Every third point of a mixed block in X and in Y is a station: 60 m apart, as in the grid."""
CAMERA = "camera"
CALIBRATION = {"c": 35.1, "x0": 0.04, "y0": -0.03, "k1": -6e-5, "k2": 2e-8}
"""True calibration, mm; all of it is free, and all photos share it."""
SENSOR = 24.0
"""Side of the square sensor, mm."""
SIGMA_IMAGE = 2e-3
"""Image coordinates, mm."""
FEWEST = 30
"""Points in a photo, about; photos of small blocks overlap the more."""


def simulate_grid(seed: int, *, points: int) -> SimulatedNetwork:
    """Simulate a square grid: from every point a set of directions to its neighbours.

    Slope distances and zenith angles go forward only. Approximate coordinates have errors of
    0.1 m; the first point is held, and the next corner in Y.
    """
    side = round(np.sqrt(points))
    plan = Network(f"grid of {side} × {side} points, simulated")
    _add_stations(plan, side, np.random.default_rng(points))
    network = disturb(measure(plan, seed=seed), seed=seed, points=0.1)
    return SimulatedNetwork(network, Truth.of(plan))


def simulate_mixed(seed: int, *, points: int, photos: int = 120) -> SimulatedNetwork:
    """Simulate a square block of photos over a grid of total stations.

    Points are 20 m apart; every third in X and Y is a station as in `simulate_grid`, the others
    are known from photos alone. The photos look down, each a quarter turn from the last, with
    60 % overlap in X and Y or more.
    """
    side = round(np.sqrt(points))
    rng = np.random.default_rng([points, photos])
    step = SPACING / EVERY
    plan = Network(f"{photos} photos over a grid of {side} × {side} points, simulated")
    _add_stations(plan, -(-side // EVERY), rng)
    for i in range(side):
        for j in range(side):
            if i % EVERY or j % EVERY:
                x, y = step * np.array([i, j]) + rng.uniform(-0.25 * step, 0.25 * step, 2)
                plan.add_point(f"p{i}-{j}", (x, y, rng.uniform(0.0, RELIEF)))
    plan.add_camera(CAMERA, BrownForwardLens(), CALIBRATION, free=CALIBRATION)
    names = list(plan.points)
    ground = np.array([p.coordinates for p in plan.points.values()])
    extent = step * (side - 1)
    columns = round(np.sqrt(photos))
    rows = -(-photos // columns)
    footprint = max(2.5 * extent / columns, extent * np.sqrt(FEWEST / points))
    height = footprint * CALIBRATION["c"] / SENSOR
    for k in range(photos):
        place = np.array([k % columns / (columns - 1), k // columns / (rows - 1)])
        at = np.array([*(extent * place), height]) + rng.normal(0.0, 0.02 * height, 3)
        down = look_at(at, np.array([*at[:2], 0.0]) + rng.normal(0.0, [0.05 * height] * 2 + [0.0]))
        turn = 0.5 * np.pi * (k % 4)
        rotation = down @ np.array(
            [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
        )
        p = (ground - at) @ rotation
        seen = np.all(np.abs(p[:, :2] / p[:, 2:]) < SENSOR / 2 / CALIBRATION["c"], axis=1)
        chosen = [n for n, s in zip(names, seen, strict=True) if s]
        plan.add_photo(f"photo {k}", CAMERA, position=at.tolist(), rotation=rotation)
        plan.add_image_points(f"photo {k}", chosen, np.zeros((len(chosen), 2)), sigma=SIGMA_IMAGE)
    network = disturb(
        measure(plan, seed=seed), seed=seed, points=0.1, centres=0.3, attitudes=np.deg2rad(0.5)
    )
    return SimulatedNetwork(network, Truth.of(plan))


def _add_stations(plan: Network, side: int, rng: np.random.Generator) -> None:
    """Add a grid of ``side`` × ``side`` stations that measure their neighbours."""
    names = [[f"{i}-{j}" for j in range(side)] for i in range(side)]
    for i in range(side):
        for j in range(side):
            x, y = SPACING * np.array([i, j]) + rng.uniform(-5.0, 5.0, 2)
            held = {(0, 0): "xyz", (side - 1, 0): "y"}.get((i, j), "")
            plan.add_point(names[i][j], (x, y, rng.uniform(0.0, RELIEF)), fixed=held)
    for i in range(side):
        for j in range(side):
            here = names[i][j]
            plan.set_orientation(here, value=float(rng.uniform(0.0, 6.0)))
            for di, dj in ((1, 0), (0, 1), (-1, 0), (0, -1)):
                if not (0 <= i + di < side and 0 <= j + dj < side):
                    continue
                there = names[i + di][j + dj]
                plan.add(Direction(here, there, 0.0, sigma=SIGMA_ANGLE))
                if di + dj > 0:
                    plan.add(
                        SlopeDistance(here, there, 0.0, sigma=SIGMA_DISTANCE),
                        ZenithAngle(here, there, 0.0, sigma=SIGMA_ANGLE),
                    )
