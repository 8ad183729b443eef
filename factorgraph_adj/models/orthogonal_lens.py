"""Orthogonal polynomials as additional parameters of aerial blocks: Ebner's 12, Grün's 44.

A vertical photo of flat ground, with image points on a square grid of m + 1 by m + 1 places
from −b to b, determines (m + 1)² corrections in x and (m + 1)² in y. Six combinations of these
corrections are the effects of exterior orientation and principal distance. The remaining
combinations are the additional parameters: their effects are orthogonal over the grid to one
another and to the six, so that correlations are as small as possible. The parameters have no
physical meaning; together they describe any smooth deformation of the image.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from ..errors import InputError
from ..types import Array
from .lens import CorrectingLens, Correction


class Product(NamedTuple):
    """One product of polynomials: factor · p_i(x) p_j(y)."""

    i: int
    """Degree in x."""
    j: int
    """Degree in y."""
    factor: float
    """Factor of the product."""


@dataclass(frozen=True)
class Term:
    """Effect of one parameter, in coordinates divided by b."""

    in_x: tuple[Product, ...]
    """Correction of x."""
    in_y: tuple[Product, ...]
    """Correction of y."""

    @property
    def degree(self) -> int:
        """Degree of the polynomials, equal for both corrections."""
        return max(p.i + p.j for p in (*self.in_x, *self.in_y))


def ratios(m: int) -> tuple[float, ...]:
    """Return β_1 … β_m of the Gram polynomials over m + 1 equidistant places from −1 to 1.

    p_0 = 1, p_1 = t, p_{k+1} = t p_k − β_k p_{k−1} with β_k = Σ p_k² / Σ p_{k−1}²
    = k² ((m + 1)² − k²) / (4 (4k² − 1)) · (2/m)².
    """
    return tuple(
        k * k * ((m + 1) ** 2 - k * k) / (4.0 * (4 * k * k - 1)) * (2.0 / m) ** 2
        for k in range(1, m + 1)
    )


def gram_polynomials(t: Array, m: int) -> tuple[Array, Array]:
    """Return p_0 … p_m and their derivatives at t (n,), (m + 1, n) each; see `ratios`."""
    beta = ratios(m)
    p = np.ones((m + 1, len(t)))
    slope = np.zeros((m + 1, len(t)))
    for k in range(m):
        p[k + 1] = t * p[k]
        slope[k + 1] = p[k] + t * slope[k]
        if k > 0:
            p[k + 1] -= beta[k - 1] * p[k - 1]
            slope[k + 1] -= beta[k - 1] * slope[k - 1]
    return p, slope


def orthogonal_terms(m: int) -> dict[str, Term]:
    """Return the orthogonal parameters of the grid of (m + 1)² points by name, in order of degree.

    a_rs corrects x and b_rs corrects y by p_{s−1}(x) p_{r−1}(y), of degree s − 1 in x and r − 1
    in y. Exterior orientation and principal distance leave only these parameters of low degree,
    four of them in both coordinates:

        a12 (x, −y)    a21 (y, x)    a22 (xy, −α p2(y))    b22 (−α p2(x), xy)
        a31 (p2(y), 0)    b13 (0, p2(x))

    with α = Σ (xy)² / Σ p2² over the grid, which makes them orthogonal to the effects of two
    tilts, (p2(x), xy) and (xy, p2(y)): α = 2 for m = 2, 10/7 for m = 4.
    """
    beta = ratios(m)
    # Σ p1² p1² / Σ p2² p0² = Σ p1² / (β2 Σ p0²) = β1 / β2
    alpha = beta[0] / beta[1]
    out = {
        "a12": Term((Product(1, 0, 1.0),), (Product(0, 1, -1.0),)),
        "a21": Term((Product(0, 1, 1.0),), (Product(1, 0, 1.0),)),
        "a22": Term((Product(1, 1, 1.0),), (Product(0, 2, -alpha),)),
        "b22": Term((Product(2, 0, -alpha),), (Product(1, 1, 1.0),)),
        "a31": Term((Product(0, 2, 1.0),), ()),
        "b13": Term((), (Product(2, 0, 1.0),)),
    }
    for degree in range(3, 2 * m + 1):
        powers = [(degree - j, j) for j in range(degree + 1) if max(j, degree - j) <= m]
        for i, j in powers:
            out[f"a{j + 1}{i + 1}"] = Term((Product(i, j, 1.0),), ())
        for i, j in powers:
            out[f"b{j + 1}{i + 1}"] = Term((), (Product(i, j, 1.0),))
    return out


def _renamed(m: int, names: Mapping[str, str]) -> dict[str, Term]:
    every = orthogonal_terms(m)
    return {new: every[old] for new, old in names.items()}


@dataclass(frozen=True)
class OrthogonalLens(CorrectingLens):
    """Base of the orthogonal sets, measured → ideal: dV = Σ a_k (t_kx, t_ky)(x̄/b, ȳ/b).

    Terms t are dimensionless, so that every parameter a is in image units. A published
    coefficient, of the same polynomial in x̄ and ȳ, is the parameter divided by b^d with the
    degree d of the term, `degree_of`. At the grid points a term is at most 1, and smaller for
    higher degrees; outside the grid the terms grow quickly.
    """

    grid: ClassVar[int] = 2
    """m: the grid has m + 1 points along x and along y."""
    terms: ClassVar[Mapping[str, Term]] = {}
    """Term of each parameter."""
    image_base: float = 1.0
    """b: distance of the outer grid points from the middle of the grid, image units. b is the image
    base for tie points at the von Gruber positions, and about half the side of the image for tie
    points all over the image."""

    def __post_init__(self) -> None:
        """Check the options."""
        super().__post_init__()
        if not (np.isfinite(self.image_base) and self.image_base > 0):
            raise InputError(f"image_base must be positive, not {self.image_base}")

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the calibration parameters."""
        return ("c", "x0", "y0", *self.terms)

    def degree_of(self, name: str) -> int:
        """Return the degree d of the term of a parameter: published coefficient = value / b^d."""
        return self.terms[name].degree

    def _correction(self, x: Array, y: Array, k: Array, partials: bool) -> Correction:
        b = self.image_base
        p, p_slope = gram_polynomials(x / b, self.grid)
        q, q_slope = gram_polynomials(y / b, self.grid)
        zero = np.zeros_like(x)
        d = np.zeros((2, len(x)))
        slopes = np.zeros((2, 2, len(x)))
        columns: list[tuple[Array, Array]] = []
        for column, term in enumerate(self.terms.values(), start=3):
            parts = (term.in_x, term.in_y)
            effects = [_sum(products, p, q) if products else zero for products in parts]
            for axis, products in enumerate(parts):
                if products:
                    d[axis] += k[:, column] * effects[axis]
                    if partials:
                        slopes[axis, 0] += k[:, column] * _sum(products, p_slope, q)
                        slopes[axis, 1] += k[:, column] * _sum(products, p, q_slope)
            columns.append((effects[0], effects[1]))
        if not partials:
            return d[0], d[1], (), []
        return d[0], d[1], tuple(slopes.reshape(4, -1) / b), columns


