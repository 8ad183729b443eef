"""Points that undetected errors move most, found without computing all effects on all points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..quality.effects import shifts
from ..quality.reliability import Reliability
from ..quality.rows import place_of
from ..types import Array, Index

BATCH = 8
"""Number of observations whose effects are computed in one solve."""


@dataclass(frozen=True)
class WeakPoint:
    """A point and the undetected error that moves the point most."""

    name: str
    """Name of the point."""
    effect: float
    """Largest shift of the point by a smallest detectable error, metres: length of the vector."""
    row: int
    """Scalar row of the observation with this error."""


@dataclass(frozen=True, eq=False)
class PointRedundancy:
    """Redundancy of the observations of each point, arrays over all points (n,)."""

    rows: Index
    """Number of scalar observations of the point."""
    uncontrolled: Index
    """Number of these observations that no other observation controls."""
    redundancy: Array
    """Sum of their redundancy numbers."""


def point_redundancy(rel: Reliability) -> PointRedundancy:
    """Return the number of observations and the redundancy of each point."""
    equations = rel.solution.equations
    n = len(equations.unknowns["point"].names)
    out = PointRedundancy(np.zeros(n, np.intp), np.zeros(n, np.intp), np.zeros(n))
    for block in equations.blocks:
        shape = block.observed.shape
        r = rel.redundancy_numbers[block.rows].reshape(shape).sum(axis=1)
        open_rows = np.sum(~rel.controlled[block.rows].reshape(shape), axis=1)
        for kind, index in block.variables:
            if kind == "point":
                np.add.at(out.rows, index, block.dimension)
                np.add.at(out.uncontrolled, index, open_rows)
                np.add.at(out.redundancy, index, r)
    return out


def weakest_points(rel: Reliability, most: int) -> list[WeakPoint]:
    """Return the points that smallest detectable errors of controlled observations move most.

    An observation's ``largest_effect`` bounds its effect on each of its points. Observations are
    taken in decreasing order of this bound, until enough points have larger effects than the
    bound of the remaining observations.
    """
    solution = rel.solution
    offset = solution.equations.unknowns["point"].offset
    names = solution.equations.unknowns["point"].names
    bound = np.where(rel.controlled, np.nan_to_num(rel.largest_effect, posinf=0.0), 0.0)
    order = np.argsort(-bound, kind="stable")
    order = order[bound[order] > 0]
    best: dict[int, tuple[float, int]] = {}
    for start in range(0, len(order), BATCH):
        rows = order[start : start + BATCH]
        left = bound[rows[0]] * (1.0 + 1e-9)
        if sum(size >= left for size, _ in best.values()) >= most:
            break
        moved = shifts(solution, rows) * rel.mdb[rows]
        for j, row in enumerate(rows.tolist()):
            place = place_of(solution.equations, row)
            for kind, index in place.block.variables:
                point = int(index[place.observation])
                if kind == "point" and offset[point] >= 0:
                    size = float(np.linalg.norm(moved[offset[point] : offset[point] + 3, j]))
                    if size > best.get(point, (0.0, 0))[0]:
                        best[point] = size, row
    ranked = sorted(best.items(), key=lambda item: -item[1][0])[:most]
    return [WeakPoint(names[p], size, row) for p, (size, row) in ranked]
