"""What the process of a part does: each function is one task, which any process can do again.

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
from ..errors import AdjustmentError, ApproximationError, DatumError, InputError
from ..graph.variables import State
from ..quality.reliability import reliability
from ..solve.ambiguous_points import better_place, standing_free
from ..solve.carried import carried
from ..solve.datum import find_defects
from ..solve.extra import NOTHING_MORE
from ..solve.memory import available
from ..solve.minimum import places_beside
from ..solve.normal import NormalEquations, Solver
from ..solve.rank import undetermined
from ..solve.run import Run
from ..solve.sides import before_the_cameras, refuse_points_behind
from ..solve.singular import SingularError
from ..types import Array, Keys
from .loaded import STAMP, Job, Loaded
from .messages import (
    LISTED,
    At,
    Begun,
    Finished,
    Moved,
    Reduced,
    Refused,
    Setup,
    Shared,
    Surveyed,
    Tested,
    packed,
    unpacked,
)
from .solution import PartSolution, Totals

HELD = 0.25
"""Share of a process's memory above which a process drops parts before it reads another one."""
FULL = 0.5
"""Share of a process's memory above which a process drops all its parts after a task: Dask gives
no tasks to a worker with more than 0.8."""
REMEDY = (
    "even if all its junctions with other parts are known: give control in this part, or "
    "observations that tie it to its junctions"
)
"""What a user can do about datum defects of a part."""
JUNCTIONS = "junctions"
"""Name of the arrays of the covariances of the junctions."""

P = ParamSpec("P")
R = TypeVar("R")

_loaded: OrderedDict[tuple[str, int], Loaded] = OrderedDict()
_lock = RLock()


def _task(
    function: Callable[Concatenate[Loaded, P], R],
) -> Callable[Concatenate[Job, P], R | Refused]:
    """Let a task have its part in memory, and return its errors instead of raising them."""

    def run(job: Job, /, *args: P.args, **kwargs: P.kwargs) -> R | Refused:
        with _lock, one_thread:  # a part is changed by one task at a time
            try:
                return function(_part(job), *args, **kwargs)
            except AdjustmentError as error:
                return _refused(error)
            finally:
                if _resident() > FULL * _limit():
                    _drop_all()

    run.__name__ = run.__qualname__ = function.__name__
    run.__doc__ = function.__doc__
    run.__module__ = function.__module__
    return run


@_task
def survey(part: Loaded) -> Surveyed:
    """Return what the root has to know to find the junctions."""
    return part.surveyed()


@_task
def share(part: Loaded, keys: Keys) -> list[Shared]:
    """Return the variables with some keys."""
    return part.shared(keys)


@_task
def observations_at(part: Loaded, keys: Keys) -> Keys:
    """Return a number for each observation whose unknowns all have some keys, (k,)."""
    return np.unique(part.observations_at(keys)[0])


@_task
def labels_of(part: Loaded, keys: Keys, numbers: Keys) -> list[tuple[str, str]]:
    """Return kind and name of observations by their numbers."""
    return part.labels_of(keys, numbers)


@_task
def begin(part: Loaded, setup: Setup) -> Begun:
    """Take in the junctions, and write the first state."""
    return part.begin(setup)


@_task
def eliminate(part: Loaded, at: At) -> Reduced:
    """Linearise, and reduce the normal equations to the junctions."""
    m = len(part.kept)
    try:
        e = part.eliminated(at)
    except SingularError:
        nothing = np.zeros(m)
        return Reduced(packed(np.zeros((m, m))), nothing, nothing, np.nan, 0.0, 0.0)
    pivots = e.factor.relative_pivots(e.normal.diagonal + e.added, tree=1.0, point=1e9)
    pivots[~part.unknowns.free] = np.inf
    fronts = e.factor.fronts
    assert fronts is not None
    return Reduced(
        packed(fronts.root.left),
        e.factor.remaining(e.normal.gradient[:, None])[:, 0],
        e.normal.diagonal[part.kept],
        e.normal.system.vtpv,
        float(np.min(pivots)),
        e.normal.resolution**2,
    )


@_task
def move(part: Loaded, at: At, junctions: Array, to: int) -> Moved:
    """Step with the movement of the junctions (m,), and write the state after the step."""
    e = part.eliminated(at)
    dx = e.factor.solve(-e.normal.gradient[:, None], junctions[:, None])[:, 0]
    dx[part.kept] = junctions
    downhill, damped = float(-e.normal.gradient @ dx), float(dx @ (e.added * dx))
    equations, state = e.normal.solver.equations, part.state(at.state)
    plain = part.unknowns.retract(state, dx)
    plain = carried(equations, state, plain, dx, fixed=part.kept)
    moved = before_the_cameras(equations, state, plain)
    if moved is None or not _same_junctions(part, plain, moved):
        return Moved(np.inf, downhill, damped)
    try:
        v = equations.residuals(moved)
        after = float(v @ v)
    except InputError:
        after = np.inf
    part.write_state(to, moved, at.weights)
    return Moved(after if np.isfinite(after) else np.inf, downhill, damped)


