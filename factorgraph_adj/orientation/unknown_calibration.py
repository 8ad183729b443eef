"""Unknown calibration: direct linear transformation (DLT), principal distances to try.

    x = (L₁X + L₂Y + L₃Z + L₄)/D    y = (L₅X + L₆Y + L₇Z + L₈)/D    D = L₉X + L₁₀Y + L₁₁Z + 1

(Abdel-Aziz & Karara 1971; FRAMES F17.1.) Image coordinates have y up. Six points that do not lie in
a plane give the eleven coefficients by linear equations in scaled coordinates; some steps of
Gauss-Newton then minimise the residuals of the image coordinates.

Where the calibration of a camera is only a guess, a block is tried with the principal distances of
such transformations, of pairs of photos, and with multiples of the format.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import InputError, Problem
from ..result_display import Shown
from ..rotation import omega_phi_kappa
from ..types import Array
from .block_input import Views
from .robust_poses import shared_principal_distance

MIN_DLT_POINTS = 6
"""Smallest number of known points."""
MIN_DLT_SINGULAR_RATIO = 1e-6
"""Smallest ratio of the last but one singular value of the equations to the first."""
MAX_DLT_STEPS = 20
"""Largest number of Gauss-Newton steps."""
TRIED_DISTANCE_FACTORS = (1.0, 0.7, 1.4, 0.5, 2.0, 0.35, 2.8, 4.0)
"""Principal distances that are tried, parts of the longer side of the image: angles of view from
110° to 14°."""
MIN_KNOWN_POINTS_OF_PHOTO = 8
"""Smallest number of known points of a photo that determine a principal distance."""
MAX_PAIRS_OF_DISTANCE = 40
"""Largest number of pairs whose principal distance is asked for."""
MIN_EPIPOLAR_LIMIT = 2e-3
"""Smallest limit of the distance from epipolar lines, part of the longer side: what distortion that
is not known leaves."""
MIN_DISTANCE_FACTOR, MAX_DISTANCE_FACTOR = 0.2, 8.0
"""Bounds of principal distances, parts of the longer side."""
MIN_REPORTED_DISTANCE_CHANGE = 0.05
"""Relative change of a principal distance that is worth telling."""


@dataclass(frozen=True, eq=False, repr=False)
class DirectTransformation(Shown):
    """Calibration and orientation of a photo from a direct linear transformation."""

    coefficients: Array
    """L₁ … L₁₁, (11,)."""
    principal_distance: tuple[float, float]
    """Principal distances c_x and c_y in both directions, image units."""
    principal_point: tuple[float, float]
    """x₀ and y₀, image units, y up."""
    shear: float
    """Tangent of the angle by which the image axes are not perpendicular."""
    position: Array
    """Projection centre, (3,), metres."""
    rotation: Array
    """world_R_camera, (3, 3); axes of the camera x right, y down, z forward."""
    residuals: Array
    """Computed − observed image coordinates, (n, 2), image units."""

    def headline(self) -> str:
        """Return calibration and place."""
        c, at = self.principal_distance, ", ".join(f"{v:.6g}" for v in self.position)
        return f"DirectTransformation: c {c[0]:.6g}, {c[1]:.6g}, at ({at})"

    @property
    def omega_phi_kappa(self) -> tuple[float, float, float]:
        """Angles ω, φ, κ, radians."""
        return omega_phi_kappa(self.rotation)

    @property
    def calibration(self) -> dict[str, float]:
        """Values for `Network.add_camera`: c, the mean of both, x0 and y0."""
        c = float(np.sqrt(self.principal_distance[0] * self.principal_distance[1]))
        return {"c": c, "x0": self.principal_point[0], "y0": self.principal_point[1]}

    def image(self, points: Array) -> Array:
        """Return the image coordinates (n, 2) of points (n, 3)."""
        return _image(self.coefficients, np.asarray(points, dtype=float))


@with_one_thread
def dlt(
    points: Sequence[Sequence[float]] | Array, xy: Sequence[Sequence[float]] | Array
) -> DirectTransformation:
    """Find calibration and orientation of a photo from known points.

    Args:
        points: known points, (n, 3), metres, n ≥ 6, not all in one plane.
        xy: their image coordinates, (n, 2), image units, y up.

    Raises:
        InputError: too few points, numbers that are not finite, points in one plane, or image
            coordinates with y down (the points lie behind the photo or the image is mirrored).
    """
    x, observed = np.asarray(points, dtype=float), np.asarray(xy, dtype=float)
    if x.ndim != 2 or x.shape[1:] != (3,) or observed.shape != (len(x), 2):
        raise InputError(
            Problem(
                f"points must be (n, 3) and xy (n, 2), not {x.shape} and {observed.shape}", "dlt"
            )
        )
    if len(x) < MIN_DLT_POINTS:
        raise InputError(Problem(f"{len(x)} points: a DLT needs {MIN_DLT_POINTS} or more", "dlt"))
    if not (np.isfinite(x).all() and np.isfinite(observed).all()):
        raise InputError(Problem("points and image coordinates must be finite numbers", "dlt"))
    local, to_local = _normalised(x)
    plane, to_plane = _normalised(observed)
    p = _linear(local, plane)
    p = _refined(p, local, plane)
    whole = np.linalg.inv(to_plane) @ p @ to_local
    if not abs(whole[2, 3]) > 1e-12 * np.abs(whole[2, :3]).max() * (np.abs(x).max() + 1e-300):
        raise InputError(
            Problem("the origin lies in the focal plane of the photo: shift the coordinates", "dlt")
        )
    return _decomposed(whole / whole[2, 3], x, observed)


def _image(coefficients: Array, x: Array) -> Array:
    p = np.append(coefficients, 1.0).reshape(3, 4)
    h = x @ p[:, :3].T + p[:, 3]
    return np.asarray(h[:, :2] / h[:, 2:])


def _normalised(x: Array) -> tuple[Array, Array]:
    """Return coordinates with mean 0 and size 1, and the matrix that made them."""
    middle = x.mean(axis=0)
    size = float(np.sqrt(((x - middle) ** 2).sum(axis=1).mean())) or 1.0
    to = np.eye(x.shape[1] + 1)
    to[:-1] /= size
    to[:-1, -1] = -middle / size
    return (x - middle) / size, to


def _linear(x: Array, xy: Array) -> Array:
    """Return the (3, 4) matrix that minimises the algebraic misfit."""
    h = np.column_stack([x, np.ones(len(x))])
    zero = np.zeros_like(h)
    a = np.concatenate(
        [
            np.concatenate([h, zero, -xy[:, :1] * h], axis=1),
            np.concatenate([zero, h, -xy[:, 1:] * h], axis=1),
        ]
    )
    _, values, vt = np.linalg.svd(a)
    if values[10] <= MIN_DLT_SINGULAR_RATIO * values[0]:
        raise InputError(
            Problem(
                "the points lie in one plane, or on a surface through the projection centre that "
                "leaves the transformation open: add points off it",
                "dlt",
            )
        )
    return np.asarray(vt[-1].reshape(3, 4))


def _refined(p: Array, x: Array, xy: Array) -> Array:
    """Return the matrix with the least residuals of image coordinates; its size stays 1."""
    h = np.column_stack([x, np.ones(len(x))])
    for _ in range(MAX_DLT_STEPS):
        q = h @ p.T
        v = (q[:, :2] / q[:, 2:] - xy).ravel()
        a = np.zeros((len(x), 2, 12))
        a[:, 0, :4] = a[:, 1, 4:8] = h / q[:, 2:]
        for i in range(2):
            a[:, i, 8:] = -(q[:, i] / q[:, 2] ** 2)[:, None] * h
        step = np.linalg.lstsq(a.reshape(-1, 12), -v, rcond=1e-13)[0]
        p = p + step.reshape(3, 4)
        p = p / np.linalg.norm(p)
        if np.linalg.norm(step) < 1e-12:
            break
    return p


def _decomposed(p: Array, x: Array, observed: Array) -> DirectTransformation:
    """Return the parts of P = K R_w→c [I | −X₀] by an RQ decomposition."""
    m = p[:, :3]
    centre = np.asarray(-np.linalg.solve(m, p[:, 3]), dtype=float)
    # Points lie in front of the photo: the third row points to them.
    m = m * np.sign(np.median((x - centre) @ m[2]))
    q, r = np.linalg.qr(m[::-1].T)
    upper, turn = r.T[::-1, ::-1], q.T[::-1]
    sign = np.diag(np.sign(np.diag(upper)))
    upper, turn = upper @ sign, sign @ turn
    upper = upper / upper[2, 2]
    # Rows of `turn`: image x, image y (up), forward; with y up a right-handed image has
    # determinant −1.
    if np.linalg.det(turn) > 0:
        raise InputError(
            Problem("the image is mirrored: y of its coordinates must point up, x right", "dlt")
        )
    rotation = (np.diag([1.0, -1.0, 1.0]) @ turn).T
    coefficients = p.ravel()[:11]
    return DirectTransformation(
        coefficients,
        (float(upper[0, 0]), float(upper[1, 1])),
        (float(upper[0, 2]), float(upper[1, 2])),
        float(upper[0, 1] / upper[1, 1]),
        centre,
        rotation,
        _image(coefficients, x) - observed,
    )


@dataclass(frozen=True, eq=False)
class PrincipalDistances:
    """Calibrations with which a block may start."""

    views: Views
    """The image points."""
    stated: Mapping[str, Sequence[float]]
    """Principal distances by camera that are tried in the place of the given one."""
    known: Array
    """Known coordinates of points, (points, 3), NaN where unknown: they determine a principal
    distance by a direct linear transformation."""

    def first(self) -> tuple[Array, ...]:
        """Return the calibrations to begin with."""
        return self._with({n: float(values[0]) for n, values in self.stated.items()})

    @property
    def guessed(self) -> tuple[str, ...]:
        """Cameras whose principal distance may be another: stated, or free and not weighted."""
        return tuple(
            c.name
            for c in self.views.cameras
            if c.name in self.stated or not (c.fixed[0] or np.isfinite(c.sigma[0]))
        )

    def others(self) -> Iterator[tuple[Array, ...]]:
        """Iterate over further calibrations: those that were stated, or multiples of the format.

        Cameras change together: those with stated values take them in order, those whose principal
        distance is free and not weighted take a multiple of the longer side of their image.
        """
        most = max((len(v) for v in self.stated.values()), default=0)
        for i in range(1, most):
            yield self._with({n: float(v[min(i, len(v) - 1)]) for n, v in self.stated.items()})
        guessed = {n: self._longer_side(n) for n in self.guessed if n not in self.stated}
        if guessed and not most:
            for way in (self._by_control, self.by_pairs):
                if found := {n: c for n in guessed if (c := way(n)) is not None}:
                    yield self._with(found)
            for factor in TRIED_DISTANCE_FACTORS:
                yield self._with({n: factor * side for n, side in guessed.items()})

    def found(self, calibrations: tuple[Array, ...]) -> dict[str, float]:
        """Return the principal distances that differ from the given ones, by camera."""
        return {
            c.name: float(values[0])
            for c, values in zip(self.views.cameras, calibrations, strict=True)
            if abs(values[0] / c.values[0] - 1.0) > MIN_REPORTED_DISTANCE_CHANGE
        }

    def _with(self, distances: Mapping[str, float]) -> tuple[Array, ...]:
        out = []
        for camera in self.views.cameras:
            values = np.array(camera.values)
            values[0] = distances.get(camera.name, values[0])
            out.append(values)
        return tuple(out)

    def _by_control(self, name: str) -> float | None:
        """Return the median principal distance of photos with known points; none: too few."""
        v = self.views
        seen = self.known[v.point]
        there = np.isfinite(seen).all(axis=1) & (v.camera == self._number(name))
        found = []
        for photo in np.unique(v.photo[there]).tolist():
            rows = np.flatnonzero(there & (v.photo == photo))
            if len(rows) < MIN_KNOWN_POINTS_OF_PHOTO:
                continue
            with suppress(InputError):
                found.append(dlt(seen[rows], v.xy[rows]).calibration["c"])
        side = self._longer_side(name)
        found = [c for c in found if MIN_DISTANCE_FACTOR < c / side < MAX_DISTANCE_FACTOR]
        return float(np.median(found)) if found else None

    def by_pairs(self, name: str) -> float | None:
        """Return the median principal distance of pairs of photos of a camera; none: no pair."""
        v = self.views
        number = self._number(name)
        side, at = self._longer_side(name), np.array(v.cameras[number].values[1:3])
        table = v.table(v.camera == number)
        common = (table @ table.T).tocoo()
        upper = common.row < common.col
        order = np.argsort(-common.data[upper], kind="stable")[:MAX_PAIRS_OF_DISTANCE]
        limit = max(3.0 * float(np.median(v.sigma[v.camera == number])) / side, MIN_EPIPOLAR_LIMIT)
        found = []
        for a, b in zip(common.row[upper][order], common.col[upper][order], strict=True):
            rows = [np.flatnonzero(v.photo == photo) for photo in (a, b)]
            _, *own = np.intersect1d(v.point[rows[0]], v.point[rows[1]], return_indices=True)
            xy = [(v.xy[r[i]] - at) / side for r, i in zip(rows, own, strict=True)]
            c = shared_principal_distance(xy[0], xy[1], limit=limit)
            if c is not None and MIN_DISTANCE_FACTOR < c < MAX_DISTANCE_FACTOR:
                found.append(c)
        return side * float(np.median(found)) if found else None

    def _number(self, name: str) -> int:
        return [c.name for c in self.views.cameras].index(name)

    def _longer_side(self, name: str) -> float:
        """Return the longer side of the format, or of what the image points cover."""
        number = self._number(name)
        camera = self.views.cameras[number]
        if camera.format is not None:
            return float(max(camera.format))
        own = self.views.xy[self.views.camera == number]
        covered = float(np.ptp(own, axis=0).max()) if len(own) else 0.0
        return covered if covered > 0.0 else float(camera.values[0])
