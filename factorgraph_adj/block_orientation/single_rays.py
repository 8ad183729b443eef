"""The place of a part by single rays of its photos to known points.

Known points that one photo of the part sees cannot be intersected in the axes of the part. With the
inverse similarity x = a Q X + b, the known point X lies on the ray c + λ d of its photo:

    d × (a Q X + b − c) = 0,

two conditions for each ray, so that four rays determine the seven parameters. With a rotation Q the
conditions are linear in a and b. Many rotations are therefore tried with some rays at a time; those
with the smallest median angle between the rays and the sights to the known points are refined by
all rays, of which wrong ones count little.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..rotation import exp_rotation
from ..types import Array, Index, Mask
from .growth import Growth
from .known import Known
from .scale import directions_of_rays
from .similarity import Similarity, even_rotations

MIN_RAYS = 4
"""Smallest number of rays that determine a similarity."""
RAYS_AT_A_TIME = 5
"""Number of rays with which a rotation is tried."""
MAX_SAMPLES = 40
"""Largest number of such choices."""
ROTATIONS = 12
"""Number of random rotations, each of which is combined with the 24 of a cube."""
REFINED = 24
"""Number of trials that are refined."""
WRONG = 0.02
"""Angle between a ray and its sight, radians, from which it counts by the logarithm."""
FITTING = 4.0
"""Largest angle between a ray that fits and its sight, relative to the median."""
MAX_RAYS = 200
"""Largest number of rays that are used, spread evenly."""
MAX_EVALUATIONS = 100
"""Largest number of evaluations of a refinement."""


@dataclass(frozen=True, eq=False)
class _Sights:
    """Rays in the axes of the part, and the known points that they lead to."""

    centre: Array
    """c, (n, 3)."""
    direction: Array
    """Unit vectors d, (n, 3)."""
    known: Array
    """X, (n, 3)."""

    def some(self, rows: Mask) -> _Sights:
        """Return some of the rays."""
        return _Sights(self.centre[rows], self.direction[rows], self.known[rows])

    def off(self, scale: Array, rotation: Array, shift: Array) -> Array:
        """Return sight − d of unit sights, (k, n, 3): a (k,), Q (k, 3, 3), b (k, 3)."""
        turned = np.einsum("kij,nj->kni", rotation, self.known)
        sight = scale[:, None, None] * turned + shift[:, None] - self.centre
        length = np.maximum(np.linalg.norm(sight, axis=2, keepdims=True), 1e-300)
        return np.asarray(sight / length - self.direction)

    def solved(self, rotation: Array, rows: Index) -> tuple[Array, Array]:
        """Return a (k,) and b (k, 3) from some rays each, (m,), for each rotation (k, 3, 3)."""
        c, d = self.centre[rows], self.direction[rows]
        across = np.eye(3) - d[:, :, None] * d[:, None, :]
        turned = np.einsum("kij,mj->kmi", rotation, self.known[rows])
        column = np.einsum("mij,kmj->kmi", across, turned)
        normal = np.zeros((len(rotation), 4, 4))
        right = np.zeros((len(rotation), 4))
        goal = np.einsum("mij,mj->mi", across, c)
        normal[:, 0, 0] = np.einsum("kmi,kmi->k", column, column)
        normal[:, 0, 1:] = normal[:, 1:, 0] = column.sum(axis=1)
        normal[:, 1:, 1:] = across.sum(axis=0)
        right[:, 0] = np.einsum("kmi,mi->k", column, goal)
        right[:, 1:] = goal.sum(axis=0)
        normal += 1e-12 * np.eye(4)
        found = np.linalg.solve(normal, right[:, :, None])[:, :, 0]
        return np.asarray(found[:, 0]), np.asarray(found[:, 1:])


def similarity_from_rays(growth: Growth, known: Known) -> tuple[Similarity, int] | None:
    """Return the similarity from the axes of a part to the frame, and the number of its rays.

    Args:
        growth: the part.
        known: coordinates, NaN where unknown.

    Returns:
        None: there are fewer than `MIN_RAYS` rays to different known points.
    """
    v = growth.views
    there: Mask = np.all(np.isfinite(known.point), axis=1)
    rows = np.flatnonzero(growth.rays.usable & growth.posed[v.photo] & there[v.point])
    if len(np.unique(v.point[rows])) < MIN_RAYS:
        return None
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_RAYS)).astype(np.intp)]
    pose = growth.pose[v.photo[rows]]
    ray = directions_of_rays(pose, growth.rays.tangent[rows])
    found = from_rays(pose[:, 9:], ray, known.point[v.point[rows]])
    return None if found is None else (found, len(rows))


def from_rays(centre: Array, direction: Array, known: Array) -> Similarity | None:
    """Return the similarity that brings rays to known points.

    Args:
        centre: origins of the rays, (n, 3), n ≥ 4.
        direction: their unit vectors, (n, 3).
        known: known points in the frame, (n, 3).

    Returns:
        X = s R x + t of points x on the rays; none: no similarity has points ahead.
    """
    middle, target = centre.mean(axis=0), known.mean(axis=0)
    size = float(np.linalg.norm(centre - middle, axis=1).max()) or 1.0
    extent = float(np.linalg.norm(known - target, axis=1).max()) or 1.0
    sights = _Sights((centre - middle) / size, direction, (known - target) / extent)
    trials = _trials(sights)
    refined = [r for t in trials if (r := _refined(sights, *t)) is not None]
    if not refined:
        return None
    _, a, q, b = min(refined, key=lambda r: r[0])
    for _ in range(2):
        angle = np.linalg.norm(sights.off(np.array([a]), q[None], b[None])[0], axis=1)
        fits = angle <= FITTING * float(np.median(angle)) + 1e-12
        better = _refined(sights.some(fits), a, q, b) if fits.sum() >= MIN_RAYS else None
        _, a, q, b = better or (0.0, a, q, b)
    # x = m + size (a Q (X − M)/extent + b), solved for X.
    scale = extent / (a * size)
    return Similarity(scale, q.T, target - scale * q.T @ (middle + size * b))


def _trials(sights: _Sights) -> list[tuple[float, Array, Array]]:
    """Return a, Q and b of the trials with the smallest median angles, of different rotations."""
    n = len(sights.known)
    rng = np.random.default_rng(n)
    turns = [exp_rotation(w) for w in rng.normal(0.0, 0.5, (ROTATIONS, 3))]
    turns[0] = np.eye(3)
    rotation = np.array([e @ t for t in turns for e in even_rotations()])
    few = min(RAYS_AT_A_TIME, n)
    samples: list[Index] = [np.arange(n)]
    samples += [rng.choice(n, few, replace=False) for _ in range(MAX_SAMPLES if n > few else 0)]
    least = np.full(len(rotation), np.inf)
    best = np.zeros((len(rotation), 4))
    for rows in samples:
        a, b = sights.solved(rotation, rows)
        angle = np.linalg.norm(sights.off(a, rotation, b), axis=2)
        median = np.where(a > 0.0, np.median(angle, axis=1), np.inf)
        better = median < least
        least[better] = median[better]
        best[better, 0], best[better, 1:] = a[better], b[better]
    order = np.argsort(least)[:REFINED]
    return [
        (float(best[i, 0]), rotation[i], best[i, 1:])
        for i in order.tolist()
        if np.isfinite(least[i])
    ]


def _refined(
    sights: _Sights, a: float, q: Array, b: Array
) -> tuple[float, float, Array, Array] | None:
    """Return cost, a, Q and b after a robust refinement; none: it has no finite cost."""
    from scipy.optimize import least_squares  # local, because it takes long to import

    def misfit(p: Array) -> Array:
        turned = (q @ exp_rotation(p[:3]))[None]
        return sights.off(a * np.exp(p[3:4]), turned, (b + p[4:])[None]).ravel()

    found = least_squares(
        misfit, np.zeros(7), loss="cauchy", f_scale=WRONG, max_nfev=MAX_EVALUATIONS
    )
    p = found.x
    if not np.isfinite(found.cost):
        return None
    rotation = np.asarray(q @ exp_rotation(p[:3]))
    return float(found.cost), a * float(np.exp(p[3])), rotation, np.asarray(b + p[4:])
