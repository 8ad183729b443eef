"""Covariance functions from values: laws of the estimates, known truth, and no signal at all."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.collocation.collocation import collocate
from factorgraph_adj.collocation.covariance_estimation import (
    empirical_covariance,
    estimate_covariance,
    fit_variogram,
)
from factorgraph_adj.collocation.covariance_function import CovarianceFunction
from factorgraph_adj.collocation.signal_test import signal_test, upper_probability_of_form
from factorgraph_adj.types import Array

TRUE = CovarianceFunction("matern52", 0.030, 400.0)
NOISE = 0.010


def drawn(n: int, seed: int, *, function: CovarianceFunction = TRUE) -> tuple[Array, Array]:
    """Return places and values with a trend, the signal and noise."""
    rng = np.random.default_rng(seed)
    where = rng.uniform(0.0, 2000.0, (n, 2))
    root = np.linalg.cholesky(function.between(where) + NOISE**2 * np.eye(n))
    return where, root @ rng.normal(size=n) + 0.2


@pytest.mark.parametrize("kind", ["matern52", "gaussian"])
def test_square_sums_equal_their_expectations_at_the_estimates(kind: str) -> None:
    """Variance components: ŝᵀC⁻¹ŝ = r_s and n̂ᵀD⁻¹n̂ = r."""
    where, values = drawn(120, 3)
    estimate = estimate_covariance(where, values, kind=kind, trend="plane")
    found = collocate(
        where, values, covariance=estimate.function, noise=estimate.noise, trend="plane"
    )
    r = np.nansum(found.redundancy_numbers)
    assert np.sum(found.noise**2) / estimate.noise**2 == pytest.approx(r, rel=1e-4)
    assert found.vtpv == pytest.approx(found.redundancy, rel=1e-6)


def test_components_are_those_of_a_network() -> None:
    """The same two variance components by the adjustment of heights with a joint covariance."""
    where, values = drawn(50, 2)
    unit = CovarianceFunction("matern52", 0.020, 400.0)
    network = fga.Network("heights with a signal")
    names = [f"P{i}" for i in range(50)]
    for name, (x, y), z in zip(names, where, values, strict=True):
        network.add_point(name, (x, y, z), fixed="xy")
    for name, z in zip(names, values, strict=True):
        network.add(fga.ControlPoint(name, (z,), axes="z", sigma=(0.01,)))
    prior = fga.Correlated(
        tuple(fga.ControlPoint(p, (0.0,), axes="z", sigma=(1.0,)) for p in names),
        unit.between(where),
    )
    network.add(prior)
    ids = list(network.observations)
    groups = {"noise": ids[:50], "signal": ids[50:]}
    components = fga.estimate_variance_components(network, groups=groups)
    estimate = estimate_covariance(where, values, kind="matern52", trend="none", length=400.0)
    assert components["noise"].factor * 0.01 == pytest.approx(estimate.noise, rel=1e-4)
    assert components["signal"].factor * 0.02 == pytest.approx(estimate.function.sigma, rel=1e-4)


def test_truth_is_found_within_its_sigmas() -> None:
    """Of 20 draws the logarithms of σ, L and noise lie within their σ as normal errors do."""
    truth = np.log([TRUE.sigma, TRUE.length, NOISE])
    ratios = []
    for seed in range(20):
        where, values = drawn(80, 100 + seed)
        e = estimate_covariance(where, values, kind="matern52")
        found = np.log([e.function.sigma, e.function.length, e.noise])
        ratios.append((found - truth) / e.log_sigmas)
    spread = np.sqrt(np.nanmean(np.square(ratios), axis=0))
    assert (np.isfinite(ratios).mean(axis=0) > 0.9).all()
    assert (spread > 0.6).all() and (spread < 1.6).all()


def test_known_noise_is_taken_as_it_is() -> None:
    where, values = drawn(100, 5)
    e = estimate_covariance(where, values, kind="matern52", noise=NOISE)
    assert e.noise == NOISE and len(e.log_sigmas) == 2
    each = np.full(len(where), NOISE)
    of_each = estimate_covariance(where, values, kind="matern52", noise=each)
    np.testing.assert_array_equal(of_each.noise, each)
    assert of_each.headline().endswith("noise as stated")
    assert of_each.likelihood == pytest.approx(e.likelihood)
    assert abs(np.log(e.function.sigma / TRUE.sigma)) < 3 * e.log_sigmas[0]
    other = CovarianceFunction("matern52", 1.1 * e.function.sigma, e.function.length)
    assert e.likelihood > e.without_signal

    def likelihood(function: CovarianceFunction) -> float:
        """Return the restricted likelihood by determinants of the whole covariance."""
        full = function.between(where) + NOISE**2 * np.eye(100)
        one = np.ones((100, 1))
        inverse = np.linalg.inv(full)
        normal = one.T @ inverse @ one
        p = inverse - inverse @ one @ one.T @ inverse / normal
        return float(
            -0.5 * (np.linalg.slogdet(full)[1] + np.linalg.slogdet(normal)[1] + values @ p @ values)
        )

    longer = CovarianceFunction("matern52", e.function.sigma, 1.1 * e.function.length)
    assert likelihood(e.function) > max(likelihood(other), likelihood(longer))


def test_empirical_covariances_by_hand() -> None:
    """Three places on a line, residuals of the mean (−1, 0, 1)."""
    found = empirical_covariance(
        np.array([0.0, 1.0, 2.0]), np.array([1.0, 2.0, 3.0]), classes=2, max_distance=3.0
    )
    np.testing.assert_allclose(found.distances, [1.0, 2.0])
    np.testing.assert_allclose(found.pairs, [2, 1])
    np.testing.assert_allclose(found.covariances, [0.0, -1.0])
    np.testing.assert_allclose(found.semivariances, [0.5, 2.0])
    assert found.variance == pytest.approx(2.0 / 3.0)


def test_a_variogram_without_scatter_gives_its_function() -> None:
    where, values = drawn(200, 6)
    shape = empirical_covariance(where, values)
    told = NOISE**2 + TRUE.sigma**2 - TRUE(shape.distances)
    function, noise = fit_variogram(
        type(shape)(shape.distances, shape.pairs, told, told, 0.0), "matern52"
    )
    assert function.length == pytest.approx(TRUE.length, rel=0.05)
    assert function.sigma == pytest.approx(TRUE.sigma, rel=0.03)
    assert noise == pytest.approx(NOISE, rel=0.1)


def test_noise_has_no_signal_as_often_as_alpha_says() -> None:
    """1000 draws of ten values, fewer than a normal approximation is good for."""
    rng = np.random.default_rng(7)
    where = rng.uniform(size=(10, 2))
    found = sum(signal_test(where, rng.normal(size=10)).has_signal for _ in range(1000))
    assert 30 <= found <= 72  # 50 ± 3.2 σ


def test_the_unit_of_noise_does_not_matter() -> None:
    where, values = drawn(30, 1)
    noise = np.random.default_rng(2).uniform(0.5, 2.0, 30)
    one, other = (signal_test(where, values, noise=s * noise) for s in (1.0, 1e-3))
    assert one.moran == pytest.approx(other.moran) and one.expected == pytest.approx(other.expected)
    assert one.probability == pytest.approx(other.probability)


def test_a_signal_is_found() -> None:
    found = sum(signal_test(*drawn(40, seed)).has_signal for seed in range(20))
    assert found >= 18


def test_a_probability_of_quadratic_forms_in_closed_form() -> None:
    """(z₁² + z₂²) exceeds a (z₃² + z₄²) with the probability 1/(1 + a)."""
    for a in (0.1, 1.0, 7.0):
        weights = np.array([1.0, 1.0, -a, -a])
        assert upper_probability_of_form(weights) == pytest.approx(1.0 / (1.0 + a), abs=1e-7)


def test_noise_is_not_smoothed() -> None:
    rng = np.random.default_rng(11)
    where, values = rng.uniform(size=(40, 2)), rng.normal(size=40)
    with pytest.raises(fga.InputError, match="no signal that noise does not explain"):
        estimate_covariance(where, values)
    taken = estimate_covariance(where, values, alpha=1.0)
    assert taken.function.sigma < 1.5
