"""Tasks of the process of a part: survey, steps, ambiguous places, results; parts kept in memory.

A task reads what it needs from the folder of the run, so that a task whose process died is done
by another one. A process keeps the parts that it has read as long as its memory allows.
"""

from __future__ import annotations

import gc
from collections import OrderedDict
from collections.abc import Callable
from contextlib import suppress
from threading import RLock
from typing import Any, Concatenate, ParamSpec, TypeVar

import numpy as np

from ..blas_threads import one_thread
from ..errors import AdjustmentError, ApproximationError, DatumError, InputError, SingularError
from ..graph.variables import State
from ..quality.reliability import reliability
from ..solve.added_factors import NO_ADDED_FACTORS
from ..solve.adjustment_run import AdjustmentRun
from ..solve.datum_defects import find_defects
from ..solve.feasible_states import refuse_points_behind, with_points_held_in_front
from ..solve.fronts import Fronts
from ..solve.machine_limits import free_memory_bytes
from ..solve.minimum import describe_second_places
from ..solve.normal_equations import NormalEquations, Solver
from ..solve.rigid_mounts import with_rig_members_placed
from ..solve.second_minimum import better_place, points_without_rays
from ..solve.undetermined_unknowns import undetermined_error
from ..types import Array, Keys
from .junctions import (
    MAX_LISTED_TESTS,
    IterationState,
    JunctionSetup,
    PartError,
    PartQuality,
    PartStart,
    PartStep,
    PartSurvey,
    ReducedEquations,
    SharedVariable,
    TestedObservation,
    packed_triangle,
    unpacked_triangle,
)
from .loaded_part import STAMP_FILE, LoadedPart, PartJob
from .solution import PartSolution, Totals

MEMORY_SHARE_BEFORE_READING = 0.25
"""Share of a process's memory above which a process drops parts before it reads another one."""
MEMORY_SHARE_AFTER_TASK = 0.5
"""Share of a process's memory above which a process drops all its parts after a task: Dask gives
no tasks to a worker with more than 0.8."""
PART_CONTROL_ADVICE = (
    "even if all its junctions with other parts are known: give control in this part, or "
    "observations that tie it to its junctions"
)
"""What a user can do about datum defects of a part."""
JUNCTIONS_FILE = "junctions"
"""Name of the arrays of the covariances of the junctions."""

P = ParamSpec("P")
R = TypeVar("R")

_loaded: OrderedDict[tuple[str, int], LoadedPart] = OrderedDict()
_lock = RLock()


def _task(
    function: Callable[Concatenate[LoadedPart, P], R],
) -> Callable[Concatenate[PartJob, P], R | PartError]:
    """Let a task have its part in memory, and return its errors instead of raising them."""

    def run(job: PartJob, /, *args: P.args, **kwargs: P.kwargs) -> R | PartError:
        with _lock, one_thread:  # a part is changed by one task at a time
            try:
                return function(_part(job), *args, **kwargs)
            except AdjustmentError as error:
                return _refused(error)
            finally:
                if _resident() > MEMORY_SHARE_AFTER_TASK * _limit():
                    _drop_all()

    run.__name__ = run.__qualname__ = function.__name__
    run.__doc__ = function.__doc__
    run.__module__ = function.__module__
    return run


@_task
def survey_part(part: LoadedPart) -> PartSurvey:
    """Return what the root has to know to find the junctions."""
    return part.surveyed()


@_task
def shared_variables(part: LoadedPart, keys: Keys) -> list[SharedVariable]:
    """Return the variables with some keys."""
    return part.shared(keys)


@_task
def observations_at(part: LoadedPart, keys: Keys) -> Keys:
    """Return a number for each observation whose unknowns all have some keys, (k,)."""
    return np.unique(part.observations_at(keys)[0])


@_task
def labels_of(part: LoadedPart, keys: Keys, numbers: Keys) -> list[tuple[str, str]]:
    """Return kind and name of observations by their numbers."""
    return part.labels_of(keys, numbers)


@_task
def begin_part(part: LoadedPart, setup: JunctionSetup) -> PartStart:
    """Take in the junctions, and write the first state."""
    return part.begin(setup)


