"""Heights above the reference surface, surfaces of equal pressure and of water (FRAMES F9).

    profile:  (1 + s) (h − a − b t − c t²)          water:  h − (w + slope · along + geoid)

h is the height of a point, or of an instrument that a camera carries at X₀ + R a, in the frame of
the network, see `height`.
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame, LocalFrame
from ..types import Array
from .antenna import antennas
from .base import Linearised

MOUNT_COMPONENTS = 6
"""Components of a mount: three rotations, three of the arm."""


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
