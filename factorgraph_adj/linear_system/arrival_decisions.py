"""Decisions on jointly tested units: which stay, fail or wait again; verdicts; gains of σ."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from ..graph.dependence import Variable
from ..ledger.row_store import Unit
from ..ledger.verdicts import Gain, Outcome, Verdict
from ..quality.group_tests import LeaveOneOutFigures, LeaveOneOutTests, critical_t2
from ..types import Array, Index, Mask

MAX_GAINS = 300
"""Largest number of units of one arrival for which the gain in precision of points is computed."""
ROUNDING_RATIO = 1e-9
"""Eigenvalue of M, and share of σ, below which only rounding errors are left."""
SINGULAR_REDUNDANCY = 1e-5
"""Eigenvalue of M up to which rows alone determine something: without them its standard deviation
would be more than 300 times as large."""
EQUAL_TEST_VALUE_RATIO = 1e-6
"""Relative difference of test values up to which they are equal: of units that only control each
other the first one fails, however numbers are rounded."""
MOTION_SIGMAS = 1e-2
"""Movement relative to the conditional standard deviation from which a variable takes part in an
undetermined motion."""


class PointCovariance(NamedTuple):
    """A point in a system of equations."""

    columns: Index
    """Its columns; none for a constant."""
    free: Mask
    """Which of its coordinates are free, (3,)."""
    variance: Array
    """Variances of its coordinates, (3,)."""


class JointTest(Protocol):
    """Arriving units in one system of equations with everything else."""

    @property
    def units(self) -> Sequence[Unit]:
        """The units."""
        ...

    @property
    def raw(self) -> Sequence[Array]:
        """L of each unit with Σ = L Lᵀ, (d, d)."""
        ...

    def tested(self) -> LeaveOneOutTests:
        """Return the tests of the units against everything else."""
        ...

    def renewed(self) -> JointTest:
        """Return the units, to be tested at the present estimates."""
        ...

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns with the rows of a unit, (m, d)."""
        ...

    def place(self, name: str) -> PointCovariance:
        """Return a point with all units in."""
        ...

    def held_by(self, i: int, combinations: Array, new: Collection[Variable]) -> set[Variable]:
        """Return those of new variables that combinations (d, n) of a unit's rows determine."""
        ...


@dataclass
class Decision:
    """Decision on tested units, by their numbers."""

    stay: list[int]
    """Units that stay."""
    out: dict[int, LeaveOneOutFigures] = field(default_factory=dict)
    """Units that failed their test, with their figures at that moment."""
    back: list[int] = field(default_factory=list)
    """Units that contradict each other: later ones may decide which is wrong."""
    loose: set[Variable] = field(default_factory=set)
    """Variables that only those units determined."""


def decide(
    joint: JointTest,
    alpha: float,
    fixed: Mask,
    new: Collection[Variable],
) -> Decision:
    """Leave out units one by one, the one with the largest T²/critical first.

    Args:
        joint: the units.
        alpha: probability of a false alarm of one test.
        fixed: which units stay whatever their tests say, (n,).
        new: variables that enter with them.
    """
    tested = joint.tested()
    entering = set(new)
    own: list[set[Variable]] = []  # of each unit: most arrivals do not ask for them
    out = Decision(stay=list(range(len(tested.rows))))
    while out.stay:
        ratios = np.where(fixed, 0.0, tested.ratios(alpha))[out.stay]
        if not ratios.max() > 1.0:
            break
        worst = int(np.argmax(ratios >= (1.0 - EQUAL_TEST_VALUE_RATIO) * ratios.max()))
        i = out.stay[worst]
        values, vectors = np.linalg.eigh(tested.block(i))
        tied = vectors[:, values <= SINGULAR_REDUNDANCY]
        lost: set[Variable] = set()
        if tied.shape[1]:
            own = own or [entering.intersection(unit.variables) for unit in joint.units]
            if joined := _joined(own[i], [own[j] for j in out.stay]):
                lost = joint.held_by(i, tied, joined)
        if lost:
            # Without it something is not determined: whatever joins that goes back to waiting.
            gone = [j for j in out.stay if not lost.isdisjoint(own[j])]
            out.back += gone
            out.loose |= lost
        else:
            gone = [i]
            out.out[i] = tested.figures(joint.raw, np.array([i]))
        for j in gone:
            tested.leave_out(j)
        out.stay = [j for j in out.stay if j not in gone]
    return out


def _joined(some: set[Variable], units: Sequence[set[Variable]]) -> set[Variable]:
    """Return new variables with all others that units join to them.

    Known variables are determined without what enters. Hence a unit determines no others than
    these: it may improve a weak known variable, and displace what only touches that, but without it
    both are as well determined as before.

    Args:
        some: the variables.
        units: new variables of each unit.
    """
    out: set[Variable] = set()
    found, rest = set(some), list(units)
    while found > out:
        out = found
        found = out.union(*(own for own in rest if not own.isdisjoint(out)))
        rest = [own for own in rest if own.isdisjoint(out)]
    return out


