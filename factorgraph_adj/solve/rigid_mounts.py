"""Mounts of rigs: diagonal of N with their weight capped; members placed as the linear step says.

A rigid mount is an observation with a standard deviation of 1 µm and 10⁻⁸ rad; nothing else places
its photo or its carrier better than to centimetres.

Damping, the search for datum defects and that for undetermined unknowns compare with the diagonal
of N: what holds an unknown if all others are held. Damping by the diagonal with mounts would keep
the whole rig where it is, and everything would seem undetermined. Here no tie of a member to its
carrier counts for more than what holds the best photo otherwise.

The linear step keeps a mount; its finite form leaves a remainder of second order, 10⁻⁶ rad for a
turn of 10⁻³ rad, that is hundreds of standard deviations. Every step would then have to be tiny. So
the variable that follows is placed again: its observations have the residuals v + A dx that the
linear step promised. The step is the same to first order, and vᵀPv is that of an exact mount.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.unknown_registry import VariableKind
from ..observations.registry import KINDS, Follower
from ..types import Array, Index, Mask

if TYPE_CHECKING:
    from .linearised_equations import LinearisedEquations

MAX_REMAINDER_SIGMAS = 0.1
"""Remainder of second order, in standard deviations, above which a variable is placed again."""
MIN_SIGNIFICANT_SHARE = 1e-13
"""Share of a sum below which a difference of two sums is rounding."""


def with_rig_members_placed(
    equations: Equations, before: State, moved: State, step: Array, *, fixed: Index | None = None
) -> State:
    """Return ``moved`` with the members of rigs where the linear step has them.

    Only variables follow that are free altogether, and have one carrier.

    Args:
        equations: the network.
        before: the state before the step.
        moved: the state after the step.
        step: the step, (n_columns,).
        fixed: columns whose variables stay where they are; None: there are none.
    """
    out = moved
    for kind, followers in _by_kind(equations).items():
        carrier, free = _carriers(equations, kind, followers)
        if fixed is not None:
            offset = equations.unknowns[kind].offset
            free &= ~np.isin(offset, fixed)
        depth = _depths(carrier, free)
        rows = [(b, f, np.flatnonzero(depth[b.variables[f.place][1]] > 0)) for b, f in followers]
        rows = [(b, f, r) for b, f, r in rows if len(r)]
        if not rows:
            continue
        promised = [_promised(equations, b.select(r), before, step) for b, f, r in rows]
        if not any(
            _left(equations, b.select(r), moved, v)
            for (b, f, r), v in zip(rows, promised, strict=True)
        ):
            continue
        out = {**out, kind: out[kind].copy()}
        for level in range(1, int(depth.max()) + 1):
            for (block, follower, chosen), v in zip(rows, promised, strict=True):
                at = np.flatnonzero(depth[block.variables[follower.place][1][chosen]] == level)
                if len(at):
                    part = block.select(chosen[at])
                    values = [out[what][index] for what, index in part.variables]
                    number = part.variables[follower.place][1]
                    out[kind][number] = follower.placed(v[at], *values, observed=part.observed)
    return out


def _by_kind(equations: Equations) -> dict[VariableKind, list[tuple[Block, Follower]]]:
    """Return the blocks whose variables follow, by the kind of these."""
    out: dict[VariableKind, list[tuple[Block, Follower]]] = {}
    for block in equations.blocks:
        record = KINDS.get(block.kind)
        if record is not None and record.follower is not None and not block.prior:
            out.setdefault(block.variables[record.follower.place][0], []).append(
                (block, record.follower)
            )
    return out


def _carriers(
    equations: Equations, kind: VariableKind, followers: list[tuple[Block, Follower]]
) -> tuple[Index, Mask]:
    """Return the carrier of each variable (−1: none), and whether it may follow."""
    table = equations.unknowns[kind]
    carrier = np.full(len(table.names), -1, dtype=np.intp)
    free: Mask = np.all(table.free & np.isinf(table.sigma), axis=1)
    for block, follower in followers:
        first, second = block.variables[follower.carrier][1], block.variables[follower.place][1]
        order = np.lexsort((first, second))
        a, b = first[order], second[order]
        twice = (b[1:] == b[:-1]) & (a[1:] != a[:-1])
        free[b[1:][twice]] = False
        free[second[(carrier[second] >= 0) & (carrier[second] != first)]] = False
        carrier[second] = first
    return carrier, free


def _depths(carrier: Index, free: Mask) -> Index:
    """Return how many carriers carry each variable, 0: it does not follow."""
    depth = np.zeros(len(carrier), dtype=np.intp)
    waiting = free & (carrier >= 0)
    while True:
        ready = waiting & ~waiting[carrier]
        if not ready.any():
            return depth
        depth[ready] = depth[carrier[ready]] + 1
        waiting &= ~ready


def _promised(equations: Equations, block: Block, before: State, step: Array) -> Array:
    """Return v + A dx of a block, (n, d)."""
    linear = block.evaluate(equations.network.frame, before)
    out = linear.residual.copy()
    for (kind, index), by in zip(block.variables, linear.jacobians, strict=True):
        offset = equations.unknowns[kind].offset[index]
        dx = np.where(
            (offset >= 0)[:, None], step[np.maximum(offset, 0)[:, None] + np.arange(by.shape[2])], 0
        )
        out += np.einsum("nij,nj->ni", by, dx)
    return out


def _left(equations: Equations, block: Block, moved: State, promised: Array) -> bool:
    """Return whether remainders of second order count."""
    v = block.evaluate(equations.network.frame, moved, jacobians=False).residual
    return bool(np.any(np.abs(v - promised) > MAX_REMAINDER_SIGMAS * block.sigma))


def diagonal_without_stiffness(system: LinearisedEquations, diagonal: Array) -> Array:
    """Return the diagonal of N (n_columns,) with eased ties; ``diagonal``: that of N."""
    return eased_ties(system, diagonal)[0]


def eased_ties(system: LinearisedEquations, diagonal: Array) -> tuple[Array, Array]:
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
    out = np.where(rest > MIN_SIGNIFICANT_SHARE * diagonal, rest, 0.0)
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
