"""What linear rows miss, compared with differences of the sum of squares that they stand for."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.solve.marginalisation import MissedStep, marginalise
from tests.networks.moved_after_retirement import two_points_by_distances
from tests.networks.small_block import columns_of, rows_of, small_block

GONE = ("P3", "P5")
STEP = 1e-3
"""Movement for the differences, relative to σ."""


def follow(solution: fga.Solution, columns: np.ndarray, missed: MissedStep) -> np.ndarray:
    """Return how everything follows a unit movement of each of u, (n_columns, k)."""
    unit = np.zeros((solution.equations.unknowns.n_columns, len(columns)))
    unit[columns, np.arange(len(columns))] = solution.equations.unknowns.free[columns]
    return solution.factor.solve(unit) @ missed.scale.T


@pytest.fixture(scope="module")
def example():
    """Return a block, its rows that touch two points, and what linear rows miss of them."""
    solution = fga.adjust(small_block())
    rows = rows_of(solution, *GONE)
    found = marginalise(solution.normal(), rows, columns_of(solution, *GONE))
    columns = found.prior.at(solution.equations, solution.state).rows[0].columns
    return solution, rows, found, columns


def test_unit_movements_have_unit_cofactors(example):
    solution, _, found, columns = example
    moving = follow(solution, columns, found.missed)
    k = moving.shape[1]
    assert found.missed.scale @ moving[columns] == pytest.approx(np.eye(k), abs=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_gradient_is_that_of_the_observations_without_that_of_their_linear_rows(example, seed):
    """What is left is of the third order: half the movement has an eighth of it."""
    solution, rows, found, columns = example
    equations, unknowns = solution.equations, solution.equations.unknowns
    moving = follow(solution, columns, found.missed)
    k = moving.shape[1]
    u = np.random.default_rng(seed).normal(size=k)

    def half_vtpv(at: np.ndarray) -> float:
        v = equations.residuals(unknowns.retract(solution.state, moving @ at))[rows]
        return 0.5 * float(v @ v)

    def gradient(at: np.ndarray) -> np.ndarray:
        steps = np.eye(k) * STEP
        found = [half_vtpv(at + s) - half_vtpv(at - s) for s in steps]
        return np.array(found) / (2 * STEP)

    a = solution.normal().system.times(moving)[rows]
    v = solution.normal().system.residual[rows]
    left, size = [], []
    for part in (2.0, 1.0):
        at = part * u
        exact = gradient(at) - a.T @ (v + a @ at)
        told, _ = found.missed.at((moving @ at)[columns])
        ours = moving[columns].T @ told
        left.append(float(np.linalg.norm(ours - exact)))
        size.append(float(np.linalg.norm(exact)))
    assert left[1] < 0.05 * size[1]
    assert left[1] < left[0] / 6


def test_later_movements_count_from_where_the_rows_were_made():
    rng = np.random.default_rng(4)
    m, k = 5, 3
    linear, cubic = rng.normal(size=(m, m)), rng.normal(size=(m, m, m))
    quadratic = sum(np.transpose(cubic, order) for order in permutations(range(3)))
    missed = MissedStep(np.eye(m), rng.normal(size=m), linear + linear.T, quadratic)
    moved, movement = rng.normal(size=m), rng.normal(size=(m, k))
    later = missed.carried(moved, np.eye(k), movement)
    d = rng.normal(size=k)
    whole, _ = missed.at(moved + movement @ d)
    carried, _ = later.at(d)
    assert carried == pytest.approx(movement.T @ whole)
    assert later.remainder == missed.at(moved)[1] > 0.0
    assert later.at(d)[1] > later.remainder


def test_what_linear_rows_miss_grows_with_their_curvature():
    """Sights ten times as precise have movements ten times as small: they miss a tenth of σ."""
    sizes = []
    for by in (1.0, 0.1):
        solution = fga.adjust(two_points_by_distances(0.2 * by))
        rows = rows_of(solution, "Q")
        found = marginalise(solution.normal(), rows, columns_of(solution, "Q"))
        sizes.append(float(np.linalg.norm(found.missed.quadratic)))
    assert sizes[0] > 1e-3
    assert sizes[1] == pytest.approx(0.1 * sizes[0], rel=0.01)
