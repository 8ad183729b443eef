"""Result of a command: verdicts, affected points, reasons of waiting observations."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..ledger.row_store import OUTCOME_CODE
from ..ledger.verdicts import Verdict
from ..ledger.waiting_observations import Candidates, known_in
from ..linear_system.arrival_decisions import untested
from ..models.unknown_registry import UNKNOWNS
from ..types import Index
from .worklist import IncrementalState, Verdicts

ALONE = "everything that it touches is given, and nothing else is determined yet"


@dataclass(frozen=True, eq=False)
class Arrival:
    """Result of an arrival, or of a change."""

    verdicts: tuple[Verdict, ...] = ()
    """Verdicts on every given observation, then on those that entered by themselves."""
    waits: tuple[str, ...] = ()
    """Ids of observations that wait again, because something is no longer determined."""

    oriented: Mapping[str, str] = field(default_factory=dict)
    """How photos that came without poses were oriented, by name."""

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


def arrival_of(
    before: IncrementalState,
    after: IncrementalState,
    tested: Verdicts,
    given: Iterable[str],
    command: str,
) -> Arrival:
    """Return the result of an arrival.

    Args:
        before: the state before.
        after: the state after.
        tested: verdicts on the tested observations.
        given: ids of the observations that were given.
        command: the command, for verdicts on readmitted observations.
    """
    ledger, then = after.ledger, before.ledger
    ids = dict.fromkeys(given)
    late = ledger.rows.among(ledger.find(ids), "waiting")
    every = tested | {v.id: v for v in _verdicts_of_waiting(after, late)}
    verdicts = [every[i] for i in ids if i in every]
    others = then.find(i for i in tested if i not in ids)
    out = [OUTCOME_CODE["waiting"], OUTCOME_CODE["suspect"], OUTCOME_CODE["rejected"]]
    waited = then.ids_of(others[np.isin(then.rows.status[others], out)])
    rows = ledger.find(waited)
    changed = ledger.rows.status[rows] != OUTCOME_CODE["waiting"]
    # A suspect that was tested again and remains one is not reported again.
    still = np.isin(rows, then.having("suspect")) & (
        ledger.rows.status[rows] == OUTCOME_CODE["suspect"]
    )
    inside = ledger.ids_of(rows[changed & ~still])
    both = set(inside).intersection(waited).difference(ids)
    entered = [v for i, v in tested.items() if i in both]
    left_out = set(then.ids_of(others[np.isin(then.rows.status[others], out[1:])]))
    back = f"came back after {command}()"
    entered = [replace(v, cause=back) if v.id in left_out else v for v in entered]
    # Rows of the state before have kept their numbers.
    was = then.having("accepted")
    left = then.ids_of(was[ledger.rows.status[was] != OUTCOME_CODE["accepted"]])
    wait = set(ledger.ids_of(ledger.rows.among(ledger.find(left), "waiting")))
    waits = tuple(i for i in left if i not in ids and i in wait)
    return Arrival((*verdicts, *entered), waits, dict(ledger.oriented))


def waiting_of(state: IncrementalState, rows: Index) -> Iterator[Waiting]:
    """Iterate over observations that wait, with what each lacks."""
    for v in _verdicts_of_waiting(state, rows):
        yield Waiting(v.id, v.kind, v.label, v.lacks)


def _verdicts_of_waiting(state: IncrementalState, rows: Index) -> Iterator[Verdict]:
    ledger = state.ledger
    lacking = Candidates(ledger, known_in(state.system), rows).lacking()
    for unit, variables in zip(ledger.units(rows), lacking, strict=True):
        lacks = dict.fromkeys(
            ledger.lacks.get(v) or f"{UNKNOWNS[v[0]].noun} {v[1]!r} is not determined yet"
            for v in variables
        )
        if (own := ledger.lacks.get(unit.ids[0])) is not None:
            lacks[own] = None
        yield from untested(unit, "waiting", "; ".join(lacks) or ALONE)
