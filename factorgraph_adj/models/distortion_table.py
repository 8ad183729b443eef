"""Distortion of a lens as the table of its calibration certificate: radial and tangential.

At the distance ρ from the principal point and the direction φ, anticlockwise from x, the image lies
at ρ + R(ρ, φ) and S(ρ, φ) across, anticlockwise:

    (dx, dy) = R (cos φ, sin φ) + S (−sin φ, cos φ)

R and S are natural cubic splines, or straight lines, between the radii of the table, zero at the
principal point, and beyond the last radius as there. A table that has several directions, such as
the four half diagonals, is linear in φ between them. (FRAMES F15.5.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..types import Array, Index

NEAR = 1e-9
"""Distance from the principal point, in the unit of the table, below which the direction of a
point has no meaning; R and S are proportional to the distance there."""


@dataclass(frozen=True, eq=False)
class DistortionTable:
    """Splines of a table of distortions."""

    radii: Array
    """Ideal distances from the principal point, increasing from zero, (n,)."""
    values: Array
    """R and S in each direction at the radii, (directions, 2, n)."""
    curvatures: Array
    """Second derivatives of R and S there; zero for straight lines, (directions, 2, n)."""
    directions: Array
    """Directions φ, increasing, radians, (directions,)."""

    @classmethod
    def of(cls, radii: Array, values: Array, directions: Array, *, spline: bool) -> DistortionTable:
        """Return the table through given values; zero is added at the principal point.

        Args:
            radii: ideal distances from the principal point, increasing, (n,).
            values: R and S at the radii, (directions, 2, n).
            directions: directions, increasing, radians.
            spline: whether values between the radii are those of natural cubic splines.
        """
        if radii[0] > 0.0:
            radii = np.append(0.0, radii)
            values = np.concatenate([np.zeros((*values.shape[:2], 1)), values], axis=2)
        curvatures = natural_curvatures(radii, values) if spline else np.zeros_like(values)
        return cls(radii, values, curvatures, directions)

    def displacements(self, x: Array, y: Array) -> tuple[Array, Array, tuple[Array, ...]]:
        """Return dx and dy at places (n,), and ∂dx/∂x, ∂dx/∂y, ∂dy/∂x, ∂dy/∂y."""
        rho = np.maximum(np.hypot(x, y), NEAR)
        angle = np.arctan2(y, x)
        cos, sin = np.cos(angle), np.sin(angle)
        value, by_rho, by_angle = self._at(rho, angle)
        (r, s), (r1, s1), (r2, s2) = value, by_rho, by_angle
        dx, dy = r * cos - s * sin, r * sin + s * cos
        # along and across the radius: ∂/∂ρ and ∂/(ρ ∂φ)
        along = r1 * cos - s1 * sin, r1 * sin + s1 * cos
        across = (
            (r2 * cos - s2 * sin - r * sin - s * cos) / rho,
            (r2 * sin + s2 * cos + r * cos - s * sin) / rho,
        )
        partials = (
            along[0] * cos - across[0] * sin,
            along[0] * sin + across[0] * cos,
            along[1] * cos - across[1] * sin,
            along[1] * sin + across[1] * cos,
        )
        return dx, dy, partials

    def _at(self, rho: Array, angle: Array) -> tuple[Array, Array, Array]:
        """Return R and S at distances and directions (n,), and partials by ρ and φ, (2, n)."""
        first = self.along(np.zeros(len(rho), dtype=np.intp), rho)
        count = len(self.directions)
        if count == 1:
            return *first, np.zeros_like(first[0])
        begin = self.directions[0]
        turned = (angle - begin) % (2 * np.pi)
        ends = np.append(self.directions - begin, 2 * np.pi)
        i = np.clip(np.searchsorted(ends, turned, side="right") - 1, 0, count - 1)
        width = ends[i + 1] - ends[i]
        share = (turned - ends[i]) / width
        (a, a1), (b, b1) = self.along(i, rho), self.along((i + 1) % count, rho)
        return a + share * (b - a), a1 + share * (b1 - a1), (b - a) / width

    def along(self, direction: Index, rho: Array) -> tuple[Array, Array]:
        """Return R and S in given directions at distances (n,), and their partials by ρ, (2, n)."""
        inside = np.minimum(rho, self.radii[-1])
        i = np.clip(np.searchsorted(self.radii, inside, side="right") - 1, 0, len(self.radii) - 2)
        h = self.radii[i + 1] - self.radii[i]
        b = (inside - self.radii[i]) / h
        a = 1.0 - b
        low, high = self.values[direction, :, i].T, self.values[direction, :, i + 1].T
        m, n = self.curvatures[direction, :, i].T, self.curvatures[direction, :, i + 1].T
        value = a * low + b * high + ((a**3 - a) * m + (b**3 - b) * n) * h**2 / 6.0
        slope = (high - low) / h + ((1.0 - 3.0 * a**2) * m + (3.0 * b**2 - 1.0) * n) * h / 6.0
        return value, np.where(rho < self.radii[-1], slope, 0.0)


def natural_curvatures(radii: Array, values: Array) -> Array:
    """Return the second derivatives of natural cubic splines at their nodes, (…, n)."""
    n = len(radii)
    out = np.zeros_like(values)
    if n < 3:
        return out
    h = np.diff(radii)
    matrix = np.diag(2.0 * (h[:-1] + h[1:])) + np.diag(h[1:-1], 1) + np.diag(h[1:-1], -1)
    slopes = np.diff(values, axis=-1) / h
    out[..., 1:-1] = np.linalg.solve(matrix, 6.0 * np.diff(slopes, axis=-1)[..., None])[..., 0]
    return out
