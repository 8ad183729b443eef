"""Equivalent weights, and robust starts where gross errors mask one another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import HeightDifference
from factorgraph_adj.quality.reliability import reliability
from factorgraph_adj.quality.robust_estimation import (
    ESTIMATORS,
    MIN_ROBUST_WEIGHT,
    equivalent_weights,
    robust_adjust,
)
from factorgraph_adj.quality.snooping import snoop
from factorgraph_adj.simulation.simulated_blocks import simulate_geocentric_block
from tests.networks.small_block import small_block
from tests.networks.trilateration import SIGMA, trilateration
from tests.support.dense import Dense

LONG = pytest.mark.slow("robust estimates to their last digit; short tests take small networks")

# -- weights ----------------------------------------------------------------------------------


def test_equivalent_weights_are_bifactor_ones():
    """P' = √D P √D over every row: alone, within a vector, within a group of vectors."""
    equations = compile_network(simulate_geocentric_block(2).network)
    state = equations.unknowns.start()
    state["orientation"] = np.zeros_like(state["orientation"])
    gamma = np.random.default_rng(1).uniform(0.1, 1.0, equations.n_rows)

    def weights(of):
        """Return P from the whitened identity, dense."""
        root = np.diag(1.0 / of.sigmas())
        for block in of.blocks:
            if block.whitener is not None:
                for i, own in enumerate(block.whitener):
                    rows = block.first_row + block.dimension * i + np.arange(block.dimension)
                    root[np.ix_(rows, rows)] = own
        for cluster in of.clusters:
            root[np.ix_(cluster.rows, cluster.rows)] = cluster.whitener
        return root.T @ root

    p = weights(equations)
    assert np.count_nonzero(p) > equations.n_rows  # some are correlated
    lighter = equations.reweighted(gamma)
    expected = np.sqrt(gamma)[:, None] * p * np.sqrt(gamma)
    np.testing.assert_allclose(weights(lighter), expected, rtol=1e-12, atol=1e-12 * p.max())
    assert lighter.sigmas() == pytest.approx(equations.sigmas() / np.sqrt(gamma))
    v = equations.residuals(state, whitened=False)
    assert np.sum(lighter.residuals(state) ** 2) == pytest.approx(v @ expected @ v)


def test_a_reweighted_adjustment_is_that_of_other_standard_deviations():
    network = small_block(6)
    rng = np.random.default_rng(3)
    first = adjust(network)
    gamma = rng.uniform(0.1, 1.0, first.equations.n_rows)
    s = adjust(network, start=first, weights=gamma)
    # Standard deviations of several parts are evaluated before: those of the adjustment itself.
    other = network.copy()
    sigma = dict(zip(s.observations.ids, s.observations.sigmas.tolist(), strict=True))
    for i, o in network.observations.items():
        other.observations[i] = replace(o, sigma=sigma[i])
    rows = dict(zip(s.observations.ids, range(len(gamma)), strict=True))
    names = [f"{o.photo}/{o.point}" for o in network.image_points()]
    last = np.array([rows[n] for n in names])  # its y
    other.images.sigma = [s.observations.sigmas[np.stack([last - 1, last], axis=1)]]
    for name, point in network.points.items():
        if point.sigma is not None:
            axes = [sigma.get(f"point {name} {axis}", np.inf) for axis in "xyz"]
            other.points[name] = replace(point, sigma=tuple(axes))
    camera = network.cameras["D3"]
    weighted = [sigma.get(f"calibration D3 {n}", np.inf) for n in camera.lens.names]
    other.cameras["D3"] = replace(camera, sigma=tuple(weighted))
    expected = adjust(other, start=first)
    assert s.vtpv == pytest.approx(expected.vtpv, rel=1e-9)
    for name in network.points:
        assert s.point(name) == pytest.approx(expected.point(name), abs=1e-8)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.nan, np.inf])
