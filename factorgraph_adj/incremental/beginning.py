"""The state at the start, and after a journal has been read."""

from __future__ import annotations

from contextlib import suppress

from ..errors import AdjustmentError
from ..graph.variables import calibration_name
from ..solve.batch import adjust_from
from ..solve.solution import Solution
from .candidates import Candidates, Nothing
from .finding import counted, determined
from .flow import State, Task, absorb
from .joining import rays_alone
from .ledger import Ledger, Some
from .rebasing import EFFORT, Draft, Failure
from .rules import Rules
from .system import System
from .units import Variable, components

MOST_LET_GO = 5
"""Largest number of adjustments at the start, each without points that the one before named."""


def begin(ledger: Ledger, rules: Rules, start: Solution | None) -> State:
    """Put a network's own observations in, without a test; what they do not determine waits.

    Args:
        ledger: everything, all of it accepted.
        rules: the options.
        start: a solution of the network, or of one like it.
    """
    inside = ledger.having("accepted")
    if not inside:
        return State(ledger)
    stay = counted(Candidates(ledger, Nothing(), inside), {}).some
    for _ in range(MOST_LET_GO):
        tried = ledger.moved(inside.less(stay), "waiting", "undetermined")
        system = _adjusted(tried, stay, rules, start) if stay else None
        if isinstance(system, System):
            return _entered(State(tried, system, settled=False), inside, rules)
        named = system.loose if isinstance(system, Failure) else None
        fewer = stay.less(rays_alone(tried, named or ()))
        if len(fewer.rays) == len(stay.rays):
            break
        stay = fewer
    stay = determined(Candidates(ledger, Nothing(), inside), datum=rules.datum)
    loose = inside.less(stay)
    if loose:
        ledger = ledger.moved(loose, "waiting", "undetermined")
        if stay:
            system = _adjusted(ledger, stay, rules, start)
    if stay and not isinstance(system, System):
        system = _at_its_start(ledger, stay, rules, start, system)
    if stay and system is None:
        ledger = ledger.moved(stay, "waiting", "undetermined")
    state = State(ledger, system if isinstance(system, System) else None, settled=False)
    return _entered(state, inside, rules)


def _entered(state: State, inside: Some, rules: Rules) -> State:
    """Let what waits of a network's own observations enter, if it can."""
    state = _with_values(state)
    waiting = state.ledger.having("waiting")
    if waiting:
        fixed = frozenset(state.ledger.ids_of(inside))
        state, _ = absorb(state, [Task(waiting, fixed)], rules)
    return state


def restored(ledger: Ledger, begun: State, rules: Rules) -> State:
    """Return the state of a ledger that was read from a journal, at rest.

    Args:
        ledger: the ledger.
        begun: the state at the beginning of the journal.
        rules: the options.
    """
    inside = ledger.having("accepted")
    if not inside:
        return State(ledger)
    start = None if begun.system is None else begun.system.base
    system = _adjusted(ledger, inside, rules, start)
    if not isinstance(system, System):
        found = _at_its_start(ledger, inside, rules, start, system)
        return State(ledger, found, settled=False)
    return settled(State(ledger, system), rules)


def settled(state: State, rules: Rules) -> State:
    """Return a state at rest; where there is no minimum the system says why."""
    if state.system is None:
        return state
    draft = Draft.of(state.ledger, state.system, rules.datum)
    found = draft.adjusted(rules.datum, tolerances=EFFORT.at_rest)
    if isinstance(found, Failure):
        return state
    return State(state.ledger, found, settled=True)


def _adjusted(
    ledger: Ledger, inside: Some, rules: Rules, start: Solution | None
) -> System | Failure | None:
    """Return the system of a network's adjustment; none where it ends in an error."""
    try:
        found = () if start is None else (start,)
        draft = Draft.of(ledger, None, rules.datum, new=_observed(ledger, inside), found=found)
        return draft.adjusted(rules.datum)
    except AdjustmentError:
        return None


def _at_its_start(
    ledger: Ledger,
    inside: Some,
    rules: Rules,
    start: Solution | None,
    failure: System | Failure | None,
) -> System | None:
    """Return the system at the values with which it begins; none: it is not determined there."""
    reason = failure.reason if isinstance(failure, Failure) else "no minimum was found"
    with suppress(AdjustmentError):
        found = () if start is None else (start,)
        draft = Draft.of(ledger, None, rules.datum, new=_observed(ledger, inside), found=found)
        free = rules.datum == "free"
        steps = 1 if free else 0  # with which the datum is found
        solution = adjust_from(draft.equations, draft.start, free=free, max_iterations=steps)
        return System.of(solution, reason)
    return None


def _observed(ledger: Ledger, inside: Some) -> set[Variable]:
    """Return the unknowns that observations touch, or that weights determine."""
    network, names, rays = ledger.described, ledger.names, ledger.rays
    out: set[Variable] = {v for u in inside.units for v in u.unknowns}
    photos = {names.photos[f] for f in set(rays.photo[inside.rays].tolist())}
    out |= {("pose", f) for f in photos}
    out |= {("calibration", calibration_name(network, f)) for f in photos}
    out |= {("point", names.points[p]) for p in set(rays.point[inside.rays].tolist())}
    every: list[Variable] = [("point", n) for n in network.points]
    every += [("pose", n) for n in network.photos]
    every += [("calibration", n) for n in network.cameras]
    every += [(kind, n) for kind, n in _stated(ledger)]
    for v in every:
        free, weighted = components(network, v)
        if free == weighted:
            out.add(v)
    return out


def _stated(ledger: Ledger) -> list[Variable]:
    """Return the unknowns besides points, photos and cameras that were stated."""
    from ..network.entities import parameter_name

    network = ledger.network
    return [
        (kind, parameter_name(key)) for kind, given in network.parameters.items() for key in given
    ]


def _with_values(state: State) -> State:
    """Write approximate values that were found into the ledger, where none were given."""
    if state.system is None:
        return state
    base = state.system.base
    ledger = state.ledger
    for kind in ("point", "pose"):
        table = base.equations.unknowns[kind]
        values = dict(zip(table.names, base.start[kind], strict=True))
        ledger = ledger.with_values(kind, values)
    return State(ledger, state.system, state.settled)
