"""Changes of points, poses, frames, verticals, drifts, levels, scales in the seven datum motions.

The seven motions are three shifts along x, y, z (1 m), three rotations about axes through a centre
and a scale about this centre (1 m at the mean distance of the points). Each function returns
G (n, k, 7), the change of the k components of n unknowns with the seven motions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..frames import Frame
from ..rotation import right_jacobian_inverse, skew
from ..types import Array, Index, Mask
from .arcs import GM, TERMS
from .positions import heights
from .rolling_shutter import MOTION
from .sub_frame import horizons, split_frame


@dataclass(frozen=True, eq=False)
class Motions:
    """Seven motions of an object about a centre, with the data of its points."""

    centre: Array
    """Centre of rotations and scale, (3,) metres."""
    size: float
    """Mean distance of the points from the centre, metres."""
    frame: Frame
    """Frame of the network."""
    points: Array
    """Coordinates of all points, (n_points, 3) metres."""
    deflections: Array
    """Deflection (ξ, η) of the vertical at each point, (n_points, 2) radians."""
    deflections_free: Mask
    """Whether the deflection at a point is unknown, (n_points,)."""

    def of_places(self, x: Array) -> Array:
        """Return how places x (n, 3) move, (n, 3, 7)."""
        out = np.zeros((len(x), 3, 7))
        out[:, :, :3] = np.eye(3)
        out[:, :, 3:6] = -skew(x - self.centre) / self.size
        out[:, :, 6] = (x - self.centre) / self.size
        return out

    @cached_property
    def turn(self) -> Array:
        """Rotation vector of the object, (3, 7)."""
        out = np.zeros((3, 7))
        out[:, 3:6] = np.eye(3) / self.size
        return out

    def at_stations(self, at: Index) -> _Stations:
        """Return how the horizons of the points ``at`` (n,) turn."""
        return self.at_places(self.points[at], self.deflections[at], self.deflections_free[at])

    def at_places(self, places: Array, deflections: Array, free: Mask) -> _Stations:
        """Return how the horizons at places turn.

        Args:
            places: the places, (n, 3) metres.
            deflections: (ξ, η) at the places, (n, 2) radians.
            free: whether the deflections are unknown, so that plumb lines turn with the object,
                (n,).
        """
        basis = self.frame.basis(places, deflections)
        turned = -skew(basis.enu[:, 2]) / self.size  # ω × u
        wanted = np.zeros((len(places), 2, 7))
        wanted[:, 0, 3:6] = np.einsum("ni,nij->nj", basis.enu[:, 1], turned)
        wanted[:, 1, 3:6] = (
            np.einsum("ni,nij->nj", basis.enu[:, 0], turned)
            / np.maximum(basis.cos_latitude, 1e-12)[:, None]
        )
        by_position = basis.angles_by_position @ self.of_places(places)
        moved = np.linalg.solve(basis.angles_by_vertical, wanted - by_position)
        angles = np.where(free[:, None, None], wanted, by_position)
        horizon = np.stack(
            [
                -angles[:, 0],
                basis.cos_latitude[:, None] * angles[:, 1],
                basis.sin_latitude[:, None] * angles[:, 1],
            ],
            axis=1,
        )
        turn = horizon[:, 2].copy()
        turn[:, 3:6] -= basis.enu[:, 2] / self.size
        turn *= np.linalg.det(basis.enu)[:, None]
        return _Stations(np.asarray(moved), turn, horizon)


@dataclass(frozen=True, eq=False)
class _Stations:
    """Motions of deflections and orientation unknowns at stations."""

    deflections: Array
    """Motions of (ξ, η), (n, 2, 7)."""
    orientation: Array
    """Motions of the orientation unknown, (n, 7)."""
    horizon: Array
    """Rotation vectors of the horizons, in their axes e, n, u, (n, 3, 7)."""


def of_points(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of points X (n, 3)."""
    return motions.of_places(values)


