"""The 3 × 3 normal matrices of object points that only cameras see, and their factors."""

from __future__ import annotations

import numpy as np

from ..types import Array, Index
from .linear import LinearSystem
from .rays import Rays

POOR = 1e-6
"""Relative pivot below which a point is factorised twice; a point at a distance of 1000 bases has
this pivot."""


def factorise_points(rays: Rays, system: LinearSystem, j: Array, extra: Array) -> PointCholesky:
    """Factorise the 3 × 3 normal matrices H = AᵀA of the points.

    H has the square of the condition of A: a point at a distance of 10⁵ bases keeps 6 digits.
    Where pivots are poor the rows are factorised again, in the axes of the first factor
    (Cholesky-QR, Yamamoto et al. 2015): A L⁻ᵀ is nearly orthogonal,
    AᵀA = L (L⁻¹AᵀA L⁻ᵀ) Lᵀ = L L' (L L')ᵀ.

    Args:
        rays: the index lists.
        system: the linearised network.
        j: whitened partials of the rays by their points, (m, 2, 3).
        extra: added to the diagonal of the normal matrix, (n_columns,).
    """
    cholesky = PointCholesky(point_blocks(rays, system, j, extra))
    worst = cholesky.pivots.min(axis=1)  # zero where a component is held
    poor = np.flatnonzero((worst > 0) & (worst < POOR))
    if len(poor):
        again = point_blocks(rays, system, j, extra, axes=cholesky)
        cholesky.refine(PointCholesky(again[:, poor]), poor)
    return cholesky


def point_blocks(
    rays: Rays,
    system: LinearSystem,
    j: Array,
    extra: Array,
    *,
    axes: PointCholesky | None = None,
) -> Array:
    """Return the 3 × 3 normal matrices of the points as (6, p): xx xy xz yy yz zz.

    Args:
        rays: the index lists.
        system: the linearised network.
        j: whitened partials of the rays by their points, (m, 2, 3).
        extra: added to the diagonal of the normal matrix, (n_columns,).
        axes: factors L of all points; with them L⁻¹ H L⁻ᵀ is returned, summed from the rows A L⁻ᵀ.
    """
    layers = rays.layers
    n = rays.n_points
    out = np.empty((6, n))
    pairs = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
    if axes is not None:
        j = axes.lower(np.ascontiguousarray(j.transpose(0, 2, 1)), rays.point).transpose(0, 2, 1)
    for row, (a, b) in enumerate(pairs):
        product = j[:, 0, a] * j[:, 0, b] + j[:, 1, a] * j[:, 1, b]
        out[row] = np.bincount(rays.point, weights=product, minlength=n)
    local = np.cumsum(layers.reduced) - 1
    for place in rays.coordinate_places:
        lb = system.blocks[place]
        if not len(lb.a[0]):
            continue
        number = lb.block.variables[0][1]
        on = np.flatnonzero(layers.reduced[number])
        partials, point = lb.a[0][on], local[number[on]]
        if axes is not None:
            partials = np.ascontiguousarray(partials.transpose(0, 2, 1))
            partials = axes.lower(partials, point).transpose(0, 2, 1)
        for row, (a, b) in enumerate(pairs):
            product = np.sum(partials[:, :, a] * partials[:, :, b], axis=1)
            out[row] += np.bincount(point, weights=product, minlength=n)
    diagonal = extra[layers.point_columns]
    if axes is None:
        for row, axis in ((0, 0), (3, 1), (5, 2)):
            out[row] += diagonal[:, axis]
    elif diagonal.any():
        added = axes.lower(np.sqrt(diagonal)[:, :, None] * np.eye(3))
        for row, (a, b) in enumerate(pairs):
            out[row] += np.sum(added[:, a] * added[:, b], axis=1)
    return out


class PointCholesky:
    """H = L Lᵀ of the 3 × 3 normal matrices of points, all at once."""

    def __init__(self, h: Array) -> None:
        """Factorise H given as (6, p): xx xy xz yy yz zz.

        ``pivots`` (p, 3) are the pivots relative to their diagonal elements of H.
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

    def refine(self, second: PointCholesky, points: Index) -> None:
        """Multiply the factors L of some points by the factors of L⁻¹ H L⁻ᵀ."""
        l11, l21, l31, l22, l32, l33 = (x[points] for x in self.l)
        m11, m21, m31, m22, m32, m33 = second.l
        found = (
            l11 * m11,
            l21 * m11 + l22 * m21,
            l31 * m11 + l32 * m21 + l33 * m31,
            l22 * m22,
            l32 * m22 + l33 * m32,
            l33 * m33,
        )
        for own, new in zip(self.l, found, strict=True):
            own[points] = new

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
