"""Data snooping so far: tests without what is rejected, by update or weights; users' factors.

Observations leave the solution in one of two ways without a new adjustment. Few rows leave by a
low-rank update of the factor, as long as what the linear model neglects cannot change the choice of
the next round. The weights of more rows become negligible, and the equations are adjusted with the
structure that they have (`readjust`).

The update takes the whitened rows B of the observations out of the linear model of the solution,
see `factorgraph_adj.solve.low_rank_update`: with G = Q Bᵀ and −D = M, the redundancy matrix of the
rows,

    dx = −G D⁻¹ v_B,   Pv' = P (v + A dx),   P Q'_vv P = P Q_vv P + P A G D⁻¹ Gᵀ Aᵀ P,

where Pv' and the diagonal of P Q'_vv P give the test values w' of all other observations. The cost
is that of one solution with as many right sides as rows leave.

A factor that a user added is rejected as a whole, where T² of its rows exceeds the critical value.
For Pope's test T²/vᵀPv has the distribution Beta(d/2, (f − d)/2) with d degrees of freedom of the
factor and the redundancy f, so that one row is tested as an observation is.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..errors import AdjustmentError, InputError
from ..graph.equations import Equations
from ..network.network import DatumChoice
from ..solve.added_factors import AddedFactors
from ..solve.low_rank_update import SolvedCofactors, Update
from ..solve.minimum import readjust
from ..solve.solution import Solution
from ..types import Array, Index, Mask
from .error_effects import residual_response, weight_diagonal, weighted_rows
from .group_tests import FactorReliability, Test, least_share
from .joint_readings import JointTests, critical_joint_test
from .rejections import Rejected, RejectedFactor, Unresolved
from .reliability import Reliability, correlations_of_tests, critical_tau, reliability
from .snooping_candidates import Choice, Outlier, RowGroups, choose_outliers

UPDATED_COLUMNS_AT_ONCE = 16
"""Number of columns that are multiplied by A at once."""
NEGLIGIBLE_WEIGHT = 1e-20
"""Factor on the weight of a withdrawn observation: below the rounding of all others, yet a point
without other observations keeps its place."""
MAX_UPDATED_ROWS = 64
"""Largest number of rows that leave by an update. With 64 rows the update takes about 0.3 s in Roma
and 0.2 s in a grid of 10 000 points; weights, whose time does not depend on the number, take 0.5 s
and 1.6 s."""
MAX_NEGLECTED_RESIDUAL = 0.01
"""Largest length of what the linear model leaves out of the whitened residuals in an update. Test
values change by about this length, so that the margin of a choice, which is relative to test values
of 3 and more, must exceed the length too."""


@dataclass
class FactorSearch:
    """The factors of a search."""

    given: AddedFactors
    """All factors, with the unknowns that their keys belong to."""
    test: Test
    """The test that decides."""
    alpha: float
    """Probability α0 of a false alarm of one test."""
    aside: dict[str, RejectedFactor] = field(default_factory=dict)
    """Those that are rejected."""
    stuck: dict[str, str] = field(default_factory=dict)
    """Why others cannot be rejected."""
    readmitted: list[str] = field(default_factory=list)
    """Those that were put back, each once."""

    def __bool__(self) -> bool:
        """Return whether there are any."""
        return bool(self.given.factors)

    def without(self, names: Collection[str]) -> AddedFactors:
        """Return the factors without some of them."""
        return self.given.without(names) if self else self.given

    def ratio(self, tested: FactorReliability, solution: Solution) -> float:
        """Return √(T²/critical) of a factor in a solution with it; 0 where nothing controls it."""
        if not tested.dof:
            return 0.0
        f = solution.redundancy
        scale = 1.0
        if self.test == "pope":
            scale = solution.vtpv / f if f > 0 else 0.0
        limit = critical_joint_test(self.test, self.alpha, tested.dof, f)
        return float(np.sqrt(tested.t2 / scale / limit)) if scale > 0.0 else 0.0

    def ratios(self, rel: Reliability) -> dict[str, float]:
        """Return √(T²/critical) of all factors that are in a solution."""
        return {f.name: self.ratio(f, rel.solution) for f in rel.factors} if self else {}

    def worst(self, rel: Reliability) -> tuple[str, float]:
        """Return the factor that is furthest beyond its critical value; no name: none is."""
        beyond = {
            name: ratio
            for name, ratio in self.ratios(rel).items()
            if ratio > 1.0 and name not in self.stuck
        }
        return max(beyond.items(), key=lambda item: item[1], default=("", 0.0))

    def suspects(self, rel: Reliability) -> int:
        """Return the number of factors beyond their critical values."""
        return sum(ratio > 1.0 for ratio in self.ratios(rel).values())

    def unresolved(self, rel: Reliability) -> list[Unresolved]:
        """Return the factors that stay beyond their critical values, the largest first."""
        found = sorted(self.ratios(rel).items(), key=lambda item: -item[1])
        left = "the search stopped before it was its turn"
        return [
            Unresolved(name, "factor", name, "", ratio, np.nan, self.stuck.get(name, left))
            for name, ratio in found
            if ratio > 1.0
        ]


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
        update = Update.of(SolvedCofactors(s.factor, s.equations.unknowns.n_columns))
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
        """Return the test values without more observations; None: an update cannot give them.

        Args:
            rows: all rows of observations, and of clusters, (k,).
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
        for first in range(0, len(sigma), UPDATED_COLUMNS_AT_ONCE):
            part = slice(first, first + UPDATED_COLUMNS_AT_ONCE)
            spread = weighted_rows(equations, system.times(update.spread @ z[:, part])[:n])
            precision += np.square(spread) @ sigma[part]
        gone = np.append(self.gone, rows)
        controlled = precision > least_share(solution) * weight_diagonal(equations)
        controlled[gone] = False
        try:
            moved = equations.residuals(equations.unknowns.retract(solution.state, update.step))
        except InputError:
            return None
        left_out = moved - residuals
        left_out[gone] = 0.0
        pv = weighted_rows(equations, residuals[:, None])[:, 0]
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
        pqp = residual_response(self.solution, rows, factor=self.update)
        return correlations_of_tests(pqp, rows, self.precision, self.controlled)


