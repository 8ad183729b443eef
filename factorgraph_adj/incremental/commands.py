"""The commands: each is a function of a state, and returns another state and what it came to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import InputError, Problem, known
from ..network.entities import Camera, Photo, Point
from ..observations import AnyObservation, Observation
from ..stochastic import StandardDeviation
from .arrival import Arrival, arrival_of
from .beginning import settled
from .flow import State, Task, Told, absorb
from .ledger import Ledger, Some
from .rules import Rules
from .taking_out import take_out
from .units import Unit, named
from .verdicts import Verdict

MOST_WEIGHT = 1e12
"""Largest factor by which a weight may be multiplied; its inverse is the smallest."""
MOST_ROUNDS = 5
"""Largest number of times that what waits is looked at before everything is at rest."""


def add(
    state: State,
    observations: Sequence[AnyObservation],
    rules: Rules,
    points: Sequence[Point] = (),
    photos: Sequence[Photo] = (),
    cameras: Sequence[Camera] = (),
) -> tuple[State, Arrival]:
    """Take observations, points, photos and cameras in.

    Raises:
        InputError: everything that is wrong with them.
    """
    ledger = state.ledger
    if points or photos or cameras:
        ledger = ledger.with_entities(points, photos, cameras)
    ledger, some = ledger.taken(observations)
    after, told = absorb(replace(state, ledger=ledger), [Task(some)], rules)
    return after, arrival_of(state, after, told, ledger.given(observations, some))


def remove(state: State, ids: Sequence[str], rules: Rules) -> tuple[State, Arrival]:
    """Take observations out, wherever they are.

    Raises:
        InputError: every id that there is not.
    """
    ids = known_ids(state, ids)
    after, told = _without(state, ids, rules)
    return after, replace(arrival_of(state, after, told, ()), verdicts=())


def put_in_place(
    state: State, ident: str, observation: Observation, rules: Rules
) -> tuple[State, Arrival]:
    """Put a new observation in the place of another, under the same id.

    Raises:
        InputError: no such id, or what is wrong with the observation.
    """
    known_ids(state, [ident])
    after, first = _without(state, [ident], rules, cause="replaced")
    ledger, some = after.ledger.taken([named(observation, ident)])
    after, told = absorb(replace(after, ledger=ledger), [Task(some)], rules)
    first.take(told.verdicts.values())
    return after, arrival_of(state, after, first, [ident])


def reweight(
    state: State, ids: Sequence[str], factor: float, rules: Rules
) -> tuple[State, Arrival]:
    """Multiply the weights of observations by a factor; those that were left out are tested anew.

    Raises:
        InputError: unknown ids, or a bad factor.
    """
    ids = known_ids(state, ids)
    if not 1.0 / MOST_WEIGHT <= factor <= MOST_WEIGHT:
        what = f"the factor of weights must be between {1 / MOST_WEIGHT:g} and {MOST_WEIGHT:g}"
        raise InputError(f"{what}, not {factor}")
    before = state.ledger
    some = _real(before, ids)
    every = before.ids_of(some)
    tested = {i for i in every if before.status(i) in ("suspect", "rejected")}
    by = 1.0 / float(np.sqrt(factor))
    scaled = [_scaled(u, by).item for u in some.units]
    rays = (before.rays.observation(before.names, row) for row in some.rays.tolist())
    scaled += [_scaled_observation(o, by) for o in rays]
    after, first = _without(state, every, rules, cause="reweighted")
    ledger, again = after.ledger.taken(scaled)
    fixed = frozenset(i for i in every if i not in tested)
    after, told = absorb(replace(after, ledger=ledger), [Task(again, fixed)], rules)
    first.take(told.verdicts.values())
    return after, arrival_of(state, after, first, every)


def accept(state: State, ids: Sequence[str], rules: Rules) -> tuple[State, Arrival]:
    """Put suspects, or rejected observations, in after all.

    Raises:
        InputError: every id that is neither.
    """
    ledger = state.ledger
    problems = [
        Problem("is neither suspect nor rejected", f"observation {i!r}")
        for i in ids
        if ledger.status(i) not in ("suspect", "rejected")
    ]
    some = ledger.find(ids)
    if not problems:
        problems = _measured_again(ledger, some)
    if problems:
        raise InputError(problems)
    ledger = ledger.moved(some, "waiting", "accepted by hand")
    every = ledger.ids_of(some)
    after, told = absorb(replace(state, ledger=ledger), [Task(some, frozenset(every))], rules)
    return after, arrival_of(state, after, told, every)


def discard(state: State, ids: Sequence[str]) -> State:
    """Throw suspects out: they count as rejected.

    Raises:
        InputError: every id that is not a suspect.
    """
    ledger = state.ledger
    suspects = ledger.having("suspect")
    problems = [
        Problem(f"is no suspect; suspects: {known(ledger.ids_of(suspects))}", f"observation {i!r}")
        for i in ids
        if ledger.status(i) != "suspect"
    ]
    if problems:
        raise InputError(problems)
    some = ledger.find(ids)
    told = {v.id: replace(v, verdict="rejected") for v in ledger.verdicts("suspect")}
    ledger = ledger.moved(some, "rejected", "discarded", verdicts=told)
    return replace(state, ledger=ledger)


def reject(state: State, ids: Sequence[str], rules: Rules, cause: str) -> tuple[State, Arrival]:
    """Take observations out and keep them as rejected; weighted unknowns lose their weights."""
    ledger = state.ledger
    some = _real(ledger, ids)
    every = ledger.ids_of(some)
    weights = [i for i in ids if not ledger.has(i)]
    after, told = _without(state, [*every, *weights], rules, cause=cause)
    items = [u.item for u in some.units]
    items += [ledger.rays.observation(ledger.names, r) for r in some.rays.tolist()]
    taken, again = after.ledger.taken(items)
    verdicts = {
        i: Verdict(i, o.kind, o.label(), "rejected", points=tuple(p for p in o.points() if p))
        for i, o in ((i, ledger.observation(i)) for i in every)
    }
    taken = taken.moved(again, "rejected", cause, verdicts=verdicts)
    after = replace(after, ledger=taken)
    return after, arrival_of(state, after, told, ())


def settle(state: State, rules: Rules) -> tuple[State, Arrival]:
    """Go to rest, and look once more at everything that waits."""
    after, told = settled(state, rules), Told()
    for _ in range(MOST_ROUNDS):
        waiting = after.ledger.having("waiting")
        if not waiting:
            break
        then = len(waiting.units) + len(waiting.rays)
        after, more = absorb(after, [Task(waiting)], rules)
        told.take(more.verdicts.values())
        left = after.ledger.having("waiting")
        if not after.settled:
            after = settled(after, rules)
        if len(left.units) + len(left.rays) == then:
            break
    return after, arrival_of(state, after, told, ())


# -- helpers --------------------------------------------------------------------------------------


def known_ids(state: State, ids: Sequence[str]) -> list[str]:
    """Return ids without repetition.

    Raises:
        InputError: every id that there is not.
    """
    wanted = list(dict.fromkeys(ids))
    missing = [i for i in wanted if not state.ledger.has(i)]
    if missing and state.system is not None:
        found = state.system.base.equations.find(missing)
        missing = [i for i, rows in zip(missing, found, strict=True) if not len(rows)]
    if missing:
        raise InputError([Problem("unknown observation", f"observation {i!r}") for i in missing])
    return wanted


def _without(
    state: State, ids: Sequence[str], rules: Rules, *, cause: str = "removed"
) -> tuple[State, Told]:
    """Take observations out, and look at what is left to be looked at."""
    out = take_out(state, ids, rules, cause)
    return absorb(out.state, out.tasks, rules, start=out.start)


def _real(ledger: Ledger, ids: Sequence[str]) -> Some:
    return ledger.find([i for i in ids if ledger.has(i)])


def _measured_again(ledger: Ledger, some: Some) -> list[Problem]:
    """Return rejected image points that have been measured again since."""
    rays, problems = ledger.rays, []
    for row in some.rays.tolist():
        others = rays.measured(int(rays.photo[row]), np.array([rays.point[row]]))
        others = others[others != row]
        if (rays.status[others] != rays.status[row]).any():
            what = "the point has been measured in this photo again since"
            problems.append(Problem(what, f"observation {rays.name(ledger.names, row)!r}"))
    return problems


def _scaled(unit: Unit, by: float) -> Unit:
    """Return the unit with its standard deviations multiplied."""
    covariance = None if unit.covariance is None else unit.covariance * by**2
    scaled = tuple(_scaled_observation(o, by) for o in unit.observations)
    return Unit(unit.ids, scaled, covariance, unit.variables, unit.unknowns)


def _scaled_observation(o: Observation, by: float) -> Observation:
    changes: dict[str, Any] = {}
    sigma = getattr(o, "sigma", None)
    if isinstance(sigma, StandardDeviation):
        changes["sigma"] = sigma.scaled(by)
    elif isinstance(sigma, tuple):
        changes["sigma"] = tuple(s * by for s in sigma)
    elif sigma is not None:
        changes["sigma"] = sigma * by
    covariance = getattr(o, "covariance", None)
    if covariance is not None:
        changes["covariance"] = np.asarray(covariance) * by**2
    return replace(o, **changes)
