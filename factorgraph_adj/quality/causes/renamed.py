"""Readings under other names, fitted beside a solution that does not contain them.

Let x be the coordinates of a few points that the solution lacks, and l the readings to them, some
of them as if they had been read to another target. With innovations d = f(x, x̂) − l, the cofactors
D = Σ + A Q Aᵀ and the partials B by x,

    x̂ = argmin dᵀ D⁻¹ d,   T² = min dᵀ D⁻¹ d,

T² is χ² with as many degrees of freedom as readings less the rank of B, if the names are right. The
solution itself stays the same, so that no wrong name bends it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace

import numpy as np

from ...errors import InputError
from ...graph.blocks import Block
from ...graph.equations import Equations
from ...solve.solution import Solution
from ...solve.update import whitener
from ...types import Array, Index
from ..innovations import Innovations
from .readings import HEIGHT, ends_of, vertical_of

MOST_STEPS = 12
"""Largest number of Gauss–Newton steps of a fit."""
AT_REST = 1e-3
"""Step relative to σ below which a fit has converged."""
RANK = 1e-10
"""Ratio of singular values of a fit below which the readings do not determine a direction."""


@dataclass(frozen=True, eq=False)
class Fit:
    """Readings fitted under some names."""

    t2: float
    """T²; infinite where there is none."""
    dof: int
    """Its degrees of freedom."""
    coordinates: Mapping[int, Array]
    """Coordinates (3,) of the new points, by number."""


NO_FIT = Fit(np.inf, 0, {})
"""The fit of readings that have none."""


class RenamedReadings:
    """Readings to points that a solution lacks."""

    def __init__(self, equations: Equations, solution: Solution, points: Sequence[int]) -> None:
        """Prepare the fits.

        Args:
            equations: the equations with the readings.
            solution: the solution without them.
            points: numbers of the points that no solution places, in ``equations``.
        """
        names = equations.unknowns["point"].names
        new = {names[p]: np.zeros(3) for p in points}
        self.equations, self.solution = equations, solution
        self.innovations = Innovations(equations, solution, points=new)
        self.columns = len(solution.equations.unknowns.free)
        self.first = {p: self.columns + 3 * i for i, p in enumerate(points)}
        self.lost = {kind: mask.copy() for kind, mask in self.innovations.lost.items()}
        self.lost["point"][list(points)] = True

    def fit(
        self,
        observations: Mapping[int, Index],
        names: Mapping[tuple[int, int], tuple[int, float | None]],
        start: Mapping[int, Array],
    ) -> Fit:
        """Fit new points to readings.

        Args:
            observations: numbers of the observations in each block, by place of the block.
            names: other targets of readings, by place of the block and number in it: the number of
                the target, and its height; none: as recorded.
            start: approximate coordinates of the points that are fitted, (3,) metres.
        """
        blocks = [
            _renamed(b, i, names, self.equations) for i, b in enumerate(self.equations.blocks)
        ]
        renamed = replace(self.equations, blocks=tuple(blocks))
        rows = self._rows(renamed, observations, start)
        if not len(rows):
            return NO_FIT
        try:
            return self._descend(renamed, rows, start)
        except (InputError, np.linalg.LinAlgError):
            return NO_FIT

    def at(self, observations: Mapping[int, Index], points: Mapping[int, Array]) -> Fit:
        """Return T² of readings under their own names, with the points where they are.

        Args:
            observations: as for `fit`.
            points: coordinates of the points, (3,) metres.
        """
        rows = self._rows(self.equations, observations, points)
        try:
            v, _ = self._whitened(self._moved(self.equations, points), rows)
        except (InputError, np.linalg.LinAlgError):
            return NO_FIT
        return Fit(float(v @ v), len(rows), points)

    def _rows(
        self,
        equations: Equations,
        observations: Mapping[int, Index],
        points: Mapping[int, Array],
    ) -> Index:
        rows = [self._known(equations.blocks[at], n, points) for at, n in observations.items()]
        return np.sort(np.concatenate([np.zeros(0, dtype=np.intp), *rows]))

    def _known(self, block: Block, numbers: Index, start: Mapping[int, Array]) -> Index:
        """Return the rows of readings that touch nothing unknown but the points of the fit."""
        fine = np.ones(len(numbers), dtype=bool)
        for kind, index in block.variables:
            lost = self.lost[kind][index[numbers]]
            if kind == "point":
                lost &= ~np.isin(index[numbers], list(start))
            fine &= ~lost
        first = block.first_row + block.dimension * numbers[fine]
        return np.asarray((first[:, None] + np.arange(block.dimension)).ravel())

    def _moved(self, equations: Equations, points: Mapping[int, Array]) -> Innovations:
        """Return the innovations of renamed equations, with the points at their places."""
        out = copy(self.innovations)
        out.equations, out.state = equations, dict(out.state)
        out.state["point"] = out.state["point"].copy()
        for p, x in points.items():
            out.state["point"][p] = x
        return out

    def _whitened(self, here: Innovations, rows: Index) -> tuple[Array, Array]:
        """Return W v and W A with W D Wᵀ = I of rows."""
        linear = here.linearise(rows)
        a = linear.a.toarray()
        known = a[:, : self.columns]
        root = whitener(linear.covariance.toarray() + known @ self.solution.cofactor_times(known.T))
        return root @ linear.v, root @ a

    def _descend(self, equations: Equations, rows: Index, start: Mapping[int, Array]) -> Fit:
        here = self._moved(equations, start)
        own = [self.first[p] + np.arange(3) for p in start]
        columns = np.concatenate([np.zeros(0, dtype=np.intp), *own])
        for _ in range(MOST_STEPS):
            v, a = self._whitened(here, rows)
            b = a[:, columns]
            step, _, rank, _ = np.linalg.lstsq(b, -v, rcond=RANK)
            t2 = float(np.sum((v + b @ step) ** 2))
            for i, p in enumerate(start):
                here.state["point"][p] += step[3 * i : 3 * i + 3]
            if np.linalg.norm(b @ step) < AT_REST * max(1.0, np.sqrt(t2)):
                found = {p: here.state["point"][p].copy() for p in start}
                return Fit(t2, len(rows) - int(rank), found)
        return NO_FIT


def _renamed(
    block: Block,
    place: int,
    names: Mapping[tuple[int, int], tuple[int, float | None]],
    equations: Equations,
) -> Block:
    """Return a block with other targets of some readings."""
    changes = {n: to for (at, n), to in names.items() if at == place}
    ends = ends_of(block) if changes else None
    if ends is None:
        return block
    variables, constants = list(block.variables), dict(block.constants)
    index = variables[ends[1]][1].copy()
    for n, (target, height) in changes.items():
        index[n] = target
        if height is not None and HEIGHT in constants:
            constants[HEIGHT] = constants[HEIGHT].copy()
            constants[HEIGHT][n] = height
    variables[ends[1]] = ("point", index)
    vertical = vertical_of(block, ends[1])
    if vertical is not None:
        own = equations.unknowns["vertical"].number
        point_names = equations.unknowns["point"].names
        at = variables[vertical][1].copy()
        for n, (target, _) in changes.items():
            at[n] = own.get(point_names[target], own.get("", 0))
        variables[vertical] = ("vertical", at)
    return replace(block, variables=tuple(variables), constants=constants)
