"""Rotations and covariances of photos as photogrammetric programs have them."""

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


def rodrigues(vector: Array) -> Array:
    """Return the rotation (3, 3) of a rotation vector by Rodrigues' formula."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)
