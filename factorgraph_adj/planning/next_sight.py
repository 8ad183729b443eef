"""Next best sight: which observation, among those possible now, gives most for a target.

The gain of a candidate follows from the present cofactors without a new adjustment, see
`factorgraph_adj.planning.sight_gains`: the figures are those that the adjustment has after the
observation, if it moves nothing. Candidates are the sights that are possible now
(`factorgraph_adj.planning.possible_sights`), or given ones.

Rows that need something that is not determined (a new point, an orientation) say nothing of the
rest, and have no gain; sights that would determine a new point are named. In a free network, rows
that notice the motions that its datum leaves open are no candidates.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError, Problem
from ..ledger.ledger import Ledger
from ..linear_system.cofactor_columns import WithRows
from ..linear_system.linear_system import LinearSystem
from ..observations.registry import CONTROL_QUANTITIES
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..statistical_tests import POWER_OF_TEST
from ..types import Array
from ..units import LENGTH
from .arriving_candidates import given_candidates
from .candidates import Candidate
from .possible_sights import possible_sights
from .sight_gains import Gains, SightGains, dense_rows
from .sight_rows import PossibleSights
from .sight_templates import Places, SightMemory
from .target_functions import TargetReader, gains
from .targets import (
    MET,
    DetectableError,
    PointPrecision,
    PositionError,
    RedundancyNumber,
    Target,
    as_targets,
    describe,
)

NO_LIMIT = 1e-15
"""Limit of a target that was given by a name alone, metres: any precision is worth having."""


@dataclass(frozen=True)
class ExpectedFigure:
    """A figure of a target before and after a candidate."""

    item: str
    """Name of the point, or label of the observation."""
    target: Target
    """The target."""
    before: float
    """Figure now: metres, a redundancy number, or σ of the observation."""
    after: float
    """Figure with the candidate."""

    @property
    def is_length(self) -> bool:
        """Whether the figures are lengths, metres."""
        return not isinstance(self.target, RedundancyNumber | DetectableError)

    def text(self, unit: str = "mm") -> str:
        """Return what changes, lengths in a unit."""
        size = LENGTH[unit] if self.is_length else 1.0
        shown = (
            f"{f / size:.3g}" if np.isfinite(f) else "uncontrolled"
            for f in (self.before, self.after)
        )
        what = f"{noun_of(self.target)} of {self.item} from {' to '.join(shown)}"
        if self.is_length:
            return f"{what} {unit}"
        return f"{what} σ" if isinstance(self.target, DetectableError) else what

    def __str__(self) -> str:
        """Return what changes, lengths in millimetres."""
        return self.text()


def noun_of(target: Target) -> str:
    """Return the name of the figures of a target without their unit."""
    if isinstance(target, PositionError | PointPrecision) and target.axes == "z":
        return "σ of the height"
    if isinstance(target, PositionError):
        where = {"xyz": "", "xy": " in plan"}.get(target.axes, f" ({target.axes})")
        return f"position error{where}"
    return re.sub(r" \([^)]*\)$", "", describe(target))


@dataclass(frozen=True, eq=False)
class NextSight:
    """A candidate with its gain."""

    candidate: Candidate
    """What would be observed; the observed values are those of its models."""
    gain: float
    """Σ ln(before/after) of the figures that fail their limits, of all if none fails; no unit."""
    cost: float
    """Cost of the candidate in the unit of ``costs``; 1 where none are stated."""
    figures: tuple[ExpectedFigure, ...]
    """Figures of all items before and after, the most improved first."""
    lacks: bool = False
    """Whether one of its readings needs something undetermined, so that this reading adds nothing
    to the gain."""

    @property
    def aim(self) -> str:
        """What to do: where to aim from which station, with which readings."""
        first = next(iter(self.candidate.single))
        kinds = ", ".join(dict.fromkeys(o.kind.replace("_", " ") for o in self.candidate.single))
        station, target = (getattr(first, name, None) for name in ("station", "target"))
        if first.record.quantity == "height difference":
            return f"level from {station} to {target}"
        if station is not None and target is not None:
            return f"aim at {target} from {station} ({kinds})"
        if first.record.quantity in CONTROL_QUANTITIES:
            return f"measure {self.candidate.name}"
        return self.candidate.name

    def sentence(self, unit: str = "mm") -> str:
        """Return a sentence for the surveyor, lengths in a unit."""
        first, n = self.figures[0], len(self.figures) - 1
        return f"{self.aim}: {first.text(unit)}" + (f", and {n} more" if n else "")

    def __str__(self) -> str:
        """Return a sentence for the surveyor, lengths in millimetres."""
        return self.sentence()


@dataclass(frozen=True, eq=False, repr=False)
class NextSights(Shown):
    """The best candidates for a target."""

    targets: tuple[Target, ...]
    """The targets."""
    sights: tuple[NextSight, ...]
    """The best first, without those that gain nothing, so that there may be none; of a sequence in
    its order, each after those before it."""
    examined: int
    """Number of candidates."""
    figures: tuple[ExpectedFigure, ...]
    """Present figures of all items; before and after are equal."""
    determining: tuple[str, ...] = ()
    """Names of sights that would determine new points: ``S1 to P7``."""

    def headline(self) -> str:
        """Return the best one."""
        if not self.sights:
            return f"Next sights: none of {self.examined} candidates gains anything"
        return f"Next sights, of {self.examined} candidates: {self.sights[0]}"

    def first_rows(self) -> Rows:
        """Return the sights with their gains."""
        cells = ((str(s), s.gain, s.cost) for s in self.sights)
        return Rows(("sight", "gain", "cost"), cells, len(self.sights))


def targets_of(given: Any) -> tuple[Target, ...]:
    """Return targets; names of points stand for their position errors without a limit."""
    if isinstance(given, str):
        given = (given,)
    elif not isinstance(given, Sequence):
        return as_targets(given)
    every = list(given)
    names = tuple(t for t in every if isinstance(t, str))
    targets = as_targets([t for t in every if not isinstance(t, str)])
    if not every:
        raise InputError("next_sights needs a target: the name of a point, or a target of a design")
    return (*((PositionError(NO_LIMIT, names),) if names else ()), *targets)


@dataclass(frozen=True)
class SightChoice:
    """Which candidates are examined, and how they are ranked."""

    stations: Sequence[str] | None = None
    """Names of the stations, or patterns; None: all that are set up, levelling and GNSS."""
    to: Sequence[str] | None = None
    """Names of the points to which sights go, or patterns; None: all."""
    kinds: Sequence[str] | None = None
    """Kinds of observations; None: all."""
    reach: float | None = None
    """Largest length of a sight, metres; None: that of the longest sight so far."""
    singly: bool = False
    """Whether each reading is a sight of its own; otherwise everything that a station reads."""
    costs: Mapping[str, float] | None = None
    """Cost of a reading of each kind, such as seconds; None: every sight has the cost 1."""
    most: int = 10
    """Largest number of sights."""
    sequence: bool = False
    """Whether each sight is the best after those before it."""

    def __post_init__(self) -> None:
        """Take single names as one, and refuse other invalid options.

        Raises:
            InputError: all of them.
        """
        problems = []
        for name in ("stations", "to", "kinds"):
            if isinstance(given := getattr(self, name), str):
                object.__setattr__(self, name, (given,))
        if isinstance(self.most, bool) or not isinstance(self.most, int) or self.most < 1:
            problems.append(Problem(f"most must be a whole number from 1, not {self.most!r}"))
        if self.reach is not None and not self.reach > 0:
            problems.append(Problem(f"reach must be greater than zero, not {self.reach!r}"))
        for kind, cost in (self.costs or {}).items():
            if not (np.isfinite(cost) and cost > 0):
                what = f"the cost of {kind!r} must be greater than zero, not {cost!r}"
                problems.append(Problem(what))
        if problems:
            raise InputError(problems)


@dataclass(frozen=True, eq=False)
class _Ranked:
    """A candidate by its place, with its gain."""

    family: PossibleSights
    number: int
    gain: float
    cost: float
    figures: tuple[ExpectedFigure, ...]

    def sight(self) -> NextSight:
        """Return it with its observations."""
        candidate, lacks = self.family.make(self.number), bool(self.family.lacks[self.number])
        return NextSight(candidate, self.gain, self.cost, self.figures, lacks)


def next_sights(
    ledger: Ledger,
    system: LinearSystem,
    solution: Callable[[], Solution],
    target: Any,
    candidates: Sequence[Candidate] | Candidate | None = None,
    *,
    alpha: float,
    choice: SightChoice,
    memory: SightMemory,
) -> NextSights:
    """Return the candidates that gain most for targets.

    Args:
        ledger: what has arrived.
        system: the linear system.
        solution: returns the whole solution, which a section of a large network takes.
        target: names of points, or targets of a design.
        candidates: the candidates; None: all that is possible now, see
            `factorgraph_adj.planning.possible_sights`.
        alpha: probability of a false alarm of the test of an observation.
        choice: which of them are examined, and how they are ranked.
        memory: what earlier queries of the same adjustment have found.

    Raises:
        InputError: invalid targets and candidates, and names that are not there.
    """
    targets = targets_of(target)
    cofactors = memory.cofactors(system, solution)
    if candidates is None:
        places, families = possible_sights(
            ledger,
            system,
            cofactors,
            memory,
            stations=choice.stations,
            points=choice.to,
            kinds=choice.kinds,
            reach=choice.reach,
            singly=choice.singly,
        )
    else:
        places = Places.of(ledger, system, cofactors, (), memory)
        families = [given_candidates(ledger, system, cofactors, candidates)]
    functions = TargetReader(ledger, system, places, alpha, POWER_OF_TEST).functions(targets)
    present = [Gains(f, limited=True) for f in functions]
    sights: list[NextSight] = []
    for _ in range(choice.most if choice.sequence else 1):
        of = [Gains(f, limited=True) for f in functions] if sights else present
        found = _ranked(families, places.names, of, choice)
        sights += [r.sight() for r in found]
        if not (choice.sequence and found):
            break
        best, n = found[0], cofactors.size
        rows = dense_rows(n, *best.family.rows(np.array([best.number])))
        functions = [f.carried(lambda q, b=rows: WithRows(q, b)) for f in functions]  # type: ignore[misc]
    return NextSights(
        targets,
        tuple(sights),
        sum(f.n for f in families),
        tuple(
            ExpectedFigure(i.name, i.target, f, f)
            for g in present
            for i, f in zip(g.of.items, g.before, strict=True)
        ),
        tuple(f.make(i).name for f in families for i in np.flatnonzero(f.determines >= 0).tolist()),
    )


def _ranked(
    families: Sequence[PossibleSights],
    names: Sequence[str],
    of: Sequence[Gains],
    choice: SightChoice,
) -> list[_Ranked]:
    """Return the best candidates of all families."""
    most = 1 if choice.sequence else choice.most
    found: list[tuple[float, float, float, int, int]] = []
    examined = []
    for k, family in enumerate(families):
        each = SightGains(family, names, of)
        cost = family.cost_of(choice.costs)
        gain, d = each.gains(most, cost)
        examined.append((each, d))
        worth = np.where(gain > MET, gain / cost, -np.inf)
        order = np.argsort(-worth, kind="stable")[:most]
        found += [
            (-float(worth[i]), float(gain[i]), float(cost[i]), k, int(i))
            for i in order.tolist()
            if gain[i] > MET
        ]
    found.sort(key=lambda f: (f[0], f[3], f[4]))
    out = []
    for _, own, price, k, i in found[:most]:
        each, d = examined[k]
        out.append(_Ranked(families[k], i, own, price, _figures(each, d, i)))
    return out


def _figures(each: SightGains, d: Sequence[Array], i: int) -> tuple[ExpectedFigure, ...]:
    """Return the figures of all items before and after candidate i, the most improved first."""
    out: list[tuple[float, ExpectedFigure]] = []
    for g, along, own in zip(each.of, each.along, d, strict=True):
        for n, item in enumerate(g.of.items):
            before, after = g.before[n], g.after(n, along[[i]], own[[i]])
            figure = ExpectedFigure(item.name, item.target, before, float(after[0]))
            out.append((float(gains(item.target, before, after)[0]), figure))
    return tuple(f for _, f in sorted(out, key=lambda o: -o[0]))
