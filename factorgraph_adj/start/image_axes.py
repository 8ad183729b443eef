"""Mistakes of all known points in images of given poses: other image axes, equal coordinates.

The poses of a reconstruction show whether the marks of known points count along the stated axes:
the rays of a point meet then, wherever the reconstruction lies. Rows that are counted from the
lower edge, and columns and rows exchanged, are common mistakes; an adjustment with them has no
sense, and data snooping of them takes long.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..entities import Camera
from ..errors import Problem, known
from ..models.image import ALONG_X, ALONG_Y, EXCHANGED, OTHER
from ..models.inverse_lens import directions
from ..models.lens import Lens
from ..network.network import Network
from ..observations.base import of_quantities
from ..observations.registry import CONTROL_QUANTITIES
from ..types import Array, Index, Mask
from .image_rays import nearest_to_rays

AXES_IN_WORDS = {
    EXCHANGED: "with x and y exchanged",
    ALONG_Y: "with y counted upwards from the lower edge",
    ALONG_X: "with x counted from the right edge",
}
"""Other meanings of image coordinates in messages."""
MAX_RAY_MISS_OF_AXES_RAD = 0.02
"""Median angle by which rays miss their point that is not asked about, radians: one degree."""
MAX_MISS_SHARE_LEFT = 0.1
"""Largest share of that angle that is left where another meaning is the right one."""
MAX_MISS_SHARE_LEFT_OF_ROUGH_POSES = 0.5
"""The same where points and poses are rough: their own errors remain with the right meaning."""
MIN_MARKED_POINTS = 3
"""Smallest number of points with marks in two photos that determine the axes."""
MIN_RAY_STRENGTH = 1e-3
"""Smallest strength of an intersection, see `nearest_to_rays`."""
MAX_COMPARED_IMAGE_POINTS = 300
"""Largest number of image points of a camera that are compared with their points."""


def problems_of_marks(network: Network, poses: Array | None = None) -> tuple[Problem, ...]:
    """Return what is wrong with the marks of known points as a whole: their axes, their places.

    Args:
        network: the network.
        poses: stored poses, (photos, 12), NaN where unknown; none: the given ones.

    Returns:
        Problems: the rays of the points do not meet (their median miss exceeds
        `MAX_RAY_MISS_OF_AXES_RAD`), and do along other axes (to less than
        `MAX_RAY_MISS_OF_AXES_RAD`, and `MAX_MISS_SHARE_LEFT` times that); or all points have the
        same coordinates.
    """
    photo, point, xy, _ = network.images.columns()
    wanted = known_points(network)
    rows = np.flatnonzero(wanted[point]) if len(point) else np.zeros(0, dtype=np.intp)
    if not len(rows):
        return ()
    where = network.images.sources.get(int(rows[0]), "image points")
    problems = []
    names = np.array(list(network.points), dtype=object)[np.unique(point[rows])]
    if (same := _all_in_one_place(network, names.tolist())) is not None:
        problems.append(Problem(same, where))
    at = _given_poses(network) if poses is None else poses
    rows = rows[np.isfinite(at[photo[rows]]).all(axis=1)]
    rays = np.bincount(point[rows], minlength=len(wanted))
    rows = rows[rays[point[rows]] > 1]
    cameras = list(network.cameras.values())
    number = {c.name: i for i, c in enumerate(cameras)}
    camera = np.array([number[f.camera] for f in network.photos.values()], dtype=np.intp)
    central = np.array([c.lens.takes != "places" for c in cameras], dtype=bool)
    rows = rows[central[camera[photo[rows]]]]
    several, group = np.unique(point[rows], return_inverse=True)
    if len(several) < MIN_MARKED_POINTS:
        return tuple(problems)

    def miss(axes: Callable[[Array, Array], Array]) -> float:
        found = np.empty((len(rows), 3))
        for i in np.unique(camera[photo[rows]]).tolist():
            own = np.flatnonzero(camera[photo[rows]] == i)
            other = axes(xy[rows[own]], middle_of_format(cameras[i]))
            with np.errstate(all="ignore"):  # distortion far outside the image
                found[own] = directions(cameras[i].lens, other, np.array(cameras[i].values)[None])
        return _median_miss(at[photo[rows]], found, group, len(several))

    stated = miss(lambda xy, _: xy)
    if not stated > MAX_RAY_MISS_OF_AXES_RAD:
        return tuple(problems)
    best, cause = min((miss(axes), cause) for cause, axes in OTHER)
    if best < min(MAX_MISS_SHARE_LEFT * stated, MAX_RAY_MISS_OF_AXES_RAD):
        problems.append(
            Problem(
                f"the rays of the marks of {len(several)} known points miss their points by "
                f"{np.rad2deg(stated):.1f}°, and {AXES_IN_WORDS[cause]} by "
                f"{np.rad2deg(best):.2g}°; valid: "
                "image coordinates along the axes of the format, such as pixels from the upper "
                "left corner of the image, y down",
                where.rpartition(":")[0] or where,
            )
        )
    return tuple(problems)


def marks_of_known_points(network: Network) -> int:
    """Return the number of image points of control, check, held and weighted points."""
    point = network.images.columns()[1]
    return int(known_points(network)[point].sum()) if len(point) else 0


def cameras_along_other_axes(network: Network, poses: Array, points: Array) -> tuple[str, ...]:
    """Return the cameras whose image points fit given poses and points better along other axes.

    Args:
        network: the network.
        poses: stored poses, (photos, 12).
        points: coordinates, (points, 3).
    """
    photo, point, xy, _ = network.images.columns()
    of = np.array([f.camera for f in network.photos.values()], dtype=object)
    out = []
    for name, camera in network.cameras.items():
        rows = np.flatnonzero(of[photo] == name)
        if not len(rows):
            continue
        rows = rows[
            np.linspace(0, len(rows) - 1, min(len(rows), MAX_COMPARED_IMAGE_POINTS)).astype(np.intp)
        ]
        pose = poses[photo[rows]]
        away, turn = points[point[rows]] - pose[:, 9:], pose[:, :9].reshape(-1, 3, 3)
        k = np.array(camera.values)[None]
        stated = float(np.median(ray_misfits(camera.lens, k, xy[rows], turn, away)))
        best = min(
            float(
                np.median(
                    ray_misfits(
                        camera.lens, k, axes(xy[rows], middle_of_format(camera)), turn, away
                    )
                )
            )
            for _, axes in OTHER
        )
        if stated > MAX_RAY_MISS_OF_AXES_RAD and best < MAX_MISS_SHARE_LEFT_OF_ROUGH_POSES * stated:
            out.append(name)
    return tuple(out)


def middle_of_format(camera: Camera) -> Array:
    """Return the middle of the format of a camera, (2,); the principal point if it is unknown."""
    corners = camera.corners()
    if corners is None:
        return np.array(camera.values[1:3])
    return np.asarray(0.5 * (corners[0] + corners[1]))


def ray_misfits(lens: Lens, calibration: Array, xy: Array, rotation: Array, away: Array) -> Array:
    """Return how far the directions of rays (n,) are from those to their points; 2 at most.

    They are 0 where there are no rays, of lens models of places.

    Args:
        lens: the lens model.
        calibration: parameters of the lens, (n, k) or (1, k).
        xy: measured coordinates, (n, 2).
        rotation: world_R_camera, camera axes x right, y down, z ahead, (n, 3, 3).
        away: vectors from the projection centres to the points, (n, 3), metres.
    """
    if lens.takes == "places":
        return np.zeros(len(xy))
    with np.errstate(all="ignore"):  # distortion far outside the image
        ray = directions(lens, xy, calibration)
        q = np.einsum("nji,nj->ni", rotation, away)
        off = q / np.linalg.norm(q, axis=1, keepdims=True) - ray
        length = np.linalg.norm(off, axis=1)
    return np.asarray(np.nan_to_num(length, nan=2.0, posinf=2.0))


def _median_miss(pose: Array, ray: Array, group: Index, n: int) -> float:
    """Return the median angle between rays and the directions to where they meet, radians."""
    d = np.einsum("nij,nj->ni", pose[:, :9].reshape(-1, 3, 3), ray)
    with np.errstate(all="ignore"):
        d /= np.linalg.norm(d, axis=1, keepdims=True)
    d = np.nan_to_num(d)
    at, strength = nearest_to_rays(pose[:, 9:], d, group, n)
    to = at[group] - pose[:, 9:]
    angle = np.arctan2(np.linalg.norm(np.cross(to, d), axis=1), np.sum(to * d, axis=1))
    angle[~(strength[group] > MIN_RAY_STRENGTH) | ~np.isfinite(angle)] = np.pi
    return float(np.median(angle))


def known_points(network: Network) -> Mask:
    """Return the control and check points, and those with held or weighted coordinates."""
    positions = of_quantities(network.observations.values(), *CONTROL_QUANTITIES)
    control = {o.point for o in positions}
    return np.array(
        [
            name in control or any(p.fixed) or p.sigma is not None or p.check is not None
            for name, p in network.points.items()
        ],
        dtype=bool,
    )


def _all_in_one_place(network: Network, names: list[str]) -> str | None:
    """Return a message if known points, three or more, all have the same coordinates."""
    control = {
        o.point: o.value
        for o in of_quantities(network.observations.values(), *CONTROL_QUANTITIES)
        if len(o.value) == 3
    }
    at = []
    for name in names:
        p = network.points[name]
        at.append(control.get(name, p.check if p.check is not None else p.coordinates))
    places = np.array(at, dtype=float)
    if (
        len(places) < MIN_MARKED_POINTS
        or not np.isfinite(places).all()
        or (places != places[0]).any()
    ):
        return None
    where = ", ".join(f"{v:.12g}" for v in places[0])
    return (
        f"all {len(names)} known points that photos see have the same coordinates ({where}): "
        f"{known(names)}; valid: coordinates of each point of its own"
    )


def _given_poses(network: Network) -> Array:
    """Return the given stored poses, (photos, 12), NaN where unknown."""
    out = np.full((len(network.photos), 12), np.nan)
    for i, photo in enumerate(network.photos.values()):
        if photo.rotation is not None and photo.position is not None:
            out[i] = [*np.ravel(photo.rotation), *photo.position]
    return out
