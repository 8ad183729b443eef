"""Clusters of equal pattern are computed at once, and give what each of them gives alone."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import (
    Correlated,
    GnssVector,
    HeadingDifference,
    Observation,
    PlanarVector,
    SlopeDistance,
)
from factorgraph_adj.solve.linearised_equations import LinearisedEquations


def network() -> fga.Network:
    """Return a drive with edges, GNSS vectors and a distance in clusters of four patterns."""
    rng = np.random.default_rng(1)
    out = fga.Network("drive")
    at = np.cumsum(rng.normal(3.0, 1.0, (7, 3)), axis=0)
    for i, x in enumerate(at):
        out.add_point(str(i), tuple(x), fixed="xyz" if i == 0 else "")
        out.set_unknown("heading", str(i), (0.2 * i,), fixed=i == 0)

    def covariance(size: int) -> np.ndarray:
        root = np.tril(rng.normal(0.0, 0.02, (size, size))) + 0.05 * np.eye(size)
        return np.asarray(root @ root.T)

    def vector(a: int, b: int) -> GnssVector:
        value = at[b] - at[a] + rng.normal(0.0, 0.05, 3)
        return GnssVector(str(a), str(b), tuple(value), sigma=(0.05,) * 3)

    for i, j in [*((k, k + 1) for k in range(6)), (0, 3), (2, 6)]:
        c, s, (e, n, _) = np.cos(0.2 * i), np.sin(0.2 * i), at[j] - at[i]
        turn = HeadingDifference(str(i), str(j), 0.2 * (j - i), sigma=0.05)
        step = PlanarVector(str(i), str(j), (s * e + c * n, s * n - c * e), sigma=(0.05, 0.05))
        pair: tuple[Observation, ...] = (step, turn) if i % 2 else (turn, step)
        out.add(Correlated(pair, covariance(3)))
    for a, b, c in ((0, 1, 2), (2, 3, 4), (4, 5, 6)):
        out.add(Correlated((vector(a, b), vector(b, c)), covariance(6)))
    length = float(np.linalg.norm(at[5] - at[0]))
    far = SlopeDistance("0", "5", length, sigma=0.05)
    out.add(Correlated((far, vector(0, 5)), covariance(4)))
    return out


@pytest.fixture(scope="module")
def system() -> LinearisedEquations:
    equations = compile_network(network())
    return LinearisedEquations(equations, equations.unknowns.start())


def test_whitened_rows_are_those_of_each_cluster_alone(system: LinearisedEquations) -> None:
    equations, state = system.equations, system.state
    raw = equations.residuals(state, whitened=False)
    partials = np.zeros((equations.n_rows, equations.unknowns.n_columns))
    for block in equations.blocks:
        found = block.evaluate(equations.network.frame, state).jacobians
        for (kind, index), a in zip(block.variables, found, strict=True):
            table = equations.unknowns[kind]
            for i, number in enumerate(index.tolist()):
                for k in np.flatnonzero(table.free[number] & (table.offset[number] >= 0)):
                    rows = block.first_row + i * block.dimension + np.arange(block.dimension)
                    partials[rows, table.offset[number] + k] += a[i, :, k]
    expected = np.zeros_like(partials)
    for c in equations.clusters:
        expected[c.rows] = c.whitener @ partials[c.rows]
        assert system.residual[c.rows] == pytest.approx(c.whitener @ raw[c.rows], abs=1e-9)
    found = system.times(np.eye(equations.unknowns.n_columns))
    assert found == pytest.approx(expected, abs=1e-9)
    assert system.transposed(np.eye(len(found))) == pytest.approx(expected.T, abs=1e-9)
    assert system.diagonal() == pytest.approx(np.sum(expected**2, axis=0), rel=1e-9)
    for (columns, a), c in zip(system.cluster_rows(), equations.clusters, strict=True):
        assert a == pytest.approx(expected[c.rows][:, columns], abs=1e-9)
    assert len(equations.cluster_batches) < len(equations.clusters)


def test_batch_arrivals_and_leverages_agree_with_dense_equations() -> None:
    solution = fga.adjust(network())
    system = solution.normal().system
    a = system.times(np.eye(system.unknowns.n_columns))
    free = system.unknowns.free
    q = np.zeros((len(free), len(free)))
    q[np.ix_(free, free)] = np.linalg.inv(a[:, free].T @ a[:, free])
    assert solution.covariance("4", "6") == pytest.approx(
        q[np.ix_(*(_columns(solution, p) for p in "46"))], rel=1e-9, abs=1e-12
    )
    groups = {g.ids: g for g in fga.reliability(solution).groups}
    edges = [g for ids, g in groups.items() if len(ids) == 2 and len(g.rows) == 3]
    assert len(edges) == 8
    for g in edges:
        m = np.eye(3) - a[g.rows] @ q @ a[g.rows].T
        assert g.redundancy == pytest.approx(np.trace(m), rel=1e-8)
        assert g.dof == np.linalg.matrix_rank(m, tol=1e-6)


def _columns(solution: fga.Solution, point: str) -> np.ndarray:
    table = solution.equations.unknowns["point"]
    return np.asarray(table.offset[table.number[point]] + np.arange(3))
