"""Search for the cheapest candidates: gain per cost, from covariances updated by their rows.

Q are the cofactors of those unknowns that the rows touch. `Update` of
`factorgraph_adj.solve.low_rank_update` gives the changes by the rows. With the loss Q − Q' of
cofactors,

    r' = r + l (Q − Q') a                   redundancy number of an observation i, a = AᵀPe_i
    ∇x = Q' a ∇',  ∇' = δ0 / √(P_ii − aᵀQ'a)

so that the normal equations are not solved again. New unknowns x_c have no covariance before their
rows [B, C] are added, with the partials C by the new and B by the other unknowns x. With ZᵀC = 0,
ZᵀB is the information of the rows on x, and x_c = −(CᵀC)⁻¹Cᵀ B x.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TypeAlias

import numpy as np

from ..quality.error_effects import whitened_unit_error
from ..solve.low_rank_update import Update
from ..types import Array, Index, Mask
from .candidates import (
    Candidate,
    CandidateRows,
    LinearCandidates,
    linearise,
    partials,
    with_candidates,
)
from .plan import DisplacementItems, Plan, displacement_items, horizons, rows_like
from .targets import (
    MET,
    DetectableDisplacement,
    DetectableError,
    PointTarget,
    RedundancyNumber,
    RowTarget,
    Target,
    UndetectedShift,
    lacking,
    matching,
    point_figures,
)

TIED = 1e-9
"""Singular value of the partials by new unknowns, relative to the largest, up to which a new
unknown is undetermined."""
MAX_CHOSEN_OF_PAIRS = 12
"""Largest number of chosen candidates for which the exchange of pairs is tried."""
MAX_AVAILABLE_OF_PAIRS = 60
"""Largest number of available candidates for which the exchange of pairs is tried."""


@dataclass(frozen=True, eq=False)
class Watched:
    """The k observations whose redundancy number or effect a target limits."""

    left: Array
    """Rows of A, (k, n)."""
    right: Array
    """AᵀPe_i, (k, n)."""
    weight: Array
    """Weights P_ii, (k,)."""
    sigma: Array
    """Standard deviations, (k,)."""
    delta0: float
    """δ0 of the smallest detectable error."""


@dataclass(frozen=True, eq=False)
class PointItems:
    """The m points to which a target applies."""

    target: PointTarget
    """The target."""
    places: Index
    """Places of the coordinates in Q, −1 for held coordinates, (m, 3)."""
    horizon: Array
    """Unit vectors east and north at each point, (m, 2, 3)."""


@dataclass(frozen=True, eq=False)
class RowItems:
    """The m observations to which a target applies."""

    target: RowTarget
    """The target."""
    rows: Index
    """Numbers of the observations among the watched ones, (m,)."""
    places: Index
    """Places in Q of the points whose shifts count, −1 for held coordinates, (p, 3)."""


@dataclass(frozen=True, eq=False)
class JointItems:
    """The points of a target of displacements, whose figures depend on all their covariances."""

    moved: DisplacementItems
    """Points and reference points."""
    places: Index
    """Places of their coordinates in Q, (n,)."""

    @property
    def target(self) -> DetectableDisplacement:
        """The target."""
        return self.moved.target


Items: TypeAlias = PointItems | RowItems | JointItems


class Covariances:
    """Q of chosen unknowns, and the lack of the targets."""

    def __init__(self, q: Array, watched: Watched, items: Sequence[Items]) -> None:
        """Start with the cofactors of a design.

        Args:
            q: cofactors, (n, n); zero in the rows and columns of unknowns that are added later.
            watched: observations that targets limit.
            items: points and observations of the targets.
        """
        self.q, self.watched, self.items = q, watched, items
        self.refresh()

    def copy(self) -> Covariances:
        """Return a copy with its own Q; observations and items are shared."""
        return Covariances(self.q.copy(), self.watched, self.items)

    def refresh(self) -> None:
        """Compute the quantities that depend on Q."""
        w = self.watched
        qa = w.right @ self.q
        self.r = 1.0 - np.einsum("kn,kn->k", w.left, qa)
        self.precision = w.weight - np.einsum("kn,kn->k", w.right, qa)
        self._qa = np.concatenate([qa, np.zeros((len(qa), 1))], axis=1)
        self._blocks = [
            self._block(i.places) if isinstance(i, PointItems) else None for i in self.items
        ]

    def _block(self, places: Index) -> Array:
        padded = np.pad(self.q, (0, 1))
        return padded[places[:, :, None], places[:, None, :]]

    def lack(self, update: Update | None = None) -> float:
        """Return the total lack of all targets, after the update if one is given."""
        total = 0.0
        for n, item in enumerate(self.items):
            total += float(lacking(item.target, self._figures(n, item, update)).sum())
        return total

    def _figures(self, n: int, item: Items, update: Update | None) -> Array:
        if isinstance(item, PointItems):
            blocks = self._blocks[n]
            assert blocks is not None
            if update is not None:
                blocks = blocks - update.loss(_spread_to(update, item.places))
            return point_figures(item.target, blocks, item.horizon)
        if isinstance(item, JointItems):
            q = self.q[np.ix_(item.places, item.places)]
            if update is not None:
                q = q - update.loss(update.spread[item.places])
            return item.moved.figures(q)
        w, rows = self.watched, item.rows
        r, precision, qa = self.r[rows], self.precision[rows], self._qa[rows]
        if update is not None:
            left, right = w.left[rows] @ update.spread, w.right[rows] @ update.spread
            r = r + update.losses(left, right)
            precision = precision + update.losses(right)
        if isinstance(item.target, RedundancyNumber):
            return np.asarray(r)
        controlled = precision > 1e-6 * w.weight[rows]
        mdb = np.full(len(rows), np.inf)
        mdb[controlled] = w.delta0 / np.sqrt(precision[controlled])
        if isinstance(item.target, DetectableError):
            return np.asarray(mdb / w.sigma[rows])
        moved = qa[:, item.places]
        if update is not None:
            lost = update.loss(_spread_to(update, item.places), right)
            moved = moved - lost.transpose(2, 0, 1)
        far = np.sqrt(np.sum(moved**2, axis=2)).max(axis=1, initial=0.0)
        return np.asarray(np.where(controlled, far * np.where(controlled, mdb, 1.0), np.inf))

    def update(self, known: Told) -> Update:
        """Return the update of Q by rows."""
        return Update.of(self.q).with_rows(known.at, known.b)

    def add(self, known: Told) -> None:
        """Add rows and their new unknowns."""
        update = self.update(known)
        self.q -= update.loss(update.spread)
        if len(known.new):
            k = known.carry
            cross = k @ self.q[known.old]
            self.q[known.new] = cross
            self.q[:, known.new] = cross.T
            own = known.own + k @ cross[:, known.old].T
            self.q[np.ix_(known.new, known.new)] = 0.5 * (own + own.T)
        self.refresh()


def _spread_to(update: Update, places: Index) -> Array:
    """Return the spread G of coordinates, zero for held coordinates (−1), (..., k)."""
    padded = np.concatenate([update.spread, np.zeros((1, update.spread.shape[1]))])
    return np.asarray(padded[places])


@dataclass(frozen=True, eq=False)
class Told:
    """Information of the rows of a candidate on known unknowns and on new ones."""

    at: Index
    """Places of the unknowns that B touches, (m,)."""
    b: Array
    """Partials B by known unknowns, (k, m)."""
    new: Index
    """Places of the new unknowns, (c,)."""
    old: Index
    """Places of the known unknowns in the rows of C, (m,)."""
    carry: Array
    """Matrix K of x_c = K x, (c, m)."""
    own: Array
    """Cofactors (CᵀC)⁻¹ of the new unknowns for held known unknowns, (c, c)."""


def told(rows: CandidateRows, place: Index, known: Mask) -> Told | None:
    """Return the information of rows; None if the rows leave a new unknown undetermined.

    Args:
        rows: rows of a candidate.
        place: place of each column in Q, (n_columns,).
        known: columns whose unknowns are determined so far, (n_columns,).
    """
    new = ~known[rows.columns]
    old = place[rows.columns[~new]]
    b = rows.a[:, ~new]
    nothing = np.zeros(0, dtype=np.intp)
    if not new.any():
        return Told(old, b, nothing, old, np.zeros((0, len(old))), np.zeros((0, 0)))
    c = rows.a[:, new]
    scale = np.linalg.norm(c, axis=0)
    if len(c) < c.shape[1] or not scale.all():
        return None
    u, s, vt = np.linalg.svd(c / scale, full_matrices=True)
    k = c.shape[1]
    if s[-1] <= TIED * s[0]:
        return None
    inverse = (vt.T / s) / scale[:, None]
    carry = -(inverse @ u[:, :k].T) @ b
    return Told(old, u[:, k:].T @ b, place[rows.columns[new]], old, carry, inverse @ inverse.T)


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
