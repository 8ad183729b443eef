"""Similarities of a part to the frame, robust by points or rays, else least squares; scale by rays.

They bring a part of a block into the frame of the network. Points have all or some of their
coordinates known; attitudes of photos give the rotation. One wrong coordinate does not spoil it:
three points at a time are tried, and the transformation with the smallest median of misfits is
refined with the points that fit.

The scale of a part whose rotation and one place are known follows from rays that leave the part. A
photo of the part is at C(s) = Y + s R (c − x), where x is the known place in the axes of the part
and Y in the frame. A ray R t of it that meets a known point P gives (P − C(s)) × R t = 0, and one
that meets a ray d from C' of another photo of known pose gives d · ((C(s) − C') × R t) = 0: both
are linear in s.

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

from ..models.similarity import Similarity, extent_ratio, fit_similarity
from ..rotation import exp_rotation
from ..types import Array, Index, Mask
from .block_input import KnownPlaces, ray_directions
from .partial_block import PartialBlock

MIN_LEVER_RATIO = 0.3
"""Smallest lever of a ray, part of the largest one, with which it counts."""
MAX_POINT_TRIPLES = 300
"""Largest number of triples of points that are tried."""
MIN_EXTENT_RATIO_OFF_LINE = 1e-2
"""Smallest ratio of the two extents of points that do not lie in one line."""
MAX_MISFIT_RATIO = 4.0
"""Multiple of the median misfit above which a known point does not fit."""
START_ROTATIONS = 24
"""Number of rotations from which partly known coordinates are fitted."""
MIN_RAYS_OF_SIMILARITY = 4
"""Smallest number of rays that determine a similarity."""
RAYS_OF_TRIAL = 5
"""Number of rays with which a rotation is tried."""
MAX_RAY_SAMPLES = 40
"""Largest number of such choices."""
RANDOM_ROTATIONS = 12
"""Number of random rotations, each of which is combined with the 24 of a cube."""
MAX_REFINED_TRIALS = 24
"""Number of trials that are refined."""
CAUCHY_ANGLE_RAD = 0.02
"""Angle between a ray and its sight, radians, from which it counts by the logarithm."""
MAX_ANGLE_RATIO = 4.0
"""Largest angle between a ray that fits and its sight, relative to the median."""
MAX_RAYS = 200
"""Largest number of rays that are used, spread evenly."""
MAX_EVALUATIONS = 100
"""Largest number of evaluations of a refinement."""


def scales_by_rays(
    growth: PartialBlock, known: KnownPlaces, rotation: Array, place: tuple[Array, Array]
) -> list[float]:
    """Return scales of a part, one of each ray that determines it.

    Args:
        growth: the part.
        known: coordinates and attitudes, NaN where unknown.
        rotation: R, from the axes of the part to the frame.
        place: a place in the axes of the part, and in the frame, (3,) each.
    """
    v, (x, y) = growth.views, place
    rows = np.flatnonzero(growth.rays.usable & growth.posed[v.photo] & ~growth.placed[v.point])
    if not len(rows):
        return []
    pose = growth.pose[v.photo[rows]]
    ray = ray_directions(growth.rays.tangent[rows], pose) @ rotation.T
    moved = (pose[:, 9:] - x) @ rotation.T
    there = np.isfinite(known.point[v.point[rows]]).all(axis=1)
    lever = np.cross(moved[there], ray[there])
    goal = np.cross(known.point[v.point[rows[there]]] - y, ray[there])
    out = _positive_scales((lever * lever).sum(axis=1), (lever * goal).sum(axis=1))
    stands = np.isfinite(known.pose).all(axis=1) & ~growth.posed
    others = np.flatnonzero(growth.rays.usable & stands[v.photo])
    if not len(others):
        return out
    theirs = known.pose[v.photo[others]]
    d = ray_directions(growth.rays.tangent[others], theirs)
    order = np.argsort(v.point[others], kind="stable")
    first = np.searchsorted(v.point[others][order], v.point[rows])
    meets = np.append(v.point[others][order], -1)[first] == v.point[rows]
    one, other = np.flatnonzero(meets), order[first[meets]]
    normal = np.cross(ray[one], d[other])
    a = (normal * moved[one]).sum(axis=1)
    b = (normal * (theirs[other, 9:] - y)).sum(axis=1)
    return out + _positive_scales(a * a, a * b)


def _positive_scales(weight: Array, product: Array) -> list[float]:
    strong = weight > MIN_LEVER_RATIO**2 * weight.max(initial=0.0)
    found = product[strong] / weight[strong]
    return [float(s) for s in found[found > 0.0]]


def in_one_line(x: Array) -> bool:
    """Return whether points (n, 3) lie nearly in one line, or are fewer than three."""
    return not extent_ratio(x) > MIN_EXTENT_RATIO_OFF_LINE


def robust_similarity(x: Array, known: Array) -> tuple[Similarity, Mask] | None:
    """Return the similarity of most points with their coordinates, and the points that fit.

    Args:
        x: points of the part, (n, 3), n ≥ 3.
        known: their known coordinates, (n, 3).

    Returns:
        None: the points lie in one line.
    """
    if in_one_line(x) or in_one_line(known):
        return None
    best = fit_similarity(x, known)
    fits = np.ones(len(x), dtype=bool)
    if not best.scale > 0 or len(x) < 5:
        return (best, fits) if best.scale > 0 else None
    rng = np.random.default_rng(len(x))
    least = np.inf
    for _ in range(MAX_POINT_TRIPLES):
        chosen = rng.choice(len(x), 3, replace=False)
        if in_one_line(x[chosen]):
            continue
        trial = fit_similarity(x[chosen], known[chosen])
        if not trial.scale > 0:
            continue
        miss = np.linalg.norm(trial.of(x) - known, axis=1)
        if (median := float(np.median(miss))) < least:
            best, least = trial, median
    for _ in range(3):
        miss = np.linalg.norm(best.of(x) - known, axis=1)
        fits = miss <= MAX_MISFIT_RATIO * float(np.median(miss)) + 1e-12
        if in_one_line(x[fits]):
            break
        trial = fit_similarity(x[fits], known[fits])
        best = trial if trial.scale > 0 else best
    return best, fits


def similarity_with_rotation(x: Array, known: Array, rotation: Array) -> Similarity | None:
    """Return scale and shift of a similarity with a given rotation, from any known components.

    Args:
        x: points of the part, (n, 3).
        known: coordinates, NaN where unknown, (n, 3).
        rotation: R, (3, 3).

    Returns:
        None: the components do not give the scale, or the scale is negative.
    """
    turned = x @ rotation.T
    row, axis = np.nonzero(np.isfinite(known))
    design = np.zeros((len(row), 4))
    design[:, 0] = turned[row, axis]
    design[np.arange(len(row)), 1 + axis] = 1.0
    middle = np.bincount(axis, design[:, 0], 3) / np.maximum(np.bincount(axis, minlength=3), 1)
    spread = design[:, 0] - middle[axis]
    if not np.abs(spread).max(initial=0.0) > 1e-9 * (np.abs(turned).max(initial=0.0) + 1e-300):
        return None
    found = np.linalg.lstsq(design, known[row, axis], rcond=1e-12)[0]
    shift = np.asarray(found[1:], dtype=float)
    return Similarity(float(found[0]), rotation, shift) if found[0] > 0 else None


def similarity_from_components(x: Array, known: Array) -> Similarity | None:
    """Return the similarity of points of which some coordinates are known, seven at least.

    The sum of squares is minimised from several rotations, which are spread evenly.

    Args:
        x: points of the part, (n, 3).
        known: coordinates, NaN where unknown, (n, 3).

    Returns:
        None: fewer than seven components, or the components leave something open.
    """
    from scipy.optimize import least_squares  # local, because it takes long to import

    there = np.isfinite(known)
    if there.sum() < 7 or there.sum(axis=0).min() == 0:
        return None
    size = float(np.ptp(x, axis=0).max()) or 1.0
    middle, goal = x.mean(axis=0), np.nanmean(known, axis=0)
    local = (x - middle) / size
    extent = max(float(np.nanmax(np.abs(known - goal))), 1e-12)
    target = (known - goal) / extent

    def misfit(p: Array, base: Array) -> Array:
        moved = np.exp(p[3]) * local @ (base @ exp_rotation(p[:3])).T + p[4:]
        return np.asarray((moved - target)[there])

    best = None
    for base in even_rotations(START_ROTATIONS):
        found = least_squares(misfit, np.zeros(7), args=(base,), method="trf", max_nfev=60)
        if best is None or found.cost < best[0].cost:
            best = found, base
    assert best is not None
    found, base = best
    values = np.linalg.svd(np.asarray(found.jac, dtype=float), compute_uv=False)
    if values[-1] < 1e-6 * values[0]:
        return None
    scale, rotation = float(np.exp(found.x[3])), base @ exp_rotation(found.x[:3])
    factor = scale * extent / size
    shift = goal + extent * found.x[4:] - factor * rotation @ middle
    return Similarity(factor, rotation, np.asarray(shift, dtype=float))


def even_rotations(n: int = 24) -> list[Array]:
    """Return the 24 rotations of a cube onto itself."""
    out = []
    for i in range(3):
        for j in range(3):
            for a in (1.0, -1.0):
                for b in (1.0, -1.0):
                    if i != j:
                        r = np.zeros((3, 3))
                        r[0, i], r[1, j] = a, b
                        r[2] = np.cross(r[0], r[1])
                        out.append(r)
    return out[:n]


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


def similarity_from_rays(growth: PartialBlock, known: KnownPlaces) -> tuple[Similarity, int] | None:
    """Return the similarity from the axes of a part to the frame, and the number of its rays.

    Args:
        growth: the part.
        known: coordinates, NaN where unknown.

    Returns:
        None: there are fewer than `MIN_RAYS_OF_SIMILARITY` rays to different known points.
    """
    v = growth.views
    there: Mask = np.all(np.isfinite(known.point), axis=1)
    rows = np.flatnonzero(growth.rays.usable & growth.posed[v.photo] & there[v.point])
    if len(np.unique(v.point[rows])) < MIN_RAYS_OF_SIMILARITY:
        return None
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_RAYS)).astype(np.intp)]
    pose = growth.pose[v.photo[rows]]
    ray = ray_directions(growth.rays.tangent[rows], pose)
    found = similarity_from_sights(pose[:, 9:], ray, known.point[v.point[rows]])
    return None if found is None else (found, len(rows))


def similarity_from_sights(centre: Array, direction: Array, known: Array) -> Similarity | None:
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
        fits = angle <= MAX_ANGLE_RATIO * float(np.median(angle)) + 1e-12
        better = (
            _refined(sights.some(fits), a, q, b) if fits.sum() >= MIN_RAYS_OF_SIMILARITY else None
        )
        _, a, q, b = better or (0.0, a, q, b)
    # x = m + size (a Q (X − M)/extent + b), solved for X.
    scale = extent / (a * size)
    return Similarity(scale, q.T, target - scale * q.T @ (middle + size * b))


def _trials(sights: _Sights) -> list[tuple[float, Array, Array]]:
    """Return a, Q and b of the trials with the smallest median angles, of different rotations."""
    n = len(sights.known)
    rng = np.random.default_rng(n)
    turns = [exp_rotation(w) for w in rng.normal(0.0, 0.5, (RANDOM_ROTATIONS, 3))]
    turns[0] = np.eye(3)
    rotation = np.array([e @ t for t in turns for e in even_rotations()])
    few = min(RAYS_OF_TRIAL, n)
    samples: list[Index] = [np.arange(n)]
    samples += [rng.choice(n, few, replace=False) for _ in range(MAX_RAY_SAMPLES if n > few else 0)]
    least = np.full(len(rotation), np.inf)
    best = np.zeros((len(rotation), 4))
    for rows in samples:
        a, b = sights.solved(rotation, rows)
        angle = np.linalg.norm(sights.off(a, rotation, b), axis=2)
        median = np.where(a > 0.0, np.median(angle, axis=1), np.inf)
        better = median < least
        least[better] = median[better]
        best[better, 0], best[better, 1:] = a[better], b[better]
    order = np.argsort(least)[:MAX_REFINED_TRIALS]
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
        misfit, np.zeros(7), loss="cauchy", f_scale=CAUCHY_ANGLE_RAD, max_nfev=MAX_EVALUATIONS
    )
    p = found.x
    if not np.isfinite(found.cost):
        return None
    rotation = np.asarray(q @ exp_rotation(p[:3]))
    return float(found.cost), a * float(np.exp(p[3])), rotation, np.asarray(b + p[4:])
