"""Direct linear transformation: one photo of unknown calibration from known points.

    x = (L₁X + L₂Y + L₃Z + L₄)/D    y = (L₅X + L₆Y + L₇Z + L₈)/D    D = L₉X + L₁₀Y + L₁₁Z + 1

(Abdel-Aziz & Karara 1971; FRAMES F17.1.) Image coordinates have y up. Six points that do not lie in
a plane give the eleven coefficients by linear equations in scaled coordinates; some steps of
Gauss-Newton then minimise the residuals of the image coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import InputError, Problem
from ..rotation import omega_phi_kappa
from ..shown import Shown
from ..types import Array

LEAST_POINTS = 6
"""Smallest number of known points."""
FLAT = 1e-6
"""Smallest ratio of the last but one singular value of the equations to the first."""
STEPS = 20
"""Largest number of Gauss-Newton steps."""


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
    if len(x) < LEAST_POINTS:
        raise InputError(Problem(f"{len(x)} points: a DLT needs {LEAST_POINTS} or more", "dlt"))
    if not (np.isfinite(x).all() and np.isfinite(observed).all()):
        raise InputError(Problem("points and image coordinates must be finite numbers", "dlt"))
    local, to_local = _scaled(x)
    plane, to_plane = _scaled(observed)
    p = _linear(local, plane)
    p = _refined(p, local, plane)
    whole = np.linalg.inv(to_plane) @ p @ to_local
    if not abs(whole[2, 3]) > 1e-12 * np.abs(whole[2, :3]).max() * (np.abs(x).max() + 1e-300):
        raise InputError(
            Problem("the origin lies in the focal plane of the photo: shift the coordinates", "dlt")
        )
    return _taken_apart(whole / whole[2, 3], x, observed)


def _image(coefficients: Array, x: Array) -> Array:
    p = np.append(coefficients, 1.0).reshape(3, 4)
    h = x @ p[:, :3].T + p[:, 3]
    return np.asarray(h[:, :2] / h[:, 2:])


def _scaled(x: Array) -> tuple[Array, Array]:
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
    if values[10] <= FLAT * values[0]:
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
    for _ in range(STEPS):
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


def _taken_apart(p: Array, x: Array, observed: Array) -> DirectTransformation:
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
