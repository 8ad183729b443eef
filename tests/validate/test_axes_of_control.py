"""Exchanged axes of held points are told by directions between them, and not by rounding."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction

HELD = {"A": (0.0, 0.0, 0.0), "B": (400.0, 100.0, 2.0), "C": (150.0, 380.0, 1.0)}


def told(exchanged: bool, sights: tuple[tuple[str, str], ...]) -> list[str]:
    """Return what is said of directions between held points."""
    network = fga.Network("axes")
    for name, (x, y, z) in HELD.items():
        network.add_point(name, (y, x, z) if exchanged else (x, y, z), fixed="xyz")
    for station, target in sights:
        dx, dy, _ = np.subtract(HELD[target], HELD[station])
        value = float(np.arctan2(dx, dy) - 0.3) % (2 * np.pi)
        network.add(Direction(station, target, value, sigma=1e-5))
    found = fga.preliminary(network)
    return [str(f) for f in found if "the other way round" in str(f)]


EVERY = tuple((a, b) for a in HELD for b in HELD if a != b)


def test_exchanged_axes_are_told() -> None:
    assert told(True, EVERY)
    assert not told(False, EVERY)


def test_a_set_that_closes_on_its_first_target_tells_nothing_of_axes() -> None:
    """The same target at the beginning and at the end of a set: they differ by rounding."""
    assert not told(False, (("A", "B"), ("A", "B"), ("B", "A"), ("B", "A")))
