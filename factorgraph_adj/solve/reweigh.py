"""A Gauss-Newton step of an adjustment whose weights change."""

from __future__ import annotations

from dataclasses import replace

from ..types import Array
from .normal import NormalEquations
from .solution import Solution

ON_THE_WAY = "a step on the way to other weights"
"""Reason of a solution that is only a step."""


def stepped(solution: Solution, movement: Array, weights: Array) -> Solution:
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
    solver = solution.solver.reweighted(equations, probing=False)
    extra = solution.extra.at(equations, state)
    normal = NormalEquations(solver, state, extra.rows)
    return replace(
        solution,
        equations=equations,
        state=state,
        converged=False,
        reason=ON_THE_WAY,
        vtpv=normal.system.vtpv,
        solver=solver,
        weights=weights,
        extra=extra,
        linearised=normal,
    )
