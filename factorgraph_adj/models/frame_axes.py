"""Axes and zero places of frames: parallel axes, angle of two axes, distance from a plane.

The axis of a frame is d = Eᵀ R e₃, the normal of a plane, the axis of a cylinder; its zero place
q = 0 is Z = O + Eᵀ e^ℓ R c, the centre of a sphere, the apex of a cone, a point of an axis.
(FRAMES F10.2.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..rotation import skew
from ..types import Array
from .base import Linearised, require
from .line_of_sight import turned_by_angles
from .sub_frame import horizons, in_frame, split_frame

OTHER_SENSE = 0.01
"""Difference from an observed angle, radians, from which on an axis may point the other way."""
PARALLEL = "the axes are parallel: the angle between them has no derivative; use parallel_axes"


class Axis(NamedTuple):
    """Axes and zero places of n frames, and their partials by (ω, c, ℓ), O and (ξ, η) at O."""

    d: Array
    """Unit vectors of the axes, (n, 3)."""
    d_by: tuple[Array, Array, Array]
    """∂d/∂(ω, c, ℓ) (n, 3, 7), ∂d/∂O (n, 3, 3), ∂d/∂(ξ, η) (n, 3, 2)."""
    zero: Array
    """Zero places Z, metres, (n, 3)."""
    zero_by: tuple[Array, Array, Array]
    """The same partials of Z."""


def axis_of(
    frame: Frame, stored: Array, origin: Array | None, vertical: Array | None, *, axis: int = 2
) -> Axis:
    """Return the axes and zero places of frames (n, 17).

    Args:
        frame: frame of the network.
        stored: the frames.
        origin: O where it is a point, (n, 3); None: the constants of the frames.
        vertical: deflections at O, (n, 2); None: zero.
        axis: number of the axis.
    """
    rotation, offset, ln_scale, constant, level = split_frame(stored)
    at = constant if origin is None else origin
    n = len(stored)
    levelled = np.flatnonzero(level != 0)
    back = np.tile(np.eye(3), (n, 1, 1))
    basis = None
    if len(levelled):
        angles = np.zeros((n, 2)) if vertical is None else vertical
        basis = frame.basis(at[levelled], angles[levelled])
        back[levelled] = horizons(basis, level[levelled]).transpose(0, 2, 1)
    turned = back @ rotation
    scale = np.exp(ln_scale)[:, None, None]
    d = turned[:, :, axis]
    arm = np.einsum("nij,nj->ni", scale * turned, offset)
    none = np.zeros((n, 3, 1))
    d_by = np.concatenate([-turned @ skew(np.eye(3)[axis]), np.zeros((n, 3, 3)), none], axis=2)
    zero_by = np.concatenate(
        [-scale * turned @ skew(offset), scale * turned, arm[:, :, None]], axis=2
    )

    def by_horizon(v: Array) -> tuple[Array, Array]:
        """Return the partials of Eᵀ r by O and by (ξ, η) where v = Eᵀ r."""
        by_origin, by_vertical = np.zeros((n, 3, 3)), np.zeros((n, 3, 2))
        if basis is not None:  # a frame that is not level has no horizon
            own = back[levelled]
            by = -own @ turned_by_angles(np.einsum("nji,nj->ni", own, v[levelled]), basis)
            by_origin[levelled] = by @ basis.angles_by_position
            by_vertical[levelled] = by @ basis.angles_by_vertical
        return by_origin, by_vertical

    (d_o, d_v), (z_o, z_v) = by_horizon(d), by_horizon(arm)
    return Axis(d, (d_by, d_o, d_v), at + arm, (zero_by, np.eye(3) + z_o, z_v))


def _joined(
    a: tuple[Array, Array, Array], b: tuple[Array, Array, Array], given: tuple[Array | None, ...]
) -> tuple[Array, ...]:
    """Return the partials by both frames, then by the point and the vertical of each origin."""
    parts = (a[0], b[0], a[1], a[2], b[1], b[2])
    present = (True, True, *(g is not None for g in given))
    return tuple(p for p, there in zip(parts, present, strict=True) if there)


def _chain(gradient: Array, by: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    return gradient @ by[0], gradient @ by[1], gradient @ by[2]


def parallel_axes(
    frame: Frame,
    stored: Array,
    stored2: Array,
    origin: Array | None,
    vertical: Array | None,
    origin2: Array | None,
    vertical2: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute the first two rows of R₁ᵀ E₁ d₂ − observed, radians, (n, 2).

    They are the inclinations of the second axis to the first one, zero for parallel axes of the
    same or the opposite sense.

    Args:
        frame: frame of the network.
        stored: first frames, (n, 17).
        stored2: second frames, (n, 17).
        origin: O of the first frames where it is a point, (n, 3).
        vertical: deflections there, (n, 2).
        origin2: O of the second frames where it is a point, (n, 3).
        vertical2: deflections there, (n, 2).
        observed: (n, 2).
    """
    b = axis_of(frame, stored2, origin2, vertical2)
    first = [axis_of(frame, stored, origin, vertical, axis=k) for k in (0, 1)]
    v = np.stack([np.einsum("ni,ni->n", a.d, b.d) for a in first], axis=1)
    rows = [_chain(b.d[:, None], a.d_by) for a in first]
    by_a = tuple(np.concatenate(each, axis=1) for each in zip(*rows, strict=True))
    by_b = _chain(np.stack([a.d for a in first], axis=1), b.d_by)
    given = (origin, vertical, origin2, vertical2)
    return Linearised(v - observed, _joined((by_a[0], by_a[1], by_a[2]), by_b, given))


