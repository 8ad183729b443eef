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

from typing import NamedTuple

import numpy as np

from ..frames import Basis, Frame
from ..rotation import skew
from ..types import Array
from .base import Linearised
from .deformation import deformed
from .sight import turned_by_angles

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


class InFrame(NamedTuple):
    """n places in their frames, and the partials of q."""

    q: Array
    """Coordinates in the frame, its unit, (n, 3)."""
    by_frame: Array
    """∂q/∂(ω, c, ℓ), (n, 3, 7)."""
    by_place: Array
    """∂q/∂X, (n, 3, 3)."""
    by_origin: Array
    """∂q/∂O, (n, 3, 3)."""
    by_vertical: Array
    """∂q/∂(ξ, η) at O, unit of the frame per radian, (n, 3, 2)."""


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
    # A frame that is not level needs no horizon, and its origin may be the centre of the Earth.
    somewhere = np.where((level != 0)[:, None], at, place)
    basis = frame.basis(somewhere, np.zeros((len(at), 2)) if vertical is None else vertical)
    horizon = horizons(basis, level)
    # Differences of coordinates come first because they lose no digits, see `sight`.
    d = np.einsum("nij,nj->ni", horizon, place - at)
    scaled = np.exp(-ln_scale)[:, None, None] * rotation.transpose(0, 2, 1)
    turned = np.einsum("nij,nj->ni", scaled, d)
    n = len(d)
    eye = np.broadcast_to(np.eye(3), (n, 3, 3))
    by_place = scaled @ horizon
    by_angles = (level != 0)[:, None, None] * (scaled @ turned_by_angles(d, basis))
    return InFrame(
        turned - offset,
        np.concatenate([skew(turned), -eye, -turned[:, :, None]], axis=2),
        by_place,
        by_angles @ basis.angles_by_position - by_place,
        by_angles @ basis.angles_by_vertical,
    )


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
