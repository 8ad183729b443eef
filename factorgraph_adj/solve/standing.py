"""A solution of values that were found in another way, as if an adjustment had ended there."""

from __future__ import annotations

import numpy as np

from ..errors import DatumError
from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array
from .datum import Defect, FreeDatum, find_defects
from .extra import NOTHING_MORE, Extra
from .free_network import MOTION, datum_columns, is_nothing, moved_from, onto_constraints
from .linear import LinearisedEquations, sum_of_squares
from .minimum import OFF_DATUM
from .normal import Solver
from .solution import Solution
from .start import Start
from .stopping import STOPPING


def standing(
    equations: Equations,
    start: Start,
    constraint: Array | None,
    *,
    reason: str,
    within: float = np.inf,
    doubt: str = "",
    extra: Extra = NOTHING_MORE,
) -> Solution:
    """Return the solution of values; a free network's is moved onto its inner constraints.

    Args:
        equations: the network.
        start: the values, and those from which they were found.
        constraint: what the minimal datum of a free network adds to the diagonal of N,
            (n_columns,); none: the datum is given.
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
        # What no observation notices changes no residual.
        if abs(float(there @ there) - float(v @ v)) <= STOPPING.unchanged * (1.0 + float(v @ v)):
            values, v = moved, there
        else:
            doubt = doubt or OFF_DATUM
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
        solver=Solver.of(equations, extra.rows),
        constraint=np.zeros(equations.unknowns.n_columns) if constraint is None else constraint,
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
        amounts = datum.project(moved_from(equations, values, given))
        if is_nothing(datum.motions @ amounts, values):
            break
        values = onto_constraints(equations, values, given, defects[0], columns)
    return values, tuple(defects), datum
