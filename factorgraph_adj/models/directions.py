"""Verticals and directions in frames and instruments; tilts, and sights to bodies at infinity.

    g = Rᵀ E d

d is a vector of the object (n, 3), R and E those of the frame, see `sub_frame`. Neither the origin
nor the scale of the frame takes part, except that the horizon E of a level frame is that of its
origin.

| partial of g by | value |
| --- | --- |
| d | Rᵀ E |
| ω | [g]× |
| O and (ξ, η) at O, of a level frame | what the horizon at O turns |

    q = Bᵀ D Rᵀ s

s is a unit vector in the frame of the network, R the attitude world_R_camera, D the turn from the
camera's axes to photogrammetric ones (x right, y up, z backwards), and B the rotation of the mount,
instrument → camera. ∂q/∂ω = Bᵀ D [Rᵀ s]×, ∂q/∂β = [q]×. (FRAMES F8.5, F8.6.)
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..rotation import TURN_ABOUT_X, skew
from ..types import Array
from .base import Linearised, require, wrap
from .line_of_sight import turned_by_angles, up_by_angles
from .positions import MOUNT_COMPONENTS, split_pose
from .sub_frame import COMPONENTS, horizons, split_frame

_STEEPEST = 1e-9
"""Smallest length of up, seen along the axis of turning, at which an inclination is defined."""
POSE = 6
"""Components of a pose."""
ALONG = "the {} axis of the instrument is vertical: it has no inclination about the other axis"
OPPOSITE = "the body stands opposite to where it was seen: the direction has no difference from it"


class Directions(NamedTuple):
    """n vectors g in frames, and their partials."""

    g: Array
    """The vectors, (n, 3)."""
    by_frame: Array
    """∂g/∂(ω, c, ℓ), (n, 3, 7)."""
    by_vector: Array
    """∂g/∂d = Rᵀ E, (n, 3, 3)."""
    by_origin: Array
    """∂g/∂O, (n, 3, 3)."""
    by_vertical: Array
    """∂g/∂(ξ, η) at O, (n, 3, 2)."""


def direction_in_frame(
    frame: Frame,
    stored: Array,
    vector: Array,
    near: Array,
    origin: Array | None,
    vertical: Array | None,
) -> Directions:
    """Return vectors d (n, 3) of the object in the axes of frames (n, 17).

    Args:
        frame: frame of the network.
        stored: stored values of the frames.
        vector: d, any unit.
        near: a place of the network for each vector, metres, (n, 3); frames that are not level
            have no horizon of their own.
        origin: O where it is a point, (n, 3); None: the constants of the frames.
        vertical: deflections (ξ, η) of the vertical at O, (n, 2); None: zero.
    """
    rotation, _, _, constant, level = split_frame(stored)
    at = constant if origin is None else origin
    n = len(vector)
    is_level = (level != 0)[:, None]
    somewhere = np.where(is_level, at, near)
    basis = frame.basis(somewhere, np.zeros((n, 2)) if vertical is None else vertical)
    horizon = horizons(basis, level)
    turned = rotation.transpose(0, 2, 1)
    by_vector = turned @ horizon
    g = np.einsum("nij,nj->ni", by_vector, vector)
    by_frame = np.zeros((n, 3, COMPONENTS))
    by_frame[:, :, :3] = skew(g)
    in_horizon = np.einsum("nij,nj->ni", horizon, vector)
    by_angles = is_level[:, :, None] * (turned @ turned_by_angles(in_horizon, basis))
    return Directions(
        g,
        by_frame,
        by_vector,
        by_angles @ basis.angles_by_position,
        by_angles @ basis.angles_by_vertical,
    )


class Verticals(NamedTuple):
    """The vertical at n places in frames, and its partials."""

    g: Array
    """Unit vectors up, (n, 3)."""
    by_frame: Array
    """∂g/∂(ω, c, ℓ), (n, 3, 7)."""
    by_place: Array
    """∂g/∂X, (n, 3, 3)."""
    by_deflection: Array
    """∂g/∂(ξ, η) at X, (n, 3, 2)."""
    by_origin: Array
    """∂g/∂O, (n, 3, 3)."""
    by_vertical: Array
    """∂g/∂(ξ, η) at O, (n, 3, 2)."""


def vertical_in_frame(
    frame: Frame,
    stored: Array,
    place: Array,
    deflection: Array,
    origin: Array | None,
    vertical: Array | None,
) -> Verticals:
    """Return the vertical u(X) at places X (n, 3) in the axes of frames (n, 17).

    Args:
        frame: frame of the network.
        stored: stored values of the frames.
        place: X, metres.
        deflection: deflections (ξ, η) of the vertical at X, (n, 2).
        origin: O where it is a point, (n, 3); None: the constants of the frames.
        vertical: deflections at O, (n, 2); None: zero.
    """
    basis = frame.basis(place, deflection)
    d = direction_in_frame(frame, stored, basis.enu[:, 2], place, origin, vertical)
    turned = d.by_vector @ up_by_angles(basis)
    return Verticals(
        d.g,
        d.by_frame,
        turned @ basis.angles_by_position,
        turned @ basis.angles_by_vertical,
        d.by_origin,
        d.by_vertical,
    )


def split_mount(mount: Array) -> tuple[Array, Array]:
    """Return B (n, 3, 3), instrument → carrier, and the arm b (n, 3) of stored mounts (n, 12)."""
    return mount[:, :9].reshape(-1, 3, 3), mount[:, 9:12]


def in_instrument(mount: Array, g: Array) -> tuple[Array, Array, Array]:
    """Return g' = Bᵀ g (n, 3) of directions g in the carrier, ∂g'/∂mount and ∂g'/∂g = Bᵀ."""
    turned = split_mount(mount)[0].transpose(0, 2, 1)
    seen = np.einsum("nij,nj->ni", turned, g)
    by_mount = np.zeros((len(g), 3, MOUNT_COMPONENTS))
    by_mount[:, :, :3] = skew(seen)
    return seen, by_mount, turned


