"""Gains of many candidates at once, by updates of the cofactors of the target's functions.

With functions F of the unknowns on which a target depends, and the rows A of a candidate,

    F Q′ Fᵀ = F Q Fᵀ − N D⁻¹ Nᵀ,   N = F Q Aᵀ,   D = I + A Q Aᵀ.

One solution of the system gives Q Fᵀ, and with it N of all candidates. D takes the columns of Q for
the stations of the sights, and the blocks of the points at their ends. Where there are too many
stations, only promising candidates are solved for: as the joint cofactors of F and A are
nonnegative definite, D ⪰ I + Nᵀ (F Q Fᵀ)⁻¹ N, from which follows the largest gain that a candidate
may have. Those that cannot be among the best are left out, and the answer is the same.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..linear_system.cofactor_columns import CofactorColumns
from ..types import Array, Index
from .possible_sights import POINT, PossibleSights
from .target_functions import TargetFunctions, TargetItem, gains, lack_of
from .targets import MET

MAX_HUB_COLUMNS = 400
"""Largest number of columns of stations for which all of them are solved for."""
SOLVED_TOGETHER = 32
"""Number of promising candidates that are solved for first; then twice as many each time."""


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
            n
            for n, (i, f) in enumerate(zip(functions.items, self.before, strict=True))
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
        first, number = 0, SOLVED_TOGETHER
        while first < s.n:
            some = order[first : first + number]
            least = np.partition(out / cost, -most)[-most] if most <= s.n else -np.inf
            if bound[some[0]] / cost[some[0]] <= least or (bound[order[first:]] <= MET).all():
                break
            for own, g in zip(d, self.of, strict=True):
                own[some] = solved_d(g.of.cofactors, s.a[some], s.columns[some])
            out[some] = self._sum(some, d)
            first, number = first + number, 2 * number
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
