"""Positions of GNSS: frames, antenna heights, averages whose covariance knows of correlation."""

import math
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.instruments.gnss_fixes import GnssFix, position_in_frame, position_record
from factorgraph_adj.instruments.position_averages import (
    PositionAverages,
    average_of,
    correlation_factor,
)
from factorgraph_adj.io.observation_records import observation_from_record

TENTH_MM = 1e-4
PHI, LAMBDA = math.radians(47.4), math.radians(12.0)
COVARIANCE = 1e-6 * np.array([[64.0, 20.0, 5.0], [20.0, 100.0, -10.0], [5.0, -10.0, 400.0]])
FIX = GnssFix(1.0e9, (PHI, LAMBDA, 560.0), quality="fixed", covariance=COVARIANCE)
GRID_FIX = replace(FIX, position=(500_000.0, 5_250_000.0, 560.0), grid=True)


def test_a_geodetic_position_becomes_geocentric_below_the_antenna():
    xyz = position_in_frame(FIX, GeocentricFrame(), antenna_height=2.0)
    latitude, longitude, height = ellipsoid("GRS80").to_geodetic(xyz)
    assert (latitude, longitude) == pytest.approx((PHI, LAMBDA), abs=1e-12)
    assert height == pytest.approx(558.0, abs=1e-6)


def test_a_topocentric_frame_has_its_origin():
    frame = TopocentricFrame(PHI, LAMBDA, 500.0)
    np.testing.assert_allclose(position_in_frame(FIX, frame), [0.0, 0.0, 60.0], atol=1e-6)


@pytest.mark.parametrize(("axes", "expected"), [("en", (5e5, 5.25e6)), ("ne", (5.25e6, 5e5))])
def test_a_position_in_a_grid_has_the_axes_of_a_local_frame(axes, expected):
    found = position_in_frame(GRID_FIX, LocalFrame(axes=axes), antenna_height=1.5)
    np.testing.assert_allclose(found, [*expected, 558.5])


def test_a_reference_system_leads_from_the_grid_to_the_earth_and_back():
    pytest.importorskip("pyproj")
    system = fga.ReferenceSystem("EPSG:25832", heights="ellipsoidal")
    frame = GeocentricFrame()
    xyz = position_in_frame(GRID_FIX, frame, system, antenna_height=1.5)
    latitude, longitude, height = frame.ellipsoid.to_geodetic(xyz)
    assert height == pytest.approx(558.5, abs=1e-5)
    geodetic = replace(FIX, position=(float(latitude), float(longitude), 558.5))
    local = position_in_frame(geodetic, LocalFrame(), system)
    np.testing.assert_allclose(local, [500_000.0, 5_250_000.0, 558.5], atol=TENTH_MM)


def test_the_covariance_turns_with_the_meridian_convergence():
    """Moving a position by a vector (e, n) moves its grid coordinates by the turned vector."""
    pytest.importorskip("pyproj")
    system = fga.ReferenceSystem("EPSG:25832", heights="ellipsoidal")
    record = position_record(FIX, "G", LocalFrame(), system)
    found = np.array(
        [
            [
                record[f"covariance_{min(a, b, key='enu'.index)}{max(a, b, key='enu'.index)}_mm2"]
                for b in "enu"
            ]
            for a in "enu"
        ]
    )
    m, n = ellipsoid("GRS80").radii(np.array(PHI))
    step, at = 10.0, np.array(position_in_frame(FIX, LocalFrame(), system))
    east = replace(FIX, position=(PHI, LAMBDA + step / (n * math.cos(PHI)), 560.0))
    north = replace(FIX, position=(PHI + step / m, LAMBDA, 560.0))
    turn = np.eye(3)
    for i, moved in enumerate((east, north)):
        shift = (position_in_frame(moved, LocalFrame(), system) - at)[:2]
        turn[:2, i] = shift / np.linalg.norm(shift)
    np.testing.assert_allclose(found, 1e6 * turn @ COVARIANCE @ turn.T, atol=0.01)
    assert abs(turn[1, 0]) > 0.03  # 3 degrees from the central meridian


@pytest.mark.parametrize("frame", [GeocentricFrame(), TopocentricFrame(PHI, LAMBDA, 500.0)])
def test_the_record_is_an_observation_with_its_covariance(frame):
    record = position_record(FIX, "G1", frame, antenna_height=1.2)
    o = observation_from_record(record)
    assert (o.kind, o.point, o.axes) == ("gnss_position", "G1", "enu")
    np.testing.assert_allclose(o.covariance, COVARIANCE, rtol=1e-12)
    np.testing.assert_allclose(o.value, position_in_frame(FIX, frame, antenna_height=1.2))


