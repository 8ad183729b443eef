"""Leverages of the rays to points that only cameras see, chunk by chunk.

With U = L⁻¹JₚᵀJₚ's rows and M = W Σ of the point (`ReducedPoints.joint`),

    Q_p Aᵀ = L⁻ᵀ (K U − Z),   H = A_c Σ A_cᵀ − UᵀZ − ZᵀU + UᵀK U,   K = I + W Σ Wᵀ,   Z = M A_cᵀ.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ..types import Array, Index
from .fronts import BlockMatrix
from .linear_rays import OF_POINT
from .point_cholesky import PointCholesky
from .rays import RayPart
from .reduction import RayCovariances, ReducedPoints


class RayLeverage(NamedTuple):
    """Leverages of the rays of one part."""

    place: int
    """Place of the block in the network."""
    rows: Index | slice
    """Numbers of the rays in the block."""
    hat: Array
    """H = A Q Aᵀ, (m, 2, 2)."""
    others: Array
    """A_c Σ A_cᵀ, the part of all unknowns but the points, (m, 2, 2)."""
    own: Array
    """Q_p Aᵀ for the coordinates of the point, (m, 3, 2)."""


def ray_leverages(
    points: ReducedPoints, joint: RayCovariances, inverse: BlockMatrix
) -> Iterator[RayLeverage]:
    """Iterate over the leverages of the rays of every part.

    Args:
        points: the first layer.
        joint: its joint covariances with the cameras.
        inverse: covariances of the cameras.
    """
    rays, system = points.rays, points.system
    for part in rays.photo_parts:
        a = part.partials(system)
        m = a.shape[2]
        width = 6 if part.camera >= 0 else len(a)
        of_rays = np.ascontiguousarray(joint.rays[part.rows].transpose(1, 2, 0))
        z = np.empty((3, 2, m))
        for axis in range(3):
            np.einsum("km,krm->rm", of_rays[axis, :width], a[:width], out=z[axis])
        side = slice(0, 0)
        if part.camera >= 0:
            side = rays.cameras[part.camera].side
            of_points = np.take(joint.shared[:, :, side], part.points, axis=0)
            for axis in range(3):
                z[axis] += np.einsum("mk,krm->rm", of_points[:, axis], a[6:])
        others = _others(part, a, inverse, width, side)
        u = points.cholesky.lower(-a[OF_POINT], part.points)
        k = np.take(joint.inner, part.points, axis=1)
        ku = np.stack(
            [
                k[0] * u[0] + k[1] * u[1] + k[2] * u[2],
                k[1] * u[0] + k[3] * u[1] + k[4] * u[2],
                k[2] * u[0] + k[4] * u[1] + k[5] * u[2],
            ]
        )
        ku -= z
        hat = others.copy()
        for i in range(2):
            for j in range(2):
                value = u[:, i] * ku[:, j] - z[:, i] * u[:, j]
                hat[:, i, j] += value[0] + value[1] + value[2]
        own = points.cholesky.upper(ku, part.points)
        yield RayLeverage(part.place, part.in_block, hat, others, own.transpose(2, 0, 1))


def _others(part: RayPart, a: Array, inverse: BlockMatrix, width: int, side: slice) -> Array:
    """Return A_c Σ A_cᵀ of the rays of a part, (m, 2, 2)."""
    out = np.empty((a.shape[2], 2, 2))
    size = side.stop - side.start
    sigma = np.empty((width + size,) * 2)
    sigma[width:, width:] = inverse.corner[side, side]
    for node, start, stop in part.runs:
        sigma[:width, :width] = inverse.diagonal[node, :width, :width]
        sigma[:width, width:] = inverse.side[node, :width, side]
        sigma[width:, :width] = sigma[:width, width:].T
        x, y = a[: width + size, 0, start:stop], a[: width + size, 1, start:stop]
        sx, sy = sigma @ x, sigma @ y
        out[start:stop, 0, 0] = np.einsum("km,km->m", x, sx)
        out[start:stop, 1, 0] = out[start:stop, 0, 1] = np.einsum("km,km->m", x, sy)
        out[start:stop, 1, 1] = np.einsum("km,km->m", y, sy)
    return out


def point_hats(
    points: ReducedPoints, alone: PointCholesky
) -> Iterator[tuple[int, Index | slice, Array]]:
    """Iterate over place of the block, rows and JₚN⁻¹Jₚᵀ (m, 2, 2) of the rays of every part.

    Args:
        points: the first layer.
        alone: factors of the normal matrices N of the points.
    """
    for part in points.rays.photo_parts:
        u = alone.lower(part.partials(points.system)[OF_POINT], part.points)
        hat = np.empty((u.shape[2], 2, 2))
        for i in range(2):
            for j in range(i, 2):
                hat[:, i, j] = hat[:, j, i] = np.einsum("km,km->m", u[:, i], u[:, j])
        yield part.place, part.in_block, hat
