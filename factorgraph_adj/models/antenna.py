"""Antennas on the carrier of a camera: their positions, ranges to them, vectors between them.

    A = X₀ + R (a + b)

X₀ is the projection centre, R the rotation from photogrammetric camera axes (x right, y up, z
backwards) to the object, a the lever arm that an observation states, b the arm of its mount, which
may be unknown. Partials: X₀: I; rotation about the axes of the camera: −R [a + b]×; b: R.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..rotation import TURN_ABOUT_X, skew
from ..types import Array
from .base import Linearised, require
from .position import split_pose

ARM = slice(9, 12)
"""Stored numbers of a mount that are its arm b."""


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
