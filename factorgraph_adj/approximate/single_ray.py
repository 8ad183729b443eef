"""Points by one image ray and a height, plan or length, or by nearly parallel rays."""

from __future__ import annotations

import numpy as np

from ..types import Array, Mask
from .loci import NOISE
from .progress import Progress
from .rays import ImageRays, posed, world_rays
from .survey import group_median


def ray_and_more(progress: Progress, rays: ImageRays) -> bool:
    """Fill points that one ray of a known photo and a height, a plan or a length determine.

    Returns:
        Whether any point was found.
    """
    rows = np.flatnonzero(~progress.complete[rays.point] & posed(progress)[rays.photo])
    if not len(rows):
        return False
    _, first = np.unique(rays.point[rows], return_index=True)
    rows = rows[first]
    # Of many points that only rays reach, none has a length or a known component.
    edges = progress.survey.edges
    helped: Mask = np.any(np.isfinite(progress.plan), axis=1)
    helped[edges.a] = helped[edges.b] = True
    rows = rows[helped[rays.point[rows]]]
    if not len(rows):
        return False
    centre, direction = world_rays(progress, rays, rows)
    led_on = False
    for p, x0, d in zip(rays.point[rows].tolist(), centre, direction, strict=True):
        plan = progress.plan[p]
        ends = progress.horizon.to_plan(np.stack([x0, x0 + d]))
        step = ends[1] - ends[0]
        known = np.isfinite(plan)
        s = _along(ends[0], step, plan, known) if known.any() else _by_length(progress, p, x0, d)
        if s > 0:
            at = progress.horizon.to_plan((x0 + s * d)[None])
            placed = progress.set_plan(np.array([p]), at[:, :2])
            led_on |= progress.set_height(np.array([p]), at[:, 2]) or placed
    return led_on


def _along(start: Array, step: Array, plan: Array, known: Mask) -> float:
    """Return the distance along the ray to its point nearest to the known components."""
    length2 = float(np.sum(step[known] ** 2))
    if length2 < 1e-4:
        return np.nan
    return float(np.sum((plan - start)[known] * step[known]) / length2)


def _by_length(progress: Progress, p: int, x0: Array, d: Array) -> float:
    """Return the distance along the ray at which slope distances to known points fit."""
    e = progress.survey.edges
    complete = progress.complete
    other = np.where(e.a == p, e.b, e.a)
    rows = np.flatnonzero(((e.a == p) | (e.b == p)) & np.isfinite(e.slope) & complete[other])
    if not len(rows):
        return np.nan
    to = progress.horizon.from_plan(progress.plan[other[rows]]) - x0
    foot = to @ d
    gap2 = np.sum(to * to, axis=1) - foot**2
    half = np.sqrt(np.maximum(e.slope[rows] ** 2 - gap2, 0.0))
    options = np.concatenate([foot - half, foot + half])
    options = options[options > 0]
    if not len(options):
        return np.nan
    at = x0 + options[:, None] * d
    known = x0 + to
    off = np.abs(np.linalg.norm(at[:, None] - known[None], axis=2) - e.slope[rows]).mean(axis=1)
    best = int(np.argmin(off))
    apart = np.abs(options - options[best]) > 0.02 * e.slope[rows].max()
    if np.any(off[apart] < 3 * off[best] + NOISE * e.slope[rows].max()):
        return np.nan
    return float(options[best])


def far_points(progress: Progress, rays: ImageRays) -> bool:
    """Place points with nearly parallel rays, or behind the photos, at the depth of the scene.

    Two or more rays determine the position of such a point across the rays. Noise hides the depth;
    the median depth of the known points of the photos replaces it. An adjustment improves the
    depth, or reports that the point is not determined.

    Returns:
        Whether any point was found.
    """
    complete = progress.complete
    usable = posed(progress)[rays.photo]
    rows = np.flatnonzero(usable & ~complete[rays.point])
    rows = rows[np.bincount(rays.point[rows], minlength=len(complete))[rays.point[rows]] >= 2]
    seen = np.flatnonzero(usable & complete[rays.point])
    if not len(rows) or not len(seen):
        return False
    centre, direction = world_rays(progress, rays, seen)
    x = progress.horizon.from_plan(progress.plan[rays.point[seen]])
    distance = np.einsum("ni,ni->n", x - centre, direction)
    scene = group_median(rays.photo[seen], distance, len(progress.pose))
    scene = np.where(scene > 0, scene, np.median(np.abs(distance)))
    centre, direction = world_rays(progress, rays, rows)
    at = centre + scene[rays.photo[rows]][:, None] * direction
    points = np.unique(rays.point[rows])
    number = np.searchsorted(points, rays.point[rows])
    count = np.bincount(number)
    mean = np.stack([np.bincount(number, at[:, c]) / count for c in range(3)], 1)
    plan = progress.horizon.to_plan(mean)
    placed = progress.set_plan(points, plan[:, :2])
    return progress.set_height(points, plan[:, 2]) or placed