def of_poses(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of poses: the attitude turns with the object, the centre moves with it."""
    rotation = values[:, :9].reshape(-1, 3, 3)
    out = np.zeros((len(values), 6, 7))
    out[:, :3, 3:6] = rotation.transpose(0, 2, 1) / motions.size
    out[:, 3:] = motions.of_places(values[:, 9:])
    return out


def of_photo_motions(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of motions of photos: velocities turn with the object and scale with it.

    Turns are about the axes of the camera, which turn with the object.
    """
    out = np.zeros((len(values), values.shape[1], 7))
    for first in range(0, values.shape[1], MOTION):
        _turn_and_scale(motions, values, first, out)
    return out


def _turn_and_scale(motions: Motions, values: Array, first: int, out: Array) -> None:
    """Let the vector of three components from ``first`` on turn with the object and scale with it.

    Args:
        motions: the seven motions.
        values: stored values, (n, s).
        first: place of the vector.
        out: motions of all components, (n, s, 7), changed in place.
    """
    vector = values[:, first : first + 3]
    out[:, first : first + 3, 3:6] = -skew(vector) / motions.size
    out[:, first : first + 3, 6] = vector / motions.size


def of_arcs(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of arcs, see `arcs`: places, velocities and higher powers move as vectors.

    GM grows with the cube of the scale. That an orbit keeps its centre, and that this centre turns
    about z, residuals of photos notice.
    """
    out = np.zeros((len(values), values.shape[1], 7))
    out[:, :3] = motions.of_places(values[:, :3])
    for first in (3, *range(TERMS, values.shape[1], 3)):
        _turn_and_scale(motions, values, first, out)
    out[:, GM, 6] = 3.0 * values[:, GM] / motions.size
    return out


def of_frames(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of frames, see `sub_frame`: what is measured in them stays.

    δω = Rᵀ (E θ − ε), δℓ = μ; with a constant origin O, δc = e^{−ℓ} Rᵀ E δO, where δO is the motion
    of the object at O; with the origin at a point, δc = 0. E is the identity or the horizon at O;
    ε is how the horizon at a point turns as the point moves. That at a constant stays.

    Args:
        motions: the seven motions.
        values: stored frames, (n, 17).
        at: number of the point at the origin of each frame, −1: none, (n,).
    """
    rotation, _, ln_scale, origin, level = split_frame(values)
    at_point = at >= 0
    origin = np.where(at_point[:, None], motions.points[at], origin)
    deflections = np.where(at_point[:, None], motions.deflections[at], 0.0)
    horizon = horizons(motions.frame.basis(origin, deflections), level)
    to_frame = rotation.transpose(0, 2, 1) @ horizon
    out = np.zeros((len(values), 7, 7))
    # A rotation is seen the other way round from left-handed axes.
    out[:, :3] = np.linalg.det(horizon)[:, None, None] * (to_frame @ motions.turn)
    follows = np.flatnonzero(at_point & (level != 0))
    if len(follows):
        turned = motions.at_stations(at[follows]).horizon
        out[follows, :3] -= rotation[follows].transpose(0, 2, 1) @ turned
    moved = np.exp(-ln_scale)[:, None, None] * (to_frame @ motions.of_places(origin))
    out[:, 3:6] = np.where(at_point[:, None, None], 0.0, moved)
    out[:, 6, 6] = 1.0 / motions.size
    return out


def without_held(values: Array, moved: Array, held: Mask, still: Array) -> Array:
    """Return the motions of frames with the turns and scales that are not held.

    A shape is held where it is symmetric: a cylinder about its axis. Where the object turns by ω or
    grows by μ, and the frame may not, what is measured in it turns and grows about q = 0 instead,
    where its shape has its axis, and not about q = −c: δc = ω × c + μ c for held ω and μ. So do
    directions and zenith angles of an instrument, whose scale is held: they stay as all grows about
    it, and only its distances notice that.

    Args:
        values: stored frames, (n, 17).
        moved: motions of all components, (n, 7, 7).
        held: held components, (n, 7).
        still: the place about which turns leave what is measured, instead of q = 0, (n, 3): the
            mean of distances from a line that are not zero, which its offset takes up.
    """
    offset = values[:, 9:12]
    kept = np.where(held[:, :, None], moved, 0.0)
    out = np.where(held[:, :, None], 0.0, moved)
    about = -skew(offset + still) @ kept[:, :3] + offset[:, :, None] * kept[:, 6:]
    out[:, 3:6] += np.where(held[:, 3:6, None], 0.0, about)
    return np.asarray(out)


def of_scales(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of distance meters, whose 1 + m decreases as lengths increase."""
    out = np.zeros((len(values), 2, 7))
    out[:, 0, 6] = -(1.0 + values[:, 0]) / motions.size
    return out


def of_verticals(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of deflections of the vertical, for plumb lines fixed in the object.

    The plumb line turns with the object; the normal of the frame depends on the position only.
    """
    return motions.at_stations(at).deflections


def of_orientations(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of orientation unknowns, for horizontal circles fixed in the object.

    So move the constants of gyrotheodolites, whose readings stay as azimuths turn.
    """
    return motions.at_stations(at).orientation[:, None, :]


def of_mounts(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of mounts: turned with their carrier, their arm scales with the object."""
    out = np.zeros((len(values), 6, 7))
    out[:, 3:, 6] = values[:, 9:12] / motions.size
    return out


def of_ports(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of flat ports: their distances and thicknesses scale with the object."""
    out = np.zeros((len(values), 5, 7))
    out[:, 2:4, 6] = values[:, 2:4] / motions.size
    return out


def of_drifts(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of drifts: where positions are observed, a shift of the object is theirs.

    Turns and the scale of the object are no shift; a drift may resemble them, but is not the same.
    """
    out = np.zeros((len(values), 9, 7))
    out[:, :3, :3] = -np.eye(3)
    return out


def of_attitude_drifts(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of drifts of attitudes: where these are observed, a turn is a drift.

    Exp(ψ') = Exp(E θ) Exp(ψ): ψ' = ψ + J_l⁻¹(ψ) E θ, in the horizon E at the centre. In a curved
    frame the horizons of the photos differ from it, and observed attitudes notice the turn.
    """
    enu = motions.frame.basis(motions.centre[None], np.zeros((1, 2))).enu[0]
    left_inverse = right_jacobian_inverse(values[:, :3]).transpose(0, 2, 1)
    out = np.zeros((len(values), 6, 7))
    out[:, :3] = left_inverse @ (np.linalg.det(enu) * enu @ motions.turn)
    return out


def of_sizes(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of lengths, such as radii, which scale with the object."""
    out = np.zeros((len(values), 1, 7))
    out[:, 0, 6] = values[:, 0] / motions.size
    return out


def of_levels(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of heights of level surfaces, which stay level.

    They rise with the object at the centre, and scale about it. No level surface tilts.
    """
    centre = motions.centre[None]
    height, up = heights(motions.frame, centre)
    out = np.zeros((len(values), 1, 7))
    out[:, 0, :3] = up
    out[:, 0, 6] = (values[:, 0] - height) / motions.size
    return out


def of_polynomials(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of strip polynomials, whose constants follow a shift of the object.

    The other motions change coordinates of strips that a polynomial does not know of.
    """
    out = np.zeros((len(values), values.shape[1], 7))
    constants = min(3, values.shape[1])
    out[:, :constants, :3] = np.eye(3)[:constants]
    return out


def of_profiles(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of height profiles a + b t + c t² with a scale s of the readings.

    The reading (1 + s) (h − a − b t − c t²) stays: a rises with the object at the centre, all
    heights grow about it, and 1 + s shrinks likewise.
    """
    height, up = heights(motions.frame, motions.centre[None])
    out = np.zeros((len(values), 4, 7))
    out[:, 0, :3] = up
    out[:, 0, 6] = (values[:, 0] - height) / motions.size
    out[:, 1:3, 6] = values[:, 1:3] / motions.size
    out[:, 3, 6] = -(1.0 + values[:, 3]) / motions.size
    return out
