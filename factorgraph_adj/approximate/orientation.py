"""Orientation unknowns of direction sets from directions to known targets."""

from __future__ import annotations

import numpy as np

from ..graph.equations import Equations
from ..graph.variables import State
from ..types import Array, Index
from .progress import Progress
from .survey import Sighted, group_angle


def bearing(progress: Progress, i: Index, j: Index) -> Array:
    """Return the bearing in plan from points i to points j, radians; NaN where unknown."""
    d = progress.plan[j, :2] - progress.plan[i, :2]
    out = np.arctan2(d[:, 0], d[:, 1])
    out[~np.isfinite(d).all(axis=1) | (np.abs(d) < 1e-9).all(axis=1)] = np.nan
    return np.asarray(out)


def orient(progress: Progress) -> bool:
    """Fill the orientation of sets that sight known targets: the median of α − direction.

    Returns:
        Whether any orientation was filled.
    """
    d: Sighted = progress.survey.directions
    rows = np.flatnonzero(np.isnan(progress.orientation[d.third]))
    if not len(rows):
        return False
    i, j, group = d.station[rows], d.target[rows], d.third[rows]
    turned = (
        bearing(progress, i, j) - progress.horizon.convergence(progress.plan[i]) - d.value[rows]
    )
    known = np.isfinite(turned)
    if not known.any():
        return False
    found = group_angle(group[known], turned[known], len(progress.orientation))
    new = np.isnan(progress.orientation) & np.isfinite(found)
    progress.orientation[new] = found[new]
    return bool(new.any())


def orient_by_model(equations: Equations, state: State) -> None:
    """Fill unknown orientations of a state with known points, by the model of directions."""
    missing = np.isnan(state["orientation"][:, 0])
    for block in equations.blocks:
        if block.kind != "direction" or not missing.any():
            continue
        group = block.variables[4][1]
        rows = np.flatnonzero(missing[group])
        trial = dict(state)
        trial["orientation"] = np.where(missing[:, None], 0.0, state["orientation"])
        v = block.select(rows).evaluate(equations.network.frame, trial, jacobians=False).residual
        found = group_angle(group[rows], v[:, 0], len(missing))
        state["orientation"][missing, 0] = found[missing]
        missing = np.isnan(state["orientation"][:, 0])
