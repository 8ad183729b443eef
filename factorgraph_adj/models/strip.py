"""Strips of models that bend: polynomials of Schut in plan and height (FRAMES F6).

    X + i Y = x + i y + Σ_j (a_j + i b_j) s^j        s = along + i across
    Z       = z + Σ h_kl along^k across^l

(x, y, z) are coordinates of the strip, turned, scaled and shifted to the ground by its absolute
orientation. Place s of a point in the strip counts from the middle of the strip, in a unit that
keeps powers small, such as kilometres. Plan is conformal: a function of the complex number s.

The coefficients are metres, that is, metres for each power of the unit of s. Their order is by
degree, so that a strip of a lower degree has only the first of them.
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised

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
