"""Cofactors of chosen unknowns with all others, of a linear system in either engine.

`LinearSystem.cofactors` gives the block of two variables. Here one solution gives whole columns of
Q, for any number of right sides at once, and the blocks of all points from the selected inverse.
In fronts these are Q′ = Q − G P Gᵀ of the base and the rows beside it, with the border of new
unknowns b (see `factorgraph_adj.solve.low_rank_update`):

    Q′_xx = Q − G P Gᵀ,   Q′_xb = −G Kᵀ,   Q′_bb = K D Kᵀ;

in iSAM2 they are those of the normal matrix of the rows in the tree.

Rows B that join, or hold functions as constraints without error, change them again:

    Q″ = Q′ − H D⁻¹ Hᵀ,   H = Q′Bᵀ,   D = S + B H   with S = I, or 0 for constraints.

Constraints on a free network determine the motions m that its datum leaves open too, which are new
unknowns with the rows C = B G: x + G m has, with P and K as above,

    Q″ = Q′ − H P Hᵀ − G K Hᵀ − H Kᵀ Gᵀ + G (Cᵀ D⁻¹ C)⁻¹ Gᵀ.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from ..factor_graph.normal_matrix import ChangedNormals, SolvedNormals
from ..models.unknown_registry import VariableKind
from ..solve.solution import Solution
from ..types import Array, Index
from .front_system import FrontSystem
from .isam2_system import ISAM2System
from .linear_system import LinearSystem

UNKNOWN = -2
"""Column of a component of a variable that is not determined."""
POINT_SIZE = 3


class CofactorColumns(Protocol):
    """Cofactors Q of all unknowns of a network, by columns."""

    @property
    def size(self) -> int:
        """Number of columns n."""
        ...

    @property
    def motions(self) -> Array:
        """Motions of the whole that the datum of a free network leaves open, (n, d)."""
        ...

    def columns(self, kind: VariableKind, names: Sequence[str], width: int) -> Index:
        """Return the columns of the components of variables, (m, width).

        −1 stands for a held component, `UNKNOWN` for those of a variable that is not determined.
        """
        ...

    def times(self, y: Array) -> Array:
        """Return Q y for y (n, k)."""
        ...

    def point_blocks(self, names: Sequence[str]) -> Array:
        """Return the cofactors of points, (m, 3, 3); zero for held and undetermined ones."""
        ...


def cofactor_columns(
    system: LinearSystem,
    solution: Callable[[], Solution],
    before: CofactorColumns | None = None,
) -> CofactorColumns:
    """Return the cofactors of a linear system by columns.

    Args:
        system: the system.
        solution: returns the whole solution, which a section of a large network takes.
        before: the columns of an earlier state, whose factor is used again; None: there are none.
    """
    if isinstance(system, ISAM2System):
        if not system.tree.lost:
            return TreeColumns(system, before if isinstance(before, TreeColumns) else None)
        system = system.fronts
    assert isinstance(system, FrontSystem)
    return FrontColumns(system if system.section is None else FrontSystem.of(solution()))


class TreeColumns:
    """Cofactors of a network in iSAM2."""

    def __init__(self, system: ISAM2System, before: TreeColumns | None = None) -> None:
        """Factorise the normal matrix of the rows in the tree, or change an earlier factor."""
        self._tree = system.tree
        factor = before.factor if before is not None and before._tree is self._tree else None
        self._solved = self._tree.solved_normals(factor)
        self._columns = {k: t.column.values.copy() for k, t in self._tree.tables.items()}
        self._numbers = {k: dict(t.number) for k, t in self._tree.tables.items()}

    @property
    def factor(self) -> SolvedNormals:
        """The factor, without later changes."""
        return self._solved.before if isinstance(self._solved, ChangedNormals) else self._solved

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(self._solved.alive)

    @property
    def motions(self) -> Array:
        """None: the datum is given."""
        return np.zeros((self.size, 0))

    def columns(self, kind: VariableKind, names: Sequence[str], width: int) -> Index:
        """Return the columns of variables, see `CofactorColumns`."""
        out = np.full((len(names), width), UNKNOWN, dtype=np.intp)
        numbers = self._numbers.get(kind, {})
        number = np.array([numbers.get(n, -1) for n in names], dtype=np.intp)
        here = np.flatnonzero(number >= 0)
        if len(here):
            found = self._columns[kind][number[here]][:, :width]
            dead = (found >= 0) & ~self._solved.alive[np.maximum(found, 0)]
            out[here] = -1
            out[here, : found.shape[1]] = np.where(dead, UNKNOWN, found)
        return out

    def times(self, y: Array) -> Array:
        """Return Q y."""
        return self._solved.times(y)

    def point_blocks(self, names: Sequence[str]) -> Array:
        """Return the cofactors of points."""
        return self._solved.blocks(_stacked(self, names))


class FrontColumns:
    """Cofactors of a network in fronts with the rows beside its base; it is no section."""

    def __init__(self, system: FrontSystem) -> None:
        """Take a system over."""
        self._system = system
        self._base = system.base
        self._n = self._base.equations.unknowns.n_columns

    @property
    def size(self) -> int:
        """Number of columns: those of the base, then those of the border."""
        return self._n + len(self._system.border.place)

    @property
    def motions(self) -> Array:
        """Motions that the datum leaves open."""
        datum = self._base.datum
        return np.zeros((self.size, 0)) if datum is None else datum.motions

    def columns(self, kind: VariableKind, names: Sequence[str], width: int) -> Index:
        """Return the columns of variables, see `CofactorColumns`."""
        unknowns, system = self._base.equations.unknowns, self._system
        table, out = unknowns[kind], np.full((len(names), width), UNKNOWN, dtype=np.intp)
        number = np.array([table.number.get(n, -1) for n in names], dtype=np.intp)
        here = np.flatnonzero(number >= 0)
        k = min(width, table.free.shape[1])
        offset = table.offset[number[here]]
        free = table.free[number[here], :k] & (offset >= 0)[:, None]
        out[here] = -1
        out[here, :k] = np.where(free, offset[:, None] + np.arange(k), -1)
        for i in np.flatnonzero(number < 0).tolist():
            if system.known(kind, names[i]):
                found = system.columns(kind, names[i])
                out[i] = -1
                out[i, : len(found)] = np.where(system.free(found), found, -1)[:width]
        return out

    @cached_property
    def _spread(self) -> Array:
        """G by all unknowns of the base, in a free network S G, (n, k)."""
        system = self._system
        update, lifted = system.update, system.lifted
        z = update.spread
        if self._base.factor.points is None:
            out = np.zeros((self._n, z.shape[1]))
            out[lifted.columns] = z[: len(lifted.columns)]
        else:
            each = [lifted.unknowns(column, system.slots) for column in z.T]
            out = np.stack(each, axis=1) if each else np.zeros((self._n, 0))
        out[~self._base.equations.unknowns.free] = 0.0
        datum = self._base.datum
        return out if datum is None else out - datum.basis @ (datum.masked.T @ out)

    def times(self, y: Array) -> Array:
        """Return Q y."""
        update, border = self._system.update, self._system.border
        inner = np.where(self._base.equations.unknowns.free[:, None], y[: self._n], 0.0)
        out = np.zeros(y.shape)
        out[: self._n] = self._base.cofactor_times(inner)
        if not len(update.signs):
            return out
        g, k = self._spread, update.parts.k
        along = g.T @ inner
        new = border.place >= 0
        of_new = k[border.place[new]].T @ y[self._n :][new]
        out[: self._n] -= g @ (update.inverse @ along + of_new)
        if new.any():
            moved = k @ (update.inner @ of_new - along)
            out[self._n + np.flatnonzero(new)] = moved[border.place[new]]
        return out

    def point_blocks(self, names: Sequence[str]) -> Array:
        """Return the cofactors of points."""
        table = self._base.equations.unknowns["point"]
        out = np.zeros((len(names), POINT_SIZE, POINT_SIZE))
        number = np.array([table.number.get(n, -1) for n in names], dtype=np.intp)
        mine = np.flatnonzero(number >= 0)
        out[mine] = self._base.point_covariances[number[mine]]
        if len(self._system.update.signs):
            on = mine[table.offset[number[mine]] >= 0]
            columns = table.offset[number[on], None] + np.arange(POINT_SIZE)
            out[on] -= self._system.update.loss(self._spread[columns])
        for i in np.flatnonzero(number < 0).tolist():
            if self._system.known("point", names[i]):
                found = self._system.cofactors(("point", names[i]), ("point", names[i]))
                out[i, : len(found), : len(found)] = found
        return out


@dataclass(frozen=True, eq=False)
class WithRows:
    """Cofactors after more rows, or constraints, see the top."""

    before: CofactorColumns
    """Cofactors without them."""
    rows: Array
    """Bᵀ, (n, k)."""
    held: bool = False
    """Whether they are constraints without error, which also determine the open motions."""

    @property
    def size(self) -> int:
        """Number of columns."""
        return self.before.size

    @property
    def motions(self) -> Array:
        """Motions that stay open."""
        return self.before.motions

    def columns(self, kind: VariableKind, names: Sequence[str], width: int) -> Index:
        """Return the columns of variables, see `CofactorColumns`."""
        return self.before.columns(kind, names, width)

    @cached_property
    def _change(self) -> tuple[Array, Array]:
        """M (n, m) and W (m, m) of Q″ = Q′ + M W Mᵀ."""
        h = self.before.times(self.rows)
        d = self.rows.T @ h
        d = 0.5 * (d + d.T)
        if not self.held:
            return h, np.asarray(-np.linalg.inv(np.eye(len(d)) + d), dtype=float)
        g = self.motions
        c = self.rows.T @ g
        size = float(np.trace(d)) / max(len(d), 1)
        # Constraints determine the motions: what is added along these has no effect on P and K.
        full = d + size * (c @ c.T)
        scale = 1.0 / np.sqrt(np.diag(full))
        inverse = np.linalg.inv(full * scale[:, None] * scale) * scale[:, None] * scale
        if not g.shape[1]:
            return h, -inverse
        of_motions = np.linalg.inv(c.T @ inverse @ c)
        k = of_motions @ c.T @ inverse
        p = inverse - inverse @ c @ k
        own = of_motions - size * np.eye(len(of_motions))
        w: Array = np.asarray(np.block([[-p, -k.T], [-k, own]]), dtype=float)
        return np.hstack([h, g]), w

    def times(self, y: Array) -> Array:
        """Return Q y."""
        m, w = self._change
        return np.asarray(self.before.times(y) + m @ (w @ (m.T @ y)))

    def point_blocks(self, names: Sequence[str]) -> Array:
        """Return the cofactors of points."""
        m, w = self._change
        columns = _stacked(self, names)
        own = np.where((columns >= 0)[:, :, None], m[columns], 0.0)
        return np.asarray(self.before.point_blocks(names) + own @ w @ own.transpose(0, 2, 1))


def _stacked(of: CofactorColumns, names: Sequence[str]) -> Index:
    """Return the columns of points, −1 where they are held or not determined, (m, 3)."""
    return np.maximum(of.columns("point", names, POINT_SIZE), -1)
