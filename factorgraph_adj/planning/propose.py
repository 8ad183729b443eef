"""The cheapest additions that make a design meet its targets.

Greedy by gain for cost: how much nearer a candidate brings the targets (the sum over all items of
the logarithm of figure and limit), divided by its cost, with the covariances brought up to date
for each candidate by `factorgraph_adj.planning.covariances`, not solved anew. Then what turned
out superfluous is left out, and single and pairs of candidates are exchanged for cheaper ones.
Each proposal is checked by a plan of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ..errors import InputError, Problem
from ..network import Network
from ..quality.rows import whitened_unit
from ..types import Array, Index, Mask
from .candidates import Candidate, Linearised, identified, linearise, partials, with_candidates
from .covariances import Covariances, PointItems, RowItems, Told, Watched, told
from .plan import Plan, horizons, plan, rows_like
from .targets import (
    RowTarget,
    Shortfall,
    Target,
    UndetectedShift,
    for_points,
    lacking,
    matching,
)

MET = 1e-9
"""Lack that is rounding."""
MOST_CHECKS = 10
"""Plans until a proposal has met its targets."""
MOST_PAIRS = 12
"""Candidates of a proposal up to which pairs of them are exchanged,"""
MOST_FOR_PAIRS = 60
"""and candidates that there are."""
LISTED = 12
"""Shortfalls that a message lists."""


@dataclass(frozen=True)
class Step:
    """A candidate that is proposed."""

    candidate: Candidate
    """It."""
    gain: float
    """How much nearer it brought the targets."""
    lack: float
    """How far they are after it; 0: met."""
    cost: float
    """Cumulative cost."""


@dataclass(frozen=True, eq=False)
class Proposal:
    """What to add to a design."""

    steps: tuple[Step, ...]
    """Candidates in the order of gain for cost."""
    plan: Plan
    """The design with them; its targets are met."""
    before: Plan
    """The design without them."""

    @property
    def cost(self) -> float:
        """Cost of all together."""
        return self.steps[-1].cost if self.steps else 0.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the candidates."""
        return tuple(s.candidate.name for s in self.steps)


def propose(
    network: Network,
    candidates: Iterable[Candidate],
    targets: Sequence[Target],
    *,
    alpha: float = 0.001,
    power: float = 0.80,
) -> Proposal:
    """Propose the cheapest additions that make a design meet its targets.

    Args:
        network: the design, determined by its own observations; see `plan`.
        candidates: what could be added, each with a cost.
        targets: what is to be achieved; of the points of the design, and of all observations,
            those of candidates among them.
        alpha: as in `plan`.
        power: as in `plan`.

    Raises:
        InputError: bad candidates or targets; targets that all candidates together do not meet,
            by item.
        DatumError: the design itself is not determined.
    """
    before = plan(network, targets, alpha=alpha, power=power)
    # Stations and other points that come with candidates are no targets themselves.
    targets = tuple(for_points(t, list(network.points)) for t in targets)
    before = Plan(before.solution, before.reliability, targets)
    every = identified(list(candidates))
    whole = with_candidates(network, every)
    if before.met:
        return Proposal((), before, before)
    _refuse_unreachable(before, plan(whole, targets, alpha=alpha, power=power))
    design, chosen = before, []  # type: ignore[var-annotated]
    for _ in range(MOST_CHECKS):
        left = [c for c in every if c.name not in {s.name for s in chosen}]
        search = _Search.of(design, left, targets)
        picked = search.cheapest()
        chosen += [left[n] for n in picked]
        design = plan(with_candidates(network, chosen), targets, alpha=alpha, power=power)
        if design.met or not picked:
            break
    if not design.met:
        raise InputError(
            [
                Problem("no choice of candidates was found that meets it", str(s))
                for s in design.shortfalls[:LISTED]
            ]
        )
    return Proposal(_ordered(before, chosen, targets), design, before)


def _refuse_unreachable(before: Plan, best: Plan) -> None:
    """Raise what fails the targets with all candidates, and is the design's own."""
    own = {s.item for s in before.shortfalls}
    hopeless = [s for s in best.shortfalls if s.item in own]
    if hopeless:
        raise InputError(
            [
                Problem(f"cannot be met: {_of(s)} with all candidates together", s.item)
                for s in hopeless[:LISTED]
            ]
        )


def _of(s: Shortfall) -> str:
    return str(s).removeprefix(f"{s.item}: ")


