"""Removal of observations; unknowns that they alone determined wait again."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..ledger.candidates import Candidates, NothingKnown
from ..ledger.ledger import Ledger
from ..ledger.options import Options
from ..ledger.verdicts import REST
from ..linear_system import engines
from ..linear_system.arrival_decisions import untested
from ..linear_system.engines import determined_only_by, downdated
from ..linear_system.front_system import FrontSystem
from ..linear_system.rebase import Draft, NoMinimum, with_doubt
from ..solve.solution import Solution
from ..types import NO_ROWS, Index
from .initial_adjustment import adjusted
from .worklist import IncrementalState, Task


class Removal(NamedTuple):
    """What is left to do once observations have been taken out."""

    state: IncrementalState
    """The state without them."""
    tasks: tuple[Task, ...]
    """Observations to be looked at: the rest of groups, what waits again, what had waited."""
    start: Solution | None
    """Where everything was, if all of it has to be found out anew."""


def remove_observations(
    state: IncrementalState, ids: Sequence[str], rules: Options, cause: str = "removed"
) -> Removal:
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
        gone = [*firsts, *weights]
        smaller = engines.reduced(system, gone, ledger, rules)
        if smaller is None and (fronts := state.fronts) is not None:
            if fronts is not system:
                smaller = engines.reduced(fronts, gone, ledger, rules)
            if smaller is None:
                ledger, smaller, again, start = _without(ledger, fronts, gone, rules)
        system = smaller
    held = np.union1d(fixed, again)
    tasks = [Task(np.union1d(rest, again), held), Task(ledger.having("waiting"))]
    after = IncrementalState(ledger, system, settled=False)
    return Removal(after, tuple(t for t in tasks if len(t.rows)), start)


def _without(
    ledger: Ledger, system: FrontSystem, ids: Sequence[str], rules: Options
) -> tuple[Ledger, FrontSystem | None, Index, Solution | None]:
    """Return ledger and system without observations that no update can take out of it.

    Returns:
        Ledger and system, what waits again, and where everything was if that is found out again.
    """
    if system.section is not None:
        with suppress(AdjustmentError):
            whole = Draft.of(ledger, system, rules.datum).adjusted(rules.datum)
            if isinstance(whole, FrontSystem) and whole.converged:
                return ledger, whole, NO_ROWS, None
    loose = set() if system.doubt or rules.datum == "free" else determined_only_by(system, ids)
    again = NO_ROWS
    if loose:
        inside = ledger.having("accepted")
        again = Candidates(ledger, NothingKnown(), inside).touching(loose)
        ledger = ledger.moved(again, "waiting", "undetermined")
    if loose is not None and len(ledger.having("accepted")):
        try:
            found = Draft.of(ledger, system, rules.datum, dropped=loose).adjusted(rules.datum)
        except AdjustmentError:
            found = None
        # Without redundancy there is a minimum, v = 0, where everything is determined.
        if isinstance(found, FrontSystem) and (found.converged or found.redundancy):
            return ledger, found, again, None
        if isinstance(found, NoMinimum) and found.loose is None:
            # What is gone may have led everything so far off that nothing leads back from there.
            smaller, anew = adjusted(ledger, rules, None)
            if isinstance(anew, FrontSystem) and anew.converged:
                left = np.setdiff1d(ledger.having("accepted"), smaller.having("accepted"))
                return smaller, anew, np.union1d(left, again), None
            stays = downdated(system, ids) or system
            return ledger, with_doubt(stays, found.reason), again, None
    inside, where = ledger.having("accepted"), system.solution
    if loose is None:
        smaller, found = adjusted(ledger, rules, where)
        if isinstance(found, FrontSystem):
            return smaller, found, np.setdiff1d(inside, smaller.having("accepted")), None
    # What is determined is found out anew.
    ledger = ledger.moved(inside, "waiting", "anew")
    return ledger, None, np.union1d(inside, again), where