def test_weights_must_be_positive_numbers(bad):
    network = small_block(6)
    gamma = np.ones(compile_network(network).n_rows)
    gamma[3] = bad
    with pytest.raises(InputError, match=r"zenith_angle|direction|distance"):
        adjust(network, weights=gamma)
    with pytest.raises(InputError, match="factors of weights"):
        adjust(network, weights=gamma[1:])


@pytest.mark.parametrize(
    ("estimator", "expected"),
    [
        ("huber", [1.0, 1.0, 0.75, 0.15]),
        ("danish", [1.0, 1.0, 1.0, np.exp(-24.0)]),
        ("igg3", [1.0, 1.0, 0.75 * (4.0 / 4.5) ** 2, 0.0]),
        ("tukey", [1.0, (1 - (1.5 / 4.685) ** 2) ** 2, (1 - (2 / 4.685) ** 2) ** 2, 0.0]),
    ],
)
def test_weight_functions_have_their_published_form(estimator, expected):
    t = np.array([0.0, 1.5, 2.0, 10.0])
    assert equivalent_weights(estimator, t) == pytest.approx(expected)
    assert equivalent_weights(estimator, -t) == pytest.approx(expected)
    # None rises, and none jumps.
    fine = equivalent_weights(estimator, np.linspace(0.0, 12.0, 12001))
    assert np.all(np.diff(fine) <= 0)
    assert np.abs(np.diff(fine)).max() < 2e-3


# -- estimation -------------------------------------------------------------------------------


def repeated_heights(heights: list[float]) -> Network:
    network = Network()
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (5.0, 0.0, 0.0), fixed="xy")
    for h in heights:
        network.add(HeightDifference("A", "B", h, sigma=0.001))
    return network


def test_hubers_estimate_of_a_height_solves_its_equation():
    """Nine readings, two of them wrong: Σ ψ(v) = 0 with ψ = v up to 1.5 σ√r and constant beyond."""
    heights = [1.0, 1.0004, 0.9993, 1.0011, 0.9998, 1.0002, 0.9989, 1.05, 1.09]
    found = robust_adjust(repeated_heights(heights), tolerance=1e-6)
    assert found.converged, found.reason
    v = found.solution.point("B")[2] - np.array(heights)
    psi = np.clip(v, -1.5e-3 * np.sqrt(8 / 9), 1.5e-3 * np.sqrt(8 / 9))
    assert abs(psi.sum()) < 1e-3 * 0.001
    assert found.test_values == pytest.approx(v / (1e-3 * np.sqrt(8 / 9)), rel=1e-4, abs=1e-3)
    assert abs(found.solution.point("B")[2] - 1.0) < 1e-3 < abs(np.mean(heights) - 1.0)


@pytest.mark.parametrize("estimator", [e for e in ESTIMATORS if e != "huber"])
def test_gross_errors_lose_all_their_influence_on_the_others(estimator):
    """10 or 10 000 times larger, they move the height by no more than a hundredth of its σ."""
    good = [1.0, 1.0004, 0.9993, 1.0011, 0.9998, 1.0002, 0.9989]
    found = [
        robust_adjust(repeated_heights([*good, 1.05, 1.0 + e]), estimator=estimator)
        for e in (0.5, 50)
    ]
    a, b = (f.solution.point("B")[2] for f in found)
    assert abs(a - b) < 0.01 * 0.001
    assert all(np.all(f.weights[-2:] <= 2 * MIN_ROBUST_WEIGHT) for f in found)


@LONG
def test_the_weights_at_rest_are_those_of_the_residuals():
    network, _ = trilateration(1, share=0.15)
    for estimator in ESTIMATORS:
        found = robust_adjust(network, estimator=estimator, tolerance=1e-4, max_iterations=200)
        assert found.converged, found.reason
        s = found.solution
        expected = np.maximum(
            equivalent_weights(estimator, found.test_values / found.scale), MIN_ROBUST_WEIGHT
        )
        assert found.weights == pytest.approx(expected, abs=1e-3)
        r = reliability(adjust(network)).redundancy_numbers
        t = s.observations.residuals / (SIGMA * np.sqrt(r))
        assert found.test_values == pytest.approx(t, rel=0.01, abs=0.01)
        assert s.equations.sigmas() == pytest.approx(SIGMA / np.sqrt(found.weights))
        dense = Dense.at(s.equations, s.state)
        gradient = dense.design.T @ dense.residual
        assert np.abs(gradient / np.linalg.norm(dense.design, axis=0)).max() < 1e-2


