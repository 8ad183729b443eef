"""Inner constraints with dense matrices, whatever hardly notices the motions that they fill."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array
from tests.support.dense import Dense


def least_noticed(solution: Solution) -> tuple[Array, Array]:
    """Return what A notices of vectors, ascending, and the vectors, by dense SVD of A alone."""
    dense = Dense.at(solution.equations, solution.state)
    scale = np.linalg.norm(dense.design, axis=0)
    _, s, vt = np.linalg.svd(dense.design / scale, full_matrices=True)
    values = np.zeros(len(vt))
    values[: len(s)] = s
    return values[::-1], (vt[::-1] / scale).T


def bordered(solution: Solution, motions: Array) -> Array:
    """Return Q (n_columns, n_columns) of min |A x + v| where G_Dᵀ x_D = 0, exactly, densely."""
    dense = Dense.at(solution.equations, solution.state)
    scale = np.linalg.norm(dense.design, axis=0)
    assert solution.datum is not None
    held = np.where(solution.datum.columns[dense.free, None], motions, 0.0) / scale[:, None]
    every, _ = np.linalg.qr(held, mode="complete")
    left = every[:, motions.shape[1] :]
    half = left @ np.linalg.inv(np.linalg.qr(dense.design / scale @ left, mode="r"))
    half /= scale[:, None]
    q = np.zeros((len(dense.free),) * 2)
    q[np.ix_(dense.free, dense.free)] = half @ half.T
    return q


def assert_sigmas(solution: Solution, q: Array, *, rtol: float) -> None:
    """Standard deviations of all points are those of a dense Q."""
    unknowns = solution.equations.unknowns
    for name in solution.network.points:
        columns = unknowns.columns("point", unknowns["point"].number[name])
        wanted = np.sqrt(np.diag(q)[columns])
        np.testing.assert_allclose(solution.standard_deviations(name), wanted, rtol=rtol)
