"""The linearised observation equations of a whole network.

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

from ..graph.equations import Equations
from ..graph.variables import State, Unknowns
from ..models.base import Linearised
from ..models.variables import VariableKind
from ..types import Array, Index
from .linear_block import LinearBlock
from .linear_rays import LinearRays


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
            evaluated: what `Equations.evaluated` returns for ``state``; none: it is computed.

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
            for c in equations.clusters:
                v[c.rows] = c.whitener @ raw[c.rows]
        self.residual = v

    def only(self, kinds: Collection[VariableKind]) -> LinearisedEquations:
        """Return the system with the other kinds of variables held."""
        out = copy(self)
        out.blocks = [lb.only(kinds) for lb in self.blocks]
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
            for c in self.equations.clusters:
                v[c.rows] = c.whitener.T @ z[c.rows]
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
        for columns, a in self.cluster_rows():
            np.add.at(out, columns, np.sum(a * a, axis=0))
        for e in self.extra:
            np.add.at(out, e.columns, np.sum(e.a * e.a, axis=0))
        return out

    def times(self, g: Array) -> Array:
        """Return A G (rows, k), whitened, for G (n_columns, k); extra rows at the end."""
        out = np.zeros((self.equations.n_rows, g.shape[1]))
        for lb in self.blocks:
            out[lb.block.rows] = lb.times(g).reshape(-1, g.shape[1])
        for c in self.equations.clusters:
            out[c.rows] = c.whitener @ out[c.rows]
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
