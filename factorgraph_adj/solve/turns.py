"""Turns of residuals across axes of shapes, of which nothing is to be learnt about a datum."""

from __future__ import annotations

import numpy as np

from ..observations import KINDS
from ..types import Array
from .linear import LinearSystem


def without_turns(system: LinearSystem, noticed: Array) -> Array:
    """Return what rows notice without turns of residuals across an axis about it.

    The frame of a line is held about its axis, so that its two residuals v turn with the object:
    A g has the part (−v₂, v₁) times the turn. It says nothing of the turn, as vᵀPv stays, if both
    distances have one weight. So do the two inclinations of an axis parallel to that of a shape.

    Args:
        system: the linearised network.
        noticed: A G, (n_rows, d).
    """
    out = noticed
    for block in system.equations.blocks:
        record = KINDS.get(block.kind)
        if record is None or not record.turns or block.whitener is not None:
            continue
        if np.any(block.sigma[:, 0] != block.sigma[:, 1]):
            continue
        v = system.residual[block.rows].reshape(-1, 2)
        w = np.column_stack([-v[:, 1], v[:, 0]])
        if out is noticed:
            out = noticed.copy()
        rows = out[block.rows].reshape(block.n, 2, -1)
        shape = block.variables[0][1]
        for f in np.unique(shape).tolist():
            own = np.flatnonzero(shape == f)
            square = float(np.sum(w[own] ** 2))
            if square > 0:
                turn = np.einsum("ni,nid->d", w[own], rows[own]) / square
                rows[own] -= w[own][:, :, None] * turn
        out[block.rows] = rows.reshape(2 * block.n, -1)
    return out
