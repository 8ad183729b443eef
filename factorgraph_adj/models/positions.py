"""Positions of points and antennas, ranges, bases, GNSS vectors, surface heights, weighted values.

Heights above the reference surface, and above surfaces of equal pressure and of water (FRAMES F9):

    profile:  (1 + s) (h − a − b t − c t²)          water:  h − (w + slope · along + geoid)

h is the height of a point, or of an instrument that a camera carries at X₀ + R a, in the frame of
the network, see `heights`.

Antennas on the carrier of a camera: their positions, ranges to them, vectors between them:

    A = X₀ + R (a + b)

X₀ is the projection centre, R the rotation from photogrammetric camera axes (x right, y up, z
backwards) to the object, a the lever arm that an observation states, b the arm of its mount, which
may be unknown. Partials: X₀: I; rotation about the axes of the camera: −R [a + b]×; b: R.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame, LocalFrame
from ..rotation import TURN_ABOUT_X, skew
from ..types import Array
from .base import Linearised, require
from .line_of_sight import up_by_angles

ARM = slice(9, 12)
"""Stored numbers of a mount that are its arm b."""
MOUNT_COMPONENTS = 6
"""Components of a mount: three rotations, three of the arm."""


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


class Antennas(NamedTuple):
    """Vectors from projection centres to antennas, and their partials."""

    arm: Array
    """R (a + b), metres, (n, 3)."""
    by_turn: Array
    """∂/∂ω, ω about the axes of the camera, (n, 3, 3)."""
    by_mount: Array
    """∂/∂(β, b), (n, 3, 6)."""


def antennas(pose: Array, mount: Array, lever_arm: Array) -> Antennas:
    """Return the arms of antennas (n, 3) on poses (n, 12) with mounts (n, 12)."""
    rotation, _ = split_pose(pose)
    arm = (lever_arm + mount[:, ARM]) @ TURN_ABOUT_X
    by_mount = np.zeros((len(pose), 3, 6))
    by_mount[:, :, 3:] = rotation @ TURN_ABOUT_X
    return Antennas(np.einsum("nij,nj->ni", rotation, arm), -rotation @ skew(arm), by_mount)


def photo_position(
    frame: Frame,
    pose: Array,
    mount: Array,
    drift: Array,
    shutter: Array,
    *,
    observed: Array,
    lever_arm: Array,
    time: Array,
    velocity: Array,
    axes: tuple[int, ...] = (0, 1, 2),
) -> Linearised:
    """Compute A + s + d t + e t² + Ẋ τ − observed, metres, of the observed axes, (n, d); FRAMES F7.

    Args:
        frame: not used; all vectors are in its axes.
        pose: stored poses, (n, 12).
        mount: stored mounts of the antennas, (n, 12); only their arms count.
        drift: shifts s, drifts d and e, (n, 9).
        shutter: time errors τ, recorded − true time, seconds, (n, 1).
        observed: positions of the antennas, (n, d).
        lever_arm: a, antenna − projection centre, (n, 3), metres in photogrammetric axes of the
            camera: x right, y up, z backwards.
        time: t, in the unit of the drift, (n,).
        velocity: Ẋ of the antenna, metres per second, (n, 3).
        axes: numbers of the observed axes.
    """
    rows = list(axes)
    found = antennas(pose, mount, lever_arm)
    powers = np.stack([np.ones_like(time), time, time**2], axis=1)
    moved = np.einsum("np,npi->ni", powers, drift.reshape(-1, 3, 3)) + velocity * shutter
    # Differences of coordinates come first because they lose no digits, see `sight`.
    v = (pose[:, 9:][:, rows] - observed) + (found.arm + moved)[:, rows]
    eye = np.broadcast_to(np.eye(3), (len(pose), 3, 3))
    by_drift = np.concatenate([power[:, None, None] * eye for power in powers.T], axis=2)
    partials = (
        np.concatenate([found.by_turn, eye], axis=2),
        found.by_mount,
        by_drift,
        velocity[:, :, None],
    )
    return Linearised(v, tuple(j[:, rows] for j in partials))


def photo_range(
    frame: Frame,
    station: Array,
    pose: Array,
    mount: Array,
    meter: Array,
    *,
    observed: Array,
    lever_arm: Array,
) -> Linearised:
    """Compute (1 + m) |A − X| + z − observed, metres, (n, 1); FRAMES F7.4.

    Args:
        frame: not used.
        station: X of the ground stations, (n, 3).
        pose: stored poses, (n, 12).
        mount: stored mounts of the antennas, (n, 12).
        meter: scale m and zero constant z, (n, 2).
        observed: ranges, (n, 1).
        lever_arm: a, (n, 3), see `photo_position`.
    """
    found = antennas(pose, mount, lever_arm)
    d = (pose[:, 9:] - station) + found.arm
    length, towards, by_meter = _measured(d, meter)
    v = length - observed
    by_pose = towards @ np.concatenate([found.by_turn, np.eye(3)[None].repeat(len(d), 0)], axis=2)
    return Linearised(v, (-towards, by_pose, towards @ found.by_mount, by_meter))


def photo_base(
    frame: Frame,
    pose: Array,
    pose2: Array,
    mount: Array,
    meter: Array,
    *,
    observed: Array,
    lever_arm: Array,
) -> Linearised:
    """Compute (1 + m) |A₂ − A₁| + z − observed, metres, (n, 1), of two photos; FRAMES F7.5.

    Args:
        frame: not used.
        pose: stored poses of the first photos, (n, 12).
        pose2: stored poses of the second photos, (n, 12).
        mount: stored mounts of the antenna, (n, 12), the same at both.
        meter: scale m and zero constant z, (n, 2).
        observed: distances, (n, 1).
        lever_arm: a, (n, 3), see `photo_position`, the same at both.
    """
    one, other = antennas(pose, mount, lever_arm), antennas(pose2, mount, lever_arm)
    d = (pose2[:, 9:] - pose[:, 9:]) + (other.arm - one.arm)
    length, towards, by_meter = _measured(d, meter)
    eye = np.eye(3)[None].repeat(len(d), 0)
    by_one, by_other = (towards @ np.concatenate([a.by_turn, eye], axis=2) for a in (one, other))
    by_mount = towards @ (other.by_mount - one.by_mount)
    return Linearised(length - observed, (-by_one, by_other, by_mount, by_meter))


def antenna_vector(
    frame: Frame, pose: Array, mount: Array, *, observed: Array, lever_arm: Array
) -> Linearised:
    """Compute R (a + b) − observed, metres, (n, 3): a vector between two antennas; FRAMES F7.9.

    Args:
        frame: not used.
        pose: stored poses, (n, 12).
        mount: stored mounts, (n, 12), whose arm b leads from the first antenna to the second.
        observed: vectors from the first antenna to the second in the axes of the frame, (n, 3).
        lever_arm: a, what is known of this arm, (n, 3).
    """
    found = antennas(pose, mount, lever_arm)
    still = np.zeros((len(pose), 3, 3))
    by_pose = np.concatenate([found.by_turn, still], axis=2)
    return Linearised(found.arm - observed, (by_pose, found.by_mount))


def _measured(d: Array, meter: Array) -> tuple[Array, Array, Array]:
    """Return (1 + m) |d| + z (n, 1), and its partials by d (n, 1, 3) and by m, z (n, 1, 2)."""
    length = np.linalg.norm(d, axis=1)
    require(
        length > 0, "antenna and station are at the same place: their distance has no direction"
    )
    towards = ((1.0 + meter[:, 0]) / length)[:, None] * d
    by_meter = np.stack([length, np.ones_like(length)], axis=1)[:, None, :]
    return ((1.0 + meter[:, 0]) * length + meter[:, 1])[:, None], towards[:, None, :], by_meter


def heights(frame: Frame, position: Array) -> tuple[Array, Array]:
    """Return heights h (n,) of places (n, 3), metres, and their gradients ∂h/∂X (n, 3).

    - geocentric and topocentric frames: the ellipsoidal height, whose gradient is the normal;
    - a flat local frame: Z;
    - a curved local frame: Z + d²/2R, with the distance d in plan from the place where Z is
      vertical.
    """
    found = frame.geodetic(position)
    if found is not None:
        return found[2], frame.basis(position, np.zeros((len(position), 2))).enu[:, 2]
    assert isinstance(frame, LocalFrame)
    height = position[:, 2].copy()
    gradient = np.zeros_like(position)
    gradient[:, 2] = 1.0
    if frame.curvature:
        away = position[:, :2] - np.asarray(frame.origin)[:2]
        height += np.sum(away**2, axis=1) / (2.0 * frame.radius)
        gradient[:, :2] = away / frame.radius
    return height, gradient


def profile_height(
    frame: Frame,
    point: Array | None,
    pose: Array | None,
    mount: Array,
    profile: Array,
    *,
    observed: Array,
    time: Array,
    lever_arm: Array,
) -> Linearised:
    """Compute (1 + s) (h − a − b t − c t²) − observed, metres, (n, 1); FRAMES F9.1, F9.3.

    Args:
        frame: frame of the network.
        point: X, (n, 3); None: the instrument is carried by a camera.
        pose: stored poses, (n, 12); None: the height is that of a point.
        mount: stored mounts, (n, 12), whose arm adds to ``lever_arm``.
        profile: a (m), b (m per unit of t), c (m per unit of t²), s, (n, 4).
        observed: readings, metres, (n, 1).
        time: place t along the profile, in any unit, (n,).
        lever_arm: instrument − projection centre, (n, 3), metres in photogrammetric axes of the
            camera: x right, y up, z backwards.
    """
    assert (point is None) != (pose is None)
    n = len(observed)
    if pose is None:
        assert point is not None
        place, turned = point, None
    else:
        turned = antennas(pose, mount, lever_arm)
        place = pose[:, 9:] + turned.arm
    h, up = heights(frame, place)
    powers = np.stack([np.ones(n), time, time * time], axis=1)
    above = h - np.sum(profile[:, :3] * powers, axis=1)
    scale = 1.0 + profile[:, 3:]
    by_place = (scale * up)[:, None, :]
    by_profile = np.concatenate([-scale * powers, above[:, None]], axis=1)[:, None, :]
    if turned is None:
        parts = (by_place, np.zeros((n, 1, MOUNT_COMPONENTS)))
    else:
        by_pose = np.concatenate([by_place @ turned.by_turn, by_place], axis=2)
        parts = (by_pose, by_place @ turned.by_mount)
    return Linearised(scale * above[:, None] - observed, (*parts, by_profile))


def level_height(
    frame: Frame,
    point: Array,
    level: Array,
    *,
    observed: Array,
    slope: Array,
    along: Array,
    geoid: Array,
) -> Linearised:
    """Compute h − (w + slope · along + geoid) − observed, metres, (n, 1); FRAMES F9.4.

    Args:
        frame: frame of the network.
        point: X, (n, 3).
        level: w, height of the surface at its reference place, metres, (n, 1).
        observed: height of the point above the surface, metres, (n, 1).
        slope: rise of the surface, metres per metre, (n,).
        along: distance from the reference place in the direction of the slope, metres, (n,).
        geoid: geoid undulation at the point − that at the reference place, metres, (n,).
    """
    h, up = heights(frame, point)
    v = (h - slope * along - geoid)[:, None] - level - observed
    return Linearised(v, (up[:, None, :], np.full((len(v), 1, 1), -1.0)))
