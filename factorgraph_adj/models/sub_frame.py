"""Places and vectors in a frame of their own, and sights (direction, zenith angle, distance).

    q = e^{−ℓ} Rᵀ E (X − O) − c          X = O + Eᵀ e^ℓ R (q + c)

X is a point or a projection centre, O the origin (m), ℓ = ln(metres per unit of the frame), c the
offset in the axes and the unit of the frame, R the rotation from the frame to the object, or, for a
frame that is ``level``, to the horizon (east, north, up) at its origin: E is then the basis of the
horizon, otherwise the identity. (Ayeni eq. 1 with S = e^{−ℓ}, M = Rᵀ E, X₀ = O + Eᵀ e^ℓ R c.)

| partial of q by | value |
| --- | --- |
| X | e^{−ℓ} Rᵀ E |
| O, if a point | −e^{−ℓ} Rᵀ E, and for a level frame what the horizon at O turns |
| ω | [q + c]× |
| c | −I |
| ℓ | −(q + c) |

Only this module defines q; every observation in a frame is a small function of q.

Of a target at q, with h = hypot(q_x, q_y) and S = |q|, an instrument reads (FRAMES F11)

| quantity | value | partials by q |
| --- | --- | --- |
| direction | θ = atan2(q_x, q_y), clockwise from the y axis | (q_y, −q_x, 0)/h² |
| zenith angle | z = atan2(h, q_z) | (q_x q_z/h, q_y q_z/h, −h)/S² |
| distance | S | q/S |

A direction counts clockwise from the y axis, as surveyors' circles do: in a level frame whose rz is
zero it is the azimuth. An instrument that counts counter-clockwise from its x axis reads π/2 − θ.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, TypeAlias

import numpy as np

from ..frames import Basis, Frame
from ..rotation import skew
from ..types import Array
from .base import Linearised, require, wrap
from .deformation import deformed
from .line_of_sight import turned_by_angles
from .terrestrial_observations import SECOND, direction_in_face_one, zenith_in_face_one

COMPONENTS = 7
"""Components of a frame: three rotations, three of the offset, ln of the scale."""
NO_LENGTH = "the target stands at the origin of the instrument: the sight has no length"
NO_DIRECTION = "the target stands on the z axis of the frame: the sight has no direction"
_SHORTEST = 1e-9
"""Smallest length of a sight, unit of the frame; shorter sights are degenerate."""
_STEEPEST = 1e-9
"""Smallest ratio of the part across the z axis to the length at which a sight has a direction."""


class Stored(NamedTuple):
    """The parts of stored frames."""

    rotation: Array
    """R, (n, 3, 3)."""
    offset: Array
    """c, unit of the frame, (n, 3)."""
    ln_scale: Array
    """ℓ, (n,)."""
    origin: Array
    """Constant O, metres, (n, 3); zero where it is a point."""
    level: Array
    """1 where R counts from the horizon at O, otherwise 0, (n,)."""


def split_frame(stored: Array) -> Stored:
    """Return the parts of stored frames (n, 17)."""
    rotation = stored[:, :9].reshape(-1, 3, 3)
    return Stored(rotation, stored[:, 9:12], stored[:, 12], stored[:, 13:16], stored[:, 16])


def horizons(basis: Basis, level: Array) -> Array:
    """Return E (n, 3, 3): the horizon where ``level`` (n,) is not zero, otherwise the identity."""
    return np.where((level != 0)[:, None, None], basis.enu, np.eye(3))


@dataclass(frozen=True, eq=False)
class InFrame:
    """n places in their frames, and the partials of q."""

    q: Array
    """Coordinates in the frame, its unit, (n, 3)."""
    turned: Array
    """q + c, (n, 3)."""
    by_place: Array
    """∂q/∂X, (n, 3, 3)."""
    by_angles: Array | None
    """∂q/∂(Φ, Λ) of the horizons at O, unit of the frame per radian, (n, 3, 2); None: no frame is
    level."""
    basis: Basis | None
    """The horizons; None: no frame is level."""

    @cached_property
    def by_frame(self) -> Array:
        """∂q/∂(ω, c, ℓ), (n, 3, 7)."""
        eye = np.broadcast_to(np.eye(3), (len(self.q), 3, 3))
        return np.concatenate([skew(self.turned), -eye, -self.turned[:, :, None]], axis=2)

    @cached_property
    def by_origin(self) -> Array:
        """∂q/∂O, (n, 3, 3)."""
        if self.by_angles is None or self.basis is None:
            return -self.by_place
        return np.asarray(self.by_angles @ self.basis.angles_by_position - self.by_place)

    @cached_property
    def by_vertical(self) -> Array:
        """∂q/∂(ξ, η) at O, unit of the frame per radian, (n, 3, 2)."""
        if self.by_angles is None or self.basis is None:
            return np.zeros((len(self.q), 3, 2))
        return np.asarray(self.by_angles @ self.basis.angles_by_vertical)

    def chain(self, gradient: Array) -> tuple[Array, Array, Array, Array]:
        """Return the partials of f(q) by frame, X, O and (ξ, η), (n, 1, k), with ∂f/∂q (n, 3).

        By the frame they are (∂f/∂q × (q + c), −∂f/∂q, −∂f/∂q · (q + c)).
        """
        g, t = gradient, self.turned
        by_frame = np.empty((len(g), 1, COMPONENTS))
        by_frame[:, 0, 0] = g[:, 1] * t[:, 2] - g[:, 2] * t[:, 1]
        by_frame[:, 0, 1] = g[:, 2] * t[:, 0] - g[:, 0] * t[:, 2]
        by_frame[:, 0, 2] = g[:, 0] * t[:, 1] - g[:, 1] * t[:, 0]
        by_frame[:, 0, 3:6] = -g
        by_frame[:, 0, 6] = -np.einsum("ni,ni->n", g, t)
        row = g[:, None, :]
        by_place = row @ self.by_place
        if self.by_angles is None or self.basis is None:
            return by_frame, by_place, -by_place, np.zeros((len(g), 1, 2))
        by_angles = row @ self.by_angles
        by_origin = by_angles @ self.basis.angles_by_position - by_place
        return by_frame, by_place, by_origin, by_angles @ self.basis.angles_by_vertical


def in_frame(
    frame: Frame, stored: Array, place: Array, origin: Array | None, vertical: Array | None
) -> InFrame:
    """Return places (n, 3) in their frames (n, 17).

    Args:
        frame: frame of the network.
        stored: stored values of the frames.
        place: X, metres.
        origin: O where it is a point, (n, 3); None: the constants of the frames.
        vertical: deflections (ξ, η) of the vertical at O, (n, 2); None: zero.
    """
    rotation, offset, ln_scale, constant, level = split_frame(stored)
    at = constant if origin is None else origin
    scaled = rotation.transpose(0, 2, 1)
    if np.any(ln_scale):
        scaled = np.exp(-ln_scale)[:, None, None] * scaled
    # Differences of coordinates come first because they lose no digits, see `sight`.
    away = place - at
    if not np.any(level):
        turned = (scaled @ away[:, :, None])[:, :, 0]
        return InFrame(turned - offset, turned, scaled, None, None)
    # A frame that is not level needs no horizon, and its origin may be the centre of the Earth.
    somewhere = np.where((level != 0)[:, None], at, place)
    basis = frame.basis(somewhere, np.zeros((len(at), 2)) if vertical is None else vertical)
    horizon = horizons(basis, level)
    d = np.einsum("nij,nj->ni", horizon, away)
    turned = np.einsum("nij,nj->ni", scaled, d)
    by_angles = (level != 0)[:, None, None] * (scaled @ turned_by_angles(d, basis))
    return InFrame(turned - offset, turned, scaled @ horizon, by_angles, basis)


def from_frame(stored: Array, q: Array, origin: Array, horizon: Array) -> Array:
    """Return the places X = O + Eᵀ e^ℓ R (q + c) of coordinates q (n, 3) in frames.

    Args:
        stored: stored values of the frames, (n, 17).
        q: coordinates, unit of the frame.
        origin: O, metres, (n, 3).
        horizon: E, (n, 3, 3).
    """
    rotation, offset, ln_scale, _, _ = split_frame(stored)
    to_object = np.exp(ln_scale)[:, None, None] * (horizon.transpose(0, 2, 1) @ rotation)
    return np.asarray(origin + np.einsum("nij,nj->ni", to_object, q + offset))


def frame_coordinate(
    frame: Frame,
    stored: Array,
    point: Array | None,
    pose: Array | None,
    origin: Array | None,
    vertical: Array | None,
    deformation: Array,
    *,
    observed: Array,
    base: Array,
    axes: tuple[int, ...] = (0, 1, 2),
) -> Linearised:
    """Compute q' − observed, unit of the frame, of the observed axes, (n, d); FRAMES F1, F2.3.

    Args:
        frame: frame of the network.
        stored: frames, (n, 17).
        point: X, (n, 3); None: the place is a projection centre.
        pose: stored poses, (n, 12); None: the place is a point.
        origin: O where it is a point, (n, 3).
        vertical: deflections at O, (n, 2).
        deformation: parameters of `factorgraph_adj.models.deformation`, (n, 20).
        observed: (n, d).
        base: length to which the deformation refers, unit of the frame, (n,).
        axes: numbers of the observed axes.
    """
    assert (point is None) != (pose is None)
    place = pose[:, 9:] if point is None else point  # type: ignore[index]
    there = in_frame(frame, stored, place, origin, vertical)
    bent = deformed(there.q, deformation, base)
    rows = list(axes)
    by_place = bent.by_q @ there.by_place
    every = (
        bent.by_q @ there.by_frame,
        by_place,
        np.concatenate([np.zeros_like(by_place), by_place], axis=2),
        bent.by_q @ there.by_origin,
        bent.by_q @ there.by_vertical,
        bent.by_parameters,
    )
    given = (stored, point, pose, origin, vertical, deformation)
    return Linearised(
        bent.q[:, rows] - observed,
        tuple(j[:, rows] for j, value in zip(every, given, strict=True) if value is not None),
    )


def frame_vector(
    frame: Frame, stored: Array, station: Array, target: Array, *, observed: Array
) -> Linearised:
    """Compute e^{−ℓ} Rᵀ E (X_j − X_i) − observed, unit of the frame, (n, 3).

    E is the identity, and the horizon at X_i in frames that are level. The partials are those of q
    with the origin X_i, without the offset.

    Args:
        frame: frame of the network.
        stored: frames, (n, 17).
        station: X_i, (n, 3) metres.
        target: X_j, (n, 3) metres.
        observed: (n, 3).
    """
    there = in_frame(frame, stored, target, station, None)
    by_frame = there.by_frame.copy()
    by_frame[:, :, 3:6] = 0.0
    return Linearised(there.turned - observed, (by_frame, there.by_origin, there.by_place))


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
