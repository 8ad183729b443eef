"""Lengths of levelled lines that contradict the places of their ends: metres for kilometres.

Where the places of the ends are not known, other lines bound their distance: the ends of a line lie
no further apart than the shortest way along the stated lengths of the others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array, Index

FAR = 100.0
"""Ratio of the stated length to the distance of the ends, or its inverse, from which it is doubted:
no line is shorter than the straight one, and none takes a hundred times the way."""
APART = 1.0
"""Smallest horizontal distance of ends that is compared, metres."""


@dataclass(frozen=True)
class _Lines:
    """Levelled lines with stated lengths."""

    ends: Index
    """Numbers of their points, (n, 2)."""
    stated: Array
    """Their lengths, (n,) metres."""
    labels: list[str]
    """Their names, (n,)."""


def wrong_line_lengths(equations: Equations, state: State) -> list[str]:
    """Return doubts about stated lengths of levelled lines.

    Args:
        equations: the network.
        state: coordinates of all points, adjusted or approximate.
    """
    lines = _stated(equations)
    if not len(lines.stated):
        return []
    apart = _distances(equations, state, lines)
    apart[~(apart > APART)] = np.nan
    around = np.where(np.isnan(apart), _ways_around(lines), np.nan)
    return [
        *_told(lines, apart, "{:.1f} m apart"),
        *_told(lines, around, "that other lines join over {:.0f} m"),
    ]


def _stated(equations: Equations) -> _Lines:
    """Return the lines whose lengths are stated."""
    ends, stated, labels = [np.zeros((0, 2), dtype=np.intp)], [np.zeros(0)], []
    for block in equations.blocks:
        points = [index for kind, index in block.variables if kind == "point"]
        if block.prior or len(points) < 2:
            continue
        found = (equations.network.observations.get(i) for i in block.ids)
        km = np.array([getattr(o, "length_km", None) or np.nan for o in found], dtype=float)
        rows = np.flatnonzero(np.isfinite(km))
        ends.append(np.column_stack([points[0][rows], points[1][rows]]))
        stated.append(1e3 * km[rows])
        labels += [block.labels(int(i)) for i in rows]
    return _Lines(np.concatenate(ends), np.concatenate(stated), labels)


def _distances(equations: Equations, state: State, lines: _Lines) -> Array:
    """Return the horizontal distances of the ends, (n,) metres."""
    start, end = (state["point"][lines.ends[:, i]] for i in (0, 1))
    enu = equations.network.frame.basis(start, np.zeros((len(start), 2))).enu
    return np.asarray(np.hypot(*np.einsum("nij,nj->ni", enu, end - start)[:, :2].T))


def _ways_around(lines: _Lines) -> Array:
    """Return the shortest ways along other lines, (n,) metres; NaN: not much shorter than it."""
    out = np.full(len(lines.stated), np.nan)
    long = np.flatnonzero(lines.stated > FAR * lines.stated.min())
    if not len(long):
        return out
    used, at = np.unique(lines.ends, return_inverse=True)
    at = at.reshape(-1, 2)
    key = np.sort(at, axis=1) @ np.array([len(used), 1])
    order = np.lexsort((lines.stated, key))
    shortest = order[np.unique(key[order], return_index=True)[1]]  # of lines with the same ends
    a, b = at[shortest].T
    graph = coo_array((lines.stated[shortest], (a, b)), shape=(len(used), len(used))).tocsr()
    roots, root = np.unique(at[long, 0], return_inverse=True)
    way = dijkstra(graph, directed=False, indices=roots)[root, at[long, 1]]
    # A way as long as the line is the line itself.
    out[long] = np.where((way < lines.stated[long]) & (way > APART), way, np.nan)
    return out


def _told(lines: _Lines, apart: Array, where: str) -> list[str]:
    """Return what is said of lengths that contradict; nothing if none does.

    Args:
        lines: the lines.
        apart: how far apart their ends are, or are at most, (n,) metres; NaN: nobody knows.
        where: what it says of the points.
    """
    ratio = lines.stated / apart
    wrong = np.flatnonzero((ratio > FAR) | (ratio < 1.0 / FAR))
    if not len(wrong):
        return []
    first = int(wrong[0])
    unit = "metres" if ratio[first] > FAR else "thousands of kilometres"
    told = (
        f"the lengths of {len(wrong)} lines contradict the places of their ends, the first"
        if len(wrong) > 1
        else "the length of a line contradicts the places of its ends,"
    )
    return [
        f"{told} {lines.labels[first]}: {lines.stated[first] / 1e3:g} km between points "
        f"{where.format(apart[first])}; is it in {unit}? The weight of a line depends on its length"
    ]
