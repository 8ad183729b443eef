"""Coordinates of one epoch with cofactors and open motions, as comparisons of epochs read them.

A comparison needs no observation: coordinates, what of them is unknown, their cofactors and the
motions that the observations leave open are enough. Adjustments have these, and so do the estimates
of epochs that are kept without their adjustments (`factorgraph_adj.monitoring.epoch_estimates`).
"""

from __future__ import annotations

from functools import cached_property
from typing import Protocol

import numpy as np

from ..frames import Frame
from ..solve.solution import Solution, cofactors_at
from ..types import Array, Index, Mask


class EpochCoordinates(Protocol):
    """What a comparison reads of an epoch of n points."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the points, n."""
        ...

    @property
    def coordinates(self) -> Array:
        """Their coordinates, (n, 3) metres."""
        ...

    @property
    def free(self) -> Mask:
        """Which coordinates are unknowns, (n, 3)."""
        ...

    @property
    def frame(self) -> Frame:
        """The frame of the coordinates."""
        ...

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of points that were left out because nothing determines them."""
        ...

    @property
    def vtpv(self) -> float:
        """Weighted sum vᵀPv."""
        ...

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        ...

    def cofactors_of(self, coordinates: Index) -> Array:
        """Return Q of free coordinates 3·point + axis (k,): (k, k) metres² for σ0 = 1."""
        ...

    def motions_of(self, coordinates: Index) -> Array:
        """Return how the datum defects move free coordinates 3·point + axis (k,): (k, d)."""
        ...


class SolutionCoordinates:
    """Coordinates of an adjustment."""

    def __init__(self, solution: Solution) -> None:
        self.solution = solution
        self._table = solution.equations.unknowns["point"]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the points."""
        return self._table.names

    @property
    def coordinates(self) -> Array:
        """Their coordinates, (n, 3) metres."""
        return np.array(self.solution.state["point"])

    @cached_property
    def free(self) -> Mask:
        """Which coordinates are unknowns, (n, 3)."""
        return np.asarray(self._table.free & (self._table.offset >= 0)[:, None])

    @property
    def frame(self) -> Frame:
        """The frame of the network."""
        return self.solution.network.frame

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Names of points that were left out because nothing determines them."""
        left_out = self.solution.network.unknowns_left_out
        return tuple(x.name for x in left_out if x.kind == "point")

    @property
    def vtpv(self) -> float:
        """Weighted sum vᵀPv."""
        return self.solution.vtpv

    @property
    def redundancy(self) -> int:
        """Redundancy."""
        return self.solution.redundancy

    def cofactors_of(self, coordinates: Index) -> Array:
        """Return Q of free coordinates 3·point + axis (k,): (k, k) metres² for σ0 = 1."""
        return cofactors_at(self.solution, self._columns(coordinates))

    def motions_of(self, coordinates: Index) -> Array:
        """Return how the datum defects move free coordinates 3·point + axis (k,): (k, d)."""
        rows = self._columns(coordinates)
        parts = [defect.motions[rows] for defect in self.solution.defects]
        return np.hstack([np.zeros((len(rows), 0)), *parts])

    def _columns(self, coordinates: Index) -> Index:
        return np.asarray(self._table.offset[coordinates // 3] + coordinates % 3)
