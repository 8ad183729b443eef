"""What is known of some unknowns without the observations of points, against dense algebra."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from factorgraph_adj.solve.added_factors import MarginalPrior, marginal_prior
from factorgraph_adj.types import Array, Index
from tests.networks.eliminated import ELIMINATED, FIRST_LAYER, eliminated

GIVEN = tuple(n for n in FIRST_LAYER if "free" not in n and n != "held photos")
"""Cases with a given datum, points that only cameras see, and something that these depend on."""
KNOWN = 1e-6
"""Share of the information along a direction from which on it is compared."""

STEP = 1e-6
"""Step of the central differences, metres and radians."""


class Divided:
    """A solution, points P of it, and the unknowns T beside them."""

    def __init__(self, name: str, seed: int) -> None:
        case = eliminated(name)
        self.case, solution = case, case.solution
        rng = np.random.default_rng(seed)
        chosen = np.sort(rng.permutation(len(case.points))[: (len(case.points) + 1) // 2])
        self.points: Index = case.points[chosen]
        layers = case.factor.layers
        numbers = np.flatnonzero(layers.reduced)[chosen]
        self.rows = solution.equations.touching("point", numbers)
        self.system = solution.normal().system
        unknowns = solution.equations.unknowns
        a = self.system.sparse(self.rows)
        touched = np.setdiff1d(a.indices, self.points)
        more = rng.permutation(case.others)[:3]
        owners = unknowns.owners(np.union1d(touched, more))
        self.columns: Index = np.sort(
            np.concatenate([unknowns.columns(k, unknowns[k].number[n]) for k, n in owners])
        )
        self.free = unknowns.free[self.columns]

    @property
    def known(self) -> MarginalPrior:
        t = self.columns
        q = self.case.dense.q[np.ix_(t, t)]
        out = marginal_prior(self.case.solution.normal(), t, q, self.points, self.rows)
        assert out is not None
        return out

    def left(self) -> tuple[Array, Array]:
        """Return N and the gradient of all other observations, reduced to T."""
        others = np.setdiff1d(np.arange(self.system.equations.n_rows), self.rows)
        a = self.system.sparse(others).toarray()
        v = self.system.residual[others]
        free = np.where(self.case.dense.free)[0]
        t = self.columns[self.free]
        o = np.setdiff1d(free, np.concatenate([t, self.points.ravel()]))
        at, ao = a[:, t], a[:, o]
        along = np.linalg.lstsq(ao, np.column_stack([at, v]), rcond=1e-12)[0]
        left = np.column_stack([at, v]) - ao @ along
        return at.T @ left[:, :-1], at.T @ left[:, -1]


@cache
def divided(name: str, seed: int) -> Divided:
    return Divided(name, seed)


every_case = pytest.mark.parametrize("name", GIVEN)
some_points = pytest.mark.parametrize("seed", [1, 2, 3])


def test_there_are_cases_of_several_sorts():
    assert set(GIVEN) < set(ELIMINATED)
    assert len(GIVEN) >= 5


@every_case
@some_points
def test_the_rows_are_the_information_of_all_other_observations(name, seed):
    """LᵀHL is between 0 and I: each direction of T in units of its standard deviation."""
    d = divided(name, seed)
    known = d.known
    r, z = known.prior.r, known.prior.z
    assert r is not None and z is not None
    expected, gradient = d.left()
    root = np.linalg.cholesky(d.case.dense.q[np.ix_(d.columns, d.columns)][d.free][:, d.free])
    found = root.T @ (r.T @ r)[np.ix_(d.free, d.free)] @ root
    assert np.abs(found - root.T @ expected @ root).max() < 1e-6
    assert np.abs(root.T @ ((r.T @ z)[d.free] - gradient)).max() < 1e-5
    assert not r[:, ~d.free].any()


@every_case
def test_counts_and_sums_are_those_of_the_rows_and_the_observations_of_the_points(name):
    d = divided(name, 1)
    known = d.known
    assert known.n_rows == len(known.prior.z) + len(d.rows)
    free = int(d.free.sum()) + int(d.case.dense.free[d.points].sum())
    assert known.redundancy == known.n_rows - free
    v = d.system.residual[d.rows]
    assert known.vtpv == pytest.approx(float(v @ v + known.prior.z @ known.prior.z))
    q = d.case.dense.q[np.ix_(d.columns, d.columns)]
    whole = known.root @ known.root.T
    sigma = np.sqrt(np.diag(q)[d.free])
    gap = (whole - q)[np.ix_(d.free, d.free)] / np.outer(sigma, sigma)
    assert np.array_equal(whole[~d.free], np.eye(len(q))[~d.free])
    assert np.abs(gap).max() < 1e-9


@every_case
def test_the_rows_move_with_the_state_as_their_partials_say(name):
    """At a state that is far from the solution, rotations by tenths of a radian among it."""
    d = divided(name, 2)
    prior, equations = d.known.prior, d.case.solution.equations
    unknowns = equations.unknowns
    rng = np.random.default_rng(5)
    away = unknowns.retract(
        d.case.solution.state, 0.1 * np.where(unknowns.free, rng.normal(size=len(unknowns.free)), 0)
    )
    (rows,) = prior.at(equations, away).rows
    scale = np.abs(rows.a).max(axis=1)
    for column in rows.columns[d.free[: len(rows.columns)]][:40]:
        step = np.zeros(len(unknowns.free))
        step[column] = STEP
        ahead, back = (
            prior.at(equations, unknowns.retract(away, s * step)).rows[0].residual for s in (1, -1)
        )
        expected = (ahead - back) / (2 * STEP)
        own = rows.a[:, list(rows.columns).index(column)]
        assert np.abs((own - expected) / scale).max() < 1e-6


@every_case
def test_the_rows_begin_at_the_solution(name):
    d = divided(name, 1)
    prior, solution = d.known.prior, d.case.solution
    (rows,) = prior.at(solution.equations, solution.state).rows
    assert np.abs(rows.residual - prior.z).max() < 1e-6
    assert not prior.movement(solution.equations, solution.state).any()


def test_rows_that_touch_something_else_are_refused():
    d = divided("mixed", 1)
    t = d.columns[6:] if d.system.unknowns.owners(d.columns[:1])[0][0] == "pose" else d.columns[3:]
    q = d.case.dense.q[np.ix_(t, t)]
    assert marginal_prior(d.case.solution.normal(), t, q, d.points, d.rows) is None
