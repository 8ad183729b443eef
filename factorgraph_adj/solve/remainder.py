"""What the elimination of the terrestrial side leaves to the photos that it touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Array, Index
from .fronts import BlockMatrix
from .rays import Rays


@dataclass(frozen=True)
class Remainder:
    """Normal equations over some columns of photos and shared calibrations."""

    columns: Index
    """The columns, (m,)."""
    normal: Array
    """Their normal matrix, (m, m)."""

    def nodes(self, rays: Rays) -> Index:
        """Return the nodes that the columns belong to."""
        place = rays.place_of[self.columns]
        inside = (place >= 0) & (place < len(rays.photos) * rays.width)
        return np.unique(place[inside] // rays.width)

    def add_to(self, rays: Rays, matrix: BlockMatrix) -> None:
        """Add the normal matrix to the reduced system."""
        w, inner = rays.width, len(rays.photos) * rays.width
        place = rays.place_of[self.columns]
        on = place >= 0
        place, normal = place[on], self.normal[np.ix_(on, on)]
        nodes = self.nodes(rays)
        k = len(nodes)
        at = np.where(
            place < inner,
            w * np.searchsorted(nodes, place // w) + place % w,
            w * k + place - inner,
        )
        whole = np.zeros((w * k + rays.side,) * 2)
        whole[np.ix_(at, at)] = normal
        blocks = whole[: w * k, : w * k].reshape(k, w, k, w)
        d = np.arange(k)
        matrix.diagonal[nodes] += blocks[d, :, d, :]
        i, j = np.triu_indices(k, 1)
        if len(i):
            matrix.pairs[matrix.find(nodes[i], nodes[j])] += blocks[i, :, j, :]
        matrix.side[nodes] += whole[: w * k, w * k :].reshape(k, w, rays.side)
        matrix.corner += whole[w * k :, w * k :]


def joined(rays: Rays, remainders: list[Remainder]) -> Index:
    """Return the pairs of nodes that remainders join, in ascending order, (k, 2)."""
    n = len(rays.photos)
    code = [np.zeros(0, dtype=np.intp)]
    for r in remainders:
        nodes = r.nodes(rays)
        i, j = np.triu_indices(len(nodes), 1)
        code.append(nodes[i] * n + nodes[j])
    every = np.unique(np.concatenate(code))
    return np.stack([every // n, every % n], 1) if n else np.zeros((0, 2), dtype=np.intp)
