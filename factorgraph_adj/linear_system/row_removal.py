"""Rows leave a system in fronts: what is left of it, and what only they determined."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..graph.dependence import Variable
from ..types import NO_ROWS, Index
from .front_system import FrontSystem
from .test_decisions import MIN_MOTION, SINGULAR_REDUNDANCY


def downdated(system: FrontSystem, ids: Sequence[str]) -> FrontSystem | None:
    """Return a system without observations; none where an update cannot tell.

    Args:
        system: the system.
        ids: first ids of units, ids of image points, and names of weighted unknowns.
    """
    found = _reduced(system, ids)
    if found is None or not found.update.trusted or found.update.condition <= SINGULAR_REDUNDANCY:
        return None
    return found


def determined_only_by(system: FrontSystem, ids: Sequence[str]) -> set[Variable] | None:
    """Return the variables that observations alone determine; none where that is not known.

    With M of the rows that leave, a null vector z of M is a motion x = Q Aᵀ z that only these
    rows see.
    """
    found = _reduced(system, ids)
    if found is None:
        return None
    update = found.update
    leave = update.signs < 0
    inner, spread = update.inner, update.spread
    e, g = inner[np.ix_(leave, leave)], spread[:, leave]
    if (~leave).any():
        gain = np.linalg.solve(inner[np.ix_(~leave, ~leave)], inner[np.ix_(~leave, leave)])
        e = e - inner[np.ix_(leave, ~leave)] @ gain
        g = g - spread[:, ~leave] @ gain
    values, vectors = np.linalg.eigh(-0.5 * (e + e.T))
    weight = np.sqrt(np.where(found.unknowns.free, system.base.normal().diagonal, 0.0))
    far = np.zeros(len(weight))
    for z in vectors[:, values <= SINGULAR_REDUNDANCY].T:
        far = np.maximum(far, np.abs(system.lifted.unknowns(g @ z, found.slots)) * weight)
    unknowns = system.unknowns
    return {
        (kind, unknowns[kind].names[number])
        for kind, number in unknowns.active()
        if (far[unknowns.columns(kind, number)] > MIN_MOTION).any()
    }


def _reduced(system: FrontSystem, ids: Sequence[str]) -> FrontSystem | None:
    """Return a system without observations, determined or not; none: they are too many."""
    joined = dict(system.joined)
    gone = [joined.pop(i) for i in ids if i in joined]
    update = system.update
    if gone:
        stays = np.ones(len(update.signs), dtype=bool)
        stays[np.concatenate(gone)] = False
        update = update.only(np.flatnonzero(stays))
        new = np.cumsum(stays) - 1
        joined = {i: new[rows] for i, rows in joined.items()}
    own = [i for i in ids if i not in system.joined]
    equations = system.base.equations
    of_own = equations.find(own)
    if system.section is not None and not all(map(len, of_own)):
        return None  # the rest has one
    rows = np.concatenate([NO_ROWS, *of_own])
    for c in equations.clusters:
        if np.isin(c.rows, rows).any():
            rows = np.union1d(rows, c.rows)
    slots = dict(system.slots)
    if len(rows):
        if len(update.signs) + len(rows) > system.most_beside:
            return None
        a = system.base.normal().system.sparse(rows)
        columns: Index = np.unique(a.indices).astype(np.intp)
        slots = system.lifted.with_slots(columns, slots)
        if not system.has_room(slots):
            return None
        f = system.lifted.expand(columns, a[:, columns].toarray(), slots)
        v = system.base.normal().system.residual[rows]
        if system.offset is not None:
            v = v + a @ system.offset
        update = update.with_rows(f.at, f.b, v, sign=-1.0)
    return replace(system, update=update, joined=joined, slots=slots, drift=None)
