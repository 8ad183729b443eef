"""A point with many distances of one kind whose residuals have one sign."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import SlopeDistance
from factorgraph_adj.types import Array

STATIONS = {"A": (0.0, 0.0, 0.0), "B": (10.0, 0.0, 0.0), "C": (5.0, 9.0, 0.0)}
"""Coordinates of the stations around the point."""
POINT = 5.0, 3.0, 0.0
"""Coordinates of the point."""
SIGMA = 0.1
"""Standard deviation of a distance, metres."""


def measured(
    station: str, to: Sequence[float] | Array, n: int, offset: float, rng: np.random.Generator
) -> list[SlopeDistance]:
    """Return distances from a station to the point.

    Args:
        station: its name.
        to: where the point is.
        n: number of distances.
        offset: by how much they are too long, in their σ.
        rng: of their random errors, a tenth of σ, and of their ids.
    """
    length = float(np.linalg.norm(np.subtract(to, STATIONS[station])))
    series = rng.integers(2**60)
    errors = rng.normal(offset, 0.1, n) * SIGMA
    return [
        SlopeDistance(station, "P", length + e, sigma=SIGMA, id=f"{station} {series} {i}")
        for i, e in enumerate(errors.tolist())
    ]


def tense_distances(n: int, offset: float, rng: np.random.Generator) -> fga.Network:
    """Return a plane network of one point, with n distances from each of three stations around it.

    Args:
        n: their number.
        offset: by how much all are too long, in their σ: the point cannot move to take it up.
        rng: of everything random.
    """
    network = fga.Network("tense distances")
    for name, at in STATIONS.items():
        network.add_point(name, at, fixed="xyz")
    network.add_point("P", POINT, fixed="z")
    for name in STATIONS:
        network.add(*measured(name, POINT, n, offset, rng))
    return network
