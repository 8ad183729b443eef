"""Attitudes (ω, φ, κ; roll, pitch, heading), tilts, inclinometers, unit vectors (FRAMES F8, F13).

    object_R_body = R B

R is the rotation from photogrammetric camera axes (x right, y up, z backwards) to the object, B the
rotation of a mount, body → camera: the boresight. A body is nominally turned like the camera, x to
the right of the flight, y forward, z up, so that B = I; a body whose axes are x forward, y right, z
down, the axes of roll, pitch and heading, is these axes turned by `FORWARD_RIGHT_DOWN`.

Attitudes are observed in two ways:

- ω, φ, κ from the axes of the frame: R_obs = R1(ω) R2(φ) R3(κ);
- roll, pitch and heading from the horizon at the photo: object_R_obs = Eᵀ N R3(ψ) R2(θ) R1(φ) T,
  E (rows east, north, up) the horizon at X₀, N north-east-down → east-north-up, T as above.

A platform may be turned about east, north and up by a rotation vector ψ (`attitude_drift`), which
stands on the left of the observed rotation in the horizon: Eᵀ Exp(ψ) E R_obs.

    g = Bᵀ Rᵀ E u(P)          r = Bᵀ Rᵀ E (X_j − X_i)

g is the vertical at the instrument, r the line from its station to a target, in the axes of an
instrument that is mounted (B) on a body whose frame has R and E, see `directions`.

`attitude` and `tilt` are the models of given rotations of photos and frames that have weights.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from ..frames import Basis, Frame
from ..rotation import TURN_ABOUT_X, exp_rotation, log_rotation, right_jacobian_inverse, skew
from ..types import Array
from .base import Linearised, require, wrap
from .directions import (
    Verticals,
    direction_in_frame,
    in_instrument,
    of_those_there,
    vertical_in_frame,
)
from .positions import split_pose
from .terrestrial_observations import NO_LENGTH

FORWARD_RIGHT_DOWN: Array = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""T = Tᵀ: right-forward-up ↔ forward-right-down; also north-east-down ↔ east-north-up."""
LOCKED = 1e-9
"""Cosine of φ or of the pitch below which the other two angles are not defined."""
NO_ANGLES = (
    "its second angle, φ or pitch, is ±90°: the other two angles are not defined there; give "
    'standard deviations of rotations of an attitude with about="body"'
)

Angles: TypeAlias = Callable[[Array], Array]
_LEAST = 1e-9
"""Smallest part of the vertical in the plane of an inclinometer, and smallest length, metres."""
ON_ITS_SIDE = "the axis of the inclinometer is vertical: its reading has no direction"


def from_omega_phi_kappa(angles: Array) -> Array:
    """Return R1(ω) R2(φ) R3(κ), (n, 3, 3), of angles (n, 3), radians."""
    return _about(0, angles[:, 0]) @ _about(1, angles[:, 1]) @ _about(2, angles[:, 2])


def to_omega_phi_kappa(r: Array) -> Array:
    """Return ω, φ, κ (n, 3) of rotations (n, 3, 3)."""
    omega = np.arctan2(-r[:, 1, 2], r[:, 2, 2])
    phi = np.arctan2(r[:, 0, 2], np.hypot(r[:, 0, 0], r[:, 0, 1]))
    return np.stack([omega, phi, np.arctan2(-r[:, 0, 1], r[:, 0, 0])], axis=1)


