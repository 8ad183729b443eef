"""Image points whose x and y are correlated: weights, adjustment, reliability, where they pass."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.simulation.measurement import disturb, measure
from factorgraph_adj.types import Array
from tests.networks.small_block import SIGMA_MM, plan
from tests.support.arrivals import batch, difference
from tests.support.dense import (
    assert_adjustment_of_full_matrices,
    assert_reliability_of_full_matrices,
)
from tests.support.same import assert_same_network


def correlations(n: int) -> Array:
    """Return different correlations; some are zero."""
    rho = 0.95 * np.sin(np.arange(n))
    rho[::5] = 0.0
    return np.asarray(rho)


def correlated(network: fga.Network) -> fga.Network:
    """Return the network with correlated image points of unequal σ."""
    out = network.copy()
    n = out.n_image_points
    out.images.sigma = [SIGMA_MM * np.column_stack([np.ones(n), 1.5 + np.cos(np.arange(n)) / 2])]
    out.images.rho = [correlations(n)]
    return out


@pytest.fixture(scope="module")
def network() -> fga.Network:
    """The small block, simulated with correlated errors."""
    return disturb(measure(correlated(plan()), seed=2), seed=3, points=0.02, centres=0.02)


@pytest.fixture(scope="module")
def solution(network: fga.Network) -> fga.Solution:
    """The adjusted block."""
    return fga.adjust(network)


def covariance(sigma: Array, rho: float) -> Array:
    """Return Σ from σ_x, σ_y and ρ."""
    x, y = sigma
    return np.array([[x * x, rho * x * y], [rho * x * y, y * y]])


def test_weights_are_the_inverse_of_the_covariance(network: fga.Network) -> None:
    (block,) = (b for b in compile_network(network).blocks if b.image)
    assert block.whitener is not None
    rows = block.ids.rows
    sigma, rho = network.images.columns()[3], network.images.correlation
    for i, w in zip(rows.tolist(), block.whitener, strict=True):
        np.testing.assert_allclose(
            w.T @ w, np.linalg.inv(covariance(sigma[i], rho[i])), rtol=1e-12, atol=0.0
        )


def test_only_cameras_with_correlated_coordinates_have_matrices_of_weights() -> None:
    network = measure(plan(), seed=2)
    network.add_camera("other", network.cameras["D3"].lens, {"c": 28.0})
    network.photos["F4"] = replace(network.photos["F4"], camera="other")
    of_f1 = network.images.columns()[0] == 0
    network.images.rho = [0.3 * of_f1]
    blocks = [b for b in compile_network(network).blocks if b.image]
    assert [b.whitener is not None for b in blocks] == [True, False]
    assert {i.split("/")[0] for i in blocks[1].ids} == {"F4"}


def test_the_adjustment_is_that_of_full_matrices(solution: fga.Solution) -> None:
    assert_adjustment_of_full_matrices(solution)


def test_reliability_is_that_of_full_matrices(solution: fga.Solution) -> None:
    assert_reliability_of_full_matrices(solution)


def test_a_blunder_in_correlated_coordinates_is_found(network: fga.Network) -> None:
    wrong = network.copy()
    xy = wrong.images.columns()[2].copy()
    row = int(np.argmax(wrong.images.correlation))
    xy[row, 0] += 0.08
    wrong.images = wrong.images.with_columns(xy=xy)
    photo, point, *_ = wrong.images.columns()
    name = f"{list(wrong.photos)[photo[row]]}/{list(wrong.points)[point[row]]}"
    found = fga.snoop(wrong)
    assert [r.id for r in found.rejected] == [name]


def test_the_correlation_passes_through_files_and_records(
    network: fga.Network, tmp_path: Path
) -> None:
    for y_down in (False, True):
        given = network.copy()
        given.cameras["D3"] = replace(given.cameras["D3"], y_down_in_files=y_down)
        fga.write_project(given, tmp_path / f"{y_down}")
        assert_same_network(fga.read(tmp_path / f"{y_down}" / "project.toml"), given)


def test_the_correlation_passes_through_copies(network: fga.Network) -> None:
    rho = {f"{o.photo}/{o.point}": o.correlation for o in network.image_points()}
    kept = network.copy()
    kept.image_mask(np.arange(network.n_image_points) % 3 > 0)
    for other in (kept, measure(network, seed=1), fga.without(network, ["F2/P3"])):
        found = {f"{o.photo}/{o.point}": o.correlation for o in other.image_points()}
        assert found
        assert all(rho[name] == value for name, value in found.items())


def test_late_image_points_end_at_the_batch_result(network: fga.Network) -> None:
    of_f4 = network.images.columns()[0] == network.photo_number["F4"]
    first, late = network.copy(), network.copy()
    last = np.flatnonzero(of_f4)[-4:]
    is_late = np.isin(np.arange(network.n_image_points), last)
    first.image_mask(~is_late)
    late.image_mask(is_late)
    live = fga.IncrementalAdjustment(first)
    live.add(list(late.image_points()))
    live.settle()
    assert difference(live.solution(), batch(live)).largest < 1e-6


@pytest.mark.parametrize("rho", [1.0, -1.0, 2.0, float("nan")])
def test_a_correlation_that_is_none_is_refused(network: fga.Network, rho: float) -> None:
    for refused in (
        lambda: fga.ImagePoint("F1", "P1", 0.0, 0.0, sigma=1.0, correlation=rho),
        lambda: network.copy().add_image_points(
            "F1", ["S1"], np.zeros((1, 2)), sigma=1.0, correlation=rho
        ),
    ):
        with pytest.raises(fga.InputError, match=r"F1/|F1 ") as caught:
            refused()
        assert "correlation must be " in str(caught.value)
