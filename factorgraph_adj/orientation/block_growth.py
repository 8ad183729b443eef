"""Growth of parts of a block from pairs: resection, intersection and adjustment in turns.

A part grows from a pair of photos; a start is judged after a few turns by how many image points
agree. The adjustments on the way are bundle adjustments of the library: the part is a free network,
or the photos around the new ones are held. The calibration takes part as weighted unknowns: each
parameter that the network leaves free may change what it does at the edge of the image by a few per
cent of the principal distance. Image points get the weights of Huber's estimator.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np

from ..entities import Camera
from ..errors import AdjustmentError, DatumError
from ..graph.equations import compile_network
from ..network.network import Network
from ..solve.minimum import adjust_from_start
from ..start.start_values import Start
from ..types import Array, Index, Mask
from .block_input import Views, well_spread_image_points
from .partial_block import GROWTH, PartialBlock, PhotoPair, begin_with_pair, start_pairs
from .robust_poses import RAYLEIGH_MEDIAN, absolute_pose
from .unknown_calibration import PrincipalDistances

CALIBRATION_PRIOR_RATIO = 0.03
"""Standard deviation of the effect of a calibration parameter, part of the principal distance."""
HUBER_SPREAD_RATIO = 2.0
"""Multiple of the spread of misses beyond which weights fall."""
WEIGHT_PASSES = 2
"""Number of times that weights are computed."""
GROWTH_STEP_TOLERANCE = 0.3
"""Bound on the last step relative to σ: an adjustment on the way need not be exact."""
MAX_GROWTH_ITERATIONS = 12
"""Largest number of iterations of one pass."""
MAX_GROWTH_TRIES = 4
"""Largest number of times that points are left out that the image points do not determine."""
MAX_START_PAIRS = 6
"""Largest number of start pairs that are tried for one part."""
MAX_START_PAIRS_OF_CALIBRATION = 3
"""The same for each calibration where several are tried."""
TRIAL_TURNS = 3
"""Number of turns after which a start is judged."""
MIN_FITTING_SHARE = 0.7
"""Share of the image points in oriented photos that must agree with a start that is kept."""
MAX_GOOD_SPREAD = 3e-4
"""Spread of misses, part of the principal distance, of a start with a calibration that fits."""
MAX_GOOD_DISTANCE_CHANGE = 0.1
"""Largest relative change of the principal distance in the first turns of a good start."""
MAX_REFUSED_SHARE = 0.3
"""Largest number of photos, as a share of the oriented ones, that a good start cannot orient."""
MAX_IMAGE_POINTS_IN_GROWTH = 300
"""Number of image points of a photo that take part while the block grows."""
MIN_POINTS_OF_SURE_PHOTO = 15
"""Number of known points of a photo that is oriented at once."""
MIN_SHARE_OF_BEST_PHOTO = 0.5
"""Photos with this share of the known points of the best photo are oriented in the same turn."""
MAX_PHOTOS_ADJUSTED_WHOLE = 30
"""Number of photos above which an adjustment on the way moves new photos and their neighbours."""
GROWTH_UNTIL_WHOLE_ADJUSTMENT = 1.25
"""Growth of the number of photos after which the whole part is adjusted again."""
MIN_PHOTOS_TO_CALIBRATE = 4
"""Number of photos from which the calibration is improved."""
MAX_FINAL_ROUNDS = 3
"""Largest number of adjustments of all image points at the end."""


def adjust_part(
    growth: PartialBlock,
    *,
    moving: Mask | None = None,
    calibrate: bool = True,
    passes: int = WEIGHT_PASSES,
) -> bool:
    """Adjust poses and points of a part, in place.

    Args:
        growth: the part.
        moving: photos that move, (photos,); the others are held. None: all move.
        calibrate: whether the calibration is improved.
        passes: number of times that weights are computed.

    Returns:
        Whether an adjustment was possible.
    """
    rows = np.flatnonzero(growth.review())
    strong = growth.strengths(rows) >= GROWTH.parallax / 2 if len(rows) else np.zeros(0, bool)
    rows = rows[strong[growth.views.point[rows]]] if len(rows) else rows
    if moving is not None:
        seen = np.zeros(len(growth.point), dtype=bool)
        seen[growth.views.point[rows[moving[growth.views.photo[rows]]]]] = True
        rows = rows[seen[growth.views.point[rows]]]
    for _ in range(MAX_GROWTH_TRIES):
        if len(rows) < GROWTH.least_rays:
            return False
        try:
            _adjust(growth, rows, moving, calibrate, passes)
            return True
        except DatumError as error:
            lost = {name for kind, name in error.unknowns if kind == "point"}
            lost |= set(error.names)
            number = growth.views.network.point_number
            away = np.zeros(len(growth.point), dtype=bool)
            away[[number[n] for n in lost if n in number]] = True
            if not away.any():
                return False
            rows = rows[~away[growth.views.point[rows]]]
        except AdjustmentError:
            # A point passed behind a photo: what pulled there leaves.
            rows = _without_the_worst(growth, rows)
    return False


def _without_the_worst(growth: PartialBlock, rows: Index) -> Index:
    v = growth.views
    miss = growth.misses(rows)
    bad = np.unique(v.point[rows[miss > np.quantile(miss, 0.9)]])
    keep = np.ones(len(growth.point), dtype=bool)
    keep[bad] = False
    return rows[keep[v.point[rows]]]


def _adjust(
    growth: PartialBlock, rows: Index, moving: Mask | None, calibrate: bool, passes: int
) -> None:
    v = growth.views
    photos, photo = np.unique(v.photo[rows], return_inverse=True)
    points, point = np.unique(v.point[rows], return_inverse=True)
    held = np.zeros(len(photos), dtype=bool) if moving is None else ~moving[photos]
    network = Network("part", datum="given" if held.any() else "free")
    for number, camera in enumerate(v.cameras):
        network.cameras[camera.name] = _camera(growth, number, calibrate and not held.any())
    of_photo = list(v.network.photos.values())
    for number, fixed in zip(photos.tolist(), held.tolist(), strict=True):
        pose = growth.pose[number]
        network.add_photo(
            v.photos[number],
            of_photo[number].camera,
            position=pose[9:],
            rotation=pose[:9].reshape(3, 3),
            fixed=fixed,
        )
    network.add_points([v.points[p] for p in points.tolist()], growth.point[points])
    sigma = np.repeat(v.sigma[rows, None], 2, axis=1)
    network.images.append(photo, point, v.xy[rows], sigma)
    equations = compile_network(network)
    state = equations.unknowns.start()
    start = Start(equations.unknowns, state, state)
    for _ in range(passes):
        weights = _weights(equations.residuals(start.state), equations.blocks)
        solution = adjust_from_start(
            equations,
            start,
            free=not held.any(),
            weights=weights,
            tolerance=GROWTH_STEP_TOLERANCE,
            max_iterations=MAX_GROWTH_ITERATIONS,
            astray=True,
        )
        start = Start(equations.unknowns, solution.state, solution.state)
    unknowns, state = equations.unknowns, start.state
    moved = np.flatnonzero(~held)
    numbers = [unknowns["pose"].number[v.photos[f]] for f in photos[moved].tolist()]
    growth.pose[photos[moved]] = state["pose"][numbers]
    numbers = [unknowns["point"].number[v.points[p]] for p in points.tolist()]
    growth.point[points] = state["point"][numbers]
    if calibrate and not held.any():
        new = list(growth.calibrations)
        for number, camera in enumerate(v.cameras):
            if not camera.per_photo and camera.name in unknowns["calibration"].number:
                own = unknowns["calibration"].number[camera.name]
                new[number] = unknowns.given(state, "calibration", own)
        growth.calibrate(tuple(new))


def _weights(v: Array, blocks: tuple) -> Array:  # type: ignore[type-arg]
    """Return Huber's factors of the weights from whitened residuals, one for each image point."""
    out = np.ones(len(v))
    for block in blocks:
        if block.lens is None:
            continue
        size = np.linalg.norm(v[block.rows].reshape(-1, 2), axis=1)
        spread = max(float(np.median(size)) / RAYLEIGH_MEDIAN, 1e-12)
        out[block.rows] = np.repeat(
            np.minimum(1.0, HUBER_SPREAD_RATIO * spread / np.maximum(size, 1e-12)), 2
        )
    return out


