"""Initial incremental state: determined observations adjusted, others waiting; convergence."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import AdjustmentError
from ..garbage_collection import without_collections
from ..graph.dependence import Variable
from ..ledger.command_input import Options
from ..ledger.ledger import Ledger
from ..ledger.waiting_observations import Candidates, NothingKnown
from ..linear_system import engines
from ..linear_system.front_system import FrontSystem
from ..linear_system.rebase import EFFORT, Draft, NoMinimum, known_network
from ..models.unknown_registry import VariableKind
from ..network.network import Network
from ..solve.doubtful_points import points_with_narrow_rays
from ..solve.minimum import adjust_from_start
from ..solve.solution import Solution
from ..start.start_values import Start
from ..types import NO_ROWS, Array, Index
from .determinability import ApproximateNetwork, DeterminabilitySearch
from .entry import sole_rays
from .nonlinear_tests import smaller_minimum
from .worklist import IncrementalState, Task, in_chosen_engine, worked_off

MAX_REDUCTIONS = 5
"""Largest number of adjustments at the start, each without points that the previous one named."""


@without_collections
def initial_state(ledger: Ledger, rules: Options, start: Solution | None) -> IncrementalState:
    """Let a network's own observations enter without a test; those that are not determined wait.

    Args:
        ledger: the ledger, with all observations accepted.
        rules: the options.
        start: a solution of the network, or of a similar one.
    """
    inside = ledger.having("accepted")
    if not len(inside):
        return IncrementalState(ledger)
    every = Candidates(ledger, NothingKnown(), inside)
    posed = all(f.rotation is not None for f in ledger.network.photos.values())
    stay: Candidates | None = None
    if start is None and posed:
        stay, reached = _determined(every, rules)
        ledger, system = adjusted(ledger, rules, None, stay, reached)
    else:
        ledger, system = adjusted(ledger, rules, start)
        if not isinstance(system, FrontSystem):
            stay, _ = _determined(every, rules)
            ledger, system = adjusted(ledger, rules, start, stay)
    if not isinstance(system, FrontSystem):
        assert stay is not None
        ledger = _without(ledger, inside, stay.rows)
        found = Candidates(ledger, NothingKnown(), stay.rows)
        system = at_its_start(ledger, found, rules, system, start)
        if system is None:
            ledger = _without(ledger, inside, NO_ROWS)
    return _entered(IncrementalState(ledger, system, settled=False), inside, rules)


class _Whole(DeterminabilitySearch):
    """A search among all observations of a network; its local network is the adjusted one."""

    def _local(self) -> Network:
        left = self.left
        return known_network(left.ledger, None, new=left.counts, rows=left.rows)


def _determined(every: Candidates, rules: Options) -> tuple[Candidates, ApproximateNetwork | None]:
    """Return observations that determine what they touch, and their network.

    Observations of points that only nearly parallel rays determine are not among them: an
    adjustment in which photos move converges slowly along such rays, in tens of iterations. Beside
    photos that are known these points are found at once.
    """
    stay, reached = _Whole(every, rules.datum, {}).determined()
    if reached is None or reached.solver is None or not reached.equations.n_rays:
        return stay, reached
    names = points_with_narrow_rays(reached.equations, reached.state, reached.solver.layers)
    rays = sole_rays(every.ledger, [("point", name) for name in names])
    return stay.only(np.setdiff1d(stay.rows, rays)), reached


def adjusted(
    ledger: Ledger,
    rules: Options,
    start: Solution | None,
    stay: Candidates | None = None,
    reached: ApproximateNetwork | None = None,
) -> tuple[Ledger, FrontSystem | NoMinimum | None]:
    """Adjust the accepted observations that are determined; the others wait.

    Args:
        ledger: the ledger with the accepted observations.
        rules: the options.
        start: the solution before, or a likely one; None: approximate values are computed.
        stay: observations that are determined at approximate values; None: not examined.
        reached: the network of these, or of some more, if it has been compiled.

    Returns:
        The ledger, and the system or the reason why there is none, if it is known.
    """
    inside = ledger.having("accepted")
    if stay is None:
        stay = DeterminabilitySearch(
            Candidates(ledger, NothingKnown(), inside), rules.datum, {}
        ).counted(())
    system: FrontSystem | NoMinimum | None = None
    for _ in range(MAX_REDUCTIONS):
        ledger = _without(ledger, inside, stay.rows)
        system = adjusted_once(ledger, stay, rules, start, reached)
        if isinstance(system, FrontSystem):
            vague: list[Variable] = [("point", p.name) for p in system.points_anywhere()]
            gone = stay.touching(vague)
        elif system is None or not system.loose:
            break
        elif system.singular and rules.datum == "given":
            gone = stay.touching(system.loose)
        else:
            gone = sole_rays(ledger, system.loose)
        if not len(gone):
            break
        stay = stay.only(np.setdiff1d(stay.rows, gone))
    return ledger, system


def _without(ledger: Ledger, inside: Index, stay: Index) -> Ledger:
    """Return the ledger in which only some of a network's observations are accepted."""
    ledger = ledger.moved(np.setdiff1d(inside, stay), "waiting", "undetermined")
    return ledger.moved(ledger.rows.among(stay, "waiting"), "accepted", "arrival")


