"""Linear rows in the place of observations, compared with dense normal equations."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.solve.linear import LinearisedEquations
from factorgraph_adj.solve.marginalisation import marginalised
from factorgraph_adj.solve.missed_step import MAX_KEPT_MARGINALISATIONS, MissedStep
from factorgraph_adj.solve.normal import NormalEquations, Solver
from factorgraph_adj.solve.singular import SingularError
from tests.networks.small_block import small_block


def dense(system: LinearisedEquations) -> tuple[np.ndarray, np.ndarray]:
    n = system.unknowns.n_columns
    return system.times(np.eye(n)), system.every_residual


def columns_of(solution: fga.Solution, *names: str) -> list[np.ndarray]:
    table = solution.equations.unknowns["point"]
    return [solution.equations.unknowns.columns("point", table.number[n]) for n in names]


def rows_of(solution: fga.Solution, *names: str) -> np.ndarray:
    number = solution.equations.unknowns["point"].number
    touching = solution.equations.touching("point", np.array([number[n] for n in names]))
    return np.unique(touching)


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
    found = marginalised(normal, rows, gone)
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
    later = marginalised(again, more, columns_of(solution, *second), found.prior)
    both = np.union1d(rows, more)
    n, g, vtpv = schur(a[both], v[both], np.concatenate(columns_of(solution, *first, *second)))
    scale = np.outer(lengths(a[both]), lengths(a[both]))
    (e,) = later.prior.at(solution.equations, state).rows
    ours = np.zeros_like(n)
    ours[np.ix_(e.columns, e.columns)] = e.a.T @ e.a
    assert np.abs((ours - n) / scale).max() < 1e-9
    assert float(e.residual @ e.residual) == pytest.approx(vtpv, rel=1e-9)
    assert later.prior.n_rows == len(both) - sum(map(len, columns_of(solution, *first, *second)))


def test_what_was_missed_moves_what_remains_as_it_would_move_everything():
    """Gradients are carried on from one marginalisation to the next, exactly."""
    solution = fga.adjust(small_block())
    normal = solution.normal()
    rows, state = rows_of(solution, "P3", "P5"), solution.state
    found = marginalised(normal, rows, columns_of(solution, "P3", "P5"))
    extra = found.prior.at(solution.equations, state).rows
    again = NormalEquations(Solver.of(solution.equations, extra), state, extra)
    (e,) = extra
    rng = np.random.default_rng(1)
    free = solution.equations.unknowns.free[e.columns]
    gradients = rng.standard_normal((6, len(e.columns), 3)) * lengths(e.a)[:, None]
    gradients *= free[:, None]
    known = MissedStep(found.missed.sigma, gradients, np.ones(6), older=0.5)
    more = np.setdiff1d(rows_of(solution, "P1"), rows)
    gone = columns_of(solution, "P1")
    later = marginalised(again, more, gone, found.prior, known)
    (e2,) = later.prior.at(solution.equations, state).rows
    whole = np.zeros((solution.equations.unknowns.n_columns, 3))
    whole[e.columns] = gradients[1]
    factor = again.factorise(np.zeros(len(whole)))
    wanted = factor.solve(whole)[e2.columns]
    carried = np.zeros_like(whole)
    carried[e2.columns] = later.missed.gradients[2]
    assert factor.solve(carried)[e2.columns] == pytest.approx(wanted, rel=1e-6, abs=1e-12)
    sigma = later.missed.sigma[:, None]
    on = sigma[:, 0] > 0
    relative = np.abs(wanted[on] / sigma[on]).max()
    assert relative <= later.missed.lengths[2] * (1 + 1e-9)
    # The rows of the marginalisation before have not moved; six and a new one are three too many.
    assert later.missed.lengths[1] == 0
    assert len(later.missed.lengths) == MAX_KEPT_MARGINALISATIONS
    assert later.missed.older > 0.5
    still = np.zeros(len(e2.columns))
    assert later.missed.at(still) == pytest.approx(
        later.missed.older + later.missed.lengths[1:].sum()
    )


def test_what_linear_rows_miss_grows_with_their_curvature():
    """Sights ten times as precise have movements ten times as small: they miss a tenth of σ."""
    missed = []
    for by in (1.0, 0.1):
        network = fga.Network("sights")
        for name, at in {"A": (0, 0, 0), "B": (9, 0, 0), "C": (0, 9, 0)}.items():
            network.add_point(name, at, fixed="xyz")
        network.add_point("P", (4.0, 5.0, 0.0), fixed="z")
        network.add_point("Q", (6.0, 8.0, 0.0), fixed="z")
        for a, b in ("AP", "BP", "CP", "PQ", "AQ", "BQ"):
            d = np.subtract(network.points[b].coordinates, network.points[a].coordinates)
            length = float(np.linalg.norm(d))
            network.add(fga.observations.SlopeDistance(a, b, length, sigma=0.2 * by))
        solution = fga.adjust(network)
        rows = rows_of(solution, "Q")
        found = marginalised(solution.normal(), rows, columns_of(solution, "Q"))
        missed.append(float(found.missed.lengths[0]))
    assert missed[0] > 1e-3
    assert missed[1] == pytest.approx(0.1 * missed[0], rel=0.1)


def test_an_unknown_that_its_rows_do_not_determine_is_refused():
    solution = fga.adjust(small_block())
    normal = solution.normal()
    with pytest.raises(SingularError):
        marginalised(normal, rows_of(solution, "P3")[:2], columns_of(solution, "P3"))
