"""The diagonal of N without the stiffness of rigid mounts, as a measure of how well unknowns hold.

Damping, the search for datum defects and that for undetermined unknowns compare with the diagonal
of N: what holds an unknown if all others are held. A rigid mount holds a photo to 1 µm beside its
carrier, though nothing holds both better than to centimetres. Damping by such a diagonal would keep
the whole rig where it is, and everything would look undetermined. Here no tie of a member to its
carrier counts for more than what holds the best photo otherwise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..observations.registry import KINDS
from ..types import Array, Index

if TYPE_CHECKING:
    from .linear import LinearisedEquations

ROUNDING = 1e-13
"""Share of a sum below which a difference of two sums is rounding."""


def eased_diagonal(system: LinearisedEquations, diagonal: Array) -> Array:
    """Return the diagonal of N (n_columns,) with eased ties; ``diagonal``: that of N."""
    return eased(system, diagonal)[0]


def eased(system: LinearisedEquations, diagonal: Array) -> tuple[Array, Array]:
    """Return the diagonal of N with eased ties (n_columns,), and a factor of every row of A.

    Args:
        system: the linearised network.
        diagonal: diagonal of N, (n_columns,).

    Returns:
        The diagonal; the factors (rows,), one except for ties, extra rows at the end.
    """
    rows = np.ones(len(system.every_residual))
    ties = [
        (place, lb, record.follower)
        for place, lb in enumerate(system.blocks)
        if (record := KINDS.get(lb.block.kind)) is not None
        and record.follower is not None
        and len(lb.a[record.follower.place])
    ]
    if not ties:
        return diagonal, rows
    rest, parts = diagonal, []
    for place, lb, follower in ties:
        own = np.ones(lb.block.n, dtype=bool)
        own[system.equations.in_cluster.get(place, slice(0))] = False
        squares = [
            (offset, np.einsum("ndk,ndk->nk", a, a) * own[:, None])
            for offset, a in zip(lb.offsets, lb.a, strict=True)
            if len(a)
        ]
        tied = np.zeros_like(diagonal)
        _add(tied, squares, np.ones(lb.block.n))
        rest = rest - tied
        parts.append((lb, follower, squares))
    # What rounding leaves of a large sum counts as nothing.
    out = np.where(rest > ROUNDING * diagonal, rest, 0.0)
    kinds = {lb.block.variables[follower.place][0] for lb, follower, _ in parts}
    caps = {kind: _largest(system, kind, out) for kind in kinds}
    for lb, follower, squares in parts:
        a = lb.a[follower.place]
        square = np.einsum("ndk,ndk->nk", a, a)
        with np.errstate(divide="ignore", invalid="ignore"):
            share = caps[lb.block.variables[follower.place][0]] / square
        share = np.minimum(np.where(square > 0.0, share, np.inf).min(axis=1), 1.0)
        _add(out, squares, share)
        rows[lb.block.rows] = np.repeat(np.sqrt(share), lb.block.dimension)
    return out, rows


def _largest(system: LinearisedEquations, kind: str, diagonal: Array) -> Array:
    """Return the largest element of each component of a kind; infinite where there is none."""
    table = system.unknowns[kind]
    on = np.flatnonzero(table.offset >= 0)
    out = np.full(table.free.shape[1], np.inf)
    for j in range(len(out)):
        most = float(diagonal[table.offset[on] + j].max(initial=0.0))
        out[j] = most if most > 0.0 else np.inf
    return out


def _add(out: Array, squares: list[tuple[Index, Array]], share: Array) -> None:
    """Add squares (n, k) at their offsets, each row with its share (n,), to out (n_columns,)."""
    for offset, square in squares:
        on = np.flatnonzero(offset >= 0)
        for j in range(square.shape[1]):
            np.add.at(out, offset[on] + j, share[on] * square[on, j])
