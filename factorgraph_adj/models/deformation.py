"""Deformations of models by film, lens and plotter; polynomials of strips (FRAMES F2.3, F6).

    q' = (q + Σ_a p_a t_a(q / b)) / (1 − wᵀ q / b²)

q are coordinates in the frame of a model, b is a length such as the base of the model. The
parameters p_a and w have the unit of the frame: each is the displacement at a place one base away.
They are shared by a group of models and weighted with 0 ± σ (Ayeni's method 23), or those of one
model are free (BATT-SAP). With (ξ, η, ζ) = q / b:

| components | terms | number |
| --- | --- | --- |
| ``x`` ``y`` ``z`` | shifts: errors of projection centres, in a group of their own | 3 |
| ``affinity`` ``shear_xy`` | (ξ, −η, 0), (η, ξ, 0) | 2 |
| ``stretch_z`` ``shear_xz`` ``shear_yz`` | (0, 0, ζ), (ζ, 0, ξ), (0, ζ, η) | 3 |
| ``x_xy`` ``x_yy`` ``x_xyy`` | ξη, η², ξη² in x; the same in y | 6 |
| ``z_xy`` ``z_yy`` ``z_xyy`` | ξη (twist), η², ξη² in z | 3 |
| ``projective_x`` ``projective_y`` ``projective_z`` | w: ξ q, η q, ζ q to first order | 3 |

The second and third row together are the affine deformation without the similarity: 12 parameters
with that of the frame. With the last row these are the 15 of a projective transformation of space.
The second, fourth and fifth together span what {1, ξ} ⊗ {1, η, η²} has beside the similarity: 8
terms in plan and 3 in height, those of Ebner (1976) without projection centres.

    X + i Y = x + i y + Σ_j (a_j + i b_j) s^j        s = along + i across
    Z       = z + Σ h_kl along^k across^l

(x, y, z) are coordinates of the strip, turned, scaled and shifted to the ground by its absolute
orientation. Place s of a point in the strip counts from the middle of the strip, in a unit that
keeps powers small, such as kilometres. Plan is conformal: a function of the complex number s.

The coefficients are metres, that is, metres for each power of the unit of s. Their order is by
degree, so that a strip of a lower degree has only the first of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, require

_LINEAR: dict[str, tuple[tuple[int, int, float], ...]] = {
    "affinity": ((0, 0, 1.0), (1, 1, -1.0)),
    "shear_xy": ((0, 1, 1.0), (1, 0, 1.0)),
    "stretch_z": ((2, 2, 1.0),),
    "shear_xz": ((0, 2, 1.0), (2, 0, 1.0)),
    "shear_yz": ((1, 2, 1.0), (2, 1, 1.0)),
}
"""Elements (row, column, factor) of the matrix of each linear term."""
_POWERS = {"xy": (1, 1), "yy": (0, 2), "xyy": (1, 2)}
"""Powers of ξ and η of the higher terms."""
DISPLACEMENTS = (
    *"xyz",
    *_LINEAR,
    *(f"{axis}_{power}" for axis in "xyz" for power in _POWERS),
)
"""Names of the parameters p, in order."""
PROJECTIVE = ("projective_x", "projective_y", "projective_z")
"""Names of the components of w."""
DEFORMATIONS = (*DISPLACEMENTS, *PROJECTIVE)
"""Names of all parameters, in order."""
MIN_DENOMINATOR = 1e-6
"""Smallest denominator 1 − wᵀ q / b²; it is 0 in the plane that goes to infinity."""
HEIGHT_TERMS: tuple[tuple[str, ...], ...] = (
    ("z",),
    ("z_x", "z_y"),
    ("z_xx", "z_xy", "z_yy"),
    ("z_xxx", "z_xxy", "z_xyy"),
    ("z_xxxx", "z_xxxy", "z_xxxxy"),
)
"""Terms of the height by degree; x stands for along, y for across: ``z_xxy`` is along² across.

