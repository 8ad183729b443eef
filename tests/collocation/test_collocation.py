"""Collocation: PyKrige's grids, the formulas written out, laws of reliability, coverage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.collocation.collocation import Collocation, collocate
from factorgraph_adj.collocation.covariance_function import (
    CORRELATION_FUNCTIONS,
    CovarianceFunction,
)
from factorgraph_adj.quality.reliability import noncentrality
from factorgraph_adj.types import Array
from tests.support.places import data_dir

KRIGING_DIGITS = 5e-6
"""The grids are printed with nine significant digits of values up to 100."""


def places(n: int, seed: int = 0, side: float = 1000.0) -> Array:
    return np.random.default_rng(seed).uniform(0.0, side, (n, 2))


def example(trend: str = "plane", seed: int = 3) -> Collocation:
    """Return a collocation of three components; one of them is not observed everywhere."""
    rng = np.random.default_rng(seed)
    where = places(25, seed)
    values = rng.normal(size=(25, 3)) + 0.01 * where[:, :1]
    values[4, 2] = values[11, 2] = np.nan
    functions = (CovarianceFunction("gaussian", 0.8, 300.0),) * 2
    height = CovarianceFunction("matern32", 1.2, 200.0)
    noise = rng.uniform(0.2, 0.6, (25, 3))
    return collocate(where, values, covariance=(*functions, height), noise=noise, trend=trend)


def read_grid(path: Path) -> tuple[Array, Array, Array]:
    """Return x and y of the columns and rows of a grid, and its values from the north."""
    head = dict(line.split()[:2] for line in path.read_text().splitlines()[:7])
    columns, rows = int(head["NCOLS"]), int(head["NROWS"])
    words = " ".join(path.read_text().splitlines()[7:]).split()
    values = np.array([float(w) for w in words[: columns * rows]]).reshape(rows, columns)
    x = float(head["XLLCENTER"]) + float(head["DX"]) * np.arange(columns, dtype=float)
    y = float(head["YLLCENTER"]) + float(head["DY"]) * np.arange(rows, dtype=float)[::-1]
    return np.asarray(x), np.asarray(y), values


@pytest.mark.published
@pytest.mark.parametrize(
    ("file", "trend"), [("test1_answer.asc", "mean"), ("test2_answer.asc", "plane")]
)
def test_grids_of_pykrige(file: str, trend: str) -> None:
    """Ordinary and universal kriging by GSLIB's KT3D, C(h) = 500 exp(−3h/3000)."""
    folder = data_dir("kriging") / "tests" / "test_data"
    data = np.loadtxt(folder / "test_data.txt")
    function = CovarianceFunction("exponential", np.sqrt(500.0), 1000.0)
    found = collocate(data[:, :2], data[:, 2], covariance=function, trend=trend)
    x, y, expected = read_grid(folder / file)
    grid = np.column_stack([c.ravel() for c in np.meshgrid(x, y)])
    predicted = found.predict(grid).values[:, 0].reshape(expected.shape)
    np.testing.assert_allclose(predicted, expected, rtol=0, atol=KRIGING_DIGITS)


def test_values_without_noise_are_met() -> None:
    where, values = places(12), np.random.default_rng(1).normal(size=12)
    function = CovarianceFunction("exponential", 1.0, 400.0)
    again = collocate(where, values, covariance=function).predict(where)
    np.testing.assert_allclose(again.values[:, 0], values, atol=1e-10)
    assert again.sigmas.max() < 1e-6


@pytest.mark.parametrize("part", ["sum", "signal", "trend"])
@pytest.mark.parametrize("trend", ["none", "mean", "plane", "similarity"])
def test_the_formulas_written_out(trend: str, part: str) -> None:
    """F16 with inverse matrices of all components at once."""
    found = example(trend)
    new = places(4, 9)
    flat = np.isfinite(found.observed).ravel()
    signal, noisy = (np.zeros((25, 3, 25, 3)) for _ in range(2))
    cross = np.zeros((4, 3, 25, 3))
    own = np.zeros((4, 3, 4, 3))
    rng = np.random.default_rng(3)
    rng.normal(size=(25, 3))
    noise = rng.uniform(0.2, 0.6, (25, 3))
    for k, f in enumerate(found.functions):
        assert f is not None
        signal[:, k, :, k] = f.between(found.places)
        noisy[:, k, :, k] = np.diag(noise[:, k] ** 2)
        cross[:, k, :, k] = f.between(new, found.places)
        own[:, k, :, k] = f.between(new)
    c, d = (m.reshape(75, 75)[np.ix_(flat, flat)] for m in (signal, noisy))
    to_new, of_new = cross.reshape(12, 75)[:, flat], own.reshape(12, 12)
    a = found.trend.design(found.places).reshape(75, -1)[flat]
    at_new = found.trend.design(new).reshape(12, -1)
    inverse = np.linalg.inv(c + d)
    q = np.linalg.inv(a.T @ inverse @ a)
    told = found.observed.ravel()[flat]
    x = q @ a.T @ inverse @ told
    p = inverse - inverse @ a @ q @ a.T @ inverse
    if part == "signal":
        at_new = np.zeros_like(at_new)
    if part == "trend":
        to_new, of_new = np.zeros_like(to_new), np.zeros_like(of_new)
    values = at_new @ x + to_new @ inverse @ (told - a @ x)
    by_trend = at_new - to_new @ inverse @ a
    errors = of_new - to_new @ inverse @ to_new.T + by_trend @ q @ by_trend.T
    predicted = found.predict(new, part=part)  # type: ignore[arg-type]
    np.testing.assert_allclose(predicted.values.ravel(), values, rtol=1e-8, atol=1e-9)
    joint = found.prediction_covariance(new, part=part)  # type: ignore[arg-type]
    np.testing.assert_allclose(joint, errors, atol=1e-9)
    np.testing.assert_allclose(predicted.sigmas.ravel() ** 2, np.diag(errors), atol=1e-9)
    np.testing.assert_allclose(found.signal.ravel()[flat], c @ p @ told, atol=1e-9)
    np.testing.assert_allclose(found.noise.ravel()[flat], d @ p @ told, atol=1e-9)
    np.testing.assert_allclose(found.redundancy_numbers.ravel()[flat], np.diag(d @ p), atol=1e-9)
    assert found.vtpv == pytest.approx(told @ p @ told)


