"""Readings between given points: they touch no unknown, and count in vᵀPv and the redundancy."""

from __future__ import annotations

from collections.abc import Callable

import pytest

import factorgraph_adj as fga
from factorgraph_adj import IncrementalAdjustment
from factorgraph_adj.observations import HeightDifference


def levelled() -> IncrementalAdjustment:
    """An adjustment of a point between two given ones, with three readings between these."""
    net = fga.Network("two bench marks")
    net.add_point("A", (0.0, 0.0, 100.0), fixed="xyz")
    net.add_point("B", (90.0, 0.0, 101.0), fixed="xyz")
    net.add_point("P", (50.0, 0.0, 100.4), fixed="xy")
    inc = IncrementalAdjustment(net)
    inc.add(
        [
            HeightDifference("A", "P", 0.4, sigma=0.001, id="to P"),
            HeightDifference("P", "B", 0.6005, sigma=0.001, id="from P"),
            HeightDifference("A", "B", 1.0015, sigma=0.001, id="first"),
            HeightDifference("A", "B", 0.9992, sigma=0.001, id="second"),
        ]
    )
    inc.add(HeightDifference("A", "B", 1.02, sigma=0.001, id="wrong"))
    inc.accept("wrong")
    return inc


def again(inc: IncrementalAdjustment) -> None:
    inc.replace("wrong", HeightDifference("A", "B", 1.0001, sigma=0.001))


@pytest.mark.parametrize(
    "change",
    [
        lambda inc: None,
        lambda inc: inc.remove("wrong"),
        lambda inc: inc.remove(["first", "second", "wrong"]),
        lambda inc: inc.remove(["to P", "wrong"]),
        again,
        lambda inc: inc.reweight(["first", "wrong"], 4.0),
        lambda inc: inc.snoop(),
    ],
    ids=["nothing", "one", "all", "one and another", "replaced", "reweighted", "snooped"],
)
def test_what_is_told_of_a_network_is_that_of_its_batch_adjustment(
    change: Callable[[IncrementalAdjustment], object],
):
    inc = levelled()
    change(inc)
    batch = fga.adjust(inc.network())
    assert inc.redundancy == batch.redundancy
    assert inc.n_observations == batch.n_observations
    assert inc.vtpv == pytest.approx(batch.vtpv, rel=1e-9, abs=1e-12)
    assert inc.solution().redundancy == batch.redundancy
