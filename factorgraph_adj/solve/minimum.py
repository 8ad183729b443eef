"""Adjustment from a start or with other weights: reweighting by lengths, second minima, datum."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from ..errors import AdjustmentError
from ..graph.equations import Equations
from ..graph.variables import State
from ..network.network import DatumChoice
from ..start.start_values import Start
from ..types import Array
from .added_factors import NO_ADDED_FACTORS, AddedFactors
from .adjustment_run import GROSS_RMS, AdjustmentRun, RunRecord, ShapeMisfit, refuse_undetermined
from .convergence import STOPPING, convergence_reason
from .datum_defects import FreeDatum
from .doubtful_points import describe_exchanged_points, describe_runaway_points
from .feasible_states import (
    DIRECTIONLESS_WEIGHT_FACTOR,
    MAX_ITERATIONS_OFF_LINES,
    describe_points_behind,
    offset_rows_on_lines,
    refuse_points_behind,
    state_off_lines,
    with_points_pulled_ahead,
)
from .gauss_newton import ITERATION, IterationEnd, Progress, iterate, step_from
from .gauss_newton_steps import NO_EXTRAPOLATIONS
from .inner_constraints import MOTION, network_on_constraints
from .machine_limits import refuse_too_large
from .normal_equations import Solver
from .second_minimum import (
    MAX_OTHER_SIDE_ITERATIONS,
    MIN_VTPV_DECREASE,
    adjustment_from_better_start,
    mirror_midpoints,
    points_without_rays,
    resolve_ambiguous_points,
)
from .shape_minimum import MAX_TRIAL_ITERATIONS, refit_shapes
from .solution import Solution

MAX_CHANCE_EXCESS_SIGMAS = 4.0
"""Largest excess of vᵀPv over its expectation, in its standard deviations, that is chance."""
MIN_WEIGHT_FACTOR = 0.5
"""Smallest factor on the weight of an observation that takes part in the judgement."""
MEDIAN_OF_CHI2 = 0.4549364
"""Median of the χ² distribution with one degree of freedom."""
NOT_ON_INNER_CONSTRAINTS = "not converged on the inner constraints of the free network"
"""Reason that a solution gives when a free network at its minimum misses its inner constraints."""
DEFAULT_TOLERANCE = 1e-5
"""Bound on the last step of every unknown relative to its own σ, if nothing else is asked for."""
DEFAULT_MAX_ITERATIONS = 100
"""Largest number of iterations, if nothing else is asked for."""
MAX_REWEIGHTINGS = 40
"""Largest number of times that weights are computed: they depend on the lengths of sights, which
hardly change with the unknowns."""
LOWER_MINIMUM_NOTE = (
    "the start was far from this minimum and vᵀPv is larger than chance explains: gross errors, or "
    "a lower minimum elsewhere, cannot be excluded"
)
"""Addition to the reason of such an adjustment."""
GROSS_ERRORS_NOTE = (
    f"the root mean square of v/σ is above {GROSS_RMS:.0f}, so that gross errors or wrong start "
    "values are likely: adjust --snoop, or fga.snoop, looks for the observations"
)
"""Addition to the reason of an adjustment that ended far from a minimum."""
MAX_PULLS_AHEAD = 3
"""Largest number of times that points are pulled back from behind cameras after an iteration."""


def fits_badly(v: Array, factors: Array | None, n_determined: int, *, relative: bool) -> bool:
    """Return whether vᵀPv is larger than chance explains.

    For normal errors E(vᵀPv) = s² r with the standard deviation s² √(2 r), r = n − u. Observations
    that an estimator has given next to no weight say nothing, and count neither in vᵀPv nor in n.
    Where standard deviations are known but for a factor, s² comes from the median of v², whose
    relative variance is 2.72 times that of vᵀPv/r; a few gross errors change vᵀPv and not s².

    Args:
        v: residuals in units of their standard deviations with these factors, (n,).
        factors: factors on the weights of the first observations, at most n; None: 1.
        n_determined: number of unknowns that the observations determine, u.
        relative: whether s² is unknown; otherwise it is 1.
    """
    used = np.ones(len(v), dtype=bool)
    if factors is not None:
        used[: len(factors)] = factors >= MIN_WEIGHT_FACTOR
    squares = np.square(v[used])
    r = len(squares) - n_determined
    if r <= 0:
        return False
    variance, spread = 1.0, np.sqrt(2.0 / r)
    if relative:
        variance = float(np.median(squares)) / MEDIAN_OF_CHI2 * len(squares) / r
        spread = np.sqrt((1.0 + 2.72) * 2.0 / r)
    return bool(squares.sum() > variance * r * (1.0 + MAX_CHANCE_EXCESS_SIGMAS * spread))


def readjust(
    solution: Solution,
    weights: Array | None,
    *,
    datum: DatumChoice | None = None,
    other_sides: bool = True,
) -> Solution:
    """Adjust a network again with other weights, starting from its solution.

    The result is that of ``adjust(network, start=solution, weights=weights)``. Equations and plan
    of the elimination are those of the solution: weights do not change them. The network must not
    have changed since.

    Args:
        solution: an adjustment of the network with any weights, or a step of one
            (`solution_after_step`).
        weights: factor on the weight of each scalar observation, as for `adjust`.
        datum: as for `adjust`.
        other_sides: whether points may go to their other sides where vᵀPv is smaller there.

    Raises:
        InputError: an observation cannot be computed, or a weight is not a number > 0; or factors
            that the user added were lost in pickling.
        DatumError: as `adjust`.
    """
    equations = solution.equations
    if solution.weights is not None:
        equations = equations.reweighted(1.0 / solution.weights)
    return adjust_from_start(
        equations,
        Start(equations.unknowns, solution.state, solution.start, solution.begun),
        free=(solution.network.datum if datum is None else datum) == "free",
        variance=solution.variance,
        weights=weights,
        extra=solution.extra,
        solver=solution.run.solver,
        astray=True,
        other_sides=other_sides,
    )


def adjust_from_start(
    equations: Equations,
    start: Start,
    *,
    free: bool,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    weights: Array | None = None,
    tolerance: float = DEFAULT_TOLERANCE,
    max_iterations: int = DEFAULT_MAX_ITERATIONS,
    extra: AddedFactors = NO_ADDED_FACTORS,
    progress: Progress | None = None,
    solver: Solver | None = None,
    astray: bool = False,
    looked: Mapping[str, ShapeMisfit] | None = None,
    other_sides: bool = True,
) -> Solution:
    """Adjust compiled equations from start values; see `adjust`.

    ``extra`` are rows beside the observations. ``solver`` is that of the same network and rows with
    other weights; None: it is made. With ``astray`` an iteration that ends where something is not
    determined that was at the start is returned as not converged; otherwise it is a `DatumError`,
    from which an incremental adjustment takes the unknowns that have to wait. ``looked`` are shapes
    that an earlier adjustment has fitted again in vain, which is not repeated where nothing has
    changed. Without ``other_sides`` points stay on the side on which the iteration finds them.
    """
    attempt = partial(
        _adjust_from_one,
        equations,
        free=free,
        variance=variance,
        weights=weights,
        tolerance=tolerance,
        max_iterations=max_iterations,
        extra=extra,
        progress=progress,
        solver=solver,
        astray=astray,
        looked={} if looked is None else looked,
        other_sides=other_sides,
    )
    return adjustment_from_better_start(attempt, start)


def _adjust_from_one(
    equations: Equations,
    start: Start,
    *,
    free: bool,
    variance: Literal["a-priori", "a-posteriori"],
    weights: Array | None,
    tolerance: float,
    max_iterations: int,
    extra: AddedFactors,
    progress: Progress | None,
    solver: Solver | None,
    astray: bool,
    looked: Mapping[str, ShapeMisfit],
    other_sides: bool,
) -> Solution:
    """Adjust compiled equations from one start; see `adjust_from_start`."""
    start = _start_off_lines(equations, start, free=free, weights=weights, extra=extra)
    run, ended = _minimise(
        equations,
        start,
        free=free,
        weights=weights,
        tolerance=tolerance,
        max_iterations=max_iterations,
        extra=extra,
        progress=progress,
        solver=solver,
        astray=astray,
        looked=looked,
        other_sides=other_sides,
    )
    if ended.converged and run.smallest_pivot < ITERATION.poor:
        run.at_solution = run.normal_at(run.state)
        refuse_undetermined(run, run.at_solution)
    if run.datum is not None:
        ended = _carry_to_datum_points(run, ended, tolerance)
    if passed := describe_points_behind(run.equations, start.state, run.state):
        why = passed if ended.converged else f"{ended.reason}; {passed}"
        gross = ended.vtpv > GROSS_RMS**2 * run.equations.n_rows and GROSS_ERRORS_NOTE not in why
        why = f"{why}; {GROSS_ERRORS_NOTE}" if gross else why
        ended = replace(ended, converged=False, reason=why)
    else:
        refuse_points_behind(run.equations, run.state)
    relative = variance == "a-posteriori"
    if ended.converged and run.damped and _fits_badly(run, weights, relative=relative):
        ended = replace(ended, reason=f"{ended.reason}; {LOWER_MINIMUM_NOTE}")
    return Solution(
        network=equations.network,
        equations=run.equations,
        state=run.state,
        start=run.start,
        converged=ended.converged,
        reason=ended.reason,
        iterations=ended.iterations,
        within=ended.left,
        second_places=(*ended.second_places, *describe_exchanged_points(run.equations, run.state)),
        begun=start.words,
        vtpv=ended.vtpv,
        run=RunRecord(run.solver, run.constraint, run.drifting, run.looked, run.at_solution),
        datum=run.datum,
        defects=run.defects,
        variance=variance,
        weights=None if weights is None else np.array(weights, dtype=float),
        extra=run.extra.at(run.equations, run.state),
        extrapolated=run.extrapolated,
    )


def _start_off_lines(
    equations: Equations, start: Start, *, free: bool, weights: Array | None, extra: AddedFactors
) -> Start:
    """Return the start, off the lines from which offsets were measured.

    These offsets say nothing of the direction; all other observations are to say it, as far as
    they can. An adjustment in which the offsets have next to no weight therefore comes first.
    """
    rows = offset_rows_on_lines(equations, start.state)
    if not rows.any():
        return start
    start = replace(start, state=state_off_lines(equations, start.state))
    factors = np.where(rows, DIRECTIONLESS_WEIGHT_FACTOR, 1.0) * (
        1.0 if weights is None else weights
    )
    with suppress(AdjustmentError):  # they are needed for more than the direction
        run, ended = _minimise(
            equations,
            start,
            free=free,
            weights=factors,
            tolerance=DEFAULT_TOLERANCE,
            max_iterations=MAX_ITERATIONS_OFF_LINES,
            extra=extra,
            progress=None,
            solver=None,
            astray=False,
            looked={},
            other_sides=True,
        )
        if np.isfinite(ended.vtpv):
            start = replace(start, state=state_off_lines(equations, run.state))
    return start


def _minimise(
    equations: Equations,
    start: Start,
    *,
    free: bool,
    weights: Array | None,
    tolerance: float,
    max_iterations: int,
    extra: AddedFactors,
    progress: Progress | None,
    solver: Solver | None,
    astray: bool,
    looked: Mapping[str, ShapeMisfit],
    other_sides: bool,
) -> tuple[AdjustmentRun, IterationEnd]:
    """Iterate to the minimum of vᵀPv; repeat with the weights that follow from the new lengths."""
    state, iterations, extrapolated = start.state, 0, NO_EXTRAPOLATIONS
    places: tuple[str, ...] = ()
    weighed = equations.weighted_at(state)
    examine = _Iteration(tolerance, MAX_OTHER_SIDE_ITERATIONS)
    for _ in range(MAX_REWEIGHTINGS):
        equations = weighed if weights is None else weighed.reweighted(weights)
        run = AdjustmentRun.at(
            equations, state, start.origin, free=free, extra=extra, solver=solver
        )
        solver, run.may_end_undetermined = run.solver, astray
        run.extrapolated, run.looked = extrapolated, looked
        run.weighted = weights is not None
        if not iterations:
            refuse_too_large(run.solver.plan, equations, state)
        go_on = _Iteration(tolerance, max_iterations, progress)
        run.state = with_points_pulled_ahead(equations, run.state, run.solver.layers.reduced)
        ended = _with_points_pulled_ahead(run, go_on(run, iterations), go_on)
        if ended.converged and other_sides:
            ended, found = resolve_ambiguous_points(run, ended, go_on, examine)
            # With the next weights the iteration begins at a place, and finds nothing between.
            places = found or places
        if ended.converged:
            ended = refit_shapes(run, ended, go_on, examine.up_to)
        iterations, state = ended.iterations, run.state
        extrapolated, looked = run.extrapolated, run.looked
        before, weighed = weighed, weighed.weighted_at(state)
        misfit = float(np.sqrt(ended.vtpv / max(equations.n_rows, 1)))
        if not ended.converged or iterations >= max_iterations or weighed.weighs_as(before, misfit):
            break
    else:
        change = np.max(np.abs(weighed.sigmas() / before.sigmas() - 1.0), initial=0.0)
        reason = (
            f"weights that depend on lengths change after {MAX_REWEIGHTINGS} adjustments: "
            f"standard deviations still change by up to {100 * change:.2g} %"
        )
        ended = replace(ended, converged=False, reason=reason, left=np.inf)
    if not ended.converged and (lost := describe_runaway_points(run.equations, run.state)):
        ended = replace(ended, reason=f"{ended.reason}; {lost}")
    if not ended.converged and ended.vtpv > GROSS_RMS**2 * run.equations.n_rows:
        ended = replace(ended, reason=f"{ended.reason}; {GROSS_ERRORS_NOTE}")
    return run, replace(ended, iterations=iterations, second_places=places)


def describe_second_places(equations: Equations, state: State) -> tuple[str, ...]:
    """Return sentences on points that fit equally well, or better, at a second place.

    Args:
        equations: a network, of which what is common with others is held.
        state: its converged values.
    """
    if not mirror_midpoints(equations, state, points_without_rays(equations)):
        return ()
    run = AdjustmentRun.at(equations, state, state, free=False)
    examine = _Iteration(DEFAULT_TOLERANCE, MAX_OTHER_SIDE_ITERATIONS)
    ended = examine(run)
    here, vtpv = run.state["point"].copy(), ended.vtpv
    if not ended.converged:
        return ()
    ended, others = resolve_ambiguous_points(run, ended, examine, examine)
    if ended.vtpv > vtpv - MIN_VTPV_DECREASE or not ended.converged:
        return others
    apart = np.linalg.norm(run.state["point"] - here, axis=1)
    name = equations.unknowns["point"].names[int(np.argmax(apart))]
    at = ", ".join(f"{x:.4f}" for x in run.state["point"][int(np.argmax(apart))])
    return (
        *others,
        f"point {name!r} fits better at {at}: give that as its approximate coordinates",
    )


def _fits_badly(run: AdjustmentRun, weights: Array | None, *, relative: bool) -> bool:
    """Return whether vᵀPv is larger than chance explains, see `fits_badly`."""
    determined = int(run.equations.unknowns.free.sum()) - sum(d.size for d in run.defects)
    return fits_badly(run.whitened(run.state), weights, determined, relative=relative)


def _with_points_pulled_ahead(
    run: AdjustmentRun, ended: IterationEnd, go_on: _Iteration
) -> IterationEnd:
    """Iterate again with points pulled back that lie behind cameras at the end."""
    for _ in range(MAX_PULLS_AHEAD):
        moved = with_points_pulled_ahead(run.equations, run.state, run.solver.layers.reduced)
        if moved is run.state or ended.iterations >= go_on.most:
            break
        run.state, run.at_solution = moved, None
        ended = go_on(run, ended.iterations)
    return ended


@dataclass(frozen=True)
class _Iteration:
    """Iteration of runs, which may be continued several times."""

    tolerance: float
    most: int
    """Largest number of iterations in all."""
    progress: Progress | None = None

    def __call__(self, run: AdjustmentRun, earlier: int = 0) -> IterationEnd:
        """Iterate from ``run.state`` after a number of iterations; the end counts them too."""
        ended = iterate(
            run,
            tolerance=self.tolerance,
            max_iterations=max(self.most - earlier, 0),
            earlier=earlier,
            progress=self.progress,
        )
        return replace(ended, iterations=earlier + ended.iterations)

    def up_to(self, run: AdjustmentRun, bound: float) -> IterationEnd:
        """Iterate from ``run.state`` until a step is below a bound, which may be looser."""
        most = min(self.most, MAX_TRIAL_ITERATIONS)
        return replace(self, tolerance=max(self.tolerance, bound), most=most)(run)


def _carry_to_datum_points(
    run: AdjustmentRun, ended: IterationEnd, tolerance: float
) -> IterationEnd:
    """Move a free network onto its inner constraints; move it back if vᵀPv grows on the way.

    The steps on the way hold a well chosen minimal datum.
    """
    assert run.datum is not None
    if ended.converged:
        here = FreeDatum(run.defects[0].at(run.equations, run.state).motions, run.datum.columns)
        run.constraint = run.normal_at(run.state).better_minimal_datum(run.constraint, here)
    shape = run.state, run.datum, run.defects
    carried = network_on_constraints(
        run.equations,
        run.state,
        run.start,
        run.datum,
        run.defects,
        normal_at=run.normal_at,
        step=lambda normal: step_from(run, normal),
        tolerance=tolerance,
        at_rest=ended.converged,
        free=run.free,
    )
    run.state, run.at_solution = carried.state, carried.normal
    run.datum, run.defects = carried.datum, carried.defects
    vtpv = run.vtpv(run.state)
    if carried.left > tolerance:
        resolution = 0.0 if carried.normal is None else carried.normal.resolution
        why = convergence_reason(carried.left, tolerance, resolution)
        left = max(carried.left, ended.left) if ended.converged_slowly else carried.left
        ended = replace(ended, reason=why, left=left)
    growth = MOTION.noticed if carried.at_rest else STOPPING.unchanged
    lost_shape = ended.converged and not vtpv <= ended.vtpv + growth * (1.0 + ended.vtpv)
    if lost_shape:
        (run.state, run.datum, run.defects), run.at_solution = shape, None
        vtpv = ended.vtpv
    if lost_shape or (ended.converged and not carried.at_rest):
        ended = replace(ended, converged=False, reason=NOT_ON_INNER_CONSTRAINTS, left=np.inf)
    return replace(ended, vtpv=vtpv)
