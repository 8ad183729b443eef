"""Rays of image coordinates, with their partials: the inverse of every lens model."""

from __future__ import annotations

import numpy as np

from ..types import Array
from .base import DegenerateError
from .lens import Lens, Ray
from .place_lens import PlaceLens
from .ray_lens import RayLens

LENS_ITERATIONS = 50
"""Largest number of steps of an inverse."""
TANGENT_TOLERANCE = 1e-8
"""Change of a tangent at which the fixed-point iteration ends."""
ANGLE_TOLERANCE = 1e-13
"""Step along the sphere at which Newton's method ends, radians."""
LONGEST_STEP = 0.3
"""Longest step along the sphere, radians."""


def tangents(lens: Lens, xy: Array, calibration: Array) -> Array:
    """Return the tangents (n, 2) of the rays of measured coordinates (n, 2).

    Solves v(t) = 0 by t ← t − v/c, with v turned back by `Lens.towards_ideal`. One step is exact
    for lens models that correct measured coordinates; the steps converge for lens models that
    distort ideal ones (distortion ≪ 1). Rays for which they do not, behind a strong pincushion
    distortion, are found by Newton's method.

    Args:
        lens: the lens model, of tangents.
        xy: measured coordinates, (n, 2), image units.
        calibration: parameters of the lens model, (n, k) or (1, k).
    """
    lens = lens.in_ideal_coordinates
    c = calibration[:, :1]

    def ideal(measured: Array) -> Array:
        return np.stack(lens.towards_ideal(measured[:, 0], measured[:, 1], calibration), axis=1) / c

    t = first = ideal(xy - calibration[:, 1:3])
    step = np.zeros_like(t)
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(LENS_ITERATIONS):
            v, _, _ = lens.residual(t[:, 0], t[:, 1], xy, calibration, jacobians=False)
            step = ideal(v)
            t = t - step
            if np.abs(step).max(initial=0.0) < TANGENT_TOLERANCE:
                return np.asarray(t)
    away = ~(np.abs(step).max(axis=1) < TANGENT_TOLERANCE)
    t[away] = _by_newton(
        lens, xy[away], calibration if len(c) == 1 else calibration[away], first[away]
    )
    return np.asarray(t)


def _by_newton(lens: Lens, xy: Array, k: Array, first: Array) -> Array:
    """Return tangents (n, 2) of measured coordinates by Newton's method with short steps."""
    t = first
    for _ in range(LENS_ITERATIONS):
        v, by_t, _ = lens.residual(t[:, 0], t[:, 1], xy, k)
        assert by_t is not None
        step = _solved(by_t, v[:, :, None])[:, :, 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        t = t - step * np.minimum(1.0, LONGEST_STEP / np.maximum(length, 1e-300))
        if length.max(initial=0.0) < TANGENT_TOLERANCE:
            break
    return t


def directions(lens: Lens, xy: Array, calibration: Array) -> Array:
    """Return unit vectors (n, 3) of the rays of measured coordinates, in the axes of the camera.

    The axes are x right, y down, z ahead. Models of tangents are inverted by `tangents`; models of
    rays by Newton's method on the unit sphere, v(d) = 0. Models of places have lines, which do not
    begin at the projection centre, see `sight_lines`; the vectors are theirs.

    Args:
        lens: the lens model.
        xy: measured coordinates, (n, 2), image units.
        calibration: parameters of the lens model, (n, k) or (1, k).
    """
    if isinstance(lens, PlaceLens):
        return lens.lines(xy, calibration)[1]
    if isinstance(lens, RayLens):
        return _on_sphere(lens, xy, calibration)
    return _unit(_ahead(tangents(lens, xy, calibration)))


def sight_lines(lens: Lens, xy: Array, calibration: Array) -> tuple[Array, Array]:
    """Return start and unit vector (n, 3) of the lines to the places of measured coordinates.

    They are in the axes of the camera, metres. The start of a ray is the projection centre, zero;
    models of places have starts of their own. Arguments as `directions`.
    """
    if isinstance(lens, PlaceLens):
        return lens.lines(xy, calibration)
    d = directions(lens, xy, calibration)
    return np.zeros_like(d), d


def rough_rays(lens: Lens, xy: Array, calibration: Array, middle: Array, c: float) -> Ray:
    """Return rays of image coordinates without distortion, and places of models of places.

    Args:
        lens: the lens model.
        xy: image coordinates, (n, 2).
        calibration: its parameters, (1, k).
        middle: principal point, (2,).
        c: principal distance.
    """
    if isinstance(lens, PlaceLens):
        x, y, z = lens.places(xy, calibration).T
        return x, y, z
    x, y = ((xy - middle) / c).T
    return x, -y, np.ones(len(x))


def _ahead(t: Array) -> Array:
    """Return rays (n, 3) of tangents (n, 2)."""
    return np.stack([t[:, 0], -t[:, 1], np.ones(len(t))], axis=1)


def _unit(d: Array) -> Array:
    return np.asarray(d / np.linalg.norm(d, axis=1, keepdims=True))


def _across(d: Array) -> Array:
    """Return two unit vectors across each unit vector, (n, 3, 2)."""
    helper = np.where(np.abs(d[:, 2:]) < 0.9, np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0]))
    first = _unit(np.cross(d, helper))
    return np.stack([first, np.cross(d, first)], axis=2)