def _ordered(
    before: Plan, chosen: Sequence[Candidate], targets: Sequence[Target]
) -> tuple[Step, ...]:
    """Return the steps of what was chosen, by gain for cost."""
    search = _Search.of(before, list(chosen), targets)
    state, known = search.start.copy(), search.known.copy()
    left, lack, cost = list(range(len(chosen))), search.start.lack(), 0.0
    steps = []
    while left:
        best = search.best(state, known, left)
        n = left[0] if best is None else best
        known = search.take(state, known, n)
        after, cost = state.lack(), cost + chosen[n].cost
        steps.append(Step(chosen[n], lack - after, after, cost))
        lack = after
        left.remove(n)
    return tuple(steps)


class _Search:
    """Choosing among candidates."""

    def __init__(
        self,
        start: Covariances,
        known: Mask,
        place: Index,
        candidates: Sequence[Candidate],
        linear: Linearised,
    ) -> None:
        self.start, self.known, self.place = start, known, place
        self.costs = np.array([c.cost for c in candidates])
        self.linear = linear
        self._told: dict[tuple[int, bytes], Told | None] = {}

    @classmethod
    def of(
        cls, design: Plan, candidates: Sequence[Candidate], targets: Sequence[Target]
    ) -> _Search:
        """Look at a design: Q of all that candidates touch and targets ask for."""
        solution = design.solution
        equations = solution.equations
        network = with_candidates(design.network, candidates)
        linear = linearise(equations, network, candidates)
        point = linear.equations.unknowns["point"]
        names = list(point.names)
        wanted = [np.zeros(0, dtype=np.intp)]
        wanted += [r.columns for r in linear.rows]
        failing = _failing_rows(design, targets)
        a = partials(solution.normal().system)
        left, right, weight = _watched_rows(design, a, failing)
        for matrix in (left, right):
            wanted.append(linear.column[np.flatnonzero(np.abs(matrix).sum(axis=0))])
        for t in targets:
            if not isinstance(t, RowTarget) or isinstance(t, UndetectedShift):
                on = matching(names, t.points) & (point.offset >= 0)
                wanted.append((point.offset[on, None] + np.arange(3)).ravel())
        columns = np.unique(np.concatenate(wanted))
        n_columns = linear.equations.unknowns.n_columns
        place = np.full(n_columns, -1, dtype=np.intp)
        place[columns] = np.arange(len(columns))
        known = np.zeros(n_columns, dtype=bool)
        known[linear.column] = True
        back = np.full(n_columns, -1, dtype=np.intp)
        back[linear.column] = np.arange(len(linear.column))
        own = np.flatnonzero(known[columns])
        unit = np.zeros((equations.unknowns.n_columns, len(own)))
        unit[back[columns[own]], np.arange(len(own))] = 1.0
        q = np.zeros((len(columns), len(columns)))
        if len(own):
            q[np.ix_(own, own)] = solution.cofactor_times(unit)[back[columns[own]]]
        spread = np.zeros((2, len(failing), len(columns)))
        spread[:, :, own] = np.stack([left, right])[:, :, back[columns[own]]]
        sigmas = solution.observations.sigmas
        watched = Watched(spread[0], spread[1], weight, sigmas[failing], design.reliability.delta0)
        items: list[PointItems | RowItems] = []
        for t in targets:
            if isinstance(t, RowTarget):
                rows = np.flatnonzero(rows_like(solution, t.observations)[failing])
                on = np.zeros(len(names), dtype=bool)
                if isinstance(t, UndetectedShift):
                    on = matching(names, t.points) & (point.offset >= 0)
                items.append(RowItems(t, rows, _places(point.offset[on], place)))
            else:
                # Points that come with candidates are asked for once they are there.
                there = [n in design.network.points for n in names]
                on = matching(names, t.points) & np.array(there, dtype=bool)
                where = np.flatnonzero(on)
                horizon = horizons(network, [names[i] for i in where])
                items.append(PointItems(t, _places(point.offset[where], place), horizon))
        return cls(Covariances(q, watched, items), known, place, candidates, linear)

    def told(self, n: int, known: Mask) -> Told | None:
        """Return what a candidate tells beside what is known."""
        columns = self.linear.rows[n].columns
        key = n, known[columns].tobytes()
        if key not in self._told:
            self._told[key] = told(self.linear.rows[n], self.place, known)
        return self._told[key]

    def take(self, state: Covariances, known: Mask, n: int) -> Mask:
        """Add a candidate; return what is known with it."""
        found = self.told(n, known)
        assert found is not None
        state.add(found)
        out = known.copy()
        out[self.linear.rows[n].columns] = True
        return out

    def best(
        self, state: Covariances, known: Mask, among: Sequence[int], budget: float = np.inf
    ) -> int | None:
        """Return the candidate with the largest gain for its cost; none where none gains."""
        lack = state.lack()
        best, value = None, 0.0
        for n in among:
            if self.costs[n] > budget:
                continue
            found = self.told(n, known)
            if found is None:
                continue
            gain = (lack - state.lack(state.change(found))) / self.costs[n]
            if gain > value * (1 + 1e-12) + MET:
                best, value = n, gain
        return best

    def greedy(
        self, taken: Sequence[int], among: Sequence[int], budget: float = np.inf
    ) -> list[int] | None:
        """Return what completes some candidates; none where nothing does within a budget."""
        state, known = self.start.copy(), self.known
        for n in taken:
            if self.told(n, known) is None:
                return None
            known = self.take(state, known, n)
        left, out = list(among), []
        while state.lack() > MET:
            best = self.best(state, known, left, budget)
            if best is None:
                return None
            n = best
            known = self.take(state, known, n)
            budget -= float(self.costs[n])
            left.remove(n)
            out.append(n)
        return out

    def cheapest(self) -> list[int]:
        """Return candidates that meet the targets, as cheap as found; all that gain if none do."""
        everything = range(len(self.costs))
        chosen = self.greedy((), everything)
        if chosen is None:
            return self._all_that_gain()
        while True:
            better = self._without_superfluous(chosen)
            better = self._exchanged(better)
            if sum(self.costs[better]) >= sum(self.costs[chosen]) - MET and len(better) >= len(
                chosen
            ):
                return better
            chosen = better

    def _all_that_gain(self) -> list[int]:
        state, known = self.start.copy(), self.known
        left, out = list(range(len(self.costs))), []
        while (n := self.best(state, known, left)) is not None:
            known = self.take(state, known, n)
            left.remove(n)
            out.append(n)
        return out

    def _without_superfluous(self, chosen: list[int]) -> list[int]:
        for n in sorted(chosen, key=lambda i: -self.costs[i]):
            rest = [i for i in chosen if i != n]
            if self.greedy(rest, ()) is not None:
                chosen = rest
        return chosen

    def _exchanged(self, chosen: list[int]) -> list[int]:
        """Return a cheaper choice with one or two exchanged, if there is one."""
        pairs = len(chosen) <= MOST_PAIRS and len(self.costs) <= MOST_FOR_PAIRS
        for size in (1, 2) if pairs else (1,):
            for out in combinations(chosen, size):
                rest = [i for i in chosen if i not in out]
                others = [i for i in range(len(self.costs)) if i not in chosen]
                saved = float(self.costs[list(out)].sum()) * (1 - 1e-9)
                found = self.greedy(rest, others, saved)
                if found is not None:
                    return self._without_superfluous([*rest, *found])
        return chosen