def _camera(growth: PartialBlock, number: int, calibrate: bool) -> Camera:
    """Return a camera with the calibration so far; what is free in the network is weighted."""
    camera, values = growth.views.cameras[number], growth.calibrations[number]
    given = tuple(values.tolist())
    if camera.per_photo or not calibrate or all(camera.fixed):
        return replace(
            camera, values=given, fixed=(True,) * len(given), sigma=(np.inf,) * len(given)
        )
    first = np.array(camera.values)
    rows = np.flatnonzero(growth.rays.usable & (growth.views.camera == number))
    t, xy = growth.rays.tangent[rows], growth.views.xy[rows]
    effect = np.zeros(len(given))
    if len(rows):
        _, _, by_k = camera.lens.residual(t[:, 0], t[:, 1], xy, values[None])
        assert by_k is not None
        effect = np.abs(by_k).max(axis=(0, 1))
    prior = CALIBRATION_PRIOR_RATIO * first[0] / np.maximum(effect, 1e-300)
    sigma = np.where(camera.fixed, np.inf, np.minimum(prior, camera.sigma))
    usable = np.isfinite(sigma) & (effect > 0)
    return replace(
        camera,
        values=given,
        fixed=tuple((~usable).tolist()),
        sigma=tuple(np.where(usable, sigma, np.inf).tolist()),
    )


