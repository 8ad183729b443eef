"""Rational lens model in normalised coordinates: OpenCV's with eight coefficients, and affinity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..types import Array
from .lens import ForwardLens


@dataclass(frozen=True)
class RationalLens(ForwardLens):
    """Radial quotient and decentring of tangents, with affinity, ideal → measured.

    With r² = t_x² + t_y² and g = (1 + k1 r² + k2 r⁴ + k3 r⁶)/(1 + k4 r² + k5 r⁴ + k6 r⁶):

        D_x = t_x g + p1 (r² + 2 t_x²) + 2 p2 t_x t_y
        D_y = t_y g + p2 (r² + 2 t_y²) + 2 p1 t_x t_y
        x = x0 + c ((1 + b1) D_x + b2 D_y),  y = y0 + c D_y

    so that f_x = c (1 + b1) and f_y = c. All parameters but c, x0, y0 are dimensionless. Since y
    points up, OpenCV's p1 is −p2 here and its p2 is p1. It is `NormalisedLens` where k4 … b2 are 0.
    """

    kind: ClassVar[str] = "rational"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        own = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "b1", "b2")
        return ("c", "x0", "y0", *own)

    def _correction(
        self, x: Array, y: Array, k: Array, partials: bool
    ) -> tuple[Array, Array, tuple[Array, ...], list[tuple[Array, Array]]]:
        k1, k2, k3, k4, k5, k6, p1, p2, b1, b2 = (k[:, j] for j in range(3, 13))
        xx, yy, xy2 = x * x, y * y, 2.0 * x * y
        r2 = xx + yy
        below = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        g = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) * below
        tx, ty = r2 + 2.0 * xx, r2 + 2.0 * yy
        u, w = x * g + p1 * tx + p2 * xy2, y * g + p2 * ty + p1 * xy2
        stretch = 1.0 + b1
        dx, dy = stretch * u + b2 * w - x, w - y
        if not partials:
            return dx, dy, (), []
        rise = (k1 + r2 * (2.0 * k2 + 3.0 * k3 * r2)) - g * (k4 + r2 * (2.0 * k5 + 3.0 * k6 * r2))
        slope = 2.0 * rise * below
        cross = 0.5 * xy2 * slope + 2.0 * (p1 * y + p2 * x)
        uxx = g + xx * slope + 6.0 * p1 * x + 2.0 * p2 * y
        wyy = g + yy * slope + 6.0 * p2 * y + 2.0 * p1 * x
        d = (stretch * uxx + b2 * cross - 1.0, stretch * cross + b2 * wyy, cross, wyy - 1.0)
        powers = [r2 * below]
        powers += [powers[0] * r2]
        powers += [powers[1] * r2]
        powers += [-g * power for power in powers]
        columns = [(x * power, y * power) for power in powers]
        columns += [(tx, xy2), (xy2, ty)]
        columns = [(stretch * a + b2 * b, b) for a, b in columns]
        zero = 0.0 * w
        return dx, dy, d, [*columns, (u, zero), (w, zero)]

    def _unit(self, c: Array) -> Array:
        return c

    def _by_c(
        self, tx: Array, ty: Array, by_a: tuple[Array, ...], dx: Array, dy: Array
    ) -> tuple[Array, Array]:
        return tx + dx, ty + dy
