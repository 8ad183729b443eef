"""vᵀPv of normal errors is explained by chance; of gross errors it is not."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.solve.minimum import fits_badly

N, U = 400, 100
"""Numbers of observations and of unknowns."""


def residuals(seed: int) -> np.ndarray:
    """Return residuals of an adjustment of normal errors with a random design."""
    rng = np.random.default_rng(seed)
    q, _ = np.linalg.qr(rng.normal(size=(N, U)))
    e = rng.normal(size=N)
    return np.asarray(e - q @ (q.T @ e))


@pytest.mark.parametrize("relative", [False, True])
def test_normal_errors_are_explained_by_chance(relative: bool) -> None:
    bad = sum(fits_badly(residuals(k), None, U, relative=relative) for k in range(200))
    assert bad <= 2  # of 200; beyond four standard deviations


@pytest.mark.parametrize("unit", [0.01, 1.0, 100.0])
def test_the_size_of_relative_standard_deviations_does_not_matter(unit: float) -> None:
    v = residuals(1)
    v[::20] += 10.0
    assert fits_badly(unit * v, None, U, relative=True)
    assert not fits_badly(unit * residuals(1), None, U, relative=True)


@pytest.mark.parametrize("factor", [0.0, 1e-6, 0.1])
def test_observations_without_weight_hide_nothing_and_show_nothing(factor: float) -> None:
    light = np.arange(N) % 2 == 0
    factors = np.where(light, factor, 1.0)
    good = np.random.default_rng(1).normal(size=N)
    # Full weights fit, whatever the residuals of the others are.
    v = np.where(light, 1000.0 * np.sqrt(factor), good) * np.sqrt(0.5)
    assert not fits_badly(v, factors, U, relative=False)
    # Full weights do not fit; the small residuals of the others must not hide it.
    v = np.where(light, 0.0, 1.5 * good)
    assert fits_badly(v, factors, U, relative=False)
    assert not fits_badly(v, None, 0, relative=False)


def test_without_redundancy_nothing_is_said() -> None:
    assert not fits_badly(np.full(3, 50.0), np.array([1.0, 0.0, 0.0]), 1, relative=False)