@dataclass(frozen=True, eq=False)
class BlockPart:
    """Photos that were oriented together."""

    growth: PartialBlock
    """Their poses and points, in axes and with the scale of the start pair."""
    start: tuple[str, str]
    """Names of the photos of the start pair."""
    fits: Mask
    """Image points that agree, (n,)."""

    @property
    def n_photos(self) -> int:
        """Number of photos."""
        return int(self.growth.posed.sum())


def build_parts(views: Views, distances: PrincipalDistances) -> list[BlockPart]:
    """Orient all photos that can be oriented, in as many parts as they need.

    Args:
        views: the image points.
        distances: calibrations with which the block may start.
    """
    every = np.ones(views.n, dtype=bool)
    skeleton = well_spread_image_points(views, every, MAX_IMAGE_POINTS_IN_GROWTH)
    free = np.ones(len(views.photos), dtype=bool)
    parts: list[BlockPart] = []
    while free.sum() >= 2:
        choices: Iterable[tuple[Array, ...]] = chain([distances.first()], distances.others())
        starts = MAX_START_PAIRS_OF_CALIBRATION if distances.guessed else MAX_START_PAIRS
        if parts:
            choices, starts = [parts[0].growth.calibrations], MAX_START_PAIRS
        part = _next_part(views, choices, starts, skeleton, free)
        if part is None:
            break
        free &= ~part.growth.posed
        parts.append(part)
    return parts


def _next_part(
    views: Views, choices: Iterable[tuple[Array, ...]], starts: int, skeleton: Mask, free: Mask
) -> BlockPart | None:
    """Return the part from the best start, with the first calibration that fits well, or the best.

    A wrong principal distance leaves misses that the wide limit of the start lets pass: the better
    of two calibrations has the smaller misses, with nearly as many image points that agree.
    """
    best: _StartedPart | None = None
    for calibrations in choices:
        empty = PartialBlock.empty(views, calibrations, skeleton)
        begun = best_started_part(empty, free, starts)
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
    grow_part(growth, free)
    fits = complete_part(growth, free)
    if growth.posed.sum() < 2:
        return None
    return BlockPart(growth, (views.photos[pair.first], views.photos[pair.second]), fits)


@dataclass(frozen=True, eq=False)
class _StartedPart:
    """A part after a few turns."""

    growth: PartialBlock
    pair: PhotoPair
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
        near = self.misses < max(3.0 * unit, MAX_GOOD_SPREAD * c)
        return (
            self.share >= MIN_FITTING_SHARE
            and near
            and not self.stuck
            and self.moved < MAX_GOOD_DISTANCE_CHANGE
        )

    def better_than(self, other: _StartedPart) -> bool:
        """Return whether it has smaller misses with not many fewer image points, or many more."""
        if self.fitting > 2.0 * other.fitting:
            return True
        return self.fitting > 0.6 * other.fitting and self.misses < other.misses

    def as_good_as(self, other: _StartedPart) -> bool:
        """Return whether nearly as many image points agree nearly as well."""
        return self.fitting > 0.8 * other.fitting and self.misses < 1.5 * other.misses


def best_started_part(empty: PartialBlock, free: Mask, most: int) -> _StartedPart | None:
    """Return a part after a few turns from the best start pair.

    A flat object and two photos have a second solution, which a third photo contradicts: a start
    is judged by how many image points agree after a few turns.
    """
    best: _StartedPart | None = None
    for pair in start_pairs(empty, free)[:most]:
        growth = empty.copy()
        if not begin_with_pair(growth, pair):
            continue
        growth.intersect(parallax=GROWTH.parallax)
        if not adjust_part(growth, calibrate=False):
            continue
        refused = grow_part(growth, free, turns=TRIAL_TURNS)
        begun = _judged(
            growth,
            pair,
            empty.calibrations,
            stuck=refused > MAX_REFUSED_SHARE * int(growth.posed.sum()),
        )
        if best is None or begun.fitting > best.fitting:
            best = begun
        if begun.share >= MIN_FITTING_SHARE and not begun.stuck:
            break
    return best


