"""Tests of joint readings: correlated parts of one measurement, such as the edge of a pose graph.

The vector and the turn of an edge come from one comparison of two scans or images. A false one is
wrong in both, so that a test of either part alone, given the other, has no meaning: in a chain with
few closures the parts of right edges may have larger test values than those of the false one. All d
components together have

    T² = uᵀ M⁻¹ u,    u = Eᵀ P v,    M = Eᵀ P Q_vv P E,

with E choosing their rows, see `factorgraph_adj.quality.group_tests`. By the inequality of Cauchy
and Schwarz an error of one reading, and no other, gives that reading the largest T² of all readings
with as many components. Baarda's test compares T² with χ²_d. For an estimated σ0, T²/vᵀPv has the
distribution Beta(d/2, (f − d)/2) with the redundancy f, so that one component is tested as by Pope.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..graph.equations import Equations
from ..solve.solution import Solution
from ..statistical_tests import fisher_quantile
from ..types import Array, Index
from .group_tests import Test, critical_t2
from .innovations import Innovations
from .prediction import Prediction
from .reliability import Reliability


def critical_joint_test(test: Test, alpha: float, dof: int, redundancy: int) -> float:
    """Return the critical value of T², relative to σ0² (Baarda) or σ̂0² (Pope).

    Args:
        test: the test that decides.
        alpha: probability α0 of a false alarm.
        dof: degrees of freedom d of T².
        redundancy: f of the adjustment; without any left Pope's test has no critical value, which
            is infinite.
    """
    if not dof:
        return np.inf
    if test == "baarda":
        return critical_t2(alpha, dof)
    if redundancy <= dof:
        return np.inf
    part = dof * fisher_quantile(1.0 - alpha, dof, redundancy - dof)
    return float(redundancy * part / (part + redundancy - dof))


@dataclass(frozen=True, eq=False)
class JointTests:
    """T² of the joint readings of a solution."""

    unit: Index
    """Number of each reading among all, (k,)."""
    t2: Array
    """T², relative to the σ0² of the test, (k,)."""
    limit: Array
    """Its critical values, (k,); infinite where there is no test."""

    @classmethod
    def of(cls, rel: Reliability, test: Test, redundancy: int, vtpv: float) -> JointTests | None:
        """Return the tests of a solution; None: it has no joint readings.

        Args:
            rel: its reliability.
            test: the test that decides.
            redundancy: f without withdrawn observations.
            vtpv: vᵀPv.
        """
        equations = rel.solution.equations
        if not has_joint_readings(equations):
            return None
        number = equations.reading_of_row
        size = np.bincount(number)
        units, t2, limits = [], [], []
        scale = 1.0 if test == "baarda" else vtpv / redundancy if redundancy > 0 else 0.0
        for g in rel.groups:
            own = int(number[g.rows[0]])
            if len(g.ids) < 2 or len(g.rows) != size[own] or np.any(number[g.rows] != own):
                continue
            units.append(own)
            t2.append(g.test / scale if g.dof and scale > 0.0 else 0.0)
            limits.append(critical_joint_test(test, rel.alpha, g.dof, redundancy))
        return cls(np.array(units, dtype=np.intp), np.array(t2), np.array(limits))

    def in_units_of(self, critical: float, size: Array) -> Array:
        """Return the sizes (m,) of all readings, those of joint ones as critical · √(T²/limit)."""
        out = size.copy()
        out[self.unit] = critical * np.sqrt(self.t2 / self.limit)
        return out

    def limits(self) -> Mapping[int, float]:
        """Return the critical value of T² by the number of the reading."""
        return dict(zip(self.unit.tolist(), self.limit.tolist(), strict=True))


def fitting_readings(
    prediction: Prediction, solution: Solution, test: Test, alpha: float
) -> dict[str, bool]:
    """Return whether joint readings fit a solution without them, by the ids of their observations.

    Args:
        prediction: the predicted observations; a reading of which one is missing does not fit.
        solution: the solution.
        test: the test that decides.
        alpha: probability α0 of a false alarm.
    """
    equations, out = prediction.equations, dict[str, bool]()
    if not has_joint_readings(equations):
        return out
    number = equations.reading_of_row
    size, own = np.bincount(number), number[prediction.rows]
    innovations = Innovations(equations, solution)
    for unit in np.unique(own).tolist():
        rows = prediction.rows[own == unit]
        ids = dict.fromkeys(equations.id(int(row)) for row in rows)
        if len(ids) < 2 and len(rows) == size[unit]:
            continue  # an observation by itself
        fits = False
        if len(rows) == size[unit]:
            linear = innovations.linearise(rows)
            y = linear.a.toarray().T
            d = linear.covariance.toarray() + y.T @ solution.cofactor_times(y)
            t2 = float(linear.v @ np.linalg.solve(d, linear.v))
            f = solution.redundancy + len(rows)
            scale = 1.0 if test == "baarda" else (solution.vtpv + t2) / f
            fits = t2 <= scale * critical_joint_test(test, alpha, len(rows), f)
        out |= dict.fromkeys(ids, fits)
    return out


def has_joint_readings(equations: Equations) -> bool:
    """Return whether observations of some cluster are parts of one reading."""
    return equations.reading_of_row is not equations.observation_of_row
