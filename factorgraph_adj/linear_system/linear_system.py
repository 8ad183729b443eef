"""Interface of the linear system in either engine, and the linear forms of observations.

`isam2_system.ISAM2System` implements it with iSAM2, `front_system.FrontSystem` with fronts. Higher
modules use the interface alone; `engines` has the operations that change a system: rows enter and
leave. The linear form of an observation is its whitened residuals and its partials by the unknowns
of a base.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
from typing import Literal, Protocol, TypeAlias

import numpy as np

from ..graph.dependence import Variable
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..ledger.excerpts import Known
from ..ledger.row_store import Unit
from ..models.unknown_registry import VariableKind
from ..observations import ImagePoint
from ..solve.adjustment_run import ShapeMisfit
from ..solve.feasible_states import state_off_lines
from ..solve.linearised_equations import LinearisedEquations
from ..solve.solution import Solution
from ..types import NO_ROWS, Array, Index

EngineName: TypeAlias = Literal["isam2", "fronts"]
"""Engine that holds a linear system."""


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
    """L of each unit with Σ = L Lᵀ, which undoes the whitening, (d, d)."""
    at: LinearisedEquations
    """The excerpt of the network, linearised."""
    chosen: Index
    """Rows of the excerpt, (k,)."""
    own: Index
    """Columns of the excerpt that they touch, (m,)."""
    movement: Array
    """Movement of the columns from the base to the state where they were linearised, (m,)."""

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
            InputError: names observations with degenerate geometry.
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
        """Return √Σ|Δv|² and the change of the partials (k, m) at the present estimates.

        Args:
            movement: movement of the columns from the base, (m,).

        Raises:
            InputError: names observations that are degenerate there.
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
        """Return the error √Σ|Δv|² of the forms where a point is moved, and nothing else.

        Args:
            name: the point.
            step: its movement from where they were linearised, (3,).

        Raises:
            InputError: names observations that are degenerate there.
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


class LinearSystem(Known, Protocol):
    """A network at its minimum, to first order. A system is a value: changes return another one."""

    @property
    def engine(self) -> EngineName:
        """Engine that holds it."""
        ...

    @property
    def doubt(self) -> str:
        """Why this is not the minimum; empty if it is."""
        ...

    @property
    def is_free(self) -> bool:
        """Whether it is a free network."""
        ...

    @property
    def n_rows(self) -> int:
        """Number of scalar rows, weighted unknowns among them."""
        ...

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        ...

    @property
    def n_rays(self) -> int:
        """Number of image points of the whole network as it was adjusted last."""
        ...

    @property
    def vtpv(self) -> float:
        """VᵀPv of the linear forms."""
        ...

    @property
    def looked(self) -> Mapping[str, ShapeMisfit]:
        """Shapes that were fitted again in vain, see `solve.shape_minimum`."""
        ...

    @property
    def adjusted_solution(self) -> Solution | None:
        """The batch solution of everything; None: something has changed since there was one."""
        ...

    @property
    def datum_solution(self) -> Solution | None:
        """The solution whose minimal datum holds a free network; None: the datum is given."""
        ...

    def names(self, kind: VariableKind) -> set[str]:
        """Return the names of the known variables of a kind."""
        ...

    def places(self) -> list[tuple[Unknowns, State, State]]:
        """Return unknowns, state and start values; those of a later entry were adjusted later."""
        ...

    def carried(self, unknowns: Unknowns, state: State) -> State:
        """Return a state with the values of variables that `places` does not have."""
        ...

    def cofactors(self, a: Variable, b: Variable) -> Array:
        """Return the joint cofactors of the components of two variables, (i, j).

        All blocks of one system have the same datum.
        """
        ...

    def function_cofactors(
        self, touched: Mapping[Variable, Index], a: Array, groups: Sequence[Index]
    ) -> list[Array]:
        """Return the cofactors A Q Aᵀ of groups of functions of unknowns.

        Args:
            touched: components of the variables that the functions touch.
            a: the functions by these, in their order, (k, m).
            groups: rows of each group.
        """
        ...

    def renumbered(self, new: Index) -> LinearSystem:
        """Return the system after the rows of the ledger have got new numbers (n,)."""
        ...

    def prepared(self) -> LinearSystem:
        """Compute now what the first new observation would wait for."""
        ...


def block_by_block(
    system: LinearSystem, touched: Mapping[Variable, Index], a: Array, groups: Sequence[Index]
) -> list[Array]:
    """Return A Q Aᵀ of groups of functions from the cofactors of pairs of variables.

    Arguments as of `LinearSystem.function_cofactors`.
    """
    ends = np.cumsum([len(own) for own in touched.values()], dtype=np.intp)
    at = {v: np.arange(end - len(touched[v]), end) for v, end in zip(touched, ends, strict=True)}
    out = []
    for rows in groups:
        found = np.zeros((len(rows),) * 2)
        mine = [v for v in touched if a[np.ix_(rows, at[v])].any()]
        for v, w in combinations_with_replacement(mine, 2):
            q = system.cofactors(v, w)[np.ix_(touched[v], touched[w])]
            block = a[np.ix_(rows, at[v])] @ q @ a[np.ix_(rows, at[w])].T
            found += block if v == w else block + block.T
        out.append(found)
    return out
