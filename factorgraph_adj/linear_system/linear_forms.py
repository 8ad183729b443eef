"""Linear forms of observations: whitened residuals and partials by the unknowns of a base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..ledger.row_store import Unit
from ..models.variables import VariableKind
from ..observations import ImagePoint
from ..solve.feasible_states import state_off_lines
from ..solve.linearised_equations import LinearisedEquations
from ..types import NO_ROWS, Array, Index


@dataclass(frozen=True, eq=False)
class LinearForms:
    """k rows v + A dx of some units, whitened."""

    units: tuple[Unit, ...]
    """The units."""
    rows: tuple[Index, ...]
    """Rows of each unit."""
    v: Array
    """Residuals at the state where they were linearised, (k,)."""
    columns: Index
    """Columns of the base that they touch, (m,)."""
    a: Array
    """Partials, (k, m)."""
    raw: tuple[Array, ...]
    """L of each unit with Σ = L Lᵀ: what whitening is undone with, (d, d)."""
    at: LinearisedEquations
    """The excerpt of the network, linearised."""
    chosen: Index
    """Rows of the excerpt, (k,)."""
    own: Index
    """Columns of the excerpt that they touch, (m,)."""
    movement: Array
    """Movement of the columns from the base where they were linearised, (m,)."""

    @classmethod
    def of(
        cls,
        units: Sequence[Unit],
        equations: Equations,
        columns_of: Callable[[VariableKind, str], Index],
        moved: Callable[[Index], Array],
        state: State,
    ) -> LinearForms:
        """Linearise the observations of an excerpt.

        Args:
            units: all of its observations.
            equations: the excerpt; its free unknowns are unknowns of the system too.
            columns_of: returns the columns of a variable.
            moved: returns the movement of columns from the base.
            state: values of its unknowns.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        state = state_off_lines(equations, state)
        system = LinearisedEquations(equations.weighted_at(state), state)
        unknowns = equations.unknowns
        a = np.zeros((len(system.residual), 0))
        if unknowns.n_columns:
            a = system.times(np.eye(unknowns.n_columns))
        columns = np.empty(unknowns.n_columns, dtype=np.intp)
        for kind, number in unknowns.active():
            at = unknowns.columns(kind, number)
            columns[at] = columns_of(kind, unknowns[kind].names[number])[: len(at)]
        own = np.flatnonzero(a.any(axis=0))
        rows, raw = rows_of(units, system.equations)
        every, movement = np.arange(len(a)), moved(columns[own])
        v, columns, a = system.residual, columns[own], a[:, own]
        return cls(tuple(units), rows, v, columns, a, raw, system, every, own, movement)

    @property
    def residuals(self) -> Array:
        """Residuals that the linear forms have at the base, (k,)."""
        return np.asarray(self.v - self.a @ self.movement)

    def some(self, chosen: Sequence[int]) -> LinearForms:
        """Return the forms of some units."""
        rows, every = stacked([self.rows[i] for i in chosen])
        return replace(
            self,
            units=tuple(self.units[i] for i in chosen),
            rows=rows,
            v=self.v[every],
            a=self.a[every],
            raw=tuple(self.raw[i] for i in chosen),
            chosen=self.chosen[every],
        )

    def missed(self, movement: Array) -> tuple[float, Array]:
        """Return √Σ|Δv|² and the change of the partials (k, m) where the unknowns are by now.

        Args:
            movement: movement of the columns from the base, (m,).

        Raises:
            InputError: names observations whose geometry has no answer there.
        """
        step = movement - self.movement
        unknowns = self.at.unknowns
        whole = np.zeros(unknowns.n_columns)
        whole[self.own] = step
        there = LinearisedEquations(self.at.equations, unknowns.retract(self.at.state, whole))
        gap = there.residual[self.chosen] - (self.v + self.a @ step)
        if not len(whole):
            return 0.0, self.a
        change = there.times(np.eye(len(whole)))[np.ix_(self.chosen, self.own)] - self.a
        return float(np.linalg.norm(gap)), change

    def relative(self, change: Array) -> float:
        """Return √Σρ² of a change of the partials; ρ is that of a row relative to its partials."""
        size = np.maximum(np.linalg.norm(self.a, axis=1), np.finfo(float).tiny)
        return float(np.linalg.norm(change / size[:, None]))

    def bend(self, name: str, step: Array) -> float:
        """Return √Σ|Δv|² of what the forms miss where a point is moved, and nothing else.

        Args:
            name: the point.
            step: its movement from where they were linearised, (3,).

        Raises:
            InputError: names observations whose geometry has no answer there.
        """
        whole = self._movement(name, step)
        there = self._residuals_after(whole)
        return float(np.linalg.norm(there - (self.v + self.a @ whole[self.own])))

    def misfit(self, name: str, step: Array) -> float:
        """Return √Σ|v|² where a point is moved, and nothing else; arguments as of `bend`."""
        return float(np.linalg.norm(self._residuals_after(self._movement(name, step))))

    def _movement(self, name: str, step: Array) -> Array:
        """Return the movement of all unknowns where a point is moved, (n_columns,)."""
        unknowns = self.at.unknowns
        whole = np.zeros(unknowns.n_columns)
        whole[unknowns.columns("point", unknowns["point"].number[name])] = step
        return whole

    def _residuals_after(self, whole: Array) -> Array:
        """Return residuals of the forms after a movement of all unknowns."""
        moved = self.at.unknowns.retract(self.at.state, whole)
        return self.at.equations.residuals(moved)[self.chosen]


def stacked(rows: Sequence[Index]) -> tuple[tuple[Index, ...], Index]:
    """Return the rows of each unit among those of all, and the rows of all."""
    ends = np.cumsum([len(r) for r in rows], dtype=np.intp)
    own = tuple(np.arange(e - len(r), e) for e, r in zip(ends, rows, strict=True))
    return own, np.concatenate([NO_ROWS, *rows])


def rows_of(
    units: Sequence[Unit], equations: Equations
) -> tuple[tuple[Index, ...], tuple[Array, ...]]:
    """Return the rows of each unit in compiled equations, and its L with Σ = L Lᵀ."""
    found = iter(equations.find([i for unit in units for i in unit.ids]))
    rows: list[Index] = []
    raw: list[Array] = []
    for unit in units:
        rows.append(np.concatenate([next(found) for _ in unit.ids]))
        o = unit.observations[0]
        if isinstance(o, ImagePoint):
            sigma: Array = np.zeros(2) + np.asarray(o.sigma)
            raw.append(np.diag(sigma))
        else:
            raw.append(_root(equations, rows[-1]))
    return tuple(rows), tuple(raw)


def _root(equations: Equations, rows: Index) -> Array:
    """Return L with Σ = L Lᵀ of some rows, which are not correlated with any other."""
    for c in equations.clusters:
        if rows[0] in c.rows:
            order = np.array([int(np.flatnonzero(c.rows == r)[0]) for r in rows])
            return np.asarray(np.linalg.inv(c.whitener)[np.ix_(order, order)])
    out = np.zeros((len(rows),) * 2)
    for block in equations.blocks:
        inside = np.flatnonzero((rows >= block.rows.start) & (rows < block.rows.stop))
        number, component = np.divmod(rows[inside] - block.first_row, block.dimension)
        if block.whitener is None:
            out[inside, inside] = block.sigma[number, component]
            continue
        for i in np.unique(number).tolist():
            at = inside[number == i]
            out[np.ix_(at, at)] = np.linalg.inv(block.whitener[i])
    return out
