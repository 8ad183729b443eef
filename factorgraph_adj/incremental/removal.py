"""Observations leave: what they alone determined waits again.

`leave` takes rows out of a system; `take_out` takes observations out of a state, and with them
what only they determined.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..graph.dependence import Variable
from ..ledger.candidates import Candidates, Nothing
from ..ledger.ledger import Ledger
from ..ledger.options import Options
from ..ledger.verdicts import REST
from ..linear_system.front_system import FrontSystem
from ..linear_system.isam2_system import ISAM2System
from ..linear_system.linearisation_error import near_minimum
from ..linear_system.rebase import Draft, Failure, with_doubt
from ..linear_system.test_statistics import MOVES, TIED, untested
from ..solve.solution import Solution
from ..types import NO_ROWS, Index
from .initial_adjustment import adjusted
from .worklist import IncrementalState, Task


def without(system: FrontSystem, ids: Sequence[str]) -> FrontSystem | None:
    """Return a system without observations; none where an update cannot tell.

    Args:
        system: the system.
        ids: first ids of units, ids of image points, and names of weighted unknowns.
    """
    found = _reduced(system, ids)
    if found is None or not found.update.trusted or found.update.condition <= TIED:
        return None
    return found


def loosened(system: FrontSystem, ids: Sequence[str]) -> set[Variable] | None:
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
    for z in vectors[:, values <= TIED].T:
        far = np.maximum(far, np.abs(system.lifted.unknowns(g @ z, found.slots)) * weight)
    unknowns = system.unknowns
    return {
        (kind, unknowns[kind].names[number])
        for kind, number in unknowns.active()
        if (far[unknowns.columns(kind, number)] > MOVES).any()
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


class Out(NamedTuple):
    """What is left to do once observations have been taken out."""

    state: IncrementalState
    """The state without them."""
    tasks: tuple[Task, ...]
    """Observations to be looked at: the rest of groups, what waits again, what had waited."""
    start: Solution | None
    """Where everything was, if all of it has to be found out anew."""


def take_out(
    state: IncrementalState, ids: Sequence[str], rules: Options, cause: str = "removed"
) -> Out:
    """Take observations out, wherever they are.

    Args:
        state: the state.
        ids: their ids, and names of weighted unknowns, which lose their weights.
        rules: the options.
        cause: why.
    """
    ledger = state.ledger
    rows = ledger.find(ids)
    weights = ledger.missing(ids)
    inside = ledger.rows.among(rows, "accepted")
    rests = {
        row: left
        for row, unit in ledger.rows.units(rows)
        if (left := unit.without(ledger.network, set(ids))) is not None
    }
    firsts = [ledger.rows.ids(ledger.names, r)[0] for r in inside.tolist()]
    ledger = ledger.moved(rows, None, cause)
    ledger, rest = ledger.appended([u.item for u in rests.values()], REST)
    fixed = rest[np.isin(list(rests), inside)]
    out = rest[np.isin(list(rests), state.ledger.having("rejected"))]
    told = {v.id: v for u in ledger.units(out) for v in untested(u, "rejected", cause=REST)}
    ledger = ledger.moved(out, "rejected", REST, told)
    rest = np.setdiff1d(rest, out)
    ledger = ledger.without_weights(weights).without_lacks(rows)
    start, again, system = None, NO_ROWS, state.system
    if system is not None and (len(inside) or weights):
        smaller: ISAM2System | None = None
        if isinstance(system, ISAM2System) and not weights:
            smaller = system.without(firsts, ledger)
        if smaller is not None:
            system = smaller
        elif (fronts := state.fronts) is not None:
            ledger, system, again, start = _without(ledger, fronts, [*firsts, *weights], rules)
    held = np.union1d(fixed, again)
    tasks = [Task(np.union1d(rest, again), held), Task(ledger.having("waiting"))]
    after = IncrementalState(ledger, system, settled=False)
    return Out(after, tuple(t for t in tasks if len(t.rows)), start)


def _without(
    ledger: Ledger, system: FrontSystem, ids: Sequence[str], rules: Options
) -> tuple[Ledger, FrontSystem | None, Index, Solution | None]:
    """Return ledger and system without observations, what waits again, and where it was."""
    if not system.doubt:
        with suppress(AdjustmentError):
            after = without(system, ids)
            after = None if after is None else near_minimum(ledger, after, rules)
            if after is not None:
                return ledger, after, NO_ROWS, None
    if system.section is not None:
        with suppress(AdjustmentError):
            whole = Draft.of(ledger, system, rules.datum).adjusted(rules.datum)
            if isinstance(whole, FrontSystem) and whole.base.converged:
                return ledger, whole, NO_ROWS, None
    loose = set() if system.doubt or rules.datum == "free" else loosened(system, ids)
    again = NO_ROWS
    if loose:
        inside = ledger.having("accepted")
        again = Candidates(ledger, Nothing(), inside).touching(loose)
        ledger = ledger.moved(again, "waiting", "undetermined")
    if loose is not None and len(ledger.having("accepted")):
        try:
            found = Draft.of(ledger, system, rules.datum, dropped=loose).adjusted(rules.datum)
        except AdjustmentError:
            found = None
        # Without redundancy there is a minimum, v = 0, where everything is determined.
        if isinstance(found, FrontSystem) and (found.base.converged or found.redundancy):
            return ledger, found, again, None
        if isinstance(found, Failure) and found.loose is None:
            # What is gone may have led everything so far off that nothing leads back from there.
            smaller, anew = adjusted(ledger, rules, None)
            if isinstance(anew, FrontSystem) and anew.base.converged:
                left = np.setdiff1d(ledger.having("accepted"), smaller.having("accepted"))
                return smaller, anew, np.union1d(left, again), None
            stays = without(system, ids) or system
            return ledger, with_doubt(stays, found.reason), again, None
    inside, where = ledger.having("accepted"), system.solution
    if loose is None:
        smaller, found = adjusted(ledger, rules, where)
        if isinstance(found, FrontSystem):
            return smaller, found, np.setdiff1d(inside, smaller.having("accepted")), None
    # What is determined is found out anew.
    ledger = ledger.moved(inside, "waiting", "anew")
    return ledger, None, np.union1d(inside, again), where
