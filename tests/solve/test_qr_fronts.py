"""Fronts by QR of the rows, against GTSAM's QR, dense QR, and Cholesky."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import SingularError
from factorgraph_adj.solve.nested_dissection import BlockPattern, dissect
from factorgraph_adj.solve.normal_equations import NormalEquations, Solver
from factorgraph_adj.solve.qr_fronts import RowElements, fronts_by_qr
from factorgraph_adj.types import NO_ROWS
from tests.benchmarks.grids import simulate_grid
from tests.networks.image_blocks import ring
from tests.networks.small_block import small_block
from tests.support.gtsam_elimination import solution_by_gtsam

NETWORKS = {
    "grid": lambda: simulate_grid(1, points=100).network,
    "combined block": small_block,
    "photos around an object": lambda: ring(3).network,
}


def turned(name: str) -> NormalEquations:
    """Return a network at its minimum, whose factorisations are by QR of all unknowns."""
    solution = fga.adjust(NETWORKS[name]())
    solver = Solver.of(solution.equations)
    solver.turn_to_qr()
    return NormalEquations(solver, solution.state)


@pytest.mark.parametrize("name", NETWORKS)
def test_solutions_are_those_of_gtsam_and_of_dense_qr(name: str) -> None:
    normal = turned(name)
    system, free = normal.system, normal.solver.equations.unknowns.free
    factor = normal.factorise(np.zeros(len(free)))
    b = np.random.default_rng(1).normal(size=len(system.residual))
    found = factor.solve(system.transposed(b[:, None]))[:, 0]
    a = system.times(np.eye(len(free)))[:, free]
    scale = 1.0 / np.linalg.norm(a, axis=0)
    dense = np.zeros(len(free))
    dense[free] = scale * np.linalg.lstsq(a * scale, b, rcond=None)[0]
    sigma = np.zeros(len(free))
    sigma[free] = scale * np.sqrt(np.diag(np.linalg.pinv((a * scale).T @ (a * scale))))
    for other in (dense, solution_by_gtsam(system, b)):
        assert (np.abs(found - other)[free] < 1e-7 * sigma[free]).all()


@pytest.mark.parametrize("name", NETWORKS)
def test_covariances_are_those_of_dense_qr(name: str) -> None:
    normal = turned(name)
    unknowns = normal.solver.equations.unknowns
    free = np.flatnonzero(unknowns.free)
    factor = normal.factorise(np.zeros(len(unknowns.free)))
    a = normal.system.times(np.eye(len(unknowns.free)))[:, free]
    scale = 1.0 / np.linalg.norm(a, axis=0)
    half = scale[:, None] * np.linalg.inv(np.linalg.qr(a * scale, mode="r"))
    q = np.zeros((len(unknowns.free),) * 2)
    q[np.ix_(free, free)] = half @ half.T
    sigma = np.sqrt(np.diag(q))
    for kind, number in unknowns.active():
        columns = unknowns.columns(kind, number)
        error = np.abs(factor.joint(columns[None])[0] - q[np.ix_(columns, columns)])
        assert (error <= 1e-8 * np.outer(sigma[columns], sigma[columns])).all(), (kind, number)
    place = factor.nodes.place_of
    one = np.flatnonzero(place >= 0)[:4][None]
    np.testing.assert_allclose(
        factor.squares(one, np.eye(4)[None])[0], q[np.ix_(one[0], one[0])], rtol=1e-7, atol=1e-18
    )


def test_points_of_photos_are_fronts_of_their_own() -> None:
    normal = turned("photos around an object")
    factor = normal.factorise(np.zeros(len(normal.diagonal)))
    points = int(normal.solver.layers.leaves.sum())
    assert points and sum(len(f.own) == 1 for f in factor.fronts.fronts) >= points
    assert max(len(f.own) for f in factor.fronts.fronts) < points


def grid_pattern(n: int) -> tuple[BlockPattern, np.ndarray]:
    """Return the pattern of a square grid of nodes of two columns with a border of one."""
    number = np.arange(n * n).reshape(n, n)
    pairs = np.concatenate(
        [
            np.stack([number[:, :-1].ravel(), number[:, 1:].ravel()], 1),
            np.stack([number[:-1].ravel(), number[1:].ravel()], 1),
        ]
    )
    pairs = pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]
    y, x = np.divmod(np.arange(n * n), n)
    at = np.stack([x, y, np.zeros(n * n)], 1).astype(float)
    return BlockPattern(n * n, 2, 1, pairs[:, 0], pairs[:, 1]), at


def test_a_column_without_rows_is_singular_and_a_held_one_is_not() -> None:
    pattern, at = grid_pattern(9)
    rng = np.random.default_rng(1)
    rows = []
    for a, b in zip(pattern.first, pattern.second, strict=True):
        row = np.zeros(pattern.n * 2 + 1)
        row[[2 * a, 2 * b, 2 * pattern.n]] = rng.normal(size=3)
        rows.append(row)
    dense = np.array([*rows, *np.eye(pattern.n * 2 + 1)[::2]])
    row, place = np.nonzero(dense)
    a = RowElements(row, place, dense[row, place], len(dense))
    held = np.zeros(dense.shape[1], dtype=bool)
    held[1:-1:2] = True
    fronts = dissect(pattern, at)
    assert len(fronts) > 1
    found = fronts_by_qr(fronts, pattern, a, held)
    y = np.where(held[:, None], 0.0, rng.normal(size=(len(held), 2)))
    on = np.flatnonzero(~held)
    dense = dense[:, on]
    np.testing.assert_allclose(
        found.solve(y)[on], np.linalg.solve(dense.T @ dense, y[on]), rtol=1e-9
    )
    held[1] = False
    with pytest.raises(SingularError):
        fronts_by_qr(fronts, pattern, a, held)


def test_a_few_nodes_that_meet_all_others_do_not_join_them() -> None:
    """Two hubs, one at each end of a chain."""
    n = 200
    first = np.concatenate([np.arange(n - 1), np.arange(n), np.arange(n)])
    second = np.concatenate([np.arange(1, n), np.full(n, n), np.full(n, n + 1)])
    order = np.lexsort((second, first))
    x = np.concatenate([np.arange(n), [0.0, n]])
    at = np.stack([x, 0.0 * x, 0.0 * x], 1)
    fronts = dissect(BlockPattern(n + 2, 1, 0, first[order], second[order]), at, NO_ROWS)
    assert max(f.size for f in fronts) < n / 4
