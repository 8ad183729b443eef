"""Straight lines in images, without object points: line photogrammetry.

The plane through the projection centre X₀ and a line with direction d through Z has in the axes of
the camera the normal n = Rᵀ (d × (Z − X₀)). A measured point has the ideal tangents t, from which
its ray is r = (t_x, −t_y, 1), and its distance from the imaged line is

    v = c nᵀr / √(n_x² + n_y²)        (image units)

in the plane of ideal coordinates. Lens models of rays have no such plane: r is then a unit vector
and v = c nᵀr/|n|, c times the sine of the angle to the plane of the line. As in the lens models
from measured to ideal coordinates, σ is that of measured coordinates.
(FRAMES F17.4; MMVII AdjLine3D.)
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..rotation import skew
from ..types import Array
from .axes import axis_of
from .base import Linearised, require
from .inverse import rays_and_partials
from .lens import Lens
from .position import split_pose

NO_IMAGE = (
    "the line has no image in the photo: it passes through the projection centre, or lies in the "
    "focal plane"
)


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
    ray, ray_by_k = rays_and_partials(lens, np.stack([x, y], axis=1), calibration)
    # In the plane of ideal coordinates only n_x and n_y count; on the sphere all of n does.
    counted = np.ones(3) if lens.takes == "rays" else np.array([1.0, 1.0, 0.0])
    c = calibration[:, 0]
    back = rotation.transpose(0, 2, 1)
    away = line.zero - centre
    n = np.einsum("nij,nj->ni", back, np.cross(line.d, away))
    in_plan = n * counted
    plan = np.linalg.norm(in_plan, axis=1)
    require(plan > 1e-12 * np.linalg.norm(away, axis=1), NO_IMAGE)
    f = c * np.einsum("ni,ni->n", n, ray) / plan
    by_n = (c / plan)[:, None] * ray - (f / plan**2)[:, None] * in_plan
    by_k = np.einsum("ni,nij->nj", (c / plan)[:, None] * n, ray_by_k)
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
