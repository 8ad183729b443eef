"""Observations are taken out, and with them what only they determine."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ..errors import AdjustmentError
from ..solve.solution import Solution
from .candidates import Candidates, Nothing
from .flow import State, Task
from .ledger import Ledger, Some
from .rebasing import Draft, Failure, with_doubt
from .rules import Rules
from .system import System
from .units import Unit


class Out(NamedTuple):
    """What is left to do once observations have been taken out."""

    state: State
    """The state without them."""
    tasks: tuple[Task, ...]
    """Observations to be looked at: the rest of groups, what waits again, what had waited."""
    start: Solution | None
    """Where everything was, if all of it has to be found out anew."""


def take_out(state: State, ids: Sequence[str], rules: Rules, cause: str = "removed") -> Out:
    """Take observations out, wherever they are.

    Args:
        state: the state.
        ids: their ids, and names of weighted unknowns, which lose their weights.
        rules: the options.
        cause: why.
    """
    ledger = state.ledger
    some = ledger.find(ids)
    weights = [i for i in ids if not ledger.has(i)]
    inside = ledger.among(some, "accepted")
    rests, fixed = _rests(ledger, some, set(ids))
    ledger = ledger.moved(some, None, cause)
    rest = Some(tuple(rests), np.zeros(0, dtype=np.intp))
    ledger = ledger.moved(rest, "waiting", "rest of a group", new=True)
    ledger = ledger.without_weights(weights).without_lacks(some)
    start = None
    again = Some.none()
    system = state.system
    if system is not None and (inside or weights):
        firsts = [u.ids[0] for u in inside.units]
        firsts += [state.ledger.rays.name(ledger.names, r) for r in inside.rays.tolist()]
        ledger, system, again, start = _without(
            replace(state, ledger=ledger), system, [*firsts, *weights], rules
        )
    waiting = ledger.having("waiting")
    held = frozenset((*fixed, *ledger.ids_of(again)))
    tasks = [Task(rest.joined(again), held), Task(waiting)]
    return Out(State(ledger, system, settled=False), tuple(t for t in tasks if t.some), start)


def _rests(ledger: Ledger, some: Some, gone: set[str]) -> tuple[list[Unit], list[str]]:
    """Return what remains of correlated groups, and the ids of those that were in the graph."""
    rests: list[Unit] = []
    fixed: list[str] = []
    for unit in some.units:
        if unit.covariance is None:
            continue
        left = unit.without(ledger.network, gone)
        if left is not None:
            rests.append(left)
            if ledger.entries[unit.ids[0]].outcome == "accepted":
                fixed += left.ids
    return rests, fixed


def _without(
    state: State, system: System, ids: Sequence[str], rules: Rules
) -> tuple[Ledger, System | None, Some, Solution | None]:
    """Return ledger and system without observations, what waits again, and where it was."""
    ledger = state.ledger
    if not system.doubt:
        with suppress(AdjustmentError):
            after = system.without(ids)
            after = None if after is None else after.within(rules.accuracy)
            if after is not None:
                return ledger, after, Some.none(), None
    loose = set() if system.doubt or rules.datum == "free" else system.loosened(ids)
    again = Some.none()
    if loose:
        inside = ledger.having("accepted")
        again = Candidates(ledger, Nothing(), inside).touching(loose)
        ledger = ledger.moved(again, "waiting", "undetermined")
    if loose is not None and ledger.having("accepted"):
        try:
            found = Draft.of(ledger, system, rules.datum, dropped=loose).adjusted(rules.datum)
        except AdjustmentError:
            found = None
        # Without redundancy there is a minimum, v = 0, where everything is determined.
        if isinstance(found, System) and (found.base.converged or found.redundancy):
            return ledger, found, again, None
        if isinstance(found, Failure) and found.loose is None:
            stays = system.without(ids) or system
            return ledger, with_doubt(stays, found.reason), again, None
    # What is determined is found out anew.
    inside = ledger.having("accepted")
    ledger = ledger.moved(inside, "waiting", "anew")
    where = system.base.at(system.state)
    return ledger, None, inside.joined(again), where
