"""The places of columns in a matrix of nodes of equal width with a border."""

from __future__ import annotations

import numpy as np

from ..types import Array, Index, Mask
from .dissection import Front, Pattern, dissect
from .fronts import BlockMatrix


class Places:
    """Nodes of some columns each, padded to equal width, and a border of full columns."""

    n: int = 0
    """Number of nodes."""
    width: int = 1
    """Number of columns of a node."""
    side: int = 0
    """Number of columns of the border."""

    def __init__(self, n_columns: int) -> None:
        """Begin without any place for some number of columns."""
        self._n_columns = n_columns
        self._structure: tuple[Index, Pattern, list[Front]] | None = None

    def _settle(
        self, node: Index, position: Index, column: Index, border: Index, kept: Index
    ) -> None:
        """Put columns into their places.

        Args:
            node: node of each place that is not in the border, (k,).
            position: place in its node, (k,).
            column: column at the place, −1 for held ones, (k,).
            border: column at each place of the border, −1 for held ones.
            kept: columns that are not eliminated, (m,).
        """
        self.width = max(int(position.max(initial=-1)) + 1, 1)
        columns = np.full((self.n, self.width), -1, dtype=np.intp)
        columns[node, position] = column
        self.side = len(border)
        self.columns: Index = np.concatenate([columns.ravel(), border])
        """Column at each place, −1 for held components and padding."""
        self.place_of: Index = np.full(self._n_columns, -1, dtype=np.intp)
        """Place of each column, −1 for others."""
        on = self.columns >= 0
        self.place_of[self.columns[on]] = np.flatnonzero(on)
        self.held: Mask = ~on
        """Places that are held or padding."""
        self.kept: Index = self.place_of[kept]
        """Places that are not eliminated, (m,)."""

    def structure(self, pairs: Index, positions: Array) -> tuple[Pattern, list[Front]]:
        """Return the blocks of the reduced system and its fronts; they are made once.

        Args:
            pairs: pairs of nodes with a block, the first one smaller, n a + b each, (p,).
            positions: where the nodes are, (n, 3), metres.
        """
        codes = np.unique(pairs)
        if self._structure is None or not np.array_equal(self._structure[0], codes):
            first, second = np.divmod(codes, max(self.n, 1))
            pattern = Pattern(self.n, self.width, self.side, first, second)
            self._structure = (codes, pattern, self._fronts(pattern, positions))
        return self._structure[1:]

    def _fronts(self, pattern: Pattern, positions: Array) -> list[Front]:
        """Return the fronts, with what is kept in the root."""
        last = np.unique(self.kept[self.kept < self.n * self.width] // self.width)
        return dissect(pattern, positions, last)

    def add_diagonal(self, matrix: BlockMatrix, extra: Array) -> None:
        """Add terms (n_columns,) to the diagonal, in place."""
        added = np.where(self.held, 0.0, extra[np.maximum(self.columns, 0)])
        n, w = self.n, self.width
        i, j = np.arange(w), np.arange(self.side)
        matrix.diagonal[:, i, i] += added[: n * w].reshape(n, w)
        matrix.corner[j, j] += added[n * w :]

    def hold(self, matrix: BlockMatrix) -> None:
        """Give held places a one on the diagonal and zeros elsewhere, in place."""
        if not self.held.any():
            return
        n, w = self.n, self.width
        free = (~self.held).astype(float)
        nodes, border = free[: n * w].reshape(n, w), free[n * w :]
        first, second = matrix.pattern.first, matrix.pattern.second
        matrix.diagonal *= nodes[:, :, None] * nodes[:, None, :]
        matrix.pairs *= nodes[first][:, :, None] * nodes[second][:, None, :]
        matrix.side *= nodes[:, :, None] * border
        matrix.corner *= border[:, None] * border
        i, j = np.arange(w), np.arange(self.side)
        matrix.diagonal[:, i, i] += 1.0 - nodes
        matrix.corner[j, j] += 1.0 - border
