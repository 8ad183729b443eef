"""Photos beside the parts of a block: those that stand, and those of which a part is known.

A photo with too few image points for a resection still has a pose if its projection centre or its
attitude is known: two rays to points of the block give the rest. One ray leaves the rotation about
itself open.
"""

from __future__ import annotations

import numpy as np

from ..approximate.resection import pose_from
from ..types import Mask
from .growth import RULES, Growth
from .known import Known
from .robust_poses import ray_misses

NEVER = 10**9
"""Number of rays of a photo of which nothing is given: it is oriented otherwise."""
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


def by_given(growth: Growth, known: Known) -> tuple[Mask, Mask]:
    """Orient photos with known projection centres or attitudes from two rays or more, in place.

    Args:
        growth: as for `stand`.
        known: coordinates and attitudes, NaN where unknown.

    Returns:
        The photos, (photos,), and the image points that agree, (n,).
    """
    v = growth.views
    done = np.zeros(len(growth.pose), dtype=bool)
    with_centre: Mask = np.all(np.isfinite(known.pose[:, 9:]), axis=1)
    with_attitude: Mask = np.all(np.isfinite(known.pose[:, :9]), axis=1)
    agree = np.zeros(v.n, dtype=bool)
    while True:
        open_ = ~growth.posed & (with_centre | with_attitude)
        found = False
        for photo in np.flatnonzero(open_).tolist():
            rows = np.flatnonzero(growth.wanted & (v.photo == photo) & growth.placed[v.point])
            x, t = growth.point[v.point[rows]], growth.rays.tangent[rows]
            d = np.column_stack([t[:, 0], -t[:, 1], np.ones(len(t))])
            d /= np.linalg.norm(d, axis=1, keepdims=True)
            pose = pose_from(known.pose[photo], x, d, NEVER)
            if pose is None:
                continue
            miss = ray_misses(pose[:9].reshape(1, 3, 3), pose[None, 9:], x, t)
            fits = miss / growth.rays.unit[rows] <= NEAR * growth.limit
            if fits.sum() < 2:
                continue
            growth.pose[photo] = pose
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
        "projection centre or attitude: measure more points of other photos in it, or take it out"
    )
