"""What every solution owes: rest at the minimum, honest covariances, names for what is missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens, Lens
from factorgraph_adj.observations import (
    ControlPoint,
    Correlated,
    GnssVector,
    HeightDifference,
    SlopeDistance,
)
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.solve.normal_equations import NormalEquations, Solver
from tests.networks.exchanged_day import day
from tests.networks.total_station import MILLIMETRE, POINTS, total_station


def decrement(solution: fga.Solution) -> float:
    """Return √(gᵀ N⁺ g) at the solution: its distance from the minimum in units of σ."""
    normal = NormalEquations(Solver.of(solution.equations), solution.state)
    a = normal.system.times(np.eye(len(normal.gradient)))
    n = a.T @ a
    scale = 1 / np.sqrt(np.where(np.diag(n) > 0, np.diag(n), 1))
    values, vectors = np.linalg.eigh(n * np.outer(scale, scale))
    g = vectors.T @ (scale * normal.gradient)
    on = values > 1e-11
    return float(np.sqrt(np.sum(g[on] ** 2 / values[on])))


def dense_inner_constraints(solution: fga.Solution) -> np.ndarray:
    """Return the cofactors of a free network over all points from a dense bordered inverse."""
    normal = NormalEquations(Solver.of(solution.equations), solution.state)
    a = normal.system.times(np.eye(len(normal.gradient)))
    assert solution.datum is not None
    g = np.where(solution.datum.columns[:, None], solution.datum.motions, 0.0)
    d = g.shape[1]
    n = len(normal.gradient)
    bordered = np.block([[a.T @ a, g * 1e3], [g.T * 1e3, np.zeros((d, d))]])
    return np.linalg.inv(bordered)[:n, :n]


# -- free networks --------------------------------------------------------------------------------


@pytest.mark.parametrize("coarse", [0.01, 0.3, 1.0])
@pytest.mark.parametrize("verticals", [False, True])
def test_a_free_network_is_at_rest_on_its_inner_constraints(coarse: float, verticals: bool) -> None:
    network = total_station(1, coarse=coarse, verticals=verticals)
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    assert solution.datum_defect == (6 if verticals else 4)
    assert decrement(solution) < 1e-5
    v = solution.equations.residuals(solution.state)
    assert solution.vtpv == pytest.approx(v @ v, rel=1e-9)
    moved = np.array(
        [solution.point(p.name) - np.array(p.coordinates) for p in network.points.values()]
    )
    assert np.abs(moved.sum(axis=0)).max() < 1e-9
    at = np.array([solution.point(p) for p in POINTS])
    turned = np.sum(at[:, 0] * moved[:, 1] - at[:, 1] * moved[:, 0])
    assert abs(turned) < 1e-6


@pytest.mark.parametrize("verticals", [False, True])
def test_covariances_of_a_free_network_are_those_of_a_dense_inverse(verticals: bool) -> None:
    solution = fga.adjust(total_station(2, coarse=0.2, verticals=verticals))
    dense = dense_inner_constraints(solution)
    columns = {p: solution.equations.unknowns.columns("point", i) for i, p in enumerate(POINTS)}
    for a, b in (("P0", "P0"), ("P0", "P4"), ("P6", "P2")):
        expected = dense[np.ix_(columns[a], columns[b])]
        assert np.abs(solution.covariance(a, b) - expected).max() < 1e-7 * np.abs(dense).max()


def test_a_part_with_control_stays_while_a_free_part_beside_it_finds_its_datum() -> None:
    """The motions of a defect move their own part alone."""
    network = total_station(3, coarse=0.3)
    shift = np.array([500.0, 0.0, 0.0])
    held = {"Q0": (500.0, 0.0, 0.0), "Q1": (540.0, 3.0, 2.0)}
    for name, x in POINTS.items():
        other = name.replace("P", "Q")
        network.add_point(other, x + shift, fixed="xyz" if other in held else "")
    for o in list(network.observations.values()):
        network.add(
            replace(o, station=o.station.replace("P", "Q"), target=o.target.replace("P", "Q"))  # type: ignore[attr-defined]
        )
    solution = fga.adjust(network)
    assert solution.converged and solution.datum_defect == 4
    assert decrement(solution) < 1e-5
    for name, x in held.items():
        assert np.array_equal(solution.point(name), x)


def test_antenna_heights_are_no_datum_for_a_free_geocentric_network() -> None:
    rng = np.random.default_rng(4)
    network = fga.Network("vectors", frame=fga.GeocentricFrame(), datum="free")
    base = network.frame.ellipsoid.to_cartesian(  # type: ignore[union-attr]
        np.array(0.8), np.array(0.2), np.array(300.0)
    )
    for name, x in POINTS.items():
        network.add_point(name, base + x)
    names = list(POINTS)
    for a, b in [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]:
        network.add(
            GnssVector(
                a,
                b,
                tuple(POINTS[b] - POINTS[a] + MILLIMETRE * rng.normal(size=3)),
                sigma=(MILLIMETRE,) * 3,
                instrument_height=1.5,
                target_height=1.5,
            )
        )
    solution = fga.adjust(network)
    assert solution.datum_defect == 3
    assert max(solution.standard_deviations(p).max() for p in POINTS) < MILLIMETRE


# -- weights --------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [("narrow", "wide"), ("wide", "narrow")])
def test_weighted_calibrations_of_unlike_lenses_stand_side_by_side(
    order: tuple[str, str],
) -> None:
    rng = np.random.default_rng(5)
    lenses = {"narrow": Lens(), "wide": BrownLens()}
    network = fga.Network("two cameras")
    for name, x in POINTS.items():
        network.add_point(name, x, fixed="xyz")
    for camera in order:
        network.add_camera(camera, lenses[camera], {"c": 30.0}, sigma={"c": 0.1, "x0": 0.05})
        network.add_photo(camera, camera, position=(25.0, 25.0, 90.0), omega_phi_kappa=(0, 0, 0))
        d = np.array(list(POINTS.values())) - (25.0, 25.0, 90.0)
        xy = -30.0 * d[:, :2] / d[:, 2:] + 0.002 * rng.normal(size=(len(d), 2))
        network.add_image_points(camera, list(POINTS), xy, sigma=0.002)
    solution = fga.adjust(network)
    assert solution.converged
    assert solution.n_observations == 2 * (2 * len(POINTS) + 2)
    for camera in order:
        assert 0 < solution.calibration(camera).sigma("c") < 0.1


def test_the_standard_deviation_of_a_clustered_observation_is_that_of_its_cluster() -> None:
    network = fga.Network("cluster")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (100, 0, 0), fixed="yz")
    ppm = fga.StandardDeviation(0.5, ppm=1000)
    pair = (SlopeDistance("A", "B", 100.0, sigma=ppm), SlopeDistance("B", "A", 100.01, sigma=ppm))
    network.add(Correlated(pair, np.array([[1e-6, 5e-7], [5e-7, 4e-6]])))
    solution = fga.adjust(network)
    assert solution.observations.sigmas == pytest.approx([0.001, 0.002])
    weights = np.linalg.inv([[1e-6, 5e-7], [5e-7, 4e-6]])
    mean = weights.sum(axis=0) @ [100.0, 100.01] / weights.sum()
    assert solution.point("B")[0] == pytest.approx(mean, abs=1e-9)
    assert solution.covariance("B")[0, 0] == pytest.approx(1 / weights.sum(), rel=1e-9)


@pytest.mark.parametrize("prior", [1.0, 10.0, 1000.0])
def test_a_weak_datum_costs_no_accuracy(prior: float) -> None:
    """1 mm of observation against up to 1 km of datum: against the singular values of A."""
    network = total_station(6, coarse=0.01, datum="given")
    for name in ("P0", "P1", "P2"):
        network.add(ControlPoint(name, tuple(POINTS[name]), sigma=(prior,) * 3))
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    normal = NormalEquations(Solver.of(solution.equations), solution.state)
    a = normal.system.times(np.eye(len(normal.gradient)))
    inverse = np.linalg.pinv(a, rcond=1e-14)
    dense = inverse @ inverse.T
    columns = solution.equations.unknowns.columns("point", 4)
    ours, expected = solution.covariance("P4"), dense[np.ix_(columns, columns)]
    sigma = np.sqrt(np.diag(expected))
    assert np.abs((ours - expected) / np.outer(sigma, sigma)).max() < 1e-8


# -- what is missing ------------------------------------------------------------------------------


def test_missing_datum_is_named_with_what_would_help() -> None:
    with pytest.raises(
        fga.DatumError, match=r"4 defects(.|\n)*rotation about z(.|\n)*free"
    ) as error:
        fga.adjust(total_station(7, coarse=0.01, datum="given"))
    assert error.value.defect == 4


def test_an_undetermined_point_is_named_without_blaming_the_datum_of_a_free_network() -> None:
    network = total_station(8, coarse=0.01)
    network.add_point("lost", (10.0, 10.0, 0.0))
    network.add(SlopeDistance("P0", "lost", 14.14, sigma=MILLIMETRE))
    with pytest.raises(fga.DatumError, match=r"2 defects") as error:
        fga.adjust(network)
    assert error.value.names == ("lost",)
    assert "shift" not in str(error.value)


def test_two_parts_without_datum_are_told_apart() -> None:
    network = fga.Network("two lines", datum="free")
    for name in "ABCD":
        network.add_point(name, (0.0, 0.0, float(ord(name))), fixed="xy")
    network.add(
        HeightDifference("A", "B", 1.0, sigma=MILLIMETRE),
        HeightDifference("C", "D", 1.0, sigma=MILLIMETRE),
    )
    with pytest.raises(fga.DatumError, match=r"2 unconnected parts(.|\n)*A, B(.|\n)*C, D"):
        fga.adjust(network)


def test_a_large_block_without_datum_is_refused_by_its_defects_alone() -> None:
    """The search for what is missing must not need memory for the square of the unknowns."""
    block = simulate_aerial_block(seed=1, image_points=12_000)
    network = block.network
    for name, photo in network.photos.items():
        network.photos[name] = replace(
            photo, fixed=(False,) * 6, sigma_position=None, sigma_attitude=None
        )
    for name, point in network.points.items():
        network.points[name] = replace(point, fixed=(False,) * 3, sigma=None)
    for ident in list(network.observations):
        del network.observations[ident]
    with pytest.raises(fga.DatumError, match="scale") as error:
        fga.adjust(network, datum="given")
    assert error.value.defect >= 7


def test_where_there_are_no_covariances_the_end_of_the_iteration_is_reported():
    """A day with an exchange of targets, whose adjustment ends where a point is lost."""
    solution = fga.adjust(day(3).network)
    assert not solution.converged
    for asked in (solution.point_table, lambda: solution.covariance("P1")):
        with pytest.raises(fga.AdjustmentError, match=r"at the solution .* has not converged"):
            asked()
