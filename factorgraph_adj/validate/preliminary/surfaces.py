"""Stated heights of surfaces of water and pressure against the given heights of points on them.

A reading whose residual at the stated values is v, with the partial J by the height of the surface,
puts the surface −v/J higher. The median over its points is compared with the standard deviation of
the stated height, and with how well the points agree with one another.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...errors import InputError, known
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...models.unknown import UnknownKind
from ...models.variables import UNKNOWNS
from ...types import Array, Index
from ...units import significant
from .finding import TIMES, Finding
from .given_rows import BETTER

ROUGH = 1.0
"""Error of approximate heights that is nothing unusual, metres."""
SPREAD = 1.4826
"""Standard deviation of normally distributed values, in medians of their sizes."""


def surfaces(equations: Equations) -> Iterator[Finding]:
    """Iterate over surfaces whose stated height is far from that of the points on them."""
    for kind in UNKNOWNS.values():
        first = kind.components[0] if kind.components else None
        if first is None or not (kind.connects and kind.on_earth and first.whole):
            continue
        if first.quantity == "length" and len(equations.unknowns[kind.name].names):
            yield from _of_kind(equations, kind)


def _of_kind(equations: Equations, kind: UnknownKind) -> Iterator[Finding]:
    table = equations.unknowns[kind.name]
    parts = [
        _implied(equations, block, place)
        for block in equations.blocks
        if not block.prior
        for place, (what, _) in enumerate(block.variables)
        if what == kind.name
    ]
    if not parts:
        return
    number, higher, sigma, rough = (np.concatenate([p[i] for p in parts]) for i in range(4))
    labels = [name for p in parts for name in p[4]]
    for n in np.unique(number).tolist():
        stated = float(table.values[n, 0])
        free, weight = bool(table.free[n, 0]), float(table.sigma[n, 0])
        approximate = free and not np.isfinite(weight)
        # A height of exactly zero that is only approximate is one that was not stated.
        if not np.isfinite(stated) or (approximate and stated == 0.0):
            continue
        rows = np.flatnonzero(number == n)
        sure = rows[~rough[rows].astype(bool)]
        own = sure if len(sure) else rows
        off = float(np.median(higher[own]))
        apart = SPREAD * float(np.median(np.abs(higher[own] - off)))
        spread = max(apart, float(np.median(sigma[own])))
        limit = TIMES * float(np.hypot(spread, weight if free and not approximate else 0.0))
        if approximate or not len(sure):
            limit = max(limit, BETTER * max(spread, ROUGH))
        if abs(off) <= limit:
            continue
        how = "approximate" if approximate else "weighted" if free else "held"
        on = known([labels[i] for i in own.tolist()], most=3)
        yield Finding(
            f"{kind.noun} {table.names[n]!r}: its {how} height of {significant(stated, 7)} m "
            f"contradicts the given heights of the {len(own)} points on it, by which it is "
            f"{significant(stated + off, 7)} m ({on})",
            "look at its value, and at the heights of these points",
            -off,
            limit,
            "m",
        )


def _implied(
    equations: Equations, block: Block, place: int
) -> tuple[Index, Array, Array, Array, list[str]]:
    """Return surfaces, by how much higher they are, σ, whether by rough points, and labels."""
    state = equations.unknowns.start()
    fine = np.ones(block.n, dtype=bool)
    rough, given = np.zeros((2, block.n))
    for what, index in block.variables:
        fine &= np.isfinite(state[what][index]).all(axis=1)
        if what in ("point", "pose"):
            table = equations.unknowns[what]
            unsure = table.free[index] & ~np.isfinite(table.sigma[index])
            rough = np.maximum(rough, unsure.any(axis=1))
            weights = np.where(np.isfinite(table.sigma[index]), table.sigma[index], 0.0)
            given = np.hypot(given, np.where(table.free[index], weights, 0.0).max(axis=1))
    rows = np.flatnonzero(fine)
    number = block.variables[place][1]
    part = block.select(rows)
    try:
        found = part.evaluate(equations.network.frame, state)
    except InputError:
        rows, found = rows[:0], None
    if found is None or not len(rows):
        none = np.zeros(0)
        return number[:0], none, none, none, []
    partial = found.jacobians[place][:, 0, 0]
    seen = partial != 0.0
    higher = -found.residual[seen, 0] / partial[seen]
    sigma = np.hypot(part.sigma[seen, 0] / np.abs(partial[seen]), given[rows[seen]])
    rows = rows[seen]
    return number[rows], higher, sigma, rough[rows], [block.labels(int(i)) for i in rows]
