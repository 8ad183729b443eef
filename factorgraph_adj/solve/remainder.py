"""What the elimination of the terrestrial side leaves to the photos that it touches."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array, Index
from .fronts import BlockMatrix
from .places import Places


@dataclass(frozen=True)
class Remainder:
    """Normal equations over some columns of photos and shared calibrations."""

    columns: Index
    """The columns, (m,)."""
    normal: Array
    """Their normal matrix, (m, m)."""

    def touched(self, nodes: Places) -> Index:
        """Return the nodes that the columns belong to."""
        place = nodes.place_of[self.columns]
        inside = (place >= 0) & (place < nodes.n * nodes.width)
        return np.unique(place[inside] // nodes.width)

    def add_to(self, nodes: Places, matrix: BlockMatrix) -> None:
        """Add the normal matrix to the reduced system."""
        w, inner = nodes.width, nodes.n * nodes.width
        place = nodes.place_of[self.columns]
        on = place >= 0
        place, normal = place[on], self.normal[np.ix_(on, on)]
        own = self.touched(nodes)
        k = len(own)
        at = np.where(
            place < inner,
            w * np.searchsorted(own, place // w) + place % w,
            w * k + place - inner,
        )
        whole = np.zeros((w * k + nodes.side,) * 2)
        whole[np.ix_(at, at)] = normal
        blocks = whole[: w * k, : w * k].reshape(k, w, k, w)
        d = np.arange(k)
        matrix.diagonal[own] += blocks[d, :, d, :]
        i, j = np.triu_indices(k, 1)
        if len(i):
            matrix.pairs[matrix.find(own[i], own[j])] += blocks[i, :, j, :]
        matrix.side[own] += whole[: w * k, w * k :].reshape(k, w, nodes.side)
        matrix.corner += whole[w * k :, w * k :]


def joined(nodes: Places, remainders: Sequence[Remainder]) -> Index:
    """Return the pairs of nodes that remainders join, n a + b each, (k,)."""
    code = [np.zeros(0, dtype=np.intp)]
    for r in remainders:
        own = r.touched(nodes)
        i, j = np.triu_indices(len(own), 1)
        code.append(own[i] * nodes.n + own[j])
    return np.unique(np.concatenate(code))
