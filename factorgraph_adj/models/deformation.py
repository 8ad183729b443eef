"""Deformations that models share: film, lens and plotter leave them in each model (FRAMES F2.3).

    q' = q + Σ_a p_a t_a(q / b)

q are coordinates in the frame of a model, b is a length such as the base of the model. The
parameters p_a have the unit of the frame: each is the displacement at a place one base away. They
are shared by a group of models and weighted with 0 ± σ (Ayeni's method 23). With (ξ, η, ζ) = q / b:

| components | terms | number |
| --- | --- | --- |
| ``x`` ``y`` ``z`` | shifts: errors of projection centres, in a group of their own | 3 |
| ``affinity`` ``shear_xy`` | (ξ, −η, 0), (η, ξ, 0) | 2 |
| ``stretch_z`` ``shear_xz`` ``shear_yz`` | (0, 0, ζ), (ζ, 0, ξ), (0, ζ, η) | 3 |
| ``x_xy`` ``x_yy`` ``x_xyy`` | ξη, η², ξη² in x; the same in y | 6 |
| ``z_xy`` ``z_yy`` ``z_xyy`` | ξη (twist), η², ξη² in z | 3 |

The second and third row together are the affine deformation without the similarity. The second and
the last two together span what {1, ξ} ⊗ {1, η, η²} has beside the similarity: 8 terms in plan and 3
in height, those of Ebner (1976) without projection centres.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..types import Array

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
