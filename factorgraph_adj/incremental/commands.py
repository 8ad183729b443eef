"""Commands on an incremental state: add, remove, replace, reweight, snoop, settle.

Each is a function of a state, and returns another state and its result. After a removal, unknowns
that only the removed observations determined wait again.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from ..entities import parameter_name
from ..errors import AdjustmentError, InputError, Problem
from ..graph.dependence import Variable, components
from ..graph.keys import KeyMap
from ..graph.observation_selection import weighted_unknowns
from ..graph.partials_check import refuse_wrong_partials
from ..graph.user_factors import FactorModel, observation_of
from ..graph.variables import Unknowns
from ..ledger.command_input import Input, Options, ids_in, listed
from ..ledger.ledger import Ledger
from ..ledger.row_store import OUTCOME_CODE
from ..ledger.verdicts import REST, SNOOPED
from ..ledger.waiting_observations import Candidates, NothingKnown, known_in
from ..linear_system import engines
from ..linear_system.arrival_decisions import untested
from ..linear_system.engines import determined_only_by, downdated
from ..linear_system.front_system import FrontSystem
from ..linear_system.rebase import Draft, NoMinimum, solution_of, with_doubt
from ..linear_system.section_choice import in_pieces
from ..network.network import Network
from ..observations import Observation
from ..observations.ids import named
from ..observations.user_factor import OwnFactor
from ..quality.rejections import Snooping
from ..quality.snooping import snoop
from ..solve.solution import Solution
from ..types import NO_ROWS, Index
from .arrival import Arrival, arrival_of
from .initial_adjustment import adjusted, settled
from .readmission import readmitted, readmitted_suspects
from .worklist import IncrementalState, Task, Verdicts, worked_off

MAX_WEIGHT_FACTOR = 1e12
"""Largest factor by which a weight may be multiplied; its inverse is the smallest."""
WEIGHT_OF_GIVEN_VALUE = (
    "is a given value with its own σ, and not an observation: remove it, and observe the unknown "
    "with the intended σ (ControlPoint for a point)"
)
MAX_SETTLING_ROUNDS = 5
"""Largest number of times that waiting observations are examined before everything has
converged."""


class Removal(NamedTuple):
    """What remains to be done after observations have been taken out."""

    state: IncrementalState
    """The state without them."""
    tasks: tuple[Task, ...]
    """Observations to be examined: the rest of groups, what waits again, what had waited."""
    start: Solution | None
    """The solution before, if determinability has to be examined again from the beginning."""


def remove_observations(
    state: IncrementalState, ids: Sequence[str], rules: Options, cause: str = "removed"
) -> Removal:
    """Take observations out, whatever their outcome.

    Args:
        state: the state.
        ids: their ids, and names of weighted unknowns, which lose their weights.
        rules: the options.
        cause: the cause, for their verdicts.
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
    verdicts = {v.id: v for u in ledger.units(out) for v in untested(u, "rejected", cause=REST)}
    ledger = ledger.moved(out, "rejected", REST, verdicts)
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
                ledger, smaller, again, start = _ledger_without(ledger, fronts, gone, rules)
        system = smaller
    held = np.union1d(fixed, again)
    tasks = [Task(np.union1d(rest, again), held), Task(ledger.having("waiting"))]
    after = IncrementalState(ledger, system, settled=False)
    return Removal(after, tuple(t for t in tasks if len(t.rows)), start)


