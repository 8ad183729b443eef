"""GNSS vectors, positions of points, and weighted variables."""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..rotation import log_rotation, right_jacobian_inverse, skew
from ..types import Array
from .base import Linearised
from .line_of_sight import up_by_angles


def _raised(
    frame: Frame, position: Array, vertical: Array, height: Array
) -> tuple[Array, Array, Array]:
    """Return h u (n, 3), and the partials of X + h u by X (n, 3, 3) and V (n, 3, 2)."""
    basis = frame.basis(position, vertical)
    h = height[:, None]
    turn = h[:, :, None] * up_by_angles(basis)
    return (
        h * basis.enu[:, 2],
        np.eye(3) + turn @ basis.angles_by_position,
        turn @ basis.angles_by_vertical,
    )


def gnss_vector(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute (X_j + h_t u_j) − (X_i + h_i u_i) − observed, metres, (n, 3)."""
    a, a_x, a_v = _raised(frame, station, station_vertical, instrument_height)
    b, b_x, b_v = _raised(frame, target, target_vertical, target_height)
    # Differences of coordinates come first because they lose no digits, see `sight`.
    return Linearised((target - station - observed) + (b - a), (-a_x, -a_v, b_x, b_v))


def coordinate(
    frame: Frame, point: Array, *, observed: Array, reference: Array, axis: Array
) -> Linearised:
    """Compute axis · (X − reference) − observed, metres, one row for each known coordinate.

    Args:
        frame: not used; every model has this argument.
        point: X, (n, 3).
        observed: (n, 1).
        reference: (n, 3).
        axis: unit vectors of the known coordinate, (n, 3).
    """
    v = np.sum(axis * (point - reference), axis=1, keepdims=True) - observed
    return Linearised(v, (axis[:, None, :],))


def split_pose(pose: Array) -> tuple[Array, Array]:
    """Return world_R_camera (n, 3, 3) and projection centres (n, 3) of stored poses (n, 12)."""
    return pose[:, :9].reshape(-1, 3, 3), pose[:, 9:]


def photo_coordinate(frame: Frame, pose: Array, *, observed: Array, axis: Array) -> Linearised:
    """Compute axis · X₀ − observed, metres, (n, 1), one row for each known coordinate.

    Args:
        frame: not used.
        pose: stored poses, (n, 12).
        observed: (n, 1).
        axis: unit vectors of the known coordinate, (n, 3).
    """
    v = np.sum(axis * split_pose(pose)[1], axis=1, keepdims=True) - observed
    return Linearised(v, (np.concatenate([np.zeros_like(axis), axis], axis=1)[:, None, :],))


def attitude(
    frame: Frame, value: Array, *, observed: Array, reference: Array, size: int = 6
) -> Linearised:
    """Compute Log(R_refᵀ R) − observed, radians about the turned axes, (n, 3).

    Args:
        frame: not used.
        value: stored values that begin with a rotation R, such as poses, (n, 9 + …).
        observed: (n, 3), zero for an attitude that is known as R_ref.
        reference: R_ref, for photos world_R_camera, (n, 3, 3).
        size: number of components of the tangent.
    """
    rotation, _ = split_pose(value)
    w = log_rotation(np.swapaxes(reference, 1, 2) @ rotation)
    jacobian = np.zeros((len(w), 3, size))
    jacobian[:, :, :3] = right_jacobian_inverse(w)
    return Linearised(w - observed, (jacobian,))


def tilt(frame: Frame, value: Array, *, observed: Array, upright: Array, size: int) -> Linearised:
    """Compute (t_y, −t_x) − observed, radians about the x and y axes of R, (n, 2); t = U Rᵀ u.

    u is the z axis of the object or of the horizon, and g = Rᵀ u is how it is seen from the axes of
    R. U turns the given g into (0, 0, 1): the tilts are those of a compensator, about the axes of
    R. They are zero where g is as given, and no turn about u changes them.

    Args:
        frame: not used.
        value: stored values that begin with a rotation R, (n, 9 + …).
        observed: (n, 2).
        upright: U, the shortest turn from the given g to (0, 0, 1), (n, 3, 3).
        size: number of components of the tangent.
    """
    rotation = value[:, :9].reshape(-1, 3, 3)
    g = rotation[:, 2]
    t = np.einsum("nij,nj->ni", upright, g)
    jacobian = np.zeros((len(g), 2, size))
    turned = upright @ skew(g)
    jacobian[:, 0, :3], jacobian[:, 1, :3] = turned[:, 1], -turned[:, 0]
    return Linearised(np.stack([t[:, 1], -t[:, 0]], axis=1) - observed, (jacobian,))


def component(
    frame: Frame, value: Array, *, observed: Array, which: Array, size: int, shift: int = 0
) -> Linearised:
    """Compute value[which + shift] − observed: a weighted component of a variable, (n, 1).

    Args:
        frame: not used.
        value: stored values, (n, s).
        observed: (n, 1).
        which: the component of the tangent, (n,).
        size: number of components of the tangent; stored values may be wider.
        shift: stored index minus tangent index of the component: 6 behind a rotation.
    """
    one = np.zeros((len(value), 1, size))
    rows = np.arange(len(value))
    index = which.astype(int)
    one[rows, 0, index] = 1.0
    return Linearised(value[rows, index + shift][:, None] - observed, (one,))
