"""Exterior orientations of photos in the quantities that surveyors use, with their σ."""

from __future__ import annotations

from dataclasses import dataclass
from math import nan, sqrt

import numpy as np

from ..rotation import angles_by_rotation, omega_phi_kappa
from ..solve.solution import Solution
from ..types import Array


@dataclass(frozen=True)
class PoseFigures:
    """Exterior orientation of a photo in the quantities that surveyors use."""

    position: tuple[float, ...]
    """X0, Y0, Z0, metres."""
    angles: tuple[float, ...]
    """ω, φ, κ, radians."""
    rotation: Array
    """world_R_camera (3, 3)."""
    sigma_position: tuple[float, ...]
    """σ of X0, Y0, Z0, metres."""
    sigma_angles: tuple[float, ...]
    """σ of ω, φ, κ, radians; NaN at φ = ±π/2."""
    sigma_rotations: tuple[float, ...]
    """σ of rotations about the axes of the camera, radians."""


def pose_figures(solution: Solution, name: str, *, known: bool) -> PoseFigures:
    """Return the exterior orientation of a photo.

    Args:
        solution: the adjustment.
        name: name of the photo.
        known: whether the adjustment has covariances; without, σ are NaN.
    """
    stored = solution.state["pose"][solution.number("pose", name)]
    rotation = stored[:9].reshape(3, 3)
    covariance = solution.pose_covariance(name) if known else np.full((6, 6), nan)
    turn = angles_by_rotation(rotation)
    variances = (turn @ covariance[:3, :3] @ turn.T).diagonal().tolist()
    own = [sqrt(max(v, 0.0)) for v in covariance.diagonal().tolist()]
    return PoseFigures(
        tuple(stored[9:].tolist()),
        omega_phi_kappa(rotation),
        rotation,
        tuple(own[3:]),
        tuple(sqrt(v) if v >= 0 else nan for v in variances),
        tuple(own[:3]),
    )
