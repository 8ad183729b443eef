"""Similarity transformations that bring a part of a block into the frame of the network.

X = s R x + t, from points with known coordinates (all three, or some of them) and from known
attitudes of photos. One wrong coordinate does not spoil it: three points at a time are tried, and
the transformation with the smallest median of misfits is refined with the points that fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..approximate.resection import turn_and_shift
from ..rotation import exp_rotation
from ..types import Array, Mask

TRIPLES = 300
"""Largest number of triples of points that are tried."""
FLAT = 1e-2
"""Smallest ratio of the two extents of points that do not lie in one line."""
FAR = 4.0
"""Multiple of the median misfit above which a known point does not fit."""
STARTS = 24
"""Number of rotations from which partly known coordinates are fitted."""


@dataclass(frozen=True, eq=False)
class Similarity:
    """X = s R x + t."""

    scale: float
    """s."""
    rotation: Array
    """R, (3, 3)."""
    shift: Array
    """t, (3,)."""

    def of(self, points: Array) -> Array:
        """Return transformed points, (n, 3)."""
        return np.asarray(self.scale * points @ self.rotation.T + self.shift)

    def of_poses(self, poses: Array) -> Array:
        """Return transformed stored poses, (n, 12)."""
        turned = self.rotation @ poses[:, :9].reshape(-1, 3, 3)
        return np.concatenate([turned.reshape(-1, 9), self.of(poses[:, 9:])], axis=1)


def from_points(x: Array, known: Array) -> Similarity | None:
    """Return the similarity of points with their known coordinates by least squares.

    Args:
        x: points of the part, (n, 3).
        known: their coordinates, (n, 3), n ≥ 2. Two points, or points in one line, leave the
            rotation about that line as it is.

    Returns:
        The transformation; none: all points are in one place.
    """
    a, b = x - x.mean(axis=0), known - known.mean(axis=0)
    size_a, size_b = np.sqrt((a * a).sum()), np.sqrt((b * b).sum())
    if not (size_a > 0 and size_b > 0):
        return None
    r, _ = turn_and_shift(a[None] / size_a, b[None] / size_b)
    scale = float((b * (a @ r[0].T)).sum() / size_a**2)
    if not scale > 0:
        return None
    return Similarity(scale, r[0], known.mean(axis=0) - scale * x.mean(axis=0) @ r[0].T)


def in_one_line(x: Array) -> bool:
    """Return whether points (n, 3) lie nearly in one line, or are fewer than three."""
    if len(x) < 3:
        return True
    extent = np.linalg.svd(x - x.mean(axis=0), compute_uv=False)
    return bool(extent[1] <= FLAT * extent[0])


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
    best = from_points(x, known)
    fits = np.ones(len(x), dtype=bool)
    if best is None or len(x) < 5:
        return None if best is None else (best, fits)
    rng = np.random.default_rng(len(x))
    least = np.inf
    for _ in range(TRIPLES):
        chosen = rng.choice(len(x), 3, replace=False)
        if in_one_line(x[chosen]):
            continue
        trial = from_points(x[chosen], known[chosen])
        if trial is None:
            continue
        miss = np.linalg.norm(trial.of(x) - known, axis=1)
        if (median := float(np.median(miss))) < least:
            best, least = trial, median
    for _ in range(3):
        miss = np.linalg.norm(best.of(x) - known, axis=1)
        fits = miss <= FAR * float(np.median(miss)) + 1e-12
        if in_one_line(x[fits]):
            break
        best = from_points(x[fits], known[fits]) or best
    return best, fits


def with_rotation(x: Array, known: Array, rotation: Array) -> Similarity | None:
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


def from_components(x: Array, known: Array) -> Similarity | None:
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
    for base in even_rotations(STARTS):
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


def mean_rotation(rotations: Array) -> Array:
    """Return the rotation nearest to some rotations, (n, 3, 3), in the least-squares sense."""
    u, _, vt = np.linalg.svd(rotations.mean(axis=0))
    return np.asarray(u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt)
