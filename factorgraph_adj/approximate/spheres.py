"""Points in space from slope distances alone, and heights from slope distances and known plan."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from ..types import Array
from .loci import CAP, NOISE, SAME, SURE
from .progress import Progress

MOST_SPHERES = 8
"""Largest number of distances of one point that are intersected by threes."""
MOST_STARTS = 20
"""Largest number of points whose triangles may start a network."""


def three_spheres(centre: Array, radius: Array) -> list[Array]:
    """Return the two points (3,) at given distances from three points; empty: these lie on a line.

    Args:
        centre: the three points, (3, 3), metres.
        radius: the distances, (3,), metres. Spheres that narrowly miss each other give one point.
    """
    e1 = centre[1] - centre[0]
    d = float(np.linalg.norm(e1))
    if d == 0.0:
        return []
    e1 = e1 / d
    w = centre[2] - centre[0]
    i = float(w @ e1)
    e2 = w - i * e1
    j = float(np.linalg.norm(e2))
    if j < 1e-3 * d:
        return []
    e2 = e2 / j
    x = (radius[0] ** 2 - radius[1] ** 2 + d * d) / (2 * d)
    y = (radius[0] ** 2 - radius[2] ** 2 + i * i + j * j) / (2 * j) - i / j * x
    z2 = radius[0] ** 2 - x * x - y * y
    if z2 < -((0.1 * radius[0]) ** 2):
        return []
    z = float(np.sqrt(max(z2, 0.0)))
    foot = centre[0] + x * e1 + y * e2
    e3 = np.cross(e1, e2)
    return [foot + z * e3, foot - z * e3] if z > 0 else [foot]


def spheres(progress: Progress) -> bool:
    """Fill points that three or more slope distances from complete points determine uniquely.

    A known height decides between two positions, or replaces a distance.

    Returns:
        Whether any point was found.
    """
    led_on = False
    for p, found in positions_in_space(progress):
        if len(found) == 1:
            led_on |= _place(progress, p, found[0])
    return led_on


def _place(progress: Progress, p: int, xyz: Array) -> bool:
    at = progress.horizon.to_plan(xyz[None])
    placed = progress.set_plan(np.array([p]), at[:, :2])
    return progress.set_height(np.array([p]), at[:, 2]) or placed


def positions_in_space(progress: Progress) -> list[tuple[int, list[Array]]]:
    """Return points with slope distances to complete points, and the positions that fit best.

    Positions (3,) are in the frame, metres. A point has several if they fit equally well.
    """
    e = progress.survey.edges
    complete = progress.complete
    usable = np.flatnonzero(np.isfinite(e.slope) & (complete[e.a] != complete[e.b]))
    far = np.where(complete[e.a[usable]], e.b[usable], e.a[usable])
    out = []
    for p in np.unique(far).tolist():
        rows = usable[far == p]
        near = np.where(e.a[rows] == p, e.b[rows], e.a[rows])
        centre = progress.horizon.from_plan(progress.plan[near])
        radius = e.slope[rows]
        found = _best(progress, p, _options(progress, p, centre, radius), centre, radius)
        if found:
            out.append((p, found))
    return out


def _options(progress: Progress, p: int, centre: Array, radius: Array) -> list[Array]:
    """Return the positions where three spheres meet, or spheres and a known plan, (3,) each."""
    if progress.placed[p]:
        plan = progress.plan[p]
        near = progress.horizon.to_plan(centre)
        up = np.sqrt(np.maximum(radius**2 - np.sum((near[:, :2] - plan[:2]) ** 2, axis=1), 0.0))
        heights = np.concatenate([near[:, 2] + up, near[:, 2] - up])
        at = np.column_stack([np.tile(plan[:2], (len(heights), 1)), heights])
        return list(progress.horizon.from_plan(at))
    chosen = range(min(len(radius), MOST_SPHERES))
    return [
        at
        for three in combinations(chosen, 3)
        for at in three_spheres(centre[list(three)], radius[list(three)])
    ]


def _best(
    progress: Progress, p: int, options: list[Array], centre: Array, radius: Array
) -> list[Array]:
    """Return the options that fit best, each position once."""
    if not options:
        return []
    at = np.array(options)
    size = float(radius.max())
    off = np.abs(np.linalg.norm(at[:, None] - centre[None], axis=2) - radius) / size
    plan = progress.horizon.to_plan(at)
    known = np.isfinite(progress.plan[p])
    off = np.concatenate([off, np.abs(plan[:, known] - progress.plan[p, known]) / size], axis=1)
    misfit = np.minimum(off, CAP).mean(axis=1)
    limit = SURE * misfit.min() + NOISE
    distinct: list[Array] = []
    for i in np.argsort(misfit, kind="stable"):
        new = all(np.linalg.norm(at[i] - d) > SAME * size for d in distinct)
        if new and (misfit[i] < limit or not distinct):
            distinct.append(at[i])
    return distinct


def start_in_space(progress: Progress) -> bool:
    """Start a free network of slope distances only: a triangle, and a fourth point above it.

    Returns:
        Whether the network was started.
    """
    e = progress.survey.edges
    if np.isfinite(progress.plan).any() or not np.isfinite(e.slope).any():
        return False
    length: dict[int, dict[int, float]] = {}
    for a, b, s in zip(e.a.tolist(), e.b.tolist(), e.slope.tolist(), strict=True):
        if np.isfinite(s):
            length.setdefault(a, {})[b] = length.setdefault(b, {})[a] = s
    best: tuple[int, float, tuple[int, int, int]] | None = None
    for a in sorted(length, key=lambda k: -len(length[k]))[:MOST_STARTS]:
        for b, c in combinations(length[a], 2):
            if c in length[b]:
                shared = len(length[a].keys() & length[b].keys() & length[c].keys())
                sides = (length[a][b], length[a][c], length[b][c])
                size = _sine(*sides)
                if best is None or (min(shared, 1), size) > best[:2]:
                    best = (min(shared, 1), size, (a, b, c))
    if best is None:
        return False
    a, b, c = best[2]
    ab, ac, bc = length[a][b], length[a][c], length[b][c]
    north = (ab**2 + ac**2 - bc**2) / (2 * ab)
    east = float(np.sqrt(max(ac**2 - north**2, 0.0)))
    progress.plan[[a, b, c]] = [[0.0, 0.0, 0.0], [0.0, ab, 0.0], [east, north, 0.0]]
    for p, found in positions_in_space(progress):
        if len(found) == 2:
            _place(progress, p, max(found, key=lambda at: float(at[2])))
            break
    return True


def _sine(ab: float, ac: float, bc: float) -> float:
    """Return the sine of the angle at A of a triangle; 0 if the sides form no triangle."""
    cosine = (ab**2 + ac**2 - bc**2) / (2 * ab * ac)
    return float(np.sqrt(max(1.0 - cosine**2, 0.0)))
