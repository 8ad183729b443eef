"""Result of a block orientation; photos of partly known pose; reasons why others failed; doubts.

A photo with too few image points for a resection still has a pose if its projection centre or its
attitude is known: two rays to points of the block give the rest. One ray leaves the rotation about
itself open. Where photos, or whole parts, cannot be oriented, the reason says what would help:
names of points, the principal distance, the axes of the image, more photos.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import known
from ..graph.observation_selection import filtered
from ..models.unknown_registry import VariableKind
from ..network.network import Network
from ..observations.base import joined_points
from ..result_display import Rows, Shown
from ..rotation import nearest_rotation
from ..start.resection import resected_pose
from ..start.start_values import Start
from ..types import Index, Mask
from .block_growth import BlockPart
from .block_input import IdealRays, KnownPlaces, Views, ray_directions
from .partial_block import GROWTH, MIN_PAIR_POINTS, PartialBlock
from .robust_poses import absolute_pose, ray_misses
from .unknown_calibration import PrincipalDistances

NO_RESECTION = 10**9
"""Number of rays of a photo of which nothing is given: it is oriented otherwise."""
MAX_MISS_RATIO_AT_KNOWN_CENTRE = 10.0
"""Multiple of the limit of misses within which an image point agrees with a photo that a known
projection centre places: the centre has an error of its own."""
MAX_MISS_WITHOUT_BASE = 5.0
"""Median miss of the rays of two photos after the best rotation, in standard deviations of an image
point, up to which they were taken from one place."""
MIN_DISTANCE_DIFFERENCE = 0.1
"""Relative difference of a held principal distance from that of the pairs that is reported."""
MIN_SHARE_WITH_OTHER_AXES = 0.7
"""Share of the image points of a photo that must fit with its axes turned."""
MAX_PHOTOS_IN_MESSAGE = 8
"""Largest number of photos that are listed."""


@dataclass(frozen=True)
class OrientedPart:
    """Photos that were oriented together, from one start pair."""

    photos: tuple[str, ...]
    """Names of the photos."""
    start: tuple[str, str]
    """Names of the start pair."""
    n_points: int
    """Number of points."""
    n_fitting: int
    """Number of image points that agree."""
    spread: float
    """Standard deviation of the image points of the part, in their a-priori ones, from the median
    of the misses."""
    datum: str
    """What gave scale, rotation and shift, in words."""
    placed: bool
    """Whether all seven were found."""
    misfit: float
    """Median distance of known places from those of the part, metres; NaN: none is known."""

    def sentence(self) -> str:
        """Return the part in words."""
        off = f", median misfit {self.misfit:.2g} m" if np.isfinite(self.misfit) else ""
        placed = "placed in the frame by" if self.placed else "its place in the frame:"
        return (
            f"{len(self.photos)} photos from the pair {self.start[0]}, {self.start[1]}; "
            f"{len(self.photos) - 2} by resection, {self.n_points} points by intersection; "
            f"{placed} {self.datum}{off}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class BlockStart(Shown):
    """Poses and points of a block that were found from its image points."""

    network: Network
    """The network, which is not changed."""
    start: Start | None
    """Start of an adjustment; none: ``problems`` names what has no values."""
    parts: tuple[OrientedPart, ...]
    """Parts, the first one found first."""
    doubtful: tuple[str, ...]
    """Ids of the image points of oriented photos that do not agree with the block."""
    doubtful_rows: Mask
    """The same by their rows in the table of image points, (n,)."""
    unoriented: dict[str, str]
    """Photos that were not oriented, and why."""
    unreached: tuple[str, ...]
    """Points of which fewer than two image points agree; their start values are rough."""
    found_distances: dict[str, float]
    """Principal distance by camera where another than the given one was found, image units."""
    problems: tuple[str, ...] = ()
    """Why there is no start: what has no values."""
    by_given: tuple[str, ...] = ()
    """Photos with too few image points for a resection that were oriented from their known
    projection centres or attitudes."""
    doubts: tuple[str, ...] = ()
    """What may be wrong where parts share many points and do not fit one another."""

    def headline(self) -> str:
        """Return how many photos and points were found, and what was left out."""
        n = sum(len(p.photos) for p in self.parts) + len(self.by_given)
        return (
            f"BlockStart: {n} of {len(self.network.photos)} photos in {len(self.parts)} "
            f"part{'s' * (len(self.parts) != 1)}, {len(self.doubtful)} of "
            f"{self.network.n_image_points} image points doubtful"
        )

    def first_rows(self) -> Rows:
        """Return the parts."""
        header = ("start pair", "photos", "points", "image points", "spread", "datum")
        rows = (
            (", ".join(p.start), len(p.photos), p.n_points, p.n_fitting, p.spread, p.datum)
            for p in self.parts
        )
        return Rows(header, rows, len(self.parts))

    def sentences(self, *, most: int = 12) -> tuple[str, ...]:
        """Return in words how the block was oriented and what it left out.

        Args:
            most: number of names that are listed at most.
        """
        several = len(self.parts) > 1
        out = [
            f"Start from image points{f', part {i}' if several else ''}: {p.sentence()}."
            for i, p in enumerate(self.parts, 1)
        ]
        out += [
            f"Principal distance of camera {name}: {value:.6g} was found by a search."
            for name, value in self.found_distances.items()
        ]
        out += self.doubts
        if self.by_given:
            out.append(
                "Oriented from known projection centres or attitudes, and two rays or more: "
                f"{known(self.by_given, most=most)}."
            )
        if self.doubtful:
            out.append(
                f"{len(self.doubtful)} image points do not agree with the start, and were not used "
                f"for it: {known(self.doubtful, most=most)}."
            )
        if self.unreached:
            out.append(
                "Fewer than two image points agree on these points, whose start values are rough: "
                f"{known(self.unreached, most=most)}."
            )
        out += [f"Photo {name} was not oriented: {why}." for name, why in self.unoriented.items()]
        return tuple(out)

    def without_doubtful(self) -> Network:
        """Return the network without the doubtful image points and what they alone determine.

        The points of ``unreached`` are taken out with all their image points, and photos that were
        not oriented with theirs, unless something else observes them.
        """
        photo, point, _, _ = self.network.images.columns()
        out = self.network.copy()
        lost = _flags_of(self.network.points, self.unreached)
        away = _flags_of(self.network.photos, self.unoriented)
        out.image_mask(~(self.doubtful_rows | lost[point] | away[photo]))
        observed_points = joined_points(out.observations.values())
        observed_photos = {f for o in out.observations.values() for f in o.photos()}
        seen = set(np.array(list(out.points), dtype=object)[out.images.columns()[1]].tolist())

        def stays(kind: VariableKind, name: str) -> bool:
            if kind == "pose":
                return name not in self.unoriented or name in observed_photos
            if kind == "point":
                return name in seen or name in observed_points
            return True

        return filtered(out, stays)


def _flags_of(names: Mapping[str, object], some: Collection[str]) -> Mask:
    """Return flags of some of many names."""
    chosen = set(some)
    return np.array([n in chosen for n in names], dtype=bool)


def add_photos_of_known_pose(growth: PartialBlock, known: KnownPlaces) -> Mask:
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
    growth.intersect(parallax=GROWTH.least_parallax)
    new &= growth.placed
    v = growth.views
    return np.asarray(growth.fitting() & (new[v.point] | stands[v.photo]))


def orient_by_given_centre_or_attitude(
    growth: PartialBlock, known: KnownPlaces
) -> tuple[Mask, Mask]:
    """Orient photos with known projection centres or attitudes from two rays or more, in place.

    Args:
        growth: as for `add_photos_of_known_pose`.
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
            pose = resected_pose(known.pose[photo], x, ray_directions(t), NO_RESECTION)
            if pose is None:
                continue
            miss = ray_misses(pose[:9].reshape(1, 3, 3), pose[None, 9:], x, t)
            fits = miss / growth.rays.unit[rows] <= MAX_MISS_RATIO_AT_KNOWN_CENTRE * growth.limit
            if fits.sum() < 2:
                continue
            growth.pose[photo] = pose
            agree[rows[fits]] = done[photo] = found = True
        if not found:
            return done, agree
        before = growth.placed
        growth.intersect(parallax=GROWTH.least_parallax)
        agree |= growth.fitting() & (growth.placed & ~before)[v.point]


