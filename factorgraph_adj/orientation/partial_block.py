"""Poses and points of a part so far, and the image points that agree; pairs that may begin one.

Image points agree with the part if they miss by less than a multiple of the spread of all misses. A
start pair has many common points that fit one relative pose, overlap, and parallax.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..start.image_rays import nearest_to_rays
from ..types import Array, Index, Mask
from .block_input import IDENTITY_POSE, IdealRays, Views, ray_directions
from .robust_poses import RAYLEIGH_MEDIAN, RelativePose, ray_misses, relative_pose

MIN_PAIR_POINTS = 8
"""Smallest number of common points of a pair."""
PAIRS_OF_ROUND = 24
"""Number of pairs that are oriented before the best of them is looked for."""
MAX_ORIENTED_PAIRS = 120
"""Largest number of pairs that are oriented."""
GOOD_PARALLAX_OF_PAIR_RAD = 0.2
"""Angle between rays, radians, above which more parallax is no better."""
MIN_PARALLAX_OF_PAIR_RAD = 0.1
"""Median angle between rays, radians, of a pair that needs no better one."""


@dataclass(frozen=True)
class GrowthRules:
    """Numbers by which a block grows."""

    least_limit: float = 3.0
    """Smallest limit of the misses of image points, in their standard deviations."""
    tight: float = 5.0
    """Multiple of the spread of misses above which an image point does not fit in the growth."""
    least_limit_at_end: float = 5.0
    """The same as ``least_limit`` at the end."""
    tight_at_end: float = 8.0
    """The same as ``tight`` at the end: what is smaller is for a test of the adjustment to find."""
    widest: float = 4e-3
    """Widest limit of the misses of rays, a tangent: what a lens that is not corrected leaves."""
    parallax: float = 0.03
    """Smallest angle between rays, radians, with which a point takes part in the growth."""
    least_parallax: float = 1e-3
    """Smallest angle between rays of a point at the end, radians."""
    least_rays: int = 6
    """Smallest number of fitting image points with which a photo takes part in the growth."""
    least_at_end: int = 4
    """Smallest number of fitting image points with which a photo is oriented at the end."""
    least_share: float = 0.4
    """Smallest share of the known points of a photo that must fit a resection."""
    paired: int = 8
    """Largest number of rays of a point that are intersected two by two."""
    drops: int = 20
    """Largest number of rays of a point that are left out, one after the other."""


GROWTH = GrowthRules()
"""The numbers by which blocks grow."""


@dataclass(eq=False)
class PartialBlock:
    """Poses and points of one part of a block, NaN until found."""

    views: Views
    """All image points."""
    rays: IdealRays
    """Their rays, with the calibrations found so far."""
    calibrations: tuple[Array, ...]
    """Calibration of each camera."""
    wanted: Mask
    """Image points that take part, (n,)."""
    pose: Array
    """Stored poses, (photos, 12)."""
    point: Array
    """Points, (points, 3)."""
    limit: float
    """Limit of the misses of image points, in their standard deviations."""
    ended: bool = False
    """Whether the growth has ended: photos with few image points stay, and smaller misses fit."""
    calibrated: bool = False
    """Whether an adjustment has already improved the calibration."""

    @classmethod
    def empty(cls, views: Views, calibrations: tuple[Array, ...], wanted: Mask) -> PartialBlock:
        """Return a part of which nothing is known."""
        rays = views.rays(calibrations)
        usable = wanted & rays.usable
        typical = float(np.median(rays.unit[usable])) if usable.any() else 1.0
        return cls(
            views,
            rays,
            calibrations,
            usable,
            np.full((len(views.photos), 12), np.nan),
            np.full((len(views.points), 3), np.nan),
            max(GROWTH.widest / typical, GROWTH.least_limit),
        )

    def copy(self) -> PartialBlock:
        """Return an independent copy, for a trial."""
        return replace(self, pose=self.pose.copy(), point=self.point.copy())

    @property
    def posed(self) -> Mask:
        """Photos with a pose, (photos,)."""
        return np.asarray(np.isfinite(self.pose[:, 0]))

    @property
    def placed(self) -> Mask:
        """Points with coordinates, (points,)."""
        return np.asarray(np.isfinite(self.point[:, 0]))

    def calibrate(self, calibrations: tuple[Array, ...]) -> None:
        """Take over improved calibrations."""
        self.calibrations = calibrations
        self.rays = self.views.rays(calibrations)
        self.calibrated = True

    def known(self, rows: Mask | None = None) -> Index:
        """Return the rows whose photo and point are known, of the wanted ones or of some."""
        among = self.wanted if rows is None else rows
        v = self.views
        return np.flatnonzero(among & self.posed[v.photo] & self.placed[v.point])

    def misses(self, rows: Index) -> Array:
        """Return the misses of image points in standard deviations, infinite behind the photo."""
        v, pose = self.views, self.pose[self.views.photo[rows]]
        r, centre = pose[:, :9].reshape(-1, 3, 3), pose[:, 9:]
        miss = ray_misses(r, centre, self.point[v.point[rows]], self.rays.tangent[rows])
        return np.asarray(miss / self.rays.unit[rows])

    def fitting(self) -> Mask:
        """Return the wanted image points that agree with poses and points, (n,)."""
        out = np.zeros(self.views.n, dtype=bool)
        rows = self.known()
        out[rows[self.misses(rows) <= self.limit]] = True
        return out

    def review(self) -> Mask:
        """Find the limit again, and forget what too few image points agree with.

        The limit is a multiple of the spread of all misses, from their median.

        Returns:
            The image points that agree, (n,).
        """
        rows = self.known()
        if not len(rows):
            return np.zeros(self.views.n, dtype=bool)
        spread = float(np.median(self.misses(rows))) / RAYLEIGH_MEDIAN
        widest = GROWTH.widest / float(np.median(self.rays.unit[rows]))
        tight, least = GROWTH.tight, GROWTH.least_limit
        if self.ended:
            tight, least = GROWTH.tight_at_end, GROWTH.least_limit_at_end
        self.limit = max(min(tight * spread, widest), least)
        least_rays = GROWTH.least_at_end if self.ended else GROWTH.least_rays
        while True:
            fits = self.fitting()
            photos = np.bincount(self.views.photo[fits], minlength=len(self.pose))
            points = np.bincount(self.views.point[fits], minlength=len(self.point))
            lost = self.posed & (photos < least_rays)
            away = self.placed & (points < 2)
            self.pose[lost], self.point[away] = np.nan, np.nan
            if not (lost.any() or away.any()):
                return fits

    def reconsider(self) -> None:
        """Intersect points again that some image points do not agree with: those may come back."""
        v = self.views
        rows = self.known()
        before = self.point.copy()
        doubted = np.zeros(len(before), dtype=bool)
        doubted[v.point[rows[self.misses(rows) > self.limit]]] = True
        agreed = np.bincount(v.point[self.fitting()], minlength=len(before))
        self.point[doubted] = np.nan
        self.intersect(parallax=GROWTH.least_parallax)
        worse = doubted & (np.bincount(v.point[self.fitting()], minlength=len(before)) < agreed)
        self.point[worse] = before[worse]

    def intersect(self, *, parallax: float) -> None:
        """Find points where rays of oriented photos meet; rays that miss are left out.

        Args:
            parallax: smallest angle between rays, radians.
        """
        v = self.views
        rows = np.flatnonzero(self.wanted & self.posed[v.photo] & ~self.placed[v.point])
        for _ in range(GROWTH.drops + 1):
            count = np.bincount(v.point[rows], minlength=len(self.point))
            rows = rows[count[v.point[rows]] >= 2]
            if not len(rows):
                break
            points, group = np.unique(v.point[rows], return_inverse=True)
            centre, direction = self.world_rays(rows)
            x, strength = nearest_to_rays(centre, direction, group, len(points))
            pose = self.pose[v.photo[rows]]
            miss = ray_misses(
                pose[:, :9].reshape(-1, 3, 3), pose[:, 9:], x[group], self.rays.tangent[rows]
            )
            miss /= self.rays.unit[rows]
            worst = np.zeros(len(points))
            np.maximum.at(worst, group, np.nan_to_num(miss, nan=np.inf))
            good = (worst <= self.limit) & (strength >= parallax)
            self.point[points[good]] = x[good]
            # The ray with the largest miss leaves where three or more do not meet.
            size = np.bincount(group, minlength=len(points))
            bad = (worst > self.limit) & (size >= 3)
            if not bad.any():
                break
            leaves = np.zeros(len(rows), dtype=bool)
            ordered = np.lexsort((-miss, group))
            leaves[ordered[np.searchsorted(group[ordered], np.arange(len(points)))]] = True
            rows = rows[bad[group] & ~leaves]
        if self.ended:
            self._intersect_by_pairs(parallax)

    def _intersect_by_pairs(self, parallax: float) -> None:
        """Find points with three rays or more from two of them, where most do not agree.

        The ray with the largest miss of all is not always the wrong one. So every pair of at most
        `GrowthRules.paired` rays of a point is tried, and the one counts with which most rays
        agree; of several the one with the smallest misses.
        """
        v = self.views
        rows = np.flatnonzero(self.wanted & self.posed[v.photo] & ~self.placed[v.point])
        rows = rows[np.argsort(v.point[rows], kind="stable")]
        first, second, owner = [], [], []
        of_point, begins, size = np.unique(v.point[rows], return_index=True, return_counts=True)
        for number, (begin, n) in enumerate(zip(begins.tolist(), size.tolist(), strict=True)):
            if n < 3:
                continue
            some = np.unique(np.linspace(0, n - 1, min(n, GROWTH.paired)).astype(int)) + begin
            i, j = np.triu_indices(len(some), 1)
            first.append(some[i])
            second.append(some[j])
            owner.append(np.full(len(i), number))
        if not owner:
            return
        a, b, point = (np.concatenate(x) for x in (first, second, owner))
        n_trials = len(point)
        centre, direction = self.world_rays(rows[np.concatenate([a, b])])
        x, strength = nearest_to_rays(centre, direction, np.tile(np.arange(n_trials), 2), n_trials)
        # The misses of every ray of the point of each trial.
        trial = np.repeat(np.arange(n_trials), size[point])
        place = np.arange(len(trial)) - np.repeat(
            np.cumsum(size[point]) - size[point] - begins[point], size[point]
        )
        pose = self.pose[v.photo[rows[place]]]
        miss = ray_misses(
            pose[:, :9].reshape(-1, 3, 3), pose[:, 9:], x[trial], self.rays.tangent[rows[place]]
        )
        miss = np.minimum(miss / self.rays.unit[rows[place]] / self.limit, 2.0)
        agree = np.bincount(trial, miss <= 1.0, n_trials)
        agree[strength < parallax] = 0
        order = np.lexsort((np.bincount(trial, np.square(miss), n_trials), -agree, point))
        best = order[np.searchsorted(point[order], np.unique(point))]
        best = best[agree[best] >= 2]
        self.point[of_point[point[best]]] = x[best]

    def world_rays(self, rows: Index) -> tuple[Array, Array]:
        """Return projection centres and unit vectors of rays, (n, 3) each."""
        pose = self.pose[self.views.photo[rows]]
        return pose[:, 9:], ray_directions(self.rays.tangent[rows], pose)

    def strengths(self, rows: Index) -> Array:
        """Return the strength of the intersection of each point by some rows, radians, (points,).

        Zero for points without rows.
        """
        centre, direction = self.world_rays(rows)
        _, strength = nearest_to_rays(centre, direction, self.views.point[rows], len(self.point))
        return strength


@dataclass(frozen=True, eq=False)
class PhotoPair:
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
        bent = (
            min(self.angle, np.pi - self.angle, GOOD_PARALLAX_OF_PAIR_RAD)
            / GOOD_PARALLAX_OF_PAIR_RAD
        )
        return float(self.fitting * bent * np.sqrt(self.overlap))


def common_points(growth: PartialBlock, free: Mask) -> list[tuple[int, int, int]]:
    """Return pairs of free photos and their number of common points, the largest number first."""
    table = growth.views.table(growth.wanted & free[growth.views.photo])
    common = (table @ table.T).tocoo()
    upper = (common.row < common.col) & (common.data >= MIN_PAIR_POINTS)
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


def start_pairs(growth: PartialBlock, free: Mask) -> list[PhotoPair]:
    """Return oriented pairs of free photos, the best start first.

    Pairs with many common points come first, a photo at most a few times in each round; more pairs
    are oriented while none of them has good parallax.
    """
    open_ = common_points(growth, free)
    found: list[PhotoPair] = []
    tried = 0
    while open_ and tried < MAX_ORIENTED_PAIRS:
        taken, later = _pairs_of_different_photos(open_)
        tried += len(taken)
        found += [p for a, b, _ in taken if (p := orient_pair(growth, a, b)) is not None]
        open_ = later
        if any(p.angle >= MIN_PARALLAX_OF_PAIR_RAD for p in found):
            break
    return sorted(found, key=lambda p: -p.score)


def _pairs_of_different_photos(
    pairs: list[tuple[int, int, int]],
) -> tuple[list[tuple[int, int, int]], list[tuple[int, int, int]]]:
    """Divide pairs into some with different photos, and the others."""
    taken: list[tuple[int, int, int]] = []
    later: list[tuple[int, int, int]] = []
    times: dict[int, int] = {}
    for pair in pairs:
        a, b, _ = pair
        if len(taken) < PAIRS_OF_ROUND and max(times.get(a, 0), times.get(b, 0)) < 6:
            taken.append(pair)
            times[a], times[b] = times.get(a, 0) + 1, times.get(b, 0) + 1
        else:
            later.append(pair)
    return taken, later


def orient_pair(growth: PartialBlock, first: int, second: int) -> PhotoPair | None:
    """Orient a pair of photos by their common points; none: too few points fit."""
    v, rays = growth.views, growth.rays
    a = np.flatnonzero(growth.wanted & (v.photo == first))
    b = np.flatnonzero(growth.wanted & (v.photo == second))
    _, in_a, in_b = np.intersect1d(v.point[a], v.point[b], return_indices=True)
    a, b = a[in_a], b[in_b]
    if len(a) < MIN_PAIR_POINTS:
        return None
    unit = float(np.median(rays.unit[np.concatenate([a, b])]))
    wide = max(GROWTH.widest if not growth.calibrated else growth.limit * unit, 3.0 * unit)
    pose = relative_pose(
        rays.tangent[a], rays.tangent[b], wide=wide, least=GROWTH.least_limit * unit
    )
    if pose is None:
        return None
    fits = pose.fits
    angle = _median_angle(pose, rays.tangent[a[fits]], rays.tangent[b[fits]])
    overlap = min(_extent(growth, a[fits], first), _extent(growth, b[fits], second))
    return PhotoPair(first, second, pose, (a, b), int(fits.sum()), angle, overlap)


def _median_angle(pose: RelativePose, first: Array, second: Array) -> float:
    d1, d2 = ray_directions(first), ray_directions(second) @ pose.rotation.T
    return float(np.median(np.arctan2(np.linalg.norm(np.cross(d1, d2), axis=1), (d1 * d2).sum(1))))


def _extent(growth: PartialBlock, rows: Index, photo: int) -> float:
    """Return the share of the extent of the image points of a photo that some of them cover."""
    every = growth.views.xy[growth.views.photo == photo]
    some = growth.views.xy[rows]
    sides = [float(np.ptp(some[:, i]) / max(np.ptp(every[:, i]), 1e-12)) for i in range(2)]
    return min(sides[0] * sides[1], 1.0)


def begin_with_pair(growth: PartialBlock, pair: PhotoPair) -> bool:
    """Begin a part with a pair, whose base is 1; return whether it has enough points."""
    growth.pose[pair.first] = IDENTITY_POSE
    growth.pose[pair.second] = np.concatenate([pair.pose.rotation.ravel(), pair.pose.base])
    a, b = (rows[pair.pose.fits] for rows in pair.rows)
    v = growth.views
    group = np.tile(np.arange(len(a)), 2)
    rows = np.concatenate([a, b])
    x, strength = nearest_to_rays(*growth.world_rays(rows), group, len(a))
    growth.point[v.point[a]] = np.where((strength >= GROWTH.parallax / 2)[:, None], x, np.nan)
    behind = ~np.isfinite(growth.misses(a)) | ~np.isfinite(growth.misses(b))
    growth.point[v.point[a[behind]]] = np.nan
    return int(growth.placed.sum()) >= MIN_PAIR_POINTS
