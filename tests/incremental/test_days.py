"""Random days: at any time within 1 % of σ of the batch, and settled in the lower minimum.

``python -m tests.benchmarks.days`` plays 2 000 of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental.arrival import Arrival
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.observations import AnyObservation, SlopeDistance
from tests.support import days
from tests.support.days import compare, drawn, play
from tests.support.studies import cases
from tests.support.two_engines import NEAR, pairs

LONG = pytest.mark.slow(
    "days from morning to evening; short tests notice a moment outside the promise"
)

SEEDS = (200, 202, 206, 147, 702)
"""Days on the site, the last with gross errors that weights depend on, and other kinds."""
TWO_MINIMA = 178
"""A day whose batch ends in a lower minimum than the arrivals do, which `settle` has to find."""

UNLIKE = (5023, 5029, 6000)
"""Days on which the engines judged new unknowns at different places, or tested suspects again at
different moments."""

SUSPECTS = [6000, *range(6066, 6120, 6)]
"""Days with the policy "flag"; on two of them suspects come back while observations arrive."""
SNOOPED_AS_THEY_ENTER = [6060]
"""Another one, of which new unknowns alone are snooped for longer than those ten take."""


@LONG
@pytest.mark.parametrize("seed", SEEDS)
def test_a_day_keeps_the_promise_at_every_moment(seed: int) -> None:
    found = list(play(seed))
    assert found
    for c in found:
        assert not c.outside, c
        if c.settled:
            assert not c.lower, c


@LONG
def test_the_day_with_two_minima_ends_in_the_lower_one_and_says_so() -> None:
    found = list(play(TWO_MINIMA))
    assert not any(c.outside for c in found)
    assert any(c.lower for c in found if not c.settled)
    assert found[-1].settled and found[-1].told and not found[-1].lower


@LONG
@pytest.mark.parametrize("seed", UNLIKE)
def test_verdicts_of_a_day_do_not_depend_on_the_engine(seed: int, engine: Engine) -> None:
    """New unknowns contradict what is known until everything moves, or bend while they enter."""
    other: Engine = "fronts" if engine == "isam2" else "isam2"
    arrivals: dict[Engine, list[Arrival]] = {engine: [], other: []}
    for name, told in arrivals.items():
        assert not any(c.outside for c in play(seed, name, told))
    found = list(pairs(*arrivals.values()))
    assert len(found) > 30
    for pair in found:
        assert pair.same and pair.difference <= NEAR, pair


@LONG
@pytest.mark.parametrize("seeds", cases([SUSPECTS, SNOOPED_AS_THEY_ENTER], [SUSPECTS]))
def test_verdicts_of_ten_days_agree_after_every_arrival(
    seeds: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Suspects come back at the same moments, whatever an engine adjusts anew at which of them."""
    monkeypatch.setattr(days, "compare", lambda *_: None)
    came_back = 0
    for seed in seeds:
        arrivals: list[list[Arrival]] = [[], []]
        for name, told in zip(("isam2", "fronts"), arrivals, strict=True):
            list(play(seed, name, told))
        for pair in pairs(*arrivals):
            assert pair.same or pair.critical, (seed, pair)
        told_of = (v.cause for arrival in arrivals[0] for v in arrival.verdicts)
        came_back += sum(cause == "came back after add()" for cause in told_of)
    assert came_back


def test_a_moment_outside_the_promise_is_noticed() -> None:
    """The comparison sees what the promise forbids: a state that is not that of its readings."""
    described, every = drawn(200)
    inc = fga.IncrementalAdjustment(described, policy="accept")
    observations: list[AnyObservation] = list(every)
    inc.add(observations)
    assert not compare(inc, 200, "all in").outside
    system = inc._state.system
    assert system is not None
    step = 0.05 * system.lifted.sigma
    moved = replace(system, offset=system.shift + step)
    inc._state = replace(inc._state, system=moved)
    inc._solution = None
    name = next(n for n in described.points if inc.standard_deviations(n).all())
    before = system.value("point", name)
    assert not np.allclose(inc.estimate(name), before, atol=1e-12)
    assert compare(inc, 200, "moved").outside


def two_places() -> tuple[fga.Network, list[AnyObservation]]:
    """Return a point that two distances leave on either side of a line; a third tells which."""
    net = fga.Network("two places")
    net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    net.add_point("B", (10.0, 0.0, 0.0), fixed="xyz")
    net.add_point("C", (5.0, 1.0, 0.0), fixed="xyz")
    net.add_point("P", (5.0, 0.5, 0.0), fixed="z")
    at = np.array([5.0, -0.8, 0.0])
    distances: list[AnyObservation] = [
        SlopeDistance(k, "P", float(np.linalg.norm(at - net.points[k].coordinates)), sigma=0.5)
        for k in "ABC"
    ]
    return net, distances


def test_settled_and_resumed_states_are_in_the_same_minimum_as_the_batch(tmp_path) -> None:
    net, distances = two_places()
    inc = fga.IncrementalAdjustment(net, policy="accept", journal=tmp_path / "day.jsonl")
    for o in distances:
        inc.add(o)
    inc.settle()
    least = inc.solution().vtpv
    del inc
    again = fga.IncrementalAdjustment.resume(tmp_path / "day.jsonl").solution()
    batch = fga.adjust(again.network)
    assert least <= batch.vtpv + 1e-9
    assert again.vtpv == pytest.approx(least, abs=1e-6)
