"""Relative poses of two photos: odometry, pairs, and the members of rigs.

With the photos A and B, their rotations R and projection centres X, the mount (B_m, b) of B on A,
and photogrammetric axes (x right, y up, z backwards) on both sides:

    M = R_Aᵀ R_B                         rotation of B in axes of A
    t = R_Aᵀ (X_B − X_A)                 base in axes of A, metres

    v = Log(R_obsᵀ B_mᵀ M)               rotation, radians about the axes of B
    v = (1 + m) (t − b) − t_obs          base; m of an odometer is zero unless its scale is unknown

Without a mount B_m is the identity and b is zero, so that the whole relative pose is observed. A
member of a rig has a mount, and the observed values are zero: R_B = R_A B_m, X_B = X_A + R_A b.
Poses are stored in axes of the graph (x right, y down, z forward), which D = diag(1, −1, −1)
turns. (FRAMES F8.8 and F12.)

| partial | of the rotation, J = Jr⁻¹(v) | of the base |
| --- | --- | --- |
| ω_A | −J Mᵀ D | (1 + m) D [D t]× |
| X_A | 0 | −(1 + m) R_Aᵀ |
| ω_B | J D | 0 |
| X_B | 0 | (1 + m) R_Aᵀ |
| β of the mount | −J (B_mᵀ M)ᵀ | 0 |
| b of the mount | 0 | −(1 + m) I |
| m | 0 | t − b |
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..rotation import TURN_ABOUT_X as TURN
from ..rotation import exp_rotation, log_rotation, right_jacobian_inverse, skew
from ..types import Array
from .base import Linearised
from .positions import split_pose


def relative_rotations(pose: Array, pose2: Array) -> Array:
    """Return M = R_Aᵀ R_B, photogrammetric axes, (n, 3, 3), of stored poses (n, 12) each."""
    return np.asarray(TURN @ np.swapaxes(split_pose(pose)[0], 1, 2) @ split_pose(pose2)[0] @ TURN)


def bases(pose: Array, pose2: Array) -> Array:
    """Return t = R_Aᵀ (X_B − X_A), photogrammetric axes of A, metres, (n, 3)."""
    rotation, centre = split_pose(pose)
    return np.asarray(np.einsum("nji,nj->ni", rotation, pose2[:, 9:] - centre) @ TURN)


def relative_rotation(
    frame: Frame, pose: Array, pose2: Array, mount: Array, *, observed: Array
) -> Linearised:
    """Compute Log(R_obsᵀ B_mᵀ M), radians about the axes of B, (n, 3).

    Args:
        frame: not used; every model has this argument.
        pose: stored poses of A, (n, 12).
        pose2: stored poses of B, (n, 12).
        mount: stored mounts, (n, 12).
        observed: rotation vectors Log R_obs, photogrammetric axes, (n, 3).
    """
    m = relative_rotations(pose, pose2)
    off = np.swapaxes(mount[:, :9].reshape(-1, 3, 3), 1, 2) @ m
    v = log_rotation(np.swapaxes(exp_rotation(observed), 1, 2) @ off)
    j = right_jacobian_inverse(v)
    by_a, by_b, by_mount = (np.zeros((len(v), 3, 6)) for _ in range(3))
    by_a[:, :, :3] = -j @ np.swapaxes(m, 1, 2) @ TURN
    by_b[:, :, :3] = j @ TURN
    by_mount[:, :, :3] = -j @ np.swapaxes(off, 1, 2)
    return Linearised(v, (by_a, by_b, by_mount))


def relative_position(
    frame: Frame, pose: Array, pose2: Array, mount: Array, odometer: Array, *, observed: Array
) -> Linearised:
    """Compute (1 + m) (t − b) − t_obs, metres in axes of A, (n, 3).

    Args:
        frame: not used.
        pose: stored poses of A, (n, 12).
        pose2: stored poses of B, (n, 12).
        mount: stored mounts, (n, 12).
        odometer: scale m and zero constant, (n, 2); a vector has no zero constant.
        observed: bases in photogrammetric axes of A, (n, 3).
    """
    rotation = split_pose(pose)[0]
    t = bases(pose, pose2)
    rest, scale = t - mount[:, 9:], 1.0 + odometer[:, :1]
    times = scale[:, :, None]
    by_x = times * (TURN @ np.swapaxes(rotation, 1, 2))
    by_a, by_b, by_mount = (np.zeros((len(t), 3, 6)) for _ in range(3))
    by_a[:, :, :3] = times * (TURN @ skew(t @ TURN))
    by_a[:, :, 3:], by_b[:, :, 3:] = -by_x, by_x
    by_mount[:, :, 3:] = -times * np.eye(3)
    by_odometer = np.stack([rest, np.zeros_like(rest)], axis=2)
    return Linearised(scale * rest - observed, (by_a, by_b, by_mount, by_odometer))


def turned(observed: Array, by: Array) -> Array:
    """Return rotation vectors (n, 3) turned about the axes that they lead to: Log(Exp(l) Exp(e)).

    An error e of a rotation l is a turn, not a term of a sum.
    """
    return log_rotation(exp_rotation(observed) @ exp_rotation(by))


def turned_with(v: Array, pose: Array, pose2: Array, mount: Array, *, observed: Array) -> Array:
    """Return the poses of B (n, 12), turned so that `relative_rotation` gives v (n, 3)."""
    m = mount[:, :9].reshape(-1, 3, 3) @ exp_rotation(observed) @ exp_rotation(v)
    rotation = split_pose(pose)[0] @ TURN @ m @ TURN
    return np.concatenate([rotation.reshape(-1, 9), pose2[:, 9:]], axis=1)


def moved_with(
    v: Array, pose: Array, pose2: Array, mount: Array, odometer: Array, *, observed: Array
) -> Array:
    """Return the poses of B (n, 12), moved so that `relative_position` gives v (n, 3)."""
    rotation, centre = split_pose(pose)
    t = (v + observed) / (1.0 + odometer[:, :1]) + mount[:, 9:]
    return np.concatenate([pose2[:, :9], centre + np.einsum("nij,nj->ni", rotation, t @ TURN)], 1)
