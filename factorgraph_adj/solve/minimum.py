"""The minimum of vᵀPv from start values: iterations, weights, datum, solution."""

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
from ..types import Array
from .ambiguous_points import LOWER, MOST_THERE, resolve_ambiguous_points, standing_free
from .datum import FreeDatum
from .determine import GROSS, refuse_unnoticed
from .exchanged_places import exchanged_places
from .extra import NOTHING_MORE, Extra
from .extrapolation import NONE_TAKEN
from .fit import fits_badly
from .free_network import MOTION, carry
from .iterate import ITERATION, Ended, Progress, iterate, step_from
from .memory import refuse_too_large
from .mirrors import mirror_midpoints
from .normal import Solver
from .points_behind import pulled_ahead
from .run import Looked, Run
from .runaway_points import points_without_place
from .second_start import better_of_both
from .shapes_anew import MOST_TRIED, look_at_shapes
from .sides import ended_behind, refuse_points_behind
from .solution import Solution
from .start import Start
from .starts_on_lines import LIGHT_WEIGHT, MOST_BESIDE, beside_lines, rows_on_lines
from .stopping import STOPPING, at_rest

OFF_DATUM = "not at rest on the inner constraints of the free network"
"""Reason that a solution gives when a free network at its minimum misses its inner constraints."""
TOLERANCE = 1e-5
"""Bound on the last step of every unknown relative to its own σ, if nothing else is asked for."""
MOST_ITERATIONS = 100
"""Largest number of iterations, if nothing else is asked for."""
MOST_WEIGHINGS = 40
"""Largest number of times that weights are computed: they depend on the lengths of sights, which
hardly change with the unknowns."""

LOWER_MINIMUM_POSSIBLE = (
    "the start was far from this minimum and vᵀPv is larger than chance explains: gross errors, or "
    "a lower minimum elsewhere, cannot be excluded"
)
"""Addition to the reason of such an adjustment."""
GROSS_END = (
    f"the root mean square of v/σ is above {GROSS:.0f}, so that gross errors or wrong start values "
    "are likely: adjust --snoop, or fga.snoop, looks for the observations"
)
"""Addition to the reason of an adjustment that ended far from a minimum."""
MOST_PULLED_BACK = 3
"""Largest number of times that points are pulled back from behind cameras after an iteration."""


def readjust(
    solution: Solution, weights: Array | None, *, datum: DatumChoice | None = None
) -> Solution:
    """Adjust a network again with other weights, starting from its solution.

    The result is that of ``adjust(network, start=solution, weights=weights)``. Equations and plan
    of the elimination are those of the solution: weights do not change them. The network must not
    have changed since.

    Args:
        solution: an adjustment of the network with any weights, or a step of one (`stepped`).
        weights: factor on the weight of each scalar observation, as for `adjust`.
        datum: as for `adjust`.

    Raises:
        InputError: an observation cannot be computed, or a weight is not a number > 0; or factors
            that the user added were lost in pickling.
        DatumError: as `adjust`.
    """
    equations = solution.equations
    if solution.weights is not None:
        equations = equations.reweighted(1.0 / solution.weights)
    return adjust_from(
        equations,
        Start(equations.unknowns, solution.state, solution.start, solution.begun),
        free=(solution.network.datum if datum is None else datum) == "free",
        variance=solution.variance,
        weights=weights,
        extra=solution.extra,
        solver=solution.solver,
        astray=True,
    )


