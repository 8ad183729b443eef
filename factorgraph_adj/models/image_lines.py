"""Straight lines in images, without object points: line photogrammetry.

The plane through the projection centre X₀ and a line with direction d through Z has in the axes of
the camera the normal n = Rᵀ (d × (Z − X₀)). A measured point has the ideal tangents t, from which
its ray is r = (t_x, −t_y, 1), and its distance from the imaged line is

    v = c nᵀr / √(n_x² + n_y²)        (image units)

in the plane of ideal coordinates. As in the lens models from measured to ideal coordinates, σ is
that of measured coordinates. (FRAMES F17.4; MMVII AdjLine3D.)
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..rotation import skew
from ..types import Array
from .axes import axis_of
from .base import Linearised, require
from .lens import Lens
from .position import split_pose

NO_IMAGE = (
    "the line has no image in the photo: it passes through the projection centre, or lies in the "
    "focal plane"
)
STEPS = 50
"""Largest number of steps to the ideal tangents of a measured point."""


def tangents(lens: Lens, x: Array, y: Array, k: Array) -> tuple[Array, Array]:
    """Return the ideal tangents t (n, 2) of measured points, and ∂t/∂K (n, 2, k).

    v(t, K) = 0 is solved by Newton's method; ∂t/∂K = −(∂v/∂t)⁻¹ ∂v/∂K.

    Args:
        lens: the lens model.
        x: measured coordinates x, (n,).
        y: measured coordinates y, (n,).
        k: calibration parameters, (n, k).
    """
    xy = np.stack([x, y], axis=1)
    t = (xy - k[:, 1:3]) / k[:, :1]
    by_t, by_k = np.zeros((0, 2, 2)), np.zeros((0, 2, 0))
    for _ in range(STEPS):
        v, by_tangents, by_lens = lens.residual(t[:, 0], t[:, 1], xy, k)
        assert by_tangents is not None
        assert by_lens is not None
        by_t, by_k = by_tangents, by_lens
        step = np.linalg.solve(by_t, v[:, :, None])[:, :, 0]
        t = t - step
        if np.abs(step).max(initial=0.0) < 1e-15 + 1e-14 * np.abs(t).max(initial=0.0):
            break
    return t, np.asarray(-np.linalg.solve(by_t, by_k))


def image_line(
    frame: Frame,
    pose: Array,
    calibration: Array,
    stored: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
    x: Array,
    y: Array,
    lens: Lens,
) -> Linearised:
    """Compute the distance of measured points from imaged lines − observed, image units, (n, 1).

    Args:
        frame: frame of the network.
        pose: stored poses, (n, 12).
        calibration: parameters of the lens, (n, k).
        stored: frames of the lines, (n, 17).
        origin: O where it is a point, (n, 3).
        vertical: deflections there, (n, 2).
        observed: distances, (n, 1).
        x: measured coordinates x, (n,).
        y: measured coordinates y, (n,).
        lens: the lens model.
    """
    rotation, centre = split_pose(pose)
    line = axis_of(frame, stored, origin, vertical)
    t, t_by_k = tangents(lens, x, y, calibration)
    c = calibration[:, 0]
    back = rotation.transpose(0, 2, 1)
    away = line.zero - centre
    n = np.einsum("nij,nj->ni", back, np.cross(line.d, away))
    plan = np.hypot(n[:, 0], n[:, 1])
    require(plan > 1e-12 * np.linalg.norm(away, axis=1), NO_IMAGE)
    ray = np.stack([t[:, 0], -t[:, 1], np.ones(len(t))], axis=1)
    f = c * np.einsum("ni,ni->n", n, ray) / plan
    in_plan = n * [1.0, 1.0, 0.0]
    by_n = (c / plan)[:, None] * ray - (f / plan**2)[:, None] * in_plan
    by_t = (c / plan)[:, None] * (in_plan[:, :2] * [1.0, -1.0])
    by_k = np.einsum("ni,nij->nj", by_t, t_by_k)
    by_k[:, 0] += f / c
    by_d = -back @ skew(away)
    by_zero = back @ skew(line.d)
    by_line = [by_d @ d + by_zero @ z for d, z in zip(line.d_by, line.zero_by, strict=True)]
    by_pose = np.concatenate([skew(n), -by_zero], axis=2)
    g = by_n[:, None]
    parts = [g @ by_pose, by_k[:, None], g @ by_line[0]]
    given = (origin, vertical)
    parts += [g @ j for j, value in zip(by_line[1:], given, strict=True) if value is not None]
    return Linearised(f[:, None] - observed, tuple(parts))