@_task
def eliminate_part(part: LoadedPart, at: IterationState) -> ReducedEquations:
    """Linearise, and reduce the normal equations to the junctions."""
    m = len(part.kept)
    try:
        e = part.eliminated(at)
    except SingularError:
        nothing = np.zeros(m)
        return ReducedEquations(
            packed_triangle(np.zeros((m, m))), nothing, nothing, np.nan, 0.0, 0.0
        )
    pivots = e.factor.relative_pivots(e.normal.diagonal + e.added, points=1e9)
    pivots[~part.unknowns.free] = np.inf
    fronts = e.factor.fronts
    assert isinstance(fronts, Fronts)  # parts are not solved by conjugate gradients
    return ReducedEquations(
        packed_triangle(fronts.root.left),
        e.factor.remaining(e.normal.gradient[:, None])[:, 0],
        e.normal.diagonal[part.kept],
        e.normal.system.vtpv,
        float(np.min(pivots)),
        e.normal.resolution**2,
    )


@_task
def step_part(part: LoadedPart, at: IterationState, junctions: Array, to: int) -> PartStep:
    """Step with the movement of the junctions (m,), and write the state after the step."""
    e = part.eliminated(at)
    dx = e.factor.solve(-e.normal.gradient[:, None], junctions[:, None])[:, 0]
    dx[part.kept] = junctions
    downhill, damped = float(-e.normal.gradient @ dx), float(dx @ (e.added * dx))
    equations, state = e.normal.solver.equations, part.state(at.state)
    plain = part.unknowns.retract(state, dx)
    plain = with_rig_members_placed(equations, state, plain, dx, fixed=part.kept)
    moved = with_points_held_in_front(equations, state, plain)
    if moved is None or not _same_junctions(part, plain, moved):
        return PartStep(np.inf, downhill, damped)
    try:
        v = equations.residuals(moved)
        after = float(v @ v)
    except InputError:
        after = np.inf
    part.write_state(to, moved, at.weights)
    return PartStep(after if np.isfinite(after) else np.inf, downhill, damped)


@_task
def has_ambiguous_points(part: LoadedPart, at: IterationState) -> bool:
    """Return whether points of this part alone are between two places, where all has converged."""
    return _state_without_ambiguity(part, at) is not None


@_task
def leave_ambiguous_places(part: LoadedPart, at: IterationState, to: int) -> None:
    """Write the state where such points have left; without any it is the same state."""
    found = _state_without_ambiguity(part, at)
    part.write_state(to, part.state(at.state) if found is None else found, at.weights)


def _state_without_ambiguity(part: LoadedPart, at: IterationState) -> State | None:
    """Return the state where points of this part alone have left places between two, if any."""
    state = part.state(at.state)
    normal = part.eliminated(at).normal
    nothing = np.zeros(part.unknowns.n_columns)
    run = AdjustmentRun(normal.solver, NO_ADDED_FACTORS, state, state, state, False, nothing)
    inside = points_without_rays(run.equations)
    inside[[part.number(v) for v in part.setup.variables if v.kind == "point"]] = False
    found = better_place(run, normal, inside, normal.system.vtpv) if inside.any() else None
    return None if found is None else found[0]


@_task
def ambiguous_places(part: LoadedPart, at: IterationState) -> tuple[str, ...]:
    """Return messages on points of this part alone that fit as well elsewhere.

    The junctions are held where they are, as such a point moves none of them.
    """
    return describe_second_places(part.with_known_junctions(at), part.state(at.state))


@_task
def has_equal_weights(part: LoadedPart, at: IterationState, misfit: float) -> bool:
    """Return whether the weights at a state are those that were used, see `Equations`."""
    before = part.solver_at(at).equations
    return before.weighted_at(part.state(at.state)).weighs_as(before, misfit)


@_task
def explain_part(part: LoadedPart, at: IterationState) -> None:
    """Raise an error that names the unknowns that the part leaves undetermined."""
    equations = part.with_known_junctions(at)
    state = part.state(at.state)
    solver = Solver.of(equations)
    normal = NormalEquations(solver, state)
    defects = find_defects(normal.system, state, normal.diagonal, free=False)
    error = undetermined_error(normal.system, normal.diagonal, defects, remedy=PART_CONTROL_ADVICE)
    if error is not None:
        raise error


