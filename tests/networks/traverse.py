"""A traverse that is observed as it goes on: every point to the three before and after it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, Observation, SlopeDistance, ZenithAngle
from factorgraph_adj.types import Array

REACH = 3
"""Number of points ahead to which a point is observed."""
SIGMA_DISTANCE, SIGMA_ANGLE = 0.003, 3e-5
"""Standard deviations, metres and radians."""


def points_of(n: int) -> dict[str, Array]:
    """Return true points, metres."""
    rng = np.random.default_rng(3)
    at = np.stack([40.0 * np.arange(n), 30.0 * (np.arange(n) % 2), np.zeros(n)], 1)
    at[:, 1:] += rng.normal(0.0, [1.0, 2.0], (n, 2))
    return {f"P{i}": x for i, x in enumerate(at)}


def traverse(n: int) -> fga.Network:
    """Return the points with approximate coordinates, the first two given; nothing is observed."""
    rng, out = np.random.default_rng(4), fga.Network("traverse")
    for name, at in points_of(n).items():
        given = name in ("P0", "P1")
        out.add_point(name, at + (0.0 if given else rng.normal(0.0, 0.05, 3)), fixed="xyz" * given)
    return out


def observed(n: int) -> Iterator[tuple[str, list[Observation]]]:
    """Iterate over the points in their order, each with what is observed from and to it by then."""
    rng, at = np.random.default_rng(5), points_of(n)
    names = list(at)
    for i, name in enumerate(names):
        found: list[Observation] = []
        for other in names[max(0, i - REACH) : i]:
            for a, b in ((name, other), (other, name)):
                d = at[b] - at[a]
                length, noise = float(np.linalg.norm(d)), rng.normal(size=3)
                reading = (np.arctan2(d[0], d[1]) + noise[1] * SIGMA_ANGLE) % (2 * np.pi)
                zenith = np.arccos(d[2] / length) + noise[2] * SIGMA_ANGLE
                distance = length + noise[0] * SIGMA_DISTANCE
                found += [
                    Direction(a, b, float(reading), sigma=SIGMA_ANGLE, set="1"),
                    ZenithAngle(a, b, float(zenith), sigma=SIGMA_ANGLE),
                    SlopeDistance(a, b, distance, sigma=SIGMA_DISTANCE),
                ]
        yield name, found
