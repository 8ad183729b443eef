"""Moving points and radar: independent solutions, frames, datum, blunders, arrivals, files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.observations.point_motions import moved_point, radar_squint
from factorgraph_adj.simulation.measurement import disturb, measure
from tests.networks.moving_targets import (
    CONTROL,
    GRAVITY,
    MUZZLE,
    POINTS,
    STRIPS,
    VELOCITY,
    missile,
    radar,
)
from tests.support.arrivals import bare, batch, difference, items
from tests.support.scatter import (
    assert_estimates_scatter_as_their_covariance_says,
    assert_the_variance_of_unit_weight_follows_its_distribution,
    few,
)

PLANS = {"missile": missile, "radar": radar}


def test_positions_at_times_are_a_regression() -> None:
    """Velocity and place of positions with equal weights, by numpy's polynomials."""
    rng = np.random.default_rng(1)
    times = np.linspace(-3.0, 5.0, 9)
    seen = np.array([4.0, 2.0, 9.0]) + times[:, None] * [3.0, -2.0, 1.0] + rng.normal(size=(9, 3))
    network = fga.Network()
    network.add_point("ship", (0.0, 0.0, 0.0))
    network.set_unknown("point_motion", "course", fixed=("x_tt", "y_tt", "z_tt"))
    for t, at in zip(times.tolist(), seen.tolist(), strict=True):
        network.add_point(f"{t}", at)
        network.add(o.GnssPosition(f"{t}", tuple(at), sigma=(1.0, 1.0, 1.0)))
        network.add(o.MovedPoint("ship", f"{t}", sigma=(1e-5,) * 3, motion="course", time=t))
    solution = fga.adjust(network)
    slope, start = np.polyfit(times, seen, 1)
    found = solution.unknown("point_motion", "course")
    np.testing.assert_allclose(found.values[:3], slope, atol=1e-8)
    np.testing.assert_allclose(solution.point("ship"), start, atol=1e-8)
    sigma = 1.0 / np.sqrt(np.sum((times - times.mean()) ** 2))
    np.testing.assert_allclose(found.sigmas[:3], sigma, rtol=1e-6)


def test_target_in_free_fall_is_found_from_rough_places() -> None:
    network = disturb(measure(missile(), seed=3), seed=3, points=50.0)
    solution = fga.adjust(network)
    found = solution.unknown("point_motion", "flight")
    assert np.all(np.abs(found.values[:3] - VELOCITY) < 4.0 * found.sigmas[:3])
    muzzle = np.abs(solution.point("muzzle") - MUZZLE) / solution.standard_deviations("muzzle")
    assert muzzle.max() < 4.0
    # Without its gravity the trajectory does not fit.
    straight = network.copy()
    for ident, x in list(straight.observations.items()):
        if isinstance(x, o.MovedPoint):
            straight.observations[ident] = replace(x, gravity=0.0)
    assert fga.adjust(straight).sigma0 > 100.0 * solution.sigma0


def test_an_unknown_gravity_is_an_acceleration() -> None:
    network = measure(missile(), seed=3)
    del network.parameters["point_motion"]["flight"]
    network.set_unknown("point_motion", "flight", (*VELOCITY, 0, 0, 0))
    for ident, x in list(network.observations.items()):
        if isinstance(x, o.MovedPoint):
            network.observations[ident] = replace(x, gravity=0.0)
    found = fga.adjust(network).unknown("point_motion", "flight")
    assert abs(found.values[5] + 0.5 * GRAVITY) < 4.0 * found.sigmas[5] < 0.05


@pytest.mark.parametrize("kind", ["geocentric", "topocentric"])
def test_gravity_points_down_in_every_frame(kind: str) -> None:
    topocentric = TopocentricFrame(0.8, 0.2, 100.0)
    at = np.array([[30.0, 20.0, 10.0]])
    frame, place, down = topocentric, at, np.array([0.0, 0.0, -1.0])
    if kind == "geocentric":
        frame, place = GeocentricFrame(), topocentric.to_geocentric(at)
        down = down @ topocentric.axes_in_geocentric
    given = {"time": np.array([2.0]), "gravity": np.array([10.0]), "observed": np.zeros((1, 3))}
    v = moved_point(frame, place, place, np.zeros((1, 6)), **given).residual[0]
    # The point has fallen by 20 m; the vertical at it is 6 µrad from that of the origin.
    np.testing.assert_allclose(v, -20.0 * down, atol=2e-4)


