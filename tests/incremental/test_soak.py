"""Observations that come and go by chance, with nonsense and degenerate geometry among them."""

from __future__ import annotations

import gc
import tracemalloc

import pytest

from factorgraph_adj import IncrementalAdjustment, adjust
from factorgraph_adj.observations import Direction, HeightDifference, ImagePoint, SlopeDistance
from tests.networks.small_block import small_block
from tests.support.soak import EVENTS, Soak

PROMISE = 1e-2
AT_REST = 1e-6
GROWTH = 40_000
"""Bytes that 120 arrivals and as many removals may leave, 300 for each: caches."""


@pytest.mark.parametrize(("seed", "policy"), [(5, "flag"), (12, "reject")])
def test_whatever_comes_and_goes_the_network_is_that_of_the_batch(seed, policy):
    """Every event is checked by `Soak.step`: nothing is lost, errors change nothing."""
    soak = Soak(seed, policy=policy)
    for _ in range(2):
        for _ in range(125):
            soak.step()
        found = soak.compare()
        assert max(found.estimates, found.sigmas) < PROMISE
        assert max(found.settled_estimates, found.settled_sigmas) < AT_REST
    assert len(soak.inc) > 50
    assert soak.done["nonsense: InputError"] > 10
    assert soak.done["arrival"] > 70 and soak.done["removal"] > 25


def test_every_kind_of_event_is_played():
    """A soak without arrivals of one kind would prove nothing of them."""
    names = [event.__name__ for _, event in EVENTS]
    assert len(set(names)) == len(names) == 15
    kinds = {getattr(o, "kind", "group") for o in Soak(1).pool}
    assert len(kinds) == 11


def test_memory_does_not_grow_with_what_has_come_and_gone():
    network = small_block(4)
    inc = IncrementalAdjustment(network, start=adjust(network))
    inc.remove("F1/P3")

    def turn(n: int) -> None:
        for i in range(n):
            inc.add(SlopeDistance("P1", "P6", 5.0, sigma=5.0, id=f"{i} s"))
            inc.add(
                [
                    ImagePoint("F1", "P3", 0.0, 0.0, sigma=9.0),
                    HeightDifference("P1", "P6", 0.0, sigma=4.0, id=f"{i} h"),
                    Direction("S1", "P5", 0.0, sigma=9.0, set=f"{i}", id=f"{i} r"),
                ]
            )
            inc.remove([f"{i} s", f"{i} h", f"{i} r", "F1/P3"])

    def traced() -> int:
        turn(40)
        inc.settle()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        traced()
        before, after = traced(), traced()
    finally:
        tracemalloc.stop()
    assert after - before < GROWTH