def of_those_there(
    partials: tuple[tuple[Array | None, Array], ...],
) -> tuple[Array, ...]:
    """Return the partials of the variables that are there, from pairs of variable and partial."""
    return tuple(partial for variable, partial in partials if variable is not None)


def _carried(pose: Array, mount: Array, s: Array) -> tuple[Array, Array, Array]:
    """Return q (n, 3), ∂q/∂s (n, 3, 3) and the rotation D Rᵀ s of it, see the module."""
    world_R_camera, _ = split_pose(pose)
    instrument_R_camera = mount[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1) @ TURN_ABOUT_X
    in_camera = np.einsum("nji,nj->ni", world_R_camera, s)
    q = np.einsum("nij,nj->ni", instrument_R_camera, in_camera)
    by_s = instrument_R_camera @ world_R_camera.transpose(0, 2, 1)
    return q, by_s, instrument_R_camera @ skew(in_camera)


def _by_mount(gradient: Array, q: Array) -> Array:
    """Return the partials (n, d, 6) by a mount, whose arm has no effect."""
    out = np.zeros((*gradient.shape[:2], MOUNT_COMPONENTS))
    out[:, :, :3] = gradient @ skew(q)
    return out


def photo_tilt(
    frame: Frame, pose: Array, mount: Array, *, observed: Array, axes: tuple[int, ...] = (0, 1)
) -> Linearised:
    """Compute inclinations − observed, radians, (n, d): atan2(q_x, q_z) and atan2(q_y, q_z).

    q is the zenith at the projection centre in the axes of the instrument, whose z axis points
    roughly up. The inclination of its x axis is positive if the axis points above the horizon.

    Args:
        frame: frame of the network.
        pose: stored poses, (n, 12).
        mount: stored mounts, (n, 12).
        observed: (n, d).
        axes: numbers of the inclined axes, 0 and 1.
    """
    _, centre = split_pose(pose)
    n = len(centre)
    basis = frame.basis(centre, np.zeros((n, 2)))
    q, by_up, by_turn = _carried(pose, mount, basis.enu[:, 2])
    rows, value = list(axes), np.empty((n, len(axes)))
    gradient = np.zeros((n, len(axes), 3))
    for row, axis in enumerate(rows):
        square = q[:, axis] ** 2 + q[:, 2] ** 2
        require(np.sqrt(square) > _STEEPEST, ALONG.format("xy"[1 - axis]))
        value[:, row] = np.arctan2(q[:, axis], q[:, 2])
        gradient[:, row, axis] = q[:, 2] / square
        gradient[:, row, 2] = -q[:, axis] / square
    by_centre = by_up @ up_by_angles(basis) @ basis.angles_by_position
    by_pose = gradient @ np.concatenate([by_turn, by_centre], axis=2)
    return Linearised(wrap(value - observed), (by_pose, _by_mount(gradient, q)))