They are the 12 terms of Schut and those of three lower ones (FRAMES F6.2)."""
COEFFICIENTS: tuple[str, ...] = tuple(
    name
    for degree, heights in enumerate(HEIGHT_TERMS)
    for name in (f"a{degree}", f"b{degree}", *heights)
)
"""Names of the coefficients in order."""
HIGHEST = len(HEIGHT_TERMS) - 1
"""Highest degree in plan."""


class Deformed(NamedTuple):
    """n places of models after their deformation, and the partials."""

    q: Array
    """q', unit of the frame, (n, 3)."""
    by_q: Array
    """∂q'/∂q, (n, 3, 3)."""
    by_parameters: Array
    """∂q'/∂p, (n, 3, number of parameters)."""


def deformed(q: Array, parameters: Array, base: Array) -> Deformed:
    """Return deformed places.

    Args:
        q: coordinates in the frames, (n, 3).
        parameters: p and w, (n, 20).
        base: b, unit of the frame, (n,).

    Raises:
        InputError: a place lies beyond the plane that a projective deformation moves to infinity.
    """
    n, size = len(q), len(DISPLACEMENTS)
    terms = np.zeros((n, 3, size))
    slopes = np.zeros((n, size, 3, 3))
    u = q / base[:, None]
    for i, name in enumerate(DISPLACEMENTS):
        if name in _LINEAR:
            for row, column, factor in _LINEAR[name]:
                terms[:, row, i] = factor * u[:, column]
                slopes[:, i, row, column] = factor
            continue
        axis, _, power = name.partition("_")
        row = "xyz".index(axis)
        k, m = _POWERS.get(power, (0, 0))
        terms[:, row, i] = u[:, 0] ** k * u[:, 1] ** m
        if k:
            slopes[:, i, row, 0] = u[:, 1] ** m
        if m:
            slopes[:, i, row, 1] = m * u[:, 0] ** k * u[:, 1] ** (m - 1)
    p, w = parameters[:, :size], parameters[:, size:] / base[:, None]
    below = 1.0 - np.sum(w * u, axis=1)
    require(below > MIN_DENOMINATOR, "its projective deformation moves it to infinity")
    moved = (q + np.einsum("nia,na->ni", terms, p)) / below[:, None]
    by_q = np.eye(3) + np.einsum("na,naij->nij", p, slopes) / base[:, None, None]
    # ∂(1/D)/∂q = w / (b² D²), ∂(1/D)/∂w = q / (b² D²)
    by_q += moved[:, :, None] * (w / base[:, None])[:, None, :]
    by_w = moved[:, :, None] * (u / base[:, None])[:, None, :]
    by_parameters = np.concatenate([terms, by_w], axis=2)
    return Deformed(moved, by_q / below[:, None, None], by_parameters / below[:, None, None])


def monomials(along: Array, across: Array, size: int) -> Array:
    """Return the partials of the corrections by the first coefficients, (n, 3, size).

    Args:
        along: places along the strip, (n,).
        across: places across the strip, (n,).
        size: number of coefficients.
    """
    s = along + 1j * across
    out = np.zeros((len(s), 3, size))
    for i, name in enumerate(COEFFICIENTS[:size]):
        if name[0] == "z":
            out[:, 2, i] = along ** name.count("x") * across ** name.count("y")
            continue
        power = s ** int(name[1:])
        if name[0] == "b":
            power = 1j * power
        out[:, 0, i], out[:, 1, i] = power.real, power.imag
    return out


def strip_coordinate(
    frame: Frame,
    point: Array,
    polynomial: Array,
    *,
    observed: Array,
    along: Array,
    across: Array,
    axes: tuple[int, ...] = (0, 1, 2),
) -> Linearised:
    """Compute X − Σ c f(s) − observed, metres, of the observed axes, (n, d); FRAMES F6.4.

    The equations are linear in points and coefficients.

    Args:
        frame: frame of the network.
        point: X, (n, 3).
        polynomial: coefficients, (n, k).
        observed: coordinates of the strip on the ground, (n, d).
        along: places along the strip, (n,).
        across: places across the strip, (n,).
        axes: numbers of the observed axes.
    """
    rows = list(axes)
    terms = monomials(along, across, polynomial.shape[1])[:, rows]
    bent = np.einsum("nij,nj->ni", terms, polynomial)
    by_point = np.broadcast_to(np.eye(3)[rows], (len(point), len(rows), 3))
    return Linearised(point[:, rows] - bent - observed, (by_point, -terms))
