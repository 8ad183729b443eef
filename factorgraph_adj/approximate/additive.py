"""Start values of unknowns that add to what is computed: sizes, levels, constants."""

from __future__ import annotations

import numpy as np

from ..errors import Problem
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.variables import Quantity, parameter_kinds
from ..types import Array
from .survey import group_angle


def solve_additive(equations: Equations, state: State) -> list[Problem]:
    """Fill missing values of unknowns with one component; return a problem for each that is left.

    An unknown s of which residuals depend as v(s) = v(0) + J s has, from each observation of which
    all other unknowns are known, the value −Jᵀv(0)/JᵀJ; its start value is their median, that of
    angles about their circular mean.
    """
    problems = []
    for record in parameter_kinds():
        kind = record.name
        missing = np.isnan(state[kind])
        if record.size != 1 or record.rotates or not missing.any():
            continue
        found: dict[int, list[float]] = {}
        for block in equations.blocks:
            places = [j for j, (what, _) in enumerate(block.variables) if what == kind]
            for place in places:
                for number, value in _values(equations, block, place, state):
                    found.setdefault(number, []).append(value)
        for number in np.flatnonzero(missing[:, 0]).tolist():
            if number in found:
                state[kind][number, 0] = _middle(found[number], record.components[0].quantity)
                continue
            what = "no approximate value: no observation of it has all its other unknowns known"
            name = equations.unknowns[kind].names[number]
            problems.append(Problem(what, f"{record.noun} {name!r}"))
    return problems


def _middle(values: list[float], quantity: Quantity) -> float:
    """Return the median of values, that of angles about their circular mean."""
    if quantity != "angle":
        return float(np.median(values))
    group = np.zeros(len(values), dtype=np.intp)
    return float(group_angle(group, np.array(values), 1)[0])


def _values(
    equations: Equations, block: Block, place: int, state: State
) -> list[tuple[int, float]]:
    """Return number and value of the unknown at a place of the variables, from each row."""
    kind, index = block.variables[place]
    wanted = np.isnan(state[kind][index, 0])
    for j, (what, other) in enumerate(block.variables):
        if j != place:
            wanted &= ~np.isnan(state[what][other]).any(axis=1)
    rows = np.flatnonzero(wanted)
    if not len(rows):
        return []
    chosen = block.select(rows)
    trial = {**state, kind: np.nan_to_num(state[kind])}
    computed = chosen.evaluate(equations.network.frame, trial)
    by_it: Array = computed.jacobians[place][:, :, 0]
    square = np.sum(by_it**2, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        values = -np.sum(by_it * computed.residual, axis=1) / square
    sound = np.isfinite(values)
    return list(zip(index[rows][sound].tolist(), values[sound].tolist(), strict=True))