def omega_phi_kappa_by_turn(angles: Array) -> Array:
    """Return ∂(ω, φ, κ)/∂θ (n, 3, 3), for R ← R Exp(θ); θ = R3ᵀR2ᵀe₁ dω + R3ᵀe₂ dφ + e₃ dκ."""
    _, phi, kappa = angles.T
    cp, tp, sk, ck = np.cos(phi), np.tan(phi), np.sin(kappa), np.cos(kappa)
    zero, one = np.zeros_like(phi), np.ones_like(phi)
    rows = [[ck / cp, -sk / cp, zero], [sk, ck, zero], [-ck * tp, sk * tp, one]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def from_roll_pitch_heading(angles: Array) -> Array:
    """Return R3(ψ) R2(θ) R1(φ), body → north-east-down, (n, 3, 3), of roll, pitch, heading."""
    return _about(2, angles[:, 2]) @ _about(1, angles[:, 1]) @ _about(0, angles[:, 0])


def to_roll_pitch_heading(r: Array) -> Array:
    """Return roll, pitch, heading (n, 3) of rotations body → north-east-down (n, 3, 3)."""
    roll = np.arctan2(r[:, 2, 1], r[:, 2, 2])
    pitch = np.arctan2(-r[:, 2, 0], np.hypot(r[:, 2, 1], r[:, 2, 2]))
    return np.stack([roll, pitch, np.arctan2(r[:, 1, 0], r[:, 0, 0])], axis=1)


def roll_pitch_heading_by_turn(angles: Array) -> Array:
    """Return ∂(roll, pitch, heading)/∂θ (n, 3, 3), for R ← R Exp(θ), θ about forward-right-down."""
    roll, pitch, _ = angles.T
    sr, cr, cp, tp = np.sin(roll), np.cos(roll), np.cos(pitch), np.tan(pitch)
    zero, one = np.zeros_like(roll), np.ones_like(roll)
    rows = [[one, sr * tp, cr * tp], [zero, cr, -sr], [zero, sr / cp, cr / cp]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def _about(axis: int, angle: Array) -> Array:
    """Return the rotations (n, 3, 3) by angles (n,) about one axis."""
    vector = np.zeros((len(angle), 3))
    vector[:, axis] = angle
    return exp_rotation(vector)


def _defined(second: Array) -> None:
    """Refuse rows whose second angle, φ or pitch (n,), is ±90°."""
    require(np.abs(np.cos(second)) > LOCKED, NO_ANGLES)


class _System(NamedTuple):
    """A system of three angles of a body."""

    rotation: Angles
    """Rotation (n, 3, 3) of angles (n, 3)."""
    angles: Angles
    """Angles of rotations."""
    by_turn: Angles
    """Partials of angles (n, 3) by a turn about the axes of the body."""


PHOTOGRAMMETRIC = _System(from_omega_phi_kappa, to_omega_phi_kappa, omega_phi_kappa_by_turn)
NAVIGATION = _System(from_roll_pitch_heading, to_roll_pitch_heading, roll_pitch_heading_by_turn)


class Bodies(NamedTuple):
    """Rotations of bodies, and how they turn about their own axes."""

    rotation: Array
    """object_R_body, (n, 3, 3)."""
    by_pose: Array
    """Turn about the axes of the body by the pose, (n, 3, 6)."""
    by_mount: Array
    """Turn about the axes of the body by the mount, (n, 3, 6)."""


def bodies(pose: Array, mount: Array) -> Bodies:
    """Return the bodies that stand on poses (n, 12) with mounts (n, 12)."""
    boresight = mount[:, :9].reshape(-1, 3, 3)
    turned = TURN_ABOUT_X @ boresight
    by_pose, by_mount = np.zeros((len(pose), 3, 6)), np.zeros((len(pose), 3, 6))
    by_pose[:, :, :3] = turned.transpose(0, 2, 1)
    by_mount[:, :, :3] = np.eye(3)
    return Bodies(split_pose(pose)[0] @ turned, by_pose, by_mount)


def _turn_of_horizon(basis: Basis) -> Array:
    """Return how the horizon turns, a rotation vector about e, n, u, by the position, (n, 3, 3)."""
    s, c = basis.sin_latitude, basis.cos_latitude
    zero = np.zeros_like(s)
    one = np.ones_like(s)
    by_angles = np.stack(
        [np.stack([-one, zero], 1), np.stack([zero, c], 1), np.stack([zero, s], 1)], axis=1
    )
    return by_angles @ basis.angles_by_position


def _drifted(drift: Array, time: Array) -> tuple[Array, Array, Array]:
    """Return Exp(ψ), J_l(ψ) and 1, t of drifts ψ = ψ₀ + ψ₁ t, (n, 6)."""
    psi = drift[:, :3] + drift[:, 3:] * time[:, None]
    # J_l(ψ) = J_r(−ψ)
    left = np.linalg.inv(right_jacobian_inverse(-psi)).astype(float, copy=False)
    return exp_rotation(psi), left, np.stack([np.ones_like(time), time], axis=1)


def photo_attitude(
    frame: Frame,
    pose: Array,
    mount: Array,
    drift: Array,
    *,
    observed: Array,
    time: Array,
    by_angles: Array,
) -> Linearised:
    """Compute v = Log((Eᵀ Exp(ψ) E R_obs)ᵀ R B), radians, (n, 3), for observed ω, φ, κ.

    Rows are rotations about x, y, z of the body, or, where ``by_angles`` is 1, what these do to ω,
    φ and κ. Partials of the rows in body axes, with K = E R B and h the turn of the horizon:

    | by | value |
    | --- | --- |
    | ω of the pose | J_r⁻¹(v) (D B)ᵀ |
    | rotation of the mount | J_r⁻¹(v) |
    | ψ₀, ψ₁ | −J_r⁻¹(v) Kᵀ J_l(ψ), times t |
    | X₀ | J_r⁻¹(v) Kᵀ (Exp(ψ) − I) ∂h/∂X₀ |

    Args:
        frame: frame of the network.
        pose: stored poses, (n, 12).
        mount: stored mounts of the bodies, (n, 12); only their rotations count.
        drift: drifts of the attitudes, (n, 6).
        observed: ω, φ, κ, (n, 3).
        time: t, in the unit of the drift, (n,).
        by_angles: 1 where rows are those of the angles, otherwise 0, (n,).
    """
    body = bodies(pose, mount)
    basis = frame.basis(pose[:, 9:], np.zeros((len(pose), 2)))
    exp_psi, left, powers = _drifted(drift, time)
    e = basis.enu
    k = e @ body.rotation
    reference = e.transpose(0, 2, 1) @ exp_psi @ e @ from_omega_phi_kappa(observed)
    by_horizon = (exp_psi - np.eye(3)) @ _turn_of_horizon(basis)
    turn = _Turn(reference, k, left, powers, by_horizon)
    rows = _rows(PHOTOGRAMMETRIC, observed, by_angles)
    return _difference(body, turn, rows)


def navigation_attitude(
    frame: Frame,
    pose: Array,
    mount: Array,
    drift: Array,
    *,
    observed: Array,
    time: Array,
    by_angles: Array,
) -> Linearised:
    """Compute v = T Log((Eᵀ Exp(ψ) N C T)ᵀ R B), radians, (n, 3), for roll, pitch and heading.

    C = R3(heading) R2(pitch) R1(roll). Rows are rotations about forward, right and down of the
    body, or, where ``by_angles`` is 1, what these do to roll, pitch and heading. Partials as in
    `photo_attitude`, but by X₀: −J_r⁻¹(v) Kᵀ ∂h/∂X₀, because the horizon carries all of R_obs.

    Args: as `photo_attitude`; ``observed``: roll, pitch, heading, (n, 3).
    """
    body = bodies(pose, mount)
    basis = frame.basis(pose[:, 9:], np.zeros((len(pose), 2)))
    exp_psi, left, powers = _drifted(drift, time)
    e = basis.enu
    in_horizon = FORWARD_RIGHT_DOWN @ from_roll_pitch_heading(observed) @ FORWARD_RIGHT_DOWN
    reference = e.transpose(0, 2, 1) @ exp_psi @ in_horizon
    by_horizon = -_turn_of_horizon(basis)
    turn = _Turn(reference, e @ body.rotation, left, powers, by_horizon)
    rows = _rows(NAVIGATION, observed, by_angles) @ FORWARD_RIGHT_DOWN
    return _difference(body, turn, rows)


class _Turn(NamedTuple):
    """A rotation to compare with, and what it depends on."""

    reference: Array
    """Observed object_R_body, with the drift, (n, 3, 3)."""
    horizon_R_body: Array
    """K = E R B, (n, 3, 3)."""
    left: Array
    """J_l(ψ), (n, 3, 3)."""
    powers: Array
    """1 and t, (n, 2)."""
    by_horizon: Array
    """Turn about e, n, u that a shift of the photo adds on the side of the body, (n, 3, 3)."""


def _difference(body: Bodies, turn: _Turn, rows: Array) -> Linearised:
    """Return rows (n, 3, 3) times Log(referenceᵀ body), with all partials."""
    w = log_rotation(turn.reference.transpose(0, 2, 1) @ body.rotation)
    by_turn = rows @ right_jacobian_inverse(w)
    to_body = by_turn @ turn.horizon_R_body.transpose(0, 2, 1)
    by_pose = by_turn @ body.by_pose
    by_pose[:, :, 3:] += to_body @ turn.by_horizon
    by_psi = -to_body @ turn.left
    by_drift = np.concatenate([p[:, None, None] * by_psi for p in turn.powers.T], axis=2)
    v = np.einsum("nij,nj->ni", rows, w)
    return Linearised(v, (by_pose, by_turn @ body.by_mount, by_drift))


def _rows(system: _System, observed: Array, by_angles: Array) -> Array:
    """Return the identity, or ∂angles/∂turn at the observed angles where these are the rows."""
    out = np.broadcast_to(np.eye(3), (len(observed), 3, 3)).copy()
    on = np.flatnonzero(by_angles)
    if len(on):
        _defined(np.where(by_angles != 0, observed[:, 1], 0.0))
        out[on] = system.by_turn(observed[on])
    return out


def turn_readings(system: _System) -> Callable[..., Array]:
    """Return the function that moves readings of a system of angles by residuals: R Exp(θ)."""

    def turned(observed: Array, change: Array, *, by_angles: Array, **_: Array) -> Array:
        rows = _rows(system, observed, by_angles)
        turn = np.linalg.solve(rows, change[:, :, None])[:, :, 0].astype(float, copy=False)
        return system.angles(system.rotation(observed) @ exp_rotation(turn))

    return turned


def photo_angle(
    frame: Frame, pose: Array, mount: Array, *, observed: Array, which: Array
) -> Linearised:
    """Compute one angle of the body − observed, radians, wrapped to (−π, π], (n, 1); FRAMES F8.4.

    Args:
        frame: frame of the network.
        pose: stored poses, (n, 12).
        mount: stored mounts of the bodies, (n, 12); only their rotations count.
        observed: (n, 1).
        which: number of the angle among ω, φ, κ, roll, pitch, heading, (n,).
    """
    body = bodies(pose, mount)
    number = which.astype(int)
    n = len(number)
    angles = np.zeros((n, 3))
    by_turn, by_shift = np.zeros((n, 1, 3)), np.zeros((n, 1, 3))
    own, on = np.flatnonzero(number < 3), np.flatnonzero(number >= 3)
    basis = frame.basis(pose[on, 9:], np.zeros((len(on), 2)))
    k = basis.enu @ body.rotation[on]
    angles[own] = to_omega_phi_kappa(body.rotation[own])
    angles[on] = to_roll_pitch_heading(FORWARD_RIGHT_DOWN @ k @ FORWARD_RIGHT_DOWN)
    _defined(angles[:, 1])
    by_turn[own, 0] = omega_phi_kappa_by_turn(angles[own])[np.arange(len(own)), number[own]]
    navigated = roll_pitch_heading_by_turn(angles[on]) @ FORWARD_RIGHT_DOWN
    by_turn[on, 0] = navigated[np.arange(len(on)), number[on] - 3]
    by_shift[on] = -by_turn[on] @ k.transpose(0, 2, 1) @ _turn_of_horizon(basis)
    by_pose = by_turn @ body.by_pose
    by_pose[:, :, 3:] += by_shift
    value = angles[np.arange(n), number % 3]
    return Linearised(wrap(value[:, None] - observed), (by_pose, by_turn @ body.by_mount))


def _inclined(
    there: Verticals,
    by_mount: Array,
    to_instrument: Array,
    v: Array,
    gradient: Array,
    origin: Array | None,
    vertical: Array | None,
) -> Linearised:
    """Return wrapped residuals (n,) with their partials, from those by g (n, 3)."""
    g = gradient[:, None, :]
    in_carrier = g @ to_instrument
    every = [
        in_carrier @ there.by_frame,
        in_carrier @ there.by_place,
        in_carrier @ there.by_deflection,
        g @ by_mount,
    ]
    every += of_those_there(
        ((origin, in_carrier @ there.by_origin), (vertical, in_carrier @ there.by_vertical))
    )
    return Linearised(wrap(v)[:, None], tuple(every))


def frame_inclination(
    frame: Frame,
    stored: Array,
    point: Array,
    deflection: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute asin g_x − observed, radians: how much the x axis rises above the horizon.

    ∂/∂g = (√(1 − g_x²), −g_x g_y/√…, −g_x g_z/√…), along the unit sphere. LGC2 INCLY.
    """
    there = vertical_in_frame(frame, stored, point, deflection, origin, vertical)
    g, by_mount, to_instrument = in_instrument(mount, there.g)
    level = np.hypot(g[:, 1], g[:, 2])
    require(level > _LEAST, ON_ITS_SIDE)
    gradient = -g[:, :1] * g / level[:, None]
    gradient[:, 0] = level
    v = np.arctan2(g[:, 0], level) - observed[:, 0]
    return _inclined(there, by_mount, to_instrument, v, gradient, origin, vertical)


def frame_roll(
    frame: Frame,
    stored: Array,
    point: Array,
    deflection: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute atan2(g_x, g_z) − observed, radians: the turn about the y axis.

    ∂/∂g = (g_z, 0, −g_x)/(g_x² + g_z²). LGC2 ROLLY.
    """
    there = vertical_in_frame(frame, stored, point, deflection, origin, vertical)
    g, by_mount, to_instrument = in_instrument(mount, there.g)
    square = g[:, 0] ** 2 + g[:, 2] ** 2
    require(square > _LEAST**2, ON_ITS_SIDE)
    gradient = np.stack([g[:, 2], np.zeros(len(g)), -g[:, 0]], 1) / square[:, None]
    v = np.arctan2(g[:, 0], g[:, 2]) - observed[:, 0]
    return _inclined(there, by_mount, to_instrument, v, gradient, origin, vertical)


def unit_vector(
    frame: Frame,
    stored: Array,
    station: Array,
    target: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute the x and y components of r/|r| less the observed ones, radians, (n, 2).

    ∂(r/|r|)/∂r = (I − r̂ r̂ᵀ)/|r|. LGC2 UVEC.
    """
    there = direction_in_frame(frame, stored, target - station, station, origin, vertical)
    r, by_mount, to_instrument = in_instrument(mount, there.g)
    length = np.linalg.norm(r, axis=1)
    require(length > _LEAST, NO_LENGTH)
    unit = r / length[:, None]
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    g = (across / length[:, None, None])[:, :2]
    in_carrier = g @ to_instrument
    by_target = in_carrier @ there.by_vector
    every = [in_carrier @ there.by_frame, -by_target, by_target, g @ by_mount]
    every += of_those_there(
        ((origin, in_carrier @ there.by_origin), (vertical, in_carrier @ there.by_vertical))
    )
    return Linearised(unit[:, :2] - observed, tuple(every))


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
