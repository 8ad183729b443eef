"""Relations of points without a shape: equal distances and heights, right angles, directions.

(FRAMES F10.3, F10.4; Comp3D codes 9, 14, 15, 21, 22.)
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, require
from .heights import heights
from .line_of_sight import turned_by_angles
from .sub_frame import horizons

NO_LENGTH = "two of its points are the same place: the direction between them is open"


def _pair(
    a: tuple[Array, Array, Array],
    b: tuple[Array, Array, Array],
    ratio: Array,
    observed: Array,
    shared: bool,
) -> Linearised:
    """Return a − ratio · b − observed with partials by the points A, B, C, D; C may be A."""
    k = ratio[:, None]
    v = (a[0] - ratio * b[0])[:, None] - observed
    by = [a[1], a[2], -k * b[1], -k * b[2]]
    if shared:
        by = [by[0] + by[2], by[1], by[3]]
    return Linearised(v, tuple(j[:, None] for j in by))


def _length(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Return |AB| and its partials by A and B."""
    d = b - a
    length = np.linalg.norm(d, axis=1)
    require(length > 0, NO_LENGTH)
    e = d / length[:, None]
    return length, -e, e


def equal_distance(
    frame: Frame,
    station: Array,
    target: Array,
    station2: Array | None,
    target2: Array,
    *,
    observed: Array,
    ratio: Array,
) -> Linearised:
    """Compute |AB| − ratio · |CD| − observed, metres, (n, 1).

    Args:
        frame: not used.
        station: A, (n, 3).
        target: B, (n, 3).
        station2: C, (n, 3); None: A.
        target2: D, (n, 3).
        observed: (n, 1).
        ratio: (n,).
    """
    c = station if station2 is None else station2
    first, second = _length(station, target), _length(c, target2)
    return _pair(first, second, ratio, observed, station2 is None)


def equal_height_difference(
    frame: Frame,
    station: Array,
    target: Array,
    station2: Array | None,
    target2: Array,
    *,
    observed: Array,
    ratio: Array,
) -> Linearised:
    """Compute (h_B − h_A) − ratio · (h_D − h_C) − observed, metres, (n, 1); see `heights`.

    Args:
        frame: frame of the network.
        station: A, (n, 3).
        target: B, (n, 3).
        station2: C, (n, 3); None: A.
        target2: D, (n, 3).
        observed: (n, 1).
        ratio: (n,).
    """
    c = station if station2 is None else station2
    (ha, ga), (hb, gb), (hc, gc), (hd, gd) = (
        heights(frame, x) for x in (station, target, c, target2)
    )
    first, second = (hb - ha, -ga, gb), (hd - hc, -gc, gd)
    return _pair(first, second, ratio, observed, station2 is None)


def right_angle(
    frame: Frame, station: Array, target: Array, target2: Array, *, observed: Array
) -> Linearised:
    """Compute eᵀf − observed, radians, (n, 1): the cosine of the angle at B in space.

    e = (A − B)/|AB| and f = (C − B)/|CB|; near a right angle it is π/2 less the angle.

    Args:
        frame: not used.
        station: B, (n, 3).
        target: A, (n, 3).
        target2: C, (n, 3).
        observed: (n, 1).
    """
    (s, _, e), (t, _, f) = _length(station, target), _length(station, target2)
    cosine = np.einsum("ni,ni->n", e, f)[:, None]
    by_a, by_c = (f - cosine * e) / s[:, None], (e - cosine * f) / t[:, None]
    return Linearised(cosine - observed, tuple(j[:, None] for j in (-by_a - by_c, by_a, by_c)))


def across(u: Array) -> Array:
    """Return two unit vectors T (n, 2, 3) across each other and across unit vectors (n, 3)."""
    least = np.eye(3)[np.argmin(np.abs(u), axis=1)]
    first = np.cross(u, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(u, first)], axis=1)


def point_direction(
    frame: Frame,
    station: Array,
    target: Array,
    *,
    observed: Array,
    ux: Array,
    uy: Array,
    uz: Array,
) -> Linearised:
    """Compute T e − observed, radians, (n, 2): the direction between two points across a given one.

    e = (X_j − X_i)/|X_j − X_i|, and T are two unit vectors across the given direction u.

    Args:
        frame: not used.
        station: X_i, (n, 3).
        target: X_j, (n, 3).
        observed: (n, 2).
        ux: component of u along x, (n,).
        uy: along y, (n,).
        uz: along z, (n,).
    """
    u = np.stack([ux, uy, uz], axis=1)
    t = across(u / np.linalg.norm(u, axis=1, keepdims=True))
    length, _, e = _length(station, target)
    along = np.einsum("nij,nj->ni", t, e)
    by = (t - along[:, :, None] * e[:, None]) / length[:, None, None]
    return Linearised(along - observed, (-by, by))


def coordinate_difference(
    frame: Frame,
    station: Array,
    vertical: Array,
    target: Array,
    *,
    observed: Array,
    horizon: Array,
    axes: tuple[int, ...] = (0, 1, 2),
) -> Linearised:
    """Compute the observed axes of E (X_j − X_i) − observed, metres, (n, d).

    E is the horizon (east, north, up) at the station, or the identity: axes of the network.

    Args:
        frame: frame of the network.
        station: X_i, (n, 3).
        vertical: deflections (ξ, η) at the station, (n, 2).
        target: X_j, (n, 3).
        observed: (n, d).
        horizon: 1 for east, north, up at the station, 0 for the axes of the network, (n,).
        axes: numbers of the observed axes.
    """
    rows = list(axes)
    basis = frame.basis(station, vertical)
    e = horizons(basis, horizon)
    d = np.einsum("nij,nj->ni", e, target - station)
    by_angles = (horizon != 0)[:, None, None] * turned_by_angles(d, basis)
    by = (
        by_angles @ basis.angles_by_position - e,
        by_angles @ basis.angles_by_vertical,
        e,
    )
    return Linearised(d[:, rows] - observed, tuple(j[:, rows] for j in by))