@pytest.mark.parametrize("trend", ["none", "mean", "plane", "similarity"])
def test_redundancy_numbers_of_signal_and_noise_share_the_redundancy(trend: str) -> None:
    found = example(trend)
    total = np.nansum(found.redundancy_numbers) + np.nansum(found.signal_redundancy_numbers)
    assert total == pytest.approx(found.redundancy)
    assert found.redundancy == 73 - len(found.coefficients)


def test_an_error_left_out_is_that_of_a_collocation_without_it() -> None:
    found = example()
    values = found.observed.copy()
    values[7, 1] = np.nan
    rng = np.random.default_rng(3)
    rng.normal(size=(25, 3))
    noise = rng.uniform(0.2, 0.6, (25, 3))
    without = collocate(
        found.places, values, covariance=found.functions, noise=noise, trend="plane"
    ).predict(found.places[7:8])
    error = found.observed[7, 1] - without.values[0, 1]
    sigma = np.hypot(without.sigmas[0, 1], noise[7, 1])
    assert found.leave_one_out[7, 1] == pytest.approx(error)
    assert found.leave_one_out_sigmas[7, 1] == pytest.approx(sigma)
    assert found.test_values[7, 1] == pytest.approx(error / sigma)
    delta0 = noncentrality(0.001, 0.8)
    assert found.minimal_detectable_bias(delta0)[7, 1] == pytest.approx(delta0 * sigma)


def test_a_value_that_alone_determines_the_trend_is_not_controlled() -> None:
    where = np.array([[0.0, 0.0], [100.0, 0.0], [0.0, 100.0]])
    function = CovarianceFunction("gaussian", 1.0, 50.0)
    found = collocate(
        where, np.array([1.0, 2.0, 0.0]), covariance=function, noise=0.1, trend="plane"
    )
    assert found.redundancy == 0 and np.isnan(found.sigma0)
    assert np.isinf(found.leave_one_out_sigmas).all() and np.isnan(found.leave_one_out).all()


def test_predicted_sigmas_cover_200_draws() -> None:
    """The mean square of errors/σ at 20 places is 1; its σ over 200 draws of them is below 0.04."""
    rng = np.random.default_rng(40)
    where = places(60, 4)
    function = CovarianceFunction("matern52", 0.03, 300.0)
    root = np.linalg.cholesky(function.between(where) + 1e-12 * np.eye(60))
    ratios = []
    for _ in range(200):
        truth = root @ rng.normal(size=60) + 0.1
        told = truth[:40] + rng.normal(scale=0.01, size=40)
        found = collocate(where[:40], told, covariance=function, noise=0.01).predict(where[40:])
        ratios.append((found.values[:, 0] - truth[40:]) / found.sigmas[:, 0])
    assert np.mean(np.square(ratios)) == pytest.approx(1.0, abs=0.1)
    assert np.mean(np.abs(ratios) < 1.96) == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize("kind", CORRELATION_FUNCTIONS)
def test_covariance_functions(kind: str) -> None:
    """They are σ² at 0, fall, and are positive definite in three dimensions."""
    f = CovarianceFunction(kind, 2.0, 10.0)
    rho = np.linspace(0.0, 60.0, 200)
    assert f(0.0) == pytest.approx(4.0)
    assert (np.diff(f(rho)) <= 0).all() and f(rho[-1]) < 0.2
    where = np.random.default_rng(0).uniform(0.0, 40.0, (60, 3))
    assert np.linalg.eigvalsh(f.between(where)).min() > -1e-12
    if kind == "wendland":
        assert (f(rho[rho >= 10.0]) == 0).all()


def test_what_is_wrong_is_said() -> None:
    f = CovarianceFunction("gaussian", 1.0, 100.0)
    with pytest.raises(fga.InputError, match=r"'gausian' is unknown; valid: .*gaussian"):
        CovarianceFunction("gausian", 1.0, 1.0)
    with pytest.raises(fga.InputError, match="length must be greater than zero"):
        CovarianceFunction("gaussian", 1.0, 0.0)
    twice = np.array([[0.0, 0.0], [0.0, 0.0], [50.0, 9.0]])
    with pytest.raises(fga.InputError, match="'1' and '2' are 0 apart; state noise"):
        collocate(twice, np.zeros(3), covariance=f)
    on_line = np.column_stack([np.arange(9.0), 2.0 * np.arange(9.0)])
    with pytest.raises(
        fga.InputError, match="do not determine the 3 coefficients of the trend 'plane'"
    ):
        collocate(on_line, np.zeros(9), covariance=f, noise=0.1, trend="plane")
    with pytest.raises(fga.InputError, match="trend 'linear' is unknown"):
        collocate(places(5), np.zeros(5), covariance=f, noise=0.1, trend="linear")
    with pytest.raises(fga.InputError, match="must have 2 coordinates, not 3"):
        collocate(places(5), np.zeros(5), covariance=f, noise=0.1).predict(np.zeros((1, 3)))
    with pytest.raises(fga.InputError, match="noise must be σ"):
        collocate(places(5), np.zeros(5), covariance=f, noise=np.ones(3))
