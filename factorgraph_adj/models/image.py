"""Collinearity equations (eq. 1): image coordinates, depths, image axes, lines in images.

With the pose world_T_camera in the axes of GTSAM (x right, y down, z forward),
p = Rᵀ (X − X₀), the tangents of the ray are t_x = p_x/p_z and t_y = −p_y/p_z. They equal
−q1/q3 and −q2/q3 in photogrammetric axes. A lens model takes tangents or the ray itself.

Axes other than those stated (`OTHER`) mirror the image. Each undoes itself, so that the same
function makes the mistake and puts it right.

The plane through the projection centre X₀ and a line with direction d through Z has in the axes of
the camera the normal n = Rᵀ (d × (Z − X₀)). A measured point has the ideal tangents t, from which
its ray is r = (t_x, −t_y, 1), and its distance from the imaged line is

    v = c nᵀr / √(n_x² + n_y²)        (image units)

in the plane of ideal coordinates. Lens models of rays have no such plane: r is then a unit vector
and v = c nᵀr/|n|, c times the sine of the angle to the plane of the line. σ is that of
ideal coordinates, even with lens models whose residuals of points are in measured ones.
(FRAMES F17.4; MMVII AdjLine3D.)
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..frames import Frame
from ..rotation import skew
from ..types import Array
from .base import Linearised, require
from .frame_axes import axis_of
from .inverse_lens import rays_and_partials
from .lens import Lens
from .positions import split_pose
from .rolling_shutter import MOTION, Readout, Turns

EXCHANGED = "x and y, exchanged,"
ALONG_X, ALONG_Y = "the direction of x", "the direction of y"
MIRRORED = "the axes, mirrored (x and y exchanged, or one the wrong way),"
OTHER: tuple[tuple[str, Axes], ...] = (
    (EXCHANGED, lambda xy, _: xy[:, ::-1]),
    (EXCHANGED, lambda xy, _: -xy[:, ::-1]),  # with rows that count down
    (ALONG_Y, lambda xy, _: xy * [1.0, -1.0]),
    (ALONG_Y, lambda xy, at: xy * [1.0, -1.0] + at * [0.0, 2.0]),  # counted from the other edge
    (ALONG_X, lambda xy, _: xy * [-1.0, 1.0]),
    (ALONG_X, lambda xy, at: xy * [-1.0, 1.0] + at * [2.0, 0.0]),
)
"""Causes, and what they make of coordinates that are right; each undoes itself."""
NO_IMAGE = (
    "the line has no image in the photo: it passes through the projection centre, or lies in the "
    "focal plane"
)


def depth(pose: Array, point: Array) -> Array:
    """Return the depth p_z of points (n, 3) in front of cameras (n, 12), metres, (n,)."""
    d = point - pose[:, 9:]
    return np.asarray(pose[:, 2] * d[:, 0] + pose[:, 5] * d[:, 1] + pose[:, 8] * d[:, 2])


def in_front(pose: Array, point: Array, lens: Lens) -> Array:
    """Return how far points (n, 3) lie on the side that a camera sees, metres, (n,).

    It is the depth for models of tangents, and the distance, which is never negative, for models
    of rays. Models of places see every point: it is infinite.
    """
    if lens.takes == "places":
        return np.full(len(point), np.inf)
    if lens.takes == "rays":
        return np.asarray(np.linalg.norm(point - pose[:, 9:], axis=1))
    return depth(pose, point)


def image(
    frame: Frame,
    pose: Array,
    calibration: Array,
    point: Array,
    motion: Array | None = None,
    *,
    observed: Array,
    lens: Lens,
    readout: Readout | None = None,
    jacobians: bool = True,
) -> Linearised:
    """Compute v = computed − observed of image coordinates, (n, 2), image units.

    Args:
        frame: not used.
        pose: stored poses, (n, 12).
        calibration: parameters of the lens, (n, k).
        point: object points, (n, 3), metres.
        motion: motions of the photos during the readout, (n, 6 d), see `rolling_shutter`.
        observed: measured coordinates, (n, 2).
        lens: the lens model.
        readout: times of the rows; None: the photos have no motion.
        jacobians: whether to compute partials by the pose's tangent [ω, δX₀] (n, 2, 6), the
            calibration (n, 2, k), the point (n, 2, 3) and the motion (n, 2, 6 d).

    Raises:
        DegenerateError: a point has no image: for models of tangents, it lies in the focal plane.
            Points behind the camera are computed, because an iteration may pass there; `in_front`
            finds such points.
    """
    _, centre = split_pose(pose)
    d = point - centre
    turns = None
    if motion is not None and readout is not None:
        turns, shift = Turns.of(motion, readout.times(observed[:, 0], observed[:, 1]))
        d = d - shift
    r = [[pose[:, 3 * i + j] for j in range(3)] for i in range(3)]
    qx, qy, qz = (d[:, 0] * r[0][j] + d[:, 1] * r[1][j] + d[:, 2] * r[2][j] for j in range(3))
    p = q = qx, qy, qz
    if turns is not None:
        p = components(turns.to_camera(np.stack(q)))
    found = lens.seen(p, observed[:, 0], observed[:, 1], calibration, jacobians=jacobians)
    v = np.stack(found.v, 1)
    if not jacobians:
        return Linearised(v, ())
    n = len(v)
    by_pose = np.empty((n, 2, 6))
    by_point = np.empty((n, 2, 3))
    by_k = np.empty((n, 2, len(found.by_k)))
    by_first = np.empty((n, 2, MOTION))
    for row in range(2):
        gx, gy, gz = (g[row] for g in found.by_p)
        if turns is not None:
            by_first[:, row, 3:] = turns.by_vector(np.stack(by_rotation(p, (gx, gy, gz)))).T
            gx, gy, gz = components(turns.to_middle(np.stack([gx, gy, gz])))
        for i, turned in enumerate(by_rotation(q, (gx, gy, gz))):
            by_pose[:, row, i] = turned
            by_point[:, row, i] = gx * r[i][0] + gy * r[i][1] + gz * r[i][2]
        for j, pair in enumerate(found.by_k):
            by_k[:, row, j] = pair[row]
    np.negative(by_point, out=by_pose[:, :, 3:])
    if turns is None:
        return Linearised(v, (by_pose, by_k, by_point))
    by_first[:, :, :3] = by_pose[:, :, 3:]
    by_motion = np.concatenate([t[:, None, None] * by_first for t in turns.powers], axis=2)
    return Linearised(v, (by_pose, by_k, by_point, by_motion))


def components(vectors: Array) -> tuple[Array, Array, Array]:
    """Return the three components (n,) of vectors (3, n)."""
    return vectors[0], vectors[1], vectors[2]


def by_rotation(p: tuple[Array, Array, Array], g: tuple[Array, Array, Array]) -> tuple[Array, ...]:
    """Return ∂v/∂ω = g × p of one component of v, for a rotation ω about the axes of the camera."""
    px, py, pz = p
    gx, gy, gz = g
    return gy * pz - gz * py, gz * px - gx * pz, gx * py - gy * px


Axes = Callable[[Array, Array], Array]
"""Coordinates with other axes, from coordinates (n, 2) and the principal point (2,)."""


def image_line(
    frame: Frame,
    pose: Array,
    calibration: Array,
    stored: Array,
    origin: Array | None,
    vertical: Array | None,
    motion: Array | None = None,
    *,
    observed: Array,
    x: Array,
    y: Array,
    lens: Lens,
    readout: Readout | None = None,
) -> Linearised:
    """Compute the distance of measured points from imaged lines − observed, image units, (n, 1).

    Args:
        frame: frame of the network.
        pose: stored poses, (n, 12).
        calibration: parameters of the lens, (n, k).
        stored: frames of the lines, (n, 17).
        origin: O where it is a point, (n, 3).
        vertical: deflections there, (n, 2).
        motion: motions of the photos during the readout, (n, 6 d); none: they stand still.
        observed: distances, (n, 1).
        x: measured coordinates x, (n,).
        y: measured coordinates y, (n,).
        lens: the lens model.
        readout: times of the rows; None: all are exposed at the same time.
    """
    rotation, centre = split_pose(pose)
    turns = None
    if motion is not None and readout is not None:
        turns, shift = Turns.of(motion, readout.times(x, y))
        rotation, centre = rotation @ turns.matrix, centre + shift
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
    g = by_n[:, None]
    by_pose, by_motion = (
        g @ np.concatenate([skew(n), -by_zero], axis=2),
        np.zeros((len(n), 1, MOTION if motion is None else motion.shape[1])),
    )
    if turns is not None:
        by_pose, by_motion = turns.of_moved_pose(by_pose)
    parts = [by_pose, by_k[:, None], g @ by_line[0]]
    given = (origin, vertical)
    parts += [g @ j for j, value in zip(by_line[1:], given, strict=True) if value is not None]
    if motion is not None:
        parts.append(by_motion)
    return Linearised(f[:, None] - observed, tuple(parts))
