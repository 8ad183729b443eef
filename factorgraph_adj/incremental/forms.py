"""Linear forms of observations: whitened residuals and partials by the unknowns of a base."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import Unknowns
from ..observations import ImagePoint, Observation
from ..solve.linear import LinearSystem
from ..types import Array, Index
from .ledger import Ledger, Some
from .units import Unit


@dataclass(frozen=True, eq=False)
class Item:
    """A unit or an image point, with what its verdict says of it."""

    ids: tuple[str, ...]
    """Ids of its observations."""
    observations: tuple[Observation, ...]
    """The observations."""
    points: tuple[str, ...]
    """Names of the points that they touch."""
    unit: Unit | None
    """The unit; none for an image point."""
    row: int = -1
    """Row of an image point in the ledger; −1 for a unit."""

    @property
    def some(self) -> Some:
        """The item as a selection of observations."""
        rows = np.array([] if self.row < 0 else [self.row], dtype=np.intp)
        return Some(() if self.unit is None else (self.unit,), rows)


def items_of(ledger: Ledger, some: Some) -> list[Item]:
    """Return the items of some observations, image points last."""
    out = [Item(u.ids, u.observations, u.points, u) for u in some.units]
    for row in some.rays.tolist():
        o = ledger.rays.observation(ledger.names, row)
        out.append(Item((ledger.rays.name(ledger.names, row),), (o,), (o.point,), None, row))
    return out


def together(items: Sequence[Item]) -> Some:
    """Return items as a selection of observations."""
    units = tuple(i.unit for i in items if i.unit is not None)
    return Some(units, np.array(sorted(i.row for i in items if i.row >= 0), dtype=np.intp))


@dataclass(frozen=True, eq=False)
class Forms:
    """k rows v + A dx of some items, whitened."""

    items: tuple[Item, ...]
    """The items."""
    rows: tuple[Index, ...]
    """Rows of each item."""
    v: Array
    """Residuals at the state where they were linearised, (k,)."""
    columns: Index
    """Columns of the base that they touch, (m,)."""
    a: Array
    """Partials, (k, m)."""
    raw: tuple[Array, ...]
    """L of each item with Σ = L Lᵀ: what whitening is undone with, (d, d)."""
    at: LinearSystem
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
        items: Sequence[Item],
        equations: Equations,
        base: Unknowns,
        moved: Callable[[Index], Array],
    ) -> Forms:
        """Linearise the observations of an excerpt, whose unknowns stand at their values.

        Args:
            items: all of its observations.
            equations: the excerpt; its free unknowns are unknowns of the base too.
            base: unknowns of the base.
            moved: returns the movement of columns from the base.

        Raises:
            InputError: names observations whose geometry has no answer.
        """
        state = equations.unknowns.start()
        system = LinearSystem(equations.weighted_at(state), state)
        unknowns = equations.unknowns
        a = np.zeros((len(system.residual), 0))
        if unknowns.n_columns:
            a = system.times(np.eye(unknowns.n_columns))
        columns = np.empty(unknowns.n_columns, dtype=np.intp)
        for kind, number in unknowns.active():
            there = base[kind]
            first = there.offset[there.number[unknowns[kind].names[number]]]
            at = unknowns.columns(kind, number)
            columns[at] = first + np.arange(len(at))
        own = np.flatnonzero(a.any(axis=0))
        rows, raw = rows_of(items, system.equations)
        return cls(
            tuple(items),
            rows,
            system.residual,
            columns[own],
            a[:, own],
            raw,
            system,
            np.arange(len(a)),
            own,
            moved(columns[own]),
        )

    @property
    def residuals(self) -> Array:
        """Residuals that the linear forms have at the base, (k,)."""
        return np.asarray(self.v - self.a @ self.movement)

    def some(self, chosen: Sequence[int]) -> Forms:
        """Return the forms of some items."""
        rows = [self.rows[i] for i in chosen]
        every = np.concatenate([np.zeros(0, dtype=np.intp), *rows])
        ends = np.cumsum([len(r) for r in rows])
        return replace(
            self,
            items=tuple(self.items[i] for i in chosen),
            rows=tuple(np.arange(e - len(r), e) for e, r in zip(ends, rows, strict=True)),
            v=self.v[every],
            a=self.a[every],
            raw=tuple(self.raw[i] for i in chosen),
            chosen=self.chosen[every],
        )

    def missed(self, movement: Array) -> tuple[float, float]:
        """Return √Σ|Δv|² and √Σρ² of the forms where their unknowns are by now.

        ρ is the change of the partials of a row relative to them.

        Args:
            movement: movement of the columns from the base, (m,).

        Raises:
            InputError: names observations whose geometry has no answer there.
        """
        step = movement - self.movement
        unknowns = self.at.unknowns
        whole = np.zeros(unknowns.n_columns)
        whole[self.own] = step
        there = LinearSystem(self.at.equations, unknowns.retract(self.at.state, whole))
        gap = there.residual[self.chosen] - (self.v + self.a @ step)
        if not len(whole):
            return 0.0, 0.0
        change = there.times(np.eye(len(whole)))[np.ix_(self.chosen, self.own)] - self.a
        size = np.maximum(np.linalg.norm(self.a, axis=1), np.finfo(float).tiny)
        return float(np.linalg.norm(gap)), float(np.linalg.norm(change / size[:, None]))


def rows_of(
    items: Sequence[Item], equations: Equations
) -> tuple[tuple[Index, ...], tuple[Array, ...]]:
    """Return the rows of each item in compiled equations, and its L with Σ = L Lᵀ."""
    found = iter(equations.find([i for item in items for i in item.ids]))
    rows: list[Index] = []
    raw: list[Array] = []
    for item in items:
        own = np.concatenate([next(found) for _ in item.ids])
        rows.append(own)
        if item.row >= 0:
            (o,) = item.observations
            assert isinstance(o, ImagePoint)
            sigma: Array = np.zeros(2) + np.asarray(o.sigma)
            raw.append(np.diag(sigma))
        else:
            raw.append(_root(equations, own))
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
