"""Linear rows in the place of observations, compared with dense normal equations."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import SingularError
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.solve.marginalisation import marginalise
from factorgraph_adj.solve.normal_equations import NormalEquations, Solver
from tests.networks.small_block import columns_of, rows_of, small_block


def dense(system: LinearisedEquations) -> tuple[np.ndarray, np.ndarray]:
    n = system.unknowns.n_columns
    return system.times(np.eye(n)), system.every_residual


def schur(a: np.ndarray, v: np.ndarray, gone: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return normal matrix and gradient of all columns but some, and vᵀPv at their minimum."""
    on = np.abs(a[:, gone]).max(axis=0) > 0
    own = a[:, gone[on]]
    q, _ = np.linalg.qr(own)
    left = a - q @ (q.T @ a)
    w = v - q @ (q.T @ v)
    return left.T @ left, left.T @ w, float(w @ w)


def lengths(a: np.ndarray) -> np.ndarray:
    """Return the lengths of columns, (n,)."""
    return np.linalg.norm(a, axis=0) + 1e-9


def test_rows_have_the_normal_matrix_gradient_and_sum_of_squares_of_what_they_stand_for():
    solution = fga.adjust(small_block())
    # Not at a minimum: gradients are not zero.
    step = 0.3 * solution.factor.solve(np.ones((solution.equations.unknowns.n_columns, 1)))[:, 0]
    state = solution.equations.unknowns.retract(solution.state, step)
    normal = NormalEquations(Solver.of(solution.equations), state)
    first, second = ("P3", "P5", "P8"), ("P1", "P6")
    rows, gone = rows_of(solution, *first), columns_of(solution, *first)
    found = marginalise(normal, rows, gone)
    a, v = dense(normal.system)
    n, g, vtpv = schur(a[rows], v[rows], np.concatenate(gone))
    extra = found.prior.at(solution.equations, state).rows
    (e,) = extra
    ours = np.zeros_like(n)
    ours[np.ix_(e.columns, e.columns)] = e.a.T @ e.a
    every = lengths(a[rows])
    scale = np.outer(every, every)
    assert np.abs((ours - n) / scale).max() < 1e-9
    gradient = np.zeros_like(g)
    gradient[e.columns] = e.a.T @ e.residual
    assert np.abs((gradient - g) / every).max() < 1e-7
    assert float(e.residual @ e.residual) == pytest.approx(vtpv, rel=1e-9)
    assert found.prior.n_rows == len(rows) - sum(map(len, gone))

    # A second time, with these rows in the place of the others.
    again = NormalEquations(Solver.of(solution.equations, extra), state, extra)
    more = np.setdiff1d(rows_of(solution, *second), rows)
    later = marginalise(again, more, columns_of(solution, *second), *found)
    both = np.union1d(rows, more)
    n, g, vtpv = schur(a[both], v[both], np.concatenate(columns_of(solution, *first, *second)))
    scale = np.outer(lengths(a[both]), lengths(a[both]))
    (e,) = later.prior.at(solution.equations, state).rows
    ours = np.zeros_like(n)
    ours[np.ix_(e.columns, e.columns)] = e.a.T @ e.a
    assert np.abs((ours - n) / scale).max() < 1e-9
    assert float(e.residual @ e.residual) == pytest.approx(vtpv, rel=1e-9)
    assert later.prior.n_rows == len(both) - sum(map(len, columns_of(solution, *first, *second)))


def test_an_unknown_that_its_rows_do_not_determine_is_refused():
    solution = fga.adjust(small_block())
    normal = solution.normal()
    with pytest.raises(SingularError):
        marginalise(normal, rows_of(solution, "P3")[:2], columns_of(solution, "P3"))
