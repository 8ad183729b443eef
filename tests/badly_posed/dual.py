"""Numbers in extended precision that carry their derivatives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factorgraph_adj.types import Array

LONG = np.longdouble
"""Extended precision: 64 bits of mantissa on x86, three decimal digits more than float64."""
SERIES = 12
"""Number of terms of the series of sin x / x and (1 − cos x) / x², for x of at most a radian."""


@dataclass(frozen=True, eq=False)
class Dual:
    """Values and their derivatives by the unknowns."""

    value: Array
    """Values, (…,)."""
    slope: Array
    """Derivatives, (…, u)."""

    def __getitem__(self, at: object) -> Dual:
        """Return some of the values."""
        return Dual(self.value[at], self.slope[at])  # type: ignore[index]

    def __add__(self, other: Dual | Array | float) -> Dual:
        """Return a sum."""
        if isinstance(other, Dual):
            return Dual(self.value + other.value, self.slope + other.slope)
        return Dual(self.value + other, self.slope)

    def __sub__(self, other: Dual | Array | float) -> Dual:
        """Return a difference."""
        if isinstance(other, Dual):
            return Dual(self.value - other.value, self.slope - other.slope)
        return Dual(self.value - other, self.slope)

    def __mul__(self, other: Dual | Array | float) -> Dual:
        """Return a product."""
        if isinstance(other, Dual):
            slope = self.value[..., None] * other.slope + other.value[..., None] * self.slope
            return Dual(self.value * other.value, slope)
        factor = np.asarray(other, dtype=LONG)
        return Dual(self.value * factor, self.slope * factor[..., None])

    def __truediv__(self, other: Dual) -> Dual:
        """Return a quotient."""
        value = self.value / other.value
        slope = (self.slope - value[..., None] * other.slope) / other.value[..., None]
        return Dual(value, slope)

    def root(self) -> Dual:
        """Return √x."""
        value = np.sqrt(self.value)
        return Dual(value, self.slope / (2 * value[..., None]))

    def angle(self, other: Dual) -> Dual:
        """Return atan2(self, other)."""
        square = (self.value**2 + other.value**2)[..., None]
        slope = (other.value[..., None] * self.slope - self.value[..., None] * other.slope) / square
        return Dual(np.arctan2(self.value, other.value), slope)


def total(*parts: Dual) -> Dual:
    """Return a sum of several."""
    first, *others = parts
    for x in others:
        first = first + x
    return first


def stacked(parts: list[Dual]) -> Dual:
    """Return several of the same shape along a new last axis."""
    return Dual(np.stack([p.value for p in parts], -1), np.stack([p.slope for p in parts], -2))


def turned(rotation: Array, by: Dual) -> list[list[Dual]]:
    """Return the elements of R Exp(ω) by Rodrigues' formula, for ω of at most a radian.

    Args:
        rotation: R, (3, 3).
        by: ω, (3,).
    """
    w = [by[i] for i in range(3)]
    square = total(*(x * x for x in w))
    # sin x / x = Σ (−x²)ᵏ/(2k + 1)!, (1 − cos x) / x² = Σ (−x²)ᵏ/(2k + 2)!
    one = Dual(np.ones((), LONG), np.zeros_like(square.slope))
    sine = cosine = one * 0.0
    term = one
    for k in range(SERIES):
        sine = sine + term
        cosine = cosine + term * (LONG(1) / (2 * k + 2))
        term = term * square * (-LONG(1) / ((2 * k + 2) * (2 * k + 3)))
    none = one * 0.0
    cross = [[none, w[2] * -1.0, w[1]], [w[2], none, w[0] * -1.0], [w[1] * -1.0, w[0], none]]
    exp = []
    for i in range(3):
        row = []
        for j in range(3):
            twice = total(*(cross[i][k] * cross[k][j] for k in range(3)))
            row.append(cross[i][j] * sine + twice * cosine + (1.0 if i == j else 0.0))
        exp.append(row)
    r = np.asarray(rotation, dtype=LONG)
    return [[total(*(exp[k][j] * r[i, k] for k in range(3))) for j in range(3)] for i in range(3)]
