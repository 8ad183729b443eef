"""Image coordinates: the collinearity equations with a lens model (eq. 1).

With the pose world_T_camera in the axes of GTSAM (x right, y down, z forward),
p = Rᵀ (X − X₀), the tangents of the ray are t_x = p_x/p_z and t_y = −p_y/p_z. They equal
−q1/q3 and −q2/q3 in photogrammetric axes. A lens model takes tangents or the ray itself.
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised
from .lens import Lens
from .position import split_pose


def depth(pose: Array, point: Array) -> Array:
    """Return the depth p_z of points (n, 3) in front of cameras (n, 12), metres, (n,)."""
    d = point - pose[:, 9:]
    return np.asarray(pose[:, 2] * d[:, 0] + pose[:, 5] * d[:, 1] + pose[:, 8] * d[:, 2])


def in_front(pose: Array, point: Array, lens: Lens) -> Array:
    """Return how far points (n, 3) lie on the side that a camera sees, metres, (n,).

    It is the depth for models of tangents, and the distance, which is never negative, for models
    of rays.
    """
    if lens.takes == "rays":
        return np.asarray(np.linalg.norm(point - pose[:, 9:], axis=1))
    return depth(pose, point)


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
        DegenerateError: a point has no image: for models of tangents, it lies in the focal plane.
            Points behind the camera are computed, because an iteration may pass there; `in_front`
            finds such points.
    """
    _, centre = split_pose(pose)
    d = point - centre
    r = [[pose[:, 3 * i + j] for j in range(3)] for i in range(3)]
    px, py, pz = (d[:, 0] * r[0][j] + d[:, 1] * r[1][j] + d[:, 2] * r[2][j] for j in range(3))
    p = px, py, pz
    found = lens.seen(p, observed[:, 0], observed[:, 1], calibration, jacobians=jacobians)
    v = np.stack(found.v, 1)
    if not jacobians:
        return Linearised(v, ())
    n = len(v)
    by_pose = np.empty((n, 2, 6))
    by_point = np.empty((n, 2, 3))
    by_k = np.empty((n, 2, len(found.by_k)))
    for row in range(2):
        gx, gy, gz = (g[row] for g in found.by_p)
        for i, turned in enumerate(by_rotation(p, (gx, gy, gz))):
            by_pose[:, row, i] = turned
            by_point[:, row, i] = gx * r[i][0] + gy * r[i][1] + gz * r[i][2]
        for j, pair in enumerate(found.by_k):
            by_k[:, row, j] = pair[row]
    np.negative(by_point, out=by_pose[:, :, 3:])
    return Linearised(v, (by_pose, by_k, by_point))


def by_rotation(p: tuple[Array, Array, Array], g: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    """Return ∂v/∂ω = p × g of one component of v, for a rotation ω about the axes of the camera."""
    px, py, pz = p
    gx, gy, gz = g
    return gy * pz - gz * py, gz * px - gx * pz, gx * py - gy * px
