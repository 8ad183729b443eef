"""Which units stay: the choice comes to an end whatever the units are said to hold."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pytest

from factorgraph_adj.graph.dependence import Variable
from factorgraph_adj.linear_system.arrival_decisions import Decision, decide
from factorgraph_adj.quality import group_tests

LOST: Variable = ("point", "P")
APART: Variable = ("point", "Q")


@dataclass
class Touching:
    """A unit that touches some variables."""

    variables: tuple[Variable, ...] = ()


@dataclass
class Two:
    """Two units, of which the second is far off, and is said to hold all points by its last digits.

    It displaces known variables, which displace points that it does not touch.
    """

    first: tuple[Variable, ...] = ()
    second: tuple[Variable, ...] = ()
    raw = (np.eye(2), np.eye(2))

    @property
    def units(self) -> tuple[Touching, ...]:
        return Touching(self.first), Touching(self.second)

    def tested(self) -> group_tests.LeaveOneOutTests:
        m = np.diag([0.5, 0.5, 0.5, 1e-9])
        rows = [np.array([0, 1]), np.array([2, 3])]
        return group_tests.LeaveOneOutTests(
            rows, np.array([0.1, 0.1, 50.0, 0.0]), lambda u: m[:, u]
        )

    def held_by(self, i: int, combinations: object, new: Collection[Variable]) -> set[Variable]:
        return set(new)


def decided(units: Two) -> Decision:
    return decide(units, 0.001, np.zeros(2, dtype=bool), {LOST, APART})  # type: ignore[arg-type]


def test_what_is_said_to_hold_what_nothing_joins_any_more_is_left_out_by_itself() -> None:
    """It was asked for ever again, as nothing that joined the point was left to leave with it."""
    decision = decided(Two())
    assert decision.stay == [0]
    assert set(decision.out) == {1} and not decision.back and not decision.loose


def test_what_joins_what_would_be_lost_goes_back_together() -> None:
    decision = decided(Two((LOST, APART), (LOST,)))
    assert decision.back == [0, 1] and decision.loose == {LOST, APART} and not decision.out


def test_what_only_known_variables_join_to_what_would_be_lost_stays() -> None:
    decision = decided(Two((APART,), (LOST,)))
    assert decision.stay == [0] and decision.back == [1] and decision.loose == {LOST}


@pytest.mark.parametrize("rounding", [-1e-12, 1e-12])
def test_of_units_that_control_each_other_alone_the_first_fails(rounding: float) -> None:
    """Both have the same test value, and rounding must not decide."""

    class Alone:
        units = (Touching(), Touching())
        raw = (np.eye(1), np.eye(1))

        def tested(self) -> group_tests.LeaveOneOutTests:
            m = np.array([[0.5, -0.5], [-0.5, 0.5]])
            v = np.array([20.0, -20.0 * (1.0 + rounding)])
            return group_tests.LeaveOneOutTests(
                [np.array([0]), np.array([1])], v, lambda u: m[:, u]
            )

    decision = decide(Alone(), 0.001, np.zeros(2, dtype=bool), ())  # type: ignore[arg-type]
    assert set(decision.out) == {0} and decision.stay == [1]
