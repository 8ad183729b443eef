"""Observations that were rejected keep their own standard deviations in the report."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance
from factorgraph_adj.report.rejected_observations import set_aside
from factorgraph_adj.simulation.measurement import measure

GON = np.pi / 200


def site() -> fga.Network:
    """Return a network whose standard deviations all depend on lengths, with three blunders."""
    network = fga.Network("site")
    places = {"A": (0, 0, 10), "B": (90, 5, 12), "C": (50, 80, 9), "P": (40, 30, 11)}
    for name, xyz in places.items():
        network.add_point(name, xyz, fixed="xyz" if name != "P" else "")
    sigma = fga.StandardDeviation(0.0015, ppm=2)
    turned = fga.StandardDeviation(0.6e-3 * GON, centring_target=0.0005)
    levelled = fga.StandardDeviation(per_sqrt_km=0.001)
    for k in range(3):
        for name in "ABC":
            network.add(
                SlopeDistance(name, "P", 1.0, sigma=sigma, id=f"s{name}{k}"),
                HeightDifference(name, "P", 1.0, sigma=levelled, id=f"h{name}{k}"),
                Direction("P", name, 0.0, sigma=turned, id=f"d{name}{k}", set=str(k)),
            )
    network.set_orientation("P", set="0", value=0.1)
    network.set_orientation("P", set="1", value=0.2)
    network.set_orientation("P", set="2", value=0.3)
    out = measure(network, seed=4)
    for ident, by in (("sA0", 0.03), ("hB1", 0.02), ("dC2", 0.05 * GON)):
        o = out.observations[ident]
        out.observations[ident] = o.with_reading([o.value + by], out.frame)  # type: ignore[attr-defined]
    return out


def test_what_is_set_aside_has_the_standard_deviation_that_it_had_in_the_network() -> None:
    """Once it was the constant part alone: 1 m for a height difference that has none."""
    network = site()
    every = fga.adjust(network)
    found = fga.snoop(network)
    assert {r.id for r in found.rejected} == {"sA0", "hB1", "dC2"}
    aside = set_aside(found.solution, found.rejected_ids, network)
    assert aside.count == 3
    for ident in ("sA0", "hB1", "dC2"):
        row = every.observations.row(ident)
        own = aside.find(ident, "")
        assert own.sigma == pytest.approx(every.observations.sigmas[row], rel=1e-3)
    assert aside.find("hB1", "").sigma < 0.001
