"""Why images cannot be oriented, or not together: what is told, and what would help."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from ..types import Array, Index, Mask
from .build import Part
from .focal import Distances
from .growth import RULES
from .pairs import LEAST_COMMON
from .robust_poses import absolute_pose
from .views import Rays, Views

NO_BASE = 5.0
"""Median miss of the rays of two photos after the best rotation, in standard deviations of an image
point, up to which they were taken from one place."""
OTHER_DISTANCE = 0.1
"""Relative difference of a held principal distance from that of the pairs that is told."""
TURNED = 0.7
"""Share of the image points of a photo that must fit with its axes turned."""
MOST_LISTED = 8
"""Largest number of photos that are listed."""


def why_none(views: Views, rays: Rays) -> str:
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
    if most < LEAST_COMMON:
        pair = ""
        if most:
            at = int(np.argmax(common.data))
            pair = f", {views.photos[common.row[at]]} and {views.photos[common.col[at]]}"
        return (
            f"{lead}two photos have at most {most} points in common{pair}, and {LEAST_COMMON} are "
            "needed: has a point the same name in all photos? otherwise measure more points in "
            "several photos"
        )
    order = np.argsort(-common.data, kind="stable")[:MOST_LISTED]
    turns = [_miss_of_rotation(views, rays, int(common.row[i]), int(common.col[i])) for i in order]
    if np.median(turns) <= NO_BASE:
        return (
            f"{lead}two photos have up to {most} points in common, and their rays differ by a "
            "rotation only: the photos were taken from one place, and have no base; take photos "
            "from other places"
        )
    return (
        f"{lead}two photos have up to {most} points in common, and fewer than {LEAST_COMMON} of "
        "them fit each other: are the names of the points the same in all photos, is the principal "
        "distance in image units, and does y count upwards?"
    )


def _miss_of_rotation(views: Views, rays: Rays, first: int, second: int) -> float:
    """Return the median miss after the best rotation, in standard deviations."""
    a, b = (np.flatnonzero(rays.usable & (views.photo == f)) for f in (first, second))
    _, i, j = np.intersect1d(views.point[a], views.point[b], return_indices=True)
    d, e = (_unit(rays.tangent[rows]) for rows in (a[i], b[j]))
    keep = np.ones(len(d), dtype=bool)
    miss = np.zeros(len(d))
    for _ in range(5):
        u, _, vt = np.linalg.svd(d[keep].T @ e[keep])
        rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
        miss = np.linalg.norm(d - e @ rotation.T, axis=1)
        keep = miss <= 2.0 * np.median(miss) + 1e-15
    return float(np.median(miss / (rays.unit[a[i]] + rays.unit[b[j]])))


def _unit(tangent: Array) -> Array:
    d = np.column_stack([tangent[:, 0], -tangent[:, 1], np.ones(len(tangent))])
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def doubts(views: Views, parts: Sequence[Part], distances: Distances) -> tuple[str, ...]:
    """Return what is told where parts share many points, and were not oriented together."""
    apart = [
        (i, shared)
        for i, part in enumerate(parts[1:], 1)
        if (shared := int((parts[0].growth.placed & part.growth.placed).sum())) >= LEAST_COMMON
    ]
    if not apart:
        return ()
    listed = ", ".join(f"part {i + 1} {n} points" for i, n in apart[:MOST_LISTED])
    out = [f"Parts share points with part 1 and do not fit it ({listed}): something is wrong."]
    out += _other_distances(views, distances)
    out += _turned(views, parts)
    if len(out) == 1:
        out.append(
            "Is the calibration that of these photos, and are the points named as in the others?"
        )
    return tuple(out)


def _other_distances(views: Views, distances: Distances) -> Iterator[str]:
    """Iterate over cameras of which pairs of photos tell another principal distance."""
    for camera in views.cameras:
        told, given = distances.by_pairs(camera.name), camera.values[0]
        if told is not None and abs(told / given - 1.0) > OTHER_DISTANCE:
            yield (
                f"Camera {camera.name}: pairs of photos have a principal distance of about "
                f"{told:.3g}, not {given:.6g}: correct it, or let c be free for a search."
            )


def _turned(views: Views, parts: Sequence[Part]) -> Iterator[str]:
    """Tell the photos of later parts that fit the first one with another axis of the image."""
    growth = parts[0].growth
    found: dict[str, list[str]] = {}
    for photo in np.flatnonzero(np.any([p.growth.posed for p in parts[1:]], axis=0)).tolist():
        rows = _known(views, growth.rays.usable, growth.placed, photo)
        if len(rows) < RULES.least_rays:
            continue
        limit = 2.0 * growth.limit * float(np.median(growth.rays.unit[rows]))
        x, t = growth.point[views.point[rows]], growth.rays.tangent[rows]
        for what, turned in (
            ("with one axis of the image the other way (does y count downwards?)", t * [1.0, -1.0]),
            ("with x and y of the image exchanged", t[:, ::-1]),
        ):
            pose = absolute_pose(np.ascontiguousarray(turned), x, limit=limit)
            if pose is not None and pose[2].mean() >= TURNED:
                found.setdefault(what, []).append(views.photos[photo])
                break
    for what, names in found.items():
        listed = ", ".join(names[:MOST_LISTED]) + " …" * (len(names) > MOST_LISTED)
        yield f"Photos that fit part 1 {what}: {listed}."


def _known(views: Views, usable: Mask, placed: Mask, photo: int) -> Index:
    return np.flatnonzero(usable & (views.photo == photo) & placed[views.point])
