"""Parts of a block, each grown from a start pair: resection, intersection, adjustment in turns."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import chain

import numpy as np

from ..types import Array, Mask
from .bundle import adjust_growth
from .focal import Distances
from .growth import RULES, Growth
from .pairs import Pair, start_pairs, start_with
from .robust_poses import RAYLEIGH_MEDIAN, absolute_pose
from .views import Views, spread_out

MOST_STARTS = 6
"""Largest number of start pairs that are tried for one part."""
STARTS_OF_EACH = 3
"""The same for each calibration where several are tried."""
TRIAL_TURNS = 3
"""Number of turns after which a start is judged."""
ENOUGH = 0.7
"""Share of the image points in oriented photos that must agree with a start that is kept."""
WELL = 3e-4
"""Spread of misses, part of the principal distance, of a start with a calibration that fits."""
MOVED = 0.1
"""Largest relative change of the principal distance in the first turns of a good start."""
MOST_REFUSED = 0.3
"""Largest number of photos, as a share of the oriented ones, that a good start cannot orient."""
SKELETON = 300
"""Number of image points of a photo that take part while the block grows."""
EASY = 15
"""Number of known points of a photo that is oriented at once."""
HALF = 0.5
"""Photos with this share of the known points of the best photo are oriented in the same turn."""
MANY_PHOTOS = 30
"""Number of photos above which an adjustment on the way moves new photos and their neighbours."""
GROWN = 1.25
"""Growth of the number of photos after which the whole part is adjusted again."""
CALIBRATED_FROM = 4
"""Number of photos from which the calibration is improved."""
LAST_ROUNDS = 3
"""Largest number of adjustments of all image points at the end."""


@dataclass(frozen=True, eq=False)
class Part:
    """Photos that were oriented together."""

    growth: Growth
    """Their poses and points, in axes and with the scale of the start pair."""
    start: tuple[str, str]
    """Names of the photos of the start pair."""
    fits: Mask
    """Image points that agree, (n,)."""

    @property
    def n_photos(self) -> int:
        """Number of photos."""
        return int(self.growth.posed.sum())


def build_parts(views: Views, distances: Distances) -> list[Part]:
    """Orient all photos that can be oriented, in as many parts as they need.

    Args:
        views: the image points.
        distances: calibrations with which the block may start.
    """
    every = np.ones(views.n, dtype=bool)
    skeleton = spread_out(views, every, SKELETON)
    free = np.ones(len(views.photos), dtype=bool)
    parts: list[Part] = []
    while free.sum() >= 2:
        choices: Iterable[tuple[Array, ...]] = chain([distances.first()], distances.others())
        starts = STARTS_OF_EACH if distances.guessed else MOST_STARTS
        if parts:
            choices, starts = [parts[0].growth.calibrations], MOST_STARTS
        part = _next_part(views, choices, starts, skeleton, free)
        if part is None:
            break
        free &= ~part.growth.posed
        parts.append(part)
    return parts


def _next_part(
    views: Views, choices: Iterable[tuple[Array, ...]], starts: int, skeleton: Mask, free: Mask
) -> Part | None:
    """Return the part from the best start, with the first calibration that fits well, or the best.

    A wrong principal distance leaves misses that the wide limit of the start lets pass: the better
    of two calibrations has the smaller misses, with nearly as many image points that agree.
    """
    best: _Begun | None = None
    for calibrations in choices:
        empty = Growth.empty(views, calibrations, skeleton)
        begun = best_start(empty, free, starts)
        if begun is None:
            continue
        if best is None or begun.better_than(best):
            best = begun
        if begun.fits_well and begun.as_good_as(best):
            best = begun
            break
    if best is None:
        return None
    growth, pair = best.growth, best.pair
    grow(growth, free)
    fits = finish(growth, free)
    if growth.posed.sum() < 2:
        return None
    return Part(growth, (views.photos[pair.first], views.photos[pair.second]), fits)


@dataclass(frozen=True, eq=False)
class _Begun:
    """A part after a few turns."""

    growth: Growth
    pair: Pair
    fitting: float
    """Number of image points that agree."""
    share: float
    """Their share in oriented photos."""
    stuck: bool
    """Whether most photos that see enough known points could not be oriented from them."""
    moved: float
    """Relative change of the principal distance, which a good start does not change by much."""
    misses: float
    """Spread of the misses, image units: it compares calibrations."""

    @property
    def fits_well(self) -> bool:
        """Whether no other calibration need be tried."""
        unit = float(np.median(self.growth.views.sigma))
        c = max(float(values[0]) for values in self.growth.calibrations)
        near = self.misses < max(3.0 * unit, WELL * c)
        return self.share >= ENOUGH and near and not self.stuck and self.moved < MOVED

    def better_than(self, other: _Begun) -> bool:
        """Return whether it has smaller misses with not many fewer image points, or many more."""
        if self.fitting > 2.0 * other.fitting:
            return True
        return self.fitting > 0.6 * other.fitting and self.misses < other.misses

    def as_good_as(self, other: _Begun) -> bool:
        """Return whether nearly as many image points agree nearly as well."""
        return self.fitting > 0.8 * other.fitting and self.misses < 1.5 * other.misses


def best_start(empty: Growth, free: Mask, most: int) -> _Begun | None:
    """Return a part after a few turns from the best start pair.

    A flat object and two photos have a second solution, which a third photo contradicts: a start
    is judged by how many image points agree after a few turns.
    """
    best: _Begun | None = None
    for pair in start_pairs(empty, free)[:most]:
        growth = empty.copy()
        if not start_with(growth, pair):
            continue
        growth.intersect(parallax=RULES.parallax)
        if not adjust_growth(growth, calibrate=False):
            continue
        refused = grow(growth, free, turns=TRIAL_TURNS)
        begun = _judged(
            growth, pair, empty.calibrations, stuck=refused > MOST_REFUSED * int(growth.posed.sum())
        )
        if best is None or begun.fitting > best.fitting:
            best = begun
        if begun.share >= ENOUGH and not begun.stuck:
            break
    return best


def _judged(growth: Growth, pair: Pair, given: tuple[Array, ...], *, stuck: bool) -> _Begun:
    """Count the image points that agree; points that one oriented photo sees do not count."""
    fits = growth.fitting()
    n = int(fits.sum())
    v = growth.views
    rows = growth.wanted & growth.posed[v.photo]
    seen = np.bincount(v.point[rows], minlength=len(growth.point))
    at = np.flatnonzero(fits)
    misses = float(np.median(growth.misses(at) * v.sigma[at])) if n else np.inf
    share = n / max(int(seen[seen >= 2].sum()), 1)
    moved = max(
        abs(float(now[0] / before[0]) - 1.0)
        for now, before in zip(growth.calibrations, given, strict=True)
    )
    return _Begun(growth, pair, float(n), share, stuck, moved, misses / RAYLEIGH_MEDIAN)


def grow(growth: Growth, free: Mask, *, turns: int | None = None) -> int:
    """Orient further photos in turns until no photo can be oriented, in place.

    Args:
        growth: the part.
        free: photos that may be oriented, (photos,).
        turns: largest number of turns; none: as many as it takes.

    Returns:
        Number of photos that see enough known points and do not fit them; 0 if turns remain.
    """
    adjusted = int(growth.posed.sum())
    turn = 0
    while turns is None or turn < turns:
        new = _resect(growth, free, least=EASY)
        if not new.any():
            new = _resect(growth, free, least=RULES.least_rays)
        if not new.any():
            v = growth.views
            usable = growth.wanted & growth.placed[v.point] & (free & ~growth.posed)[v.photo]
            return int((np.bincount(v.photo[usable], minlength=len(free)) >= EASY).sum())
        turn += 1
        growth.intersect(parallax=RULES.parallax)
        n = int(growth.posed.sum())
        whole = n <= MANY_PHOTOS or n >= GROWN * adjusted
        moving = None if whole else _around(growth, new)
        adjust_growth(growth, moving=moving, calibrate=n >= CALIBRATED_FROM)
        adjusted = n if whole else adjusted
        growth.review()
        growth.intersect(parallax=RULES.parallax)
    return 0


def _around(growth: Growth, new: Mask) -> Mask:
    """Return the new photos and those that share many points with them."""
    table = growth.views.table(growth.fitting())
    common = np.asarray((table @ table[new].T).max(axis=1).todense()).ravel()
    return np.asarray(growth.posed & (new | (common >= EASY)))


def _resect(growth: Growth, free: Mask, *, least: int) -> Mask:
    """Orient the photos that see most known points; return which were oriented."""
    v = growth.views
    usable = growth.wanted & growth.placed[v.point] & (free & ~growth.posed)[v.photo]
    count = np.bincount(v.photo[usable], minlength=len(growth.pose))
    new = np.zeros(len(growth.pose), dtype=bool)
    found = growth.pose.copy()
    most = 0
    for photo in np.argsort(-count, kind="stable").tolist():
        if count[photo] < max(least, HALF * most):
            break
        rows = np.flatnonzero(usable & (v.photo == photo))
        pose = absolute_pose(
            growth.rays.tangent[rows],
            growth.point[v.point[rows]],
            limit=_loose(growth) * float(np.median(growth.rays.unit[rows])),
        )
        if pose is None or pose[2].sum() < max(least, RULES.least_share * len(rows)):
            continue
        most = most or int(count[photo])
        found[photo] = np.concatenate([pose[0].ravel(), pose[1]])
        new[photo] = True
    growth.pose = found
    return new


def _loose(growth: Growth) -> float:
    """Return the limit of a resection: points on the rim of a block are less certain."""
    return 2.0 * growth.limit


def finish(growth: Growth, free: Mask) -> Mask:
    """Take all image points in, adjust, and look again at everything that was left out, in place.

    Returns:
        The image points that agree with the block, (n,).
    """
    whole = growth.rays.usable
    if whole.sum() > growth.wanted.sum():
        adjust_growth(growth)
        growth.review()
    growth.wanted, growth.ended = whole, True
    before = -1
    for _ in range(LAST_ROUNDS):
        growth.intersect(parallax=RULES.least_parallax)
        adjust_growth(growth, passes=1)
        growth.review()
        growth.reconsider()
        fits = growth.review()
        growth.intersect(parallax=RULES.least_parallax)
        new = _resect(growth, free, least=RULES.least_at_end)
        if not new.any() and fits.sum() <= 1.001 * before:
            break
        before = int(fits.sum())
    return growth.review()
