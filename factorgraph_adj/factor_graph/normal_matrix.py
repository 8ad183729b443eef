"""Normal matrix of linear rows: its solutions and the covariances of single variables, in fronts.

iSAM2 gives the covariances of a few variables; whoever asks for those of a variable with all
others solves with the whole matrix of the same rows. Its nodes are the variables, in pieces of
three columns.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csc_array, csr_array

from ..solve.block_matrix import BlockMatrix
from ..solve.fronts import Fronts
from ..solve.nested_dissection import BlockPattern, Front, dissect
from ..types import Array, Index, Mask
from .linear_rows import LinearRows

WIDTH = 3
"""Columns of a node."""
MAX_CHANGED_COLUMNS = 60
"""Largest number of columns in which a factor is changed: each of them costs a solution, and a new
factor as much as about a hundred of a grid."""
LEAST_CHANGE = 1e-4
"""Smallest singular value of I + Δ G: below it a change loses digits, and the matrix is factorised
anew."""


class NormalPattern(NamedTuple):
    """The nodes of a normal matrix, and their fronts."""

    codes: Index
    """Pairs of nodes with a block, n a + b, ascending."""
    pattern: BlockPattern
    """Its blocks."""
    fronts: list[Front]
    """Its fronts."""


class RowsWithNormals(LinearRows):
    """Linear rows with their normal matrix."""

    _pattern: NormalPattern | None = None

    def normal_matrix(self) -> csc_array:
        """Return N = AᵀA of all rows inside, (columns, columns)."""
        n, first = self._key.n, 0
        data, row, column = [np.zeros(0)], [np.zeros(0, np.intp)], [np.zeros(0, np.intp)]

        def take(a: Array, at: Index) -> None:
            lines = first + np.arange(a.shape[0] * a.shape[1]).reshape(a.shape[:2])
            on = np.broadcast_to((at >= 0)[:, None, :], a.shape)
            data.append(a[on])
            row.append(np.broadcast_to(lines[:, :, None], a.shape)[on])
            column.append(np.broadcast_to(at[:, None, :], a.shape)[on])

        for sort, own in enumerate(self.rows):
            inside = self._inside.values[own.unit.values] & ~own.joint.values
            rows = np.flatnonzero(inside)
            for a, at in self._forms(sort, rows):
                take(a, at)
            first += len(rows) * own.v.values.shape[1]
        groups = np.array(self._groups(np.flatnonzero(self._inside.values)), dtype=np.intp)
        for group in self._correlated(groups):
            for on, columns in group.columns(self._first.values):
                held = np.broadcast_to(columns >= 0, columns.shape)
                take(group.a[:, :, on], np.where(held, columns, -1))
            first += group.v.size
        places = np.concatenate(row), np.concatenate(column)
        rows_of_all = coo_array((np.concatenate(data), places), shape=(first, n)).tocsr()
        return csc_array(rows_of_all.T @ rows_of_all)

    def solved_normals(self, before: SolvedNormals | None = None) -> SolvedNormals | ChangedNormals:
        """Return the factorised normal matrix, or an earlier factor with few changes.

        Args:
            before: the factor of an earlier state of the same rows; None: there is none.

        Raises:
            SingularError: the rows do not determine all variables that they touch.
        """
        whole = self.normal_matrix()
        if before is not None:
            changed = ChangedNormals.of(before, whole, self._alive.values[self._key.values])
            if changed is not None:
                return changed
        matrix = coo_array(whole)
        keys = np.arange(self._first.n)
        pieces = -(-self._size.values // WIDTH)
        begin = np.cumsum(pieces) - pieces
        inside = np.arange(self._key.n) - self._first.values[self._key.values]
        node = begin[self._key.values] + inside // WIDTH
        place = WIDTH * node + inside % WIDTH
        alive = self._alive.values[self._key.values]
        n = int(pieces.sum())
        on = alive[matrix.row] & alive[matrix.col]
        rows, columns = place[matrix.row[on]], place[matrix.col[on]]
        a, b = rows // WIDTH, columns // WIDTH
        codes = np.unique((a * n + b)[a < b])
        found = self._pattern
        if found is None or found.pattern.n != n or not np.array_equal(found.codes, codes):
            first, second = np.divmod(codes, max(n, 1))
            pattern = BlockPattern(n, WIDTH, 0, first, second)
            owner = np.repeat(keys, pieces)
            positions = self._positions(owner, first, second)
            found = self._pattern = NormalPattern(codes, pattern, dissect(pattern, positions))
        blocks = BlockMatrix.zeros(found.pattern)
        blocks.places_of(rows, columns).add(blocks, matrix.data[on])
        free = np.zeros(n * WIDTH, dtype=bool)
        free[place[alive]] = True
        diagonal = np.einsum("nii->ni", blocks.diagonal).copy()
        diagonal[~free.reshape(n, WIDTH)] = 1.0
        i = np.arange(WIDTH)
        blocks.diagonal[:, i, i] = diagonal
        return SolvedNormals(Fronts.of(found.fronts, blocks), whole, place, alive, free)

    def _positions(self, owner: Index, first: Index, second: Index) -> Array:
        """Return where nodes are, (n, 3): points, and what they are joined to in their middle."""
        n = len(owner)
        at = np.full((self._first.n, 3), np.nan)
        table = self.tables.get("point")
        if table is not None:
            key = table.key.values
            at[key[key >= 0]] = table.theta.values[key >= 0, :3]
        known: Mask = np.isfinite(at[owner]).all(axis=1)
        out = np.where(known[:, None], at[owner], 0.0)
        joined = csr_array((np.ones(len(first)), (first, second)), shape=(n, n))
        joined = joined + joined.T
        for _ in range(2):  # what no point is joined to is near what is
            count = joined @ known.astype(float)
            middle = (joined @ np.where(known[:, None], out, 0.0)) / np.maximum(count, 1.0)[:, None]
            new = ~known & (count > 0)
            out[new], known = middle[new], known | new
        return out


class SolvedNormals:
    """A factorised normal matrix."""

    def __init__(
        self, fronts: Fronts, matrix: csc_array, place: Index, alive: Mask, free: Mask
    ) -> None:
        """Take the factor over.

        Args:
            fronts: the factor.
            matrix: the normal matrix, (n, n).
            place: place of each column in it, (n,).
            alive: which columns are determined by rows, (n,).
            free: which places are of such columns.
        """
        self._fronts, self._place, self.alive, self._free = fronts, place, alive, free
        self.matrix = matrix
        self._diagonal: Array | None = None

    def times(self, y: Array) -> Array:
        """Return N⁻¹ y for y (n, k); zero at columns without rows."""
        inner = np.zeros((len(self._free), y.shape[1]))
        inner[self._place[self.alive]] = y[self.alive]
        out = np.zeros_like(y)
        out[self.alive] = self._fronts.solve(inner)[self._place[self.alive]]
        return out

    def blocks(self, columns: Index) -> Array:
        """Return the covariances (m, 3, 3) of variables of three components at most.

        Args:
            columns: their columns, −1: held, (m, 3).
        """
        if self._diagonal is None:
            self._diagonal = self._fronts.inverse().diagonal
        safe = np.maximum(columns, 0)
        on = (columns >= 0) & self.alive[safe]
        node, place = self._place[safe] // WIDTH, self._place[safe] % WIDTH
        own = np.max(np.where(on, node, 0), axis=1)
        found = self._diagonal[own[:, None, None], place[:, :, None], place[:, None, :]]
        return np.where(on[:, :, None] & on[:, None, :], found, 0.0)


class ChangedNormals:
    """A factorised normal matrix N with changes Δ of a few columns E, without a new factor.

    (N + E Δ Eᵀ)⁻¹ = Q − Q E W EᵀQ,   W = (I + Δ G)⁻¹ Δ,   G = EᵀQE,   Q = N⁻¹.
    """

    def __init__(self, before: SolvedNormals, spread: Array, weight: Array) -> None:
        """Take the change over.

        Args:
            before: the factor.
            spread: Q E, (n, k).
            weight: W, (k, k).
        """
        self.before, self._spread, self._weight = before, spread, weight
        self.alive = before.alive

    @classmethod
    def of(cls, before: SolvedNormals, matrix: csc_array, alive: Mask) -> ChangedNormals | None:
        """Return the changes of a matrix; None where a new factor is better."""
        if before.matrix.shape != matrix.shape or not np.array_equal(before.alive, alive):
            return None
        change = coo_array(matrix - before.matrix)
        columns = np.unique(change.col[change.data != 0.0])
        if len(columns) > MAX_CHANGED_COLUMNS:
            return None
        unit = np.zeros((len(alive), len(columns)))
        unit[columns, np.arange(len(columns))] = 1.0
        spread = before.times(unit)
        delta = np.asarray(csc_array(change)[columns][:, columns].todense())
        size = np.eye(len(columns)) + delta @ spread[columns]
        if len(columns) and np.linalg.svd(size, compute_uv=False)[-1] < LEAST_CHANGE:
            return None
        weight = np.linalg.solve(size, delta)
        return cls(before, spread, 0.5 * (weight + weight.T))

    def times(self, y: Array) -> Array:
        """Return the inverse times y (n, k); zero at columns without rows."""
        change = self._spread @ (self._weight @ (self._spread.T @ y))
        return np.asarray(self.before.times(y) - change)

    def blocks(self, columns: Index) -> Array:
        """Return the covariances of variables, see `SolvedNormals.blocks`."""
        own = np.where((columns >= 0)[:, :, None], self._spread[columns], 0.0)
        return self.before.blocks(columns) - own @ self._weight @ own.transpose(0, 2, 1)
