"""Motions of photos from their neighbours: shift and turn of a platform between two exposures.

A platform that moves evenly from exposure A to exposure B, in the time Δt, has the same velocity
and the same turn during the readout of a photo between them:

    v_s = v Δt − (X_B − X_A)             metres, axes of the network
    v_t = ω Δt − Log(R_Aᵀ R_B)           radians, axes of the camera (x right, y down, z forward)

so that standard deviations are those of the displacement and the turn by which the platform may
differ from an even motion. The motion v, ω of the photo is that of `rolling_shutter`.

| partial | of the shift | of the turn, J = Jr⁻¹(Log(R_Aᵀ R_B)) |
| --- | --- | --- |
| ω_A | 0 | J R_Bᵀ R_A |
| X_A | I | 0 |
| ω_B | 0 | −J |
| X_B | −I | 0 |
| v | Δt I | 0 |
| ω | 0 | Δt I |
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..rotation import log_rotation, right_jacobian_inverse
from ..types import Array
from .base import Linearised
from .positions import split_pose
from .rolling_shutter import MOTION, VELOCITY


def photo_shift(
    frame: Frame, before: Array, after: Array, motion: Array, *, observed: Array, interval: Array
) -> Linearised:
    """Compute v Δt − (X_B − X_A) − observed, metres, (n, 3).

    Args:
        frame: not used; every model has this argument.
        before: stored poses of A, (n, 12).
        after: stored poses of B, (n, 12).
        motion: motions of the photos, (n, 6) or, with higher powers, more.
        observed: differences from an even motion, (n, 3).
        interval: Δt, (n,) seconds.
    """
    moved = after[:, 9:] - before[:, 9:]
    by_a, by_b = (np.zeros((len(moved), 3, MOTION)) for _ in range(2))
    by_motion = np.zeros((len(moved), 3, motion.shape[1]))
    by_a[:, :, 3:], by_b[:, :, 3:] = np.eye(3), -np.eye(3)
    by_motion[:, :, :3] = interval[:, None, None] * np.eye(3)
    v = interval[:, None] * motion[:, :3] - moved - observed
    return Linearised(v, (by_a, by_b, by_motion))


def photo_turn(
    frame: Frame, before: Array, after: Array, motion: Array, *, observed: Array, interval: Array
) -> Linearised:
    """Compute ω Δt − Log(R_Aᵀ R_B) − observed, radians, (n, 3); arguments as `photo_shift`."""
    relative = np.swapaxes(split_pose(before)[0], 1, 2) @ split_pose(after)[0]
    turn = log_rotation(relative)
    j = right_jacobian_inverse(turn)
    by_a, by_b = (np.zeros((len(turn), 3, MOTION)) for _ in range(2))
    by_motion = np.zeros((len(turn), 3, motion.shape[1]))
    by_a[:, :, :3], by_b[:, :, :3] = j @ np.swapaxes(relative, 1, 2), -j
    by_motion[:, :, VELOCITY:MOTION] = interval[:, None, None] * np.eye(3)
    v = interval[:, None] * motion[:, VELOCITY:MOTION] - turn - observed
    return Linearised(v, (by_a, by_b, by_motion))
