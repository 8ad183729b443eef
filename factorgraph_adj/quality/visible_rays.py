"""Rays by which the photos of an adjusted block would see further points, linearised.

A photo sees a point that lies in front of it and whose image lies within its format. Without a
format it sees as far as its camera's image points in the adjustment reach. Surfaces that hide a
point are not known here: the caller says which photos see it, or gives normals and a limit of the
angle at which a surface is looked at.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError, Problem, known
from ..models.base import DegenerateError
from ..models.image import image
from ..models.inverse_lens import directions
from ..models.lens import Lens
from ..solve.solution import Solution
from ..types import Array, Index, Mask

STEPS_TO_THE_IMAGE = 50
"""Largest number of steps from a point to its image coordinates."""
NEGLIGIBLE = 1e-9
"""Step of image coordinates at which they are found, in the principal distance."""
BORDER_PLACES = 33
"""Places on each side of the format whose rays bound the field of view."""
FIELD_MARGIN = 1.01
"""Margin of the field of view. It only keeps rays away that a polynomial of distortion would fold
back into the format; the format itself is compared with image coordinates."""


@dataclass(frozen=True)
class VisibleRays:
    """n rays from points to photos, whitened, in the order of the points."""

    point: Index
    """Number of the point of each ray, ascending, (n,)."""
    photo: Index
    """Number of the photo, in the order of the network, (n,)."""
    calibration: Index
    """Number of the calibration, (n,)."""
    by_pose: Array
    """Partials by the pose's tangent [ω, δX₀], (n, 2, 6)."""
    by_calibration: Array
    """Partials by the calibration, (n, 2, most parameters); zero beyond those of the lens."""
    by_point: Array
    """Partials by the point, (n, 2, 3)."""


@dataclass(frozen=True)
class ViewingLimit:
    """The steepest angle at which surfaces are looked at."""

    normals: Array
    """Outward unit normals of the surface at the points, (n, 3)."""
    angle: float
    """Largest angle between normal and ray, radians."""


@dataclass(frozen=True)
class _Sight:
    """What one lens model needs to be seen through."""

    lens: Lens
    photos: Index
    low: Array
    high: Array
    field_of_view: Array
    """Format (n, 2) each, and largest angle from the axis of the photos, (n,)."""


