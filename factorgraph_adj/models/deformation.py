"""Deformations of film, lens, plotter and strips of models: polynomials (FRAMES F2.3, F6)."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised

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
DEFORMATIONS = (
    *"xyz",
    *_LINEAR,
    *(f"{axis}_{power}" for axis in "xyz" for power in _POWERS),
)
"""Names of the parameters, in order."""


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
        parameters: p, (n, 17).
        base: b, unit of the frame, (n,).
    """
    n = len(q)
    terms = np.zeros((n, 3, len(DEFORMATIONS)))
    slopes = np.zeros((n, len(DEFORMATIONS), 3, 3))
    u = q / base[:, None]
    for i, name in enumerate(DEFORMATIONS):
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
    moved = np.einsum("nia,na->ni", terms, parameters)
    by_q = np.einsum("na,naij->nij", parameters, slopes) / base[:, None, None]
    return Deformed(q + moved, np.eye(3) + by_q, terms)


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
