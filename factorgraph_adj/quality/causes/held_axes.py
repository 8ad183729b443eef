"""The scale of the coordinates of held points along one axis, tested as if it were unknown.

A board whose spacing is not the same along its axes, or heights of another unit, make all given
coordinates along an axis wrong in the same ratio s from their centre: given − true = s (x − x̄). The
column of s is that of the given coordinates, see `given`, times x − x̄.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csc_array, csr_array

from ...solve.linear import LinearisedEquations
from ...solve.solution import Solution
from ...types import Index
from .columns import Explained, explain_pieces, in_pieces
from .given import held_components

LEAST = 4
"""Smallest number of held coordinates with a scale of their own: that of fewer is the error of any
of them."""
AXES = "xyz"


@dataclass(frozen=True)
class AxisScale:
    """A scale of all given coordinates along an axis."""

    axis: str
    """Name of the axis."""
    points: int
    """Number of held points."""
    found: Explained
    """What it explains; its error is s = 1 − true / given."""


def axis_scales(solution: Solution) -> list[AxisScale]:
    """Test the scale of given coordinates along each axis.

    Args:
        solution: result of `adjust`.

    Returns:
        The axes along which `LEAST` points with coordinates of their own are held; none where the
        user added factors, whose partials by held components are not known.

    Raises:
        SingularError: the normal equations are singular at the solution.
    """
    held = held_components(solution.equations).get("point")
    if solution.n_extra or held is None:
        return []
    at = solution.state["point"]
    wide = [a for a in range(len(AXES)) if len(np.unique(at[held[:, a], a])) >= LEAST]
    if not wide:
        return []
    unknowns = solution.equations.unknowns.freed({"point": held})
    equations = replace(solution.equations, unknowns=unknowns)
    system = LinearisedEquations(equations, solution.state)
    points = np.flatnonzero(held.any(axis=1))
    first = np.array([unknowns.columns("point", p)[0] for p in points.tolist()])
    ratio = [np.where(held[points, a], at[points, a], np.nan) for a in wide]
    ratio = [np.nan_to_num(r - np.nanmean(r)) for r in ratio]
    rows = np.unique(equations.touching("point", points))

    def pieces(which: Index) -> Iterator[tuple[Index, csr_array]]:
        for some in in_pieces(rows):
            a = csc_array(system.sparse(some))
            # f(x) computes with the given values, which are larger than the true ones by s (x − x̄).
            columns = [-(a[:, first + wide[i]] @ ratio[i]) for i in which.tolist()]
            yield some, csr_array(np.stack(columns, axis=1))

    groups: list[Index] = [np.array([i]) for i in range(len(wide))]
    explained = explain_pieces(solution, pieces, groups)
    return [
        AxisScale(AXES[a], int(held[:, a].sum()), e) for a, e in zip(wide, explained, strict=True)
    ]
