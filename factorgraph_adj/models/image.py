"""Image coordinates: the collinearity equations with a lens model (eq. 1).

With the pose world_T_camera in the axes of GTSAM (x right, y down, z forward),
p = Rᵀ (X − X₀), the tangents of the ray are t_x = p_x/p_z and t_y = −p_y/p_z. They equal
−q1/q3 and −q2/q3 in photogrammetric axes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, require
from .lens import Lens, Pair
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
    p = px, py, pz
    found = seen(p, observed[:, 0], observed[:, 1], calibration, lens, jacobians=jacobians)
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


class Seen(NamedTuple):
    """Image coordinates of rays p = Rᵀ (X − X₀), one array for each component."""

    v: tuple[Array, Array]
    """v_x and v_y, (n,) each, image units."""
    by_p: tuple[tuple[Array, Array], ...]
    """g = ∂v/∂p_x, ∂v/∂p_y and ∂v/∂p_z, each of v_x and v_y; empty if not requested."""
    by_k: tuple[Pair, ...]
    """∂v/∂K of each calibration parameter; empty if not requested."""


def seen(
    p: tuple[Array, Array, Array],
    x: Array,
    y: Array,
    calibration: Array,
    lens: Lens,
    *,
    jacobians: bool = True,
) -> Seen:
    """Compute v and its partials by the ray in the axes of the camera and by the calibration.

    Args:
        p: components of the rays in the axes of the camera, (n,) each, metres.
        x: measured coordinates x, (n,).
        y: measured coordinates y, (n,).
        calibration: parameters of the lens, (n, k) or (1, k).
        lens: the lens model.
        jacobians: whether to compute the partials.

    Raises:
        DegenerateError: as `image`.
    """
    px, py, pz = p
    require(np.abs(pz) > 1e-12 * (np.abs(px) + np.abs(py) + np.abs(pz)), IN_FOCAL_PLANE)
    iz = 1.0 / pz
    tx, ty = px * iz, -py * iz
    v, by_t, by_k = lens.partials(tx, ty, x, y, calibration, jacobians=jacobians)
    if not jacobians:
        return Seen(v, (), ())
    # ∂v/∂p from ∂t/∂p = [[1/z, 0, −t_x/z], [0, −1/z, −t_y/z]]
    (xx, yx), (xy, yy) = by_t
    by_x, by_y = (xx * iz, yx * iz), (-xy * iz, -yy * iz)
    by_z = tuple(by_y[row] * ty - by_x[row] * tx for row in range(2))
    return Seen(v, (by_x, by_y, (by_z[0], by_z[1])), by_k)


def by_rotation(p: tuple[Array, Array, Array], g: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    """Return ∂v/∂ω = p × g of one component of v, for a rotation ω about the axes of the camera."""
    px, py, pz = p
    gx, gy, gz = g
    return gy * pz - gz * py, gz * px - gx * pz, gx * py - gy * px
