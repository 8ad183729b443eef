"""Shapes that fit badly after convergence: fitted again to their points, or turned round.

A shape that is placed from its first few points may not be the one that all of its points make: a
cylinder through five points is not unique, and later points leave it in a minimum of its own. The
normal of a plane or the axis of a cylinder may point either way, and a relation with a sense fits
one of them. After convergence, where the observations of a shape exceed what chance explains, the
adjustment is repeated with the shape turned round, and with the shape fitted again to its points
where they are without it. The smallest vᵀPv counts. A start at which every residual is as it was at
another start, except for its sign, is the same shape with its axis the other way, and is not tried
again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from ..errors import AdjustmentError, InputError
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.unknown_registry import UNKNOWNS
from ..start.shape_fit import ShapeFit, frames_of_shapes, shape_observations
from ..types import Array, Index
from .adjustment_run import AdjustmentRun, ShapeMisfit
from .gauss_newton import IterationEnd

MIN_EXCESS_SIGMAS = 4.0
"""Excess of vᵀPv of n rows over n, in units of its standard deviation √(2n), from which a shape is
examined."""
LOOSE_SHAPE_WEIGHT_FACTOR = 1e-6
"""Factor on the weights of a shape's observations with which its points are found without it."""
MIN_SHAPE_VTPV_DECREASE, MIN_SHAPE_VTPV_DECREASE_RATIO = 1e-6, 1e-9
"""Decrease of vᵀPv from which another minimum counts as better, and more of it relative to vᵀPv."""
TRIAL_TOLERANCE, TRIAL_TOLERANCE_RATIO = 1e-2, 1e-4
"""Bound of the last step relative to σ up to which another start is followed, and the same relative
to √vᵀPv where that is more: such a step changes vᵀPv by 1e-8 of its value."""
MAX_TRIAL_ITERATIONS = 50
"""Largest number of iterations from another start."""
LOOSE_TOLERANCE_FACTOR = 10.0
"""Multiple of this bound up to which points are followed without the shape: they are a start."""
MAX_SAME_RESIDUAL_RATIO = 1e-9
"""Largest difference of the amounts of residuals, relative to √vᵀPv, at starts that are the same
shape."""
MIN_MISFIT_CHANGE_FACTOR = 1.5
"""Factor by which the rows or the excess of a shape that was fitted again in vain change before it
is fitted again, so that n arrivals on it cost in proportion to log n. An adjustment that settles
does not count earlier failures."""
MAX_SHAPES_REFITTED = 10
"""Largest number of shapes that are examined, those that fit worst first."""
HALF_TURN_ABOUT_X = np.array([1.0, -1.0, -1.0])
"""Diagonal of the half turn about x, which reverses the z axis of a frame."""


def refitted_shape(equations: Equations, state: State, f: int) -> State | None:
    """Return a state with the free components and sizes of one shape from its points alone.

    Args:
        equations: the network.
        state: its values.
        f: number of the frame of the shape.

    Returns:
        The state; None where no shape was found.
    """
    parts = [part for number, part in shape_observations(equations) if number == f]
    table = equations.unknowns["frame"]
    given = np.where(table.free[f], np.nan, UNKNOWNS["frame"].given(state["frame"][f][None])[0])
    lost = free_sizes(equations, f)
    refitted = {**state, "frame": state["frame"].copy()}
    refitted["frame"][f, :13] = np.nan
    for kind, number in lost:
        refitted[kind] = refitted[kind].copy()
        refitted[kind][number] = np.nan
    with np.errstate(all="ignore"):  # trials may be anything
        what = ShapeFit(equations, refitted, f, parts, lost, given).run()
    found = not what and np.isfinite(refitted["frame"][f]).all()
    return refitted if found else None


def free_sizes(equations: Equations, f: int) -> list[tuple[str, int]]:
    """Return kind and number of the free sizes of a shape, by the number of its frame."""
    parts = (part for number, part in shape_observations(equations) if number == f)
    keys = dict.fromkeys((k, int(i)) for p in parts for k, n in p.sizes for i in np.unique(n))
    return [(k, i) for k, i in keys if equations.unknowns[k].free[i].any()]


def refit_shapes(
    run: AdjustmentRun,
    ended: IterationEnd,
    go_on: Callable[[AdjustmentRun, int], IterationEnd],
    examine: Callable[[AdjustmentRun, float], IterationEnd],
) -> IterationEnd:
    """Fit shapes again that do not fit; ``run.state`` becomes the better minimum, or stays.

    Args:
        run: a converged adjustment. Shapes in ``run.looked`` that have not changed since are not
            examined; at the end it has the shapes that were examined in vain.
        ended: how it ended.
        go_on: function that iterates from ``run.state`` after a number of iterations.
        examine: function that iterates from another state, with iterations of its own, up to a
            bound of the last step relative to σ.

    Returns:
        How it ended at last.
    """
    names = run.equations.unknowns["frame"].names
    in_vain: dict[str, ShapeMisfit] = {}
    improved = False
    for f, rows, now in _misfits(run):
        better, before = False, run.looked.get(names[f])
        if before is not None and _alike(before, now):
            now = before
        else:
            for other in _ends(run, f, rows, trial_tolerance(ended.vtpv), examine):
                if (
                    other[1]
                    < ended.vtpv
                    - MIN_SHAPE_VTPV_DECREASE
                    - MIN_SHAPE_VTPV_DECREASE_RATIO * ended.vtpv
                ):
                    run.state, run.at_solution, better = other[0], None, True
                    ended = go_on(run, ended.iterations)
                    if not ended.converged:
                        return ended
        if not better:
            in_vain[names[f]] = now
        improved |= better
    # At another minimum a shape that was examined before may be fitted in another way.
    run.looked = {} if improved else in_vain
    _make_sizes_positive(run, ended.vtpv)
    return ended


