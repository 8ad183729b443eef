"""Rotations: ω, φ, κ, the conventions of camera axes, Exp and Log, the nearest rotation.

A pose in the graph is ``gtsam.Pose3`` = world_T_camera in the axes of GTSAM and OpenCV
(x right, y down, z forward), so that GTSAM's own factors and other programs' poses fit in.
Photogrammetric camera axes (x right, y up, z backwards) are these axes turned by π about x.
This module alone defines the turn between the two conventions.
"""

from __future__ import annotations

import numpy as np

from .types import Array

TURN_ABOUT_X: Array = np.diag([1.0, -1.0, -1.0])
"""camera_R_photogrammetric = photogrammetric_R_camera: the turn by π about x."""


def world_R_photogrammetric(omega: float, phi: float, kappa: float) -> Array:
    """Return R = R1(ω) R2(φ) R3(κ), camera (x right, y up, z backwards) → object; angles in rad.

    Its transpose is M of the collinearity equations.
    """
    so, co = np.sin(omega), np.cos(omega)
    sp, cp = np.sin(phi), np.cos(phi)
    sk, ck = np.sin(kappa), np.cos(kappa)
    return np.array(
        [
            [cp * ck, -cp * sk, sp],
            [co * sk + so * sp * ck, co * ck - so * sp * sk, -so * cp],
            [so * sk - co * sp * ck, so * ck + co * sp * sk, co * cp],
        ]
    )


def world_R_camera(omega: float, phi: float, kappa: float) -> Array:
    """Return the rotation of the graph's Pose3 from ω, φ, κ (rad)."""
    return world_R_photogrammetric(omega, phi, kappa) @ TURN_ABOUT_X


def omega_phi_kappa(rotation: Array) -> tuple[float, float, float]:
    """Return ω, φ, κ (rad) of a graph rotation world_R_camera (3, 3).

    At φ = ±π/2 only ω ± κ is determined; ω is then set to zero.
    """
    r = rotation @ TURN_ABOUT_X
    phi = float(np.arctan2(r[0, 2], np.hypot(r[0, 0], r[0, 1])))
    if np.hypot(r[0, 0], r[0, 1]) < 1e-12:
        return 0.0, phi, float(np.arctan2(r[1, 0], r[1, 1]))
    return (
        float(np.arctan2(-r[1, 2], r[2, 2])),
        phi,
        float(np.arctan2(-r[0, 1], r[0, 0])),
    )


def angles_by_rotation(rotation: Array) -> Array:
    """Return ∂(ω, φ, κ)/∂θ (3, 3) of world_R_camera, for R ← R Exp(θ), θ about the camera's axes.

    In photogrammetric axes θ = R3ᵀR2ᵀe₁ dω + R3ᵀe₂ dφ + e₃ dκ. At φ = ±π/2 the angles are
    ambiguous and the result is NaN.
    """
    _, phi, kappa = omega_phi_kappa(rotation)
    sp, cp = np.sin(phi), np.cos(phi)
    sk, ck = np.sin(kappa), np.cos(kappa)
    if abs(cp) < 1e-12:
        return np.full((3, 3), np.nan)
    by_angles = np.array([[cp * ck, sk, 0.0], [-cp * sk, ck, 0.0], [sp, 0.0, 1.0]])
    return np.asarray(np.linalg.inv(by_angles) @ TURN_ABOUT_X)


def nearest_rotation(h: Array, *, mirrored: bool = False) -> Array:
    """Return the orthogonal R (…, d, d) with the largest tr(Rᵀ H): b ≈ R a for H = Σ b aᵀ (Kabsch).

    The mean of rotations in the least-squares sense is the rotation nearest to their sum.

    Args:
        h: H, (…, d, d).
        mirrored: whether R is a rotation with a mirror, det R = −1, and not a rotation.
    """
    u, _, vt = np.linalg.svd(h)
    sign = np.asarray(np.sign(np.linalg.det(u @ vt)) * (-1.0 if mirrored else 1.0))
    u[..., -1] *= sign[..., None]
    return np.asarray(u @ vt)


def rotation_of_quaternion(q: Array) -> Array:
    """Return the rotation (3, 3) of a quaternion w, x, y, z of length 1, (4,)."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def skew(w: Array) -> Array:
    """Return [w]× (..., 3, 3) with [w]× a = w × a, for w (..., 3)."""
    out = np.zeros((*w.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2] = -w[..., 2], w[..., 1]
    out[..., 1, 0], out[..., 1, 2] = w[..., 2], -w[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -w[..., 1], w[..., 0]
    return out


def _series(angle2: Array) -> tuple[Array, Array]:
    """Return sin θ/θ and (1 − cos θ)/θ² from θ², stable at 0."""
    small = angle2 < 1e-8
    safe = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe)
    a = np.where(small, 1.0 - angle2 / 6.0, np.sin(angle) / angle)
    b = np.where(small, 0.5 - angle2 / 24.0, (1.0 - np.cos(angle)) / safe)
    return a, b


def exp_rotation(w: Array) -> Array:
    """Return the rotation matrices (..., 3, 3) of the rotation vectors w (..., 3)."""
    a, b = _series(np.sum(w * w, axis=-1))
    k = skew(w)
    return np.eye(3) + a[..., None, None] * k + b[..., None, None] * (k @ k)


def log_rotation(r: Array) -> Array:
    """Return the rotation vector (n, 3) of rotation matrices (n, 3, 3); |result| ≤ π."""
    from scipy.spatial.transform import Rotation

    writable = np.require(r, requirements="W")  # scipy before 1.14 takes no other
    return np.asarray(Rotation.from_matrix(writable).as_rotvec(), dtype=float)


def right_jacobian(w: Array) -> Array:
    """Return J_r(w) (n, 3, 3): Exp(w + δ) = Exp(w) Exp(J_r(w) δ + ⋯)."""
    angle2 = np.sum(w * w, axis=-1)
    a, b = _series(angle2)
    small = angle2 < 1e-8
    d = np.where(small, 1.0 / 6.0 - angle2 / 120.0, (1.0 - a) / np.where(small, 1.0, angle2))
    k = skew(w)
    return np.eye(3) - b[..., None, None] * k + d[..., None, None] * (k @ k)


def right_jacobian_inverse(w: Array) -> Array:
    """Return J_r⁻¹(w) (n, 3, 3): Log(Exp(w) Exp(δ)) = w + J_r⁻¹(w) δ + ⋯."""
    angle2 = np.sum(w * w, axis=-1)
    small = angle2 < 1e-8
    safe = np.where(small, 1.0, angle2)
    half = np.sqrt(safe) / 2
    d = np.where(small, 1.0 / 12.0, (1.0 - half * np.cos(half) / np.sin(half)) / safe)
    k = skew(w)
    return np.eye(3) + 0.5 * k + d[..., None, None] * (k @ k)
