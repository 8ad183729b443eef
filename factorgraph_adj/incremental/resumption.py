"""The state after a journal: where everything was, compared with what the journal says.

The adjustment begins at the estimates that the lines have. It must reach the vᵀPv of the last line;
a larger one belongs to another minimum, as where a later observation has moved everything, so that
estimates of different lines do not fit one another. The network is then adjusted at lines before,
at half of the way again and again, and each adjustment begins where the one before has ended, as
the journal's own did. What is left of a difference is a doubt of the solution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..ledger.candidates import Candidates, NothingKnown
from ..ledger.journal_entries import reading, replay
from ..ledger.ledger import Ledger
from ..ledger.options import Options
from ..linear_system.front_system import FrontSystem
from ..linear_system.rebase import Failure
from ..network.network import Network
from .initial_adjustment import adjusted_once, at_its_start, initial_state, settled
from .recorded_estimates import Estimates, all_estimates, read_estimates
from .retirement import retired_again, with_everything
from .worklist import IncrementalState

MAX_ADJUSTED_LINES = 100
"""Largest number of lines at which the network is adjusted on the way."""
VTPV_TOLERANCE = 1e-4
"""Difference of two vᵀPv of one minimum, relative to 100 + vᵀPv: what is left until everything
settles."""


class Moment(NamedTuple):
    """What a journal says up to a line."""

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
    """Return the state at the end of a journal, at rest.

    Args:
        network: the network at its beginning.
        header: its first line.
        entries: its lines after the first.
        rules: the options.
        journal: its name.

    Raises:
        InputError: a line that does not follow from those before.
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
    """What they say, that on the start first."""
    rules: Options
    """The options."""
    journal: str
    """Name of the journal."""

    def adjusted(self, moment: Moment) -> tuple[Moment, FrontSystem | Failure | None]:
        """Return the last moment of the journal, and its network adjusted.

        Args:
            moment: a moment before.
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
        """Return a state at rest whose solution tells of a minimum that is not the journal's."""
        system, said = state.system, self.lines[-1].get("vtpv")
        if not isinstance(system, FrontSystem) or said is None:
            return state
        if abs(system.vtpv - said) <= _within(said):
            return state
        told = (
            f"the journal ended at a minimum with vᵀPv {said:.6g}, which was not found again; "
            f"here it is {system.vtpv:.6g}"
        )
        return replace(state, system=system.with_second_place(told))

    def _excess(self, line: int, found: FrontSystem | Failure | None) -> float:
        """Return by how much vᵀPv exceeds what a line says, beyond what is left to settle."""
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
