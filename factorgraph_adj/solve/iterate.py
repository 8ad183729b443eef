"""The iteration: steps of Gauss and Newton, damped where they fail, until nothing moves.

The criterion is rigorous and free of units: for a step dx of N dx = −AᵀPv, Cauchy-Schwarz
bounds the step of every unknown, and of every function of them, relative to its own standard
deviation by √(dxᵀ N dx).

Its parts stand alone: `Step` is one step, `Damping` says how far it is damped, `Stop` whether it is
taken and when to stop, `Extrapolation` where several steps lead together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from ..graph.variables import State
from .damping import Damping
from .determine import (
    drifting,
    explain,
    name_overflow,
    refuse_unnoticed,
    settle_datum,
    what_is_undetermined,
)
from .extrapolation import Extrapolation
from .inner import follow
from .normal import NormalEquations
from .run import Run
from .sides import before_the_cameras
from .step import Attempt, Step
from .stopping import STOPPING, Judgement, Stop, at_rest, no_higher
from .tree import SingularError

Progress: TypeAlias = Callable[[int, float, float], None]
"""Called with iteration, vᵀPv and the bound of the step relative to σ."""


@dataclass(frozen=True)
class IterationRule:
    """What an iteration does beside stepping."""

    suspicious: float = 1e-11
    """What is left of a diagonal element of N in its elimination, relative, below which datum
    defects are looked for: rounding leaves less where nothing is determined."""
    poor: float = 1e-6
    """The same below which any undetermined unknown is looked for: rounding leaves up to 10⁻¹⁰ of
    the smallest pivot of a singular N, as it depends on the order of elimination."""
    explained: int = 5000
    """Number of columns up to which a vanished pivot is explained at once, and not at the end of
    the iteration: the search for a null space takes seconds beyond."""
    doubtful: float = 0.25
    """Part of the predicted decrease below which points follow a step of the cameras on their own:
    one point near a camera may have spoilt it."""
    following: float = 1.0
    """Step relative to σ above which they do."""
    passing: float = 0.1
    """Step relative to σ up to which no point can pass a camera."""


ITERATION = IterationRule()
"""The rule of all iterations."""


@dataclass(frozen=True)
class Ended:
    """How an iteration ended."""

    iterations: int
    """Number of iterations."""
    converged: bool
    """Whether it came to rest."""
    reason: str
    """Why it ended."""
    vtpv: float
    """VᵀPv where it ended."""


class Movement(NamedTuple):
    """Where the unknowns go."""

    state: State
    """The state."""
    vtpv: float
    """VᵀPv there."""
    plain: bool
    """Whether a step leads there, and not an extrapolation of several."""


def iterate(
    run: Run, *, tolerance: float, max_iterations: int, progress: Progress | None = None
) -> Ended:
    """Step until nothing moves; ``run.state`` is where that was.

    Args:
        run: the adjustment.
        tolerance: bound on the last step of every unknown, relative to its own σ.
        max_iterations: after as many the iteration ends.
        progress: called after each of them.

    Raises:
        InputError: an observation that cannot be computed.
        DatumError: unknowns that the observations do not determine.
    """
    damping, stop, beyond = Damping(), Stop(tolerance), Extrapolation()
    vtpv = np.inf
    for iteration in range(1, max_iterations + 1):
        normal = run.normal_at(run.state)
        before = normal.system.vtpv
        if not np.isfinite(before):
            name_overflow(run)
        first = iteration == 1
        if first and (run.free or bool(np.any(run.unobserved(normal)))):
            settle_datum(run, normal)
        damping, found = _descend(run, normal, stop, damping, first=first)
        if found is None:
            return _no_way_on(run, normal, stop, iteration)
        attempt, judged = found
        bound = attempt.step.bound
        stop = stop.noted(attempt, judged, before)
        moved = _movement(run, normal, beyond, attempt, judged, stop)
        run.state, vtpv = moved.state, moved.vtpv
        if progress is not None:
            progress(iteration, vtpv, bound)
        if judged.done:
            return Ended(iteration, True, at_rest(judged.left, tolerance), vtpv)
        if stop.rest.exhausted:
            return _at_smallest_step(run, stop, iteration)
        stop = stop.moved(bound, before, vtpv, plain=moved.plain)
        if stop.in_vain:
            return _in_vain(run, stop, iteration, vtpv)
        damping = damping.relaxed(judged.gain, bound)
    reason = f"not at rest after {max_iterations} iterations: the last step was {stop.last:.2g} σ"
    return Ended(max_iterations, False, reason, vtpv)


# -- one iteration --------------------------------------------------------------------------------


def _descend(
    run: Run, normal: NormalEquations, stop: Stop, damping: Damping, *, first: bool
) -> tuple[Damping, tuple[Attempt, Judgement] | None]:
    """Damp until a step is accepted; none where no damping leads to one."""
    while True:
        damped = damping.value > 0.0
        step = step_from(run, normal, damping.value)
        if first and not damped:
            # A defect of datum leaves a pivot without anything: no need to search without.
            suspicious = step is None or normal.smallest_pivot < ITERATION.suspicious
            if suspicious and run.datum is None:
                settle_datum(run, normal)
            if run.smallest_pivot < ITERATION.poor and step is not None:
                refuse_unnoticed(run, normal)
        if step is not None:
            attempt = _try(run, step, normal.system.vtpv)
            judged = stop.judge(attempt, normal.system.vtpv, damped=damped)
            if judged.accepted:
                return damping, (attempt, judged)
        damping = damping.harder()
        if damping.hopeless:
            return damping, None


def step_from(run: Run, normal: NormalEquations, damping: float = 0.0) -> Step | None:
    """Return the step from a linearisation, with some damping.

    None where undamped normal equations have no answer: damping may lead where they have one. At
    the end of the way the error says what is missing.
    """
    damped = normal.diagonal * damping
    if damping == 0.0:
        run.smallest_pivot = 0.0
    try:
        # Damping fills the datum too, and without taking sides for the points that are held.
        factor = normal.factorise(damped if damping > 0.0 else run.constraint)
    except SingularError:
        if damping > 0.0:
            return None
        if run.equations.unknowns.n_columns <= ITERATION.explained:
            explain(run, normal)
        return None
    if damping == 0.0:
        run.smallest_pivot = normal.smallest_pivot
    return Step.of(factor, normal.gradient, damped)


def _try(run: Run, step: Step, before: float) -> Attempt:
    """Return where a step leads; where it brings little, points follow the cameras on their own."""
    equations, layers = run.equations, run.solver.layers
    plain = equations.unknowns.retract(run.state, step.movement)
    moved: State | None = plain
    if step.bound > ITERATION.passing:
        moved = before_the_cameras(equations, run.state, plain)
    after = np.inf if moved is None else run.vtpv(moved)
    little = after > before - ITERATION.doubtful * step.decrease
    if little and step.bound > ITERATION.following and layers.reduced.any():
        followed = follow(equations, layers, run.state, plain)
        moved = before_the_cameras(equations, run.state, followed)
        after = np.inf if moved is None else run.vtpv(moved)
    return Attempt(step, moved, after)


def _movement(
    run: Run,
    normal: NormalEquations,
    beyond: Extrapolation,
    attempt: Attempt,
    judged: Judgement,
    stop: Stop,
) -> Movement:
    """Return where the unknowns go: by an accepted step, or beyond it where that is better."""
    assert attempt.state is not None
    by_step = Movement(attempt.state, attempt.vtpv, True)
    step = attempt.step
    if step.bound >= STOPPING.still:
        beyond.clear()
        return by_step
    if judged.done:
        return by_step
    movement = beyond.beyond(step.movement, lambda dx: normal.system.times(dx[:, None])[:, 0])
    # Where steps shrink fast, their own convergence is better than any guess.
    if movement is not None and stop.slows_down(step.bound):
        guess = run.equations.unknowns.retract(run.state, movement)
        further = before_the_cameras(run.equations, run.state, guess)
        there = np.inf if further is None else run.vtpv(further)
        better = there < attempt.vtpv or (judged.small and no_higher(there, attempt.vtpv))
        if further is not None and better:
            beyond.moved(movement)
            return Movement(further, there, False)
    beyond.moved(step.movement)
    return by_step


# -- ends -----------------------------------------------------------------------------------------


def _undamped(run: Run, normal: NormalEquations) -> float:
    """Return the bound of the step without damping, infinite where there is none."""
    step = step_from(run, normal)
    return np.inf if step is None else step.bound


def _at_smallest_step(run: Run, stop: Stop, iteration: int) -> Ended:
    """End after the smallest step of those that vᵀPv cannot tell from rounding."""
    assert stop.rest.state is not None
    run.state = stop.rest.state
    reason = at_rest(stop.rest.bound, stop.tolerance)
    return Ended(iteration, True, reason, run.vtpv(run.state))


def _no_way_on(run: Run, normal: NormalEquations, stop: Stop, iteration: int) -> Ended:
    """End where no damping leads to a step: at rest, if the undamped step is small."""
    vtpv = normal.system.vtpv
    left = _undamped(run, normal)
    if stop.near_enough(left, vtpv):
        return Ended(iteration, True, at_rest(left, stop.tolerance), vtpv)
    if stop.rest.state is not None:  # it was there before, as near as vᵀPv can tell
        return _at_smallest_step(run, stop, iteration)
    explain(run, normal)
    reason = "no step decreases vᵀPv any more, yet the solution is not at rest"
    return Ended(iteration, False, reason, vtpv)


def _in_vain(run: Run, stop: Stop, iteration: int, vtpv: float) -> Ended:
    """End where many steps in a row brought nothing, and name what drifts."""
    normal = run.normal_at(run.state)
    left = _undamped(run, normal)
    if stop.near_enough(left, vtpv):
        return Ended(iteration, True, at_rest(left, stop.tolerance), vtpv)
    if run.equations.unknowns.n_columns <= ITERATION.explained:
        explain(run, normal)
    elif (why := what_is_undetermined(run, normal)) is not None:
        run.drifting = why.unknowns
    return Ended(iteration, False, drifting(run, stop.last), vtpv)