def test_squint_is_that_of_the_doppler_frequency() -> None:
    """f = −2/λ · dr/dt = 2 |V| sin(squint)/λ, by differences of the range."""
    sensor, target = np.array([[0.0, 0.0, 3000.0]]), np.array([[2500.0, 900.0, 100.0]])
    motion, time = np.array([[8.0, 100.0, 1.0, 0.3, -0.2, 0.1]]), np.array([4.0])

    def place(t: float) -> np.ndarray:
        return sensor[0] + t * motion[0, :3] + t * t * motion[0, 3:]

    h = 1e-4
    there, here = (np.linalg.norm(target[0] - place(4.0 + s * h)) for s in (1.0, -1.0))
    rate = (there - here) / (2.0 * h)
    squint = radar_squint(LocalFrame(), sensor, target, motion, observed=0.0, time=time).residual
    speed = np.linalg.norm(motion[0, :3] + 8.0 * motion[0, 3:])
    np.testing.assert_allclose(speed * np.sin(squint[0, 0]), -rate, rtol=1e-7)


def test_strips_from_both_sides_give_terrain_and_tracks() -> None:
    plan = radar()
    network = disturb(measure(plan, seed=2), seed=2, points=40.0)
    for name, (_, velocity) in STRIPS.items():
        rough = np.array(velocity) + np.array([2.0, -3.0, 1.0])
        del network.parameters["point_motion"][name]
        network.set_unknown("point_motion", name, (*rough, 0, 0, 0), fixed=("x_tt", "y_tt", "z_tt"))
    solution = fga.adjust(network)
    for i in range(CONTROL, POINTS):
        error = solution.point(f"P{i}") - plan.points[f"P{i}"].coordinates
        assert np.all(np.abs(error) < 4.5 * solution.standard_deviations(f"P{i}"))
    for name, (_, velocity) in STRIPS.items():
        found = solution.unknown("point_motion", name)
        assert np.all(np.abs(found.values[:3] - velocity) < 4.0 * found.sigmas[:3])


def test_ranges_and_squints_know_no_place_and_no_direction() -> None:
    network = measure(radar(), seed=1)
    network.datum = "free"
    for p in list(network.points.values()):
        network.points[p.name] = replace(p, fixed=(False,) * 3)
    assert fga.adjust(network).datum_defect == 6


@pytest.mark.parametrize(
    ("name", "kind", "error"), [("missile", "azimuth", 0.002), ("radar", "radar_squint", 0.003)]
)
def test_blunder_is_found(name: str, kind: str, error: float) -> None:
    network = measure(PLANS[name](), seed=5)
    ident, x = next((i, x) for i, x in network.observations.items() if x.kind == kind)
    network.observations[ident] = replace(x, value=x.value + error)
    assert [r.id for r in fga.snoop(network).rejected] == [ident]


@pytest.mark.parametrize("name", PLANS)
def test_arrivals_in_any_order_end_at_the_adjustment_of_all(name: str) -> None:
    network = measure(PLANS[name](), seed=6)
    every = items(network)
    inc = fga.IncrementalAdjustment(bare(network), policy="accept")
    for some in np.array_split(np.random.default_rng(6).permutation(len(every)), 10):
        inc.add([every[i] for i in some])
    inc.settle()
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-5


@pytest.mark.parametrize("name", PLANS)
def test_project_comes_back_and_plans(tmp_path, name: str) -> None:
    network = measure(PLANS[name](), seed=7)
    fga.write_project(network, tmp_path / "project.toml")
    again = fga.read_project(tmp_path / "project.toml")
    ours = fga.adjust(network)
    np.testing.assert_allclose(fga.adjust(again).vtpv, ours.vtpv, rtol=1e-9)
    point = next(p.name for p in network.points.values() if not any(p.fixed))
    planned = fga.plan(again).solution.standard_deviations(point)
    np.testing.assert_allclose(planned, ours.standard_deviations(point), rtol=0.05)


@pytest.mark.parametrize("name", ["moved_point", "radar_range"])
def test_estimates_scatter_as_their_covariance_says(name: str) -> None:
    assert_estimates_scatter_as_their_covariance_says(few(name))
    assert_the_variance_of_unit_weight_follows_its_distribution(few(name))


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(fga.InputError, match="cannot join a point to itself"):
        o.MovedPoint("A", "A", sigma=(1.0,) * 3, motion="m", time=1.0)
    network = fga.Network()
    network.add_point("A", (0, 0, 0))
    network.add_point("B", (1, 0, 0))
    with pytest.raises(fga.InputError, match="motion of moving point"):
        network.add(o.RadarRange("A", "B", 1.0, sigma=1.0, motion="m", time=0.0))
    network.set_unknown("point_motion", "m", (0.0,) * 6, fixed=True)
    network.add(o.RadarSquint("A", "B", 0.0, sigma=1.0, motion="m", time=0.0))
    with pytest.raises(fga.InputError, match="stands still"):
        fga.adjust(network)
