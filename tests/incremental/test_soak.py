"""Observations that come and go by chance, with nonsense and degenerate geometry among them.

`Life` is a state machine of Hypothesis: rules are what may happen on the site, and whatever
happens, in whatever order,

- every observation is in the graph, waiting, suspect or rejected, and what waits says why;
- what is refused is refused with words and changes nothing;
- a resumed journal is the state that it was written from;
- the solution is that of the batch adjustment, within `PROMISE`, and within `AT_REST` when settled.

What breaks is shrunk to the fewest events. The short lives here are the same on every machine;
``HYPOTHESIS_PROFILE=soak pytest tests/incremental/test_soak.py -k lives`` plays 500 new ones of
100 events, and ``python -m tests.benchmarks soak`` one of 20 000.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TypeVar

import numpy as np
import pytest
from hypothesis import HealthCheck, Phase, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from factorgraph_adj import IncrementalAdjustment, adjust
from factorgraph_adj.ledger.verdicts import Policy
from factorgraph_adj.observations import Direction, HeightDifference, ImagePoint, SlopeDistance
from tests.networks.site import STATIONS
from tests.networks.small_block import small_block
from tests.support import events
from tests.support.events import EVENTS, Choices
from tests.support.memory import held_bytes
from tests.support.soak import Soak
from tests.support.watched import AT_REST, PROMISE, Watched

ROUNDS = 40
"""Rounds of arrivals after which tables and caches have reached their size."""
GROWTH = 200
"""Bytes that an arrival and its removal may leave: caches."""
T = TypeVar("T")

# -- lives that Hypothesis makes up ---------------------------------------------------------------


class Drawn:
    """Choices that Hypothesis makes, see `tests.support.events.Choices`."""

    def __init__(self, data: st.DataObject) -> None:
        self.draw = data.draw

    def whole(self, low: int, high: int) -> int:
        return self.draw(st.integers(low, high - 1))

    def real(self, low: float, high: float) -> float:
        return self.draw(st.floats(low, high))

    def chance(self, probability: float) -> bool:
        return self.draw(st.integers(0, 99)) < 100 * probability

    def error(self) -> float:
        return self.draw(st.floats(-3.0, 3.0))

    def fitting(self, what: Sequence[T], fits: Callable[[T], bool]) -> T | None:
        found = [item for item in what if fits(item)]
        return found[self.whole(0, len(found))] if found else None


def happens(event: Callable[[Watched, Choices], None]) -> Callable[[Life, st.DataObject], None]:
    """Return an event as what a rule of the state machine does."""

    def played(life: Life, data: st.DataObject) -> None:
        life.play(event.__name__, lambda: event(life.site, Drawn(data)))

    played.__name__ = event.__name__
    return played


OFTEN = rule(data=st.data())
SELDOM = precondition(lambda life: life.site.n % 4 == 3)
"""For rules that take long."""


class Life(RuleBasedStateMachine):
    """An adjustment from its first observation to its last."""

    def __init__(self) -> None:
        super().__init__()
        self.folder = TemporaryDirectory()
        self.sound = False
        """Whether nothing has broken."""

    @initialize(
        seed=st.integers(0, 2),
        policy=st.sampled_from(["flag", "reject"]),
        stations=st.lists(st.sampled_from(list(STATIONS)), unique=True),
    )
    def morning(self, seed: int, policy: Policy, stations: list[str]) -> None:
        """Some stations observe all that they see."""
        self.site = Watched(seed, policy, Path(self.folder.name, "life.jsonl"))
        for station in stations:
            self.play("morning", partial(events.observe_all, self.site, station))
        self.sound = True

    def play(self, name: str, event: Callable[[], None]) -> None:
        """Let something happen; after an error everything is as it was."""
        self.sound = False
        self.site.play(name, event)
        self.sound = True

    # Rules are drawn alike: what comes has more of them than what goes.
    arrival = OFTEN(happens(events.arrival))
    another_arrival = OFTEN(happens(events.arrival))
    one_more_arrival = OFTEN(happens(events.arrival))
    whole_photo = OFTEN(happens(events.whole_photo))
    entity = OFTEN(happens(events.entity))
    removal = OFTEN(happens(events.removal))
    replacement = OFTEN(happens(events.replacement))
    reweighting = OFTEN(happens(events.reweighting))
    gross_error = OFTEN(happens(events.gross_error))
    accepting = OFTEN(happens(events.accepting))
    discarding = OFTEN(happens(events.discarding))
    clean_up = OFTEN(happens(events.clean_up))
    nonsense = OFTEN(happens(events.nonsense))
    degenerate = OFTEN(happens(events.degenerate))
    beyond_reason = OFTEN(happens(events.beyond_reason))
    snooping = SELDOM(OFTEN(happens(events.snooping)))
    asking = SELDOM(OFTEN(happens(events.asking)))

    @SELDOM
    @rule()
    def settling(self) -> None:
        """Come to rest."""
        self.play("settling", self.site.inc.settle)

    @SELDOM
    @rule()
    def resuming(self) -> None:
        """Go on from the journal."""
        self.play("resuming", self.site.resume)

    @SELDOM
    @rule()
    def comparing(self) -> None:
        """Compare with the batch adjustment; come to rest and compare again."""
        self.play("comparing", self.site.assert_as_batch)

    @invariant()
    def everything_is_somewhere(self) -> None:
        self.site.check_ids("at any time")

    def teardown(self) -> None:
        if self.sound:
            self.site.assert_as_batch()
        self.folder.cleanup()


LONG = settings(suppress_health_check=list(HealthCheck))
"""As the profile says."""
SHORT = settings(
    LONG, max_examples=8, stateful_step_count=30, phases=(Phase.explicit, Phase.generate)
)
"""A few short lives; one that fails is told as it was found, without minutes of shrinking."""


@pytest.mark.slow(
    "anything in any order, where other tests of the incremental adjustment have one thing each: "
    "what breaks here is what nobody thought of"
)
def test_lives_of_any_events_are_those_of_the_batch():
    asked = os.environ.get("HYPOTHESIS_PROFILE") == "soak"
    run_state_machine_as_test(Life, settings=LONG if asked else SHORT)


def test_every_event_has_a_rule():
    rules = {rule.function.__name__ for rule in Life.setup_state().rules}
    assert {event.__name__ for _, event in EVENTS} <= rules
    assert {"settling", "resuming", "comparing"} <= rules


# -- one life by a seed ---------------------------------------------------------------------------


@pytest.mark.slow(
    "two lives of 250 events: adjustments of hundreds of observations, taken apart and put "
    "together many times over; the lives of Hypothesis are short"
)
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
    assert len(soak.site.inc) > 50
    assert soak.site.done["nonsense: InputError"] > 10
    assert soak.site.done["arrival"] > 70 and soak.site.done["removal"] > 25


def test_every_kind_of_event_is_played():
    """A soak without arrivals of one kind would prove nothing of them."""
    names = [event.__name__ for _, event in EVENTS]
    assert len(set(names)) == len(names) == 15
    kinds = {getattr(o, "kind", "group") for o in Soak(1).site.pool}
    assert len(kinds) == 11


@pytest.mark.slow(
    "eighty rounds of arrivals after forty: what grows by jumps, when a table is doubled or the "
    "tree is built anew, shows only after many; nothing else here measures memory"
)
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

    def held() -> int:
        inc.settle()
        return held_bytes()

    turn(ROUNDS)  # tables and caches reach their size
    before = held()
    turn(2 * ROUNDS)
    assert held() - before < GROWTH * 4 * 2 * ROUNDS


@pytest.mark.slow("walks through all that a process holds, by which the long runs count memory")
def test_what_is_held_is_counted_behind_views_and_in_containers_too():
    """8 MB and 3 MB, each to a hundredth of both.

    A process of tests also holds what it tells of them, some kB that come and go between counts.
    """
    behind, within = 8_000_000, 3_000_000
    noise = 0.01 * (behind + within)
    before = held_bytes()
    kept = [np.ones(behind // 8)[::2], np.array([[1.5] * 3, "x" * within], dtype=object)]
    assert held_bytes() - before == pytest.approx(behind + within, abs=noise)
    kept.clear()
    assert held_bytes() - before == pytest.approx(0.0, abs=noise)
