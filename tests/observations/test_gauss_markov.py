"""Errors of positions that are correlated in time."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import PhotoPosition, SlopeDistance, gauss_markov
from factorgraph_adj.simulation.measurement import measure
from tests.networks.every_kind import COVARIANCE
from tests.networks.small_flight import Plan, plan_of


def positions(n: int) -> list[PhotoPosition]:
    return [
        PhotoPosition(f"f{i}", (0.0, 0.0, 0.0), covariance=COVARIANCE * (1 + i)) for i in range(n)
    ]


def test_the_covariance_is_that_of_a_markov_process() -> None:
    times = np.array([0.0, 1.0, 2.5, 7.0])
    joint = np.asarray(gauss_markov(positions(4), times, correlation_time=2.0).covariance)
    for i in range(4):
        own = joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
        np.testing.assert_allclose(own, COVARIANCE * (1 + i), rtol=1e-12)
    between = joint[0:3, 6:9]
    np.testing.assert_allclose(between, np.exp(-1.25) * np.sqrt(3) * COVARIANCE, rtol=1e-12)
    # Markov: of the past only the last value matters, so that P has no elements beyond neighbours.
    inverse = np.linalg.inv(joint)
    assert np.abs(inverse[0:3, 6:12]).max() < 1e-12 * np.abs(inverse).max()


@pytest.mark.parametrize("correlation_time", [0.01, 1.0, 100.0])
def test_a_common_error_of_a_strip_is_hardly_reduced_by_its_exposures(correlation_time) -> None:
    """The weight of the mean of n equidistant positions is (n − (n − 2) ρ) / (1 + ρ) σ²."""
    n, sigma = 6, 0.05
    plain = [PhotoPosition(f"f{i}", (0.0,) * 3, sigma=(sigma,) * 3) for i in range(n)]
    joint = gauss_markov(plain, np.arange(6.0), correlation_time=correlation_time).covariance
    ones = np.tile(np.eye(3), (n, 1))
    weight = ones.T @ np.linalg.solve(joint, ones)
    rho = np.exp(-1.0 / correlation_time)
    expected = (n - (n - 2) * rho) / (1 + rho) / sigma**2
    np.testing.assert_allclose(weight, expected * np.eye(3), rtol=1e-9, atol=1e-6)


def test_a_strip_is_adjusted_with_it() -> None:
    network = plan_of(Plan(control=0, attitudes=None))
    for strip in ("0", "1"):
        own = [i for i in network.observations if i.startswith(f"GNSS {strip}")]
        chosen = [network.observations.pop(i) for i in own]
        network.add(gauss_markov(chosen, np.arange(4.0), correlation_time=100.0))
    solution = fga.adjust(measure(network, seed=1))
    assert solution.converged
    assert solution.sigma0 == pytest.approx(1.0, abs=0.3)


def test_bad_input_is_named() -> None:
    with pytest.raises(fga.InputError, match="give a time for each of 2 observations"):
        gauss_markov(positions(2), [1.0], correlation_time=1.0)
    with pytest.raises(fga.InputError, match="correlation_time must be greater than zero, not 0"):
        gauss_markov(positions(2), [1.0, 2.0], correlation_time=0.0)
    with pytest.raises(fga.InputError, match="slope_distance is no vector"):
        gauss_markov([SlopeDistance("A", "B", 1.0, sigma=1.0)], [0.0], correlation_time=1.0)
    with pytest.raises(fga.InputError, match="positive definite"):
        gauss_markov(positions(2), [1.0, 1.0], correlation_time=1.0)
    gauss_markov(positions(2), [1.0, 1.0], correlation_time=1.0, white=0.01)
