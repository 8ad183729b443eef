"""The Gauss-Newton iteration: damped, accelerated, extrapolated and Newton steps, and its end.

The criterion is rigorous and free of units: for a step dx of N dx = −AᵀPv, Cauchy-Schwarz
bounds the step of every unknown, and of every function of the unknowns, relative to its own
standard deviation by √(dxᵀ N dx).

The parts are separate: `Step` is one step, `Damping` damps it, `StepRecord` decides whether it is
taken and when the iteration ends, and `Extrapolation` combines the last steps.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeAlias

import numpy as np

from ..errors import SingularError
from ..graph.variables import State
from .adjustment_run import (
    AdjustmentRun,
    describe_lost_determinacy,
    drift_reason,
    find_undetermined,
    misfits_grossly,
    raise_overflow,
    refuse_lasting_defects,
    refuse_undetermined,
    settle_datum,
)
from .convergence import (
    STOPPING,
    Judgement,
    StepRecord,
    convergence_reason,
    iteration_limit_reason,
    no_higher,
)
from .feasible_states import with_points_held_in_front
from .gauss_newton_steps import Attempt, Damping, Extrapolation, Factorised, S, Step
from .inner_constraints import held_gradient
from .machine_limits import check_numerical_precision
from .normal_equations import NormalEquations
from .rigid_mounts import with_rig_members_placed
from .step_refinements import (
    ACCELERATION,
    NEWTON,
    accelerated_movement,
    newton_step,
    state_after_inner_iterations,
)

Progress: TypeAlias = Callable[[int, float, float], None]
"""Function that is called with iteration, vᵀPv and the bound of the step relative to σ."""


@dataclass(frozen=True)
class IterationRule:
    """Limits at which an iteration searches for defects, or moves points on their own."""

    suspicious: float = 1e-11
    """Pivot relative to its diagonal element of N below which datum defects are searched: rounding
    leaves smaller pivots for undetermined unknowns."""
    poor: float = 1e-6
    """Pivot relative to its diagonal element of N below which any undetermined unknown is searched:
    rounding leaves pivots up to 10⁻¹⁰ in a singular N, depending on the order of elimination."""
    explained: int = 5000
    """Largest number of columns for which a vanished pivot is explained at once. In larger networks
    the search for a null space takes seconds and waits for the end of the iteration."""
    doubtful: float = 0.25
    """Part of the predicted decrease below which points follow a step of the cameras on their own:
    one point near a camera may have spoilt the step."""
    following: float = 1.0
    """Step relative to σ above which points may follow a step of the cameras on their own."""
    passing: float = 0.1
    """Step relative to σ up to which no point can pass a camera."""


ITERATION = IterationRule()
"""The rule of all iterations."""


@dataclass(frozen=True)
class IterationEnd:
    """How an iteration ended."""

    iterations: int
    """Number of iterations."""
    converged: bool
    """Whether the iteration converged."""
    reason: str
    """Why the iteration ended."""
    vtpv: float
    """Value of vᵀPv after the last iteration."""
    left: float = np.inf
    """Bound of the distance from the minimum relative to σ; infinite: it is not known."""
    second_places: tuple[str, ...] = ()
    """Sentences on points that fit equally well at a second place."""
    converged_slowly: bool = False
    """Whether it converged by steps that shrank slowly, whose length is no bound."""

    @classmethod
    def at_rest(
        cls, stop: StepRecord[S], iterations: int, left: float, vtpv: float
    ) -> IterationEnd:
        """Return the end of an iteration that converged."""
        reason = convergence_reason(left, stop.tolerance, stop.resolution)
        left = max(left, stop.tolerance)
        return cls(iterations, True, reason, vtpv, left, converged_slowly=stop.creeping)


class Movement(NamedTuple):
    """The state to which the unknowns move."""

    state: State
    """Values of all variables."""
    vtpv: float
    """Value of vᵀPv at the state."""
    plain: bool
    """Whether one step leads to the state; false: an extrapolation of several steps."""


def iterate(
    run: AdjustmentRun,
    *,
    tolerance: float,
    max_iterations: int,
    earlier: int = 0,
    progress: Progress | None = None,
) -> IterationEnd:
    """Step until the unknowns have converged; ``run.state`` is the last state.

    If steps shrank slowly, Newton's steps are the last ones, and bound the distance to the minimum.

    Args:
        run: the adjustment.
        tolerance: bound on the last step of every unknown, relative to its own σ.
        max_iterations: largest number of iterations.
        earlier: number of iterations with earlier weights, which the reason counts too.
        progress: called after each iteration.

    Raises:
        InputError: an observation cannot be computed.
        DatumError: the observations do not determine all unknowns.
    """
    ended = _gauss_newton(run, tolerance, max_iterations, earlier, progress)
    return _newton(run, ended, tolerance) if ended.converged and ended.converged_slowly else ended


def _gauss_newton(
    run: AdjustmentRun,
    tolerance: float,
    max_iterations: int,
    earlier: int,
    progress: Progress | None,
) -> IterationEnd:
    """Take Gauss-Newton steps, damped where they fail, as `iterate`."""
    damping, beyond = Damping(), Extrapolation()
    stop: StepRecord[State] = StepRecord(tolerance)
    vtpv = np.inf
    bounds: list[float] = []
    for iteration in range(1, max_iterations + 2):
        if iteration > max_iterations and not stop.expecting:
            break
        normal = run.normal_at(run.state)
        before = normal.system.vtpv
        if not np.isfinite(before):
            raise_overflow(run)
        first = iteration == 1
        # A robust estimate gives weights, and begins where another adjustment may have ended
        # wrongly.
        if first and run.state is run.began and not run.weighted:
            check_numerical_precision(normal.system, normal.resolution)
        # Pivots of a preconditioner do not show defects of the whole.
        defects = run.free or run.solver.iterative or bool(np.any(run.unobserved(normal)))
        if first and defects:
            settle_datum(run, normal)
        # A free network's motion onto its inner constraints begins with a check.
        trusting = run.datum is not None
        stop = replace(stop, resolution=normal.resolution, trusting=trusting)
        damping, found = _descend(run, normal, stop, damping, first=first)
        if found is None:
            return _no_way_on(run, normal, stop, iteration)
        attempt, judged = found
        bound = attempt.step.bound
        if judged.arrived:
            run.at_solution = normal
            return IterationEnd.at_rest(stop, iteration - 1, judged.left, before)
        if iteration > max_iterations:
            break
        bounds.append(bound)
        run.damped = run.damped or damping.value > 0.0
        stop = stop.noted(attempt, judged, before, run.state)
        moved = _movement(run, normal, beyond, attempt, judged, stop)
        run.state, vtpv = moved.state, moved.vtpv
        if progress is not None:
            progress(iteration, vtpv, bound)
        if judged.done:
            return IterationEnd.at_rest(stop, iteration, judged.left, vtpv)
        if stop.rest.exhausted:
            return _at_smallest_step(run, stop, iteration)
        stop = stop.moved(bound, before, vtpv, plain=moved.plain)
        if stop.in_vain:
            return _in_vain(run, stop, iteration, vtpv)
        damping = damping.relaxed(judged.gain, bound)
        del normal  # or two linearisations are in memory at once
    total = earlier + max_iterations
    reason = iteration_limit_reason(total, bounds, tolerance)
    return IterationEnd(max_iterations, False, reason, vtpv if bounds else run.vtpv(run.state))


# -- one iteration --------------------------------------------------------------------------------


def _descend(
    run: AdjustmentRun,
    normal: NormalEquations,
    stop: StepRecord[State],
    damping: Damping,
    *,
    first: bool,
) -> tuple[Damping, tuple[Attempt[State], Judgement] | None]:
    """Damp until a step is accepted; None: no damping leads to an accepted step."""
    while True:
        damped = damping.value > 0.0
        factor = _factorised(run, normal, damping.value, keep=stop.expecting)
        step = None if factor is None else _step(run, normal, factor, damping.value)
        if first and not damped:
            # Datum defects leave vanishing pivots; without such a pivot no search is needed.
            suspicious = step is None or normal.smallest_pivot < ITERATION.suspicious
            # Far from the minimum a singular N may be that of the place; the end judges it.
            near = not misfits_grossly(normal)
            if suspicious and near and run.datum is None:
                settle_datum(run, normal)
            elif suspicious and run.datum is None:
                refuse_lasting_defects(run, normal)
            if run.smallest_pivot < ITERATION.poor and near and step is not None:
                refuse_undetermined(run, normal)
        if factor is not None and step is not None:
            vtpv = normal.system.vtpv
            there = stop.arrived(step.bound, damped=damped)
            attempt = Attempt(step, run.state, vtpv)
            if not there:
                attempt = _try(run, normal, factor, step, damped=damped)
            judged = stop.judge(attempt, vtpv, damped=damped)
            if judged.accepted:
                return damping, (attempt, judged)
        damping = damping.harder()
        if damping.hopeless:
            return damping, None


def step_from(
    run: AdjustmentRun, normal: NormalEquations, damping: float = 0.0, *, keep: bool = False
) -> Step | None:
    """Return the step from a linearisation, with some damping; None: the system is singular.

    With ``keep`` the linearisation keeps its factorisation: it is probably that of the solution.

    Damping may lead to a state at which the undamped normal equations are regular; otherwise the
    end of the iteration raises an error that names the undetermined unknowns.
    """
    factor = _factorised(run, normal, damping, keep=keep)
    return None if factor is None else _step(run, normal, factor, damping)


def _factorised(
    run: AdjustmentRun, normal: NormalEquations, damping: float, *, keep: bool
) -> Factorised | None:
    """Factorise N + λD; None: it is singular."""
    if damping == 0.0:
        run.smallest_pivot = 0.0
    try:
        # Damping fills the datum too, and treats all points alike.
        added = normal.eased * damping if damping > 0.0 else run.constraint
        factor = normal.factorise(added, keep=keep)
    except SingularError:
        if damping > 0.0:
            return None
        if run.equations.unknowns.n_columns <= ITERATION.explained and not misfits_grossly(normal):
            describe_lost_determinacy(run, normal)
        return None
    if damping == 0.0:
        run.smallest_pivot = normal.smallest_pivot
    return factor


def _step(run: AdjustmentRun, normal: NormalEquations, factor: Factorised, damping: float) -> Step:
    """Solve for the step that belongs to a factorisation."""
    if damping == 0.0:
        return Step.of(factor, held_gradient(normal, run.defects, run.constraint))
    return Step.of(factor, normal.gradient, normal.eased * damping)


def _try(
    run: AdjustmentRun, normal: NormalEquations, factor: Factorised, step: Step, *, damped: bool
) -> Attempt[State]:
    """Try a step; where it brings less than it promises, along its curve too.

    An undamped step may bring less, as the next one is good again; damped steps stay short where
    the valley of vᵀPv is curved.
    """
    before = normal.system.vtpv
    attempt = _moved(run, step, before)
    enough = ACCELERATION.straight if damped else ITERATION.doubtful
    straight = attempt.vtpv <= before - enough * step.decrease
    if straight or step.bound < ACCELERATION.short:
        return attempt
    movement = accelerated_movement(run, normal, factor, step)
    if movement is None:
        return attempt
    curved = _moved(run, replace(step, movement=movement), before)
    return curved if curved.vtpv < attempt.vtpv else attempt


def _moved(run: AdjustmentRun, step: Step, before: float) -> Attempt[State]:
    """Move by a step; where vᵀPv decreases little, points follow the cameras on their own."""
    equations, layers = run.equations, run.solver.layers
    plain = equations.unknowns.retract(run.state, step.movement)
    plain = with_rig_members_placed(equations, run.state, plain, step.movement)
    moved: State | None = plain
    if step.bound > ITERATION.passing:
        moved = with_points_held_in_front(equations, run.state, plain)
    after = np.inf if moved is None else run.vtpv(moved)
    little = after > before - ITERATION.doubtful * step.decrease
    if little and step.bound > ITERATION.following and layers.reduced.any():
        followed = state_after_inner_iterations(equations, layers, run.state, plain)
        moved = with_points_held_in_front(equations, run.state, followed)
        after = np.inf if moved is None else run.vtpv(moved)
    return Attempt(step, moved, after)


def _movement(
    run: AdjustmentRun,
    normal: NormalEquations,
    beyond: Extrapolation,
    attempt: Attempt[State],
    judged: Judgement,
    stop: StepRecord[State],
) -> Movement:
    """Return the movement by an accepted step, or by the extrapolation where vᵀPv is lower."""
    assert attempt.state is not None
    by_step = Movement(attempt.state, attempt.vtpv, True)
    step = attempt.step
    if step.bound >= STOPPING.still:
        beyond.clear()
        return by_step
    if judged.done:
        return by_step
    movement = beyond.beyond(step.movement, lambda dx: normal.system.times(dx[:, None])[:, 0])
    # Steps that shrink fast converge better by themselves.
    slow = movement is not None and stop.slows_down(step.bound)
    if movement is not None and slow and beyond.promising:
        guess = run.equations.unknowns.retract(run.state, movement)
        further = with_points_held_in_front(run.equations, run.state, guess)
        there = np.inf if further is None else run.vtpv(further)
        better = there < attempt.vtpv or (judged.small and no_higher(there, attempt.vtpv))
        if further is not None and better:
            beyond.in_vain = 0
            beyond.moved(movement)
            run.extrapolated = run.extrapolated.with_one(attempt.vtpv - there)
            return Movement(further, there, False)
    beyond.in_vain += slow
    beyond.moved(step.movement)
    return by_step


# -- ends -----------------------------------------------------------------------------------------


def _newton(run: AdjustmentRun, ended: IterationEnd, tolerance: float) -> IterationEnd:
    """Take Newton's steps from a converged state; end at the state nearest to the minimum."""
    nearest, last, taken = np.inf, np.inf, 0
    best = run.state, run.at_solution, ended.vtpv
    while True:
        normal = run.at_solution
        if normal is None or normal.state is not run.state:
            normal = run.normal_at(run.state)
        vtpv = normal.system.vtpv
        step = newton_step(run, normal)
        if step is None or not no_higher(vtpv, ended.vtpv):
            break
        if step.bound < nearest:
            nearest, best = step.bound, (run.state, normal, vtpv)
        slowly = step.bound > NEWTON.shrinking * last
        if step.bound < tolerance or slowly or taken == NEWTON.steps:
            break
        there = run.equations.unknowns.retract(run.state, step.movement)
        moved = with_points_held_in_front(run.equations, run.state, there)
        if moved is None:
            break
        run.state, run.at_solution, last, taken = moved, None, step.bound, taken + 1
    run.state, run.at_solution, vtpv = best
    if not np.isfinite(nearest):  # no product could be computed
        return ended
    assert run.at_solution is not None
    reason = convergence_reason(nearest, tolerance, run.at_solution.resolution)
    left = max(nearest, tolerance)
    return replace(ended, iterations=ended.iterations + taken, reason=reason, vtpv=vtpv, left=left)


