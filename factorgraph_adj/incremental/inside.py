"""Arriving units inside an adjusted network, or in one that is linearised before it moves."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..graph.dependence import Variable
from ..observations import ImagePoint
from ..quality.leave_out import Tested
from ..solve.factor import Factor
from ..solve.leverage import leverages
from ..solve.normal import NormalEquations
from ..solve.solution import Solution
from ..types import Array, Index
from .forms import rows_of, stacked
from .judging import MOVES, Place
from .units import Unit

FEW = 300
"""Number of rows up to which all columns of M are solved for at once."""
MOST_NUMBERS = 3_000_000
"""Largest number of rows times unknowns for which this is done."""
AT_ONCE = 64
"""Number of rows that are solved for at once beyond that."""


@dataclass(frozen=True, eq=False)
class Inside:
    """Units and their rows in a factorised network, as `judging.Joint`."""

    normal: NormalEquations
    """The normal equations, the units among them."""
    factor: Factor
    """They, factorised."""
    base: Solution | None
    """The solution, if the network is at its minimum."""
    units: tuple[Unit, ...]
    """The units."""
    rows: tuple[Index, ...]
    """Rows of each unit among those of all units."""
    raw: tuple[Array, ...]
    """L of each unit with Σ = L Lᵀ."""
    every: Index
    """Rows of the network, (k,)."""
    a: csr_array
    """Whitened partials, (k, n_columns)."""

    @classmethod
    def of(
        cls,
        normal: NormalEquations,
        factor: Factor,
        units: Sequence[Unit],
        base: Solution | None = None,
    ) -> Inside:
        """Find the rows of units."""
        found, raw = rows_of(units, normal.system.equations)
        rows, every = stacked(found)
        a = normal.system.sparse(every)
        return cls(normal, factor, base, tuple(units), rows, raw, every, a)

    def tested(self) -> Tested:
        """Return the units; residuals are those after the Gauss-Newton step, if any is left."""
        v = self.normal.system.residual[self.every]
        if self.base is None:
            v = v - self.a @ self.factor.solve(self.normal.gradient[:, None])[:, 0]
        if self._few:
            return Tested(self.rows, v, lambda u: self._m[:, u])
        return Tested(self.rows, v, self._columns, self._blocks)

    def _columns(self, rows: Index) -> Array:
        """Return M_·u of some rows u, (k, u)."""
        out = np.zeros((len(self.every), len(rows)))
        out[rows, np.arange(len(rows))] = 1.0
        return np.asarray(out - self.a @ self._solved(rows))

    def _solved(self, rows: Index) -> Array:
        """Return Q A_uᵀ, (n_columns, u)."""
        if self._few:
            return self._spread[:, rows]
        return self.factor.solve(self.a[rows].toarray().T)

    @property
    def _few(self) -> bool:
        """Whether all columns of M are solved for at once."""
        return len(self.every) <= FEW and self.a.shape[0] * self.a.shape[1] <= MOST_NUMBERS

    @cached_property
    def _spread(self) -> Array:
        return self.factor.solve(self.a.toarray().T)

    @cached_property
    def _m(self) -> Array:
        m = np.eye(len(self.every)) - self.a @ self._spread
        return np.asarray(0.5 * (m + m.T))

    @cached_property
    def _blocks(self) -> Array:
        """M_uu of every unit, padded, (n, d, d)."""
        most = max(len(r) for r in self.rows)
        out = np.zeros((len(self.units), most, most))
        rays = np.array([isinstance(u.observations[0], ImagePoint) for u in self.units])
        self._of_rays(np.flatnonzero(rays), out)
        rest = np.flatnonzero(~rays)
        for start in range(0, len(rest), AT_ONCE):
            part = rest[start : start + AT_ONCE].tolist()
            own, rows = stacked([self.rows[i] for i in part])
            x = self.a[rows] @ self._solved(rows)
            for i, at in zip(part, own, strict=True):
                out[i, : len(at), : len(at)] = np.eye(len(at)) - x[np.ix_(at, at)]
        return out

    def _of_rays(self, chosen: Index, out: Array) -> None:
        """Write M_uu of image points, from the leverages of all."""
        if not len(chosen):
            return
        first = self.every[[self.rows[i][0] for i in chosen.tolist()]]
        system = self.normal.system
        found = leverages(system, self.factor, None).blocks
        for block, of_block in zip(system.blocks, found, strict=True):
            inside = (first >= block.block.rows.start) & (first < block.block.rows.stop)
            if inside.any():
                number = (first[inside] - block.block.first_row) // 2
                out[chosen[inside], :2, :2] = np.eye(2) - of_block.hat[number]

    # -- unknowns -----------------------------------------------------------------------------

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns with the rows of a unit, (m, d)."""
        return np.asarray(self._solved(self.rows[i])[columns])

    def place(self, name: str) -> Place:
        """Return a point at the minimum."""
        assert self.base is not None
        unknowns = self.normal.system.unknowns
        columns = unknowns.columns("point", unknowns["point"].number[name])
        variance = np.diag(self.base.covariance(name))
        return Place(columns, unknowns.free[columns], variance)

    def held_by(self, i: int, combinations: Array, new: Collection[Variable]) -> set[Variable]:
        """Return which of new variables combinations (d, n) of a unit's rows determine."""
        unknowns = self.normal.system.unknowns
        weight = np.sqrt(np.where(unknowns.free, self.normal.diagonal, 0.0))
        motion = self.factor.solve(self.a[self.rows[i]].toarray().T @ combinations)
        far = np.abs(motion).max(axis=1) * weight
        out: set[Variable] = set()
        for kind, name in new:
            number = unknowns[kind].number.get(name)
            if number is not None and (far[unknowns.columns(kind, number)] > MOVES).any():
                out.add((kind, name))
        return out
