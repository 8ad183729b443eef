"""Units inside an adjusted network: both ways to their redundancy matrix M, against dense M."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.ledger.ledger import Ledger
from factorgraph_adj.ledger.row_store import Unit
from factorgraph_adj.linear_system import joint_tests as module
from factorgraph_adj.linear_system.joint_tests import RowsInBase
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import ImagePoint
from factorgraph_adj.quality import group_tests
from factorgraph_adj.solve.solution import normal_equations_at
from factorgraph_adj.types import Array
from tests.networks.eliminated import Eliminated, eliminated

ROUNDING = 1e-9
"""Error of an element of M, which is at most one."""
NETWORKS = ("mixed", "mixed, free", "mixed, held height", "terrestrial", "photos")
MOST = 120
"""Number of units at most."""


def units_of(network: Network) -> list[Unit]:
    """Return observations, groups and image points in an order of their own."""
    ledger = Ledger.of(network)
    rows = ledger.having("accepted")
    return ledger.units(np.random.default_rng(1).permutation(rows)[:MOST])


def test_the_networks_have_groups_and_image_points():
    units = {name: units_of(eliminated(name).solution.network) for name in NETWORKS}
    assert any(len(u.ids) > 1 for u in units["terrestrial"])
    rays = {n: sum(isinstance(u.item, ImagePoint) for u in units[n]) for n in NETWORKS}
    assert all(n > 40 for name, n in rays.items() if name != "terrestrial")


def rows_and_m(case: Eliminated, found: RowsInBase) -> tuple[Array, Array]:
    """Return A of the rows of all units, and I − A Q Aᵀ."""
    a = case.dense.a[found.every]
    return a, np.eye(len(a)) - a @ case.dense.q @ a.T


@pytest.mark.parametrize("few", [10_000, 0])
@pytest.mark.parametrize("name", NETWORKS)
def test_whole_matrix_and_columns_on_demand_are_those_of_the_dense_matrix(name, few, monkeypatch):
    monkeypatch.setattr(module, "MAX_DENSE_ROWS", few)
    monkeypatch.setattr(module, "ROWS_PER_SOLUTION", 7)
    case = eliminated(name)
    units = units_of(case.solution.network)
    found = RowsInBase.of(case.solution.normal(), case.factor, units, case.solution)
    assert len(found.every) > 20
    a, m = rows_and_m(case, found)
    tested = found.tested()
    v = case.solution.normal().system.residual[found.every]
    assert np.array_equal(tested.v, v)
    for i, own in enumerate(found.rows):
        assert tested.block(i) == pytest.approx(m[np.ix_(own, own)], abs=ROUNDING)
        spread = case.dense.q @ a[own].T
        every = np.arange(len(spread))
        error = np.abs(found.spread(i, every) - spread) / case.dense.sigma[:, None]
        assert error.max() < 10 * max(ROUNDING, case.rounding)
    # Units leave: then columns of M are asked for.
    expected = group_tests.LeaveOneOutTests(found.rows, v, lambda u: m[:, u])
    for i in (0, len(units) // 2, len(units) - 1):
        tested.leave_out(i)
        expected.leave_out(i)
        assert tested.v == pytest.approx(expected.v, abs=ROUNDING * (1.0 + np.abs(v).max()))
        assert tested.blocks == pytest.approx(expected.blocks, abs=ROUNDING)


@pytest.mark.parametrize("name", ["mixed", "terrestrial"])
def test_before_the_network_moves_residuals_are_those_after_the_step(name):
    case = eliminated(name)
    solution = case.solution
    step = 0.1 * case.dense.sigma * np.random.default_rng(2).normal(size=len(case.dense.free))
    unknowns = solution.equations.unknowns
    state = unknowns.retract(solution.state, np.where(case.dense.free, step, 0.0))
    normal = normal_equations_at(solution, state)
    factor = normal.factorise(solution.run.constraint)
    units = units_of(solution.network)
    found = RowsInBase.of(normal, factor, units)
    a = normal.system.times(np.eye(len(step)))
    v = normal.system.residual
    dx = np.linalg.lstsq(a * case.dense.sigma, -v, rcond=None)[0] * case.dense.sigma
    expected = (v + a @ dx)[found.every]
    assert found.tested().v == pytest.approx(expected, abs=1e-8)
    at_rest = RowsInBase.of(normal, factor, units, solution)
    assert np.abs(at_rest.tested().v - expected).max() > 1e-3


@pytest.mark.parametrize("name", NETWORKS)
def test_roots_are_those_of_the_covariances_that_were_given(name):
    case = eliminated(name)
    network, units = case.solution.network, units_of(case.solution.network)
    found = RowsInBase.of(case.solution.normal(), case.factor, units)
    given = dict(network.clusters)
    sigma = case.solution.equations.sigmas()[found.every]
    for unit, rows, root in zip(units, found.rows, found.raw, strict=True):
        covariance = root @ root.T
        if unit.ids in given:
            assert covariance == pytest.approx(given[unit.ids], rel=1e-9)
        assert np.sqrt(np.diag(covariance)) == pytest.approx(sigma[rows], rel=1e-9)
