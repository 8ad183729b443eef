"""Dense fronts by QR of the rows of the observations instead of Cholesky of normal equations.

Each front takes in the rows whose first node it eliminates, and what its children leave. With the
columns that it eliminates (o) and the columns that remain (b),

    Qᵀ A = | R_oo  R_ob |
           |  0    R_bb |,        L = R_ooᵀ,   B = R_obᵀ,

and R_bb are rows of the parent. Normal equations are never formed, so that twice the digits are
left; the price is about six times the operations. Solutions and covariances are those of
`factorgraph_adj.solve.fronts`, from L and B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from ..errors import SingularError
from ..types import Array, Index, Mask
from .fronts import Fronts, RootFront
from .nested_dissection import BlockPattern, Front

ROWS_FOR_EACH_COLUMN = 4
"""Number of rows for each column that are triangularised at once: memory for the rows of a front
that many children leave rows to stays in proportion to its square."""
QR_BLOCK_COLUMNS = 32
"""Number of columns that LAPACK reflects together."""


@dataclass(frozen=True)
class RowElements:
    """Rows by places of the reduced system, as their elements."""

    row: Index
    """Number of the row of each element, (k,)."""
    place: Index
    """Place of each element, (k,)."""
    value: Array
    """Its value, (k,); elements at the same place of a row are added."""
    n_rows: int
    """Number of rows."""

    @classmethod
    def joined(cls, parts: Sequence[RowElements]) -> RowElements:
        """Return the rows of several parts, one below the other."""
        first = np.cumsum([0, *(p.n_rows for p in parts)]).tolist()
        return cls(
            np.concatenate([p.row + n for p, n in zip(parts, first, strict=False)]),
            np.concatenate([p.place for p in parts]),
            np.concatenate([p.value for p in parts]),
            first[-1],
        )


def fronts_by_qr(
    fronts: list[Front], pattern: BlockPattern, rows: RowElements, held: Mask
) -> Fronts:
    """Return the factor of AᵀA, from the rows A.

    Args:
        fronts: the fronts in the order of elimination; the last one has no border.
        pattern: the blocks that rows touch.
        rows: A.
        held: places that no row touches and that are not unknowns, (n w + k,).

    Raises:
        SingularError: A has not the rank of its columns.
    """
    w, inner = pattern.width, pattern.n * pattern.width
    with np.errstate(over="ignore"):  # coordinates may have diverged
        diagonal = _summed(rows.place, rows.value**2, len(held))
    if not np.isfinite(diagonal).all():
        raise SingularError("the rows of the observations have no pivots")
    scale = 1.0 / np.sqrt(np.where(diagonal > 0.0, diagonal, 1.0))
    starts, number, place, value = _by_front(fronts, pattern, rows, scale)
    at = np.full(len(held), -1, dtype=np.intp)
    waiting: dict[int, tuple[Index, Array]] = {}
    made: list[tuple[Array, Array]] = []
    border = inner + np.arange(pattern.side)
    for front, start, stop in zip(fronts, starts[:-1], starts[1:], strict=True):
        own = (w * front.own[:, None] + np.arange(w)).ravel()
        later = np.concatenate([(w * front.border[:, None] + np.arange(w)).ravel(), border])
        if front is fronts[-1]:
            own, later = np.concatenate([own, border]), border[:0]
        mine, rest = np.flatnonzero(~held[own]), np.flatnonzero(~held[later])
        columns = np.concatenate([own[mine], later[rest]])
        at[columns] = np.arange(len(columns))
        pieces = [
            _dense(number[start:stop], at[place[start:stop]], value[start:stop], len(columns))
        ]
        for child in front.children:
            there, left = waiting.pop(id(child))
            piece = np.zeros((len(left), len(columns)))
            piece[:, at[there]] = left
            pieces.append(piece)
        r, o = _triangle(pieces, len(columns)), len(mine)
        if len(r) < o or not r.diagonal()[:o].all() or not np.isfinite(r).all():
            raise SingularError("a pivot vanished")
        root = np.eye(len(own), order="F")
        root[mine[:, None], mine] = r[:o, :o].T
        across = np.zeros((len(later), len(own)), order="F")
        across[rest[:, None], mine] = r[:o, o:].T
        made.append((root, across))
        waiting[id(front)] = (columns[o:], r[o:, o:])
    last, _ = made.pop()
    return Fronts(fronts, pattern, diagonal, made, RootFront.whole(last))


def _by_front(
    fronts: Sequence[Front], pattern: BlockPattern, rows: RowElements, scale: Array
) -> tuple[list[int], Index, Index, Array]:
    """Return the elements of the rows by the front that takes them in.

    Returns:
        First element of each front and the end, (fronts + 1,); and number of the row, place and
        scaled value of every element, by ascending rows in each front.
    """
    value = rows.value * scale[rows.place]
    w = pattern.width
    front_of = np.full(len(scale), len(fronts) - 1, dtype=np.intp)
    for number, front in enumerate(fronts):
        front_of[(w * front.own[:, None] + np.arange(w)).ravel()] = number
    first = np.full(rows.n_rows, len(fronts), dtype=np.intp)
    np.minimum.at(first, rows.row, front_of[rows.place])
    of = first[rows.row]
    order = np.argsort(of * rows.n_rows + rows.row, kind="stable")
    starts = np.searchsorted(of[order], np.arange(len(fronts) + 1))
    return starts.tolist(), rows.row[order], rows.place[order], value[order]


def _dense(number: Index, column: Index, value: Array, n: int) -> Array:
    """Return rows (m, n) from the ascending numbers of their rows, and their columns."""
    row = np.zeros(len(number), dtype=np.intp)
    np.cumsum(number[1:] != number[:-1], out=row[1:])
    m = int(row[-1]) + 1 if len(row) else 0
    return _summed(row * n + column, value, m * n).reshape(m, n)


def _summed(place: Index, value: Array, n: int) -> Array:
    """Return the sums of values at the same of n places."""
    return np.asarray(np.bincount(place, weights=value, minlength=n), dtype=float)


def _triangle(pieces: list[Array], n: int) -> Array:
    """Return R of rows (m, n) in pieces, with positive diagonal: (min(m, n), n)."""
    r, waiting, count = np.zeros((0, n)), list[Array](), 0
    for i, piece in enumerate(pieces):
        waiting.append(piece)
        count += len(piece)
        if count > ROWS_FOR_EACH_COLUMN * n or i == len(pieces) - 1:
            r, waiting, count = _reflected(np.concatenate([r, *waiting])), [], 0
    return r


def _reflected(a: Array) -> Array:
    """Return R of rows."""
    k = min(a.shape)
    if not k:
        return a[:k]
    work = QR_BLOCK_COLUMNS * a.shape[1]
    r, _, _, _ = lapack.dgeqrf(np.asfortranarray(a), lwork=work, overwrite_a=1)
    r = np.triu(r[:k])
    return np.asarray(np.where(r.diagonal()[:, None] < 0.0, -r, r))
