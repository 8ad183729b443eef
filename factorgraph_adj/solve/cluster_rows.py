"""Whitened partials of the clusters of one pattern."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..graph.clusters import ClusterBatch
from ..types import Array, Index


@dataclass(frozen=True)
class ClusterRows:
    """The whitened rows of a batch of clusters."""

    batch: ClusterBatch
    """The clusters."""
    columns: Index
    """Columns that the rows touch, (m, w)."""
    a: Array
    """Whitened partials, (m, k, w)."""

    @classmethod
    def of(cls, batch: ClusterBatch, partials: Sequence[tuple[Array, ...]]) -> ClusterRows:
        """Return the rows of a batch.

        Args:
            batch: the clusters.
            partials: partials of each block by each variable (n, d, k), not whitened in clusters;
                empty for variables that are held.
        """
        a = np.zeros((*batch.rows.shape, batch.columns.shape[1]))
        filled = np.zeros(batch.columns.shape[1], dtype=bool)
        for slot in batch.slots:
            found = partials[slot.place][slot.variable]
            if not len(found):
                continue
            size = slot.columns.stop - slot.columns.start
            own = found[slot.observations][:, slot.components, :size]
            a[:, slot.at, slot.columns] += own
            filled[slot.columns] = True
        if filled.all():  # the same array in every iteration: its places are known
            return cls(batch, batch.columns, batch.whitener @ a)
        return cls(batch, batch.columns[:, filled], batch.whitener @ a[:, :, filled])
