"""Input of a block orientation: image points as rays; known places, attitudes and lengths.

Known are coordinates of points and photos, attitudes, and lengths between points or photos.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ..entities import Camera
from ..graph.equations import Equations
from ..graph.variables import DEFAULT, State
from ..models.inverse_lens import directions
from ..network.network import Network
from ..observations.base import of_quantities
from ..observations.registry import (
    CONTROL_QUANTITIES,
    DISTANCE_QUANTITIES,
    POSITION_QUANTITIES,
    Quantity,
)
from ..start.relative_positions import fill_given_attitudes
from ..types import Array, Index, Mask

MAX_RAY_TANGENT = 5.0
"""Largest tangent of a ray that a block is oriented from: 79° off the axis."""
IDENTITY_POSE: Array = np.append(np.eye(3), np.zeros(3))
"""Stored pose whose axes are those of the world, (12,)."""


@dataclass(frozen=True, eq=False)
class KnownPlaces:
    """Known coordinates and attitudes, NaN where unknown."""

    point: Array
    """Points, (points, 3), metres."""
    pose: Array
    """Stored poses, (photos, 12)."""

    def filled(self, state: State) -> KnownPlaces:
        """Return the same with values of a state where nothing is known."""
        return KnownPlaces(
            np.where(np.isnan(self.point), state["point"], self.point),
            np.where(np.isnan(self.pose), state["pose"], self.pose),
        )


@dataclass(frozen=True)
class KnownLength:
    """A known length between two points or two photos."""

    between: str
    """``"point"`` or ``"pose"``."""
    ends: tuple[int, int]
    """Numbers of both ends."""
    value: float
    """Length, metres."""


def without_approximations(equations: Equations) -> Equations:
    """Return the network with no values of photos and points but held and weighted ones."""
    unknowns = equations.unknowns
    values, rough = unknowns.start(), unknowns.rough()
    for kind in ("point", "pose"):
        values[kind] = np.where(rough[kind], np.nan, values[kind])
    return replace(equations, unknowns=unknowns.starting_at(values))


def given_places(equations: Equations) -> KnownPlaces:
    """Return what is given: coordinates of points and photos, control, positions and attitudes."""
    state, unknowns = equations.unknowns.start(), equations.unknowns
    point, pose = state["point"], state["pose"]
    observations = equations.network.observations.values()
    for o in of_quantities(observations, *POSITION_QUANTITIES):
        if o.record.quantity in CONTROL_QUANTITIES:
            row = unknowns["point"].number[o.point]
            horizontal = set(o.axes) <= set("enu")
            if horizontal and len(o.axes) < 3:
                continue  # no component of the frame alone
            for axis, value in zip("xyz" if horizontal else o.axes, o.value, strict=True):
                point[row, "xyz".index(axis)] = value
        else:
            row = unknowns["pose"].number[o.photo]
            for axis, value in zip(o.axes, o.value, strict=True):
                i = 9 + "xyz".index(axis)
                pose[row, i] = value if np.isnan(pose[row, i]) else pose[row, i]
    fill_given_attitudes(equations, pose)
    return KnownPlaces(point, pose)


def known_lengths(equations: Equations) -> Iterator[KnownLength]:
    """Iterate over known lengths: distances, GNSS vectors, and bases between photos, of rigs too.

    Horizontal distances are among them: the scale is where a fit begins.
    """
    unknowns = equations.unknowns
    mounts = unknowns["mount"]
    read: frozenset[Quantity] = DISTANCE_QUANTITIES | {
        "vector",
        "distance of photos",
        "relative position",
    }
    for o in of_quantities(equations.network.observations.values(), *read):
        quantity = o.record.quantity
        if quantity in DISTANCE_QUANTITIES and o.value > 0:
            number = unknowns["point"].number
            yield KnownLength("point", (number[o.station], number[o.target]), float(o.value))
        elif quantity == "vector":
            number, size = unknowns["point"].number, float(np.linalg.norm(o.value))
            if size > 0:
                yield KnownLength("point", (number[o.station], number[o.target]), size)
        elif quantity == "distance of photos" and o.value > 0:
            number = unknowns["pose"].number
            yield KnownLength("pose", (number[o.photo], number[o.photo2]), float(o.value))
        elif quantity == "relative position" and o.instrument is None:
            vector = np.array(o.value, dtype=float)
            if o.mount is not None:
                vector = vector + mounts.values[mounts.number[o.mount or DEFAULT], 9:12]
            size = float(np.linalg.norm(vector))
            if size > 0 and np.isfinite(size):
                number = unknowns["pose"].number
                yield KnownLength("pose", (number[o.photo], number[o.photo2]), size)


@dataclass(frozen=True, eq=False)
class Views:
    """Image points in the order of the image table of a network."""

    network: Network
    """The network."""
    photos: tuple[str, ...]
    """Names of the photos."""
    points: tuple[str, ...]
    """Names of the points."""
    cameras: tuple[Camera, ...]
    """Cameras."""
    photo: Index
    """Number of the photo of each image point, (n,)."""
    point: Index
    """Number of the point of each image point, (n,)."""
    camera: Index
    """Number of the camera of each image point, (n,)."""
    xy: Array
    """Measured coordinates, (n, 2), image units."""
    sigma: Array
    """Standard deviation of an image point, (n,), image units: the mean of those of x and y."""

    @classmethod
    def of(cls, network: Network) -> Views:
        """Return the image points of a network, without those of lens models of places."""
        photo, point, xy, sigma = network.images.columns()
        cameras = tuple(network.cameras.values())
        number = {c.name: i for i, c in enumerate(cameras)}
        camera_of = np.array([number[f.camera] for f in network.photos.values()], dtype=np.intp)
        camera = camera_of[photo] if len(photo) else np.zeros(0, dtype=np.intp)
        central = np.array([c.lens.takes != "places" for c in cameras], dtype=bool)
        if not central.all():
            photo, point, camera, xy, sigma = (
                x[central[camera]] for x in (photo, point, camera, xy, sigma)
            )
        return cls(
            network,
            tuple(network.photos),
            tuple(network.points),
            cameras,
            photo,
            point,
            camera,
            xy,
            sigma.mean(axis=1),
        )

    @property
    def n(self) -> int:
        """Number of image points."""
        return len(self.photo)

    def calibrations(self) -> tuple[Array, ...]:
        """Return the given calibration of each camera."""
        return tuple(np.array(c.values) for c in self.cameras)

    def rays(self, calibrations: tuple[Array, ...]) -> IdealRays:
        """Return the ideal rays of all image points with some calibrations.

        One standard deviation is σ/√|det ∂v/∂t| as a tangent: σ/c for a lens without distortion,
        and more towards the edge of a fisheye lens.
        """
        tangent = np.zeros((self.n, 2))
        unit = np.full(self.n, np.nan)
        for number, (camera, values) in enumerate(zip(self.cameras, calibrations, strict=True)):
            own = np.flatnonzero(self.camera == number)
            with np.errstate(all="ignore"):
                d = directions(camera.lens, self.xy[own], values[None])
                tangent[own] = np.where(d[:, 2:] > 0.0, d[:, :2] * [1.0, -1.0] / d[:, 2:], np.nan)
            own = own[np.abs(tangent[own]).max(axis=1, initial=0.0) < MAX_RAY_TANGENT]
            if len(own):
                x, y = tangent[own].T
                _, by_t, _ = camera.lens.residual(x, y, self.xy[own], values[None])
                assert by_t is not None
                unit[own] = self.sigma[own] / np.sqrt(np.abs(np.linalg.det(by_t)))
        # A ray that a lens model cannot undo, or one beside the camera, orients nothing.
        lost = ~(np.isfinite(tangent).all(axis=1) & np.isfinite(unit))
        tangent[lost], unit[lost] = 0.0, 1.0
        return IdealRays(tangent, unit, ~lost)

    def table(self, rows: Mask) -> sparse.csr_array:
        """Return the incidence of photos and points over some rows, (photos, points)."""
        at = np.flatnonzero(rows)
        ones = np.ones(len(at), dtype=np.int64)
        shape = (len(self.photos), len(self.points))
        return sparse.csr_array((ones, (self.photo[at], self.point[at])), shape=shape)

    def label(self, row: int) -> str:
        """Return the id of an image point, as in ``solution.observations``."""
        stated = self.network.images.ids.get(row)
        return stated or f"{self.photos[self.photo[row]]}/{self.points[self.point[row]]}"


@dataclass(frozen=True, eq=False)
class IdealRays:
    """Ideal rays of image points."""

    tangent: Array
    """t_x, t_y with y up, (n, 2)."""
    unit: Array
    """One standard deviation of an image point as a tangent, (n,)."""
    usable: Mask
    """Image points whose ray could be computed, (n,)."""


def ray_directions(tangent: Array, pose: Array = IDENTITY_POSE) -> Array:
    """Return unit vectors of rays, (n, 3), R [t_x, −t_y, 1] normalised.

    Args:
        tangent: t_x, t_y with y up, (n, 2).
        pose: stored poses of the photos, (n, 12) or (12,); without them, the unit vectors have the
            axes of the photos.
    """
    r, t = pose[..., :9], tangent
    d = r[..., 0::3] * t[:, :1] - r[..., 1::3] * t[:, 1:] + r[..., 2::3]
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def well_spread_image_points(views: Views, rows: Mask, most: int) -> Mask:
    """Choose about ``most`` image points of each photo: the points with most rays, well spread.

    Each photo is divided into 5 × 5 cells by the quantiles of its image coordinates; in each cell
    the points with most rays are chosen. Every ray of a chosen point is kept.

    Args:
        views: the image points.
        rows: the image points to choose from, (n,).
        most: number of image points of a photo above which points are left out.

    Returns:
        The chosen image points, (n,).
    """
    at = np.flatnonzero(rows)
    count = np.bincount(views.point[at], minlength=len(views.points))
    chosen = np.zeros(len(views.points), dtype=bool)
    order = at[np.argsort(views.photo[at], kind="stable")]
    photos, first = np.unique(views.photo[order], return_index=True)
    for own in np.split(order, first[1:]) if len(photos) else []:
        own = own[count[views.point[own]] >= 2]
        if len(own) <= most:
            chosen[views.point[own]] = True
            continue
        cell = np.zeros(len(own), dtype=np.intp)
        for axis in range(2):
            rank = np.argsort(np.argsort(views.xy[own, axis], kind="stable"), kind="stable")
            cell = 5 * cell + (5 * rank) // len(own)
        by_rays = np.lexsort((-count[views.point[own]], cell))
        ordered = cell[by_rays]
        place = np.arange(len(own)) - np.searchsorted(ordered, ordered)
        chosen[views.point[own[by_rays[place < max(most // 25, 1)]]]] = True
    return np.asarray(rows & chosen[views.point])
