"""Readmission of suspects and rejected observations that fit after a command; verdicts on them.

An observation that was left out fits if T² of its innovation (computed from everything accepted −
observed) is below its critical value: first alone, then together with the others that are
readmitted. Several gross errors that agree with one another do not outvote accepted observations,
as each has to fit without the others. The times of examination:

- Suspects after every arrival of which something has entered. All of them are predicted, the latest
  `MAX_SUSPECTS_PREDICTED` where there are more; those whose innovations are within √critical · σ of
  their last tests, beyond which they contradict whatever has entered since, are tested, the nearest
  `MAX_SUSPECTS_TESTED` first; where one is readmitted, the others are tested once more. Rejected
  observations have been decided on: arrivals do not change them.
- All suspects and rejected observations after a command that takes observations out, lets them
  enter or changes them, which may have removed what others contradicted, and at `settle`. Those
  that have lost everything that determined their variables are examined like an arrival. A suspect
  may wait again. A rejected observation is readmitted only where something else tests it, and stays
  rejected otherwise: nothing indicates that the observation it contradicted was the wrong one.
  Suspects that are too nonlinear for a test on linear forms are tested by readjustment
  (`nonlinear_tests`), which takes too long after each arrival.

Data snooping applies its own limit again: after `snoop` no component of a readmitted observation
has a test value |w| beyond the limit of that search, and an observation that a search rejected has
to fit within the limit of that search, too, whenever it is examined. Otherwise another command, or
the next search, would undo a search with a stricter level.

Observations that were discarded by hand, or that have been measured again since, stay out.

"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..ledger.row_store import REMOVED
from ..ledger.verdicts import DISCARDED, SNOOPED, Outcome, Verdict
from ..ledger.waiting_observations import Candidates, known_in
from ..linear_system.predictions import UNANSWERED, InnovationTest, innovation_tests, near_enough
from ..linear_system.rebase import known_network
from ..network.network import Network
from ..quality.group_tests import critical_t2
from ..types import NO_ROWS, Index
from .nonlinear_tests import tested_by_readjustment
from .worklist import IncrementalState, Task, Verdicts, worked_off

MAX_RETESTED_TOGETHER = 50
"""Largest number of observations that are tested again together."""
MAX_SUSPECTS_PREDICTED = 250
"""Largest number of suspects that are predicted after an arrival: the latest ones."""
MAX_SUSPECTS_TESTED = 10
"""Largest number of them that are tested in one round: each needs covariances of its own."""
MAX_READMISSION_ROUNDS = 5
"""Largest number of rounds after one command; each begins with the observations of the last one."""


def readmitted(
    state: IncrementalState,
    known: Verdicts,
    rules: Options,
    *,
    but: Collection[str] = (),
    limit: float = np.inf,
) -> tuple[IncrementalState, Verdicts]:
    """Readmit suspects and rejected observations that fit after a command.

    Args:
        state: the state after a command.
        known: verdicts of the command; observations that it has tested are not examined again.
        rules: the options.
        but: ids of observations that the command has rejected.
        limit: largest |w| of readmitted observations, beside their T².

    Returns:
        The state, and the verdicts of the command and on readmitted observations.
    """
    known = dict(known)
    state, bent = _bent(state, {*known, *but}, rules)
    known |= bent
    tested = {*known, *but}
    for _ in range(MAX_READMISSION_ROUNDS):
        ledger = state.ledger
        rows = np.setdiff1d(_left_out(ledger), ledger.find(tested))
        if not len(rows):
            break
        if state.system is not None and state.system.doubt:
            break
        found = Candidates(ledger, known_in(state.system), rows)
        ready, late = found.ready, found.late
        if state.system is None:
            ready, late = NO_ROWS, rows
        limits = _limits(ledger, rows, limit)
        if len(ready):
            state, ready = _fitting(state, ready, rules, limits)
        state, more = _entered(state, ready, rules, limits)
        # With the policy "accept" nothing is tested that enters with new variables.
        late = late if rules.policy != "accept" else NO_ROWS
        state, other = _entered(state, late, rules, limits)
        back = [i for i, v in (more | other).items() if v.verdict == "accepted"]
        known |= more | other
        if not back:
            break
    return state, known


def readmitted_suspects(
    state: IncrementalState, known: Verdicts, rules: Options
) -> tuple[IncrementalState, Verdicts]:
    """Readmit suspects that fit after an arrival of which something has entered.

    Args:
        state: the state after the arrival.
        known: verdicts of the arrival; observations that it has tested are not examined again.
        rules: the options.

    Returns:
        The state, and the verdicts of the arrival and on readmitted observations.
    """
    known, tested = dict(known), set(known)
    latest = known
    for _ in range(MAX_READMISSION_ROUNDS):
        entered = any(v.verdict == "accepted" for v in latest.values())
        if rules.policy != "flag" or state.system is None or state.system.doubt or not entered:
            break
        ledger = state.ledger
        suspects = np.setdiff1d(ledger.having("suspect"), ledger.find(tested))
        ready = Candidates(ledger, known_in(state.system), suspects).ready
        latest_ready = ready[-MAX_SUSPECTS_PREDICTED:]
        near = near_enough(ledger, state.system, latest_ready)[:MAX_SUSPECTS_TESTED]
        tested.update(ledger.ids_of(near))
        limits = dict.fromkeys(near.tolist(), np.inf)
        state, fits = _fitting(state, near, rules, limits)
        state, latest = _entered(state, fits, rules, limits)
        known |= latest
    return state, known


def _bent(
    state: IncrementalState, tested: Collection[str], rules: Options
) -> tuple[IncrementalState, Verdicts]:
    """Let suspects enter that fit after a readjustment with them, see `nonlinear_tests`."""
    ledger = state.ledger
    suspects = np.setdiff1d(ledger.having("suspect"), ledger.find(tested))
    if not len(suspects) or (system := state.fronts) is None:
        return state, {}
    ledger, system, known = tested_by_readjustment(ledger, system, suspects, rules, ())
    if not known:
        return state, {}
    return IncrementalState(ledger, system, settled=False), {v.id: v for v in known}


def remeasured(ledger: Ledger, chosen: Index) -> Index:
    """Return those of some image points whose points have been measured in their photos since."""
    rows = ledger.rows
    rays, every = rows.images(chosen), rows.images(np.flatnonzero(rows.status != REMOVED))
    pairs = zip(rows.photo[every].tolist(), rows.point[every].tolist(), strict=True)
    last = dict(zip(pairs, every.tolist(), strict=True)) if len(rays) else {}
    since = [last[int(rows.photo[r]), int(rows.point[r])] != r for r in rays.tolist()]
    return np.asarray(rays[np.array(since, dtype=bool)])


def _left_out(ledger: Ledger) -> Index:
    """Return suspects and rejected observations that may be readmitted."""
    rejected = ledger.having("rejected")
    by_hand = [
        row
        for row in rejected.tolist()
        if any(v.cause == DISCARDED for v in ledger.rows.verdicts.get(row, ()))
    ]
    rejected = np.setdiff1d(rejected, [*by_hand, *remeasured(ledger, rejected).tolist()])
    return np.union1d(ledger.having("suspect"), rejected).astype(np.intp)


def tested_now(state: IncrementalState, rules: Options) -> list[Verdict]:
    """Return the verdicts on suspects and rejected observations with present tests.

    Each is tested alone against everything that is accepted by now. Observations without a test, as
    their variables are not determined or retired, or as the datum of a free network alone controls
    them, have no verdict here.
    """
    ledger, system = state.ledger, state.system
    if system is None or system.doubt:
        return []
    left_out = np.union1d(ledger.having("suspect"), ledger.having("rejected")).astype(np.intp)
    rows = Candidates(ledger, known_in(system), left_out).ready
    out: list[Verdict] = []
    for test in innovation_tests(ledger, system, rows, rules.alpha):
        verdicts = ledger.rows.verdicts.get(test.row, ())
        sizes = [len(v.components) for v in verdicts]
        if not test.answered or sum(sizes) != len(test.innovation):
            continue
        dof = len(test.innovation)
        critical = critical_t2(rules.alpha, dof)
        figures = np.stack(
            (test.innovation, test.sigma, test.of_components, test.redundancy_numbers)
        )
        parts = np.split(figures, np.cumsum(sizes)[:-1], axis=1)
        for v, (innovation, sigma, w, redundancy_numbers) in zip(verdicts, parts, strict=True):
            tested = {"innovation": innovation, "sigma": sigma, "w": w, "dof": dof}
            tested |= {"redundancy_numbers": redundancy_numbers}
            tested |= {"t2": test.ratio * critical, "critical": critical}
            out.append(replace(v, **tested))
    return out


def with_what_was_left_out(state: IncrementalState) -> Network:
    """Return the network with all suspects and rejected observations that may be readmitted."""
    ledger = state.ledger
    rows = Candidates(ledger, known_in(state.system), _left_out(ledger)).ready
    return known_network(ledger.moved(rows, "accepted", "causes"), state.system)


def _limits(ledger: Ledger, rows: Index, limit: float) -> Mapping[int, float]:
    """Return the largest |w| with which each of some observations is readmitted, by rows."""
    out = {}
    for row in rows.tolist():
        former = ledger.rows.verdicts.get(row, ())
        own = (float(np.sqrt(v.critical)) for v in former if v.cause == SNOOPED)
        out[row] = min([limit, *(x for x in own if x > 0.0)])
    return out


def _fitting(
    state: IncrementalState, rows: Index, rules: Options, limits: Mapping[int, float]
) -> tuple[IncrementalState, Index]:
    """Return those of some observations between known variables that fit, each alone.

    Verdicts on observations without a test say so, as long as they have none.
    """
    assert state.system is not None
    ledger = state.ledger
    tests = list(innovation_tests(ledger, state.system, rows, rules.alpha))
    for test in tests:
        verdicts = ledger.rows.verdicts.get(test.row, ())
        doubted = {v.id: replace(v, doubt=_doubt(v, test)) for v in verdicts}
        if any(doubted[v.id].doubt != v.doubt for v in verdicts):
            outcome = verdicts[0].verdict
            ledger = ledger.moved(np.array([test.row]), outcome, "tested again", doubted)
    fits = [t.row for t in tests if t.ratio <= 1.0 and t.w <= limits[t.row]]
    return replace(state, ledger=ledger), np.array(fits, dtype=np.intp)


def _doubt(verdict: Verdict, test: InnovationTest) -> str:
    """Return the doubt of a verdict after a test of its observation."""
    if test.answered:
        return "" if verdict.doubt == UNANSWERED else verdict.doubt
    return verdict.doubt or UNANSWERED


# -- entry ----------------------------------------------------------------------------------------


def _entered(
    state: IncrementalState, rows: Index, rules: Options, limits: Mapping[int, float]
) -> tuple[IncrementalState, Verdicts]:
    """Let left-out observations enter; return the state, and verdicts.

    Those that do not enter keep their outcome, with their first verdicts. Those beyond their
    limits, and rejected ones that nothing tests, are left out; the others enter without them.
    """
    before = state.ledger
    rejected = before.having("rejected")
    while len(rows):
        ledger = before.moved(rows, "waiting", "tested again")
        parts = np.array_split(rows, -(-len(rows) // MAX_RETESTED_TOGETHER))
        after, known = worked_off(replace(state, ledger=ledger), [Task(p) for p in parts], rules)
        thrown = np.intersect1d(rows, rejected)
        waits = after.ledger.rows.among(thrown, "waiting").tolist()
        inside = after.ledger.rows.among(rows, "accepted")
        verdicts = {r: [known[i] for i in before.ids_of(np.array([r]))] for r in inside.tolist()}
        beyond = [r for r, own in verdicts.items() if any(_largest(v) > limits[r] for v in own)]
        untested = [
            r for r in thrown.tolist() if not all(v.controlled for v in verdicts.get(r, ()))
        ]
        if not (waits or beyond or untested):
            return _as_before(before, after, rows, known)
        rows = np.setdiff1d(rows, [*waits, *beyond, *untested])
    return state, {}


def _largest(verdict: Verdict) -> float:
    """Return the largest |w| of a verdict; 0 where nothing is tested."""
    return 0.0 if verdict.w is None else float(np.max(np.nan_to_num(np.abs(verdict.w))))


def _as_before(
    before: Ledger, after: IncrementalState, rows: Index, known: Verdicts
) -> tuple[IncrementalState, Verdicts]:
    """Restore outcomes and first verdicts of observations that have failed again."""
    ledger = after.ledger
    failed = np.union1d(ledger.rows.among(rows, "suspect"), ledger.rows.among(rows, "rejected"))
    outcomes: tuple[Outcome, ...] = ("suspect", "rejected")
    for outcome in outcomes:
        mine = np.intersect1d(failed, before.having(outcome))
        first: dict[str, Verdict] = {
            v.id: v for row in mine.tolist() for v in before.rows.verdicts.get(row, ())
        }
        ledger = ledger.moved(mine, outcome, "tested again", first)
    ids = set(ledger.ids_of(failed))
    own = set(ledger.ids_of(rows))
    fresh = {i: replace(v, entered=v.entered or i in own) for i, v in known.items() if i not in ids}
    return replace(after, ledger=ledger), fresh
