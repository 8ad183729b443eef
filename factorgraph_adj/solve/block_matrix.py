"""A symmetric matrix in blocks of nodes with a border, and the places of elements in it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Array, Index
from .nested_dissection import BlockPattern


@dataclass
class BlockMatrix:
    """A symmetric matrix of n nodes of w columns and a border of k full columns."""

    pattern: BlockPattern
    """The blocks."""
    diagonal: Array
    """Blocks on the diagonal, (n, w, w)."""
    pairs: Array
    """Blocks of the pairs of nodes, rows of the first and columns of the second, (p, w, w)."""
    side: Array
    """Blocks of each node with the border, (n, w, k)."""
    corner: Array
    """The border itself, (k, k)."""

    @classmethod
    def zeros(cls, pattern: BlockPattern) -> BlockMatrix:
        """Return a matrix of zeros."""
        n, w, k = pattern.n, pattern.width, pattern.side
        pairs = np.zeros((len(pattern.first), w, w))
        return cls(pattern, np.zeros((n, w, w)), pairs, np.zeros((n, w, k)), np.zeros((k, k)))

    @property
    def diagonals(self) -> Array:
        """Elements on the diagonal, (n w + k,)."""
        own = np.einsum("nii->ni", self.diagonal).ravel()
        return np.concatenate([own, np.diag(self.corner)])

    def scaled(self, scale: Array) -> BlockMatrix:
        """Return D M D with D = diag(scale), (n w + k,)."""
        n, w = self.diagonal.shape[:2]
        own, border = scale[: n * w].reshape(n, w), scale[n * w :]
        first, second = self.pattern.first, self.pattern.second
        return BlockMatrix(
            self.pattern,
            self.diagonal * own[:, :, None] * own[:, None, :],
            self.pairs * own[first][:, :, None] * own[second][:, None, :],
            self.side * own[:, :, None] * border,
            self.corner * border[:, None] * border,
        )

    def at(self, rows: Index, columns: Index) -> Array:
        """Return the elements at places of rows and columns (n w + k), of equal shape."""
        i, j = np.minimum(rows, columns), np.maximum(rows, columns)
        n, w = self.diagonal.shape[:2]
        inner = n * w
        out = np.zeros(np.broadcast(rows, columns).shape)
        a, b = i // w, j // w
        in_corner = i >= inner
        out[in_corner] = self.corner[i[in_corner] - inner, j[in_corner] - inner]
        at_side = ~in_corner & (j >= inner)
        out[at_side] = self.side[a[at_side], i[at_side] % w, j[at_side] - inner]
        own = (j < inner) & (a == b)
        out[own] = self.diagonal[a[own], i[own] % w, j[own] % w]
        off = (j < inner) & (a != b)
        if off.any():
            place = self.find(a[off], b[off])
            out[off] = self.pairs[place, i[off] % w, j[off] % w]
        return out

    def places_of(self, rows: Index, columns: Index) -> ElementPlaces:
        """Return where elements of rows and columns (n w + k), (m,) each, stand in the arrays.

        Elements of both triangles are given, and each is taken where it is stored.
        """
        n, w = self.diagonal.shape[:2]
        inner, k = n * w, len(self.corner)
        a, b = rows // w, columns // w
        i, j = rows - w * a, columns - w * b
        inside = (rows < inner) & (columns < inner)
        corner = np.flatnonzero((rows >= inner) & (columns >= inner))
        side = np.flatnonzero((rows < inner) & (columns >= inner))
        own = np.flatnonzero(inside & (a == b))
        off = np.flatnonzero(inside & (a < b))
        pair = self.find(a[off], b[off])
        return ElementPlaces(
            (
                (corner, (rows[corner] - inner) * k + columns[corner] - inner),
                (side, rows[side] * k + columns[side] - inner),
                (own, rows[own] * w + j[own]),
                (off, (pair * w + i[off]) * w + j[off]),
            )
        )

    def find(self, first: Index, second: Index) -> Index:
        """Return the numbers of the blocks of pairs of nodes, the first one smaller."""
        if not len(first):
            return np.zeros(0, dtype=np.intp)
        code = self.pattern.first * self.pattern.n + self.pattern.second
        wanted = first * self.pattern.n + second
        found = np.minimum(np.searchsorted(code, wanted), max(len(code) - 1, 0))
        if not len(code) or not np.array_equal(code[found], wanted):
            raise IndexError("the matrix has no block for a pair of nodes")
        return np.asarray(found, dtype=np.intp)


@dataclass(frozen=True)
class ElementPlaces:
    """Where elements stand in the arrays of a `BlockMatrix`."""

    parts: tuple[tuple[Index, Index], ...]
    """Numbers of the elements that stand in the border itself, beside it, on the diagonal and in
    the pairs, and their flat places there."""

    def add(self, matrix: BlockMatrix, values: Array) -> None:
        """Add values (m,) of the elements to a matrix, in place."""
        arrays = (matrix.corner, matrix.side, matrix.diagonal, matrix.pairs)
        for array, (own, at) in zip(arrays, self.parts, strict=True):
            flat = array.reshape(-1)
            if len(at) < len(flat) / 8:
                np.add.at(flat, at, values[own])
            elif len(at):
                flat += np.bincount(at, weights=values[own], minlength=len(flat))
