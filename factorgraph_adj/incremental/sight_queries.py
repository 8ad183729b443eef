"""Query for the next best sight, beside those of the state."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ..blas_threads import one_at_a_time
from ..errors import InputError
from .state_queries import StateQueries

if TYPE_CHECKING:
    from ..planning.candidates import Candidate
    from ..planning.next_sight import NextSights
    from ..planning.sight_templates import SightMemory


class SightQueries(StateQueries):
    """Queries of an adjustment, with that for the next best sight."""

    _sights: SightMemory | None = None
    """What earlier questions have found; None: there was none."""

    @one_at_a_time
    def next_sights(
        self,
        target: Any,
        candidates: Sequence[Candidate] | Candidate | None = None,
        *,
        stations: Sequence[str] | None = None,
        to: Sequence[str] | None = None,
        kinds: Sequence[str] | None = None,
        reach: float | None = None,
        singly: bool = False,
        costs: Mapping[str, float] | None = None,
        most: int = 10,
        sequence: bool = False,
    ) -> NextSights:
        """Return the observations, among those possible now, that gain most for a target.

        The best is that with the largest gain Σ ln(before/after) of the figures of the target, per
        cost where costs are stated. Sights that gain nothing are left out. The adjustment does not
        change; see `factorgraph_adj.planning.next_sight`.

        Args:
            target: names of points, whose position errors are to become small, or targets of
                `factorgraph_adj.planning.targets`.
            candidates: candidates as of a design, such as photos; None: all sights possible now.
            stations: names or patterns; None: all that are set up, with levelling and GNSS.
            to: names or patterns of the points to which sights go; None: all.
            kinds: kinds of observations; None: all that have been observed.
            reach: largest length of a sight, metres; None: that of the longest sight so far.
            singly: whether each reading is a sight of its own, not all of a station together.
            costs: cost of a reading of each kind, such as seconds, for the gain per cost.
            most: largest number of sights.
            sequence: whether each sight is the best after those before it.

        Raises:
            InputError: nothing is in the graph; invalid targets, candidates or options.
        """
        if self._state.system is None:
            raise InputError("nothing is determined yet: no sight can be judged")
        module = import_module("factorgraph_adj.planning.next_sight")
        memory = self._sights = self._sights or module.SightMemory()
        found: NextSights = module.next_sights(
            self._state.ledger,
            self._state.system,
            self.solution,
            target,
            candidates,
            alpha=self._rules.alpha,
            choice=module.SightChoice(stations, to, kinds, reach, singly, costs, most, sequence),
            memory=memory,
        )
        return found