@dataclass(frozen=True, eq=False)
class Visibility:
    """The photos of a solution as places from which points are seen."""

    solution: Solution
    """The adjusted block."""
    sigma: float | None = None
    """Standard deviation of image coordinates, image units; None: the median of each camera."""
    factor: float = 1.0
    """Factor on the standard deviations."""
    _sights: list[_Sight] = field(default_factory=list, init=False, repr=False)

    def __post_init__(self) -> None:
        """Prepare formats, fields of view and standard deviations.

        Raises:
            InputError: no photos, or cameras of which neither format nor image points are known.
        """
        s = self.solution
        network = s.network
        if not network.photos:
            raise InputError("the network has no photos, from which further points could be seen")
        cameras = {name: _CameraFigures(name, s) for name in network.cameras}
        names = [p.camera for p in network.photos.values()]
        used = list(dict.fromkeys(names))
        problems = [p for name in used for p in cameras[name].problems(self.sigma is None)]
        if problems:
            raise InputError(problems)
        number = np.zeros(len(names), dtype=np.intp)
        sigmas = np.zeros((len(names), 2))
        table = s.equations.unknowns["calibration"]
        for i, (photo, name) in enumerate(zip(network.photos, names, strict=True)):
            own = f"{name}@{photo}"
            number[i] = table.number[own if network.cameras[name].per_photo else name]
            stated = cameras[name].sigma if self.sigma is None else np.full(2, self.sigma)
            sigmas[i] = stated * self.factor
        object.__setattr__(self, "calibration", number)
        object.__setattr__(self, "sigmas", sigmas)
        for lens in dict.fromkeys(network.cameras[name].lens for name in used):
            chosen = [i for i, name in enumerate(names) if network.cameras[name].lens == lens]
            photos = np.array(chosen, dtype=np.intp)
            corners = [cameras[names[i]].corners for i in chosen]
            low, high = (np.array([c[j] for c in corners if c is not None]) for j in (0, 1))
            calibrations = s.state["calibration"][number[photos], : len(lens.names)]
            self._sights.append(
                _Sight(lens, photos, low, high, _fields_of_view(lens, low, high, calibrations))
            )

    calibration: Index = field(init=False, repr=False)
    """Number of the calibration of each photo, (photos,)."""
    sigmas: Array = field(init=False, repr=False)
    """Standard deviations of image coordinates x, y of each photo, image units, (photos, 2)."""

    def rays(
        self, points: Array, visible: Mask | None = None, limit: ViewingLimit | None = None
    ) -> VisibleRays:
        """Return the rays to points that lie near one another.

        Args:
            points: coordinates, (m, 3), metres.
            visible: which photos see which points as far as the caller knows, (m, photos); None:
                nothing hides a point.
            limit: surface normals at the points, and the largest angle; None: no limit.
        """
        s, most = self.solution, self.solution.state["calibration"].shape[1]
        found = []
        for sight in self._sights:
            point, photo = self._pairs(sight, points, visible, limit)
            width = len(sight.lens.names)
            pose = s.state["pose"][self._pose[photo]]
            k = s.state["calibration"][self.calibration[photo], :width]
            kept, xy = self._imaged(sight.lens, points[point], pose, k)
            place = np.searchsorted(sight.photos, photo[kept])
            inside = np.all((xy >= sight.low[place]) & (xy <= sight.high[place]), axis=1)
            kept, xy = kept[inside], xy[inside]
            point, photo, pose, k = point[kept], photo[kept], pose[kept], k[kept]
            partials = image(
                s.network.frame, pose, k, points[point], observed=xy, lens=sight.lens
            ).jacobians
            weights = 1.0 / self.sigmas[photo][:, :, None]
            by_pose, by_k, by_point = (weights * a for a in partials)
            padded = np.zeros((len(point), 2, most))
            padded[:, :, :width] = by_k
            found.append((point, photo, by_pose, padded, by_point))
        point, photo, by_pose, by_k, by_point = (
            np.concatenate(parts) for parts in zip(*found, strict=True)
        )
        order = np.argsort(point, kind="stable")
        photo = photo[order]
        return VisibleRays(
            point[order],
            photo,
            self.calibration[photo],
            by_pose[order],
            by_k[order],
            by_point[order],
        )

    @property
    def _pose(self) -> Index:
        table = self.solution.equations.unknowns["pose"].number
        return np.array([table[n] for n in self.solution.network.photos], dtype=np.intp)

    def _pairs(
        self, sight: _Sight, points: Array, visible: Mask | None, limit: ViewingLimit | None
    ) -> tuple[Index, Index]:
        """Return points and photos within the fields of view, by their numbers."""
        stored = self.solution.state["pose"][self._pose[sight.photos]]
        middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
        radius = float(np.linalg.norm(points - middle, axis=1).max(initial=0.0))
        # Photos whose field of view does not reach the sphere around the points see none of them.
        away = middle - stored[:, 9:]
        distance = np.linalg.norm(away, axis=1)
        axis = stored[:, [2, 5, 8]]
        along = np.einsum("ni,ni->n", away, axis)
        outside = distance > radius
        with np.errstate(divide="ignore", invalid="ignore"):
            angle = np.arccos(np.clip(along / distance, -1.0, 1.0))
            wide = np.arcsin(np.clip(radius / distance, 0.0, 1.0))
        near = np.flatnonzero(~outside | (angle <= sight.field_of_view + wide))
        d = points[:, None] - stored[None, near, 9:]
        length = np.linalg.norm(d, axis=2)
        cosine = np.einsum("mni,ni->mn", d, axis[near])
        sees = cosine >= np.cos(sight.field_of_view[near]) * length
        sees &= length > 0.0
        if visible is not None:
            sees &= visible[:, sight.photos[near]]
        if limit is not None:
            facing = -np.einsum("mni,mi->mn", d, limit.normals)
            sees &= facing >= np.cos(limit.angle) * length
        point, column = np.nonzero(sees)
        return point, sight.photos[near[column]]

    def _imaged(self, lens: Lens, at: Array, pose: Array, k: Array) -> tuple[Index, Array]:
        """Return the numbers of the rays that have an image (m,), and its coordinates (m, 2)."""
        frame = self.solution.network.frame
        kept, xy = np.arange(len(at)), k[:, 1:3].copy()
        off: Mask = np.ones(len(at), dtype=bool)
        for _ in range(STEPS_TO_THE_IMAGE):
            try:
                v = image(
                    frame, pose[kept], k[kept], at[kept], observed=xy, lens=lens, jacobians=False
                ).residual
            except DegenerateError as error:
                has: Mask = np.ones(len(kept), dtype=bool)
                has[error.rows] = False
                kept, xy, off = kept[has], xy[has], off[has]
                continue
            xy = xy + v
            near = np.abs(v).max(axis=1, initial=0.0) <= NEGLIGIBLE * np.abs(k[kept, 0])
            off = np.logical_not(near)
            has = np.asarray(np.isfinite(xy).all(axis=1))
            kept, xy, off = kept[has], xy[has], off[has]
            if not off.any():
                break
        return kept[~off], xy[~off]