def reason_not_oriented(every: int, of_block: int, alone: int, *, centred: bool) -> str:
    """Return why a photo was not oriented, and what would help.

    Args:
        every: number of its image points.
        of_block: number of those of points of the block.
        alone: number of those of points that no other photo has.
        centred: whether its projection centre is known.
    """
    found = f"{of_block} of its {every} image points belong to points of the block"
    if of_block >= GROWTH.least_at_end:
        return (
            f"{found}, and fewer than {GROWTH.least_at_end} of them fit one pose: are they named "
            "as in the other photos, and is the calibration that of this photo?"
        )
    lone = f" ({alone} to points that no other photo sees)" if alone else ""
    if centred:
        return (
            f"{found}{lone}; with its known projection centre two that fit give its rotation, and "
            "one leaves the rotation about its ray open: observe its attitude, measure more points "
            "of other photos in it, or take it out"
        )
    return (
        f"{found}{lone}; a resection needs {GROWTH.least_at_end} that fit, or two with a known "
        "projection centre or attitude: measure more points of other photos in it, or take it out"
    )


def reason_no_pair(views: Views, rays: IdealRays) -> str:
    """Return why no pair of photos could be oriented, and what would help."""
    table = views.table(rays.usable)
    seen = np.flatnonzero(np.diff(table.indptr) > 0)
    lead = "no pair of photos could be oriented from image points: "
    measured = len(np.unique(views.photo))
    if len(seen) < 2 <= measured:
        lost = int((~rays.usable).sum())
        names = [c.name for i, c in enumerate(views.cameras) if (views.camera == i).any()]
        return (
            f"{lead}{lost} of {views.n} image points in {measured} photos have rays beside the "
            f"camera, or none with its lens: is the principal distance of {', '.join(names)} in "
            "the unit of the image points, and are they measured from the middle of the image?"
        )
    if len(seen) < 2:
        return (
            f"{lead}only one photo has usable image points; two that see the same points from two "
            "places are needed; a single photo is oriented from four known points"
        )
    both = (table @ table.T).tolil()
    both.setdiag(0)
    common = both.tocoo()
    most = int(common.data.max()) if common.nnz else 0
    if most < MIN_PAIR_POINTS:
        pair = ""
        if most:
            at = int(np.argmax(common.data))
            pair = f", {views.photos[common.row[at]]} and {views.photos[common.col[at]]}"
        return (
            f"{lead}two photos have at most {most} points in common{pair}, and {MIN_PAIR_POINTS} "
            "are needed: has a point the same name in all photos? otherwise measure more points in "
            "several photos"
        )
    order = np.argsort(-common.data, kind="stable")[:MAX_PHOTOS_IN_MESSAGE]
    turns = [_miss_of_rotation(views, rays, int(common.row[i]), int(common.col[i])) for i in order]
    if np.median(turns) <= MAX_MISS_WITHOUT_BASE:
        return (
            f"{lead}two photos have up to {most} points in common, and their rays differ by a "
            "rotation only: the photos were taken from one place, and have no base; take photos "
            "from other places"
        )
    return (
        f"{lead}two photos have up to {most} points in common, and fewer than {MIN_PAIR_POINTS} of "
        "them fit each other: are the names of the points the same in all photos, is the principal "
        "distance in image units, and does y count upwards?"
    )


