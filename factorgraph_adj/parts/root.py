"""The root of a network in parts: the sum of the reduced normal equations of all parts."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ..solve.fronts import BlockMatrix, Fronts
from ..solve.remainder import Remainder
from ..solve.singular import SingularError
from ..types import Array, Index
from .junctions import Junctions, RootPlaces
from .messages import Reduced, unpacked

NAMED = 12
"""Largest number of junctions that a message names."""
SEARCHED = 4000
"""Largest number of columns for which undetermined combinations are searched densely."""
NULL = 1e-12
"""Eigenvalue of the scaled normal matrix below which a combination counts as undetermined."""


class Root:
    """The summed normal equations of the junctions at one point of the iteration."""

    def __init__(self, junctions: Junctions, places: RootPlaces) -> None:
        """Begin with nothing."""
        self.junctions, self.places = junctions, places
        pattern, self._order = places.layout
        self.matrix = BlockMatrix.zeros(pattern)
        self.right: Array = np.zeros(junctions.n_columns)
        """Σs."""
        self.diagonal: Array = np.zeros(junctions.n_columns)
        """Diagonal of N of all parts."""
        self._fronts: Fronts | None = None

    def add(self, number: int, reduced: Reduced) -> None:
        """Add the reduced normal equations of a part."""
        columns = self.junctions.columns[number]
        Remainder(columns, unpacked(reduced.normal)).add_to(self.places, self.matrix)
        np.add.at(self.right, columns, reduced.right)
        np.add.at(self.diagonal, columns, reduced.diagonal)

    def factorise(self, damping: float) -> float:
        """Factorise with λ diag(N) added; return the smallest pivot relative to diag(N).

        Raises:
            SingularError: the junctions are not determined.
        """
        m, places = self.matrix, self.places
        if damping > 0.0:
            places.add_diagonal(m, damping * self.diagonal)
        places.hold(m)
        self._fronts = Fronts(self._order, m)
        on = places.columns >= 0
        pivots = (self._fronts.pivots * self._fronts.diagonal)[on]
        whole = self.diagonal[places.columns[on]] * (1.0 + damping)
        return float(np.min(pivots / np.maximum(whole, np.finfo(float).tiny), initial=1.0))

    def solve(self) -> Array:
        """Return the movement of the junctions, (n_columns,)."""
        assert self._fronts is not None
        places = self.places
        y = np.zeros((len(places.columns), 1))
        on = places.columns >= 0
        y[on, 0] = -self.right[places.columns[on]]
        x = np.zeros(len(self.right))
        x[places.columns[on]] = self._fronts.solve(y)[on, 0]
        return x

    def covariances(self) -> Covariances:
        """Return the covariances of the junctions, for σ0 = 1."""
        assert self._fronts is not None
        return Covariances(self.places, self._fronts.inverse())

    def undetermined(self) -> tuple[int, list[str]]:
        """Return how many combinations are undetermined, and the junctions with a share in them.

        Large roots are not searched: then the number is 0 and the list is empty.
        """
        n = self.junctions.n_columns
        if n > SEARCHED:
            return 0, []
        places = self.places
        at = places.place_of[np.arange(n)]
        whole = _stored(places, self.matrix)[np.ix_(at, at)]
        scale = 1.0 / np.sqrt(np.where(self.diagonal > 0, self.diagonal, 1.0))
        values, vectors = np.linalg.eigh(whole * scale[:, None] * scale)
        null = vectors[:, values < NULL]
        share = np.sum(null**2, axis=1)
        order = np.argsort(-share, kind="stable")
        named = [self.junctions.name(int(i)) for i in order[:NAMED] if share[i] > 0.01]
        return null.shape[1], named


class Covariances:
    """The covariances of all junctions, at least between those of one part."""

    def __init__(self, places: RootPlaces, inverse: BlockMatrix) -> None:
        """Take in the selected inverse of the root."""
        self._places, self._inverse = places, inverse

    def of(self, columns: Index) -> Array:
        """Return the covariances (m, m) of columns that one part has."""
        at = self._places.place_of[columns]
        i, j = np.tril_indices(len(at))
        out = np.zeros((len(at), len(at)))
        out[i, j] = out[j, i] = self._inverse.at(at[i], at[j])
        return out


class Sums(NamedTuple):
    """Figures of all parts together."""

    vtpv: float
    """Value of vᵀPv."""
    smallest: float
    """Smallest pivot relative to its diagonal element of N."""
    resolution: float
    """Bound of a movement by one unit in the last digit of every value, relative to σ."""


def summed(root: Root, parts: Iterable[tuple[int, Reduced]]) -> Sums:
    """Add the reduced normal equations of all parts.

    Raises:
        SingularError: the interior of a part is not determined.
    """
    vtpv, smallest, rounding, singular = 0.0, 1.0, 0.0, list[int]()
    for number, reduced in parts:
        if not reduced.smallest > 0.0:
            singular.append(number)
            continue
        root.add(number, reduced)
        vtpv += reduced.vtpv
        smallest = min(smallest, reduced.smallest)
        rounding += reduced.rounding
    if singular:
        raise SingularError("the interior of a part is not determined")
    return Sums(vtpv, smallest, float(np.sqrt(rounding)))


def _stored(places: RootPlaces, m: BlockMatrix) -> Array:
    """Return the whole matrix of the root, dense."""
    n, w, side = places.n, places.width, places.side
    out = np.zeros((n, w, n, w))
    i = np.arange(n)
    out[i, :, i, :] = m.diagonal
    out[m.pattern.first, :, m.pattern.second, :] = m.pairs
    out[m.pattern.second, :, m.pattern.first, :] = m.pairs.transpose(0, 2, 1)
    whole = np.zeros((n * w + side,) * 2)
    whole[: n * w, : n * w] = out.reshape(n * w, n * w)
    across = m.side.reshape(n * w, side)
    whole[: n * w, n * w :], whole[n * w :, : n * w] = across, across.T
    whole[n * w :, n * w :] = m.corner
    return whole
