"""The network of what is in the graph."""

from __future__ import annotations

import factorgraph_adj as fga
from factorgraph_adj.ledger.ledger import Ledger
from factorgraph_adj.observations import Direction, SlopeDistance
from factorgraph_adj.units import ARCSEC


def test_unknowns_that_nobody_states_come_in_the_order_in_which_observations_name_them() -> None:
    network = fga.Network("three stations")
    for name, x in (("A", 0.0), ("B", 100.0), ("C", 200.0)):
        network.add_point(name, (x, x / 2.0, 0.0))
    for station, target, own in (
        ("C", "A", "2"),
        ("A", "B", "1"),
        ("C", "B", "1"),
        ("A", "C", "1"),
    ):
        network.add(SlopeDistance(station, target, 100.0, sigma=1e-3))
        network.add(Direction(station, target, 1.0, sigma=ARCSEC, set=own))
    sets = list(network.of_kind("orientation"))
    assert sets == [("C", "2"), ("A", "1"), ("C", "1")]
    assert list(Ledger.of(network).described.of_kind("orientation")) == sets