def across(direction: Array) -> Array:
    """Return two unit vectors (n, 2, 3) perpendicular to unit vectors w (n, 3).

    They are the x and y axes, turned by the shortest rotation from the nearer of the two z
    directions to w.
    """
    side = np.where(direction[:, 2] < 0.0, -1.0, 1.0)
    x, y, z = direction[:, 0], direction[:, 1], side * direction[:, 2]
    a = 1.0 / (1.0 + z)
    first = np.stack([1.0 - a * x * x, -a * x * y, -side * x], axis=1)
    second = np.stack([-a * x * y, 1.0 - a * y * y, -side * y], axis=1)
    return np.stack([first, second], axis=1)


def photo_sight(
    frame: Frame,
    pose: Array,
    mount: Array,
    *,
    observed: Array,
    body: Array,
    seen: Array,
    axes: tuple[int, ...] = (0, 1),
) -> Linearised:
    """Compute the angles from the measured to the true direction − observed, radians, (n, d).

    With the measured direction w, T = `across` (w) and q the body in the axes of the instrument:
    v = T q θ / sin θ − observed, where θ is the angle between w and q.

    Args:
        frame: not used.
        pose: stored poses, (n, 12).
        mount: stored mounts, (n, 12).
        observed: corrections of the measured direction along T, usually zero, (n, d).
        body: unit vectors to the body in the frame of the network, (n, 3).
        seen: w, unit vectors in the axes of the instrument, (n, 3).
        axes: numbers of the rows of T that are observed, 0 and 1.
    """
    q, _, by_turn = _carried(pose, mount, body)
    along = np.sum(seen * q, axis=1)
    tangent = across(seen)[:, list(axes)]
    sine = np.linalg.norm(np.cross(seen, q), axis=1)
    require((sine > _STEEPEST) | (along > 0.0), OPPOSITE)
    angle = np.arctan2(sine, along)
    small = angle < 1e-4
    safe = np.where(small, 1.0, sine)
    stretch = np.where(small, 1.0 + angle**2 / 6.0, angle / safe)
    # ∂(θ/sin θ)/∂q = (θ cos θ − sin θ)/sin³ θ · w on the unit sphere, with limit −(1/3) w.
    change = np.where(small, -1.0 / 3.0 - 2.0 * angle**2 / 15.0, (angle * along - safe) / safe**3)
    u = np.einsum("nij,nj->ni", tangent, q)
    gradient = stretch[:, None, None] * tangent + (
        change[:, None, None] * u[:, :, None] * seen[:, None, :]
    )
    by_pose = np.zeros((len(q), len(axes), POSE))
    by_pose[:, :, :3] = gradient @ by_turn
    return Linearised(stretch[:, None] * u - observed, (by_pose, _by_mount(gradient, q)))