def adjust_from(
    equations: Equations,
    start: Start,
    *,
    free: bool,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    weights: Array | None = None,
    tolerance: float = TOLERANCE,
    max_iterations: int = MOST_ITERATIONS,
    extra: Extra = NOTHING_MORE,
    progress: Progress | None = None,
    solver: Solver | None = None,
    astray: bool = False,
    looked: Mapping[str, Looked] | None = None,
    other_sides: bool = True,
) -> Solution:
    """Adjust compiled equations from start values; see `adjust`.

    ``extra`` are rows beside the observations. ``solver`` is that of the same network and rows with
    other weights; none: it is made. With ``astray`` an iteration that ends where something is not
    determined that was at the start is returned as not converged; otherwise it is a `DatumError`,
    by which an incremental adjustment knows what to let wait. ``looked`` are shapes that an
    adjustment before has fitted anew in vain, which is not repeated where nothing has changed.
    Without ``other_sides`` points stay on the side on which the iteration finds them.
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
    return better_of_both(attempt, start)


def _adjust_from_one(
    equations: Equations,
    start: Start,
    *,
    free: bool,
    variance: Literal["a-priori", "a-posteriori"],
    weights: Array | None,
    tolerance: float,
    max_iterations: int,
    extra: Extra,
    progress: Progress | None,
    solver: Solver | None,
    astray: bool,
    looked: Mapping[str, Looked],
    other_sides: bool,
) -> Solution:
    """Adjust compiled equations from one start; see `adjust_from`."""
    start = _beside_lines(equations, start, free=free, weights=weights, extra=extra)
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
        refuse_unnoticed(run, run.at_solution)
    if run.datum is not None:
        ended = _carry_to_datum_points(run, ended, tolerance)
    if passed := ended_behind(run.equations, start.state, run.state):
        why = passed if ended.converged else f"{ended.reason}; {passed}"
        gross = ended.vtpv > GROSS**2 * run.equations.n_rows and GROSS_END not in why
        why = f"{why}; {GROSS_END}" if gross else why
        ended = replace(ended, converged=False, reason=why)
    else:
        refuse_points_behind(run.equations, run.state)
    relative = variance == "a-posteriori"
    if ended.converged and run.damped and _fits_badly(run, weights, relative=relative):
        ended = replace(ended, reason=f"{ended.reason}; {LOWER_MINIMUM_POSSIBLE}")
    return Solution(
        network=equations.network,
        equations=run.equations,
        state=run.state,
        start=run.start,
        converged=ended.converged,
        reason=ended.reason,
        iterations=ended.iterations,
        within=ended.left,
        second_places=(*ended.second_places, *exchanged_places(run.equations, run.state)),
        begun=start.words,
        vtpv=ended.vtpv,
        solver=run.solver,
        constraint=run.constraint,
        datum=run.datum,
        defects=run.defects,
        variance=variance,
        weights=None if weights is None else np.array(weights, dtype=float),
        extra=run.extra.at(run.equations, run.state),
        drifting=run.drifting,
        extrapolated=run.extrapolated,
        looked=run.looked,
        linearised=run.at_solution,
    )


def _beside_lines(
    equations: Equations, start: Start, *, free: bool, weights: Array | None, extra: Extra
) -> Start:
    """Return the start, off the lines from which offsets were measured.

    These offsets say nothing of the direction; all other observations are to say it, as far as
    they can. An adjustment in which the offsets have next to no weight therefore comes first.
    """
    rows = rows_on_lines(equations, start.state)
    if not rows.any():
        return start
    start = replace(start, state=beside_lines(equations, start.state))
    factors = np.where(rows, LIGHT_WEIGHT, 1.0) * (1.0 if weights is None else weights)
    with suppress(AdjustmentError):  # they are needed for more than the direction
        run, ended = _minimise(
            equations,
            start,
            free=free,
            weights=factors,
            tolerance=TOLERANCE,
            max_iterations=MOST_BESIDE,
            extra=extra,
            progress=None,
            solver=None,
            astray=False,
            looked={},
            other_sides=True,
        )
        if np.isfinite(ended.vtpv):
            start = replace(start, state=beside_lines(equations, run.state))
    return start


def _minimise(
    equations: Equations,
    start: Start,
    *,
    free: bool,
    weights: Array | None,
    tolerance: float,
    max_iterations: int,
    extra: Extra,
    progress: Progress | None,
    solver: Solver | None,
    astray: bool,
    looked: Mapping[str, Looked],
    other_sides: bool,
) -> tuple[Run, Ended]:
    """Iterate to the minimum of vᵀPv; repeat with the weights that follow from the new lengths."""
    state, iterations, extrapolated = start.state, 0, NONE_TAKEN
    told: tuple[str, ...] = ()
    weighed = equations.weighted_at(state)
    examine = _Iteration(tolerance, MOST_THERE)
    for _ in range(MOST_WEIGHINGS):
        equations = weighed if weights is None else weighed.reweighted(weights)
        run = Run.at(equations, state, start.origin, free=free, extra=extra, solver=solver)
        solver, run.may_go_astray = run.solver, astray
        run.extrapolated, run.looked = extrapolated, looked
        run.weighted = weights is not None
        if not iterations:
            refuse_too_large(run.solver.plan, equations, state)
        go_on = _Iteration(tolerance, max_iterations, progress)
        run.state = pulled_ahead(equations, run.state, run.solver.layers.reduced)
        ended = _ahead_of_cameras(run, go_on(run, iterations), go_on)
        if ended.converged and other_sides:
            ended, found = resolve_ambiguous_points(run, ended, go_on, examine)
            # With the next weights the iteration begins at a place, and finds nothing between.
            told = found or told
        if ended.converged:
            ended = look_at_shapes(run, ended, go_on, examine.up_to)
        iterations, state = ended.iterations, run.state
        extrapolated, looked = run.extrapolated, run.looked
        before, weighed = weighed, weighed.weighted_at(state)
        misfit = float(np.sqrt(ended.vtpv / max(equations.n_rows, 1)))
        if not ended.converged or iterations >= max_iterations or weighed.weighs_as(before, misfit):
            break
    else:
        change = np.max(np.abs(weighed.sigmas() / before.sigmas() - 1.0), initial=0.0)
        reason = (
            f"weights that depend on lengths are not at rest after {MOST_WEIGHINGS} adjustments: "
            f"standard deviations still change by up to {100 * change:.2g} %"
        )
        ended = replace(ended, converged=False, reason=reason, left=np.inf)
    if not ended.converged and (lost := points_without_place(run.equations, run.state)):
        ended = replace(ended, reason=f"{ended.reason}; {lost}")
    if not ended.converged and ended.vtpv > GROSS**2 * run.equations.n_rows:
        ended = replace(ended, reason=f"{ended.reason}; {GROSS_END}")
    return run, replace(ended, iterations=iterations, second_places=told)


def places_beside(equations: Equations, state: State) -> tuple[str, ...]:
    """Return sentences on points that fit equally well, or better, at a second place.

    Args:
        equations: a network, of which what is common with others is held.
        state: where it is at rest.
    """
    if not mirror_midpoints(equations, state, standing_free(equations)):
        return ()
    run = Run.at(equations, state, state, free=False)
    examine = _Iteration(TOLERANCE, MOST_THERE)
    ended = examine(run)
    here, vtpv = run.state["point"].copy(), ended.vtpv
    if not ended.converged:
        return ()
    ended, told = resolve_ambiguous_points(run, ended, examine, examine)
    if ended.vtpv > vtpv - LOWER or not ended.converged:
        return told
    apart = np.linalg.norm(run.state["point"] - here, axis=1)
    name = equations.unknowns["point"].names[int(np.argmax(apart))]
    at = ", ".join(f"{x:.4f}" for x in run.state["point"][int(np.argmax(apart))])
    return (*told, f"point {name!r} fits better at {at}: give that as its approximate coordinates")


def _fits_badly(run: Run, weights: Array | None, *, relative: bool) -> bool:
    """Return whether vᵀPv is larger than chance explains, see `fits_badly`."""
    determined = int(run.equations.unknowns.free.sum()) - sum(d.size for d in run.defects)
    return fits_badly(run.whitened(run.state), weights, determined, relative=relative)


def _ahead_of_cameras(run: Run, ended: Ended, go_on: _Iteration) -> Ended:
    """Iterate again with points pulled back that lie behind cameras at the end."""
    for _ in range(MOST_PULLED_BACK):
        moved = pulled_ahead(run.equations, run.state, run.solver.layers.reduced)
        if moved is run.state or ended.iterations >= go_on.most:
            break
        run.state, run.at_solution = moved, None
        ended = go_on(run, ended.iterations)
    return ended


@dataclass(frozen=True)
class _Iteration:
    """The iteration of runs, which may go on several times."""

    tolerance: float
    most: int
    """Largest number of iterations in all."""
    progress: Progress | None = None

    def __call__(self, run: Run, earlier: int = 0) -> Ended:
        """Iterate from ``run.state`` after a number of iterations; the end counts them too."""
        ended = iterate(
            run,
            tolerance=self.tolerance,
            max_iterations=max(self.most - earlier, 0),
            earlier=earlier,
            progress=self.progress,
        )
        return replace(ended, iterations=earlier + ended.iterations)

    def up_to(self, run: Run, bound: float) -> Ended:
        """Iterate from ``run.state`` until a step is below a bound, which may be looser."""
        most = min(self.most, MOST_TRIED)
        return replace(self, tolerance=max(self.tolerance, bound), most=most)(run)


def _carry_to_datum_points(run: Run, ended: Ended, tolerance: float) -> Ended:
    """Move a free network onto its inner constraints; move it back if vᵀPv grows on the way.

    The steps on the way hold a well chosen minimal datum.
    """
    assert run.datum is not None
    if ended.converged:
        here = FreeDatum(run.defects[0].at(run.equations, run.state).motions, run.datum.columns)
        run.constraint = run.normal_at(run.state).held_better(run.constraint, here)
    shape = run.state, run.datum, run.defects
    carried = carry(
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
        why = at_rest(carried.left, tolerance, resolution)
        left = max(carried.left, ended.left) if ended.crept else carried.left
        ended = replace(ended, reason=why, left=left)
    growth = MOTION.noticed if carried.at_rest else STOPPING.unchanged
    lost_shape = ended.converged and not vtpv <= ended.vtpv + growth * (1.0 + ended.vtpv)
    if lost_shape:
        (run.state, run.datum, run.defects), run.at_solution = shape, None
        vtpv = ended.vtpv
    if lost_shape or (ended.converged and not carried.at_rest):
        ended = replace(ended, converged=False, reason=OFF_DATUM, left=np.inf)
    return replace(ended, vtpv=vtpv)
