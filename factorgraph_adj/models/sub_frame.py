"""Places in a frame of their own: models, scanner and tracker stations, shapes.

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
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..frames import Basis, Frame
from ..rotation import skew
from ..types import Array
from .base import Linearised
from .deformation import deformed
from .line_of_sight import turned_by_angles

COMPONENTS = 7
"""Components of a frame: three rotations, three of the offset, ln of the scale."""


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
        deformation: parameters of `factorgraph_adj.models.deformation`, (n, 17).
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