def _places(offset: Index, place: Index) -> Index:
    """Return the places of the coordinates of points, −1 where held, (m, 3)."""
    columns = np.where(offset[:, None] >= 0, offset[:, None] + np.arange(3), 0)
    return np.where(offset[:, None] >= 0, place[columns], -1)


def _failing_rows(design: Plan, targets: Sequence[Target]) -> Index:
    """Return the observations that fail a target."""
    out = np.zeros(design.solution.n_observations, dtype=bool)
    for t in targets:
        if isinstance(t, RowTarget):
            rows = np.flatnonzero(rows_like(design.solution, t.observations))
            out[rows[lacking(t, design.figures(t)[1]) > 0]] = True
    return np.flatnonzero(out)


def _watched_rows(design: Plan, a: object, rows: Index) -> tuple[Array, Array, Array]:
    """Return A_i, AᵀPe_i and P_ii of observations, (k, n_columns) twice and (k,)."""
    equations = design.solution.equations
    n = equations.unknowns.n_columns
    left, right = np.zeros((len(rows), n)), np.zeros((len(rows), n))
    weight = np.zeros(len(rows))
    for j, row in enumerate(rows.tolist()):
        at, values = whitened_unit(equations, row)
        part = np.asarray(a[at].todense())  # type: ignore[index]
        right[j] = values @ part
        weight[j] = values @ values
        # A of the observation itself: W⁻¹ of its group's whitened rows.
        whitener = np.stack([_unit(equations, int(i), at) for i in at], axis=1)
        left[j] = np.linalg.solve(whitener, part)[at.tolist().index(row)]
    return left, right, weight


def _unit(equations: object, row: int, at: Index) -> Array:
    """Return the column of a group's whitener that belongs to a row."""
    where, values = whitened_unit(equations, row)  # type: ignore[arg-type]
    out = np.zeros(len(at))
    out[np.searchsorted(at, where)] = values
    return out