def _seen(lens: RayLens, d: Array, xy: Array, k: Array) -> tuple[Array, Array, Array, Array]:
    """Return rays that have an image, their v (n, 2), ∂v/∂p (n, 2, 3) and ∂v/∂K (n, 2, k).

    Rays without an image are turned towards the axis until they have one.
    """
    while True:
        try:
            found = lens.seen((d[:, 0], d[:, 1], d[:, 2]), xy[:, 0], xy[:, 1], k)
            break
        except DegenerateError as error:
            inwards = d[error.rows] + [0.0, 0.0, 0.2]
            if not np.isfinite(inwards).all() or (d[error.rows, 2] > 1.0 - 1e-6).any():
                raise
            d = d.copy()
            d[error.rows] = _unit(inwards)
    n = len(d)
    by_p, by_k = np.empty((n, 2, 3)), np.empty((n, 2, len(found.by_k)))
    for out, pairs in ((by_p, found.by_p), (by_k, found.by_k)):
        for j, pair in enumerate(pairs):
            out[:, 0, j], out[:, 1, j] = pair
    return d, np.stack(found.v, axis=1), by_p, by_k


def _on_sphere(lens: RayLens, xy: Array, k: Array) -> Array:
    """Return unit vectors (n, 3) of measured coordinates by Newton's method on the sphere."""
    from_middle = (xy - k[:, 1:3]) / k[:, :1]
    d = lens.guess(from_middle[:, 0], from_middle[:, 1])
    for _ in range(LENS_ITERATIONS):
        d, v, by_p, _ = _seen(lens, d, xy, k)
        across = _across(d)
        step = _solved(by_p @ across, -v[:, :, None])[:, :, 0]
        length = np.linalg.norm(step, axis=1, keepdims=True)
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(length, 1e-300))
        d = _unit(d + np.einsum("nij,nj->ni", across, step))
        if length.max(initial=0.0) < ANGLE_TOLERANCE:
            break
    return d


def _solved(a: Array, b: Array) -> Array:
    """Solve 2 × 2 systems (n, 2, 2), (n, 2, m); a singular one has the solution of its damped."""
    det = a[:, 0, 0] * a[:, 1, 1] - a[:, 0, 1] * a[:, 1, 0]
    size = np.einsum("nij,nij->n", a, a)
    det = np.where(np.abs(det) > 1e-9 * size, det, 1e-9 * size + 1e-300)
    first = (a[:, 1, 1, None] * b[:, 0] - a[:, 0, 1, None] * b[:, 1]) / det[:, None]
    second = (a[:, 0, 0, None] * b[:, 1] - a[:, 1, 0, None] * b[:, 0]) / det[:, None]
    return np.stack([first, second], axis=1)


def rays_and_partials(lens: Lens, xy: Array, k: Array) -> tuple[Array, Array]:
    """Return rays r (n, 3) of measured coordinates, and ∂r/∂K (n, 3, k).

    r is (t_x, −t_y, 1) for models of tangents and a unit vector for models of rays. v(r, K) = 0 is
    solved by Newton's method; ∂r/∂K = −B (∂v/∂r B)⁻¹ ∂v/∂K with two directions B across r.

    Args:
        lens: the lens model.
        xy: measured coordinates, (n, 2), image units.
        k: calibration parameters, (n, k).
    """
    if isinstance(lens, RayLens):
        d, _, by_p, by_k = _seen(lens, _on_sphere(lens, xy, k), xy, k)
        across = _across(d)
        return d, np.asarray(-across @ _solved(by_p @ across, by_k))
    lens = lens.in_ideal_coordinates
    t = (xy - k[:, 1:3]) / k[:, :1]
    by_t, by_k = np.zeros((0, 2, 2)), np.zeros((0, 2, 0))
    for _ in range(LENS_ITERATIONS):
        v, by_tangents, by_lens = lens.residual(t[:, 0], t[:, 1], xy, k)
        assert by_tangents is not None
        assert by_lens is not None
        by_t, by_k = by_tangents, by_lens
        step = np.linalg.solve(by_t, v[:, :, None])[:, :, 0]
        t = t - step
        if np.abs(step).max(initial=0.0) < 1e-15 + 1e-14 * np.abs(t).max(initial=0.0):
            break
    t_by_k = -np.linalg.solve(by_t, by_k)
    by_k = np.concatenate([t_by_k[:, :1], -t_by_k[:, 1:], np.zeros_like(t_by_k[:, :1])], axis=1)
    return _ahead(t), by_k
