"""The linearised observation equations of a whole network.

The system has all columns of variables with a free component; partials by held components are
zero. Rows are whitened, except those of clusters, whose whitening joins several observations
and is applied where rows are used.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns, Variables
from ..models.variables import VariableKind
from ..types import Array, Index


@dataclass(frozen=True)
class ExtraRows:
    """Whitened rows of a factor that the user added."""

    columns: Index
    """Columns that the rows touch, (m,)."""
    a: Array
    """Partials, (k, m)."""
    residual: Array
    """Whitened residuals at the state, (k,)."""


@dataclass(frozen=True)
class LinearBlock:
    """One block, linearised."""

    block: Block
    """The observations."""
    offsets: tuple[Index, ...]
    """First column of each variable (n,), −1 where the variable is a constant."""
    a: tuple[Array, ...]
    """Partials by each variable, (n, d, k), whitened outside clusters."""


class LinearSystem:
    """Whitened residuals v and partials A of all observations at one state."""

    def __init__(self, equations: Equations, state: State, extra: Sequence[ExtraRows] = ()) -> None:
        """Linearise all observations at ``state``.

        Raises:
            InputError: observations cannot be computed at ``state``; the error names them.
        """
        self.equations = equations
        self.unknowns: Unknowns = equations.unknowns
        self.extra = tuple(extra)
        self.blocks: list[LinearBlock] = []
        v = np.empty(equations.n_rows)
        raw = np.empty(equations.n_rows) if equations.clusters else None
        for place, block in enumerate(equations.blocks):
            residual, jacobians = block.evaluate(equations.network.frame, state)
            clustered = equations.in_cluster.get(place)
            v[block.rows] = block.whiten(residual).ravel()
            if raw is not None:
                raw[block.rows] = residual.ravel()
            offsets = []
            whitened = []
            for (kind, index), jacobian in zip(block.variables, jacobians, strict=True):
                table = self.unknowns[kind]
                offset = table.offset[index]
                offsets.append(offset)
                if not (offset >= 0).any():
                    whitened.append(jacobian[:0])
                    continue
                a = block.whiten(jacobian)
                if clustered is not None:
                    a[clustered] = jacobian[clustered]
                _mask(a, table, index)
                whitened.append(a)
            self.blocks.append(LinearBlock(block, tuple(offsets), tuple(whitened)))
        if raw is not None:
            for c in equations.clusters:
                v[c.rows] = c.whitener @ raw[c.rows]
        self.residual = v

    def only(self, kinds: Collection[VariableKind]) -> LinearSystem:
        """Return the system with the other kinds of variables held."""
        out = copy(self)
        out.blocks = [
            LinearBlock(
                lb.block,
                lb.offsets,
                tuple(
                    a if kind in kinds else a[:0]
                    for (kind, _), a in zip(lb.block.variables, lb.a, strict=True)
                ),
            )
            for lb in self.blocks
        ]
        kept = np.zeros(self.unknowns.n_columns, dtype=bool)
        for kind in kinds:
            table = self.unknowns[kind]
            for j in range(table.free.shape[1]):
                on = (table.offset >= 0) & (j < table.size)
                kept[table.offset[on] + j] = True
        out.extra = tuple(
            ExtraRows(e.columns[kept[e.columns]], e.a[:, kept[e.columns]], e.residual)
            for e in self.extra
        )
        return out

    @property
    def vtpv(self) -> float:
        """Weighted sum of squared residuals vᵀPv."""
        return float(self.residual @ self.residual) + sum(
            float(e.residual @ e.residual) for e in self.extra
        )

    def gradient(self) -> Array:
        """Return AᵀPv, (n_columns,)."""
        v = np.concatenate([self.residual, *(e.residual for e in self.extra)])
        return self.transposed(v[:, None])[:, 0]

    def transposed(self, z: Array) -> Array:
        """Return Aᵀ Z (n_columns, k), A whitened, for Z (rows, k); extra rows at the end."""
        v = z
        if self.equations.clusters:
            v = z.copy()
            for c in self.equations.clusters:
                v[c.rows] = c.whitener.T @ z[c.rows]
        out = np.zeros((self.unknowns.n_columns, z.shape[1]))
        for lb in self.blocks:
            w = v[lb.block.rows].reshape(*lb.block.observed.shape, -1)
            for offset, a in zip(lb.offsets, lb.a, strict=True):
                if len(a):
                    _add_transposed(out, a, offset, w)
        first = self.equations.n_rows
        for e in self.extra:
            np.add.at(out, e.columns, e.a.T @ z[first : first + len(e.a)])
            first += len(e.a)
        return out

    def diagonal(self) -> Array:
        """Return the diagonal of N = AᵀPA, (n_columns,)."""
        out = np.zeros(self.unknowns.n_columns)
        clustered = self.equations.in_cluster
        for place, lb in enumerate(self.blocks):
            for offset, a in zip(lb.offsets, lb.a, strict=True):
                if len(a):
                    square = np.einsum("ndk,ndk->nk", a, a)
                    if place in clustered:
                        square[clustered[place]] = 0.0
                    _add(out, offset, square)
        for columns, a in self.cluster_rows():
            np.add.at(out, columns, np.sum(a * a, axis=0))
        for e in self.extra:
            np.add.at(out, e.columns, np.sum(e.a * e.a, axis=0))
        return out

    def times(self, g: Array) -> Array:
        """Return A G (rows, k), whitened, for G (n_columns, k); extra rows at the end."""
        out = np.zeros((self.equations.n_rows, g.shape[1]))
        for lb in self.blocks:
            rows = np.zeros((*lb.block.observed.shape, g.shape[1]))
            for offset, a in zip(lb.offsets, lb.a, strict=True):
                if len(a):
                    _add_product(rows, a, offset, g)
            out[lb.block.rows] = rows.reshape(-1, g.shape[1])
        for c in self.equations.clusters:
            out[c.rows] = c.whitener @ out[c.rows]
        return np.concatenate([out, *(e.a @ g[e.columns] for e in self.extra)])

    def cluster_rows(self) -> list[tuple[Index, Array]]:
        """Return columns (m,) and whitened partials (k, m) of every cluster."""
        out = []
        for c in self.equations.clusters:
            place = {int(r): i for i, r in enumerate(c.rows)}
            pieces: dict[int, Array] = {}
            for lb in self.blocks:
                first, d = lb.block.first_row, lb.block.dimension
                rows = c.rows[(c.rows >= lb.block.rows.start) & (c.rows < lb.block.rows.stop)]
                for i in np.unique((rows - first) // d):
                    for offset, a in zip(lb.offsets, lb.a, strict=True):
                        if not len(a) or offset[i] < 0:
                            continue
                        k = a.shape[2]
                        for component in range(d):
                            row = place[int(first + i * d + component)]
                            for j in range(k):
                                column = int(offset[i]) + j
                                piece = pieces.setdefault(column, np.zeros(len(c.rows)))
                                piece[row] += a[i, component, j]
            columns = np.array(sorted(pieces), dtype=np.intp)
            a = np.zeros((len(c.rows), len(columns)))  # no columns if all their variables are held
            for j, column in enumerate(columns.tolist()):
                a[:, j] = pieces[column]
            out.append((columns, c.whitener @ a))
        return out


def _mask(a: Array, table: Variables, index: Index) -> None:
    """Set the partials (n, d, k) by held components of partly free variables to zero."""
    active = table.offset >= 0
    for j in range(a.shape[2]):
        held = active & ~table.free[:, j]
        if not held.any():
            continue
        if held.sum() == active.sum():
            a[:, :, j] = 0.0
        else:
            a[held[index], :, j] = 0.0


def _add_product(rows: Array, a: Array, offset: Index, g: Array) -> None:
    """Add A G to rows (n, d, k), for partials (n, d, j) by the variable at each offset."""
    starts = _runs(offset)
    if len(starts) < len(offset) / 8:
        # Rows of one photo or camera lie together and share its part of G.
        for start, stop in zip(starts, np.r_[starts[1:], len(offset)], strict=True):
            first = offset[start]
            if first >= 0:
                rows[start:stop] += a[start:stop] @ g[first : first + a.shape[2]]
        return
    on = offset >= 0
    for j in range(a.shape[2]):
        rows += a[:, :, j, None] * np.where(on[:, None], g[np.maximum(offset + j, 0)], 0.0)[:, None]


def _add_transposed(out: Array, a: Array, offset: Index, w: Array) -> None:
    """Add Aᵀ W to out (n_columns, k), for partials (n, d, j) at each offset and W (n, d, k)."""
    starts = _runs(offset)
    j = a.shape[2]
    if len(starts) < len(offset) / 8:
        for start, stop in zip(starts, np.r_[starts[1:], len(offset)], strict=True):
            first = offset[start]
            if first >= 0:
                part = w[start:stop].reshape(-1, w.shape[2])
                out[first : first + j] += a[start:stop].reshape(-1, j).T @ part
        return
    on = offset >= 0
    if not on.all():
        offset, a, w = offset[on], a[on], w[on]
    values = a.transpose(0, 2, 1) @ w
    n = len(offset)
    for i in range(j):
        if w.shape[2] == 1:
            weights = values[:, i, 0]
            out[:, 0] += np.bincount(offset + i, weights=weights, minlength=len(out))
            continue
        places = (np.ones(n), offset + i, np.arange(n + 1))
        out += np.asarray(csr_array(places, shape=(n, len(out))).T @ values[:, i])


def _runs(offset: Index) -> Index:
    """Return where runs of equal offsets start."""
    return np.flatnonzero(np.r_[True, offset[1:] != offset[:-1]])


def _add(out: Array, offset: Index, values: Array) -> None:
    """Add values (n, k) to the k columns from each offset; rows with offset −1 are skipped."""
    on = offset >= 0
    if not on.all():
        offset, values = offset[on], values[on]
    if not len(offset):
        return
    starts = _runs(offset)
    if len(starts) < len(offset) / 8:
        # Rows of one photo or camera lie together: they are summed at once.
        values = np.add.reduceat(values, starts, axis=0)
        offset = offset[starts]
    for j in range(values.shape[1]):
        out += np.bincount(offset + j, weights=values[:, j], minlength=len(out))
