"""Choice among candidates by their gain per cost, from updated covariances."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np

from ..quality.error_effects import whitened_unit_error
from ..types import Array, Index, Mask
from .candidates import Candidate, LinearCandidates, linearise, partials, with_candidates
from .covariances import Covariances, Items, JointItems, PointItems, RowItems, Told, Watched, told
from .plan import Plan, displacement_items, horizons, rows_like
from .targets import (
    MET,
    DetectableDisplacement,
    RowTarget,
    Target,
    UndetectedShift,
    lacking,
    matching,
)

MAX_CHOSEN_OF_PAIRS = 12
"""Largest number of chosen candidates for which the exchange of pairs is tried."""
MAX_AVAILABLE_OF_PAIRS = 60
"""Largest number of available candidates for which the exchange of pairs is tried."""


class CandidateSearch:
    """Search for the cheapest candidates that meet the targets."""

    def __init__(
        self,
        start: Covariances,
        known: Mask,
        place: Index,
        candidates: Sequence[Candidate],
        linear: LinearCandidates,
    ) -> None:
        self.start, self.known, self.place = start, known, place
        self.costs = np.array([c.cost for c in candidates])
        self.linear = linear
        self._told: dict[tuple[int, bytes], Told | None] = {}

    @classmethod
    def of(
        cls,
        design: Plan,
        candidates: Sequence[Candidate],
        targets: Sequence[Target],
        watched: Collection[str] = (),
    ) -> CandidateSearch:
        """Start with Q of a design for all unknowns of its candidates and targets.

        Args:
            design: plan of the design.
            candidates: the candidates to choose from.
            targets: targets of the design.
            watched: labels of observations that are included although they meet their targets;
                failing observations are always included.
        """
        solution = design.solution
        equations = solution.equations
        network = with_candidates(design.network, candidates)
        linear = linearise(equations, network, candidates)
        point = linear.equations.unknowns["point"]
        names = list(point.names)
        wanted = [np.zeros(0, dtype=np.intp)]
        wanted += [r.columns for r in linear.rows]
        failing = _failing_rows(design, targets, watched)
        a = partials(solution.normal().system)
        left, right, weight = _watched_rows(design, a, failing)
        for matrix in (left, right):
            wanted.append(linear.column[np.flatnonzero(np.abs(matrix).sum(axis=0))])
        joint = {
            t: displacement_items(solution, t)
            for t in targets
            if isinstance(t, DetectableDisplacement)
        }
        wanted += [linear.column[found.columns] for found in joint.values()]
        for t in targets:
            if t not in joint and (not isinstance(t, RowTarget) or isinstance(t, UndetectedShift)):
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
        rows_watched = Watched(
            spread[0], spread[1], weight, sigmas[failing], design.reliability.delta0
        )
        items: list[Items] = []
        for t in targets:
            if isinstance(t, RowTarget):
                rows = np.flatnonzero(rows_like(solution, t.observations)[failing])
                on = np.zeros(len(names), dtype=bool)
                if isinstance(t, UndetectedShift):
                    on = matching(names, t.points) & (point.offset >= 0)
                items.append(RowItems(t, rows, _places(point.offset[on], place)))
            elif isinstance(t, DetectableDisplacement):
                items.append(JointItems(joint[t], place[linear.column[joint[t].columns]]))
            else:
                # Points of candidates are subject to targets once they are in the design.
                there = [n in design.network.points for n in names]
                on = matching(names, t.points) & np.array(there, dtype=bool)
                where = np.flatnonzero(on)
                horizon = horizons(network, [names[i] for i in where])
                items.append(PointItems(t, _places(point.offset[where], place), horizon))
        return cls(Covariances(q, rows_watched, items), known, place, candidates, linear)

    def told(self, n: int, known: Mask) -> Told | None:
        """Return the information of a candidate, given the known unknowns."""
        columns = self.linear.rows[n].columns
        key = n, known[columns].tobytes()
        if key not in self._told:
            self._told[key] = told(self.linear.rows[n], self.place, known)
        return self._told[key]

    def take(self, state: Covariances, known: Mask, n: int) -> Mask:
        """Add a candidate; return the mask of known unknowns with it."""
        found = self.told(n, known)
        assert found is not None
        state.add(found)
        out = known.copy()
        out[self.linear.rows[n].columns] = True
        return out

    def best(
        self, state: Covariances, known: Mask, among: Sequence[int], budget: float = np.inf
    ) -> int | None:
        """Return the candidate with the largest gain per cost; None if no candidate gains."""
        lack = state.lack()
        best, value = None, 0.0
        for n in among:
            if self.costs[n] > budget:
                continue
            found = self.told(n, known)
            if found is None:
                continue
            gain = lack - state.lack(state.update(found))
            # Costs have an arbitrary unit, so the threshold is on the gain alone.
            if gain > MET and gain / self.costs[n] > value * (1 + 1e-12):
                best, value = n, gain / self.costs[n]
        return best

    def greedy(
        self, taken: Sequence[int], among: Sequence[int], budget: float = np.inf
    ) -> list[int] | None:
        """Return candidates that complete those taken; None if no choice fits the budget."""
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
        """Return the cheapest choice found that meets the targets, or else all that gain."""
        everything = range(len(self.costs))
        chosen = self.greedy((), everything)
        if chosen is None:
            return self._all_that_gain()
        while True:
            better = self._without_superfluous(chosen)
            better = self._exchanged(better)
            no_cheaper = sum(self.costs[better]) >= sum(self.costs[chosen]) * (1 - 1e-9)
            if no_cheaper and len(better) >= len(chosen):
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
        """Return a cheaper choice with one or two candidates exchanged, or else ``chosen``."""
        pairs = len(chosen) <= MAX_CHOSEN_OF_PAIRS and len(self.costs) <= MAX_AVAILABLE_OF_PAIRS
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
    """Return the places of the coordinates of points, −1 for held coordinates, (m, 3)."""
    columns = np.where(offset[:, None] >= 0, offset[:, None] + np.arange(3), 0)
    return np.where(offset[:, None] >= 0, place[columns], -1)


def _failing_rows(design: Plan, targets: Sequence[Target], watched: Collection[str] = ()) -> Index:
    """Return the rows of observations that fail a target or are watched."""
    out = np.zeros(design.solution.n_observations, dtype=bool)
    for t in targets:
        if isinstance(t, RowTarget):
            rows = np.flatnonzero(rows_like(design.solution, t.observations))
            out[rows[lacking(t, design.figures(t)[1]) > 0]] = True
    if watched:
        label = design.solution.equations.label
        out |= np.array([label(i) in watched for i in range(len(out))], dtype=bool)
    return np.flatnonzero(out)


def _watched_rows(design: Plan, a: object, rows: Index) -> tuple[Array, Array, Array]:
    """Return A_i, AᵀPe_i and P_ii of observations, (k, n_columns) twice and (k,)."""
    equations = design.solution.equations
    n = equations.unknowns.n_columns
    left, right = np.zeros((len(rows), n)), np.zeros((len(rows), n))
    weight = np.zeros(len(rows))
    for j, row in enumerate(rows.tolist()):
        at, values = whitened_unit_error(equations, row)
        part = np.asarray(a[at].todense())  # type: ignore[index]
        right[j] = values @ part
        weight[j] = values @ values
        # The row of A of the observation itself is W⁻¹ times the whitened rows of its group. The
        # columns of W are those of its members, in the order of the group, which need not be that
        # of the rows.
        whitener = np.stack([whitened_unit_error(equations, i)[1] for i in at.tolist()], axis=1)
        left[j] = np.linalg.solve(whitener, part)[at.tolist().index(row)]
    return left, right, weight
