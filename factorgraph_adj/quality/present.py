"""The present solution of a search of data snooping, and what has been taken out of it.

Observations leave the solution in one of two ways without an adjustment anew. Few rows leave by a
low-rank update of the factor (`UpdatedTests`), as long as what the linear model leaves out cannot
change the choice of the next round. The weights of more rows become negligible, and the equations
are adjusted with the structure that they have (`readjust`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import AdjustmentError
from ..network.network import DatumChoice
from ..solve.minimum import readjust
from ..solve.solution import Solution
from ..types import Array, Index
from .candidates import Choice, Outlier, Units, choose
from .rejections import Test
from .reliability import Reliability, critical_tau, reliability
from .updated_tests import UpdatedTests

NEGLIGIBLE = 1e-20
"""Factor on the weight of a withdrawn observation: below the rounding of all others, yet a point
without other observations keeps its place."""
MOST_UPDATED = 64
"""Largest number of rows that leave by an update. With 64 rows the update takes about 0.3 s in Roma
and 0.2 s in a grid of 10 000 points; weights, whose time does not depend on the number, take 0.5 s
and 1.6 s."""
MOST_LEFT_OUT = 0.01
"""Largest length of what the linear model leaves out of the whitened residuals in an update. Test
values change by about this length, so that the margin of a choice, which is relative to test values
of 3 and more, must exceed the length too."""


@dataclass(frozen=True, eq=False)
class Present:
    """A solution, and the observations of its network that have been taken out; a value."""

    reliability: Reliability
    """Reliability of the solution."""
    test: Test
    """The test that decides."""
    weights: Array | None = None
    """Factors on the weights of the solution; none: no observation is withdrawn."""
    updated: UpdatedTests | None = None
    """Update of the solution; none: no observation has left it by an update."""
    withdrawn: int = 0
    """Redundancy that withdrawn observations, and those of the update, have taken along."""

    @property
    def solution(self) -> Solution:
        """The solution."""
        return self.reliability.solution

    @property
    def tested(self) -> Reliability | UpdatedTests:
        """Test values of the present solution."""
        return self.reliability if self.updated is None else self.updated

    @property
    def unsettled(self) -> bool:
        """Whether observations are out of the solution that are in its network."""
        return self.weights is not None or self.updated is not None

    def doubtful(self, choice: Choice) -> bool:
        """Return whether an adjustment might choose otherwise than the update."""
        return self.updated is not None and choice.margin <= self.updated.left_out

    @property
    def redundancy(self) -> int:
        """Redundancy without the withdrawn observations."""
        return self.solution.redundancy - self.withdrawn

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight without the withdrawn observations."""
        f = self.redundancy
        vtpv = self.solution.vtpv if self.updated is None else self.updated.vtpv
        return float(np.sqrt(vtpv / f)) if f > 0 else np.nan

    @property
    def values(self) -> Array:
        """The test values that decide, (n,): w, or τ = w/σ̂0; NaN where vᵀPv vanishes."""
        w = self.tested.w
        if self.test == "baarda":
            return w
        return w / self.sigma0 if self.sigma0 > 0 else np.full(len(w), np.nan)

    @property
    def critical(self) -> float:
        """Critical value of the test values."""
        if self.test == "baarda":
            return self.reliability.critical_w
        return critical_tau(self.reliability.alpha, self.redundancy)

    @property
    def largest(self) -> Array:
        """Largest of the test values of each observation, (m,)."""
        return Units.of(self.solution.equations).largest(self.values)

    def choice(self, share: float, stuck: Collection[str]) -> Choice:
        """Choose the observations that the next round sets aside; ``stuck`` ones stay."""
        found = self.solution.equations.find(list(stuck))
        return choose(
            self.tested,
            self.values,
            scale=1.0 if self.test == "baarda" else self.sigma0,
            critical=self.critical,
            share=share,
            stuck=self._units(np.array([r[0] for r in found if len(r)], dtype=np.intp)),
            gone=() if self.updated is None else self._units(self.updated.gone),
        )

    # -- taking out --------------------------------------------------------------------------------

    def updated_without(self, chosen: Sequence[Outlier]) -> Present | None:
        """Return the test values after a low-rank update; none: there are too many rows for it."""
        own = self.solution.weights is None or self.weights is not None
        rows = self._rows(chosen)
        if not own or rows is None or any(c.point is not None for c in chosen):
            return None
        before = UpdatedTests.of(self.reliability) if self.updated is None else self.updated
        if len(before.gone) + len(rows) > MOST_UPDATED:
            return None
        after = before.without(rows)
        if after is None or after.left_out > MOST_LEFT_OUT:
            return None
        return replace(self, updated=after, withdrawn=self.withdrawn + len(rows))

    def reweighted_without(
        self, chosen: Sequence[Outlier], datum: DatumChoice | None
    ) -> Present | None:
        """Return the adjustment with negligible weights of outliers, and of what has left it.

        None: the adjustment fails, or members of clusters are among the outliers.
        """
        rows, equations = self._rows(chosen), self.solution.equations
        if rows is None:
            return None
        weights = np.ones(equations.n_rows) if self.weights is None else self.weights.copy()
        if self.updated is not None:
            weights[self.updated.gone] = NEGLIGIBLE
        rows = rows[weights[rows] == 1.0]
        weights[rows] = NEGLIGIBLE
        rel = self.reliability
        try:
            solution = readjust(self.solution, weights, datum=datum)
            if not solution.converged:
                return None
            rel = reliability(solution, alpha=rel.alpha, power=rel.power)
        except AdjustmentError:
            return None
        withdrawn = self.withdrawn + len(rows) - 3 * sum(c.point is not None for c in chosen)
        return Present(rel, self.test, weights, None, withdrawn)

    def _rows(self, chosen: Sequence[Outlier]) -> Index | None:
        """Return the rows of outliers, (k,), with all rays of points that are set aside.

        None for members of clusters: the weights of the other members depend on them.
        """
        equations, units = self.solution.equations, Units.of(self.solution.equations)
        rows = [np.zeros(0, dtype=np.intp)]
        rows += [units.rows(c.unit) for c in chosen if c.point is None]
        for c in chosen:
            if c.point is not None:
                rows.append((self.rays(c.point)[:, None] + np.arange(2)).ravel())
        out = np.concatenate(rows)
        joint = np.concatenate([np.zeros(0, dtype=np.intp), *(c.rows for c in equations.clusters)])
        return None if np.isin(out, joint).any() else out

    def rays(self, point: int) -> Index:
        """Return the first row of every ray to a point, (k,)."""
        return np.concatenate(
            [
                block.first_row + 2 * np.flatnonzero(block.variables[2][1] == point)
                for block in self.solution.equations.blocks
                if block.kind == "image"
            ]
        )

    def _units(self, rows: Index) -> list[int]:
        """Return the numbers of the observations with these rows."""
        number = self.solution.equations.observation_of_row
        return [int(n) for n in number[rows]]
