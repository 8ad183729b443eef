"""Sights from an instrument in a frame of its own: direction, zenith angle and distance of q.

With q the place of the target in the frame of the instrument, see `sub_frame`, h = hypot(q_x, q_y)
and S = |q| (FRAMES F11):

| quantity | value | partials by q |
| --- | --- | --- |
| direction | θ = atan2(q_x, q_y), clockwise from the y axis | (q_y, −q_x, 0)/h² |
| zenith angle | z = atan2(h, q_z) | (q_x q_z/h, q_y q_z/h, −h)/S² |
| distance | S | q/S |

A direction counts clockwise from the y axis, as surveyors' circles do: in a level frame whose rz is
zero it is the azimuth. An instrument that counts counter-clockwise from its x axis reads π/2 − θ.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, require, wrap
from .sub_frame import InFrame, in_frame
from .terrestrial_observations import SECOND, direction_in_face_one, zenith_in_face_one

NO_LENGTH = "the target stands at the origin of the instrument: the sight has no length"
NO_DIRECTION = "the target stands on the z axis of the frame: the sight has no direction"
_SHORTEST = 1e-9
"""Smallest length of a sight, unit of the frame; shorter sights are degenerate."""
_STEEPEST = 1e-9
"""Smallest ratio of the part across the z axis to the length at which a sight has a direction."""
_Chain: TypeAlias = tuple[Array, tuple[Array, ...]]
"""Residuals (n, 1), and partials (n, 1, k) by each variable."""


def length_in_frame(q: Array) -> Array:
    """Return S = |q| (n,) of targets q (n, 3)."""
    s = np.sqrt(np.einsum("ni,ni->n", q, q))
    require(s > _SHORTEST, NO_LENGTH)
    return np.asarray(s)


def across_axis(q: Array) -> Array:
    """Return h = hypot(q_x, q_y) (n,) of targets q (n, 3)."""
    h = np.hypot(q[:, 0], q[:, 1])
    require(h > _STEEPEST * length_in_frame(q), NO_DIRECTION)
    return np.asarray(h)


def _chained(v: Array, gradient: Array, there: InFrame, given: tuple[Array | None, ...]) -> _Chain:
    """Return residuals (n, 1) and their partials by the variables of `in_frame` that are there.

    Args:
        v: residuals, (n,).
        gradient: ∂v/∂q, (n, 3).
        there: q and its partials.
        given: frame, point, origin and vertical; None where one is not there.
    """
    every = there.chain(gradient)
    return v[:, None], tuple(j for j, x in zip(every, given, strict=True) if x is not None)


def frame_direction(
    frame: Frame,
    stored: Array,
    point: Array,
    origin: Array | None,
    vertical: Array | None,
    collimation_error: Array,
    *,
    observed: Array,
    face: Array,
) -> Linearised:
    """Compute the reading of the horizontal circle − observed, radians.

    The reading is θ − c/sin z in face 1 and θ + c/sin z + π in face 2, with 1/sin z = S/h.

    Args:
        frame: frame of the network.
        stored: frames of the instruments, (n, 17).
        point: targets, (n, 3).
        origin: points at the origins of the frames, (n, 3); None: constants.
        vertical: deflections at the origins, (n, 2).
        collimation_error: c, radians, (n, 1).
        observed: (n, 1).
        face: 1 or 2, (n,).
    """
    there = in_frame(frame, stored, point, origin, vertical)
    q = there.q
    h = across_axis(q)
    gradient = np.stack([q[:, 1] / h**2, -q[:, 0] / h**2, np.zeros_like(h)], axis=1)
    side = np.where(face == SECOND, 1.0, -1.0)
    c = collimation_error[:, 0]
    s = length_in_frame(q)
    steep = s / h
    if np.any(c):
        # ∂(S/h)/∂q = q/(S h) − S (q_x, q_y, 0)/h³
        bent = q / (s * h)[:, None]
        bent[:, :2] -= q[:, :2] * (steep / h**2)[:, None]
        gradient += (side * c)[:, None] * bent
    turned = direction_in_face_one(observed[:, 0], face)
    v = wrap(np.arctan2(q[:, 0], q[:, 1]) + side * c * steep - turned)
    residual, partials = _chained(v, gradient, there, (stored, point, origin, vertical))
    return Linearised(residual, (*partials, (side * steep)[:, None, None]))


def frame_zenith(
    frame: Frame,
    stored: Array,
    point: Array,
    origin: Array | None,
    vertical: Array | None,
    index_error: Array,
    *,
    observed: Array,
    face: Array,
) -> Linearised:
    """Compute the reading of the vertical circle − observed, radians.

    The reading is z + i in face 1 and 2π − z + i in face 2; z counts from the z axis of the frame.
    There is no refraction: the axis need not be the vertical, and sights are short.

    Args:
        frame: frame of the network.
        stored: frames of the instruments, (n, 17).
        point: targets, (n, 3).
        origin: points at the origins of the frames, (n, 3); None: constants.
        vertical: deflections at the origins, (n, 2).
        index_error: i, radians, (n, 1).
        observed: (n, 1).
        face: 1 or 2, (n,).
    """
    there = in_frame(frame, stored, point, origin, vertical)
    q = there.q
    h, s2 = across_axis(q), length_in_frame(q) ** 2
    side = np.where(face == SECOND, -1.0, 1.0)
    along = side * q[:, 2] / (h * s2)
    gradient = np.stack([along * q[:, 0], along * q[:, 1], -side * h / s2], axis=1)
    reading = zenith_in_face_one(observed[:, 0] - index_error[:, 0], face)
    v = side * wrap(np.arctan2(h, q[:, 2]) - reading)
    residual, partials = _chained(v, gradient, there, (stored, point, origin, vertical))
    return Linearised(residual, (*partials, np.ones((len(q), 1, 1))))


def frame_distance(
    frame: Frame,
    stored: Array,
    point: Array,
    origin: Array | None,
    vertical: Array | None,
    edm: Array,
    *,
    observed: Array,
) -> Linearised:
    """Compute (1 + m) S + zero − observed, unit of the frame.

    Args:
        frame: frame of the network.
        stored: frames of the instruments, (n, 17).
        point: targets, (n, 3).
        origin: points at the origins of the frames, (n, 3); None: constants.
        vertical: deflections at the origins, (n, 2).
        edm: m and zero of the distance meters, (n, 2).
        observed: (n, 1).
    """
    there = in_frame(frame, stored, point, origin, vertical)
    s = length_in_frame(there.q)
    scale = 1.0 + edm[:, 0]
    v = scale * s + edm[:, 1] - observed[:, 0]
    gradient = there.q * (scale / s)[:, None]
    residual, partials = _chained(v, gradient, there, (stored, point, origin, vertical))
    by_edm = np.stack([s, np.ones_like(s)], axis=1)[:, None, :]
    return Linearised(residual, (*partials, by_edm))


def place_of_sight(direction: Array, zenith: Array, distance: Array) -> Array:
    """Return q (n, 3) of directions, zenith angles and distances, each (n,)."""
    across = distance * np.sin(zenith)
    return np.stack(
        [across * np.sin(direction), across * np.cos(direction), distance * np.cos(zenith)], axis=-1
    )
