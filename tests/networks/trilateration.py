"""A plane network of all distances between its points, many of them grossly wrong."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import HorizontalDistance

SIGMA = 0.002
"""Standard deviation of a distance, metres."""


def trilateration(
    seed: int,
    *,
    points: int = 15,
    share: float = 0.0,
    size: tuple[float, float] = (30.0, 60.0),
    noise: float = 1.0,
) -> tuple[Network, frozenset[str]]:
    """Return a network of 1 km and the ids of its wrong distances, all of them too long.

    Args:
        seed: seed of points, errors and gross errors.
        points: number of points; two are held, and the redundancy is n(n − 1)/2 − 2(n − 2).
        share: part of the distances that are wrong.
        size: smallest and largest gross error, multiples of σ.
        noise: σ of the errors relative to the one stated.
    """
    rng = np.random.default_rng(seed)
    xy = rng.uniform(0.0, 1000.0, (points, 2))
    network = Network("trilateration")
    for i, at in enumerate(xy):
        start = at + rng.normal(0.0, 0.05, 2) * (i > 1)
        fixed = "xyz" if i < 2 else "z"
        network.add_point(f"P{i}", (*start.tolist(), 0.0), fixed=fixed)
    pairs = list(combinations(range(points), 2))
    wrong = rng.choice(len(pairs), int(share * len(pairs)), replace=False)
    ids = []
    for k, (i, j) in enumerate(pairs):
        length = np.hypot(*(xy[i] - xy[j])) + rng.normal(0.0, noise * SIGMA)
        if k in wrong:
            length += rng.uniform(*size) * SIGMA
        (ident,) = network.add(HorizontalDistance(f"P{i}", f"P{j}", length, sigma=SIGMA))
        if k in wrong:
            ids.append(ident)
    return network, frozenset(ids)
