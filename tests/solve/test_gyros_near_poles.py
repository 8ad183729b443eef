"""Free networks with a gyrotheodolite of unknown constant, up to the poles, against dense matrices.

Turned about its vertical, a network changes all azimuths alike, and the constant follows, but for
the convergence of meridians: D/ρ of the turn for an extent D at the distance ρ from the pole.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.frames import TopocentricFrame
from factorgraph_adj.simulation.measurement import disturb, measure
from tests.support.dense import Dense
from tests.support.inner import assert_sigmas, bordered, least_noticed
from tests.support.studies import cases

LATITUDES = (80.0, 84.0, 86.0, 89.0, 89.9, 89.999, 90.0, -86.0, -89.9, -90.0)
SIGMA = 3e-5
"""Standard deviation of an azimuth, radians."""
SIZES = (40.0, 1000.0, 20_000.0)
PER_MILLE = 1e-3


def stations(
    latitude: float,
    size: float,
    seed: int,
    *,
    geocentric: bool = False,
    at: tuple[str, ...] = tuple(f"P{i}" for i in range(6)),
    per_station: int = 1,
    coarse: float = 0.01,
    known: float | None = None,
) -> fga.Network:
    """Return six total stations that sight each other; some have azimuths of one gyrotheodolite.

    ``known`` is the standard deviation of one more azimuth without an unknown constant.
    """
    rng = np.random.default_rng([seed, 7])
    local = TopocentricFrame(np.radians(latitude), np.radians(15.0))
    network = fga.Network("near a pole", frame=local.geocentric if geocentric else local)
    network.datum = "free"
    network.set_gyro("gyro", value=0.3)
    names = [f"P{i}" for i in range(6)]
    for name in names:
        x = rng.uniform(-1, 1, 3) * [size, size, size / 10]
        network.add_point(name, local.to_geocentric(x[None])[0] if geocentric else x)
        network.set_orientation(name, value=0.3)
    for a in names:
        others = [n for n in names if n != a]
        for b in others:
            network.add(
                o.Direction(a, b, 0.0, sigma=1e-5),
                o.ZenithAngle(a, b, 1.5, sigma=1e-5),
                o.SlopeDistance(a, b, 1.0, sigma=1e-3),
            )
        for b in others[:per_station] if a in at else ():
            network.add(o.GyroAzimuth(a, b, 0.0, gyro="gyro", sigma=SIGMA))
    if known is not None:
        network.add(o.Azimuth("P0", "P3", 0.0, sigma=known))
    return disturb(measure(network, seed=seed), seed=seed, points=coarse)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("geocentric", [False, True])
@pytest.mark.parametrize("seed", cases(range(3), [0]))
def test_covariances_are_those_of_dense_inner_constraints(latitude, size, geocentric, seed):
    """With the motions of the program, and with those that a dense null space has for them."""
    solution = fga.adjust(stations(latitude, size, seed, geocentric=geocentric))
    assert solution.converged, solution.reason
    assert solution.datum_defect in (2, 3, 4)
    dense = Dense.at(solution.equations, solution.state)
    assert solution.datum is not None
    ours = solution.datum.motions[dense.free]
    assert_sigmas(solution, bordered(solution, ours), rtol=PER_MILLE)
    _, vectors = least_noticed(solution)
    theirs = vectors[:, : solution.datum_defect]
    # Vectors that are noticed a little are mixed with those that are noticed little more.
    assert_sigmas(solution, bordered(solution, theirs), rtol=5 * PER_MILLE)
    sum_r = fga.reliability(solution).redundancy_numbers.sum()
    assert sum_r == pytest.approx(solution.redundancy, abs=1e-3)


@pytest.mark.parametrize("size", SIZES)
def test_around_a_pole_a_rotation_about_it_and_a_shift_along_it_are_left(size):
    """Two singular values are zero to what rounding and curvature leave, the third is not."""
    for latitude in (90.0, -90.0, 89.999):
        solution = fga.adjust(stations(latitude, size, 1))
        values, _ = least_noticed(solution)
        assert solution.datum_defect == 2
        assert values[1] < 1e-3 * values[2]


@pytest.mark.parametrize("latitude", [80.0, 84.0, 86.0, 89.0])
def test_a_direction_that_convergence_tells_badly_stays_a_defect(latitude):
    """Standard deviations of a small network are those at middle latitudes: a degree of the pole
    does not make metres of tenths of millimetres."""
    near, far = (fga.adjust(stations(phi, 40.0, 2)) for phi in (latitude, 45.0))
    assert near.datum_defect == far.datum_defect == 4
    for name in near.network.points:
        np.testing.assert_allclose(
            near.standard_deviations(name), far.standard_deviations(name), rtol=PER_MILLE
        )


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("latitude", LATITUDES)
@pytest.mark.parametrize("size", SIZES)
def test_azimuths_of_one_station_tell_nothing_beside_their_constant(latitude, size):
    """The constant takes up the turn of the network at any distance from a pole."""
    solution = fga.adjust(stations(latitude, size, 4, at=("P2",), per_station=5))
    assert solution.converged and solution.datum_defect == 4
    _, vectors = least_noticed(solution)
    assert_sigmas(solution, bordered(solution, vectors[:, :4]), rtol=PER_MILLE)


def test_a_weak_azimuth_of_known_constant_counts_beside_strong_ones_of_unknown_constant():
    solution = fga.adjust(stations(86.0, 1000.0, 5, per_station=5, known=1e-2))
    assert solution.converged and solution.datum_defect == 3
    sigma = np.sqrt(solution.variable_covariance(("gyro", "gyro"))[0, 0])
    assert sigma < 1e-2


@pytest.mark.parametrize("latitude", [45.0, 80.0, 84.0, 86.0, 89.0])
def test_it_comes_to_rest_from_coordinates_that_are_wrong_by_a_metre(latitude):
    for seed in range(3):
        solution = fga.adjust(stations(latitude, 1000.0, seed, per_station=5, coarse=1.0))
        assert solution.converged, solution.reason