@_task
def is_between(part: Loaded, at: At) -> bool:
    """Return whether points of this part alone are between two places, where all is at rest."""
    return _beside(part, at) is not None


@_task
def leave(part: Loaded, at: At, to: int) -> None:
    """Write the state where such points have left; without any it is the same state."""
    found = _beside(part, at)
    part.write_state(to, part.state(at.state) if found is None else found, at.weights)


def _beside(part: Loaded, at: At) -> State | None:
    """Return the state where points of this part alone have left places between two, if any."""
    state = part.state(at.state)
    normal = part.eliminated(at).normal
    nothing = np.zeros(part.unknowns.n_columns)
    run = Run(normal.solver, NOTHING_MORE, state, state, state, False, nothing)
    inside = standing_free(run.equations)
    inside[[part.number(v) for v in part.setup.variables if v.kind == "point"]] = False
    found = better_place(run, normal, inside, normal.system.vtpv) if inside.any() else None
    return None if found is None else found[0]


@_task
def second_places(part: Loaded, at: At) -> tuple[str, ...]:
    """Return what is to be told of points of this part alone that fit as well elsewhere.

    The junctions are held where they are, as such a point moves none of them.
    """
    return places_beside(part.with_known_junctions(at), part.state(at.state))


@_task
def weighs_as(part: Loaded, at: At, misfit: float) -> bool:
    """Return whether the weights at a state are those that were used, see `Equations`."""
    before = part.solver_at(at).equations
    return before.weighted_at(part.state(at.state)).weighs_as(before, misfit)


@_task
def explain(part: Loaded, at: At) -> None:
    """Raise an error that names the unknowns that the part leaves undetermined."""
    equations = part.with_known_junctions(at)
    state = part.state(at.state)
    solver = Solver.of(equations)
    normal = NormalEquations(solver, state)
    defects = find_defects(normal.system, state, normal.diagonal, free=False)
    error = undetermined(normal.system, normal.diagonal, defects, remedy=REMEDY)
    if error is not None:
        raise error


@_task
def finish(part: Loaded, at: At, totals: Totals) -> Finished:
    """Write covariances and reliability of a part to its folder.

    The covariances of its junctions for σ0 = 1 are in the folder; they are too large for a task.

    Args:
        part: the part.
        at: the solution.
        totals: figures of the whole network.
    """
    e = part.eliminated(at)
    fronts = e.factor.fronts
    assert fronts is not None
    fronts.root.close(unpacked(part.job.own.arrays(JUNCTIONS)["covariances"]))
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
    part.job.own.write(STAMP, part.stamp())
    size = np.where(found.controlled, np.abs(found.w), 0.0)
    largest = np.argsort(-size, kind="stable")[:LISTED]
    r = found.redundancy_numbers
    done = Finished(
        float(r.sum()),
        int((~found.controlled).sum()),
        tuple(
            Tested(solution.equations.label(int(i)), float(found.w[i]), float(r[i]))
            for i in largest
            if size[i] > 0
        ),
        _peak(),
    )
    part.last = None
    return done


# -- parts in memory ------------------------------------------------------------------------------


def _part(job: Job) -> Loaded:
    """Return a part, from memory if it is there; older ones make room for it."""
    key = job.run, job.number
    found = _loaded.pop(key, None)
    if found is None:
        limit = _limit()
        while _loaded and _resident() > HELD * limit:
            _loaded.popitem(last=False)
            gc.collect()
        found = Loaded(job)
    _loaded[key] = found
    return found


def _drop_all() -> None:
    _loaded.clear()
    gc.collect()


def forget(run: str) -> None:
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
    return available() + _resident()


def _resident() -> float:
    """Return the bytes of memory of this process; 0 where the system does not tell."""
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


def _same_junctions(part: Loaded, a: Any, b: Any) -> bool:
    """Return whether two states have the same values of the junctions."""
    for v in part.setup.variables:
        number = part.number(v)
        if not np.array_equal(a[v.kind][number], b[v.kind][number]):
            return False
    return True


def _refused(error: AdjustmentError) -> Refused:
    """Return an error as data."""
    kind = type(error).__name__
    if isinstance(error, InputError | ApproximationError):
        return Refused(kind, tuple((p.where, p.what) for p in error.problems))
    if isinstance(error, DatumError):
        return Refused(kind, (("", str(error)),), error.defect, error.unknowns)
    return Refused(kind, (("", str(error)),))
