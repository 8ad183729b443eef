"""Turns of residuals across axes and verticals, which tell nothing about a datum."""

from __future__ import annotations

import numpy as np

from ..models.variables import UNKNOWNS
from ..observations import KINDS
from ..types import Array, Mask
from .linear import LinearisedEquations
from .stations import places_of


def without_turns(system: LinearisedEquations, noticed: Array) -> Array:
    """Return what rows notice without turns of residuals across an axis about it.

    The frame of a line is held about its axis, so that its two residuals v turn with the object:
    A g has the part (−v₂, v₁) times the turn. It says nothing of the turn, as vᵀPv stays, if both
    distances have one weight, and hardly anything otherwise: v is of the size of σ. So do the two
    inclinations of an axis parallel to that of a shape.

    Args:
        system: the linearised network.
        noticed: A G, (n_rows, d).
    """
    out = noticed
    for block in system.equations.blocks:
        record = KINDS.get(block.kind)
        if record is None or not record.turns or block.whitener is not None:
            continue
        v = system.residual[block.rows].reshape(-1, 2)
        ratio = block.sigma[:, 1] / block.sigma[:, 0]
        w = np.column_stack([-v[:, 1] * ratio, v[:, 0] / ratio])
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


def turning_rows(system: LinearisedEquations) -> Mask:
    """Return which rows, extra rows last, are residuals in two directions across an axis."""
    out = np.zeros(len(system.every_residual), dtype=bool)
    for block in system.equations.blocks:
        record = KINDS.get(block.kind)
        out[block.rows] = record is not None and record.turns
    return out


def without_turned_deflections(
    system: LinearisedEquations, noticed: Array, radians: Array
) -> Array:
    """Return what rows notice without turns of weighted deflections about the vertical.

    A deflection (ξ, η) turns with the object about the vertical. Where it is expected to be zero,
    both components with one σ, only its size counts, which stays: A g has the part ω (η, −ξ)/σ,
    and vᵀPv knows nothing of the turn ω.

    Args:
        system: the linearised network.
        noticed: A G, (n_rows, d).
        radians: rotation vectors of the motions G, (3, d).
    """
    out = noticed
    state, frame = system.state, system.equations.network.frame
    for block in system.equations.blocks:
        kind, numbers = block.variables[0]
        if not block.prior or not UNKNOWNS[kind].across:
            continue
        which = block.constants["which"].astype(int)
        at = places_of(system.equations, kind, numbers)
        enu = frame.basis(state["point"][at], np.zeros((len(at), 2))).enu
        turn = np.linalg.det(enu)[:, None] * (enu[:, 2] @ radians)
        for number in np.unique(numbers).tolist():
            own = np.flatnonzero(numbers == number)
            sigma = block.sigma[own, 0]
            if len(own) < 2 or np.any(block.observed[own]) or sigma[0] != sigma[1]:
                continue
            xi, eta = state[kind][number]
            rows = np.arange(block.rows.start, block.rows.stop)[own]
            moved = np.array([eta, -xi])[which[own]]
            if out is noticed:
                out = noticed.copy()
            out[rows] -= (moved / sigma)[:, None] * turn[own]
    return out
