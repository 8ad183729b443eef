"""Terrestrial networks of any size: total stations on a grid."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.experiment.simulate import SimulatedNetwork, Truth, disturb, measure
from factorgraph_adj.network import Network
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle
from factorgraph_adj.units import ARCSEC

SPACING = 60.0
RELIEF = 8.0
SIGMA_DISTANCE = 1e-3
SIGMA_ANGLE = 2.0 * ARCSEC


def simulate_grid(seed: int, *, points: int) -> SimulatedNetwork:
    """Simulate a square grid: from every point a set of directions to its neighbours.

    Slope distances and zenith angles go forward only. Approximate coordinates have errors of
    0.1 m; the first point is held, and the next corner in Y.
    """
    side = round(np.sqrt(points))
    rng = np.random.default_rng(points)
    names = [[f"{i}-{j}" for j in range(side)] for i in range(side)]
    plan = Network(f"grid of {side} × {side} points, simulated")
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
    network = disturb(measure(plan, seed=seed), seed=seed, points=0.1)
    return SimulatedNetwork(network, Truth.of(plan))
