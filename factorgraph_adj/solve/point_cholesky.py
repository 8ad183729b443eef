"""The factors of the 3 × 3 normal matrices of object points, all at once.

Arrays have one contiguous row for each component: x y z of vectors, xx xy xz yy yz zz of symmetric
matrices.
"""

from __future__ import annotations

import numpy as np

from ..types import Array, Index

ELEMENTS = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Rows and columns of the elements of a symmetric matrix, in the order of its array."""
DIAGONAL = (0, 3, 5)
"""Places of the elements on the diagonal."""


class PointCholesky:
    """H = L Lᵀ of the normal matrices H of points."""

    def __init__(self, h: Array, free: Array) -> None:
        """Factorise.

        Args:
            h: the normal matrices, (6, p).
            free: one for each free component, zero for held ones, (3, p). Held components take no
                part: their pivot is one, and what is solved for them is zero.
        """
        tiny = np.finfo(float).tiny
        fx, fy, fz = free
        xx, yy, zz = h[0], h[3], h[5]
        xy, xz, yz = h[1] * (fx * fy), h[2] * (fx * fz), h[4] * (fy * fz)
        l11 = np.sqrt(np.maximum(xx, tiny))
        l21, l31 = xy / l11, xz / l11
        left22 = yy - l21**2
        l22 = np.sqrt(np.maximum(left22, np.maximum(yy * 1e-16, tiny)))
        l32 = (yz - l31 * l21) / l22
        left33 = zz - l31**2 - l32**2
        l33 = np.sqrt(np.maximum(left33, np.maximum(zz * 1e-16, tiny)))
        self.l = np.stack([fx / l11, l21, l31, fy / l22, l32, fz / l33])
        """1/l11, l21, l31, 1/l22, l32, 1/l33, (6, p); zero for held components."""
        with np.errstate(invalid="ignore", divide="ignore"):
            pivots = np.stack([(xx > 0) * 1.0, left22 / yy, left33 / zz])
        np.nan_to_num(pivots, copy=False, nan=0.0)
        self.pivots = np.where(free > 0, pivots, 1.0)
        self._largest = np.maximum(np.stack([xx, yy, zz]), tiny)
        """Pivots relative to the diagonal of H, (3, p); one for held components."""

    def refine(self, second: PointCholesky, points: Index) -> None:
        """Multiply the factors L of some points by the factors of L⁻¹ H L⁻ᵀ."""
        i11, l21, l31, i22, l32, i33 = self.l[:, points]
        j11, m21, m31, j22, m32, j33 = second.l
        with np.errstate(divide="ignore"):
            l22, l33 = _reciprocal(i22), _reciprocal(i33)
            m11, m22 = _reciprocal(j11), _reciprocal(j22)
        self.l[:, points] = (
            i11 * j11,
            l21 * m11 + l22 * m21,
            l31 * m11 + l32 * m21 + l33 * m31,
            i22 * j22,
            l32 * m22 + l33 * m32,
            i33 * j33,
        )
        roots = np.stack([i11, i22, i33])  # zero for held components
        left = second.pivots * second._largest * _reciprocal(roots) ** 2
        self.pivots[:, points] = np.where(roots > 0, left / self._largest[:, points], 1.0)

    def lower(self, b: Array, at: Index | None = None) -> Array:
        """Return L⁻¹ b for b (3, …, m); ``at`` gives the point of each column."""
        e = self.l if at is None else np.take(self.l, at, axis=1)
        out = np.empty_like(b)
        np.multiply(b[0], e[0], out=out[0])
        np.multiply(out[0], e[1], out=out[1])
        np.subtract(b[1], out[1], out=out[1])
        out[1] *= e[3]
        np.multiply(out[0], e[2], out=out[2])
        np.subtract(b[2], out[2], out=out[2])
        out[2] -= out[1] * e[4]
        out[2] *= e[5]
        return out

    def upper(self, b: Array, at: Index | None = None) -> Array:
        """Return L⁻ᵀ b for b (3, …, m); ``at`` gives the point of each column."""
        e = self.l if at is None else np.take(self.l, at, axis=1)
        out = np.empty_like(b)
        np.multiply(b[2], e[5], out=out[2])
        np.multiply(out[2], e[4], out=out[1])
        np.subtract(b[1], out[1], out=out[1])
        out[1] *= e[3]
        np.multiply(out[1], e[1], out=out[0])
        np.subtract(b[0], out[0], out=out[0])
        out[0] -= out[2] * e[2]
        out[0] *= e[0]
        return out

    def covariances(self, inner: Array) -> Array:
        """Return L⁻ᵀ K L⁻¹ (6, p) of all points for K (6, p)."""
        whole = np.empty((3, 3, inner.shape[1]))
        for (i, j), value in zip(ELEMENTS, inner, strict=True):
            whole[i, j] = whole[j, i] = value
        out = self.upper(self.upper(whole).transpose(1, 0, 2))
        return np.stack([out[i, j] for i, j in ELEMENTS])


def _reciprocal(x: Array) -> Array:
    """Return 1/x; zero where x is zero."""
    return np.where(x != 0.0, 1.0 / np.where(x != 0.0, x, 1.0), 0.0)


def square(elements: Array) -> Array:
    """Return symmetric matrices (p, 3, 3) from their elements (6, p)."""
    out = np.empty((elements.shape[1], 3, 3))
    for (i, j), value in zip(ELEMENTS, elements, strict=True):
        out[:, i, j] = out[:, j, i] = value
    return out