def left_out(
    joint: JointTest, decision: Decision, outcome: Outcome, alpha: float, given: Collection[str]
) -> Iterator[Verdict]:
    """Iterate over the verdicts on the units that failed their tests.

    Args:
        joint: the units.
        decision: what happens to them.
        outcome: outcome of those that failed.
        alpha: probability of a false alarm of one test.
        given: ids of observations that did not wait before.
    """
    for i, figures in decision.out.items():
        yield from _tested(joint.units[i], outcome, figures, 0, alpha, given, ())


def accepted_verdicts(
    joint: JointTest, alpha: float, given: Collection[str], *, gains: bool
) -> Iterator[Verdict]:
    """Iterate over the verdicts on units that all stay.

    Args:
        joint: the units.
        alpha: probability of a false alarm of one test.
        given: ids of observations that did not wait before.
        gains: whether verdicts have the gain of each unit's points; not for more than `MAX_GAINS`
            units.
    """
    if not joint.units:
        return
    tested = joint.tested()
    figures = tested.figures(joint.raw, np.arange(len(joint.units)))
    with_gains = gains and len(joint.units) <= MAX_GAINS
    added = _gains(joint, tested) if with_gains else [()] * len(joint.units)
    for i, unit in enumerate(joint.units):
        yield from _tested(unit, "accepted", figures, i, alpha, given, added[i])


def untested(unit: Unit, outcome: Outcome, lacks: str = "", cause: str = "") -> list[Verdict]:
    """Return the verdicts on a unit that was not tested."""
    return [
        Verdict(
            i,
            o.kind,
            o.label(),
            outcome,
            o.component_names(),
            lacks=lacks,
            points=unit.points,
            cause=cause,
        )
        for i, o in zip(unit.ids, unit.observations, strict=True)
    ]


def _tested(
    unit: Unit,
    outcome: Outcome,
    figures: LeaveOneOutFigures,
    number: int,
    alpha: float,
    given: Collection[str],
    gains: tuple[Gain, ...],
) -> Iterator[Verdict]:
    """Iterate over the verdicts on a tested unit, by its number among the figures."""
    at, dof = 0, int(figures.dof[number])
    critical = critical_t2(alpha, dof)
    for ident, o in zip(unit.ids, unit.observations, strict=True):
        names = o.component_names()
        part = slice(at, at + len(names))
        at = part.stop
        yield Verdict(
            ident,
            o.kind,
            o.label(),
            outcome,
            names,
            figures.innovation[number, part],
            figures.sigma[number, part],
            figures.w[number, part],
            figures.redundancy_numbers[number, part],
            float(figures.t2[number]),
            dof,
            critical,
            entered=unit.ids[0] not in given,
            points=unit.points,
            gains=gains,
        )


def _gains(joint: JointTest, tested: LeaveOneOutTests) -> list[tuple[Gain, ...]]:
    """Return the gains of the points of each unit: without it, Q + Q Aᵀ M⁻¹ A Q."""
    found: list[dict[str, Gain]] = [{} for _ in joint.units]
    sizes = np.array([len(rows) for rows in tested.rows])
    for size in np.unique(sizes).tolist():
        numbers = np.flatnonzero(sizes == size)
        values, vectors = np.linalg.eigh(tested.blocks[numbers, :size, :size])
        members: dict[str, list[int]] = {}
        for k, i in enumerate(numbers.tolist()):
            for name in dict.fromkeys(joint.units[i].points):
                members.setdefault(name, []).append(k)
        for name, own in members.items():
            columns, free, variance = joint.place(name)
            if not len(columns):
                continue
            variance = np.maximum(variance, 0.0)
            spread = np.stack([joint.spread(i, columns) for i in numbers[own].tolist()])
            turned, along = spread @ vectors[own], values[own][:, None, :]
            on = along > ROUNDING_RATIO
            more = np.where(on, turned**2 / np.where(on, along, 1.0), 0.0).sum(axis=2)
            limit = ROUNDING_RATIO * np.sqrt(variance)[:, None]
            lost = (~on & (np.abs(turned) > limit)).any(axis=2)
            before = np.where(free, np.where(lost, np.inf, np.sqrt(variance + more)), 0.0)
            after = np.where(free, np.sqrt(variance), 0.0)
            for i, own_before in zip(numbers[own].tolist(), before, strict=True):
                found[i][name] = Gain(name, own_before, after)
    return [
        tuple(gains[n] for n in dict.fromkeys(unit.points) if n in gains)
        for unit, gains in zip(joint.units, found, strict=True)
    ]
