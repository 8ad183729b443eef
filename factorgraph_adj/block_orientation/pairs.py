"""Pairs of photos from which a block can start: common points, overlap and parallax."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..approximate.rays import nearest_to_rays
from ..types import Array, Index, Mask
from .growth import RULES, Growth
from .robust_poses import RelativePose, relative_pose

LEAST_COMMON = 8
"""Smallest number of common points of a pair."""
AT_ONCE = 24
"""Number of pairs that are oriented before the best of them is looked for."""
MOST_PAIRS = 120
"""Largest number of pairs that are oriented."""
GOOD_ANGLE = 0.2
"""Angle between rays, radians, above which more parallax is no better."""
ENOUGH_ANGLE = 0.1
"""Median angle between rays, radians, of a pair that needs no better one."""


@dataclass(frozen=True, eq=False)
class Pair:
    """An oriented pair of photos."""

    first: int
    """Number of the first photo."""
    second: int
    """Number of the second photo."""
    pose: RelativePose
    """Pose of the second photo in the axes of the first."""
    rows: tuple[Index, Index]
    """Image points of the common points in both photos."""
    fitting: int
    """Number of common points that fit."""
    angle: float
    """Median angle between the rays of the common points, radians."""
    overlap: float
    """Smaller share of the extent of a photo that the common points cover."""

    @property
    def score(self) -> float:
        """Worth of the pair as a start: number of fitting points, parallax and overlap."""
        bent = min(self.angle, np.pi - self.angle, GOOD_ANGLE) / GOOD_ANGLE
        return float(self.fitting * bent * np.sqrt(self.overlap))


def common_points(growth: Growth, free: Mask) -> list[tuple[int, int, int]]:
    """Return pairs of free photos and their number of common points, the largest number first."""
    table = growth.views.table(growth.wanted & free[growth.views.photo])
    common = (table @ table.T).tocoo()
    upper = (common.row < common.col) & (common.data >= LEAST_COMMON)
    order = np.argsort(-common.data[upper], kind="stable")
    return [
        (int(a), int(b), int(n))
        for a, b, n in zip(
            common.row[upper][order],
            common.col[upper][order],
            common.data[upper][order],
            strict=True,
        )
    ]


def start_pairs(growth: Growth, free: Mask) -> list[Pair]:
    """Return oriented pairs of free photos, the best start first.

    Pairs with many common points come first, a photo at most a few times in each round; more pairs
    are oriented while none of them has good parallax.
    """
    open_ = common_points(growth, free)
    found: list[Pair] = []
    tried = 0
    while open_ and tried < MOST_PAIRS:
        taken, later = _different(open_)
        tried += len(taken)
        found += [p for a, b, _ in taken if (p := orient_pair(growth, a, b)) is not None]
        open_ = later
        if any(p.angle >= ENOUGH_ANGLE for p in found):
            break
    return sorted(found, key=lambda p: -p.score)


def _different(
    pairs: list[tuple[int, int, int]],
) -> tuple[list[tuple[int, int, int]], list[tuple[int, int, int]]]:
    """Divide pairs into some with different photos, and the others."""
    taken: list[tuple[int, int, int]] = []
    later: list[tuple[int, int, int]] = []
    times: dict[int, int] = {}
    for pair in pairs:
        a, b, _ = pair
        if len(taken) < AT_ONCE and max(times.get(a, 0), times.get(b, 0)) < 6:
            taken.append(pair)
            times[a], times[b] = times.get(a, 0) + 1, times.get(b, 0) + 1
        else:
            later.append(pair)
    return taken, later


def orient_pair(growth: Growth, first: int, second: int) -> Pair | None:
    """Orient a pair of photos by their common points; none: too few points fit."""
    v, rays = growth.views, growth.rays
    a = np.flatnonzero(growth.wanted & (v.photo == first))
    b = np.flatnonzero(growth.wanted & (v.photo == second))
    _, in_a, in_b = np.intersect1d(v.point[a], v.point[b], return_indices=True)
    a, b = a[in_a], b[in_b]
    if len(a) < LEAST_COMMON:
        return None
    unit = float(np.median(rays.unit[np.concatenate([a, b])]))
    wide = max(RULES.widest if not growth.calibrated else growth.limit * unit, 3.0 * unit)
    pose = relative_pose(
        rays.tangent[a], rays.tangent[b], wide=wide, least=RULES.least_limit * unit
    )
    if pose is None:
        return None
    fits = pose.fits
    angle = _median_angle(pose, rays.tangent[a[fits]], rays.tangent[b[fits]])
    overlap = min(_extent(growth, a[fits], first), _extent(growth, b[fits], second))
    return Pair(first, second, pose, (a, b), int(fits.sum()), angle, overlap)


def _median_angle(pose: RelativePose, first: Array, second: Array) -> float:
    d1 = np.column_stack([first[:, 0], -first[:, 1], np.ones(len(first))])
    d2 = np.column_stack([second[:, 0], -second[:, 1], np.ones(len(second))]) @ pose.rotation.T
    d1, d2 = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in (d1, d2))
    return float(np.median(np.arctan2(np.linalg.norm(np.cross(d1, d2), axis=1), (d1 * d2).sum(1))))


def _extent(growth: Growth, rows: Index, photo: int) -> float:
    """Return the share of the extent of the image points of a photo that some of them cover."""
    every = growth.views.xy[growth.views.photo == photo]
    some = growth.views.xy[rows]
    sides = [float(np.ptp(some[:, i]) / max(np.ptp(every[:, i]), 1e-12)) for i in range(2)]
    return min(sides[0] * sides[1], 1.0)


def start_with(growth: Growth, pair: Pair) -> bool:
    """Begin a part with a pair, whose base is 1; return whether it has enough points."""
    identity = np.concatenate([np.eye(3).ravel(), np.zeros(3)])
    growth.pose[pair.first] = identity
    growth.pose[pair.second] = np.concatenate([pair.pose.rotation.ravel(), pair.pose.base])
    a, b = (rows[pair.pose.fits] for rows in pair.rows)
    v = growth.views
    group = np.tile(np.arange(len(a)), 2)
    rows = np.concatenate([a, b])
    pose, t = growth.pose[v.photo[rows]], growth.rays.tangent[rows]
    r = pose[:, :9]
    d = r[:, 0::3] * t[:, :1] - r[:, 1::3] * t[:, 1:] + r[:, 2::3]
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    x, strength = nearest_to_rays(pose[:, 9:], d, group, len(a))
    growth.point[v.point[a]] = np.where((strength >= RULES.parallax / 2)[:, None], x, np.nan)
    behind = ~np.isfinite(growth.misses(a)) | ~np.isfinite(growth.misses(b))
    growth.point[v.point[a[behind]]] = np.nan
    return int(growth.placed.sum()) >= LEAST_COMMON
