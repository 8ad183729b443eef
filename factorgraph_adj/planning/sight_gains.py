"""Gains of many candidates at once, by updates of the cofactors of the target's functions.

With functions F of the unknowns on which a target depends, and the rows A of a candidate,

    F Q′ Fᵀ = F Q Fᵀ − N D⁻¹ Nᵀ,   N = F Q Aᵀ,   D = I + A Q Aᵀ.

One solution of the system gives Q Fᵀ, and with it N of all candidates. As the joint cofactors of F
and A are nonnegative definite, D ⪰ I + Nᵀ (F Q Fᵀ)⁻¹ N, from which follows the largest gain that a
candidate may have. The most promising candidates are solved for, with rows at the present
estimates, until the others cannot be among the best: the answer is that of an examination of all.
Where the first do not suffice, D of the others takes the columns of Q for the stations of the
sights, and the blocks of the points at their ends; where these columns are many, only after as many
have been solved for. Of sights that end at no point it takes the columns of all their unknowns.

Solutions come in slices of bounded size, each of which is reduced to D at once, and after each the
candidates that may still be among the best are chosen anew.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import InputError
from ..linear_system.cofactor_columns import CofactorColumns
from ..types import Array, Index
from .sight_rows import POINT, PossibleSights
from .target_functions import TargetFunctions, TargetItem, gains, lack_of
from .targets import MET

MAX_PRODUCT_BYTES = 2 * 1024**3
"""Largest memory of the products of all sights with all functions of the targets, bytes."""
MAX_HUB_COLUMNS = 400
"""Largest number of columns of stations that are solved for right after the first candidates; more
of them only when as many columns have been solved for by candidates."""
SOLVED_TOGETHER = 16
"""Number of promising candidates that are solved for first; then twice as many each time."""
MAX_SLICE_BYTES = 2**24
"""Largest size of the right-hand sides that are solved for at once, bytes (16 MiB, but at least the
rows of one candidate): with their solution and what the solver keeps beside it, some 64 MiB."""


def columns_at_once(n: int) -> int:
    """Return how many dense columns of n unknowns a slice has."""
    return max(MAX_SLICE_BYTES // (8 * max(n, 1)), 1)


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

        Raises:
            InputError: the products of sights and functions need more than `MAX_PRODUCT_BYTES`.
        """
        functions, rows = sum(len(g.b) for g in of), sights.n * sights.a.shape[1]
        if (wanted := 8 * functions * rows) > MAX_PRODUCT_BYTES:
            what = f"{sights.n} sights for {functions // POINT} points take {wanted >> 20} MiB"
            raise InputError(
                f"{what}, more than {MAX_PRODUCT_BYTES >> 20}: name fewer points, or limit "
                "`stations`, `to` or `reach`"
            )
        self.sights, self.names, self.of = sights, names, of
        self.along = [g.along(sights.a, sights.columns) for g in of]

    def gains(self, most: int, cost: Array) -> tuple[Array, list[Array]]:
        """Return the gains (m,), −∞ where they cannot be among the best, and D of each function.

        Args:
            most: number of the best by gain and cost.
            cost: cost of each candidate, (m,).
        """
        s = self.sights
        bound = sum((g.most(n) for g, n in zip(self.of, self.along, strict=True)), np.zeros(s.n))
        bound = bound * (1.0 + s.uncertain)
        out = np.full(s.n, -np.inf)
        size = s.a.shape[1]
        d = [np.broadcast_to(np.eye(size), (s.n, size, size)).copy() for _ in self.of]
        rest = np.argsort(-bound / cost, kind="stable")
        number, solved, begun = SOLVED_TOGETHER, 0, False
        largest = max((g.of.cofactors.size for g in self.of), default=0)
        while len(rest):
            least = np.partition(out / cost, -most)[-most] if most <= s.n else -np.inf
            rest = rest[(bound[rest] / cost[rest] > least) & (bound[rest] > MET)]
            if not len(rest):
                break
            hubs = self._few_hubs(rest, solved) if begun else None
            number = min(number, max(columns_at_once(largest) // size, 1))
            some = rest[:number] if hubs is None else rest
            a, columns = s.rows(some)
            found: dict[int, Array] = {}
            for own, along, g in zip(d, self.along, self.of, strict=True):
                q = g.of.cofactors
                if id(q) not in found:
                    known = None if hubs is None else self._known_d(q, hubs, a, columns, some)
                    found[id(q)] = solved_d(q, a, columns) if known is None else known
                own[some], along[some] = found[id(q)], g.along(a, columns)
            out[some] = self._sum(some, d)
            rest, begun = rest[len(some) :], True
            number, solved = 2 * number, solved + size * len(some)
        return out, d

    def _leaf(self, some: Index) -> int:
        """Return the number of columns of the points at which sights end; 0: not all end at one."""
        return POINT if bool((self.sights.points[some] >= 0).all()) else 0

    def _few_hubs(self, some: Index, solved: int) -> Index | None:
        """Return the columns of the stations of some sights; None: they are too many.

        Args:
            some: the sights.
            solved: number of columns that have been solved for.
        """
        columns = self.sights.columns[some]
        hubs = columns[:, : columns.shape[1] - self._leaf(some)]
        on = np.zeros(int(hubs.max(initial=-1)) + 1, dtype=bool)
        on[hubs[hubs >= 0]] = True
        found = np.flatnonzero(on)
        return found if len(found) <= max(MAX_HUB_COLUMNS, solved) else None

    def _known_d(
        self, cofactors: CofactorColumns, hubs: Index, a: Array, columns: Index, some: Index
    ) -> Array:
        """Return D of some sights from the columns of stations and the blocks of points.

        With rows A = (A_h, A_p) of the stations and the point at the end,
        A Q Aᵀ = A_p Q_pp A_pᵀ + sym((A_h Q_hh + 2 A_p Q_ph) A_hᵀ), column by column of Q.
        """
        m, size, width = a.shape
        hub_width = width - self._leaf(some)
        leaf = a[:, :, hub_width:]
        d = np.zeros((m, size, size))
        if hub_width < width:
            points = self.sights.points[some]
            used = np.unique(points)
            blocks = np.zeros((int(used.max(initial=0)) + 1, POINT, POINT))
            blocks[used] = cofactors.point_blocks([self.names[i] for i in used.tolist()])
            d += leaf @ blocks[points] @ leaf.transpose(0, 2, 1)
        own = np.where((columns >= 0)[:, None, :], a, 0.0)
        weighted = np.concatenate([own[:, :, :hub_width], 2.0 * own[:, :, hub_width:]], axis=2)
        place = np.full(cofactors.size + 1, -1, dtype=np.intp)
        step = columns_at_once(cofactors.size)
        for first in range(0, len(hubs), step):
            part = hubs[first : first + step]
            unit = np.zeros((cofactors.size, len(part)))
            unit[part, np.arange(len(part))] = 1.0
            q = cofactors.times(unit)
            place[part] = np.arange(len(part))
            for j in range(hub_width):
                at = place[columns[:, j]]
                on = np.flatnonzero(at >= 0)
                x = weighted[on] @ q[columns[on], at[on, None]][:, :, None]
                d[on] += x * own[on, None, :, j]
            place[part] = -1
        return np.eye(size) + 0.5 * (d + d.transpose(0, 2, 1))

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
