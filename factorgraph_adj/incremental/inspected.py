"""Arriving items inside an adjusted network, or in one that is linearised before it moves."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..graph.variables import calibration_name
from ..quality.leave_out import Tested
from ..solve.factor import Factor
from ..solve.leverage import leverages
from ..solve.linear import LinearSystem
from ..solve.normal import NormalEquations
from ..types import Array, Index, Mask
from .deciding import gain
from .forms import Item, rows_of
from .system import MOVES
from .units import Variable
from .verdicts import Gain

FEW = 300
"""Number of rows up to which all columns of M are solved for at once."""
AT_ONCE = 64
"""Number of rows that are solved for at once beyond that."""


@dataclass(frozen=True, eq=False)
class Inspected:
    """Items and their rows in a factorised network."""

    normal: NormalEquations
    """The normal equations, the items among them."""
    factor: Factor
    """They, factorised."""
    items: tuple[Item, ...]
    """The items."""
    rows: tuple[Index, ...]
    """Rows of each item among those of all items."""
    raw: tuple[Array, ...]
    """L of each item with Σ = L Lᵀ."""
    every: Index
    """Rows of the network, (k,)."""
    a: csr_array
    """Whitened partials, (k, n_columns)."""

    @classmethod
    def of(cls, normal: NormalEquations, factor: Factor, items: Sequence[Item]) -> Inspected:
        """Find the rows of items."""
        found, raw = rows_of(items, normal.system.equations)
        every = np.concatenate([np.zeros(0, dtype=np.intp), *found])
        ends = np.cumsum([len(r) for r in found])
        rows = tuple(np.arange(e - len(r), e) for e, r in zip(ends, found, strict=True))
        a = normal.system.sparse(every)
        return cls(normal, factor, tuple(items), rows, raw, every, a)

    @property
    def system(self) -> LinearSystem:
        """The linearised network."""
        return self.normal.system

    def tested(self, *, moved: bool) -> Tested:
        """Return the items to be tested.

        Args:
            moved: whether the network is at its minimum; otherwise the residuals are those after
                the Gauss-Newton step.
        """
        v = self.system.residual[self.every]
        if not moved:
            v = v - self.a @ self.factor.solve(self.normal.gradient[:, None])[:, 0]
        if len(self.every) <= FEW:
            return Tested(self.rows, v, lambda u: self._whole[:, u])
        return Tested(self.rows, v, self._columns, self._blocks)

    def _columns(self, rows: Index) -> Array:
        """Return M_·u of some rows u, (k, u)."""
        out = np.zeros((len(self.every), len(rows)))
        out[rows, np.arange(len(rows))] = 1.0
        return np.asarray(out - self.a @ self.spread(rows))

    def spread(self, rows: Index) -> Array:
        """Return Q A_uᵀ, (n_columns, u)."""
        if len(self.every) <= FEW:
            return self._spread[:, rows]
        return self.factor.solve(self.a[rows].toarray().T)

    @cached_property
    def _spread(self) -> Array:
        return self.factor.solve(self.a.toarray().T)

    @cached_property
    def _whole(self) -> Array:
        m = np.eye(len(self.every)) - self.a @ self._spread
        return np.asarray(0.5 * (m + m.T))

    @cached_property
    def _blocks(self) -> Array:
        """M_uu of every item, padded, (n, d, d)."""
        most = max(len(r) for r in self.rows)
        out = np.zeros((len(self.items), most, most))
        rays = np.array([i.row >= 0 for i in self.items])
        self._of_rays(np.flatnonzero(rays), out)
        rest = np.flatnonzero(~rays)
        for start in range(0, len(rest), AT_ONCE):
            part = rest[start : start + AT_ONCE]
            rows = np.concatenate([self.rows[i] for i in part.tolist()])
            x = self.a[rows] @ self.spread(rows)
            at = 0
            for i in part.tolist():
                d = len(self.rows[i])
                out[i, :d, :d] = np.eye(d) - x[at : at + d, at : at + d]
                at += d
        return out

    def _of_rays(self, chosen: Index, out: Array) -> None:
        """Write M_uu of image points, from the leverages of all."""
        if not len(chosen):
            return
        first = self.every[[self.rows[i][0] for i in chosen.tolist()]]
        found = leverages(self.system, self.factor, None).blocks
        for block, of_block in zip(self.system.blocks, found, strict=True):
            inside = (first >= block.block.rows.start) & (first < block.block.rows.stop)
            if inside.any():
                number = (first[inside] - block.block.first_row) // 2
                out[chosen[inside], :2, :2] = np.eye(2) - of_block.hat[number]

    # -- what the items determine -------------------------------------------------------------

    def variables(self, i: int) -> tuple[Variable, ...]:
        """Return the variables of an item that have a free component."""
        item = self.items[i]
        if item.unit is not None:
            return item.unit.unknowns
        (o,) = item.observations
        photo, point = o.photo, o.point  # type: ignore[attr-defined]
        lens = calibration_name(self.system.equations.network, photo)
        return ("pose", photo), ("calibration", lens), ("point", point)

    def held_by(self, new: Mapping[Variable, object]) -> Callable[[int, Array], set[Variable]]:
        """Return what says which of new variables combinations of an item's rows determine."""
        unknowns = self.system.unknowns
        weight = np.sqrt(np.where(unknowns.free, self.normal.diagonal, 0.0))

        def found(i: int, combinations: Array) -> set[Variable]:
            motion = self.factor.solve(self.a[self.rows[i]].toarray().T @ combinations)
            far = np.abs(motion).max(axis=1) * weight
            out: set[Variable] = set()
            for kind, name in new:
                number = unknowns[kind].number.get(name)
                if number is not None and (far[unknowns.columns(kind, number)] > MOVES).any():
                    out.add((kind, name))
            return out

        return found

    def gains(self, i: int, m: Array, variance: Callable[[str], Array]) -> tuple[Gain, ...]:
        """Return what an item adds to its points.

        Args:
            i: its number.
            m: M of the item, (d, d).
            variance: returns the variances of the coordinates of a point, (3,).
        """
        unknowns = self.system.unknowns
        out = []
        for name in dict.fromkeys(self.items[i].points):
            number = unknowns["point"].number[name]
            columns = unknowns.columns("point", number)
            if len(columns):
                free: Mask = unknowns.free[columns]
                spread = self.spread(self.rows[i])[columns]
                out.append(gain(name, variance(name), spread, m, free))
        return tuple(out)
