"""Solutions at given states: values found in another way, or a step with other weights."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import DatumError
from ..graph.equations import Equations
from ..graph.variables import State
from ..start.start_values import Start
from ..types import Array
from .added_factors import NO_ADDED_FACTORS, AddedFactors
from .adjustment_run import RunRecord
from .convergence import STOPPING
from .datum_defects import Defect, FreeDatum, find_defects
from .inner_constraints import (
    MOTION,
    datum_columns,
    displacement_from_start,
    is_negligible_motion,
    state_on_constraints,
)
from .linearised_equations import LinearisedEquations, sum_of_squares
from .minimum import NOT_ON_INNER_CONSTRAINTS
from .normal_equations import NormalEquations, Solver
from .solution import Solution

STEP_TO_OTHER_WEIGHTS = "a step on the way to other weights"
"""Reason of a solution that is only a step."""


def solution_after_step(solution: Solution, movement: Array, weights: Array) -> Solution:
    """Return an adjustment after a step, linearised there with other weights.

    The plan of the elimination is that of the solution: weights do not change it. Covariances of a
    step are not checked by probes.

    Args:
        solution: an adjustment, or a step of one.
        movement: step of the unknowns, (n_columns,).
        weights: factor on the weight of each scalar observation, as for `adjust`.

    Raises:
        InputError: an observation cannot be computed after the step.
    """
    before = 1.0 if solution.weights is None else solution.weights
    equations = solution.equations.reweighted(weights / before)
    state = equations.unknowns.retract(solution.state, movement)
    solver = solution.run.solver.reweighted(equations, probing=False)
    extra = solution.extra.at(equations, state)
    normal = NormalEquations(solver, state, extra.rows)
    return replace(
        solution,
        equations=equations,
        state=state,
        converged=False,
        reason=STEP_TO_OTHER_WEIGHTS,
        vtpv=normal.system.vtpv,
        run=replace(solution.run, solver=solver, linearised=normal),
        weights=weights,
        extra=extra,
    )


def solution_at_given_values(
    equations: Equations,
    start: Start,
    constraint: Array | None,
    *,
    reason: str,
    within: float = np.inf,
    doubt: str = "",
    extra: AddedFactors = NO_ADDED_FACTORS,
) -> Solution:
    """Return the solution of values; a free network's is moved onto its inner constraints.

    Args:
        equations: the network.
        start: the values, and those from which they were found.
        constraint: what the minimal datum of a free network adds to the diagonal of N,
            (n_columns,); None: the datum is given.
        reason: why the values are a minimum.
        within: bound of the distance of every unknown from the minimum, relative to its own σ.
        doubt: why they are none; empty if they are one.
        extra: rows beside the observations, with which the datum is given.

    Raises:
        DatumError: a free network has several parts.
    """
    values = start.state
    equations = equations.weighted_at(values)
    v = equations.residuals(values)
    datum: FreeDatum | None = None
    defects: tuple[Defect, ...] = ()
    if constraint is not None:
        moved, defects, datum = _on_datum(equations, values, start.origin)
        there = equations.residuals(moved)
        # Motions that no observation is sensitive to change no residual.
        if abs(float(there @ there) - float(v @ v)) <= STOPPING.unchanged * (1.0 + float(v @ v)):
            values, v = moved, there
        else:
            doubt = doubt or NOT_ON_INNER_CONSTRAINTS
    extra = extra.at(equations, values)
    return Solution(
        network=equations.network,
        equations=equations,
        state=values,
        start=start.origin,
        converged=not doubt,
        reason=doubt or reason,
        iterations=0,
        within=np.inf if doubt else within,
        vtpv=sum_of_squares(v, *(e.residual for e in extra.rows)),
        run=RunRecord(
            Solver.of(equations, extra.rows),
            np.zeros(equations.unknowns.n_columns) if constraint is None else constraint,
        ),
        datum=datum,
        defects=defects,
        extra=extra,
    )


def _on_datum(
    equations: Equations, values: State, given: State
) -> tuple[State, tuple[Defect, ...], FreeDatum]:
    """Return the values moved onto the inner constraints, the defect, and the constraints."""
    columns = None
    for _ in range(MOTION.transformations):
        system = LinearisedEquations(equations, values)
        defects = find_defects(system, values, system.diagonal(), free=True)
        if len(defects) != 1:
            raise DatumError(
                f"a free network must be one connected part, not {len(defects)}",
                defect=sum(d.size for d in defects),
            )
        if columns is None:
            columns = datum_columns(equations, defects[0].motions)
        datum = FreeDatum(defects[0].motions, columns)
        amounts = datum.project(displacement_from_start(equations, values, given))
        if is_negligible_motion(datum.motions @ amounts, values):
            break
        values = state_on_constraints(equations, values, given, defects[0], columns)
    return values, tuple(defects), datum
