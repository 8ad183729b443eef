"""A free network on its inner constraints: which coordinates carry the datum, and the way there.

The iteration keeps a minimal datum; a solution at rest is then carried onto the inner constraints
G_Dᵀ (x − x₀)_D = 0 over any datum points by finite similarity transformations, which no
observation notices.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from ..errors import DatumError
from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array, Mask
from .datum import Defect, FreeDatum, find_defects, transform
from .normal import NormalEquations

MOST_TRANSFORMATIONS = 20
"""Times that a solution is moved towards inner constraints; two or three suffice as a rule."""
CARRIED = 1e-12
"""Motion that is left, relative to the coordinates, where a solution is on its constraints."""


def datum_columns(
    equations: Equations, motions: Array, points: Collection[str] | None = None
) -> Mask:
    """Return the coordinates (n_columns,) that carry the datum.

    Args:
        equations: the network.
        motions: G of the defect, (n_columns, d).
        points: names of the datum points; none: those with the flag, or all if none has it.

    Raises:
        DatumError: they are too few, or lie on one line.
    """
    unknowns, network = equations.unknowns, equations.network
    chosen = np.zeros(unknowns.n_columns, dtype=bool)
    table = unknowns["point"]
    if points is None:
        flagged = np.array([p.datum for p in network.points.values()], dtype=bool)
        wanted = flagged if flagged.any() else np.ones(len(flagged), dtype=bool)
    else:
        names = set(points)
        wanted = np.array([n in names for n in table.names], dtype=bool)
    on = (table.offset >= 0) & wanted
    for axis in range(3):
        chosen[table.offset[on] + axis] = True
    chosen &= unknowns.free
    if int(np.linalg.matrix_rank(motions[chosen])) < motions.shape[1]:
        what = "flag" if points is None else "name"
        raise DatumError(
            f"the datum points ({int(on.sum())}) cannot carry a datum with "
            f"{motions.shape[1]} defects: {what} more points, not on one line",
            defect=motions.shape[1],
            names=[n for n, o in zip(table.names, on, strict=True) if o][:12],
        )
    return chosen


def moved_from(equations: Equations, state: State, start: State) -> Array:
    """Return x − x₀ of the points, (n_columns,): what inner constraints act on."""
    table = equations.unknowns["point"]
    on = np.flatnonzero(table.offset >= 0)
    out = np.zeros(equations.unknowns.n_columns)
    columns = table.offset[on, None] + np.arange(3)
    out[columns] = state["point"][on] - start["point"][on]
    out[~equations.unknowns.free] = 0.0
    return out


@dataclass(frozen=True)
class Carried:
    """A free network on its way to its inner constraints."""

    state: State
    """Where it is."""
    normal: NormalEquations | None
    """Its normal equations, if they are there."""
    defects: tuple[Defect, ...]
    """Its defect at that state, or the last one on the way."""
    datum: FreeDatum
    """The inner constraints."""
    at_rest: bool
    """Whether it is at rest, and on the constraints."""


def carry(
    equations: Equations,
    state: State,
    start: State,
    datum: FreeDatum,
    defects: tuple[Defect, ...],
    *,
    normal_at: Callable[[State], NormalEquations],
    step: Callable[[NormalEquations], tuple[Array, float] | None],
    tolerance: float,
    at_rest: bool,
    free: bool = True,
) -> Carried:
    """Move a solution onto inner constraints.

    The motions of the defect are renewed at every state: inner constraints and covariances
    belong to those at the solution.

    Args:
        equations: the network.
        state: a solution on any minimal datum.
        start: x₀, what the constraints refer to.
        datum: the constraints: its columns are kept.
        defects: the defect so far.
        normal_at: makes the normal equations at a state.
        step: returns a step of the adjustment and its bound relative to σ; none where there is
            no answer.
        tolerance: bound at which a state is at rest.
        at_rest: whether ``state`` is. One that is not may have points on their way to infinity:
            it is moved once.
        free: as in `find_defects`.
    """
    for _ in range(MOST_TRANSFORMATIONS if at_rest else 1):
        normal = normal_at(state)
        found = find_defects(normal.system, state, normal.diagonal, free=free)
        if len(found) != 1 or found[0].size != datum.motions.shape[1]:
            return Carried(state, normal, defects, datum, False)
        defects = tuple(found)
        datum = FreeDatum(found[0].motions, datum.columns)
        if at_rest:
            next_step = step(normal)
            if next_step is not None and next_step[1] > tolerance:
                state = equations.unknowns.retract(state, next_step[0])
                continue
        amounts = datum.project(moved_from(equations, state, start))
        shift = float(np.abs(datum.motions @ amounts).max())
        if shift < CARRIED * (1.0 + float(np.abs(state["point"]).max())):
            return Carried(state, normal, defects, datum, at_rest)
        state = transform(equations, state, found[0], amounts)
    return Carried(state, None, defects, datum, False)
