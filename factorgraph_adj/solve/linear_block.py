"""One block of observations, linearised."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from ..graph.blocks import Block
from ..graph.variables import Unknowns, Variables
from ..models.variables import VariableKind
from ..types import Array, Index

FEW = 100
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
    if n * j <= FEW:
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
