"""The 3 × 3 normal matrices of object points that only cameras see, and their factors."""

from __future__ import annotations

import numpy as np

from ..types import Array, Index
from .linear import LinearSystem
from .rays import Rays


def point_blocks(rays: Rays, system: LinearSystem, j: Array, extra: Array) -> Array:
    """Return the 3 × 3 normal matrices of the points as (6, p): xx xy xz yy yz zz."""
    plan = rays.plan
    n = rays.n_points
    out = np.empty((6, n))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    for row, (a, b) in enumerate(pairs):
        product = j[:, 0, a] * j[:, 0, b] + j[:, 1, a] * j[:, 1, b]
        out[row] = np.bincount(rays.point, weights=product, minlength=n)
    local = np.cumsum(plan.reduced) - 1
    for place in rays.coordinate_places:
        lb = system.blocks[place]
        if not len(lb.a[0]):
            continue
        number = lb.block.variables[0][1]
        on = np.flatnonzero(plan.reduced[number])
        for row, (a, b) in enumerate(pairs):
            product = np.sum(lb.a[0][on, :, a] * lb.a[0][on, :, b], axis=1)
            out[row] += np.bincount(local[number[on]], weights=product, minlength=n)
    columns = plan.point_columns
    for row, axis in ((0, 0), (3, 1), (5, 2)):
        out[row] += extra[columns[:, axis]]
    return out


class PointCholesky:
    """H = L Lᵀ of the 3 × 3 normal matrices of points, all at once."""

    def __init__(self, h: Array) -> None:
        """Factorise H given as (6, p): xx xy xz yy yz zz.

        ``pivots`` (p, 3) are what is left of each diagonal, relative.
        """
        xx, xy, xz, yy, yz, zz = h
        tiny = np.finfo(float).tiny
        l11 = np.sqrt(np.maximum(xx, tiny))
        l21, l31 = xy / l11, xz / l11
        left22 = yy - l21**2
        l22 = np.sqrt(np.maximum(left22, np.maximum(yy * 1e-16, tiny)))
        l32 = (yz - l31 * l21) / l22
        left33 = zz - l31**2 - l32**2
        l33 = np.sqrt(np.maximum(left33, np.maximum(zz * 1e-16, tiny)))
        self.l = (l11, l21, l31, l22, l32, l33)
        with np.errstate(invalid="ignore", divide="ignore"):
            self.pivots = np.stack([(xx > 0) * 1.0, left22 / yy, left33 / zz], 1)
        np.nan_to_num(self.pivots, copy=False, nan=0.0)

    def lower(self, b: Array, at: Index | None = None) -> Array:
        """Return L⁻¹ b for b (m, 3, k); ``at`` gives the point of each row."""
        l11, l21, l31, l22, l32, l33 = ((x if at is None else x[at])[:, None] for x in self.l)
        out = np.empty_like(b)
        np.divide(b[:, 0], l11, out=out[:, 0])
        out[:, 1] = (b[:, 1] - l21 * out[:, 0]) / l22
        out[:, 2] = (b[:, 2] - l31 * out[:, 0] - l32 * out[:, 1]) / l33
        return out

    def upper(self, b: Array, at: Index | None = None) -> Array:
        """Return L⁻ᵀ b for b (m, 3, k); ``at`` gives the point of each row."""
        l11, l21, l31, l22, l32, l33 = ((x if at is None else x[at])[:, None] for x in self.l)
        out = np.empty_like(b)
        out[:, 2] = b[:, 2] / l33
        out[:, 1] = (b[:, 1] - l32 * out[:, 2]) / l22
        out[:, 0] = (b[:, 0] - l21 * out[:, 1] - l31 * out[:, 2]) / l11
        return out