def _judged(
    growth: PartialBlock, pair: PhotoPair, given: tuple[Array, ...], *, stuck: bool
) -> _StartedPart:
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
    return _StartedPart(growth, pair, float(n), share, stuck, moved, misses / RAYLEIGH_MEDIAN)


def grow_part(growth: PartialBlock, free: Mask, *, turns: int | None = None) -> int:
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
        new = _resect(growth, free, least=MIN_POINTS_OF_SURE_PHOTO)
        if not new.any():
            new = _resect(growth, free, least=GROWTH.least_rays)
        if not new.any():
            v = growth.views
            usable = growth.wanted & growth.placed[v.point] & (free & ~growth.posed)[v.photo]
            return int(
                (
                    np.bincount(v.photo[usable], minlength=len(free)) >= MIN_POINTS_OF_SURE_PHOTO
                ).sum()
            )
        turn += 1
        growth.intersect(parallax=GROWTH.parallax)
        n = int(growth.posed.sum())
        whole = n <= MAX_PHOTOS_ADJUSTED_WHOLE or n >= GROWTH_UNTIL_WHOLE_ADJUSTMENT * adjusted
        moving = None if whole else _around(growth, new)
        adjust_part(growth, moving=moving, calibrate=n >= MIN_PHOTOS_TO_CALIBRATE)
        adjusted = n if whole else adjusted
        growth.review()
        growth.intersect(parallax=GROWTH.parallax)
    return 0


def _around(growth: PartialBlock, new: Mask) -> Mask:
    """Return the new photos and those that share many points with them."""
    table = growth.views.table(growth.fitting())
    common = np.asarray((table @ table[new].T).max(axis=1).todense()).ravel()
    return np.asarray(growth.posed & (new | (common >= MIN_POINTS_OF_SURE_PHOTO)))


def _resect(growth: PartialBlock, free: Mask, *, least: int) -> Mask:
    """Orient the photos that see most known points; return which were oriented."""
    v = growth.views
    usable = growth.wanted & growth.placed[v.point] & (free & ~growth.posed)[v.photo]
    count = np.bincount(v.photo[usable], minlength=len(growth.pose))
    new = np.zeros(len(growth.pose), dtype=bool)
    found = growth.pose.copy()
    most = 0
    for photo in np.argsort(-count, kind="stable").tolist():
        if count[photo] < max(least, MIN_SHARE_OF_BEST_PHOTO * most):
            break
        rows = np.flatnonzero(usable & (v.photo == photo))
        pose = absolute_pose(
            growth.rays.tangent[rows],
            growth.point[v.point[rows]],
            limit=_resection_limit(growth) * float(np.median(growth.rays.unit[rows])),
        )
        if pose is None or pose[2].sum() < max(least, GROWTH.least_share * len(rows)):
            continue
        most = most or int(count[photo])
        found[photo] = np.concatenate([pose[0].ravel(), pose[1]])
        new[photo] = True
    growth.pose = found
    return new


def _resection_limit(growth: PartialBlock) -> float:
    """Return the limit of a resection: points on the rim of a block are less certain."""
    return 2.0 * growth.limit


def complete_part(growth: PartialBlock, free: Mask) -> Mask:
    """Take all image points in, adjust, and look again at everything that was left out, in place.

    Returns:
        The image points that agree with the block, (n,).
    """
    whole = growth.rays.usable
    if whole.sum() > growth.wanted.sum():
        adjust_part(growth)
        growth.review()
    growth.wanted, growth.ended = whole, True
    before = -1
    for _ in range(MAX_FINAL_ROUNDS):
        growth.intersect(parallax=GROWTH.least_parallax)
        adjust_part(growth, passes=1)
        growth.review()
        growth.reconsider()
        fits = growth.review()
        growth.intersect(parallax=GROWTH.least_parallax)
        new = _resect(growth, free, least=GROWTH.least_at_end)
        if not new.any() and fits.sum() <= 1.001 * before:
            break
        before = int(fits.sum())
    return growth.review()