def _entered(state: IncrementalState, inside: Index, rules: Options) -> IncrementalState:
    """Let the others of a network's own observations enter, if they can."""
    state = _with_values(state)
    waiting = state.ledger.having("waiting")
    if len(waiting):
        state, _ = worked_off(state, [Task(waiting, inside)], rules)
    state = in_chosen_engine(state, rules)
    if state.system is not None:
        state.system.prepared()
    return state


def settled(state: IncrementalState, rules: Options) -> IncrementalState:
    """Return a converged state; without a minimum its system has the reason."""
    if state.system is None:
        return state
    draft = replace(Draft.of(state.ledger, state.system, rules.datum), looked={})
    found = draft.adjusted(rules.datum, tolerances=EFFORT.at_rest)
    if isinstance(found, NoMinimum):
        return state.on_fronts()
    if state.ledger.retired is None:  # linear rows hold only near them
        found = smaller_minimum(draft, found, rules.datum, tolerances=EFFORT.at_rest)
    return IncrementalState(state.ledger, engines.converged(state.system, found), settled=True)


def _draft(
    ledger: Ledger,
    stay: Candidates,
    rules: Options,
    start: Solution | None,
    reached: ApproximateNetwork | None = None,
    there: Mapping[Variable, Array] | None = None,
) -> Draft:
    if reached is None:
        found = () if start is None else (start,)
        own = [v for v in stay.links.variables if there and v in there and ledger.needs(v)[0] > 0]
        at = {v: there[v] for v in own} if there else None
        return Draft.of(ledger, None, rules.datum, new=stay.counts.keys(), found=found, there=at)
    unknowns, state = reached.equations.unknowns, reached.state
    values = Start(unknowns, state, state)
    if unknowns.n_columns and np.array_equal(stay.rows, reached.rows):
        return Draft(reached.equations, values, reached.rows)
    return Draft.of(ledger, None, rules.datum, new=stay.counts.keys(), found=(values,))


def adjusted_once(
    ledger: Ledger,
    stay: Candidates,
    rules: Options,
    start: Solution | None = None,
    reached: ApproximateNetwork | None = None,
    there: Mapping[Variable, Array] | None = None,
) -> FrontSystem | NoMinimum | None:
    """Return the system of a network's adjustment; None where it ends in an error.

    Args:
        ledger: the ledger.
        stay: its observations that are adjusted.
        rules: the options.
        start: the solution before, or a likely one.
        reached: the network, if it has been compiled.
        there: values of unknowns as start values.
    """
    with suppress(AdjustmentError):
        if len(stay.rows):
            draft = _draft(ledger, stay, rules, start, reached, there)
            same = reached is not None and draft.equations is reached.equations
            return draft.adjusted(rules.datum, solver=reached.solver if reached and same else None)
    return None


def at_its_start(
    ledger: Ledger,
    stay: Candidates,
    rules: Options,
    failure: NoMinimum | None,
    start: Solution | None = None,
    there: Mapping[Variable, Array] | None = None,
) -> FrontSystem | None:
    """Return the system at its start values; None: it is not determined there.

    Args:
        ledger: the ledger.
        stay: its observations that are determined.
        rules: the options.
        failure: why there is no minimum.
        start: the solution before, or a likely one.
        there: values of unknowns.
    """
    reason = "no minimum was found" if failure is None else failure.reason
    with suppress(AdjustmentError):
        if len(stay.rows):
            draft = _draft(ledger, stay, rules, start, there=there)
            free = rules.datum == "free"
            steps = 1 if free else 0  # which finds the datum
            solution = adjust_from_start(
                draft.equations, draft.start, free=free, max_iterations=steps
            )
            return FrontSystem.of(solution, reason)
    return None


def _with_values(state: IncrementalState) -> IncrementalState:
    """Write computed approximate values into the ledger, where none were given."""
    ledger = state.ledger
    kinds: tuple[VariableKind, ...] = ("point", "pose")
    for unknowns, _, start in () if state.system is None else state.system.places():
        for kind in kinds:
            values = dict(zip(unknowns[kind].names, start[kind].tolist(), strict=True))
            ledger = ledger.with_values(kind, values)
    return replace(state, ledger=ledger)
