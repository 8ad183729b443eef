"""A small free network of total stations: all sights between seven points."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle

POINTS = {
    f"P{i}": np.array(x, dtype=float)
    for i, x in enumerate(
        [(0, 0, 0), (40, 3, 2), (38, 44, -3), (-2, 41, 5), (20, 20, 12), (61, 22, 4), (19, 65, 1)]
    )
}


MILLIMETRE = 1e-3


def azimuth(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arctan2(*(b - a)[:2]))


def zenith(a: np.ndarray, b: np.ndarray) -> float:
    d = b - a
    return float(np.arctan2(np.hypot(d[0], d[1]), d[2]))


def total_station(
    seed: int, *, coarse: float, datum: str = "free", verticals: bool = False
) -> fga.Network:
    """Return a network of directions, zenith angles and distances between all points."""
    rng = np.random.default_rng(seed)
    network = fga.Network("all sights", datum=datum)  # type: ignore[arg-type]
    for name, x in POINTS.items():
        network.add_point(name, x + coarse * rng.uniform(-1, 1, 3))
    for i, (a, xa) in enumerate(POINTS.items()):
        if verticals:
            network.set_vertical(a)
        for b, xb in POINTS.items():
            if a == b:
                continue
            network.add(
                Direction(a, b, azimuth(xa, xb) - i + 1e-5 * rng.normal(), sigma=1e-5),
                ZenithAngle(a, b, zenith(xa, xb) + 1e-5 * rng.normal(), sigma=1e-5),
                SlopeDistance(
                    a, b, np.linalg.norm(xb - xa) + MILLIMETRE * rng.normal(), sigma=MILLIMETRE
                ),
            )
    return network
