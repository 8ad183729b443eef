"""Vectors in the axes of a moving body: points seen from a photo, or from a pose in plan.

With the rotation R and the projection centre X₀ of a photo in photogrammetric axes (x right, y up,
z backwards), and with the azimuth α of the forward axis of a vehicle in plan:

    q = Rᵀ (X − X₀)                              point in axes of a photo
    ahead = sin α d_e + cos α d_n                horizontal vector d = X_j − X_i in axes of a
    left = −cos α d_e + sin α d_n                vehicle that stands level at i
    turn = α_j − α_i                             clockwise

d_e, d_n are east and north in the horizon of the station. Poses are stored in axes of the graph,
which D = diag(1, −1, −1) turns.

| partial | of q | of ahead | of left |
| --- | --- | --- | --- |
| ω of the photo | D [D q]× | | |
| X₀ | −Rᵀ | | |
| X | Rᵀ | | |
| d | | (sin α, cos α, 0) | (−cos α, sin α, 0) |
| α | | −left | ahead |
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..rotation import TURN_ABOUT_X as TURN
from ..rotation import skew
from ..types import Array
from .base import Linearised, wrap
from .line_of_sight import sight
from .positions import split_pose


def body_vector(frame: Frame, pose: Array, point: Array, *, observed: Array) -> Linearised:
    """Compute Rᵀ (X − X₀) − observed, metres in photogrammetric axes, (n, 3).

    Args:
        frame: not used; every model has this argument.
        pose: stored poses, (n, 12).
        point: (n, 3).
        observed: (n, 3).
    """
    rotation, centre = split_pose(pose)
    p = np.einsum("nji,nj->ni", rotation, point - centre)
    by_point = TURN @ np.swapaxes(rotation, 1, 2)
    by_pose = np.concatenate([TURN @ skew(p), -by_point], axis=2)
    return Linearised(p @ TURN - observed, (by_pose, by_point))


def planar_vector(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    heading: Array,
    *,
    observed: Array,
) -> Linearised:
    """Compute (ahead, left) − observed, metres, (n, 2).

    Args:
        frame: the frame of the network.
        station: X_i, (n, 3).
        station_vertical: deflections at i, (n, 2).
        target: X_j, (n, 3).
        target_vertical: deflections at j, (n, 2).
        heading: α, (n, 1).
        observed: (n, 2).
    """
    none = np.zeros(len(station))
    s = sight(frame, station, station_vertical, target, target_vertical, none, none)
    sine, cosine = np.sin(heading[:, 0]), np.cos(heading[:, 0])
    zero = np.zeros_like(sine)
    axes = np.stack([np.stack([sine, cosine, zero], 1), np.stack([-cosine, sine, zero], 1)], axis=1)
    ahead, left = np.einsum("nij,nj->in", axes, s.q)
    rows = [s.chain(axes[:, i]) for i in range(2)]
    by_place = tuple(np.concatenate(both, axis=1) for both in zip(*rows, strict=True))
    by_heading = np.stack([-left, ahead], axis=1)[:, :, None]
    return Linearised(np.stack([ahead, left], axis=1) - observed, (*by_place, by_heading))


def heading_difference(
    frame: Frame,
    station: Array,
    target: Array,
    heading: Array,
    heading2: Array,
    *,
    observed: Array,
) -> Linearised:
    """Compute α_j − α_i − observed, radians, wrapped to (−π, π], (n, 1).

    Args:
        frame: not used.
        station: place of the first station, which a turn does not depend on.
        target: place of the second one.
        heading: α_i, (n, 1).
        heading2: α_j, (n, 1).
        observed: (n, 1).
    """
    one, none = np.ones((len(heading), 1, 1)), np.zeros((len(heading), 1, 3))
    return Linearised(wrap(heading2 - heading - observed), (none, none, -one, one))
