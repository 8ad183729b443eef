"""Photos beside the parts of a block: those that stand, and those whose projection centre is known.

A photo with too few image points for a resection still has a pose if its projection centre is
known: two rays to points of the block give its rotation. One ray leaves the rotation about itself
open.
"""

from __future__ import annotations

import numpy as np

from ..types import Array, Mask
from .growth import RULES, Growth
from .known import Known
from .robust_poses import ray_misses

LEAST_ANGLE = 0.01
"""Smallest angle between two rays, radians, that give the rotation of a photo."""
NEAR = 10.0
"""Multiple of the limit of misses within which an image point agrees with a photo that a known
projection centre places: the centre has an error of its own."""


def stand(growth: Growth, known: Known) -> Mask:
    """Give photos the poses that are known altogether, in place; return the points' new rays, (n,).

    Args:
        growth: poses and points of all parts in the frame of the network.
        known: coordinates and attitudes, NaN where unknown.
    """
    stands: Mask = ~growth.posed & np.all(np.isfinite(known.pose), axis=1)
    if not stands.any():
        return np.zeros(growth.views.n, dtype=bool)
    growth.pose[stands] = known.pose[stands]
    new = ~growth.placed
    growth.intersect(parallax=RULES.least_parallax)
    new &= growth.placed
    v = growth.views
    return np.asarray(growth.fitting() & (new[v.point] | stands[v.photo]))


def by_centre(growth: Growth, known: Known) -> tuple[Mask, Mask]:
    """Orient photos with known projection centres from two rays or more, in place.

    Args:
        growth: as for `stand`.
        known: coordinates and attitudes, NaN where unknown.

    Returns:
        The photos, (photos,), and the image points that agree, (n,).
    """
    v = growth.views
    done = np.zeros(len(growth.pose), dtype=bool)
    agree = np.zeros(v.n, dtype=bool)
    while True:
        open_: Mask = ~growth.posed & np.all(np.isfinite(known.pose[:, 9:]), axis=1)
        found = False
        for photo in np.flatnonzero(open_).tolist():
            rows = np.flatnonzero(growth.wanted & (v.photo == photo) & growth.placed[v.point])
            centre = known.pose[photo, 9:]
            rotation = _rotation(growth.rays.tangent[rows], growth.point[v.point[rows]] - centre)
            if rotation is None:
                continue
            miss = ray_misses(
                rotation[None], centre[None], growth.point[v.point[rows]], growth.rays.tangent[rows]
            )
            fits = miss / growth.rays.unit[rows] <= NEAR * growth.limit
            if fits.sum() < 2:
                continue
            growth.pose[photo] = np.concatenate([rotation.ravel(), centre])
            agree[rows[fits]] = done[photo] = found = True
        if not found:
            return done, agree
        before = growth.placed
        growth.intersect(parallax=RULES.least_parallax)
        agree |= growth.fitting() & (growth.placed & ~before)[v.point]


def why_not(every: int, of_block: int, alone: int, *, centred: bool) -> str:
    """Return why a photo was not oriented, and what would help.

    Args:
        every: number of its image points.
        of_block: number of those of points of the block.
        alone: number of those of points that no other photo has.
        centred: whether its projection centre is known.
    """
    found = f"{of_block} of its {every} image points belong to points of the block"
    if of_block >= RULES.least_at_end:
        return (
            f"{found}, and fewer than {RULES.least_at_end} of them fit one pose: are they named as "
            "in the other photos, and is the calibration that of this photo?"
        )
    lone = f" ({alone} to points that no other photo sees)" if alone else ""
    if centred:
        return (
            f"{found}{lone}; with its known projection centre two that fit give its rotation, and "
            "one leaves the rotation about its ray open: observe its attitude, measure more points "
            "of other photos in it, or take it out"
        )
    return (
        f"{found}{lone}; a resection needs {RULES.least_at_end} that fit, or two with a known "
        "projection centre: measure more points of other photos in it, or take it out"
    )


def _rotation(tangent: Array, to_point: Array) -> Array | None:
    """Return world_R_camera from rays and directions to their points; none: too few or too narrow.

    Minimises Σ |R d − u|² over rotations (Wahba's problem).
    """
    if len(tangent) < 2:
        return None
    d = np.column_stack([tangent[:, 0], -tangent[:, 1], np.ones(len(tangent))])
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    u = to_point / np.linalg.norm(to_point, axis=1, keepdims=True)
    if np.linalg.norm(d - d[0], axis=1).max() < LEAST_ANGLE:
        return None
    left, _, right = np.linalg.svd(u.T @ d)
    flip = np.diag([1.0, 1.0, np.linalg.det(left @ right)])
    return np.asarray(left @ flip @ right)