def _ledger_without(
    ledger: Ledger, system: FrontSystem, ids: Sequence[str], rules: Options
) -> tuple[Ledger, FrontSystem | None, Index, Solution | None]:
    """Return ledger and system without observations that no update can remove from the system.

    Returns:
        Ledger and system, what waits again, and the solution before if that is examined again.
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
        # Without redundancy there is a minimum, v = 0, wherever everything is determined.
        if isinstance(found, FrontSystem) and (found.converged or found.redundancy):
            return ledger, found, again, None
        if isinstance(found, NoMinimum) and found.loose is None:
            # The removed observations may have moved the state too far for the others to move it
            # back.
            smaller, restarted = adjusted(ledger, rules, None)
            if isinstance(restarted, FrontSystem) and restarted.converged:
                left = np.setdiff1d(ledger.having("accepted"), smaller.having("accepted"))
                return smaller, restarted, np.union1d(left, again), None
            stays = downdated(system, ids) or system
            return ledger, with_doubt(stays, found.reason), again, None
    inside, where = ledger.having("accepted"), system.solution
    if loose is None:
        smaller, found = adjusted(ledger, rules, where)
        if isinstance(found, FrontSystem):
            return smaller, found, np.setdiff1d(inside, smaller.having("accepted")), None
    # Determinability is examined again.
    ledger = ledger.moved(inside, "waiting", "anew")
    return ledger, None, np.union1d(inside, again), where


def at_time(state: IncrementalState, time: float | None, rules: Options) -> IncrementalState:
    """Return the state at the time of an arrival; None: that of the latest arrival.

    Raises:
        InputError: the time is wrong, or no option uses it, or the first arrival lacks it.
    """
    looks = rules.keep_seconds is not None
    if time is not None and not looks:
        raise InputError("time= needs keep_seconds, which this adjustment does not have")
    if time is not None:
        return replace(state, ledger=state.ledger.at(time))
    if looks and state.ledger.time is None:
        what = "keep_seconds needs the time of arrivals, at least that of the first"
        raise InputError(f"{what}: add(…, time=SECONDS)")
    return state


def add(state: IncrementalState, given: Input, rules: Options) -> tuple[IncrementalState, Arrival]:
    """Take observations, points, photos, cameras and other unknowns in.

    Raises:
        InputError: all their problems.
    """
    ledger = state.ledger
    observations, points = given.observations, given.points
    if given.describes:
        ledger = ledger.with_entities(points, given.photos, given.cameras, given.unknowns)
    if given.factors:
        described = ledger.everything
        made = [observation_of(name, make, described) for name, make in given.factors.items()]
        observations = [*observations, *made]
    ledger, rows = ledger.taken(observations)
    there = 0 if state.system is None else state.system.n_rays
    pieces = in_pieces(ledger, there, rows)
    tasks = [Task(piece, asked=True) for piece in pieces]
    if placed := [("point", p.name) for p in points if p.name in state.ledger.network.points]:
        waiting = Candidates(ledger, known_in(state.system), state.ledger.having("waiting"))
        tasks.append(Task(waiting.touching(placed)))
    after, verdicts = worked_off(replace(state, ledger=ledger), tasks, rules, growing=True)
    after, verdicts = readmitted_suspects(after, verdicts, rules)
    if given.factors:
        _refuse_wrong_partials(after, made, Unknowns(described), rules)
    after = _with_weighted(after, given.variables, rules)
    return after, arrival_of(state, after, verdicts, ledger.ids_of(rows), "add")


def _refuse_wrong_partials(
    state: IncrementalState, made: Sequence[OwnFactor], keyed: Unknowns, rules: Options
) -> None:
    """Refuse factors whose Jacobians contradict their errors, if their variables are known."""
    if state.system is None:
        return
    solution = solution_of(state.ledger, state.system, rules)
    unknowns = solution.equations.unknowns
    joined = {
        o.id or "": o.model.factor
        for o in made
        if isinstance(o.model, FactorModel)
        and o.model.factor is not None
        and all(parameter_name(key) in unknowns[kind].number for kind, key in o.unknowns)
    }
    refuse_wrong_partials(joined, solution.equations, solution.state, KeyMap(keyed))


def remove(
    state: IncrementalState, ids: str | Iterable[str], rules: Options
) -> tuple[IncrementalState, Arrival]:
    """Take observations out, whatever their outcome.

    Raises:
        InputError: all ids that do not exist.
    """
    weights = weighted_unknowns(state.ledger.network)
    after, verdicts = without(state, known_ids(state, ids_in(ids), weights), rules)
    after, verdicts = readmitted(after, verdicts, rules)
    return after, arrival_of(state, after, verdicts, (), "remove")


def replace_observation(
    state: IncrementalState, ident: str, observation: Observation, rules: Options
) -> tuple[IncrementalState, Arrival]:
    """Put a new observation in the place of another, under the same id.

    Raises:
        InputError: no such id, or problems of the observation.
    """
    known_ids(state, ids_in([ident]))
    (observation,) = listed([observation], "single observation", Observation)
    out = remove_observations(state, [ident], rules, "replaced")
    ledger, rows = out.state.ledger.taken([named(observation, ident)])
    tasks = [Task(rows, asked=True), *out.tasks]
    begun = replace(out.state, ledger=ledger)
    after, verdicts = worked_off(begun, tasks, rules, start=out.start)
    after, verdicts = readmitted(after, verdicts, rules)
    return after, arrival_of(state, after, verdicts, [ident], "replace")


def reweight(
    state: IncrementalState, ids: str | Iterable[str], factor: float, rules: Options
) -> tuple[IncrementalState, Arrival]:
    """Multiply the weights of observations by a factor; those that were left out are tested again.

    Raises:
        InputError: unknown ids, or a bad factor.
    """
    wanted = known_ids(state, ids_in(ids))
    if not isinstance(factor, Real) or not 1.0 / MAX_WEIGHT_FACTOR <= factor <= MAX_WEIGHT_FACTOR:
        least = f"{1 / MAX_WEIGHT_FACTOR:g}"
        what = f"the factor of weights must be between {least} and {MAX_WEIGHT_FACTOR:g}"
        raise InputError(f"{what}, not {factor!r}")
    before = state.ledger
    rows = before.find(wanted)
    every = before.ids_of(rows)
    by = 1.0 / factor**0.5
    scaled = [u.scaled(by) for u in before.units(rows)]
    out = remove_observations(state, every, rules, "reweighted")
    ledger, again = out.state.ledger.taken(scaled)
    fixed = again[before.rows.status[rows] == OUTCOME_CODE["accepted"]]
    tasks = [Task(again, fixed, asked=True), *out.tasks]
    begun = replace(out.state, ledger=ledger)
    after, verdicts = worked_off(begun, tasks, rules, start=out.start)
    after, verdicts = readmitted(after, verdicts, rules)
    return after, arrival_of(state, after, verdicts, every, "reweight")


def reject(
    state: IncrementalState, ids: Sequence[str], rules: Options, limit: float
) -> tuple[IncrementalState, Arrival]:
    """Reject what data snooping found; weighted unknowns lose their weights.

    Args:
        state: the state.
        ids: ids of observations, and names of weighted unknowns.
        rules: the options.
        limit: limit of |w| in that search.
    """
    ledger = state.ledger
    rows = ledger.find(ids)
    every, units = ledger.ids_of(rows), ledger.units(rows)
    weights = ledger.missing(ids)
    after, verdicts = without(state, [*every, *weights], rules, cause=SNOOPED)
    taken, again = after.ledger.taken([u.item for u in units])
    own = (v for u in units for v in untested(u, "rejected", cause=SNOOPED))
    rejected = {v.id: replace(v, critical=limit**2) for v in own}
    after = replace(after, ledger=taken.moved(again, "rejected", SNOOPED, rejected))
    after, verdicts = readmitted(after, verdicts, rules, but=every, limit=limit)
    return after, arrival_of(state, after, verdicts, (), "snoop")


def snooped(
    state: IncrementalState,
    network: Network,
    solution: Solution,
    rules: Options,
    options: Mapping[str, Any],
) -> tuple[IncrementalState, Arrival, Snooping]:
    """Search a whole network for gross errors; reject the observations found.

    Args:
        state: the state.
        network: its network.
        solution: its solution.
        rules: the options of the adjustment.
        options: those of `factorgraph_adj.snoop`.
    """
    found = snoop(network, start=solution, **options)
    ids = [r.id for r in found.rejected]
    ids += [i for p in found.rejected_points for i in p.rays]
    if not ids:
        return state, Arrival(), found
    limit = found.critical * (found.solution.sigma0 if found.test == "pope" else 1.0)
    return *reject(state, list(dict.fromkeys(ids)), rules, limit), found


def settle(state: IncrementalState, rules: Options) -> tuple[IncrementalState, Arrival]:
    """Iterate to convergence, and examine again all waiting and left-out observations."""
    after, verdicts = settled(state, rules), Verdicts()
    for _ in range(MAX_SETTLING_ROUNDS):
        waiting = after.ledger.having("waiting")
        if not len(waiting):
            break
        after, more = worked_off(after, [Task(waiting)], rules)
        verdicts |= more
        if not after.settled:
            after = settled(after, rules)
        if len(after.ledger.having("waiting")) == len(waiting):
            break
    after, verdicts = readmitted(after, verdicts, rules)
    if not after.settled:
        after = settled(after, rules)
    return after, arrival_of(state, after, verdicts, (), "settle")


def without(
    state: IncrementalState, ids: Sequence[str], rules: Options, *, cause: str = "removed"
) -> tuple[IncrementalState, Verdicts]:
    """Take observations out, and process what remains to be examined."""
    out = remove_observations(state, ids, rules, cause)
    return worked_off(out.state, out.tasks, rules, start=out.start)


# -- helpers --------------------------------------------------------------------------------------


def known_ids(
    state: IncrementalState, ids: Sequence[str], weights: Collection[str] = ()
) -> list[str]:
    """Return ids without repetition.

    Args:
        state: the state.
        ids: ids of observations.
        weights: names of weighted unknowns, which may be among them.

    Raises:
        InputError: all ids that do not exist.
    """
    wanted = list(dict.fromkeys(ids))
    missing = [i for i in state.ledger.missing(wanted) if i not in weights]
    if missing:
        stated = weighted_unknowns(state.ledger.network)
        raise InputError(
            Problem(WEIGHT_OF_GIVEN_VALUE, f"weighted {i}")
            if i in stated
            else state.ledger.unknown(i)
            for i in missing
        )
    return wanted


def _with_weighted(
    state: IncrementalState, new: Sequence[Variable], rules: Options
) -> IncrementalState:
    """Return the state in which those of new unknowns are known that weights determine."""
    system, network = state.system, state.ledger.network
    if system is None:
        return state
    for v in new:
        if v[0] == "calibration" and network.cameras[v[1]].per_photo:
            continue
        free, weighted = components(network, v)
        if 0 < free == weighted and not system.known(*v):
            break
    else:
        return state
    draft = Draft.of(state.ledger, system, rules.datum)
    found = draft.adjusted(rules.datum, doubted=bool(system.doubt))
    return (
        IncrementalState(state.ledger, found, settled=False)
        if isinstance(found, FrontSystem)
        else state
    )
