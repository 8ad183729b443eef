"""Simulated measurements have the errors that their stochastic model states."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import InputError
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import GnssVector, SlopeDistance
from factorgraph_adj.simulation import simulated_blocks
from factorgraph_adj.simulation.measurement import SimulatedNetwork, disturb, look_at, measure
from factorgraph_adj.simulation.simulated_blocks import (
    simulate_aerial_block,
    simulate_geocentric_block,
)
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.types import Array

CONFIDENCE = 0.999


def whitened_errors(simulated: SimulatedNetwork) -> dict[str, Array]:
    """Return W (true − measured) by kind of observation, with weights for the true geometry."""
    equations = compile_network(simulated.network)
    state = equations.unknowns.start()
    truth = simulated.truth
    state["point"] = np.array(list(truth.points.values()))
    state["pose"] = np.array(
        [np.concatenate([f.rotation.ravel(), f.position]) for f in truth.photos.values()]
    )
    for kind, true in (
        ("calibration", truth.cameras),
        ("vertical", truth.verticals),
        ("refraction", truth.refractions),
        ("edm", truth.distance_meters),
    ):
        for i, name in enumerate(equations.unknowns[kind].names):
            if name in true:
                state[kind][i] = true[name].values
    # Orientation unknowns have no truth of their own here: directions are left out.
    state["orientation"] = np.zeros_like(state["orientation"])
    equations = equations.weighted_at(state)
    v = equations.residuals(state)
    return {b.kind: v[b.rows] for b in equations.blocks if b.kind != "direction"}


@pytest.mark.parametrize(
    "simulated",
    [
        simulate_geocentric_block(5),
        simulate_aerial_block(5, image_points=5000, points_per_photo=500),
    ],
    ids=["geocentric", "aerial"],
)
def test_measured_values_scatter_about_the_true_ones_with_their_weights(
    simulated: SimulatedNetwork,
) -> None:
    """Squares of whitened errors are χ², for every kind of observation; 99.9 % for all at once."""
    errors = whitened_errors(simulated)
    assert len(errors) >= 3
    tail = (1 - CONFIDENCE) / 2 / len(errors)
    for kind, v in errors.items():
        low, high = stats.chi2.ppf(tail, len(v)), stats.chi2.isf(tail, len(v))
        assert low < v @ v < high, kind


def two_points(sigma: float | StandardDeviation) -> Network:
    plan = Network()
    plan.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    plan.add_point("B", (1000.0, 0.0, 0.0))
    plan.add(SlopeDistance("A", "B", 0.0, sigma=sigma))
    return plan


def test_a_part_proportional_to_the_distance_counts_with_the_true_distance() -> None:
    """1 mm + 9 ppm over 1 km makes 10 mm: 300 draws scatter so, to 99.9 %."""
    plan = two_points(StandardDeviation(constant=1e-3, ppm=9.0))
    drawn = [measure(plan, seed=s).observations["1"].value - 1000.0 for s in range(300)]
    total = float(np.sum(np.square(drawn))) / 10e-3**2
    assert stats.chi2.ppf(0.0005, 300) < total < stats.chi2.isf(0.0005, 300)


def test_correlated_components_are_drawn_with_their_covariance() -> None:
    covariance = np.array([[4.0, 1.5, 0.0], [1.5, 1.0, -0.8], [0.0, -0.8, 9.0]]) * 1e-6
    plan = two_points(1e-3)
    plan.add(GnssVector("A", "B", (0.0, 0.0, 0.0), covariance=covariance))
    z = np.array(
        [
            np.array(measure(plan, seed=s).observations["2"].value) - [1000.0, 0.0, 0.0]
            for s in range(300)
        ]
    )
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), z.T)
    scatter = whitened @ whitened.T / 300
    # Four standard errors of a variance and of a covariance of 300 normal numbers.
    assert np.all(np.abs(np.diag(scatter) - 1) < 4 * np.sqrt(2 / 300))
    assert np.all(np.abs(scatter - np.diag(np.diag(scatter))) < 4 * np.sqrt(1 / 300))


def test_weighted_unknowns_are_drawn_and_held_ones_are_not() -> None:
    plan = two_points(1e-3)
    plan.add_point("C", (5.0, 5.0, 5.0), sigma=(0.1, np.inf, np.inf), fixed="z")
    plan.set_vertical("A", xi=1e-5, sigma=2e-5)
    plan.set_refraction(value=0.13, fixed=True)
    measured = measure(plan, seed=1)
    x, y, z = measured.points["C"].coordinates
    assert x != 5.0
    assert (y, z) == (5.0, 5.0)
    assert measured.points["A"].coordinates == (0.0, 0.0, 0.0)
    assert measured.verticals["A"].values[0] != 1e-5
    assert measured.refractions[""].values == (0.13,)
    assert plan.points["C"].coordinates == (5.0, 5.0, 5.0)


def test_approximate_values_move_what_is_free_and_nothing_else() -> None:
    plan = two_points(1e-3)
    plan.add_point("C", (5.0, 5.0, 5.0), sigma=(0.1, 0.1, np.inf))
    moved = disturb(plan, seed=1, points=0.2)
    assert moved.points["A"].coordinates == (0.0, 0.0, 0.0)
    assert moved.points["C"].coordinates[:2] == (5.0, 5.0)
    assert moved.points["C"].coordinates[2] != 5.0
    assert moved.observations is plan.observations


def test_the_same_seed_measures_the_same() -> None:
    a, b, c = (simulate_geocentric_block(s).network for s in (7, 7, 8))
    assert [o.value for o in a.observations.values()] == [o.value for o in b.observations.values()]
    assert np.array_equal(a.images.columns()[2], b.images.columns()[2])
    assert not np.any(a.images.columns()[2] == c.images.columns()[2])


def test_a_camera_looks_where_it_is_told() -> None:
    rotation = look_at(np.array([0.0, 0.0, 10.0]), np.array([3.0, 4.0, 10.0]))
    assert np.allclose(rotation, [[0.8, 0.0, 0.6], [-0.6, 0.0, 0.8], [0.0, -1.0, 0.0]])


# -- aerial block ---------------------------------------------------------------------------------


def test_an_aerial_block_has_the_size_asked_for_and_its_truth_is_found() -> None:
    """About as many image points; every point with two rays; calibration within 4 σ."""
    simulated = simulate_aerial_block(3, image_points=12_000, points_per_photo=600)
    network = simulated.network
    assert network.n_image_points == pytest.approx(12_000, rel=0.1)
    assert len(network.photos) == 20
    _, point, xy, _ = network.images.columns()
    assert np.bincount(point).min() >= 2
    assert np.all(np.abs(xy) < 0.55 * np.array(simulated_blocks.AERIAL_SENSOR_MM))
    solution = adjust(network)
    assert solution.converged
    tail = (1 - CONFIDENCE) / 2
    r = solution.redundancy
    assert stats.chi2.ppf(tail, r) < solution.vtpv < stats.chi2.isf(tail, r)
    estimate = solution.calibration(simulated_blocks.AERIAL_CAMERA)
    for name, true in simulated_blocks.AERIAL_CALIBRATION.items():
        assert abs(estimate[name] - true) < 4 * estimate.sigma(name)
    for name in list(simulated.truth.points)[::500]:
        error = solution.point(name) - simulated.truth.points[name]
        assert error @ np.linalg.solve(solution.covariance(name), error) < stats.chi2.isf(1e-4, 3)


def test_a_block_too_small_for_photos_is_refused() -> None:
    with pytest.raises(InputError, match="4 photos"):
        simulate_aerial_block(0, image_points=1000, points_per_photo=500)
