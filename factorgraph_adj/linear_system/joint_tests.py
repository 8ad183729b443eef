"""Joint tests of units as rows beside a base, or as rows of an adjusted network.

`RowsBesideBase` has incoming units beside a base, between known variables or with new ones;
`RowsInBase` has units inside an adjusted network, or in one that is linearised before it moves.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.sparse import csr_array

from ..graph.dependence import Variable
from ..ledger.row_store import Unit
from ..observations import ImagePoint
from ..quality.group_tests import LeaveOneOutTests
from ..solve.factorisation import Factorisation
from ..solve.leverages import leverages
from ..solve.low_rank_update import Update
from ..solve.normal_equations import NormalEquations
from ..solve.solution import Solution
from ..types import Array, Index
from .arrival_decisions import MOTION_SIGMAS, PointCovariance
from .border import WatchedRows
from .front_system import FrontSystem
from .linear_system import LinearForms, rows_of, stacked

MAX_DENSE_ROWS = 300
"""Number of rows up to which all columns of M are computed at once."""
MAX_DENSE_NUMBERS = 3_000_000
"""Largest number of rows times unknowns for which this is done."""
ROWS_PER_SOLUTION = 64
"""Number of rows that are computed at once in larger systems."""


@dataclass(frozen=True, eq=False)
class RowsBesideBase:
    """Units as rows beside a system, as `arrival_decisions.JointTest`."""

    system: FrontSystem
    """The system without them."""
    forms: LinearForms
    """Their linear forms."""
    slots: Mapping[int, int]
    """Slots of the system's points with theirs."""
    update: Update
    """The update with all of them."""

    @classmethod
    def of(cls, system: FrontSystem, forms: LinearForms) -> RowsBesideBase | None:
        """Put forms beside a system; None where a new base has to take them in."""
        own = forms.columns[forms.columns < system.unknowns.n_columns]
        slots = system.lifted.with_slots(own, system.slots)
        too_many = len(system.update.signs) + len(forms.v) > system.most_beside
        if too_many or not system.has_room(slots):
            return None
        f = replace(system, slots=slots).expand(forms.columns, forms.a)
        update = system.update.with_rows(f.at, f.b, forms.residuals)
        return cls(system, forms, slots, update) if update.trusted else None

    def some(self, chosen: Sequence[int]) -> RowsBesideBase | None:
        """Return some of the units beside the system."""
        if len(chosen) == len(self.units):
            return self
        return RowsBesideBase.of(self.system, self.forms.some(chosen))

    @cached_property
    def after(self) -> FrontSystem:
        """The system with the units."""
        before = len(self.system.update.signs)
        new = {
            unit.ids[0]: before + own for unit, own in zip(self.units, self.forms.rows, strict=True)
        }
        joined = {**self.system.joined, **new}
        system = replace(self.system, update=self.update, joined=joined, slots=self.slots)
        if not system.border.unknowns:
            return system
        watched = WatchedRows.of(self.forms, system.border, system.unknowns.n_columns)
        return replace(system, border=system.border.watching(watched))

    @property
    def units(self) -> tuple[Unit, ...]:
        """The units."""
        return self.forms.units

    @property
    def raw(self) -> tuple[Array, ...]:
        """L of each unit with Σ = L Lᵀ."""
        return self.forms.raw

    def tested(self) -> LeaveOneOutTests:
        """Return the tests of the units against everything else."""
        new = len(self.system.update.signs) + np.arange(len(self.forms.v))
        inverse = self.update.inverse
        m = inverse[np.ix_(new, new)]
        return LeaveOneOutTests(
            self.forms.rows, inverse[new] @ self.update.residuals, lambda u: m[:, u]
        )

    def renewed(self) -> RowsBesideBase:
        """Return the units: their linear forms stay."""
        return self

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns with the rows of a unit, (m, d)."""
        rows: Index = len(self.system.update.signs) + self.forms.rows[i]
        f = self.after.expand(columns, np.eye(len(columns)))
        return self.update.gain(f.at, f.b)[:, rows]

    def place(self, name: str) -> PointCovariance:
        """Return a point with all units in."""
        point: Variable = ("point", name)
        columns = self.after.columns(*point)
        variance = np.diag(self.after.cofactors(point, point)) if len(columns) else np.zeros(0)
        return PointCovariance(columns, self.after.free(columns), variance)

    def held_by(self, i: int, combinations: Array, new: Collection[Variable]) -> set[Variable]:
        """Return those of new variables that combinations (d, n) of a unit's rows determine.

        Variables that were known stay known without them.
        """
        system, rows = self.system, len(self.system.update.signs) + self.forms.rows[i]
        out: set[Variable] = set()
        for variable in set(new) & system.border.unknowns.keys():
            columns = system.border.unknowns[variable].columns
            place = system.border.place[columns]
            place = place[place >= 0]
            motion = self.update.parts.k[np.ix_(place, rows)] @ combinations
            weight = np.linalg.norm(self.update.border[:, place], axis=0)
            if (np.abs(motion).max(axis=1) * weight > MOTION_SIGMAS).any():
                out.add(variable)
        return out


@dataclass(frozen=True, eq=False)
class RowsInBase:
    """Units and their rows in a factorised network, as `arrival_decisions.JointTest`."""

    normal: NormalEquations
    """The normal equations, the units among them."""
    factor: Factorisation
    """These, factorised."""
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
        factor: Factorisation,
        units: Sequence[Unit],
        base: Solution | None = None,
    ) -> RowsInBase:
        """Find the rows of units."""
        found, raw = rows_of(units, normal.system.equations)
        rows, every = stacked(found)
        a = normal.system.sparse(every)
        return cls(normal, factor, base, tuple(units), rows, raw, every, a)

    @classmethod
    def of_system(cls, system: FrontSystem, units: Sequence[Unit]) -> RowsInBase:
        """Find the rows of units in the base of a system."""
        base = system.base
        return cls.of(base.normal(), base.factor, units, base)

    def tested(self) -> LeaveOneOutTests:
        """Return the tests of the units, with residuals after a remaining Gauss-Newton step."""
        v = self.normal.system.residual[self.every]
        if self.base is None:
            v = v - self.a @ self.factor.solve(self.normal.gradient[:, None])[:, 0]
        if self._few:
            return LeaveOneOutTests(self.rows, v, lambda u: self._m[:, u])
        return LeaveOneOutTests(self.rows, v, self._columns, self._blocks)

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
        return (
            len(self.every) <= MAX_DENSE_ROWS
            and self.a.shape[0] * self.a.shape[1] <= MAX_DENSE_NUMBERS
        )

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
        for start in range(0, len(rest), ROWS_PER_SOLUTION):
            part = rest[start : start + ROWS_PER_SOLUTION].tolist()
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

    def renewed(self) -> RowsInBase:
        """Return the units: their linear forms stay."""
        return self

    def spread(self, i: int, columns: Index) -> Array:
        """Return Q Aᵀ of columns with the rows of a unit, (m, d)."""
        return np.asarray(self._solved(self.rows[i])[columns])

    def place(self, name: str) -> PointCovariance:
        """Return a point at the minimum."""
        assert self.base is not None
        unknowns = self.normal.system.unknowns
        columns = unknowns.columns("point", unknowns["point"].number[name])
        variance = np.diag(self.base.covariance(name))
        return PointCovariance(columns, unknowns.free[columns], variance)

    def held_by(self, i: int, combinations: Array, new: Collection[Variable]) -> set[Variable]:
        """Return those of new variables that combinations (d, n) of a unit's rows determine."""
        unknowns = self.normal.system.unknowns
        weight = np.sqrt(np.where(unknowns.free, self.normal.diagonal, 0.0))
        motion = self.factor.solve(self.a[self.rows[i]].toarray().T @ combinations)
        far = np.abs(motion).max(axis=1) * weight
        out: set[Variable] = set()
        for kind, name in new:
            number = unknowns[kind].number.get(name)
            if number is not None and (far[unknowns.columns(kind, number)] > MOTION_SIGMAS).any():
                out.add((kind, name))
        return out
