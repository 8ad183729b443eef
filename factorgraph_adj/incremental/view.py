"""A `Solution` of a state, as that of the batch adjustment."""

from __future__ import annotations

import numpy as np

from ..errors import DatumError
from ..graph.equations import Equations
from ..graph.variables import State as Values
from ..solve.batch import OFF_DATUM
from ..solve.datum import Defect, FreeDatum, find_defects
from ..solve.free_network import (
    MOTION,
    datum_columns,
    is_nothing,
    moved_from,
    onto_constraints,
)
from ..solve.linear import LinearSystem
from ..solve.normal import Solver
from ..solve.solution import Solution
from ..solve.stopping import STOPPING
from .flow import State
from .rebasing import Draft
from .rules import Rules


def solution_of(state: State, rules: Rules) -> Solution:
    """Return the solution of a state; a free network's on its inner constraints.

    Args:
        state: the state; something is determined.
        rules: the options.
    """
    system = state.system
    assert system is not None
    if not system.changed and not system.doubt:
        return system.base
    draft = Draft.of(state.ledger, system, rules.datum)
    values = draft.start.state
    equations = draft.equations.weighted_at(values)
    solver = Solver.of(equations)
    constraint = np.zeros(equations.unknowns.n_columns)
    v = equations.residuals(values)
    datum: FreeDatum | None = None
    defects: tuple[Defect, ...] = ()
    on_datum = True
    if system.base.datum is not None:
        _, constraint = draft.normal(system.base)
        moved, defects, datum = _on_datum(equations, values, draft.start.origin)
        there = equations.residuals(moved)
        # What no observation notices changes no residual.
        change = abs(float(there @ there) - float(v @ v))
        on_datum = change <= STOPPING.unchanged * (1.0 + float(v @ v))
        if on_datum:
            values, v = moved, there
    at_rest = f"within {rules.accuracy:.0%} of each σ of the minimum"
    doubt = system.doubt or ("" if on_datum else OFF_DATUM)
    return Solution(
        network=equations.network,
        equations=equations,
        state=values,
        start=draft.start.origin,
        converged=not doubt,
        reason=doubt or at_rest,
        iterations=0,
        vtpv=float(v @ v),
        solver=solver,
        constraint=constraint,
        datum=datum,
        defects=defects,
    )


def _on_datum(
    equations: Equations, values: Values, given: Values
) -> tuple[Values, tuple[Defect, ...], FreeDatum]:
    """Return the values moved onto the inner constraints, the defect, and the constraints."""
    columns = None
    for _ in range(MOTION.transformations):
        system = LinearSystem(equations, values)
        defects = find_defects(system, values, system.diagonal(), free=True)
        if len(defects) != 1:
            raise DatumError(
                f"a free network must be one connected part, not {len(defects)}",
                defect=sum(d.size for d in defects),
            )
        if columns is None:
            columns = datum_columns(equations, defects[0].motions)
        datum = FreeDatum(defects[0].motions, columns)
        amounts = datum.project(moved_from(equations, values, given))
        if is_nothing(datum.motions @ amounts, values):
            break
        values = onto_constraints(equations, values, given, defects[0], columns)
    return values, tuple(defects), datum
