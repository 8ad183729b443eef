"""Residuals that only shrink with a network: of lengths that are compared with zero.

Conditions of shapes are lengths that should be zero. Where all else are angles, a smaller network
has smaller residuals in metres: vᵀPv has no minimum at a finite size.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..graph.blocks import Block
from ..types import Array, Mask
from .linear import LinearisedEquations


def lengths_of_zero(system: LinearisedEquations) -> Iterator[tuple[Block, Mask]]:
    """Yield blocks of lengths, and which of their observations (n,) are lengths of zero."""
    for block in system.equations.blocks:
        if block.unit == "m" and block.fixes == "nothing" and not block.prior:
            zero = ~np.any(block.observed, axis=1)
            if zero.any():
                yield block, zero


def without_shrinking(system: LinearisedEquations, noticed: Array, scale: Array) -> Array:
    """Return what rows notice without the shrinking of lengths that should be zero.

    Such a length grows with the object: A g is v times the change of ln scale.

    Args:
        system: the linearised network.
        noticed: A G, (n_rows, d).
        scale: change of ln scale in each motion, (d,).
    """
    out = noticed.copy()
    for block, zero in lengths_of_zero(system):
        rows = np.arange(block.rows.start, block.rows.stop)[np.repeat(zero, block.dimension)]
        out[rows] -= system.residual[rows][:, None] * scale
    return out