@_task
def finish_part(part: LoadedPart, at: IterationState, totals: Totals) -> PartQuality:
    """Write covariances and reliability of a part to its folder.

    The covariances of its junctions for σ0 = 1 are in the folder; they are too large for a task.

    Args:
        part: the part.
        at: the solution.
        totals: figures of the whole network.
    """
    e = part.eliminated(at)
    fronts = e.factor.fronts
    assert isinstance(fronts, Fronts)  # parts are not solved by conjugate gradients
    fronts.root.close(unpacked_triangle(part.job.own.arrays(JUNCTIONS_FILE)["covariances"]))
    solution = PartSolution.of(e.normal, part.state(0), e.factor, totals)
    refuse_points_behind(solution.equations, solution.state)
    found = reliability(solution)
    part.job.own.write_arrays("covariances", solution.every_covariance())
    part.job.own.write_arrays(
        "reliability",
        {
            "r": found.redundancy_numbers,
            "w": found.w,
            "mdb": found.mdb,
            "delta_bar": found.delta_bar,
            "estimated_errors": found.estimated_errors,
        },
    )
    part.job.own.write(STAMP_FILE, part.stamp())
    size = np.where(found.controlled, np.abs(found.w), 0.0)
    largest = np.argsort(-size, kind="stable")[:MAX_LISTED_TESTS]
    r = found.redundancy_numbers
    done = PartQuality(
        float(r.sum()),
        int((~found.controlled).sum()),
        tuple(
            TestedObservation(solution.equations.label(int(i)), float(found.w[i]), float(r[i]))
            for i in largest
            if size[i] > 0
        ),
        _peak(),
    )
    part.last = None
    return done


# -- parts in memory ------------------------------------------------------------------------------


def _part(job: PartJob) -> LoadedPart:
    """Return a part, from memory if it is there; older ones make room for it."""
    key = job.run, job.number
    found = _loaded.pop(key, None)
    if found is None:
        limit = _limit()
        while _loaded and _resident() > MEMORY_SHARE_BEFORE_READING * limit:
            _loaded.popitem(last=False)
            gc.collect()
        found = LoadedPart(job)
    _loaded[key] = found
    return found


def _drop_all() -> None:
    _loaded.clear()
    gc.collect()


def forget_run(run: str) -> None:
    """Drop all parts of a run from the memory of this process."""
    with _lock:
        for key in [k for k in _loaded if k[0] == run]:
            del _loaded[key]
        gc.collect()


def _limit() -> float:
    """Return the bytes of memory that this process may use."""
    with suppress(ImportError, ValueError, AttributeError):
        from distributed import get_worker

        limit = get_worker().memory_manager.memory_limit
        if limit:
            return float(limit)
    return free_memory_bytes() + _resident()


def _resident() -> float:
    """Return the bytes of memory of this process; 0 where the system does not report it."""
    return _status("VmRSS:")


def _peak() -> int:
    """Return the largest memory of this process so far."""
    return int(_status("VmHWM:"))


def _status(field: str) -> float:
    with suppress(OSError), open("/proc/self/status", encoding="ascii") as lines:
        for line in lines:
            if line.startswith(field):
                return 1024.0 * float(line.split()[1])
    return 0.0


def _same_junctions(part: LoadedPart, a: Any, b: Any) -> bool:
    """Return whether two states have the same values of the junctions."""
    for v in part.setup.variables:
        number = part.number(v)
        if not np.array_equal(a[v.kind][number], b[v.kind][number]):
            return False
    return True


def _refused(error: AdjustmentError) -> PartError:
    """Return an error as data."""
    kind = type(error).__name__
    if isinstance(error, InputError | ApproximationError):
        return PartError(kind, tuple((p.where, p.what) for p in error.problems))
    if isinstance(error, DatumError):
        return PartError(kind, (("", str(error)),), error.defect, error.unknowns)
    return PartError(kind, (("", str(error)),))
