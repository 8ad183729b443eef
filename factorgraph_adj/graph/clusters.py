"""Clusters of one pattern in arrays: rows, whiteners, columns of their unknowns.

A pose graph has a cluster for each edge, tens of thousands of them, and all are of one or two
patterns: equal kinds of observations in equal order, equal components, equal unknowns in common.
What is computed of a cluster is computed of all clusters of a batch at once.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..types import Array, Index
from .blocks import Block
from .variables import Unknowns
from .weights import Cluster


@dataclass(frozen=True)
class ClusterSlot:
    """A variable of an observation in the clusters of a batch."""

    place: int
    """Place of the block of the observation."""
    observations: Index
    """Number of the observation in its block for each cluster, (m,)."""
    components: Index
    """Components of the observation that are in the cluster, (d,)."""
    at: Index
    """Their places among the rows of the cluster, (d,)."""
    variable: int
    """Place of the variable among those of the block."""
    columns: slice
    """Its places among the columns of the cluster."""


@dataclass(frozen=True)
class ClusterBatch:
    """Clusters of one pattern."""

    numbers: Index
    """Their numbers among all clusters, (m,)."""
    rows: Index
    """Scalar rows of each, (m, k)."""
    whitener: Array
    """W of each, (m, k, k)."""
    columns: Index
    """Columns of the unknowns of each, (m, w)."""
    slots: tuple[ClusterSlot, ...]
    """Their variables that have columns."""


def cluster_batches(
    clusters: Sequence[Cluster], blocks: Sequence[Block], unknowns: Unknowns
) -> tuple[ClusterBatch, ...]:
    """Return clusters in batches of one pattern.

    Args:
        clusters: the clusters.
        blocks: the blocks of observations with all their rows.
        unknowns: the unknowns of the network.
    """
    by_size: dict[int, list[int]] = defaultdict(list)
    for number, c in enumerate(clusters):
        by_size[len(c.rows)].append(number)
    first_rows = np.array([b.first_row for b in blocks], dtype=np.intp)
    dimensions = np.array([b.dimension for b in blocks], dtype=np.intp)
    out = []
    for some in by_size.values():
        numbers = np.array(some, dtype=np.intp)
        rows = np.stack([clusters[n].rows for n in some])
        place = np.searchsorted(first_rows, rows, side="right") - 1
        observation, component = np.divmod(rows - first_rows[place], dimensions[place])
        firsts = first_equal(rows - component)  # the first row of an observation is its own
        for own in alike(np.concatenate([place, component, firsts], axis=1)):
            parts = [
                (int(place[own[0], f]), observation[own, f], component[own[0], at], at)
                for f in np.unique(firsts[own[0]]).tolist()
                for at in [np.flatnonzero(firsts[own[0]] == f)]
            ]
            for on, columns, slots in _by_columns(parts, blocks, unknowns, len(own)):
                at_once = own[on]
                whitener = np.stack([clusters[n].whitener for n in numbers[at_once].tolist()])
                out.append(ClusterBatch(numbers[at_once], rows[at_once], whitener, columns, slots))
    return tuple(out)


def _by_columns(
    parts: Sequence[tuple[int, Index, Index, Index]],
    blocks: Sequence[Block],
    unknowns: Unknowns,
    n: int,
) -> Iterator[tuple[Index, Index, tuple[ClusterSlot, ...]]]:
    """Yield clusters whose observations have the same unknowns in common, and their columns.

    Args:
        parts: place of the block, number of the observation for each cluster (n,), components in
            the cluster and their places there, of each observation.
        blocks: the blocks.
        unknowns: the unknowns.
        n: number of clusters.
    """
    variables = [
        (part, j, unknowns[kind], index[part[1]])
        for part in parts
        for j, (kind, index) in enumerate(blocks[part[0]].variables)
    ]
    if not variables:
        yield np.arange(n), np.zeros((n, 0), dtype=np.intp), ()
        return
    offsets = np.stack([table.offset[index] for _, _, table, index in variables], axis=1)
    sizes = np.stack([table.size[index] for _, _, table, index in variables], axis=1)
    firsts = np.where(offsets >= 0, first_equal(offsets), -1)
    for on in alike(np.concatenate([firsts, np.where(offsets >= 0, sizes, 0)], axis=1)):
        first, size = firsts[on[0]].tolist(), sizes[on[0]].tolist()
        begin: dict[int, int] = {}
        columns = [np.zeros((len(on), 0), dtype=np.intp)]
        slots = []
        for i, (part, j, _, _) in enumerate(variables):
            if first[i] < 0:
                continue
            if first[i] == i:
                begin[i] = sum(c.shape[1] for c in columns)
                columns.append(offsets[on, i, None] + np.arange(size[i]))
            own = slice(begin[first[i]], begin[first[i]] + size[i])
            slots.append(ClusterSlot(part[0], part[1][on], part[2], part[3], j, own))
        yield on, np.concatenate(columns, axis=1), tuple(slots)


def first_equal(values: Index) -> Index:
    """Return the place of the first equal value of each row of values, (n, k)."""
    return np.asarray((values[:, :, None] == values[:, None, :]).argmax(axis=2), dtype=np.intp)


def alike(pattern: Index) -> list[Index]:
    """Return the numbers of the rows of each pattern (n, k), in the order of their first ones."""
    if len(pattern) == 1:
        return [np.zeros(1, dtype=np.intp)]
    _, first, number = np.unique(pattern, axis=0, return_index=True, return_inverse=True)
    number = number.ravel()
    return [np.flatnonzero(number == i) for i in np.argsort(first).tolist()]
