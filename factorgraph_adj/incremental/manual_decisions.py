"""Decisions by hand about observations: accept, discard, and revoke, which takes the last one back.

A decision replaces the verdict on an observation, and the new verdict keeps it (``former``). What
comes back because of a decision keeps its own as well, with the decision (``following``): the ids
of the observations that were decided on, and how many decisions about each stood then. `revoke`
restores all of them, so that the state is the one without the decision, as far as nothing else has
changed since. While a later decision about something that came back stands, it is refused.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from ..errors import InputError, Problem
from ..ledger.command_input import Options, ids_in
from ..ledger.ledger import Ledger
from ..ledger.row_store import OUTCOME_CODE
from ..ledger.verdicts import DISCARDED, Outcome, Verdict
from ..linear_system.arrival_decisions import untested
from ..types import NO_ROWS, Index
from .arrival import Arrival, arrival_of
from .commands import without
from .readmission import readmitted, remeasured
from .worklist import IncrementalState, Task, Verdicts, worked_off

BY_HAND = "accepted by hand"
"""Cause of changes of observations that a person has accepted."""
REVOKED = "revoked"
"""Cause of changes of observations about which a decision was taken back."""


def accept(
    state: IncrementalState, ids: str | Iterable[str], rules: Options
) -> tuple[IncrementalState, Arrival]:
    """Let suspects or rejected observations enter without regard to their tests.

    Raises:
        InputError: all ids that are neither.
    """
    ledger, wanted = state.ledger, ids_in(ids)
    _refuse_others(ledger, wanted, ("suspect", "rejected"), "is neither suspect nor rejected")
    rows = ledger.find(wanted)
    _refuse_remeasured(ledger, rows)
    after, verdicts = _entered(state, rows, rules)
    after, verdicts = readmitted(after, verdicts, rules)
    every = ledger.ids_of(rows)
    after = _noted(state, after, rows, rows)
    return after, arrival_of(state, after, verdicts, every, "accept")


def discard(
    state: IncrementalState, ids: str | Iterable[str], rules: Options
) -> tuple[IncrementalState, Arrival]:
    """Reject suspects and accepted observations; others that fit then are readmitted.

    Raises:
        InputError: all ids that are neither.
    """
    ledger, wanted = state.ledger, ids_in(ids)
    _refuse_others(ledger, wanted, ("suspect", "accepted"), "is neither suspect nor accepted")
    rows = ledger.find(wanted)
    every = ledger.ids_of(rows)
    formers = [v for row in rows.tolist() for v in _verdicts(ledger, row)]
    rejected = {
        v.id: replace(v, verdict="rejected", cause=DISCARDED, former=v, following=())
        for v in formers
    }
    inside = ledger.rows.among(rows, "accepted")
    out = ledger.moved(np.setdiff1d(rows, inside), "rejected", DISCARDED, rejected)
    after, verdicts = replace(state, ledger=out), Verdicts()
    if len(inside):
        after, verdicts = _left(after, inside, rejected, rules, DISCARDED)
        after, verdicts = readmitted(after, verdicts, rules, but=every)
        after = _noted(state, after, NO_ROWS, rows)
    return after, arrival_of(state, after, verdicts | rejected, every, "discard")


def revoke(
    state: IncrementalState, ids: str | Iterable[str], rules: Options
) -> tuple[IncrementalState, Arrival]:
    """Take the last decisions by hand about observations back, with what came back after them.

    Raises:
        InputError: all ids about which no decision by hand stands, and with which something came
            back about which a later decision stands; image points that have been measured again.
    """
    ledger, wanted = state.ledger, ids_in(ids)
    rows = ledger.find(wanted)
    every = ledger.ids_of(rows)
    there = decided(ledger)
    what = "no decision by hand about it stands that could be taken back"
    if problems := [
        Problem(ledger.retirement_note(i) or what, f"observation {i!r}")
        for i in wanted
        if i not in there
    ]:
        raise InputError(problems)
    recorded = ledger.rows.verdicts
    last = {(v.id, _layers(v)) for r in rows.tolist() for v in recorded[r]}
    _refuse_decided_later(ledger, last)
    following = [r for r, own in recorded.items() if last.intersection(own[0].following)]
    both = np.union1d(rows, np.array(following, dtype=np.intp))
    formers = {v.id: v.former for r in both.tolist() for v in recorded[r] if v.former is not None}
    outcomes = {r: formers[recorded[r][0].id].verdict for r in both.tolist()}
    enters = np.array([r for r, was in outcomes.items() if was == "accepted"], dtype=np.intp)
    leaves = ledger.rows.among(both, "accepted")
    _refuse_remeasured(ledger, enters)
    for row in np.setdiff1d(both, [*enters.tolist(), *leaves.tolist()]).tolist():
        ledger = ledger.moved(np.array([row]), outcomes[row], REVOKED, formers)
    after, verdicts = replace(state, ledger=ledger), Verdicts()
    if len(enters):
        # Before others leave: they may have its variables.
        after, verdicts = _entered(after, enters, rules)
        inside = after.ledger.rows.among(enters, "accepted")
        deeper = {i: v for i, v in formers.items() if v.former is not None}
        after = _marked(after, inside, deeper)
    if len(leaves):
        after, more = _left(after, leaves, formers, rules, REVOKED)
        verdicts |= more
    # Others that came meanwhile may fit again.
    after, verdicts = readmitted(after, verdicts, rules, but=ledger.ids_of(both))
    told = {i: v for i, v in formers.items() if v.verdict != "accepted"}
    return after, arrival_of(state, after, verdicts | told, every, "revoke")


def decided(ledger: Ledger) -> frozenset[str]:
    """Return the ids of the observations about which a decision by hand stands."""
    return frozenset(
        v.id
        for own in ledger.rows.verdicts.values()
        for v in own
        if v.former is not None and not v.following
    )


# -- helpers --------------------------------------------------------------------------------------


def _refuse_others(
    ledger: Ledger, wanted: Sequence[str], outcomes: Sequence[Outcome], what: str
) -> None:
    """Refuse ids of observations with other outcomes."""
    problems = [
        Problem(ledger.retirement_note(i) or what, f"observation {i!r}")
        for i in wanted
        if ledger.status(i) not in outcomes
    ]
    if problems:
        raise InputError(problems)


def _refuse_remeasured(ledger: Ledger, rows: Index) -> None:
    """Refuse rejected image points that have been measured again since."""
    what = "the point has been measured in this photo again since"
    again = ledger.ids_of(remeasured(ledger, rows))
    if again:
        raise InputError(Problem(what, f"observation {name!r}") for name in again)


def _layers(verdict: Verdict) -> int:
    """Return how many decisions have replaced verdicts on an observation."""
    number = 0
    while (before := verdict.former) is not None:
        verdict, number = before, number + 1
    return number


def _refuse_decided_later(ledger: Ledger, last: set[tuple[str, int]]) -> None:
    """Refuse decisions with which something came back about which a later decision stands.

    Args:
        ledger: the ledger.
        last: ids of observations, and how many decisions about each stand.
    """
    problems = []
    for own in ledger.rows.verdicts.values():
        below = own[0].former
        while below is not None:
            for ident, _ in last.intersection(below.following):
                what = f"{own[0].id!r} came back with it, and a later decision about that stands: "
                what += "take that back first"
                problems.append(Problem(what, f"observation {ident!r}"))
            below = below.former
    if problems:
        raise InputError(problems)


def _verdicts(ledger: Ledger, row: int) -> Sequence[Verdict]:
    """Return the verdicts on a row; those on an accepted one have no figures."""
    return ledger.rows.verdicts.get(row) or untested(ledger.unit(row), "accepted")


def _entered(
    state: IncrementalState, rows: Index, rules: Options
) -> tuple[IncrementalState, Verdicts]:
    """Let observations enter without a test."""
    waiting = replace(state, ledger=state.ledger.moved(rows, "waiting", BY_HAND))
    return worked_off(waiting, [Task(rows, rows, asked=True)], rules)


def _left(
    state: IncrementalState,
    rows: Index,
    verdicts: Verdicts,
    rules: Options,
    cause: str,
) -> tuple[IncrementalState, Verdicts]:
    """Let accepted observations leave; they get the outcomes of given verdicts.

    Systems know their observations by id, and ledgers by row: they come as new rows.
    """
    units = state.ledger.units(rows)
    after, tested = without(state, [i for u in units for i in u.ids], rules, cause=cause)
    ledger, again = after.ledger.taken([u.item for u in units])
    for row, unit in zip(again.tolist(), units, strict=True):
        own = verdicts[unit.ids[0]]
        ledger = ledger.moved(np.array([row]), own.verdict, own.cause or cause, verdicts)
    return replace(after, ledger=ledger), tested


def _noted(
    before: IncrementalState, after: IncrementalState, rows: Index, decided_on: Index
) -> IncrementalState:
    """Return a state in which accepted observations keep the verdicts that a decision replaced.

    Args:
        before: the state before the decision.
        after: the state with what it has let in.
        rows: rows of the observations that were accepted by hand.
        decided_on: rows of the observations that were decided on.
    """
    was = before.ledger.rows
    decision = tuple(
        (v.id, _layers(v) + 1) for r in decided_on.tolist() for v in _verdicts(before.ledger, r)
    )
    out = np.isin(was.status, [OUTCOME_CODE["suspect"], OUTCOME_CODE["rejected"]])
    inside = after.ledger.rows.among(np.flatnonzero(out), "accepted")
    marks: Verdicts = {}
    for row in inside.tolist():
        following = () if row in rows else decision
        for v in was.verdicts.get(row, ()):
            mark = replace(v, verdict="accepted", cause="", former=v, following=following)
            marks[v.id] = mark
    return _marked(after, inside, marks)


def _marked(state: IncrementalState, rows: Index, verdicts: Verdicts) -> IncrementalState:
    """Return a state with verdicts on accepted observations; the causes of changes stay."""
    ledger = state.ledger
    marked = ledger.moved(rows, "accepted", BY_HAND, verdicts)
    return replace(state, ledger=replace(marked, causes=ledger.causes))