@dataclass(frozen=True, eq=False)
class SnoopingState:
    """A solution, and the observations of its network that have been taken out; a value."""

    reliability: Reliability
    """Reliability of the solution."""
    test: Test
    """The test that decides."""
    weights: Array | None = None
    """Factors on the weights of the solution; None: no observation is withdrawn."""
    updated: UpdatedTests | None = None
    """Update of the solution; None: no observation has left it by an update."""
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
        """Largest test values of all readings, (m,); of joint ones critical · √(T²/limit)."""
        size = RowGroups.of(self.solution.equations).largest(self.values)
        joint, critical = self.joint, self.critical
        return size if joint is None or np.isnan(critical) else joint.in_units_of(critical, size)

    @cached_property
    def joint(self) -> JointTests | None:
        """Tests of joint readings, which leave by weights alone; None: there are none."""
        return JointTests.of(self.reliability, self.test, self.redundancy, self.solution.vtpv)

    def choice(self, share: float, stuck: Collection[str]) -> Choice:
        """Choose the observations that the next round rejects; ``stuck`` ones stay."""
        found = self.solution.equations.find(list(stuck))
        return choose_outliers(
            self.tested,
            self.values,
            scale=1.0 if self.test == "baarda" else self.sigma0,
            critical=self.critical,
            share=share,
            stuck=self._units(np.array([r[0] for r in found if len(r)], dtype=np.intp)),
            gone=() if self.updated is None else self._units(self.updated.gone),
            joint=self.joint,
        )

    # -- taking out --------------------------------------------------------------------------------

    def updated_without(self, chosen: Sequence[Outlier]) -> SnoopingState | None:
        """Return the test values after a low-rank update.

        None: there are too many rows for it, or joint readings, whose tests it does not update.
        """
        own = self.solution.weights is None or self.weights is not None
        rows = self._rows(chosen)
        if (
            not own
            or self.joint is not None
            or rows is None
            or any(c.point is not None for c in chosen)
        ):
            return None
        before = UpdatedTests.of(self.reliability) if self.updated is None else self.updated
        if len(before.gone) + len(rows) > MAX_UPDATED_ROWS:
            return None
        after = before.without(rows)
        if after is None or after.left_out > MAX_NEGLECTED_RESIDUAL:
            return None
        return replace(self, updated=after, withdrawn=self.withdrawn + len(rows))

    def reweighted_without(
        self, chosen: Sequence[Outlier], datum: DatumChoice | None
    ) -> SnoopingState | None:
        """Return the adjustment with negligible weights of outliers, and of what has left it.

        None: the adjustment fails, or some members of a cluster leave, and others stay.
        """
        rows, equations = self._rows(chosen), self.solution.equations
        if rows is None:
            return None
        weights = np.ones(equations.n_rows) if self.weights is None else self.weights.copy()
        if self.updated is not None:
            weights[self.updated.gone] = NEGLIGIBLE_WEIGHT
        rows = rows[weights[rows] == 1.0]
        weights[rows] = NEGLIGIBLE_WEIGHT
        rel = self.reliability
        try:
            solution = readjust(self.solution, weights, datum=datum)
            if not solution.converged:
                return None
            rel = reliability(solution, alpha=rel.alpha, power=rel.power)
        except AdjustmentError:
            return None
        withdrawn = self.withdrawn + len(rows) - 3 * sum(c.point is not None for c in chosen)
        return SnoopingState(rel, self.test, weights, None, withdrawn)

    def _rows(self, chosen: Sequence[Outlier]) -> Index | None:
        """Return the rows of outliers, (k,), with all rays of points that are rejected.

        None for some members of a cluster: the weights of the others depend on them.
        """
        equations, units = self.solution.equations, RowGroups.of(self.solution.equations)
        rows = [np.zeros(0, dtype=np.intp)]
        rows += [units.rows(c.unit) for c in chosen if c.point is None]
        for c in chosen:
            if c.point is not None:
                rows.append((self.rays(c.point)[:, None] + np.arange(2)).ravel())
        out = np.concatenate(rows)
        leaves = np.zeros(equations.n_rows, dtype=bool)
        leaves[out] = True
        parted = (leaves[c.rows] for c in equations.clusters)
        return None if any(own.any() and not own.all() for own in parted) else out

    def rays(self, point: int) -> Index:
        """Return the first row of every ray to a point, (k,)."""
        return np.concatenate(
            [
                block.first_row + 2 * np.flatnonzero(block.variables[2][1] == point)
                for block in self.solution.equations.blocks
                if block.image
            ]
        )

    def _units(self, rows: Index) -> list[int]:
        """Return the numbers of the readings with these rows."""
        number = self.solution.equations.reading_of_row
        return [int(n) for n in number[rows]]


def rejected_components(
    equations: Equations,
    rows: Index,
    tests: Array,
    errors: Array,
    number: int,
    inseparable: tuple[tuple[str, float], ...] = (),
) -> tuple[Rejected, ...]:
    """Return all components of an observation that a round rejects, without final figures.

    Args:
        equations: the equations that contain the observation.
        rows: its rows, (d,).
        tests: test values of all rows, (n,).
        errors: their estimated gross errors, (n,).
        number: number of the round.
        inseparable: labels of inseparable observations, with the correlations.
    """
    nan, out = float("nan"), []
    for row in rows.tolist():
        block = next(b for b in equations.blocks if b.rows.start <= row < b.rows.stop)
        i, place = divmod(row - block.first_row, block.dimension)
        figures = float(tests[row]), float(errors[row])
        name, component = equations.label(row), block.component(i, place)
        start = block.ids[i], block.kind, name, component
        out.append(Rejected(*start, *figures, number, nan, nan, nan, inseparable))
    return tuple(out)
