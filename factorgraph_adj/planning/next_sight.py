"""Next best sight: which observation, among those possible now, gives most for a target.

The gain of rows A of a candidate follows from the present cofactors Q without a new adjustment.
With functions F of the unknowns on which the target depends,

    F Q′ Fᵀ = F Q Fᵀ − N D⁻¹ Nᵀ,   N = F Q Aᵀ,   D = I + A Q Aᵀ,

which are the cofactors after the observation to the last digit, if it moves nothing. One solution
of the system gives Q Fᵀ, and with it N of all candidates. D takes the columns of Q for the stations
of the sights, and the blocks of the points at their ends. Where there are too many stations, only
promising candidates are solved for: from D ⪰ I + Nᵀ (F Q Fᵀ)⁻¹ N follows the largest gain that a
candidate may have, so that those that cannot be among the best are left out, and the answer is the
same.

Rows that need something that is not determined (a new point, an orientation) say nothing of the
rest, and have no gain; sights that would determine a new point are named. In a free network, rows
that notice the motions that its datum leaves open are no candidates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..ledger.ledger import Ledger
from ..linear_system.cofactor_columns import CofactorColumns, WithRows, cofactor_columns
from ..linear_system.linear_system import LinearSystem
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..statistical_tests import POWER_OF_TEST
from ..types import Array, Index
from .arriving_candidates import given_candidates
from .candidates import Candidate
from .possible_sights import POINT, Places, PossibleSights, possible_sights
from .target_functions import TargetFunctions, TargetItem, TargetReader, gains, lack_of
from .targets import MET, PositionError, Target, as_targets, describe

MAX_HUB_COLUMNS = 400
"""Largest number of columns of stations for which all of them are solved for."""
SOLVED_TOGETHER = 96
"""Number of promising candidates that are solved for together."""
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

    def __str__(self) -> str:
        """Return what changes, lengths in millimetres."""
        text = describe(self.target)
        what, unit = text.replace(" (m)", ""), " mm" if text.endswith("(m)") else ""
        size = 1e3 if unit else 1.0
        before = f"{size * self.before:.3g}" if np.isfinite(self.before) else "uncontrolled"
        after = f"{size * self.after:.3g}" if np.isfinite(self.after) else "uncontrolled"
        return f"{what} of {self.item} from {before} to {after}{unit}"


@dataclass(frozen=True, eq=False)
class NextSight:
    """A candidate with its gain."""

    candidate: Candidate
    """What would be observed; the observed values are those of its models."""
    gain: float
    """Σ ln(before/after) of the figures that fail their limits; of all if none fails."""
    cost: float
    """Cost of the candidate."""
    figures: tuple[ExpectedFigure, ...]
    """Figures of all items before and after, the most improved first."""
    lacks: bool = False
    """Whether one of its readings needs something that is not determined, and says nothing."""

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
        return self.candidate.name

    def __str__(self) -> str:
        """Return a sentence for the surveyor."""
        if not self.figures:
            return self.aim
        more = f", and {len(self.figures) - 1} more" if len(self.figures) > 1 else ""
        return f"{self.aim}: {self.figures[0]}{more}"


@dataclass(frozen=True, eq=False, repr=False)
class NextSights(Shown):
    """The best candidates for a target."""

    targets: tuple[Target, ...]
    """The targets."""
    sights: tuple[NextSight, ...]
    """The best first; of a sequence in its order, each after those before it."""
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


class Gains:
    """Gains of candidates for functions of the unknowns."""

    def __init__(self, functions: TargetFunctions, limited: bool) -> None:
        """Solve for the functions.

        Args:
            functions: the functions.
            limited: whether only items that fail their limits count, if there are such.
        """
        self.of = functions
        self.spread = functions.cofactors.times(functions.rows)
        self.b = functions.rows.T @ self.spread
        self.b = 0.5 * (self.b + self.b.T)
        self.before = [float(i.figures(self._own(i)[None])[0]) for i in functions.items]
        failing = [
            n for n, (i, f) in enumerate(zip(functions.items, self.before, strict=True))
            if lack_of(i, f) > 0
        ]
        self.counted = failing if limited and failing else list(range(len(self.before)))

    def _own(self, item: TargetItem) -> Array:
        return self.b[np.ix_(item.at, item.at)]

    def along(self, a: Array, columns: Index) -> Array:
        """Return N (m, t, d) of rows A (m, d, w) at columns (m, w), −1: none."""
        picked = np.where((columns >= 0)[:, :, None], self.spread[columns], 0.0)
        return np.asarray((a @ picked).transpose(0, 2, 1))

    def after(self, n: int, along: Array, d: Array) -> Array:
        """Return figures (m,) of an item after candidates with N (m, t, d) and D (m, d, d)."""
        item = self.of.items[n]
        own = along[:, item.at]
        if d.shape[1] == 1:
            loss = own @ own.transpose(0, 2, 1) / d
        else:
            loss = own @ np.linalg.solve(d, own.transpose(0, 2, 1))
        return item.figures(self._own(item) - loss)

    def gains(self, along: Array, d: Array) -> Array:
        """Return the gains of candidates, (m,)."""
        out = np.zeros(len(along))
        for n in self.counted:
            after = self.after(n, along, d)
            out += gains(self.of.items[n].target, self.before[n], after)
        return out

    def most(self, along: Array) -> Array:
        """Return what candidates gain at most, (m,)."""
        scale = np.sqrt(np.maximum(np.diag(self.b), 0.0))
        on = scale > 0
        even = self.b[np.ix_(on, on)] / np.outer(scale[on], scale[on])
        n = along[:, on] / scale[on][:, None]
        d = n.transpose(0, 2, 1) @ np.linalg.pinv(even, rcond=1e-10, hermitian=True) @ n
        return self.gains(along, np.eye(along.shape[2]) + d)


class SightGains:
    """Gains of candidates of one family for all targets."""

    def __init__(self, sights: PossibleSights, names: Sequence[str], of: Sequence[Gains]) -> None:
        """Take the candidates over.

        Args:
            sights: the candidates.
            names: names of the points.
            of: functions of the targets.
        """
        self.sights, self.names, self.of = sights, names, of
        self.along = [g.along(sights.a, sights.columns) for g in of]

    def gains(self, most: int, cost: Array) -> tuple[Array, list[Array]]:
        """Return the gains (m,), −∞ where they cannot be among the best, and D of each function.

        Args:
            most: number of the best by gain and cost.
            cost: cost of each candidate, (m,).
        """
        s = self.sights
        hubs = np.unique(s.columns[:, :-POINT])
        hubs = hubs[hubs >= 0]
        if len(hubs) <= MAX_HUB_COLUMNS and (s.points >= 0).all():
            d = [self._all(g.of.cofactors, hubs) for g in self.of]
            return self._sum(np.arange(s.n), d), d
        return self._best(most, cost)

    def _all(self, cofactors: CofactorColumns, hubs: Index) -> Array:
        """Return D of all candidates from the columns of stations and the blocks of points."""
        s = self.sights
        unit = np.zeros((cofactors.size, len(hubs)))
        unit[hubs, np.arange(len(hubs))] = 1.0
        q = cofactors.times(unit) if len(hubs) else unit
        place = np.full(cofactors.size + 1, -1, dtype=np.intp)
        place[hubs] = np.arange(len(hubs))
        of_hub, of_point = s.columns[:, :-POINT], s.columns[:, -POINT:]
        d = np.broadcast_to(np.eye(s.a.shape[1]), (s.n, *(s.a.shape[1],) * 2)).copy()
        leaf = s.a[:, :, -POINT:]
        used = np.unique(s.points)
        blocks = np.zeros((int(used.max(initial=0)) + 1, POINT, POINT))
        blocks[used] = cofactors.point_blocks([self.names[i] for i in used.tolist()])
        d += leaf @ blocks[s.points] @ leaf.transpose(0, 2, 1)
        if of_hub.shape[1] and len(hubs):
            hub = np.where((of_hub >= 0)[:, None, :], s.a[:, :, :-POINT], 0.0)
            at = place[of_hub]
            q_hh = q[of_hub[:, :, None], at[:, None, :]]
            q_lh = q[of_point[:, :, None], at[:, None, :]]
            point = np.where((of_point >= 0)[:, None, :], leaf, 0.0)
            cross = point @ q_lh @ hub.transpose(0, 2, 1)
            d += hub @ q_hh @ hub.transpose(0, 2, 1) + cross + cross.transpose(0, 2, 1)
        return d

    def _best(self, most: int, cost: Array) -> tuple[Array, list[Array]]:
        """Return gains of those candidates that may be among the best."""
        s = self.sights
        bound = sum((g.most(n) for g, n in zip(self.of, self.along, strict=True)), np.zeros(s.n))
        out = np.full(s.n, -np.inf)
        size = s.a.shape[1]
        d = [np.broadcast_to(np.eye(size), (s.n, size, size)).copy() for _ in self.of]
        order = np.argsort(-bound / cost, kind="stable")
        for first in range(0, s.n, SOLVED_TOGETHER):
            some = order[first : first + SOLVED_TOGETHER]
            least = np.partition(out / cost, -most)[-most] if most <= s.n else -np.inf
            if bound[some[0]] / cost[some[0]] <= least or (bound[order[first:]] <= MET).all():
                break
            for own, g in zip(d, self.of, strict=True):
                own[some] = solved_d(g.of.cofactors, s.a[some], s.columns[some])
            out[some] = self._sum(some, d)
        return out, d

    def _sum(self, some: Index, d: Sequence[Array]) -> Array:
        """Return the gains of some candidates for all targets."""
        out = np.zeros(len(some))
        for g, along, own in zip(self.of, self.along, d, strict=True):
            out += g.gains(along[some], own[some])
        return out


def solved_d(cofactors: CofactorColumns, a: Array, columns: Index) -> Array:
    """Return D (m, d, d) of rows A (m, d, w) at columns (m, w) by a solution for each row."""
    m, size, _ = a.shape
    y = dense_rows(cofactors.size, a, columns)
    x = cofactors.times(y).reshape(-1, m, size)
    out = np.zeros((m, size, size))
    for j in range(columns.shape[1]):
        at = columns[:, j]
        on = np.flatnonzero(at >= 0)
        out[on] += a[on, :, j][:, :, None] * x[at[on], on][:, None, :]
    return np.eye(size) + 0.5 * (out + out.transpose(0, 2, 1))


def dense_rows(n: int, a: Array, columns: Index) -> Array:
    """Return Aᵀ (n, m d) of rows A (m, d, w) at columns (m, w)."""
    m, size, width = a.shape
    out = np.zeros((n, m, size))
    each = np.arange(m)
    for j in range(width):
        on = columns[:, j] >= 0
        out[columns[on, j], each[on]] += a[on, :, j]
    return out.reshape(n, m * size)


@dataclass(frozen=True)
class SightChoice:
    """Which candidates are examined, and how they are ranked."""

    stations: tuple[str, ...] | None = None
    """Names of the stations; None: all that are set up, levelling and GNSS."""
    points: tuple[str, ...] | None = None
    """Names of the points to which sights go; None: all."""
    kinds: tuple[str, ...] | None = None
    """Kinds of observations; None: all."""
    reach: float = np.inf
    """Largest length of a sight, metres."""
    together: bool = True
    """Whether everything that a station reads is one sight; otherwise each reading is one."""
    costs: Mapping[str, float] | None = None
    """Cost of a reading of each kind, such as seconds; None: every sight has the cost 1."""
    most: int = 10
    """Largest number of sights."""
    sequence: bool = False
    """Whether each sight is the best after those before it."""


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

    Raises:
        InputError: invalid targets and candidates, and names that are not there.
    """
    targets = targets_of(target)
    cofactors = cofactor_columns(system, solution)
    if candidates is None:
        places, families = possible_sights(
            ledger,
            system,
            cofactors,
            stations=choice.stations,
            points=choice.points,
            kinds=choice.kinds,
            reach=choice.reach,
            together=choice.together,
        )
    else:
        places = Places.of(ledger, system, cofactors, ())
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
        rows = dense_rows(n, best.family.a[[best.number]], best.family.columns[[best.number]])
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
        tuple(f.make(i).name for f in families for i in np.flatnonzero(f.determines >= 0)),
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
    for _, gain, cost, k, i in found[:most]:
        each, d = examined[k]
        out.append(_Ranked(families[k], i, gain, cost, _figures(each, d, i)))
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
