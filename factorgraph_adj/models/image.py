"""Image coordinates: the collinearity equations with a lens model (eq. 1).

With the pose world_T_camera in the axes of GTSAM (x right, y down, z forward),
p = Rᵀ (X − X₀), the tangents of the ray are t_x = p_x/p_z and t_y = −p_y/p_z. They equal
−q1/q3 and −q2/q3 in photogrammetric axes.
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, require
from .lens import Lens
from .position import split_pose

IN_FOCAL_PLANE = "the point lies in the focal plane of the photo: it has no image"


def depth(pose: Array, point: Array) -> Array:
    """Return the depth p_z of points (n, 3) in front of cameras (n, 12), metres, (n,)."""
    d = point - pose[:, 9:]
    return np.asarray(pose[:, 2] * d[:, 0] + pose[:, 5] * d[:, 1] + pose[:, 8] * d[:, 2])


def image(
    frame: Frame,
    pose: Array,
    calibration: Array,
    point: Array,
    *,
    observed: Array,
    lens: Lens,
    jacobians: bool = True,
) -> Linearised:
    """Compute v = computed − observed of image coordinates, (n, 2), image units.

    Args:
        frame: not used.
        pose: stored poses, (n, 12).
        calibration: parameters of the lens, (n, k).
        point: object points, (n, 3), metres.
        observed: measured coordinates, (n, 2).
        lens: the lens model.
        jacobians: whether to compute partials by the pose's tangent [ω, δX₀] (n, 2, 6), the
            calibration (n, 2, k) and the point (n, 2, 3).

    Raises:
        DegenerateError: a point lies in the focal plane. Points behind the camera are computed,
            because an iteration may pass there; `depth` finds such points.
    """
    _, centre = split_pose(pose)
    d = point - centre
    r = [[pose[:, 3 * i + j] for j in range(3)] for i in range(3)]
    px, py, pz = (d[:, 0] * r[0][j] + d[:, 1] * r[1][j] + d[:, 2] * r[2][j] for j in range(3))
    require(np.abs(pz) > 1e-12 * (np.abs(px) + np.abs(py) + np.abs(pz)), IN_FOCAL_PLANE)
    tx, ty = px / pz, -py / pz
    v, by_t, by_k = lens.residual(tx, ty, observed, calibration, jacobians=jacobians)
    if by_t is None or by_k is None:
        return Linearised(v, ())
    n = len(v)
    by_pose = np.empty((n, 2, 6))
    by_point = np.empty((n, 2, 3))
    iz = 1.0 / pz
    for row in range(2):
        # ∂v/∂p from ∂t/∂p = [[1/z, 0, −t_x/z], [0, −1/z, −t_y/z]]
        gx = by_t[:, row, 0] * iz
        gy = -by_t[:, row, 1] * iz
        gz = -(by_t[:, row, 0] * tx + by_t[:, row, 1] * ty) * iz
        by_pose[:, row, 0] = gy * pz - gz * py
        by_pose[:, row, 1] = gz * px - gx * pz
        by_pose[:, row, 2] = gx * py - gy * px
        for i in range(3):
            by_point[:, row, i] = gx * r[i][0] + gy * r[i][1] + gz * r[i][2]
    np.negative(by_point, out=by_pose[:, :, 3:])
    return Linearised(v, (by_pose, by_k, by_point))
