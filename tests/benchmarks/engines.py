"""One arriving row in iSAM2 and in dense fronts: ``python -m tests.benchmarks.engines POINTS``.

Both hold the same linear system of a simulated grid: iSAM2 as linear factors without
relinearisation (Cholesky), the fronts as the factorised solution. Each of some rows arrives in
both, alternating. A test of the row needs the joint covariance of its unknowns, and the estimates
need the step: iSAM2 gives them by `jointMarginalCovariance` and `update`, the fronts by one
solution with the row.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from time import perf_counter

import gtsam
import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.types import Array

from .grids import simulate_grid

ARRIVALS = 40
"""Number of rows that arrive."""


@dataclass(frozen=True)
class Rows:
    """The whitened rows of an observation."""

    columns: tuple[int, ...]
    """First column of each variable."""
    partials: tuple[Array, ...]
    """Partials by each variable, (d, k)."""
    residual: Array
    """Residuals, (d,)."""

    def factor(self) -> gtsam.NonlinearFactor:
        """Return them as a linear factor."""
        terms = [x for pair in zip(self.columns, self.partials, strict=True) for x in pair]
        unit = gtsam.noiseModel.Unit.Create(len(self.residual))
        return gtsam.LinearContainerFactor(gtsam.JacobianFactor(*terms, -self.residual, unit))


def rows_of(solution: fga.Solution) -> list[Rows]:
    """Return all observations of at most three variables, which a factor takes in Python."""
    system = solution.normal().system
    out = []
    for lb in system.blocks:
        v = system.residual[lb.block.rows].reshape(lb.block.observed.shape)
        for i in range(lb.block.n):
            on = [j for j, a in enumerate(lb.a) if len(a) and lb.offsets[j][i] >= 0]
            if 0 < len(on) <= 3:
                columns = tuple(int(lb.offsets[j][i]) for j in on)
                out.append(Rows(columns, tuple(np.array(lb.a[j][i]) for j in on), v[i]))
    return out


def measure(points: int) -> dict[str, float]:
    """Return the medians of all arrivals, milliseconds."""
    solution = fga.adjust(simulate_grid(1, points=points).network)
    unknowns, rows = solution.equations.unknowns, rows_of(solution)
    late = set(np.random.default_rng(1).choice(len(rows), ARRIVALS, replace=False).tolist())
    options = gtsam.ISAM2Params()
    options.setFactorization("CHOLESKY")
    options.enableRelinearization = False
    isam, graph, values = gtsam.ISAM2(options), gtsam.NonlinearFactorGraph(), gtsam.Values()
    for first, size in unknowns.size_at.items():
        values.insert(first, np.zeros(size))
        held = np.diag((~unknowns.free[first : first + size]).astype(float))
        if held.any():
            graph.add(Rows((first,), (held,), np.zeros(size)).factor())
    for i, row in enumerate(rows):
        if i not in late:
            graph.add(row.factor())
    isam.update(graph, values)
    seconds: dict[str, list[float]] = {"joint covariance": [], "update": [], "fronts": []}
    for i in sorted(late):
        begin = perf_counter()
        isam.jointMarginalCovariance(list(rows[i].columns)).fullMatrix()
        joint = perf_counter()
        graph = gtsam.NonlinearFactorGraph()
        graph.add(rows[i].factor())
        isam.update(graph, gtsam.Values())
        isam.calculateEstimate()
        updated = perf_counter()
        y = np.zeros((unknowns.n_columns, len(rows[i].residual)))
        for first, a in zip(rows[i].columns, rows[i].partials, strict=True):
            y[first : first + a.shape[1]] = a.T
        solving = perf_counter()
        solution.factor.solve_reduced(y[solution.factor.reduced_columns])
        seconds["fronts"].append(perf_counter() - solving)
        seconds["joint covariance"].append(joint - begin)
        seconds["update"].append(updated - joint)
    return {name: 1e3 * float(np.median(s)) for name, s in seconds.items()}


if __name__ == "__main__":
    for name, ms in measure(int(sys.argv[1])).items():
        print(f"{name:20s}{ms:9.1f} ms")
