"""Scenes of a pushbroom scanner against an exact sensor; panoramic cameras; powers of motions."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.factor_graph.row_arrays import sort_of
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.models.scanner_lens import CylindricalLens, LineLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.text import render_text
from factorgraph_adj.rotation import exp_rotation, world_R_camera
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.types import Array
from tests.networks.pushbroom_pair import GSD, LOOK, SIGMA_PX, pair, usual_weights

CONFIDENCE = 0.999


@pytest.fixture(scope="module")
def network() -> Network:
    return pair(weights=usual_weights)


@pytest.fixture(scope="module")
def solution(network: Network) -> fga.Solution:
    return fga.adjust(network)


def test_rays_of_cameras_with_other_readouts_are_not_evaluated_together(network: Network) -> None:
    """Rows that arrive are evaluated with the lens and the readout of the first of their sort."""
    blocks = [b for b in compile_network(network).blocks if b.kind == "image"]
    assert len(blocks) == len({sort_of(b) for b in blocks}) == 2


def check_points(network: Network) -> list[str]:
    known = {getattr(o, "point", "") for o in network.observations.values()}
    return [p for p in network.points if p not in known]


def errors(solution: fga.Solution) -> Array:
    """Return the errors of the check points, (n, 3) metres."""
    network = solution.network
    at = [np.array(solution.point(p)) - network.points[p].check for p in check_points(network)]
    return np.array(at)


@pytest.mark.parametrize(("powers", "largest"), [(2, 0.02), (3, 0.002)])
def test_exact_images_give_the_ground_as_far_as_the_power_goes(powers: int, largest: float) -> None:
    """The orbit departs by 11 mm from a motion of power 2 and by 5 µm from one of power 3.

    What is left with power 3 is the oscillation in roll.
    """
    found = fga.adjust(pair(powers, weights=usual_weights, noise=None))
    assert np.abs(errors(found)).max() < largest


def test_a_uniform_motion_does_not_do_for_a_scene_of_five_seconds() -> None:
    """The satellite falls by 30 m out of its tangent: heights are wrong by metres."""
    found = fga.adjust(pair(1, weights=usual_weights, noise=None))
    assert np.sqrt(np.mean(errors(found)[:, 2] ** 2)) > 2.0


def test_measured_scenes_are_as_precise_as_rays_of_their_angle(solution: fga.Solution) -> None:
    """σ_h = σ_x √2/(2 tan 24°) for each point alone; the block adds that of its poses."""
    lower, upper = stats.chi2.ppf([0.0005, 0.9995], solution.redundancy)
    assert lower < solution.vtpv < upper
    network = solution.network
    sigma = np.mean([np.sqrt(solution.covariance(p)[2, 2]) for p in check_points(network)])
    alone = SIGMA_PX * GSD / np.cos(LOOK) ** 2 * np.sqrt(2.0) / (2.0 * np.tan(LOOK))
    assert alone < sigma < 1.6 * alone


@pytest.mark.parametrize(
    "seeds",
    [6, pytest.param(200, marks=pytest.mark.slow("200 repetitions; six show gross faults only"))],
)
def test_estimates_scatter_as_their_covariances_say(seeds: int) -> None:
    """Weighted poses and motions are observations: their start values are drawn."""
    exact = fga.adjust(pair(3, weights=usual_weights, noise=None))
    plan = pair(3, weights=usual_weights, noise=None)
    for p in plan.points:
        x, y, z = exact.point(p).tolist()
        plan.points[p] = replace(plan.points[p], coordinates=(x, y, z))
    for f in plan.photos:
        pose = exact.pose(f)
        x, y, z = pose.position.tolist()
        plan.photos[f] = replace(plan.photos[f], position=(x, y, z), rotation=pose.rotation)
        motion = plan.of_kind("photo_motion")[f]
        values = exact.unknown("photo_motion", f).values
        plan.set_unknown("photo_motion", f, values, sigma=motion.sigma)
    vtpv = squares = 0.0
    n = 0
    for seed in range(seeds):
        found = fga.adjust(measure(plan, seed=seed))
        vtpv += found.vtpv
        for f in plan.photos:
            key = ("photo_motion", f)
            e = np.subtract(found.unknown(*key).values, plan.of_kind("photo_motion")[f].values)
            q = found.variable_covariance(key, key)
            scale = np.sqrt(np.diag(q))
            e, q = e / scale, q / np.outer(scale, scale)
            squares += float(e @ np.linalg.solve(q, e))
            n += len(e)
    for total, freedom in ((vtpv, seeds * found.redundancy), (squares, n)):
        lower, upper = stats.chi2.ppf([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], freedom)
        assert lower < total < upper


def test_points_without_coordinates_are_intersected_from_the_poses_of_their_lines(
    network: Network, solution: fga.Solution
) -> None:
    lost = network.copy()
    for p in check_points(network):
        nowhere = (float("nan"),) * 3
        lost.points[p] = replace(lost.points[p], coordinates=nowhere)
    found = fga.adjust(lost)
    assert found.vtpv == pytest.approx(solution.vtpv, rel=1e-6)
    assert found.iterations <= 6


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_image_points_of_two_readouts_arrive(
    network: Network, solution: fga.Solution, engine: str
) -> None:
    late = check_points(network)[:8]
    points = [o for o in network.image_points() if o.point in late]
    first = without(network, [f"{o.photo}/{o.point}" for o in points])
    growing = fga.IncrementalAdjustment(first, engine=engine)  # type: ignore[arg-type]
    growing.add(points)
    for found in (growing.estimate, growing.solution().point):
        for p in late:
            np.testing.assert_allclose(found(p), solution.point(p), atol=2e-3)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_gross_error_in_the_image_of_a_control_point_is_found(
    network: Network, axis: str
) -> None:
    """A line number that is wrong by 8 lines is wrong by 3.6 ms, in time and in the image."""
    by_chance = {r.id for r in fga.snoop(network).rejected}
    control = next(getattr(o, "point", "") for o in list(network.observations.values())[4:])
    ident = f"ahead/{control}"
    assert ident not in by_chance
    (right,) = (o for o in network.image_points() if f"{o.photo}/{o.point}" == ident)
    spoiled = without(network, [ident])
    spoiled.add(replace(right, **{axis: getattr(right, axis) + 8.0}))
    assert {r.id for r in fga.snoop(spoiled).rejected} == {ident, *by_chance}


def test_a_plan_has_the_precision_that_the_adjustment_has() -> None:
    plan = pair(weights=usual_weights, noise=None)
    made = fga.adjust(plan)
    for f in plan.photos:
        planned, found = (s.unknown("photo_motion", f) for s in (fga.plan(plan).solution, made))
        np.testing.assert_allclose(planned.sigmas, found.sigmas, rtol=1e-3)


def test_projects_and_reports_have_all_powers(
    tmp_path: Path, network: Network, solution: fga.Solution
) -> None:
    fga.write_project(network, tmp_path / "project.toml")
    back = fga.read_project(tmp_path / "project.toml")
    assert back.of_kind("photo_motion") == network.of_kind("photo_motion")
    assert fga.adjust(back).vtpv == pytest.approx(solution.vtpv, rel=1e-6)
    text = render_text(Report(solution))
    assert "motion ahead" in text
    assert "rz_tt" in text


def test_motions_of_one_camera_go_to_the_same_power(network: Network) -> None:
    mixed = network.copy()
    mixed.cameras["line back"] = replace(mixed.cameras["line back"], per_photo=False)
    mixed.photos["back"] = replace(mixed.photos["back"], camera="line ahead")
    mixed.set_unknown("photo_motion", "back", (0.0,) * 6)
    with pytest.raises(fga.InputError, match="powers of t up to 1, and that of photo 'ahead'"):
        compile_network(mixed)
    mixed.set_unknown("photo_motion", "back", (0.0,) * 8)
    with pytest.raises(fga.InputError, match="it has 8 components"):
        compile_network(mixed)


def panorama(powers: int) -> Network:
    """Return photos of panoramic cameras that scan for two seconds from an aircraft."""
    rng = np.random.default_rng(5)
    network = Network("panoramic")
    network.add_camera(
        "camera",
        CylindricalLens(),
        {"c": 610.0},
        format=(1300.0, 115.0),
        readout=2.0,
        readout_towards="right",
    )
    points = np.column_stack([rng.uniform(-4e3, 4e3, (120, 2)), rng.uniform(0, 300, 120)])
    motion = np.array([0.0, 220.0, 1.0, 2e-3, -3e-3, 1e-3, 0.5, -0.4, 0.3, 4e-4, 2e-4, -3e-4])
    poses = []
    for f in range(4):
        at = np.array([30.0 * f, 900.0 * (f - 1.5), 3000.0])
        # The axis of the cylinder, y of the camera, is in the direction of the flight.
        poses.append((at, world_R_camera(0.15 * (-1.0) ** f, 0.02, 0.01)))
    rays = np.array([(points - at) @ turn for at, turn in poses])
    angle = np.arctan2(rays[..., 0], rays[..., 2])
    up = 610.0 * -rays[..., 1] / np.hypot(rays[..., 0], rays[..., 2])
    inside = (np.abs(610.0 * angle) < 640.0) & (np.abs(up) < 250.0)
    used = np.flatnonzero(inside.sum(axis=0) >= 2)
    for i in used.tolist():
        network.add_point(f"P{i}", points[i])
    for f, (at, turn) in enumerate(poses):
        network.add_photo(f"F{f}", "camera", position=at, rotation=turn)
        network.set_unknown("photo_motion", f"F{f}", motion[: 6 * powers] * (1 + 0.1 * f))
        names = [f"P{i}" for i in used.tolist() if inside[f, i]]
        network.add_image_points(f"F{f}", names, np.zeros((len(names), 2)), sigma=0.02)
    for p in list(network.points)[::3]:
        network.add(fga.ControlPoint(p, (0.0, 0.0, 0.0), sigma=(0.05,) * 3))
    return network


def test_panoramic_photos_find_their_motion_during_the_scan() -> None:
    plan = panorama(2)
    readings = measure(plan, seed=3)
    for f, motion in plan.of_kind("photo_motion").items():
        start = [*motion.values[:6], *(0.0,) * 6]
        readings.set_unknown("photo_motion", f, start)
    found = fga.adjust(readings)
    lower, upper = stats.chi2.ppf([0.0005, 0.9995], found.redundancy)
    assert lower < found.vtpv < upper
    for f, motion in plan.of_kind("photo_motion").items():
        each = found.unknown("photo_motion", f)
        error = np.subtract(each.values, motion.values) / np.array(each.sigmas)
        assert (np.abs(error) < 4.5).all()


def test_an_image_on_a_cylinder_is_that_of_a_line_that_turns() -> None:
    """A slit that turned about y by λ sees the point in its middle, at the height of the image."""
    lens, k = CylindricalLens(), np.array([[610.0, 0.0, 0.0]])
    rng = np.random.default_rng(1)
    p = rng.normal(size=(20, 3)) + np.array([0.0, 0.0, 1.5])
    zero = np.zeros(20)
    x, y = lens.seen((p[:, 0], p[:, 1], p[:, 2]), zero, zero, k, jacobians=False).v
    slit, line = LineLens(), np.array([[610.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]])
    for i in range(20):
        q = exp_rotation(np.array([0.0, x[i] / 610.0, 0.0])).T @ p[i]
        # The axes of the line of detectors are those of the slit turned by 90°.
        each = tuple(np.array([v]) for v in (-q[1], q[0], q[2]))
        along, across = slit.seen(each, zero[:1], zero[:1], line, jacobians=False).v  # type: ignore[arg-type]
        assert along[0] == pytest.approx(y[i], abs=1e-9)
        assert across[0] == pytest.approx(0.0, abs=1e-9)
