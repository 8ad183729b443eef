"""Linearised blocks, clusters and users' rows: whitened v and A, AᵀPv, A x, diagonal of N.

The system has all columns of variables with a free component; partials by held components are
zero. Rows are whitened, except those of clusters, whose whitening joins several observations
and is applied where rows are used.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array, csr_array

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State, Unknowns, Variables
from ..models.base import Linearised
from ..models.unknown_registry import VariableKind
from ..types import Array, Index
from .cluster_rows import ClusterRows
from .linearised_rays import LinearRays

MAX_ROWS_ADDED_SINGLY = 100
"""Largest number of rows that are added one by one: a sparse matrix takes as long to make."""


@dataclass(frozen=True)
class LinearBlock:
    """One block, linearised."""

    block: Block
    """The observations."""
    offsets: tuple[Index, ...]
    """First column of each variable (n,), −1 where the variable is a constant."""
    a: tuple[Array, ...]
    """Partials by each variable, (n, d, k), whitened outside clusters; empty for constants."""

    @classmethod
    def of(
        cls,
        block: Block,
        jacobians: Sequence[Array],
        unknowns: Unknowns,
        clustered: Index | None,
    ) -> LinearBlock:
        """Return a block from its partials.

        Args:
            block: the observations.
            jacobians: partials by each variable, (n, d, k), not whitened.
            unknowns: the unknowns of the network.
            clustered: numbers of the observations in clusters, whose rows stay as they are.
        """
        offsets, whitened = [], []
        for (kind, index), jacobian in zip(block.variables, jacobians, strict=True):
            table = unknowns[kind]
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
        return cls(block, tuple(offsets), tuple(whitened))

    def only(self, kinds: Collection[VariableKind]) -> LinearBlock:
        """Return the block with the other kinds of variables held."""
        kept = tuple(
            a if kind in kinds else a[:0]
            for (kind, _), a in zip(self.block.variables, self.a, strict=True)
        )
        return replace(self, a=kept)

    def partials(self, rows: Index) -> tuple[Array, ...]:
        """Return the partials of some observations, as ``a``."""
        return tuple(a[rows] if len(a) else a for a in self.a)

    def times(self, g: Array) -> Array:
        """Return A G (n, d, k) for G (n_columns, k)."""
        out = np.zeros((*self.block.observed.shape, g.shape[1]))
        for offset, a in zip(self.offsets, self.a, strict=True):
            if len(a):
                _add_product(out, a, offset, g)
        return out

    def add_transposed(self, out: Array, z: Array) -> None:
        """Add Aᵀ Z to out (n_columns, k), for Z (n, d, k)."""
        for offset, a in zip(self.offsets, self.a, strict=True):
            if len(a):
                _add_transposed(out, a, offset, z)

    def add_diagonal(self, out: Array, clustered: Index | None = None) -> None:
        """Add the diagonal of AᵀA to out (n_columns,), without the observations in clusters."""
        for offset, a in zip(self.offsets, self.a, strict=True):
            if len(a):
                square = np.einsum("ndk,ndk->nk", a, a)
                if clustered is not None:
                    square[clustered] = 0.0
                _add(out, offset, square)


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
    _scatter(out, offset, a.transpose(0, 2, 1) @ w)


def _scatter(out: Array, offset: Index, values: Array) -> None:
    """Add values (n, j, k) to the rows of out (n_columns, k), the j rows from each offset."""
    n, j, k = values.shape
    rows = (offset[:, None] + np.arange(j)).ravel()
    flat = values.reshape(n * j, k)
    if n * j <= MAX_ROWS_ADDED_SINGLY:
        np.add.at(out, rows, flat)
    elif k == 1:
        out[:, 0] += np.bincount(rows, weights=flat[:, 0], minlength=len(out))
    else:
        places = (np.ones(n * j), rows, np.arange(n * j + 1))
        out += np.asarray(csr_array(places, shape=(n * j, len(out))).T @ flat)


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
    _scatter(out[:, None], offset, values[:, :, None])


def sum_of_squares(*residuals: Array) -> float:
    """Return Σv² of whitened residuals; infinite beyond the largest number."""
    with np.errstate(over="ignore"):
        return sum(float(v @ v) for v in residuals)


@dataclass(frozen=True)
class ExtraRows:
    """Whitened rows of a factor that the user added."""

    columns: Index
    """Columns that the rows touch, (m,)."""
    a: Array
    """Partials, (k, m)."""
    residual: Array
    """Whitened residuals at the state, (k,)."""
    name: str = ""
    """Name of the factor."""


class LinearisedEquations:
    """Whitened residuals v and partials A of all observations at one state."""

    def __init__(
        self,
        equations: Equations,
        state: State,
        extra: Sequence[ExtraRows] = (),
        evaluated: Mapping[int, Linearised] | None = None,
    ) -> None:
        """Linearise all observations at ``state``.

        Args:
            equations: the network.
            state: values of all variables.
            extra: rows of factors that the user added, at ``state``.
            evaluated: what `Equations.evaluated` returns for ``state``; None: it is computed.

        Raises:
            InputError: observations cannot be computed at ``state``; the error names them.
        """
        self.equations, self.state = equations, state
        self.unknowns: Unknowns = equations.unknowns
        self.extra = tuple(extra)
        self.blocks: list[LinearBlock | LinearRays] = []
        v = np.empty(equations.n_rows)
        raw = np.empty(equations.n_rows) if equations.clusters else None
        frame = equations.network.frame
        for place, block in enumerate(equations.blocks):
            if place in equations.rays:
                rays = LinearRays.at(equations.rays[place], state)
                self.blocks.append(rays)
                v[block.rows] = rays.residual().ravel()
                continue
            clustered = equations.in_cluster.get(place)
            found = block.evaluate(frame, state) if evaluated is None else evaluated[place]
            residual, jacobians = found
            self.blocks.append(LinearBlock.of(block, jacobians, self.unknowns, clustered))
            v[block.rows] = block.whiten(residual).ravel()
            if raw is not None:
                raw[block.rows] = residual.ravel()
        if raw is not None:
            for batch in equations.cluster_batches:
                v[batch.rows] = (batch.whitener @ raw[batch.rows][:, :, None])[:, :, 0]
        self.residual = v
        self._clusters: tuple[ClusterRows, ...] | None = None

    def only(self, kinds: Collection[VariableKind]) -> LinearisedEquations:
        """Return the system with the other kinds of variables held."""
        out = copy(self)
        out.blocks = [lb.only(kinds) for lb in self.blocks]
        out._clusters = None
        kept = np.zeros(self.unknowns.n_columns, dtype=bool)
        for kind in kinds:
            table = self.unknowns[kind]
            for j in range(table.free.shape[1]):
                on = (table.offset >= 0) & (j < table.size)
                kept[table.offset[on] + j] = True
        out.extra = tuple(
            replace(e, columns=e.columns[kept[e.columns]], a=e.a[:, kept[e.columns]])
            for e in self.extra
        )
        return out

    @property
    def vtpv(self) -> float:
        """Weighted sum of squared residuals vᵀPv."""
        return sum_of_squares(self.residual, *(e.residual for e in self.extra))

    @property
    def every_residual(self) -> Array:
        """Whitened residuals, extra rows at the end, (rows,)."""
        return np.concatenate([self.residual, *(e.residual for e in self.extra)])

    def gradient(self) -> Array:
        """Return AᵀPv, (n_columns,)."""
        others = [lb for lb in self.blocks if not isinstance(lb, LinearRays)]
        out = self._transposed(self.every_residual[:, None], others)[:, 0]
        for lb in self.blocks:
            if isinstance(lb, LinearRays):
                lb.add_gradient(out)
        return out

    def transposed(self, z: Array) -> Array:
        """Return Aᵀ Z (n_columns, k), A whitened, for Z (rows, k); extra rows at the end."""
        return self._transposed(z, self.blocks)

    def _transposed(self, z: Array, blocks: Iterable[LinearBlock | LinearRays]) -> Array:
        """Return Aᵀ Z of some blocks and of the extra rows."""
        v = z
        if self.equations.clusters:
            v = z.copy()
            for batch in self.equations.cluster_batches:
                v[batch.rows] = batch.whitener.transpose(0, 2, 1) @ z[batch.rows]
        out = np.zeros((self.unknowns.n_columns, z.shape[1]))
        for lb in blocks:
            lb.add_transposed(out, v[lb.block.rows].reshape(*lb.block.observed.shape, -1))
        first = self.equations.n_rows
        for e in self.extra:
            np.add.at(out, e.columns, e.a.T @ z[first : first + len(e.a)])
            first += len(e.a)
        return out

    def diagonal(self) -> Array:
        """Return the diagonal of N = AᵀPA, (n_columns,)."""
        out = np.zeros(self.unknowns.n_columns)
        for place, lb in enumerate(self.blocks):
            if isinstance(lb, LinearRays):
                lb.add_diagonal(out)
            else:
                lb.add_diagonal(out, self.equations.in_cluster.get(place))
        for c in self.clusters:
            np.add.at(out, c.columns, np.sum(c.a * c.a, axis=1))
        for e in self.extra:
            np.add.at(out, e.columns, np.sum(e.a * e.a, axis=0))
        return out

    def times(self, g: Array) -> Array:
        """Return A G (rows, k), whitened, for G (n_columns, k); extra rows at the end."""
        out = np.zeros((self.equations.n_rows, g.shape[1]))
        for lb in self.blocks:
            out[lb.block.rows] = lb.times(g).reshape(-1, g.shape[1])
        for batch in self.equations.cluster_batches:
            out[batch.rows] = batch.whitener @ out[batch.rows]
        return np.concatenate([out, *(e.a @ g[e.columns] for e in self.extra)])

    def sparse(self, rows: Index) -> csr_array:
        """Return whitened partials of some rows, (k, n_columns); extra rows are not among them.

        Args:
            rows: numbers of the rows, each once, (k,).
        """
        parts: list[tuple[Array, Index, Index]] = []
        inside = np.zeros(self.equations.n_rows, dtype=bool)
        clusters = [c for c in self.equations.clusters if np.isin(c.rows, rows).any()]
        every = self.cluster_rows() if clusters else []
        dense = dict(zip(map(id, self.equations.clusters), every, strict=bool(clusters)))
        for c in clusters:
            inside[c.rows] = True
            columns, a = dense[id(c)]
            own, mine = np.nonzero(rows[:, None] == c.rows)
            shape = (len(own), len(columns))
            i, j = np.broadcast_to(own[:, None], shape), np.broadcast_to(columns, shape)
            parts.append((a[mine].ravel(), i.ravel(), j.ravel()))
        for lb in self.blocks:
            block = lb.block
            own = np.flatnonzero((rows >= block.rows.start) & (rows < block.rows.stop))
            own = own[~inside[rows[own]]]
            if not len(own):
                continue
            number, component = np.divmod(rows[own] - block.first_row, block.dimension)
            chosen, place = np.unique(number, return_inverse=True)
            for offset, a in zip(lb.offsets, lb.partials(chosen), strict=True):
                if not len(a):
                    continue
                first = offset[number][:, None]
                shape = (len(own), a.shape[2])
                columns = np.broadcast_to(first + np.arange(shape[1]), shape)
                on = np.broadcast_to(first >= 0, shape) & (a[place, component] != 0.0)
                at = np.broadcast_to(own[:, None], shape)
                parts.append((a[place, component][on], at[on], columns[on]))
        shape = (len(rows), self.unknowns.n_columns)
        if not parts:
            return csr_array(shape)
        values, i, j = (np.concatenate(x) for x in zip(*parts, strict=True))
        return csr_array(coo_array((values, (i, j)), shape=shape))

    @property
    def clusters(self) -> tuple[ClusterRows, ...]:
        """Whitened partials of all clusters, in batches of one pattern."""
        if self._clusters is None:
            partials = [lb.a if isinstance(lb, LinearBlock) else () for lb in self.blocks]
            batches = self.equations.cluster_batches
            self._clusters = tuple(ClusterRows.of(batch, partials) for batch in batches)
        return self._clusters

    def cluster_rows(self) -> list[tuple[Index, Array]]:
        """Return columns (m,) and whitened partials (k, m) of every cluster, in their order."""
        found = {
            number: (c.columns[i], c.a[i])
            for c in self.clusters
            for i, number in enumerate(c.batch.numbers.tolist())
        }
        return [found[number] for number in range(len(found))]