def _miss_of_rotation(views: Views, rays: IdealRays, first: int, second: int) -> float:
    """Return the median miss after the best rotation, in standard deviations."""
    a, b = (np.flatnonzero(rays.usable & (views.photo == f)) for f in (first, second))
    _, i, j = np.intersect1d(views.point[a], views.point[b], return_indices=True)
    d, e = (ray_directions(rays.tangent[rows]) for rows in (a[i], b[j]))
    keep = np.ones(len(d), dtype=bool)
    miss = np.zeros(len(d))
    for _ in range(5):
        rotation = nearest_rotation(d[keep].T @ e[keep])
        miss = np.linalg.norm(d - e @ rotation.T, axis=1)
        keep = miss <= 2.0 * np.median(miss) + 1e-15
    return float(np.median(miss / (rays.unit[a[i]] + rays.unit[b[j]])))


def doubts_of_parts(
    views: Views, parts: Sequence[BlockPart], distances: PrincipalDistances
) -> tuple[str, ...]:
    """Return what is reported where parts share many points, and were not oriented together."""
    apart = [
        (i, shared)
        for i, part in enumerate(parts[1:], 1)
        if (shared := int((parts[0].growth.placed & part.growth.placed).sum())) >= MIN_PAIR_POINTS
    ]
    if not apart:
        return ()
    listed = known((f"part {i + 1} {n} points" for i, n in apart), most=MAX_PHOTOS_IN_MESSAGE)
    out = [f"Parts share points with part 1 and do not fit it ({listed}): something is wrong."]
    out += _other_distances(views, distances)
    out += _photos_with_other_axes(views, parts)
    if len(out) == 1:
        out.append(
            "Is the calibration that of these photos, and are the points named as in the others?"
        )
    return tuple(out)


def _other_distances(views: Views, distances: PrincipalDistances) -> Iterator[str]:
    """Iterate over cameras of which pairs of photos determine another principal distance."""
    for camera in views.cameras:
        told, given = distances.by_pairs(camera.name), camera.values[0]
        if told is not None and abs(told / given - 1.0) > MIN_DISTANCE_DIFFERENCE:
            yield (
                f"Camera {camera.name}: pairs of photos have a principal distance of about "
                f"{told:.3g}, not {given:.6g}: correct it, or let c be free for a search."
            )


def _photos_with_other_axes(views: Views, parts: Sequence[BlockPart]) -> Iterator[str]:
    """Report the photos of later parts that fit the first one with another axis of the image."""
    growth = parts[0].growth
    found: dict[str, list[str]] = {}
    for photo in np.flatnonzero(np.any([p.growth.posed for p in parts[1:]], axis=0)).tolist():
        rows = _known(views, growth.rays.usable, growth.placed, photo)
        if len(rows) < GROWTH.least_rays:
            continue
        limit = 2.0 * growth.limit * float(np.median(growth.rays.unit[rows]))
        x, t = growth.point[views.point[rows]], growth.rays.tangent[rows]
        for what, turned in (
            ("with one axis of the image the other way (does y count downwards?)", t * [1.0, -1.0]),
            ("with x and y of the image exchanged", t[:, ::-1]),
        ):
            pose = absolute_pose(np.ascontiguousarray(turned), x, limit=limit)
            if pose is not None and pose[2].mean() >= MIN_SHARE_WITH_OTHER_AXES:
                found.setdefault(what, []).append(views.photos[photo])
                break
    for what, names in found.items():
        yield f"Photos that fit part 1 {what}: {known(names, most=MAX_PHOTOS_IN_MESSAGE)}."


def _known(views: Views, usable: Mask, placed: Mask, photo: int) -> Index:
    return np.flatnonzero(usable & (views.photo == photo) & placed[views.point])
