"""What an arrival, or a change, came to."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from ..models.variables import UNKNOWNS
from .candidates import Candidates, known_in
from .deciding import waiting
from .flow import State, Told
from .forms import items_of
from .ledger import Some
from .verdicts import Verdict

ALONE = "all that it touches is given, and nothing else is determined yet"


@dataclass(frozen=True, eq=False)
class Arrival:
    """What an arrival, or a change, came to."""

    verdicts: tuple[Verdict, ...] = ()
    """Of every observation given, then of those that entered by themselves."""
    waits: tuple[str, ...] = ()
    """Ids of observations that wait again: something is not determined any more."""

    @property
    def points(self) -> tuple[str, ...]:
        """Points of the accepted observations."""
        found = (p for v in self.verdicts if v.verdict == "accepted" for p in v.points)
        return tuple(dict.fromkeys(found))


@dataclass(frozen=True)
class Waiting:
    """An observation that waits."""

    id: str
    """Its id."""
    kind: str
    """Its kind."""
    label: str
    """Readable name."""
    lacks: str
    """What is missing until it can enter."""


def arrival_of(before: State, after: State, told: Told, given: Iterable[str]) -> Arrival:
    """Return what observations came to.

    Args:
        before: the state before.
        after: the state after.
        told: verdicts on the tested observations.
        given: ids of the observations that were given.
    """
    ids = dict.fromkeys(given)

    def waited(state: State, some: Iterable[str]) -> set[str]:
        ledger = state.ledger
        return set(ledger.ids_of(ledger.among(ledger.find(some), "waiting")))

    late = after.ledger.among(after.ledger.find(ids), "waiting")
    every = told.verdicts | {v.id: v for v in _verdicts_of_waiting(after, late)}
    verdicts = [every[i] for i in ids if i in every]
    others = [i for i in told.verdicts if i not in ids]
    then, now = waited(before, others), waited(after, others)
    entered = [
        told.verdicts[i] for i in others if i in then and i not in now and after.ledger.has(i)
    ]
    moved = dict.fromkeys(
        i
        for change in after.ledger.changes
        for i, was in change.before.items()
        if was == "accepted" and i not in ids
    )
    now = waited(after, moved)
    waits = [i for i in moved if i in now and before.ledger.status(i) == "accepted"]
    return Arrival((*verdicts, *entered), tuple(waits))


def waiting_of(state: State, some: Some) -> Iterator[Waiting]:
    """Iterate over observations that wait, with what each lacks."""
    for v in _verdicts_of_waiting(state, some):
        yield Waiting(v.id, v.kind, v.label, v.lacks)


def _verdicts_of_waiting(state: State, some: Some) -> Iterator[Verdict]:
    candidates = Candidates(state.ledger, known_in(state.system), some)
    items = items_of(state.ledger, some)
    open_variables = [list(v) for v in candidates.of_units]
    for i in range(len(some.rays)):
        open_variables.append(
            [every[index[i]] for every, index, is_open in candidates.of_rays if is_open[index[i]]]
        )
    for item, variables in zip(items, open_variables, strict=True):
        lacks = dict.fromkeys(
            state.ledger.lacks.get(v) or f"{UNKNOWNS[v[0]].noun} {v[1]!r} is not determined yet"
            for v in variables
        )
        yield from waiting(item, "; ".join(lacks) or ALONE)
