"""Patterns of points: grids, corners, perimeters, points spread over others, nearest ones."""

from __future__ import annotations

import numpy as np

from ...types import Array, Index

JITTER = 0.3
"""Largest shift of a point from its place in a jittered grid, as a fraction of the grid's width."""


def jittered_grid(low: Array, high: Array, spacing: float, rng: np.random.Generator) -> Array:
    """Return plan coordinates (n, 2) of a jittered grid that fills a rectangle, column by column.

    Args:
        low: smallest X and Y, metres.
        high: largest X and Y, metres.
        spacing: approximate width of the grid; the exact width is fitted to the rectangle.
        rng: generator of the shifts, up to `JITTER` of the width.
    """
    size = np.asarray(high) - low
    columns, rows = np.maximum(1, np.round(size / spacing)).astype(int)
    x, y = ((np.arange(n) + 0.5) / n for n in (columns, rows))
    grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=2).reshape(-1, 2)
    grid += rng.uniform(-JITTER, JITTER, grid.shape) / [columns, rows]
    return np.asarray(low + grid * size)


def corners(xy: Array) -> list[int]:
    """Return the numbers of the points (n, 2) nearest to the corners of their rectangle."""
    middle, half = (xy.max(0) + xy.min(0)) / 2, np.ptp(xy, axis=0) / 2
    signs = ((-1, -1), (1, -1), (1, 1), (-1, 1))
    return list(
        dict.fromkeys(int(np.argmin(np.sum((xy - middle - half * s) ** 2, axis=1))) for s in signs)
    )


def perimeter(xy: Array) -> list[int]:
    """Return the numbers of the points (n, 2) on the edge, in order around it.

    The rectangle of the points is divided into columns and rows as wide as the spacing of the
    points; the first and the last point of each column and row are on the edge. For a regular
    grid this is its edge. The order is by azimuth from the middle of the rectangle, anticlockwise
    from its lower left corner.
    """
    n = len(xy)
    size = np.maximum(np.ptp(xy, axis=0), 1e-9)
    width = np.maximum(np.sqrt(size.prod() / n), size.max() / n)
    cuts = np.clip(np.round(size / width).astype(int), 1, n)
    cell = np.minimum(((xy - xy.min(axis=0)) / size * cuts).astype(int), cuts - 1)
    chosen: set[int] = set()
    for across, along in ((0, 1), (1, 0)):
        for c in range(cuts[across]):
            inside = np.flatnonzero(cell[:, across] == c)
            if inside.size:
                t = xy[inside, along]
                chosen |= {int(inside[np.argmin(t)]), int(inside[np.argmax(t)])}
    # Scaling by the half sides avoids crowded azimuths at the ends of a long block.
    d = (xy - (xy.max(axis=0) + xy.min(axis=0)) / 2) / size
    turn = (np.arctan2(d[:, 1], d[:, 0]) + 0.75 * np.pi) % (2 * np.pi)
    return sorted(chosen, key=lambda i: (float(turn[i]), i))


def spread(xy: Array, count: int, first: list[int]) -> list[int]:
    """Return the numbers of ``count`` points (n, 2) that are far from one another.

    The first points are given; each further point is the one farthest from all chosen points.
    """
    chosen = first[:count]
    if not chosen:
        return []
    nearest = np.min(np.linalg.norm(xy[:, None] - xy[chosen], axis=2), axis=1)
    while len(chosen) < min(count, len(xy)):
        far = int(np.argmax(nearest))
        chosen.append(far)
        nearest = np.minimum(nearest, np.linalg.norm(xy - xy[far], axis=1))
    return sorted(chosen)


def round_lines(n: int, count: int) -> list[tuple[int, int]]:
    """Return ``count`` lines along a ring of n places, evenly spread.

    The first n lines join neighbours; further lines join every second place, then every third. No
    pair is joined twice: at most n (n − 1) / 2 lines are possible.
    """
    lines: dict[tuple[int, int], None] = {}
    for step in range(1, n // 2 + 1):
        # For a step of half the ring, the second half repeats the lines of the first, reversed.
        ring = [(i, (i + step) % n) for i in range(n // 2 if 2 * step == n else n)]
        missing = count - len(lines)
        chosen = (
            ring
            if missing >= len(ring)
            else [ring[k * len(ring) // missing] for k in range(missing)]
        )
        lines |= dict.fromkeys(chosen)
        if len(lines) >= count:
            break
    return list(lines)


def nearest_lines(xyz: Array, count: int) -> list[tuple[int, int]]:
    """Return ``count`` short lines between points (n, 3).

    First, each point is joined to its nearest one, up to ``count`` lines; then the shortest of
    all other lines follow.
    """
    length = np.linalg.norm(xyz[:, None] - xyz[None, :], axis=2)
    np.fill_diagonal(length, np.inf)
    near: Index = np.argmin(length, axis=1)
    own = {(min(i, int(j)), max(i, int(j))): None for i, j in enumerate(near)}
    lines = dict(sorted(own.items(), key=lambda item: float(length[item[0]])))
    i, j = np.triu_indices(len(xyz), 1)
    order = np.argsort(length[i, j], kind="stable")
    for a, b in zip(i[order].tolist(), j[order].tolist(), strict=True):
        if len(lines) >= count:
            break
        lines[a, b] = None
    return list(lines)[:count]
