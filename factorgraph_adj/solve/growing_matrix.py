"""A matrix that gains columns, as an immutable value: G = Q Bᵀ of a low-rank update."""

from __future__ import annotations

import numpy as np

from ..types import Array

INITIAL_COLUMNS = 32
"""Number of columns of G for which there is room at first."""


class GrowingMatrix:
    """A matrix (n, k) to which columns are added, as an immutable value.

    Matrices to which columns are added one after the other share their room: it is copied when it
    is full, or where something else has been added before.
    """

    def __init__(self, n: int, k: int = 0, room: Array | None = None) -> None:
        """Take the first k columns of some room; None: there are no columns."""
        self._room = np.zeros((n, INITIAL_COLUMNS), order="F") if room is None else room
        self._k, self._taken = k, [k]

    @property
    def array(self) -> Array:
        """The matrix, (n, k)."""
        return self._room[:, : self._k]

    def with_columns(self, more: Array) -> GrowingMatrix:
        """Return the matrix with more columns (n, j)."""
        n, k = len(self._room), self._k + more.shape[1]
        if self._taken[0] != self._k or k > self._room.shape[1]:
            room = np.zeros((n, 2 * max(k, INITIAL_COLUMNS)), order="F")
            room[:, : self._k] = self.array
            return GrowingMatrix(n, self._k, room).with_columns(more)
        out = GrowingMatrix(n, k, self._room)
        out._taken = self._taken
        out._room[:, self._k : k] = more
        self._taken[0] = k
        return out