@pytest.mark.slow(
    "the figure is compared with dense algebra or repeated simulation; short tests take "
    "its laws in small networks"
)
def test_all_components_of_an_observation_share_a_weight():
    network = simulate_geocentric_block(4).network
    found = robust_adjust(network)
    number = found.solution.equations.observation_of_row
    for gamma in np.split(found.weights, np.flatnonzero(np.diff(number)) + 1):
        assert len(set(gamma.tolist())) == 1
    assert len(set(found.weights.tolist())) > 50


@LONG
def test_the_scale_is_found_where_standard_deviations_are_not_known():
    """All σ are stated three times too large or too small, a fifth of the distances is wrong.

    The median of all |t| then is the quantile 0.5/0.8 of the right ones: 1.3 times too large, with
    105 distances give or take a fifth.
    """
    for factor in (1 / 3, 3.0):
        network, bad = trilateration(1, share=0.2, noise=factor)
        found = robust_adjust(network, estimator="tukey", scale="median")
        assert 1.0 < found.scale / factor < 1.6
        rejected = {r.id for r in snoop(network, test="pope", robust="tukey").rejected}
        assert bad <= rejected
        assert len(rejected - bad) <= 1


def test_an_estimation_that_does_not_come_to_rest_says_so():
    network, _ = trilateration(1, share=0.2)
    found = robust_adjust(network, max_iterations=2)
    assert not found.converged
    assert "stopped after 2 adjustments" in found.reason
    steps: list[tuple[int, float, float]] = []
    robust_adjust(network, progress=lambda *step: steps.append(step))
    assert [s[0] for s in steps] == list(range(1, len(steps) + 1))
    assert steps[-1][2] < 0.01


@pytest.mark.parametrize(
    ("options", "what"),
    [
        ({"estimator": "hampel"}, "unknown estimator 'hampel'; valid: huber, danish, igg3, tukey"),
        ({"scale": "mad"}, "unknown scale 'mad'; valid: a-priori, median"),
    ],
)
def test_unknown_choices_are_refused(options, what):
    with pytest.raises(InputError, match=what):
        robust_adjust(repeated_heights([1.0, 2.0]), **options)


# -- before snooping ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def masked() -> tuple[Network, frozenset[str]]:
    """A quarter of the distances of a network are wrong, and all too long."""
    return trilateration(2, share=0.25)


@pytest.mark.parametrize("share", [0.4, 1.0])
def test_where_gross_errors_mask_one_another_snooping_alone_takes_good_ones(masked, share):
    network, bad = masked
    rejected = {r.id for r in snoop(network, share=share).rejected}
    assert len(rejected - bad) > 5
    assert bad - rejected


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_after_a_robust_start_it_finds_them_all_and_no_other(masked, estimator):
    network, bad = masked
    found = snoop(network, robust=estimator)
    assert {r.id for r in found.rejected} == bad
    assert found.rounds[0].number == 0
    assert found.rounds[0].set_aside == len(bad) + len(found.readmitted) - sum(
        r.round > 0 for r in found.rejected
    )
    # Clean: the solution is that of the network without the wrong distances.
    clean = network.copy()
    for ident in bad:
        del clean.observations[ident]
    expected = adjust(clean)
    assert found.solution.vtpv == pytest.approx(expected.vtpv, rel=1e-6)
    for name in network.points:
        assert found.solution.point(name) == pytest.approx(expected.point(name), abs=1e-7)