def _sum(products: tuple[Product, ...], p: Array, q: Array) -> Array:
    """Return Σ factor · p_i q_j, (n,)."""
    return np.asarray(sum(factor * p[i] * q[j] for i, j, factor in products))


@dataclass(frozen=True)
class EbnerLens(OrthogonalLens):
    """Ebner's 12 additional parameters, measured → ideal, over 3 × 3 points. Ebner (1976).

    With x = x̄/b, y = ȳ/b, k = x² − 2/3, l = y² − 2/3, and b1 … b12 in image units:

        dVx =  b1 x + b2 y − 2 b3 k + b4 xy + b5 l + b7 x l + b9 y k + b11 k l
        dVy = −b1 y + b2 x + b3 xy − 2 b4 l + b6 k + b8 y k + b10 x l + b12 k l

    Published coefficients are b1, b2 divided by b, b3 … b6 by b², b7 … b10 by b³, and b11, b12
    by b⁴. Source: H. Ebner, Self-calibrating block adjustment, Bildmessung und
    Luftbildwesen 44 (1976), 128–139.
    """

    kind: ClassVar[str] = "ebner"
    grid: ClassVar[int] = 2
    terms: ClassVar[Mapping[str, Term]] = _renamed(
        2,
        {
            "b1": "a12",
            "b2": "a21",
            "b3": "b22",
            "b4": "a22",
            "b5": "a31",
            "b6": "b13",
            "b7": "a32",
            "b8": "b23",
            "b9": "a23",
            "b10": "b32",
            "b11": "a33",
            "b12": "b33",
        },
    )


@dataclass(frozen=True)
class GruenLens(OrthogonalLens):
    """Grün's 44 additional parameters, measured → ideal, over 5 × 5 points. Grün (1978).

    With x = x̄/b, y = ȳ/b, k = x² − 1/2, l = y² − 1/2, p = x³ − 17/20 x, q = y³ − 17/20 y,
    r = x⁴ − 31/28 x² + 9/70, s = y⁴ − 31/28 y² + 9/70, and all parameters in image units:

        dVx =  a12 x + a21 y + a22 xy − 10/7 b22 k + a31 l + a14 p + a23 y k + a32 x l + a41 q
             + a15 r + a24 y p + a33 k l + a42 x q + a51 s + … + a55 r s
        dVy = −a12 y + a21 x − 10/7 a22 l + b22 xy + b13 k + b14 p + b23 y k + b32 x l + b41 q
             + b15 r + b24 y p + b33 k l + b42 x q + b51 s + … + b55 r s

    The first index of a parameter is the degree in y and the second that in x, each plus one.
    A published coefficient is the parameter divided by b^d, d the sum of both degrees. A. Grün,
    Progress in photogrammetric point determination by compensation of systematic errors and
    detection of gross errors, Nachrichten aus dem Karten- und Vermessungswesen II/36 (1978),
    113–140.
    """

    kind: ClassVar[str] = "gruen"
    grid: ClassVar[int] = 4
    terms: ClassVar[Mapping[str, Term]] = orthogonal_terms(4)
