"""Directions of instruments that a camera carries: to the zenith, and to bodies at infinity.

    q = Bᵀ D Rᵀ s

s is a unit vector in the frame of the network, R the attitude world_R_camera, D the turn from the
camera's axes to photogrammetric ones (x right, y up, z backwards), and B the rotation of the mount,
instrument → camera. ∂q/∂ω = Bᵀ D [Rᵀ s]×, ∂q/∂β = [q]×. (FRAMES F8.5, F8.6.)
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..rotation import TURN_ABOUT_X, skew
from ..types import Array
from .base import Linearised, require, wrap
from .level_surface import MOUNT
from .position import split_pose
from .sight import up_by_angles

ALONG = "the {} axis of the instrument is vertical: it has no inclination about the other axis"
OPPOSITE = "the body stands opposite to where it was seen: the direction has no difference from it"
_STEEPEST = 1e-9
"""Smallest length of up, seen along the axis of turning, at which an inclination is defined."""
POSE = 6
"""Components of a pose."""


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
    out = np.zeros((*gradient.shape[:2], MOUNT))
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
