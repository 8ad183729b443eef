"""Test values of a solution without some of its observations, by a low-rank update.

In the linear model of the solution the whitened rows B of the observations leave, see
`factorgraph_adj.solve.update`: with G = Q Bᵀ and −D = M, the redundancy matrix of the rows,

    dx = −G D⁻¹ v_B,   Pv' = P (v + A dx),   P Q'_vv P = P Q_vv P + P A G D⁻¹ Gᵀ Aᵀ P,

where Pv' and the diagonal of P Q'_vv P give the test values w' of all other observations. The cost
is that of one solution with as many right sides as rows leave.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..solve.solution import Solution
from ..solve.update import Solved, Update
from ..types import Array, Index, Mask
from .effects import response
from .reliability import UNCONTROLLED, Reliability, correlations_of_tests
from .rows import weighted, weights

AT_ONCE = 16
"""Number of columns that are multiplied by A at once."""


@dataclass(frozen=True, eq=False)
class UpdatedTests:
    """Test values of all observations without some; arrays (n,) in the order of the solution.

    The observations that left have NaN test values and count as not controlled.
    """

    reliability: Reliability
    """Reliability of the solution with all observations."""
    update: Update
    """The update of its factor."""
    gone: Index
    """Rows that left, (k,)."""
    w: Array
    """Test values of Baarda."""
    controlled: Mask
    """Whether other observations control the observation."""
    estimated_errors: Array
    """Estimated errors observed − true, as in `Reliability`."""
    precision: Array
    """(P Q_vv P)_ii; 1/unit²."""
    vtpv: float
    """vᵀPv of the linear model."""
    left_out: float
    """Length of what the linear model leaves out of the whitened residuals of the other
    observations. With the same partials no test value is wrong by more; with partials at the new
    state no test value of the tests was wrong by more than twice the length."""

    @classmethod
    def of(cls, rel: Reliability) -> UpdatedTests:
        """Return the test values of a solution with all observations."""
        s = rel.solution
        update = Update.of(Solved(s.factor, s.equations.unknowns.n_columns))
        return cls(
            rel,
            update,
            np.zeros(0, dtype=np.intp),
            rel.w,
            rel.controlled,
            rel.estimated_errors,
            rel.precision,
            s.vtpv,
            0.0,
        )

    @property
    def solution(self) -> Solution:
        """The solution with all observations."""
        return self.reliability.solution

    def without(self, rows: Index) -> UpdatedTests | None:
        """Return the test values without more observations; none: an update cannot give them.

        Args:
            rows: all rows of observations that are not members of clusters, (k,).
        """
        solution, equations = self.solution, self.solution.equations
        system = solution.normal().system
        unit = np.zeros((len(system.every_residual), len(rows)))
        unit[rows, np.arange(len(rows))] = 1.0
        b = system.transposed(unit)
        at = np.flatnonzero(b.any(axis=1))
        update = self.update.with_rows(at, b[at].T, system.residual[rows], sign=-1.0)
        if not update.trusted:
            return None
        n = equations.n_rows
        residuals = system.residual + system.times(update.step[:, None])[:n, 0]
        precision = self.reliability.precision.copy()
        z, sigma = update.parts[:2]
        for first in range(0, len(sigma), AT_ONCE):
            part = slice(first, first + AT_ONCE)
            spread = weighted(equations, system.times(update.spread @ z[:, part])[:n])
            precision += np.square(spread) @ sigma[part]
        gone = np.append(self.gone, rows)
        controlled = precision > UNCONTROLLED * weights(equations)
        controlled[gone] = False
        try:
            moved = equations.residuals(equations.unknowns.retract(solution.state, update.step))
        except InputError:
            return None
        left_out = moved - residuals
        left_out[gone] = 0.0
        pv = weighted(equations, residuals[:, None])[:, 0]
        safe = np.where(controlled, precision, np.nan)
        return UpdatedTests(
            self.reliability,
            update,
            gone,
            pv / np.sqrt(safe),
            controlled,
            -pv / safe,
            precision,
            solution.vtpv + update.vtpv,
            float(np.linalg.norm(left_out)),
        )

    def correlations_with(self, rows: Index) -> Array:
        """Return the correlations of all test values with those of ``rows``, (n, k)."""
        pqp = response(self.solution, rows, factor=self.update)
        return correlations_of_tests(pqp, rows, self.precision, self.controlled)