def test_a_network_takes_positions_and_finds_the_point():
    frame = TopocentricFrame(PHI, LAMBDA, 500.0)
    network = fga.Network("receiver", frame=frame)
    network.add_point("G1", (3.0, -2.0, 55.0))
    for shift in (-1.0, 1.0):
        moved = replace(FIX, position=(PHI, LAMBDA, 560.0 + shift))
        network.add(
            observation_from_record(position_record(moved, "G1", frame, antenna_height=2.0))
        )
    solution = fga.adjust(network)
    np.testing.assert_allclose(solution.point("G1"), [0.0, 0.0, 58.0], atol=TENTH_MM)


@pytest.mark.parametrize(
    ("fix", "frame", "message"),
    [
        (GRID_FIX, GeocentricFrame(), "reference system"),
        (FIX, LocalFrame(), "reference system"),
        (replace(FIX, covariance=None), GeocentricFrame(), "no standard deviation"),
        (replace(FIX, position=None), GeocentricFrame(), "no position"),
    ],
)
def test_what_a_record_lacks_is_told(fix, frame, message):
    with pytest.raises(InputError, match=message):
        position_record(fix, "G", frame)


# -- averages -------------------------------------------------------------------------------------


def series(rng, n, tau, covariance, interval=1.0):
    """Positions of a Gauss–Markov process of first order in a grid."""
    rho = math.exp(-interval / tau) if tau > 0 else 0.0
    root = np.linalg.cholesky(covariance)
    white = rng.standard_normal((n, 3)) @ root.T
    noise = np.empty_like(white)
    noise[0] = white[0]
    for i in range(1, n):
        noise[i] = rho * noise[i - 1] + math.sqrt(1 - rho**2) * white[i]
    return [
        GnssFix(6e6 + interval * i, tuple(1000.0 + e), True, "fixed", covariance=covariance)
        for i, e in enumerate(noise)
    ]


def test_the_factor_is_the_sum_of_all_correlations():
    rho = math.exp(-1.0 / 20.0)
    expected = sum(rho ** abs(k) for k in range(-2000, 2001))
    assert correlation_factor(1.0, 20.0) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize(("period", "tau"), [(60.0, 20.0), (10.0, 20.0), (60.0, 0.0)])
def test_a_series_of_averages_has_the_precision_that_the_network_computes(period, tau):
    """Averages as independent observations: the mean of all has χ² of its three components."""
    rng = np.random.default_rng(7)
    trials, total, statistics = 60, 1200, []
    for _ in range(trials):
        averages = PositionAverages(period, tau)
        found = [a for f in series(rng, total, tau, COVARIANCE) if (a := averages.take(f))]
        found.append(averages.rest())
        normals = [np.linalg.inv(a.fix.covariance) for a in found]
        normal = np.sum(normals, axis=0)
        off = [np.array(a.fix.position) - 1000.0 for a in found]
        mean = np.linalg.solve(
            normal, np.sum([n @ o for n, o in zip(normals, off, strict=True)], axis=0)
        )
        statistics.append(mean @ normal @ mean)
    # χ² with 3 degrees: mean 3, variance 6. Outliers at 0.1 % and the ends change it little.
    assert np.mean(statistics) == pytest.approx(3.0, abs=4 * math.sqrt(6.0 / trials))


def test_independence_would_make_an_hour_four_times_too_precise():
    rng = np.random.default_rng(8)
    spread = []
    for _ in range(60):
        fixes = series(rng, 3600, 20.0, COVARIANCE)
        spread.append(np.mean([f.position for f in fixes], axis=0)[0] - 1000.0)
    assert np.std(spread) > 4 * math.sqrt(COVARIANCE[0, 0] / 3600)


def test_an_average_weights_by_the_covariances():
    """Two positions: the weighted mean by hand."""
    other = replace(GRID_FIX, time=GRID_FIX.time + 1.0, covariance=4 * COVARIANCE)
    moved = replace(other, position=tuple(np.add(other.position, (0.010, 0.0, 0.0))))
    found = average_of([GRID_FIX, moved], 0.0)
    assert found.fix.position[0] == pytest.approx(GRID_FIX.position[0] + 0.002, abs=1e-6)
    np.testing.assert_allclose(found.fix.covariance, 0.8 * COVARIANCE, rtol=1e-9)
    assert found.fix.time == GRID_FIX.time + 0.5