def axis_angle(
    frame: Frame,
    stored: Array,
    stored2: Array,
    origin: Array | None,
    vertical: Array | None,
    origin2: Array | None,
    vertical2: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute the angle between two axes − observed, radians, (n, 1).

    Axes have no sense: of α = atan2(|d₁ × d₂|, d₁ᵀd₂) and π − α that which is nearer to the
    observed angle counts, where α is further from it than `OTHER_SENSE`. Nearer than that, as with
    right angles, α counts: a residual that folded at π/2 would be too small.

    Args:
        frame: as `parallel_axes`.
        stored: as there, like all other variables.
        stored2: as there.
        origin: as there.
        vertical: as there.
        origin2: as there.
        vertical2: as there.
        observed: (n, 1).
    """
    a = axis_of(frame, stored, origin, vertical)
    b = axis_of(frame, stored2, origin2, vertical2)
    across = np.linalg.norm(np.cross(a.d, b.d), axis=1)
    require(across > 1e-12, PARALLEL)
    cosine = np.einsum("ni,ni->n", a.d, b.d)
    angle = np.arctan2(across, cosine)
    off = np.abs(angle - observed[:, 0])
    other = (off > OTHER_SENSE) & (np.abs(np.pi - angle - observed[:, 0]) < off)
    sense = np.where(other, -1.0, 1.0)
    v = np.where(other, np.pi - angle, angle)[:, None] - observed
    # ∂α/∂d₁ = −(d₂ − cos α d₁)/sin α, along which |d₁| stays.
    by_a = -(sense / across)[:, None] * (b.d - cosine[:, None] * a.d)
    by_b = -(sense / across)[:, None] * (a.d - cosine[:, None] * b.d)
    given = (origin, vertical, origin2, vertical2)
    parts = _joined(_chain(by_a[:, None], a.d_by), _chain(by_b[:, None], b.d_by), given)
    return Linearised(v, parts)


def plane_distance(
    frame: Frame,
    stored: Array,
    stored2: Array,
    origin: Array | None,
    vertical: Array | None,
    origin2: Array | None,
    vertical2: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute |q₃| − observed, metres, (n, 1), of the zero place of the second frame in the first.

    An observed distance of zero or less has the sign of q₃ itself.

    Args:
        frame: as `parallel_axes`.
        stored: as there, like all other variables.
        stored2: as there.
        origin: as there.
        vertical: as there.
        origin2: as there.
        vertical2: as there.
        observed: (n, 1).
    """
    b = axis_of(frame, stored2, origin2, vertical2)
    there = in_frame(frame, stored, b.zero, origin, vertical)
    q = there.q[:, 2:]
    sign = np.where((observed > 0) & (q < 0), -1.0, 1.0)
    by_a = tuple(
        sign[:, :, None] * j[:, 2:] for j in (there.by_frame, there.by_origin, there.by_vertical)
    )
    by_b = _chain(sign[:, :, None] * there.by_place[:, 2:], b.zero_by)
    given = (origin, vertical, origin2, vertical2)
    return Linearised(sign * q - observed, _joined((by_a[0], by_a[1], by_a[2]), by_b, given))
