"""Small plane networks of ranges alone, whose rows bend noticeably within the σ of their points."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import AnyObservation, HorizontalDistance

BEACONS = 3, 5
"""Smallest number of held points, and the largest."""
POINTS = 6, 10
"""The same of unknown ones."""
SIZE = 10.0, 50.0
"""Side of the area, metres, from and to."""
SIGMA = 0.01, 1.0
"""Standard deviation of all ranges of a network, metres, from and to; uniform in its logarithm."""
RANGES_OF_POINT = 4
"""Mean number of ranges of a point."""
APPROXIMATE = 0.02
"""Standard deviation of approximate coordinates, relative to the side of the area."""


def plane_ranges(seed: int) -> tuple[fga.Network, list[AnyObservation]]:
    """Return a network without observations, and its ranges in a random order.

    Args:
        seed: of everything random.
    """
    rng = np.random.default_rng(seed)
    size = float(rng.uniform(*SIZE))
    sigma = float(np.exp(rng.uniform(*np.log(SIGMA))))
    n_held, n_free = (
        int(rng.integers(*BEACONS, endpoint=True)),
        int(rng.integers(*POINTS, endpoint=True)),
    )
    net = fga.Network(f"plane ranges {seed}")
    true = {f"B{i}": rng.uniform(0.0, size, 2) for i in range(n_held)}
    true |= {f"P{i}": rng.uniform(0.0, size, 2) for i in range(n_free)}
    for name, at in true.items():
        if name.startswith("B"):
            net.add_point(name, (*at, 0.0), fixed="xyz")
        else:
            near = at + rng.normal(0.0, APPROXIMATE * size, 2)
            net.add_point(name, (*near, 0.0), fixed="z")
    return net, list(_ranges(true, n_free, sigma, rng))


def _ranges(
    true: dict[str, np.ndarray], n_free: int, sigma: float, rng: np.random.Generator
) -> Iterator[AnyObservation]:
    """Iterate over ranges between pairs of points of which one is unknown at least."""
    names = list(true)
    pairs = [(a, b) for i, b in enumerate(names) for a in names[:i] if b.startswith("P")]
    n = min(len(pairs), RANGES_OF_POINT * n_free)
    for k in rng.permutation(len(pairs))[:n].tolist():
        a, b = pairs[k]
        value = float(np.linalg.norm(true[a] - true[b])) + float(rng.normal(0.0, sigma))
        yield HorizontalDistance(a, b, max(value, 0.1 * sigma), sigma=sigma, id=f"{a} {b}")