def test_geodetic_positions_are_averaged_as_those_of_a_grid():
    """The covariance is along east and north, the coordinates are latitude and longitude."""
    rng = np.random.default_rng(3)
    fixes = series(rng, 50, 0.0, COVARIANCE)
    meridian = 6_378_137.0  # as the average scales; it cancels
    geodetic = [
        replace(
            f,
            grid=False,
            position=(
                PHI + (f.position[1] - 1000.0) / meridian,
                LAMBDA + (f.position[0] - 1000.0) / (meridian * math.cos(PHI)),
                f.position[2],
            ),
        )
        for f in fixes
    ]
    grid, earth = average_of(fixes, 5.0), average_of(geodetic, 5.0)
    east = (earth.fix.position[1] - LAMBDA) * meridian * math.cos(PHI)
    north = (earth.fix.position[0] - PHI) * meridian
    found = [east + 1000.0, north + 1000.0, earth.fix.position[2]]
    np.testing.assert_allclose(found, grid.fix.position, atol=1e-6)
    np.testing.assert_allclose(earth.fix.covariance, grid.fix.covariance)


def test_a_wrong_fix_of_some_seconds_is_left_out():
    rng = np.random.default_rng(4)
    fixes = series(rng, 60, 0.0, COVARIANCE)
    wrong = [replace(f, position=(f.position[0] + 0.19, *f.position[1:])) for f in fixes[20:25]]
    found = average_of([*fixes[:20], *wrong, *fixes[25:]], 0.0)
    assert (found.used, found.outliers) == (55, 5)
    assert found.fix.position[0] == pytest.approx(1000.0, abs=0.005)
    with pytest.raises(InputError, match="differ from their median"):
        many = [
            replace(f, position=(f.position[0] + 0.1 * i, *f.position[1:]))
            for i, f in enumerate(fixes)
        ]
        average_of(many, 0.0)


def test_periods_are_those_of_utc_and_every_position_is_counted():
    averages = PositionAverages(60.0, 10.0, "fixed", 5.0)
    found = []
    for i in range(200):
        quality = "float" if i % 10 == 0 else "fixed"
        age = 9.0 if i % 10 == 1 else 1.0
        at = GnssFix(6e6 + 30.0 + i, GRID_FIX.position, True, quality, 9, age, COVARIANCE)
        found += [a] if (a := averages.take(at)) else []
    assert averages.take(GnssFix(6e6 + 250.0, None)) is None
    late = GnssFix(6e6, GRID_FIX.position, True, "fixed", 9, 1.0, COVARIANCE)
    assert averages.take(late) is None
    assert [a.used for a in found] == [24, 48, 48]
    assert averages.rest().used == 40
    assert averages.rest() is None
    expected = {"quality float": 20, "old corrections": 20, "without a position": 1, "late": 1}
    assert averages.left_out == expected


def test_without_a_period_every_position_is_one():
    found = PositionAverages(0.0, 0.0).take(GRID_FIX)
    assert found.fix is GRID_FIX


def test_a_position_of_a_wrong_week_does_not_end_the_averages():
    """The receiver is wrong once; the third position that comes after it begins its period anew."""
    averages, found, said = PositionAverages(10.0, 10.0), [], []
    for i in range(40):
        at = 6e6 + i + (7 * 86400.0 if i == 15 else 0.0)
        try:
            average = averages.take(replace(GRID_FIX, time=at))
        except InputError as error:
            said.append(str(error))
            continue
        found += [] if average is None else [(average.fix.time, average.used)]
    # Of 10 to 19 there are five before the wrong one, and two of 18 to 19 after three others.
    assert found == [(6e6 + 4.5, 10), (6e6 + 12.0, 5), (6e6 + 18.5, 2), (6e6 + 24.5, 10)]
    assert said == [
        "1 positions are left out: their times were ahead of the 3 that came after them"
    ]
    assert averages.left_out == {"late": 2, "ahead": 1}


def test_positions_of_two_sorts_are_refused():
    with pytest.raises(InputError, match="one period"):
        average_of([FIX, GRID_FIX], 0.0)
    with pytest.raises(InputError, match="not positive definite"):
        average_of([replace(FIX, covariance=-COVARIANCE)], 0.0)


def test_positions_of_one_time_count_as_one():
    once = [replace(FIX, time=FIX.time + i) for i in range(60)]
    expected, found = average_of(once, 100.0).fix, average_of([*once, *once], 100.0).fix
    assert found.covariance == pytest.approx(expected.covariance, rel=1e-12)
    pair = average_of([FIX, FIX], 0.0, interval=60.0).fix
    assert pair.covariance == pytest.approx(FIX.covariance, rel=1e-12)


def test_positions_on_both_sides_of_the_180th_meridian_are_neighbours():
    near = 1e-9
    sides = [
        replace(FIX, time=FIX.time + i, position=(PHI, side * (math.pi - near), 560.0))
        for i, side in enumerate((1.0, -1.0, -1.0))
    ]
    latitude, longitude, height = average_of(sides, 0.0).fix.position
    assert (latitude, height) == pytest.approx((PHI, 560.0), abs=1e-12)
    assert longitude == pytest.approx(-(math.pi - near / 3.0), abs=1e-14)
