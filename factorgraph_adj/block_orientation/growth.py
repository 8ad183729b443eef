"""A block that grows: poses and points found so far, and which image points they agree with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..approximate.rays import nearest_to_rays
from ..types import Array, Index, Mask
from .robust_poses import RAYLEIGH_MEDIAN, ray_misses
from .views import Rays, Views


@dataclass(frozen=True)
class Rules:
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


RULES = Rules()
"""The numbers by which blocks grow."""


@dataclass(eq=False)
class Growth:
    """Poses and points of one part of a block, NaN until found."""

    views: Views
    """All image points."""
    rays: Rays
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
    def empty(cls, views: Views, calibrations: tuple[Array, ...], wanted: Mask) -> Growth:
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
            max(RULES.widest / typical, RULES.least_limit),
        )

    def copy(self) -> Growth:
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
        """Find the limit anew, and forget what too few image points agree with.

        The limit is a multiple of the spread of all misses, from their median.

        Returns:
            The image points that agree, (n,).
        """
        rows = self.known()
        if not len(rows):
            return np.zeros(self.views.n, dtype=bool)
        spread = float(np.median(self.misses(rows))) / RAYLEIGH_MEDIAN
        widest = RULES.widest / float(np.median(self.rays.unit[rows]))
        tight, least = RULES.tight, RULES.least_limit
        if self.ended:
            tight, least = RULES.tight_at_end, RULES.least_limit_at_end
        self.limit = max(min(tight * spread, widest), least)
        least_rays = RULES.least_at_end if self.ended else RULES.least_rays
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
        """Intersect points anew that some image points do not agree with: those may come back."""
        v = self.views
        rows = self.known()
        before = self.point.copy()
        doubted = np.zeros(len(before), dtype=bool)
        doubted[v.point[rows[self.misses(rows) > self.limit]]] = True
        agreed = np.bincount(v.point[self.fitting()], minlength=len(before))
        self.point[doubted] = np.nan
        self.intersect(parallax=RULES.least_parallax)
        worse = doubted & (np.bincount(v.point[self.fitting()], minlength=len(before)) < agreed)
        self.point[worse] = before[worse]

    def intersect(self, *, parallax: float) -> None:
        """Find points where rays of oriented photos meet; rays that miss are left out.

        Args:
            parallax: smallest angle between rays, radians.
        """
        v = self.views
        rows = np.flatnonzero(self.wanted & self.posed[v.photo] & ~self.placed[v.point])
        for _ in range(RULES.drops + 1):
            count = np.bincount(v.point[rows], minlength=len(self.point))
            rows = rows[count[v.point[rows]] >= 2]
            if not len(rows):
                break
            points, group = np.unique(v.point[rows], return_inverse=True)
            centre, direction = self._world(rows)
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
        `Rules.paired` rays of a point is tried, and the one counts with which most rays agree; of
        several the one with the smallest misses.
        """
        v = self.views
        rows = np.flatnonzero(self.wanted & self.posed[v.photo] & ~self.placed[v.point])
        rows = rows[np.argsort(v.point[rows], kind="stable")]
        first, second, owner = [], [], []
        of_point, begins, size = np.unique(v.point[rows], return_index=True, return_counts=True)
        for number, (begin, n) in enumerate(zip(begins.tolist(), size.tolist(), strict=True)):
            if n < 3:
                continue
            some = np.unique(np.linspace(0, n - 1, min(n, RULES.paired)).astype(int)) + begin
            i, j = np.triu_indices(len(some), 1)
            first.append(some[i])
            second.append(some[j])
            owner.append(np.full(len(i), number))
        if not owner:
            return
        a, b, point = (np.concatenate(x) for x in (first, second, owner))
        n_trials = len(point)
        centre, direction = self._world(rows[np.concatenate([a, b])])
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

    def _world(self, rows: Index) -> tuple[Array, Array]:
        """Return projection centres and unit vectors of rays, (n, 3) each."""
        pose, t = self.pose[self.views.photo[rows]], self.rays.tangent[rows]
        r = pose[:, :9]
        d = r[:, 0::3] * t[:, :1] - r[:, 1::3] * t[:, 1:] + r[:, 2::3]
        return pose[:, 9:], d / np.linalg.norm(d, axis=1, keepdims=True)

    def strengths(self, rows: Index) -> Array:
        """Return the strength of the intersection of each point by some rows, radians, (points,).

        Zero for points without rows.
        """
        centre, direction = self._world(rows)
        _, strength = nearest_to_rays(centre, direction, self.views.point[rows], len(self.point))
        return strength
