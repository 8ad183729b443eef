"""Resumption from a journal: the estimates in its lines, and the adjusted state that they lead to.

The adjustment begins at the estimates of the lines. It must reach the vᵀPv of the last line; a
larger one belongs to another minimum, for example where a later observation has moved everything,
so that estimates of different lines do not fit one another. The network is then adjusted at earlier
lines, by repeated bisection, and each adjustment begins where the previous one has ended, as those
of the journal did. A remaining difference is a doubt of the solution.

A line has the estimates of unknowns that became known with it, and of points that readings have
moved to their other sides. When more observations have changed than unknowns are known, when the
adjustment settles and when something is retired, a line has all estimates: these take less space
than the observations. Every line has vᵀPv, with which `resumption` compares its own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from ..graph.dependence import Variable
from ..ledger.command_input import Options
from ..ledger.journal_entries import reading, replay
from ..ledger.ledger import Ledger
from ..ledger.row_store import REMOVED
from ..ledger.waiting_observations import Candidates, NothingKnown
from ..linear_system.front_system import FrontSystem
from ..linear_system.linear_system import LinearSystem
from ..linear_system.rebase import NoMinimum
from ..models.unknown_registry import ROTATION, UNKNOWNS
from ..network.network import Network
from ..types import NO_ROWS, Array, Index
from .initial_adjustment import adjusted_once, at_its_start, initial_state, settled
from .retirement import retired_again, with_everything
from .worklist import IncrementalState

Estimates: TypeAlias = dict[Variable, Array]
"""Values of unknowns, as in a state."""
MAX_ORTHOGONALITY_ERROR = 1e-6
"""Largest deviation of R Rᵀ from I of a rotation in a journal."""
MAX_ADJUSTED_LINES = 100
"""Largest number of earlier lines at which the network is adjusted."""
VTPV_TOLERANCE = 1e-4
"""Difference of two vᵀPv of one minimum, relative to 100 + vᵀPv: what remains until everything
settles."""


class RecordedLine(NamedTuple):
    """Estimates in the next line."""

    estimates: Estimates
    """The estimates."""
    vtpv: float
    """VᵀPv; NaN where there is none."""
    lost: set[Variable]
    """Unknowns that are not known any more."""
    changed: int
    """Number of observations that will have changed since a line had all estimates."""

    def fields(self) -> dict[str, Any]:
        """Return the fields of the line."""
        out: dict[str, Any] = {}
        for (kind, name), value in self.estimates.items():
            out.setdefault("estimates", {}).setdefault(kind, {})[name] = value.tolist()
        return out | ({"vtpv": self.vtpv} if math.isfinite(self.vtpv) else {})


class RecordedEstimates:
    """Estimates that a journal has."""

    def __init__(self) -> None:
        """Begin with a journal that has none."""
        self._known: set[Variable] = set()
        self._changed = 0

    def next_line(
        self, before: Ledger, after: IncrementalState, *, everything: bool = False
    ) -> RecordedLine:
        """Return the estimates of the next line; `written` records that it was written.

        Args:
            before: the ledger of the line before.
            after: the state.
            everything: whether the line has all estimates in any case.
        """
        ledger, system = after.ledger, after.system
        if system is None:
            return RecordedLine({}, np.nan, self._known, 0)
        rows = NO_ROWS if everything else _changed(before, ledger)
        changed = self._changed + len(rows)
        if everything or changed > len(self._known):
            found = all_estimates(system)
            return RecordedLine(found, system.vtpv, self._known - found.keys(), 0)
        touched = {*Candidates(ledger, NothingKnown(), rows).links.variables}
        lost = {v for v in touched & self._known if not system.known(*v)}
        wanted = touched - self._known
        if ledger.sides != before.sides:
            wanted |= {("point", side.point) for side in ledger.sides.values()}
        return RecordedLine(_estimates(system, wanted), system.vtpv, lost, changed)

    def written(self, line: RecordedLine) -> None:
        """Record that a line was written."""
        self._known -= {*line.lost}
        self._known |= line.estimates.keys()
        self._changed = line.changed


def _changed(before: Ledger, after: Ledger) -> Index:
    """Return the rows whose outcomes have changed."""
    was = np.full(after.rows.n, REMOVED, dtype=np.int8)
    was[: before.rows.n] = before.rows.status
    return np.flatnonzero(was != after.rows.status)


def read_estimates(line: Mapping[str, Any]) -> Estimates:
    """Return the estimates of a line.

    Raises:
        ValueError: a rotation is not orthogonal, or vᵀPv is not a number.
        TypeError, AttributeError: these are no estimates.
    """
    out: Estimates = {}
    for kind, values in line.get("estimates", {}).items():
        for name, given in values.items():
            value: Array = np.array(given, dtype=float)
            if value.ndim != 1 or not np.isfinite(value).all():
                raise ValueError(f"{given!r:.40} is not an estimate of {name!r}")
            if UNKNOWNS[kind].rotates:
                r = value[:ROTATION].reshape(3, 3)
                if not np.abs(r @ r.T - np.eye(3)).max() < MAX_ORTHOGONALITY_ERROR:
                    raise ValueError(f"the estimate of {name!r} has no rotation")
            out[kind, name] = value
    if not math.isfinite(line.get("vtpv", 0.0)):
        raise ValueError("vtpv is not a number")
    return out


def all_estimates(system: LinearSystem) -> Estimates:
    """Return the estimates of all known unknowns."""
    out: Estimates = {}
    constant: set[Variable] = set()
    for unknowns, state, _ in system.places():
        for kind, table in unknowns.tables.items():
            every = zip(table.names, state[kind], table.offset.tolist(), strict=True)
            for name, value, offset in every:
                if offset >= 0:
                    out[kind, name] = value
                else:
                    constant.add((kind, name))
    others = ((kind, name) for kind in UNKNOWNS for name in system.names(kind))
    return out | _estimates(system, {*others} - out.keys() - constant)


def _estimates(system: LinearSystem, variables: Iterable[Variable]) -> Estimates:
    """Return the estimates of those of some unknowns that are known."""
    found = {v: system.value(*v) for v in variables}
    return {v: x for v, x in found.items() if x is not None and np.isfinite(x).all()}


class Moment(NamedTuple):
    """State of a journal up to a line."""

    line: int
    """Number of lines."""
    ledger: Ledger
    """The ledger."""
    estimates: Estimates
    """Estimates, the last ones of each unknown."""


def resumed(
    network: Network,
    header: Mapping[str, Any],
    entries: Sequence[Mapping[str, Any]],
    rules: Options,
    journal: str,
) -> IncrementalState:
    """Return the state at the end of a journal, converged.

    Args:
        network: the network at its beginning.
        header: its first line.
        entries: its lines after the first.
        rules: the options.
        journal: its name.

    Raises:
        InputError: a line that does not follow from the previous ones.
    """
    ledger, first = Ledger.of(network), header.get("start")
    if first is not None:
        moment = Moment(0, ledger, {})
    else:  # a journal of a version that did not record estimates
        begun = initial_state(ledger, rules, None)
        there = {} if begun.system is None else all_estimates(begun.system)
        moment = Moment(1, begun.ledger.recorded()[0], there)
    lines = _Lines([first or {}, *entries], rules, journal)
    moment, found = lines.adjusted(moment)
    if isinstance(found, FrontSystem):
        state = settled(IncrementalState(moment.ledger, found), rules)
        return lines.compared(state)
    inside = Candidates(moment.ledger, NothingKnown(), moment.ledger.having("accepted"))
    system = at_its_start(moment.ledger, inside, rules, found, there=moment.estimates)
    return IncrementalState(moment.ledger, system, settled=not len(inside.rows))


@dataclass(frozen=True)
class _Lines:
    """The lines of a journal."""

    lines: Sequence[Mapping[str, Any]]
    """Contents of the lines, the first one first."""
    rules: Options
    """The options."""
    journal: str
    """Name of the journal."""

    def adjusted(self, moment: Moment) -> tuple[Moment, FrontSystem | NoMinimum | None]:
        """Return the last moment of the journal, and its network adjusted.

        Args:
            moment: an earlier moment.
        """
        ends, found = [len(self.lines)], None
        for n in range(1, MAX_ADJUSTED_LINES + len(self.lines).bit_length() + 1):
            end = self._moment(moment, ends[-1])
            inside = Candidates(end.ledger, NothingKnown(), end.ledger.having("accepted"))
            found = adjusted_once(end.ledger, inside, self.rules, there=end.estimates)
            far = n < MAX_ADJUSTED_LINES and end.line - moment.line > 1
            if far and self._excess(end.line, found) > 0.0:
                ends.append((moment.line + end.line) // 2)
                continue
            moment = end
            if isinstance(found, FrontSystem):
                moment = end._replace(estimates=end.estimates | all_estimates(found))
            ends.pop()
            if not ends:
                break
        return moment, found

    def compared(self, state: IncrementalState) -> IncrementalState:
        """Return a converged state whose solution reports a minimum that is not the journal's."""
        system, said = state.system, self.lines[-1].get("vtpv")
        if not isinstance(system, FrontSystem) or said is None:
            return state
        if abs(system.vtpv - said) <= _within(said):
            return state
        message = (
            f"the journal ended at a minimum with vᵀPv {said:.6g}, which was not found again; "
            f"here it is {system.vtpv:.6g}"
        )
        return replace(state, system=system.with_second_place(message))

    def _excess(self, line: int, found: FrontSystem | NoMinimum | None) -> float:
        """Return by how much vᵀPv exceeds that of a line, beyond what remains until it settles."""
        said = self.lines[line - 1].get("vtpv")
        if said is None:
            return 0.0
        return found.vtpv - said - _within(said) if isinstance(found, FrontSystem) else np.inf

    def _moment(self, moment: Moment, end: int) -> Moment:
        """Return a later moment."""
        ledger, estimates = moment.ledger, dict(moment.estimates)
        for number in range(moment.line, end):
            line, where = self.lines[number], f"{self.journal}:{number + 1}"
            with reading(where):
                if line.get("taken_back"):
                    if ledger.retired is not None:
                        retired = ledger.retired
                        estimates |= dict(retired.archive.determined(retired.number))
                    ledger = with_everything(ledger)
                if "retired" in line:
                    ledger = retired_again(ledger, line["retired"])
                    if ledger.retired is not None:
                        estimates |= ledger.retired.prior.references()
                estimates |= read_estimates(line)
            ledger = replay(line, ledger, where=where)
        return Moment(end, ledger, estimates)


def _within(vtpv: float) -> float:
    return VTPV_TOLERANCE * (100.0 + vtpv)
