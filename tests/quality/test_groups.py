"""Correlated groups, effects of single errors, and which observation is to blame."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.stats import chi2, ncx2

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import GnssVector, HeightDifference, SlopeDistance
from factorgraph_adj.quality.group_tests import noncentrality_of_group
from factorgraph_adj.quality.reliability import critical_tau, noncentrality
from tests.networks.simulated import gnss, levelling
from tests.networks.small_block import small_block
from tests.support.dense import DenseReliability


def test_the_usual_noncentrality_is_4_13() -> None:
    assert noncentrality(0.001, 0.80) == pytest.approx(4.13, abs=0.005)
    assert noncentrality_of_group(0.001, 0.80, 1) == pytest.approx(noncentrality(0.001, 0.80) ** 2)


@pytest.mark.parametrize("dof", [1, 2, 3, 6])
def test_a_group_s_error_at_the_limit_is_found_with_the_power_asked_for(dof: int) -> None:
    limit = noncentrality_of_group(0.01, 0.9, dof)
    assert ncx2.sf(chi2.ppf(0.99, dof), dof, limit) == pytest.approx(0.9, abs=1e-9)


def test_critical_tau_approaches_the_normal_quantile() -> None:
    assert critical_tau(0.001, 10**7) == pytest.approx(3.2905, abs=1e-4)
    assert critical_tau(0.001, 20) < np.sqrt(20)
    assert np.isnan(critical_tau(0.001, 1))


@pytest.fixture(scope="module")
def vectors() -> fga.Solution:
    return fga.adjust(gnss())


def test_groups_are_tested_with_the_general_forms(vectors: fga.Solution) -> None:
    """T = uᵀM⁻¹u with u = Pv, M = P Q_vv P of the group; every correlated one is there."""
    rel, dense = fga.reliability(vectors), DenseReliability.of(vectors)
    names = [g.ids for g in rel.groups]
    assert ("v1",) in names and ("v2",) in names and ("v1", "v2") in names
    # Five vectors, a position, two members of a cluster, the cluster, the correlated control.
    assert len(names) == 10
    assert sum(len(g.rows) for g in rel.groups) == 5 * 3 + 3 + 3 + 3 + 6 + 3
    for g in rel.groups:
        m = dense.precision[np.ix_(g.rows, g.rows)]
        u = dense.weighted[g.rows]
        assert g.redundancy == pytest.approx(dense.redundancy_numbers[g.rows].sum(), abs=1e-8)
        assert -1e-9 <= g.redundancy <= len(g.rows) + 1e-9
        if g.dof == len(g.rows):
            assert g.test == pytest.approx(float(u @ np.linalg.solve(m, u)), rel=1e-6)
            np.testing.assert_allclose(
                g.estimated_error, -np.linalg.solve(m, u), rtol=1e-5, atol=1e-9
            )
            limit = noncentrality_of_group(0.001, 0.80, g.dof)
            assert float(g.weakest @ m @ g.weakest) == pytest.approx(limit, rel=1e-6)
            # No other error of that detectability is longer in the norm of P.
            moved = dense.effects[:, g.rows] @ g.weakest
            assert np.isfinite(g.external) and np.all(np.isfinite(moved))
        else:
            # E hangs on the cluster and one distance: most of v2 is controlled by nothing.
            assert np.isinf(g.external)
    assert any(g.dof == len(g.rows) for g in rel.groups)
    assert any(g.dof < len(g.rows) for g in rel.groups)


def test_an_error_in_a_group_comes_back_as_its_estimate() -> None:
    """v is linear in the error: ∇̂ of the group grows by exactly what was put in."""
    network = gnss()
    ident = next(i for i, o in network.observations.items() if isinstance(o, GnssVector))
    before = next(g for g in fga.reliability(fga.adjust(network)).groups if g.ids == (ident,))
    o = network.observations[ident]
    error = np.array([0.03, -0.01, 0.02])
    network.observations[ident] = GnssVector(
        o.station,
        o.target,
        tuple((np.array(o.value) + error).tolist()),
        covariance=o.covariance,  # type: ignore[attr-defined]
    )
    after = next(g for g in fga.reliability(fga.adjust(network)).groups if g.ids == (ident,))
    np.testing.assert_allclose(after.estimated_error - before.estimated_error, error, atol=1e-6)
    assert after.test > after.critical


def test_an_error_of_one_observation_moves_what_effect_on_says() -> None:
    network = small_block(3)
    solution = fga.adjust(network)
    rel = fga.reliability(solution)
    ident = next(i for i, o in network.observations.items() if isinstance(o, HeightDifference))
    o = network.observations[ident]
    error = 2e-4
    changed = small_block(3)
    changed.observations[ident] = HeightDifference(
        o.station,
        o.target,
        o.value + error,
        sigma=o.sigma,  # type: ignore[attr-defined]
    )
    moved = fga.adjust(changed)
    for name in ("P1", "P12"):
        np.testing.assert_allclose(
            rel.effect_on(ident, name, error=error),
            moved.point(name) - solution.point(name),
            atol=0.01 * error,
        )
    centre = moved.pose("F2").position - solution.pose("F2").position
    effect = rel.effect_on(ident, ("pose", "F2"), error=error)
    np.testing.assert_allclose(effect[3:], centre, atol=0.01 * error)
    both = rel.effect_on(ident, ["P1", ("pose", "F2")], error=error)
    assert [(e.kind, e.name, len(e.values)) for e in both] == [
        ("point", "P1", 3),
        ("pose", "F2", 6),
    ]
    assert np.all(rel.effect_on(ident, "S1", error=error) == 0.0)  # held


def test_effect_on_names_what_it_does_not_know() -> None:
    solution = fga.adjust(levelling())
    rel = fga.reliability(solution)
    with pytest.raises(InputError, match="unknown observation 'XY'; known: AB"):
        rel.effect_on("XY")
    with pytest.raises(InputError, match="unknown point 'Z'; known: A"):
        rel.effect_on("AB", "Z")
    with pytest.raises(InputError, match=re.escape("height_difference D E (id DE)")):
        rel.effect_on("DE")
    assert rel.effect_on("DE", "E", error=0.01)[2] == pytest.approx(0.01)
    with pytest.raises(InputError, match="row 99"):
        rel.effect_on(99)


def test_an_observation_with_several_components_asks_for_one() -> None:
    solution = fga.adjust(small_block(3))
    rel = fga.reliability(solution)
    with pytest.raises(InputError, match="components x, y"):
        rel.effect_on("F1/P3", "P3")
    assert rel.row("F1/P3", "y") == rel.row("F1/P3", "x") + 1
    assert len(rel.effect_on("F1/P3", "P3", component="x")) == 3


def test_observations_that_cannot_be_told_apart_are_named_together() -> None:
    """Two lines in a chain between held bench marks: an error of either is the same."""
    network = fga.Network("chain")
    for name, z, held in (("A", 0.0, "xyz"), ("M", 1.0, "xy"), ("B", 2.0, "xyz"), ("C", 5, "xyz")):
        network.add_point(name, (0.0, 0.0, z), fixed=held)
    network.add(
        HeightDifference("A", "M", 1.010, sigma=0.001, id="AM"),
        HeightDifference("M", "B", 1.000, sigma=0.001, id="MB"),
    )
    solution = fga.adjust(network)
    rel = fga.reliability(solution)
    assert rel.redundancy_numbers == pytest.approx([0.5, 0.5])
    first = rel.suspects(1)[0]
    assert first.value == pytest.approx(-10 / np.sqrt(2))
    assert first.inseparable == ((1 - first.row, pytest.approx(1.0)),)
    assert abs(rel.correlation([0, 1])[0, 1]) == pytest.approx(1.0)
    assert rel.suspects(5, critical=20.0) == ()


def test_pope_s_tests_stay_below_the_root_of_the_redundancy() -> None:
    rel = fga.reliability(fga.adjust(levelling("free")))
    on = rel.controlled
    assert np.all(np.abs(rel.tau[on]) <= np.sqrt(rel.solution.redundancy) + 1e-9)
    np.testing.assert_allclose(rel.tau[on], rel.w[on] / rel.solution.sigma0)


def test_an_a_posteriori_solution_scales_detectable_errors_and_not_their_tests() -> None:
    network = small_block(5)
    prior = fga.reliability(fga.adjust(network))
    posterior = fga.reliability(fga.adjust(network, variance="a-posteriori"))
    sigma0 = posterior.solution.sigma0
    on = prior.controlled
    np.testing.assert_allclose(posterior.mdb[on], sigma0 * prior.mdb[on], rtol=1e-9)
    np.testing.assert_allclose(posterior.w[on], prior.w[on], rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(posterior.delta_bar[on], prior.delta_bar[on], rtol=1e-9)


@pytest.mark.parametrize(("alpha", "power"), [(0.0, 0.8), (1.0, 0.8), (0.001, 1.0), (0.5, 0.4)])
def test_probabilities_out_of_range_are_refused(alpha: float, power: float) -> None:
    solution = fga.adjust(levelling())
    with pytest.raises(InputError, match="alpha and power"):
        fga.reliability(solution, alpha=alpha, power=power)


def test_without_redundancy_nothing_is_controlled_and_nothing_fails() -> None:
    network = fga.Network("no redundancy")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (3.0, 0.0, 0.0), fixed="yz")
    network.add(SlopeDistance("A", "B", 3.01, sigma=0.001))
    rel = fga.reliability(fga.adjust(network))
    assert rel.redundancy_numbers == pytest.approx([0.0], abs=1e-12)
    assert not rel.controlled.any() and np.isinf(rel.mdb[0]) and np.isnan(rel.w[0])
    assert np.isnan(rel.tau[0]) and rel.suspects() == ()
    assert rel.e2[0] == pytest.approx(1.0)


def test_figures_of_a_solution_that_is_not_at_rest_belong_to_where_it_stopped() -> None:
    stopped = fga.adjust(small_block(2), max_iterations=1)
    assert not stopped.converged
    ours, dense = fga.reliability(stopped), DenseReliability.of(stopped)
    np.testing.assert_allclose(ours.redundancy_numbers, dense.redundancy_numbers, atol=1e-8)
