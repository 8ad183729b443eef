"""The solution of a part: its own estimates, with the figures of the whole network."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..graph.variables import State
from ..solve.factor import Factor
from ..solve.normal import NormalEquations
from ..solve.solution import Solution
from ..types import Array


@dataclass(frozen=True)
class Totals:
    """Figures of the whole network."""

    vtpv: float
    """Value of vᵀPv."""
    redundancy: int
    """Redundancy."""
    variance_factor: float
    """Scale of covariances: 1, or σ̂0²."""
    converged: bool
    """Whether the iteration came to rest."""
    reason: str
    """Why the iteration ended."""
    iterations: int
    """Number of iterations."""
    within: float
    """No unknown is further than this multiple of its own σ from the minimum."""


@dataclass(frozen=True, eq=False, repr=False)
class PartSolution(Solution):
    """The solution of a part of a network that was adjusted in parts.

    Estimates, covariances and redundancy numbers are those of the whole network; redundancy, vᵀPv
    and σ̂0 too. Observations and unknowns are those of the part.
    """

    totals: Totals | None = None
    """Figures of the whole network."""

    @classmethod
    def of(
        cls, normal: NormalEquations, start: State, factor: Factor, totals: Totals
    ) -> PartSolution:
        """Return the solution of a part.

        Args:
            normal: the linearisation at the solution.
            start: the values that the iteration started from.
            factor: the eliminated part, which knows the covariances of its junctions.
            totals: figures of the whole network.
        """
        equations = normal.solver.equations
        out = cls(
            network=equations.network,
            equations=equations,
            state=normal.state,
            start=start,
            converged=totals.converged,
            reason=totals.reason,
            iterations=totals.iterations,
            within=totals.within,
            vtpv=totals.vtpv,
            solver=normal.solver,
            constraint=0.0 * normal.diagonal,
            linearised=normal,
            totals=totals,
        )
        out.__dict__["factor"] = factor
        return out

    def every_covariance(self) -> dict[str, Array]:
        """Return the covariances of all variables, (n, k, k) for each kind, zero where held."""
        out = {"point": self.point_covariances}
        for kind, table in self.equations.unknowns.tables.items():
            if kind == "point":
                continue
            k = table.free.shape[1]
            found = np.zeros((len(table.names), k, k))
            for size in np.unique(table.size[table.offset >= 0]).tolist():
                on = np.flatnonzero((table.offset >= 0) & (table.size == size))
                columns = table.offset[on, None] + np.arange(size)
                found[on, :size, :size] = self.factor.selected.joint(columns)
            found *= table.free[:, :, None] & table.free[:, None, :]
            out[kind] = found * self.variance_factor
        return out

    @property
    def redundancy(self) -> int:
        """Redundancy of the whole network."""
        assert self.totals is not None
        return self.totals.redundancy

    @property
    def sum_of_redundancy_numbers(self) -> None:
        """Only all parts together have a known sum."""
        return None

    @property
    def variance_factor(self) -> float:
        """Scale of covariances: 1, or σ̂0² of the whole network."""
        assert self.totals is not None
        return self.totals.variance_factor
