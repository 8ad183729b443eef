"""Blocks that are not aerial strips: equal to dense algebra, and to QR where pivots are small."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.solve.nested_dissection import MAX_LEAF_NODES
from factorgraph_adj.solve.normal_equations import NormalEquations, Solver
from factorgraph_adj.types import Array
from tests.networks.shapes import SHAPES


@cache
def adjusted(name: str) -> fga.Solution:
    solution = fga.adjust(SHAPES[name](3))
    assert solution.converged
    assert not solution.run.solver.qr_everywhere
    return solution


@cache
def design(name: str) -> Array:
    """Return whitened A."""
    system = adjusted(name).normal().system
    return system.times(np.eye(system.unknowns.n_columns))


@cache
def whole(name: str) -> Array:
    """Return Q = (AᵀA)⁻¹ by QR of A without held columns."""
    free = adjusted(name).equations.unknowns.free
    a = design(name)[:, free]
    scale = 1.0 / np.linalg.norm(a, axis=0)
    r = np.linalg.qr(a * scale, mode="r")
    half = np.linalg.solve(r, np.eye(len(r))) * scale[:, None]
    q = np.zeros((len(free),) * 2)
    q[np.ix_(free, free)] = half @ half.T
    return q


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("name", SHAPES)
def test_covariances_and_redundancy_numbers_are_those_of_dense_algebra(name: str) -> None:
    solution = adjusted(name)
    a, q = design(name), whole(name)
    rel = fga.reliability(solution)
    hat = np.einsum("ij,jk,ik->i", a, q, a, optimize=True)
    np.testing.assert_allclose(rel.redundancy_numbers, 1.0 - hat, atol=1e-7)
    assert rel.redundancy_numbers.sum() == pytest.approx(solution.redundancy, abs=1e-6)
    unknowns = solution.equations.unknowns
    sigma = np.sqrt(np.diag(q))
    for kind in ("point", "pose", "calibration", "orientation"):
        for number, first in enumerate(unknowns[kind].offset.tolist()):
            if first < 0:
                continue
            columns = unknowns.columns(kind, number)
            found = solution.variable_covariance((kind, unknowns[kind].names[number]))
            s = np.where(sigma[columns] > 0, sigma[columns], 1.0)
            wanted = q[np.ix_(columns, columns)]
            assert np.max(np.abs(found - wanted) / np.outer(s, s)) < 1e-5, (kind, number)


@pytest.mark.parametrize("name", SHAPES)
def test_the_order_is_that_of_the_shape(name: str) -> None:
    """Small fronts where photos see their neighbours, one where everything sees everything."""
    factor = adjusted(name).factor
    assert factor.fronts is not None
    sizes = [f.size for f in factor.fronts.fronts]
    n = factor.fronts.pattern.n
    if name == "unordered":
        assert sizes == [n]
    else:
        assert len(sizes) > 1 and max(sizes) <= 2 * MAX_LEAF_NODES


@pytest.mark.parametrize("damping", [1e-6, 1e-2])
@pytest.mark.parametrize("name", SHAPES)
def test_damped_steps_are_those_of_dense_algebra(name: str, damping: float) -> None:
    solution = adjusted(name)
    normal = solution.normal()
    a = design(name)
    free = solution.equations.unknowns.free
    n = (a.T @ a)[np.ix_(free, free)]
    damped = n + damping * np.diag(np.diag(n))
    y = np.random.default_rng(1).normal(size=(len(free), 2)) * np.sqrt(normal.diagonal)[:, None]
    factor = normal.factorise(damping * normal.diagonal)
    wanted = np.linalg.solve(damped, y[free])
    scale = np.abs(wanted * np.sqrt(np.diag(n))[:, None]).max()
    error = np.abs(factor.solve(y)[free] - wanted) * np.sqrt(np.diag(n))[:, None]
    assert error.max() < 1e-6 * scale


@pytest.mark.parametrize("name", ["tied", "far_points"])
def test_it_is_what_gtsam_eliminates_by_qr(name: str) -> None:
    """All unknowns by QR, without normal equations of points or cameras."""
    solution = adjusted(name)
    solver = Solver.of(solution.equations)
    solver.turn_to_qr()
    other = NormalEquations(solver, solution.state).factorise(
        np.zeros(len(solution.run.constraint))
    )
    y = np.random.default_rng(1).normal(size=(len(solution.run.constraint), 2))
    y *= np.sqrt(solution.normal().diagonal)[:, None]
    wanted, found = other.solve(y), solution.factor.solve(y)
    sigma = np.sqrt(np.maximum(np.diag(whole(name)), 1e-30))[:, None]
    assert np.max(np.abs(found - wanted) / sigma) < 1e-5 * np.max(np.abs(wanted) / sigma)