def trial_tolerance(vtpv: float) -> float:
    """Return the bound of the last step, relative to σ, up to which other starts are followed."""
    return max(TRIAL_TOLERANCE, TRIAL_TOLERANCE_RATIO * float(np.sqrt(vtpv)))


def _alike(before: ShapeMisfit, now: ShapeMisfit) -> bool:
    """Return whether neither the number of the rows of a shape nor their misfit changed much."""
    changes = np.array([now.rows / before.rows, now.excess / before.excess])
    return bool(
        np.all((changes > 1.0 / MIN_MISFIT_CHANGE_FACTOR) & (changes < MIN_MISFIT_CHANGE_FACTOR))
    )


def _ends(
    run: AdjustmentRun,
    f: int,
    rows: Index,
    bound: float,
    examine: Callable[[AdjustmentRun, float], IterationEnd],
) -> Iterator[tuple[State, float]]:
    """Yield states at which iterations from other starts of a shape converged, with vᵀPv."""
    tried = [run.equations.residuals(run.state)]
    for state in _others(run, f, rows, bound, examine):
        if _tried_before(run, state, tried):
            continue
        other = replace(run, state=state, at_solution=None, last=None)
        try:
            there = examine(other, bound)
        except AdjustmentError:  # something is not determined, or cannot be computed there
            continue
        if there.converged:
            yield other.state, there.vtpv


def _tried_before(run: AdjustmentRun, state: State, tried: list[Array]) -> bool:
    """Return whether a start is one that was tried, but for senses; otherwise note its residuals.

    Args:
        run: the adjustment.
        state: the start.
        tried: residuals at the starts before it, (n_rows,) each.
    """
    try:
        v = run.equations.residuals(state)
    except InputError:  # an observation is degenerate there, which the adjustment reports as well
        return False
    bound = MAX_SAME_RESIDUAL_RATIO * float(np.linalg.norm(v))
    if any(np.max(np.abs(np.abs(v) - np.abs(other))) <= bound for other in tried):
        return True
    tried.append(v)
    return False


def _make_sizes_positive(run: AdjustmentRun, vtpv: float) -> None:
    """Turn shapes round that are the same with sizes of the opposite sign, as paraboloids are."""
    equations = run.equations
    for f in sorted(frames_of_shapes(equations)):
        sizes = [(k, i) for k, i in free_sizes(equations, f) if run.state[k][i, 0] < 0]
        if not sizes:
            continue
        state = with_shape_reversed(run.state, f)
        for kind, number in sizes:
            state[kind] = state[kind].copy()
            state[kind][number, 0] *= -1.0
        if run.vtpv(state) <= vtpv + MIN_SHAPE_VTPV_DECREASE + MIN_SHAPE_VTPV_DECREASE_RATIO * vtpv:
            run.state, run.at_solution = state, None


def _misfits(run: AdjustmentRun) -> list[tuple[int, Index, ShapeMisfit]]:
    """Return the frames of shapes that fit badly, the worst first, their rows, and the misfit."""
    equations = run.equations
    some = sorted(frames_of_shapes(equations))
    if not some:
        return []
    v = equations.residuals(run.state)
    found = []
    for f in some:
        rows = _rows(equations, f)
        excess = (float(v[rows] @ v[rows]) - len(rows)) / np.sqrt(2.0 * len(rows))
        if excess > MIN_EXCESS_SIGMAS:
            found.append((f, rows, ShapeMisfit(float(excess), len(rows))))
    found.sort(key=lambda each: -each[2].excess)
    return found[:MAX_SHAPES_REFITTED]


def _rows(equations: Equations, f: int) -> Index:
    """Return the rows of the observations that touch a frame."""
    out = [np.zeros(0, dtype=np.intp)]
    for block in equations.blocks:
        if block.prior:
            continue
        on = np.zeros(len(block.observed), dtype=bool)
        for kind, index in block.variables:
            if kind == "frame":
                on |= index == f
        rows = np.arange(equations.n_rows)[block.rows].reshape(-1, block.dimension)
        out.append(rows[on].ravel())
    return np.concatenate(out)


def _others(
    run: AdjustmentRun,
    f: int,
    rows: Index,
    bound: float,
    examine: Callable[[AdjustmentRun, float], IterationEnd],
) -> Iterator[State]:
    """Yield states with the shape turned round and fitted again, each in both senses."""
    yield with_shape_reversed(run.state, f)
    weights = np.ones(run.equations.n_rows)
    weights[rows] = LOOSE_SHAPE_WEIGHT_FACTOR
    loose = AdjustmentRun.at(
        run.equations.reweighted(weights),
        run.state,
        run.start,
        free=run.free,
        extra=run.extra,
        solver=run.solver,
    )
    try:
        examine(loose, LOOSE_TOLERANCE_FACTOR * bound)
    except AdjustmentError:  # only the shape determines something
        return
    state = refitted_shape(run.equations, loose.state, f)
    if state is not None:
        yield state
        yield with_shape_reversed(state, f)


def with_shape_reversed(state: State, f: int) -> State:
    """Return a state in which the z axis of a frame points the other way, at the same place."""
    frames: Array = state["frame"].copy()
    frames[f, :9] = (frames[f, :9].reshape(3, 3) * HALF_TURN_ABOUT_X).ravel()
    frames[f, 9:12] *= HALF_TURN_ABOUT_X
    return {**state, "frame": frames}