class _CameraFigures:
    """Format and σ of image coordinates of a camera, from its record or its image points."""

    def __init__(self, name: str, solution: Solution) -> None:
        network = solution.network
        self.name, self.camera = name, network.cameras[name]
        photos = list(network.photos.values())
        mine = np.array([p.camera == name for p in photos], dtype=bool)
        sigmas, places = [np.zeros((0, 2))], [np.zeros((0, 2))]
        for block in solution.equations.blocks:
            if not block.image:
                continue
            own = mine[block.variables[0][1]]
            sigma = np.broadcast_to(block.sigma, block.observed.shape)
            if solution.weights is not None:
                factors = solution.weights[block.rows].reshape(sigma.shape)
                with np.errstate(divide="ignore"):
                    sigma = sigma / np.sqrt(factors)
            sigmas.append(sigma[own])
            places.append(block.observed[own])
        self._sigmas, self._places = np.concatenate(sigmas), np.concatenate(places)

    @property
    def sigma(self) -> Array:
        """Medians of σx and σy, (2,)."""
        return np.asarray(np.median(self._sigmas, axis=0))

    @property
    def corners(self) -> tuple[Array, Array] | None:
        """Lower left and upper right corner of the format, or of the image points."""
        stated = self.camera.corners()
        if stated is not None or not len(self._places):
            return stated
        return self._places.min(axis=0), self._places.max(axis=0)

    def problems(self, needs_sigma: bool) -> list[Problem]:
        """Return what is not known of the camera."""
        where = f"camera {self.name!r}"
        out = []
        if self.corners is None:
            out.append(Problem("has no format and no image points; state its format", where))
        if needs_sigma and not len(self._sigmas):
            out.append(Problem("has no image points; state sigma of image coordinates", where))
        return out


def _fields_of_view(lens: Lens, low: Array, high: Array, calibrations: Array) -> Array:
    """Return the largest angle of rays of each format from the axis of the camera, (n,)."""
    if lens.takes == "places":  # no point is beside or behind the camera
        return np.full(len(low), np.pi)
    out = np.empty(len(low))
    widest = np.pi if lens.takes == "rays" else np.pi / 2.0 * (1.0 - 1e-9)
    seen: dict[bytes, float] = {}
    for i, (a, b, k) in enumerate(zip(low, high, calibrations, strict=True)):
        key = np.concatenate([a, b, k]).tobytes()
        if key not in seen:
            t = np.linspace(0.0, 1.0, BORDER_PLACES)[:, None]
            corners = np.array([a, [b[0], a[1]], b, [a[0], b[1]]])
            sides = zip(corners, np.roll(corners, -1, axis=0), strict=True)
            border = np.concatenate([p + t * (q - p) for p, q in sides])
            with np.errstate(all="ignore"):
                z = directions(lens, border, k[None])[:, 2]
            angle = float(np.max(np.arccos(np.clip(z, -1.0, 1.0))))
            seen[key] = min(FIELD_MARGIN * angle, widest) if np.isfinite(angle) else widest
        out[i] = seen[key]
    return out


def visibility_mask(visible: Mask | None, points: int, photos: list[str]) -> Mask | None:
    """Return which photos see which points, checked.

    Raises:
        InputError: the array has another shape.
    """
    if visible is None:
        return None
    found = np.asarray(visible)
    if found.dtype != bool or found.shape != (points, len(photos)):
        raise InputError(
            f"visible must be an array of bool, one row for each of the {points} points and one "
            f"column for each of the {len(photos)} photos ({known(photos)}), not {found.dtype} "
            f"{found.shape}"
        )
    return found
