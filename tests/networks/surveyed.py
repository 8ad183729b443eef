"""A small network of a total station and a level, without unknowns of instruments."""

from __future__ import annotations

import math

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance, ZenithAngle


def surveyed() -> fga.Network:
    """Directions, distances, zenith angles and a levelled loop between four points, seed 4."""
    places = {"A": (0.0, 0.0, 10.0), "B": (90.0, 10.0, 13.0), "C": (40.0, 80.0, 8.0)}
    places |= {"P": (10.0, 60.0, 14.0)}
    network, rng = fga.Network("surveyed"), np.random.default_rng(4)
    for name, at in places.items():
        network.add_point(name, at, fixed="xyz" if name in "AB" else "")
    for a in places:
        for b in places:
            if a == b:
                continue
            d = np.subtract(places[b], places[a])
            s, plan = float(np.linalg.norm(d)), math.hypot(d[0], d[1])
            e = rng.normal(size=4).tolist()
            ends = {"instrument_height": 1.5, "target_height": 1.5}
            bearing = math.atan2(d[0], d[1]) % (2 * math.pi)
            network.add(
                Direction(a, b, bearing + 1e-5 * e[0], sigma=1e-5),
                SlopeDistance(a, b, s + 0.002 * e[1], sigma=0.002, **ends),
                ZenithAngle(a, b, math.atan2(plan, d[2]) + 2e-5 * e[2], sigma=2e-5, **ends),
                HeightDifference(a, b, float(d[2]) + 0.001 * e[3], sigma=0.001),
            )
    return network