def _undamped(run: AdjustmentRun, normal: NormalEquations) -> float:
    """Return the bound of the undamped step; infinite where the system is singular."""
    step = step_from(run, normal)
    return np.inf if step is None else step.bound


def _at_smallest_step(run: AdjustmentRun, stop: StepRecord[State], iteration: int) -> IterationEnd:
    """End at the state from which the smallest of the steps leads that are only rounding."""
    assert stop.rest.state is not None
    run.state = stop.rest.state
    return IterationEnd.at_rest(stop, iteration, stop.rest.bound, run.vtpv(run.state))


def _no_way_on(
    run: AdjustmentRun, normal: NormalEquations, stop: StepRecord[State], iteration: int
) -> IterationEnd:
    """End where no damping leads to a step: converged if the undamped step is small."""
    vtpv = normal.system.vtpv
    left = _undamped(run, normal)
    if stop.near_enough(left, vtpv):
        return IterationEnd.at_rest(stop, iteration, left, vtpv)
    if stop.rest.state is not None:  # an earlier state had converged to the resolution of vᵀPv
        return _at_smallest_step(run, stop, iteration)
    why = describe_lost_determinacy(run, normal)
    reason = "no step decreases vᵀPv any more, yet the solution has not converged"
    return IterationEnd(iteration, False, f"{reason}; {why}" if why else reason, vtpv)


def _in_vain(
    run: AdjustmentRun, stop: StepRecord[State], iteration: int, vtpv: float
) -> IterationEnd:
    """End after many consecutive steps without progress, and name the unknowns that drift."""
    normal = run.normal_at(run.state)
    left = _undamped(run, normal)
    if stop.near_enough(left, vtpv):
        return IterationEnd.at_rest(stop, iteration, left, vtpv)
    if run.equations.unknowns.n_columns <= ITERATION.explained:
        if why := describe_lost_determinacy(run, normal):
            reason = f"{drift_reason(run, stop.last)}; {why}"
            return IterationEnd(iteration, False, reason, vtpv)
    elif (error := find_undetermined(run, normal)) is not None:
        run.drifting = error.unknowns
    return IterationEnd(iteration, False, drift_reason(run, stop.last), vtpv)
