"""Covariance of a photo in ω, φ, κ, as photogrammetric programs print it."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.rotation import exp_rotation, omega_phi_kappa
from factorgraph_adj.types import Array

STEP = 1e-5
"""Step of central differences, radians: their error is of the order of its square."""


def covariance_of_angles(rotation: Array, covariance: Array) -> Array:
    """Return the covariance (6, 6) of ω, φ, κ (rad), X0, Y0, Z0 (m).

    Args:
        rotation: world_R_camera (3, 3).
        covariance: that of rotations about the camera's axes and of the centre, (6, 6).
    """
    turns = exp_rotation(STEP * np.concatenate([np.eye(3), -np.eye(3)]))
    angles = np.array([omega_phi_kappa(rotation @ turn) for turn in turns])
    change = angles[:3] - angles[3:]
    change = (change + np.pi) % (2 * np.pi) - np.pi
    jacobian = np.eye(6)
    jacobian[:3, :3] = change.T / (2 * STEP)
    return jacobian @ covariance @ jacobian.T
