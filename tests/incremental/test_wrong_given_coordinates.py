"""Given coordinates that are grossly wrong are named where they keep all from a solution."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction

GIVEN = {"A": (0.0, 0.0), "B": (100.0, 0.0), "C": (100.0, 100.0), "D": (0.0, 100.0)}
STATIONS = {"P": (40.0, 50.0), "Q": (60.0, 30.0)}


def resected(off: float, targets: str = "ABCDPQ") -> fga.IncrementalAdjustment:
    """Return two stations that directions to given points determine.

    Args:
        off: error of the given coordinate x of B, metres.
        targets: the points that are sighted.
    """
    network = fga.Network("resection")
    for name, (x, y) in GIVEN.items():
        network.add_point(name, (x + off * (name == "B"), y, 0.0), fixed="xyz")
    for name in STATIONS:
        network.add_point(name, (np.nan, np.nan, 0.0), fixed="z")
    inc = fga.IncrementalAdjustment(network)
    places = GIVEN | STATIONS
    for s in STATIONS:
        for t in targets:
            if s != t:
                east, north = np.subtract(places[t], places[s])
                angle = float(np.arctan2(east, north)) % (2.0 * np.pi)
                inc.add(Direction(s, t, angle, sigma=1e-5, set=s))
    return inc


def test_they_are_named_where_there_are_readings_enough() -> None:
    inc = resected(1000.0)
    assert not len(inc)
    lacks = {w.lacks for w in inc.waiting}
    assert any("more readings than it takes: given coordinates ('A', 'B'" in why for why in lacks)
    assert not any("too weakly" in why for why in lacks)


@pytest.mark.parametrize(("off", "targets"), [(0.0, "ABCDPQ"), (1000.0, "AC")])
def test_they_are_not_where_nothing_is_wrong_or_nothing_shows_it(off: float, targets: str) -> None:
    inc = resected(off, targets)
    assert len(inc) or inc.n_waiting
    assert not any("given coordinates" in w.lacks for w in inc.waiting)
