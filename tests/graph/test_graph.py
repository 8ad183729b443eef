"""The GTSAM graph of a network: same errors and partials as the equations and GTSAM's own."""

from __future__ import annotations

import gc
from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.errors import AdjustmentError, InputError
from factorgraph_adj.factor_graph.network_graph import Graph, build_graph
from factorgraph_adj.graph import factors
from factorgraph_adj.graph.equations import Equations, compile_network
from factorgraph_adj.graph.keys import KeyMap, from_gtsam, state_of, values_of
from factorgraph_adj.graph.user_factors import linearise_extra, name_of
from factorgraph_adj.models.lens import BrownLens, NoDistortion, NormalisedLens
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Azimuth,
    ControlPoint,
    Correlated,
    Direction,
    GnssVector,
    PhotoPosition,
    SlopeDistance,
    VerticalAngle,
)
from factorgraph_adj.rotation import world_R_camera
from factorgraph_adj.types import Array
from tests.networks import every_kind
from tests.networks.every_kind import FRAMES, GEOMETRIES, LENSES_USED, VIEWS
from tests.support.differences import whitened_system
from tests.support.graphs import normal_equations

LONG = pytest.mark.slow("memory of graphs that were made and freed; short tests make them")

ROUNDING = 1e-9
"""Relative: coordinates of 6·10⁶ m, divided by lengths of 100 m."""


def assert_graph_is_the_equations(equations: Equations) -> None:
    built = build_graph(equations)
    state = state_of(equations, built.values)
    a, v = whitened_system(built.equations, state)
    a = a * equations.unknowns.free
    assert built.error == pytest.approx(0.5 * float(v @ v), rel=ROUNDING)
    n, g = normal_equations(built)
    scale = np.sqrt(np.where(np.diag(a.T @ a) > 0, np.diag(a.T @ a), 1.0))
    size = max(1.0, float(np.linalg.norm(v)))
    np.testing.assert_allclose(
        n / np.outer(scale, scale), a.T @ a / np.outer(scale, scale), atol=ROUNDING
    )
    np.testing.assert_allclose(g / scale / size, a.T @ v / scale / size, atol=ROUNDING)


@pytest.mark.parametrize("frame", FRAMES)
def test_graph_of_terrestrial_observations_is_the_equations(frame: str) -> None:
    assert_graph_is_the_equations(every_kind.sight_equations(frame, GEOMETRIES["ordinary"])[0])


@pytest.mark.parametrize("lens", LENSES_USED)
def test_graph_of_image_coordinates_is_the_equations(lens: str) -> None:
    assert_graph_is_the_equations(every_kind.image_equations(lens, VIEWS["ordinary"])[0])


def mixed_network() -> Network:
    """Two photos of four points, distances, a correlated pair, everything weighted or held once."""
    network = Network("mixed")
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (10.0, 0.5, 0.2), fixed="z")
    network.add_point("C", (9.0, 8.0, 1.0), sigma=(0.01, 0.02, np.inf))
    network.add_point("D", (1.0, 7.0, -0.5))
    network.add_camera("small", NoDistortion(), {"c": 50.0})
    values = {"c": 28.0, "k1": 1e-4}
    network.add_camera("big", BrownLens(), values, free=["c"], sigma={"k1": 1e-5})
    for name, camera, x in (("f1", "small", 2.0), ("f2", "big", 8.0), ("f3", "big", 5.0)):
        network.add_photo(
            name,
            camera,
            position=(x, 4.0, 15.0),
            omega_phi_kappa=(0.1, 0.02 * x, 0.3),
            fixed=(False, False, False, False, True, False) if name == "f2" else False,
            sigma_attitude=0.02 if name == "f1" else None,
        )
        network.add_image_points(name, list("ABCD"), np.full((4, 2), 0.3), sigma=(0.004, 0.005))
    network.add(
        SlopeDistance("A", "B", 10.02, sigma=0.003), SlopeDistance("B", "C", 7.6, sigma=0.01)
    )
    correlated = (GnssVector("A", "C", (9.01, 8.0, 1.0), sigma=(1.0, 1.0, 1.0)),)
    covariance = np.diag([1e-4, 2e-4, 3e-4, 4e-4]) + 5e-5
    network.add(Correlated((*correlated, SlopeDistance("A", "D", 7.1, sigma=0.01)), covariance))
    return network


def test_graph_of_a_mixed_network_is_the_equations() -> None:
    assert_graph_is_the_equations(compile_network(mixed_network()))


def test_names_and_keys_map_both_ways() -> None:
    keys = build_graph(mixed_network()).keys
    assert keys.key("point", "C") == gtsam.symbol("p", 2)
    assert keys.name(gtsam.symbol("p", 2)) == "C"
    assert keys.kind(gtsam.symbol("c", 1)) == "pose"
    assert keys.name(keys.key("calibration", "big")) == "big"
    with pytest.raises(InputError, match="unknown point 'X'; known: A, B, C, D"):
        keys.key("point", "X")
    with pytest.raises(InputError, match="point 'A': is held altogether"):
        keys.key("point", "A")
    with pytest.raises(InputError, match=r"key x3 belongs to no variable .*p point, c pose"):
        keys.name(gtsam.symbol("x", 3))


def test_only_variables_with_a_free_component_have_a_key() -> None:
    built = build_graph(mixed_network())
    named = {gtsam.DefaultKeyFormatter(k) for k in built.values.keys()}  # noqa: SIM118
    assert named == {"p1", "p2", "p3", "c0", "c1", "c2", "k1"}
    assert len(built.keys) == len(named)
    assert {gtsam.DefaultKeyFormatter(k) for k in built.graph.keyVector()} == named


def test_states_survive_the_way_through_gtsam_values() -> None:
    equations = compile_network(mixed_network())
    state = equations.unknowns.start()
    back = state_of(equations, values_of(equations, state))
    for kind in state:
        np.testing.assert_allclose(back[kind], state[kind], atol=1e-15)


def test_missing_values_are_all_named() -> None:
    equations = compile_network(mixed_network())
    values = values_of(equations, equations.unknowns.start())
    values.erase(gtsam.symbol("p", 2))
    values.erase(gtsam.symbol("c", 0))
    with pytest.raises(InputError) as caught:
        state_of(equations, values)
    assert str(caught.value) == "point 'C': has no value\npose 'f1': has no value"


def test_a_correlated_group_is_one_factor_over_all_its_variables() -> None:
    built = build_graph(mixed_network())
    groups = [
        f
        for f in map(built.graph.at, range(built.graph.size()))
        if f.noiseModel().dim() == 4
        and set(f.keys()) == {gtsam.symbol("p", 2), gtsam.symbol("p", 3)}
    ]
    (group,) = groups
    covariance = np.diag([1e-4, 2e-4, 3e-4, 4e-4]) + 5e-5
    np.testing.assert_allclose(group.noiseModel().covariance(), covariance, rtol=1e-10)


def test_gtsam_finds_the_minimum_that_adjust_finds() -> None:
    """Held components stay where they are, by hard constraints of the graph."""
    network = Network("trilateration with a photo of which Y₀ is held")
    rng = np.random.default_rng(7)
    truth = rng.uniform(-5.0, 5.0, (8, 3))
    names = [f"P{i}" for i in range(8)]
    for i, (name, at) in enumerate(zip(names, truth, strict=True)):
        start = at + (rng.normal(0, 0.05, 3) if i else 0.0)
        held = {0: "xyz", 1: "yz", 2: "z"}.get(i, "")
        start = np.where([axis in held for axis in "xyz"], at, start)
        network.add_point(name, start, fixed=held)
    for i in range(8):
        for j in range(i):
            s = float(np.linalg.norm(truth[i] - truth[j]))
            network.add(SlopeDistance(names[i], names[j], s + rng.normal(0, 0.003), sigma=0.003))
    centre, rotation = np.array([0.5, -0.4, 30.0]), world_R_camera(0.1, -0.1, 0.4)
    network.add_camera("camera", NoDistortion(), {"c": 50.0}, free=["c"])
    network.add_photo(
        "f",
        "camera",
        position=centre + np.array([0.3, 0.0, -0.2]),
        rotation=rotation @ world_R_camera(0.02, -0.01, 0.03) @ np.diag([1.0, -1.0, -1.0]),
        fixed=(False, False, False, False, True, False),
    )
    p = (truth - centre) @ rotation
    xy = 50.0 * np.stack([p[:, 0], -p[:, 1]], 1) / p[:, 2:]
    network.add_image_points("f", names, xy + rng.normal(0, 0.005, xy.shape), sigma=0.005)
    solution = adjust(network)
    built = build_graph(network)
    values = built.values
    for _ in range(8):
        values = values.retract(built.graph.linearize(values).optimize())
    state = state_of(built.equations, values)
    assert 2.0 * built.graph.error(values) == pytest.approx(solution.vtpv, rel=1e-9)
    for name, xyz in zip(names, state["point"], strict=True):
        np.testing.assert_allclose(xyz, solution.point(name), atol=1e-7)
    np.testing.assert_allclose(state["pose"][0, 9:], solution.pose("f").position, atol=1e-6)
    assert state["pose"][0, 10] == pytest.approx(centre[1], abs=1e-12)
    assert state["point"][2, 2] == pytest.approx(truth[2, 2], abs=1e-12)


# -- against GTSAM's own factors ------------------------------------------------------------------


def one_factor(network: Network, number: int = 0) -> tuple[gtsam.NonlinearFactor, Graph]:
    built = build_graph(network)
    return built.graph.at(number), built


def assert_same(
    ours: gtsam.NonlinearFactor, theirs: gtsam.NonlinearFactor, values: gtsam.Values
) -> None:
    """Compare error and Jacobian; keys in the same order."""
    assert ours.error(values) == pytest.approx(theirs.error(values), rel=1e-10)
    a, b = (
        gtsam.JacobianFactor(ours.linearize(values)),
        gtsam.JacobianFactor(theirs.linearize(values)),
    )
    assert list(a.keys()) == list(b.keys())
    np.testing.assert_allclose(a.jacobian()[0], b.jacobian()[0], rtol=1e-10, atol=1e-10)
    np.testing.assert_allclose(a.jacobian()[1], b.jacobian()[1], rtol=1e-10, atol=1e-10)


def two_points() -> Network:
    network = Network()
    network.add_point("i", (1.0, 2.0, 3.0))
    network.add_point("j", (7.0, -4.0, 5.5))
    return network


POINTS = (gtsam.symbol("p", 0), gtsam.symbol("p", 1))


def test_a_slope_distance_is_gtsams_range_factor() -> None:
    network = two_points()
    network.add(SlopeDistance("i", "j", 8.0, sigma=0.02))
    ours, built = one_factor(network)
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.02)
    assert_same(ours, gtsam.RangeFactor3(*POINTS, 8.0, noise), built.values)


def test_a_gnss_vector_is_gtsams_between_factor_with_a_full_covariance() -> None:
    network = two_points()
    network.add(GnssVector("i", "j", (6.1, -6.0, 2.4), covariance=every_kind.COVARIANCE))
    ours, built = one_factor(network)
    noise = gtsam.noiseModel.Gaussian.Covariance(every_kind.COVARIANCE)
    theirs = gtsam.BetweenFactorPoint3(*POINTS, np.array([6.1, -6.0, 2.4]), noise)
    assert ours.error(built.values) == pytest.approx(theirs.error(built.values), rel=1e-12)
    # Two square roots of one information matrix differ by a rotation; AᵀA and Aᵀb do not.
    np.testing.assert_allclose(
        ours.linearize(built.values).augmentedInformation(),
        theirs.linearize(built.values).augmentedInformation(),
        atol=1e-12,
    )


def test_known_coordinates_are_gtsams_prior_factor() -> None:
    network = two_points()
    network.add(ControlPoint("i", (1.1, 2.1, 2.8), covariance=every_kind.COVARIANCE))
    ours, built = one_factor(network)
    noise = gtsam.noiseModel.Gaussian.Covariance(every_kind.COVARIANCE)
    theirs = gtsam.PriorFactorPoint3(POINTS[0], np.array([1.1, 2.1, 2.8]), noise)
    np.testing.assert_allclose(
        ours.linearize(built.values).augmentedInformation(),
        theirs.linearize(built.values).augmentedInformation(),
        atol=1e-12,
    )


def photo_network(lens: NoDistortion | None = None, **calibration: float) -> Network:
    network = two_points()
    lens = NoDistortion() if lens is None else lens
    network.add_camera("camera", lens, calibration or {"c": 50.0}, free=lens.names)
    rotation = world_R_camera(0.2, -0.3, 0.7)
    network.add_photo("f", "camera", position=(2.0, 1.0, 40.0), rotation=rotation)
    return network


POSE, CALIBRATION = gtsam.symbol("c", 0), gtsam.symbol("k", 0)


@pytest.mark.parametrize("arm", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.9)])
def test_a_photo_position_is_gtsams_gps_factor(arm: tuple[float, float, float]) -> None:
    """GTSAM's body is the camera with y down and z forward."""
    network = photo_network()
    network.add(PhotoPosition("f", (2.1, 1.0, 40.3), sigma=(0.1, 0.2, 0.3), lever_arm=arm))
    ours, built = one_factor(network)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.1, 0.2, 0.3]))
    body = np.array([arm[0], -arm[1], -arm[2]])
    theirs = gtsam.GPSFactorArm(POSE, np.array([2.1, 1.0, 40.3]), body, noise)
    assert_same(ours, theirs, built.values)
    if arm == (0.0, 0.0, 0.0):
        assert_same(ours, gtsam.GPSFactor(POSE, np.array([2.1, 1.0, 40.3]), noise), built.values)


def test_a_weighted_attitude_is_the_rotation_of_gtsams_prior_factor() -> None:
    network = two_points()
    network.add_camera("camera", NoDistortion(), {"c": 50.0})
    given = world_R_camera(0.2, -0.3, 0.7)
    network.add_photo("f", "camera", position=(2.0, 1.0, 4.0), rotation=given, sigma_attitude=0.01)
    ours, built = one_factor(network)
    prior = gtsam.Pose3(gtsam.Rot3(given), np.array([2.0, 1.0, 4.0]))
    theirs = gtsam.PriorFactorPose3(POSE, prior, gtsam.noiseModel.Isotropic.Sigma(6, 0.01))
    values = gtsam.Values()
    values.insert(POSE, prior.retract(np.array([0.3, -0.2, 0.5, 0.0, 0.0, 0.0])))
    a, b = (
        gtsam.JacobianFactor(ours.linearize(values)),
        gtsam.JacobianFactor(theirs.linearize(values)),
    )
    np.testing.assert_allclose(a.jacobian()[0], b.jacobian()[0][:3], atol=1e-9)
    np.testing.assert_allclose(a.jacobian()[1], b.jacobian()[1][:3], atol=1e-9)
    assert built.error == pytest.approx(0.0, abs=1e-20)


def test_a_weighted_calibration_is_gtsams_prior_factor() -> None:
    network = two_points()
    network.add_camera("camera", BrownLens(), {"c": 50.0, "k1": 2e-4}, sigma={"k1": 1e-5})
    ours, built = one_factor(network)
    values = built.values
    moved = values.atVector(CALIBRATION) + 1e-3
    values.update(CALIBRATION, moved)
    scale = built.keys.scale("calibration", "camera")
    sigmas = np.full(10, np.inf)
    sigmas[3] = 1e-5 / scale[3]
    prior = np.array([50.0, 0, 0, 2e-4, 0, 0, 0, 0, 0, 0]) / scale
    theirs = gtsam.PriorFactorVector(CALIBRATION, prior, gtsam.noiseModel.Diagonal.Sigmas(sigmas))
    assert ours.error(values) == pytest.approx(theirs.error(values), rel=1e-9)
    row = gtsam.JacobianFactor(theirs.linearize(values)).jacobian()[0][3:4]
    np.testing.assert_allclose(ours.linearize(values).jacobian()[0], row, rtol=1e-9)


Y_UP = np.diag([1.0, -1.0])
"""Our image coordinates have y up, GTSAM's y down."""


def image_factors(network: Network) -> tuple[gtsam.NonlinearFactor, Graph]:
    network.add_image_points("f", ["j"], np.array([[2.0, -1.0]]), sigma=1.0)
    return one_factor(network)


def test_a_pinhole_is_gtsams_projection_factor() -> None:
    ours, built = image_factors(photo_network(c=50.0, x0=0.2, y0=-0.1))
    k = gtsam.Cal3_S2(50.0, 50.0, 0.0, 0.2, 0.1)
    unit = gtsam.noiseModel.Unit.Create(2)
    theirs = gtsam.GenericProjectionFactorCal3_S2(np.array([2.0, 1.0]), unit, POSE, POINTS[1], k)
    assert ours.error(built.values) == pytest.approx(theirs.error(built.values), rel=1e-12)
    a, b = ours.linearize(built.values).jacobian()
    c, d = theirs.linearize(built.values).jacobian()
    np.testing.assert_allclose(Y_UP @ a[:, [0, 1, 2, 3, 4, 5, -3, -2, -1]], c, atol=1e-11)
    np.testing.assert_allclose(Y_UP @ b, d, atol=1e-12)


def test_a_normalised_lens_is_the_camera_of_bundler() -> None:
    """Cal3Bundler: f (1 + k1 r² + k2 r⁴), without principal point."""
    lens = NormalisedLens()
    ours, built = image_factors(photo_network(lens, c=50.0, k1=-0.1, k2=0.05))
    k = gtsam.Cal3Bundler(50.0, -0.1, 0.05, 0.0, 0.0)
    camera = gtsam.PinholeCameraCal3Bundler(built.values.atPose3(POSE), k)
    unit = gtsam.noiseModel.Unit.Create(2)
    theirs = gtsam.GeneralSFMFactorCal3Bundler(np.array([2.0, 1.0]), unit, POSE, POINTS[1])
    values = gtsam.Values()
    values.insert(POSE, camera)
    values.insert(POINTS[1], built.values.atVector(POINTS[1]))
    assert ours.error(built.values) == pytest.approx(theirs.error(values), rel=1e-12)
    a, b = ours.linearize(built.values).jacobian()
    a[:, 6:-3] /= built.keys.scale("calibration", "camera")
    c, d = theirs.linearize(values).jacobian()
    by_camera = [*range(6), *(6 + lens.names.index(n) for n in ("c", "k1", "k2"))]
    np.testing.assert_allclose(Y_UP @ a[:, [*by_camera, -3, -2, -1]], c, atol=1e-11)
    np.testing.assert_allclose(Y_UP @ b, d, atol=1e-12)


def test_a_normalised_lens_is_the_camera_of_opencv() -> None:
    """Cal3DS2 is OpenCV's; its p1 is our −p2 and its p2 our p1, because its y points down."""
    lens = NormalisedLens()
    values = {"c": 50.0, "x0": 0.3, "y0": -0.2, "k1": -0.1, "k2": 0.05, "p1": 2e-3, "p2": -1e-3}
    ours, built = image_factors(photo_network(lens, **values))
    k = gtsam.Cal3DS2(50.0, 50.0, 0.0, 0.3, 0.2, -0.1, 0.05, 1e-3, 2e-3)
    unit = gtsam.noiseModel.Unit.Create(2)
    theirs = gtsam.GeneralSFMFactor2Cal3DS2(
        np.array([2.0, 1.0]), unit, POSE, POINTS[1], CALIBRATION
    )
    other = gtsam.Values()
    other.insert(POSE, built.values.atPose3(POSE))
    other.insert(POINTS[1], built.values.atVector(POINTS[1]))
    other.insert(CALIBRATION, k)
    assert ours.error(built.values) == pytest.approx(theirs.error(other), rel=1e-12)
    a = Y_UP @ ours.linearize(built.values).jacobian()[0]
    linear = theirs.linearize(other)
    c = linear.jacobian()[0]
    a[:, 6:14] /= built.keys.scale("calibration", "camera")
    np.testing.assert_allclose(a[:, :6], c[:, :6], atol=1e-11)
    ours_by_k, theirs_by_k = dict(zip(lens.names, a[:, 6:14].T, strict=True)), c[:, 9:].T
    np.testing.assert_allclose(a[:, -3:], c[:, 6:9], atol=1e-11)
    fx, fy, _, u0, v0, k1, k2, p1, p2 = theirs_by_k
    for name, column in (
        ("c", fx + fy),
        ("x0", u0),
        ("y0", -v0),
        ("k1", k1),
        ("k2", k2),
        ("p1", p2),
        ("p2", -p1),
    ):
        np.testing.assert_allclose(ours_by_k[name], column, atol=1e-11, err_msg=name)


def test_azimuth_and_vertical_angle_are_gtsams_bearing() -> None:
    """A bearing has two components in the tangent plane of the unit sphere: cosβ dα and dβ.

    GTSAM turns that plane as it likes; AᵀA does not depend on it. The station is a pose with
    the axes of the frame.
    """
    network = two_points()
    sigma = 0.001
    d = np.array([6.0, -6.0, 2.5])
    cos = float(np.hypot(d[0], d[1]) / np.linalg.norm(d))
    network.add(
        Azimuth("i", "j", float(np.arctan2(d[0], d[1])), sigma=sigma / cos),
        VerticalAngle("i", "j", float(np.arcsin(d[2] / np.linalg.norm(d))), sigma=sigma),
        SlopeDistance("i", "j", 8.0, sigma=0.02),
    )
    built = build_graph(network)
    n, g = normal_equations(built)
    values = gtsam.Values()
    values.insert(POINTS[0], gtsam.Pose3(gtsam.Rot3(), np.array([1.0, 2.0, 3.0])))
    values.insert(POINTS[1], built.values.atVector(POINTS[1]))
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([sigma, sigma, 0.02]))
    theirs = gtsam.BearingRangeFactor3D(*POINTS, gtsam.Unit3(d), 8.0, noise)
    a, b = theirs.linearize(values).jacobian()
    by_position = a[:, 3:]  # without the turn of the pose
    np.testing.assert_allclose(n, by_position.T @ by_position, atol=1e-6)
    np.testing.assert_allclose(g, -by_position.T @ b, atol=1e-6)


# -- factors of one's own -------------------------------------------------------------------------


def iso(dimension: int, sigma: float) -> gtsam.noiseModel.Base:
    return gtsam.noiseModel.Isotropic.Sigma(dimension, sigma)


def extra_factors() -> dict[str, Callable[[KeyMap, gtsam.Values], gtsam.NonlinearFactor]]:
    return {
        "range to a photo": lambda k, v: gtsam.RangeFactor3D(
            k.key("pose", "f2"), k.key("point", "C"), 17.0, iso(1, 0.1)
        ),
        "pose prior": lambda k, v: gtsam.PriorFactorPose3(
            k.key("pose", "f3"), gtsam.Pose3(), iso(6, 0.1)
        ),
        "between photos": lambda k, v: gtsam.BetweenFactorPose3(
            k.key("pose", "f1"),
            k.key("pose", "f3"),
            gtsam.Pose3(gtsam.Rot3(), np.array([3.0, 0.1, 0.2])),
            iso(6, 0.01),
        ),
        "bearing and range of a partly held point": lambda k, v: gtsam.BearingRangeFactor3D(
            k.key("pose", "f1"),
            k.key("point", "B"),
            gtsam.Unit3(np.array([0.0, 0.1, 1.0])),
            16.0,
            iso(3, 0.1),
        ),
        "calibration prior": lambda k, v: gtsam.PriorFactorVector(
            k.key("calibration", "big"), np.full(10, 1e-4), iso(10, 1e-3)
        ),
        "marginalised prior": lambda k, v: gtsam.LinearContainerFactor(
            gtsam.HessianFactor(
                gtsam.PriorFactorPose3(k.key("pose", "f1"), gtsam.Pose3(), iso(6, 0.1)).linearize(v)
            ),
            v,
        ),
    }


@pytest.mark.parametrize("name", extra_factors())
def test_an_extra_factor_has_its_error_and_gradient(name: str) -> None:
    equations = compile_network(mixed_network())
    unknowns, state = equations.unknowns, equations.unknowns.start()
    factor = extra_factors()[name](KeyMap(unknowns), values_of(equations, state))
    ((_, columns, a, r),) = linearise_extra({"own": factor}, equations, state)
    assert a.shape == (len(r), len(columns))
    assert 0.5 * float(r @ r) == pytest.approx(factor.error(values_of(equations, state)), rel=1e-9)
    gradient = np.zeros(len(columns))
    for i, column in enumerate(columns):
        step = np.zeros(unknowns.n_columns)
        step[column] = 1e-5 * unknowns.free[column]
        there, back = (
            factor.error(values_of(equations, unknowns.retract(state, s))) for s in (step, -step)
        )
        gradient[i] = (there - back) / 2e-5
    np.testing.assert_allclose(a.T @ r, gradient, rtol=1e-6, atol=1e-6 * np.abs(gradient).max())


def test_a_smart_factor_enters_by_a_root_of_its_information() -> None:
    network = Network()
    network.add_camera("camera", NoDistortion(), {"c": 50.0})
    for i in range(3):
        at, angles = (float(i), 0.2 * i, 20.0), (0.1 * i, -0.1, 0.3)
        network.add_photo(f"f{i}", "camera", position=at, omega_phi_kappa=angles)
        network.add(PhotoPosition(f"f{i}", at, sigma=(1.0, 1.0, 1.0)))
    equations = compile_network(network)
    state = equations.unknowns.start()
    values, k = values_of(equations, state), gtsam.Cal3_S2(500.0, 500.0, 0.0, 0.0, 0.0)
    smart = gtsam.SmartProjectionPoseFactorCal3_S2(iso(2, 1.0), k)
    for i in range(3):
        camera = gtsam.PinholeCameraCal3_S2(values.atPose3(gtsam.symbol("c", i)), k)
        noise = 0.3 * np.array([i, -i])
        smart.add(camera.project(np.array([1.0, 2.0, 3.0])) + noise, gtsam.symbol("c", i))
    ((_, columns, a, r),) = linearise_extra({"own": smart}, equations, state)
    information = smart.linearize(values).information()
    assert 0.5 * float(r @ r) == pytest.approx(smart.error(values), rel=1e-9)
    turn = from_gtsam("pose", np.eye(6), state["pose"][0])
    np.testing.assert_allclose(
        (a.T @ a)[:6, :6],
        turn.T @ information[:6, :6] @ turn,
        atol=1e-9 * np.abs(information).max(),
    )
    np.testing.assert_array_equal(columns, np.arange(18))


def test_adjusting_with_an_extra_factor_is_adjusting_with_the_observation() -> None:
    def network() -> Network:
        net = Network()
        net.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
        net.add_point("B", (10.0, 0.0, 0.0), fixed="yz")
        net.add_point("C", (3.0, 6.0, 0.0), fixed="z")
        net.add(
            SlopeDistance("A", "B", 10.01, sigma=0.005),
            SlopeDistance("A", "C", 6.7, sigma=0.005),
            SlopeDistance("B", "C", 9.2, sigma=0.005),
        )
        return net

    with_observation = network()
    with_observation.add(SlopeDistance("B", "C", 9.23, sigma=0.002))
    with_factor = network()
    k = build_graph(with_factor).keys
    factor = gtsam.RangeFactor3(k.key("point", "B"), k.key("point", "C"), 9.23, iso(1, 0.002))
    a, b = adjust(with_observation), adjust(with_factor, extra_factors=[factor])
    assert b.vtpv == pytest.approx(a.vtpv, rel=1e-9)
    assert b.redundancy == a.redundancy
    np.testing.assert_allclose(b.point("C"), a.point("C"), atol=1e-9)
    np.testing.assert_allclose(b.covariance("B", "C"), a.covariance("B", "C"), atol=1e-12)


def test_extra_factors_that_do_not_fit_are_refused_by_name() -> None:
    equations = compile_network(mixed_network())
    state = equations.unknowns.start()

    def refused(factor: gtsam.NonlinearFactor, message: str) -> None:
        with pytest.raises(InputError, match=message):
            linearise_extra({name_of(1, factor): factor}, equations, state)

    zero = np.zeros(3)
    p, x = gtsam.symbol("p", 0), gtsam.symbol("x", 4)
    refused(gtsam.PriorFactorPoint3(p, zero, iso(3, 1.0)), "p0 is the point 'A', which is held")
    refused(
        gtsam.PriorFactorPoint3(x, zero, iso(3, 1.0)), r"factor 1 \(PriorFactorPoint3\): key x4"
    )
    c = gtsam.symbol("p", 2)
    refused(gtsam.PriorFactorPose3(c, gtsam.Pose3(), iso(6, 1.0)), "cannot be linearised")
    hard = gtsam.noiseModel.Constrained.All(3)
    refused(gtsam.PriorFactorPoint3(c, zero, hard), "is a hard constraint")


# -- what protects GTSAM --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("partial", "message"),
    [
        (np.zeros(3), "must be 1 × 3"),
        (np.zeros((2, 3)), "must be 1 × 3"),
        (np.zeros((1, 4)), "must be 1 × 3"),
        (np.full((1, 3), np.nan), "must be 1 × 3 finite numbers"),
    ],
)
def test_wrong_partials_never_reach_gtsam(partial: Array, message: str) -> None:
    key = gtsam.symbol("p", 0)
    factor = factors.guarded(
        iso(1, 1.0), [key], [3], lambda v, j: (np.zeros(1), [partial]), lambda: "distance i j"
    )
    values = gtsam.Values()
    values.insert(key, np.zeros(3))
    with pytest.raises(AdjustmentError, match=f"distance i j: partials by p0 {message}"):
        factor.linearize(values)


@pytest.mark.parametrize("residual", [np.zeros(2), np.array([np.nan]), np.zeros((1, 1))])
def test_wrong_residuals_never_reach_gtsam(residual: Array) -> None:
    factor = factors.guarded(
        iso(1, 1.0), [1], [3], lambda v, j: (residual, [np.zeros((1, 3))]), lambda: "distance i j"
    )
    values = gtsam.Values()
    values.insert(1, np.zeros(3))
    with pytest.raises(AdjustmentError, match="distance i j: residual"):
        factor.error(values)


def test_a_degenerate_sight_comes_through_gtsam_by_name() -> None:
    network = Network()
    network.add_point("i", (1.0, 2.0, 3.0))
    network.add_point("j", (1.0, 2.0, 8.0))
    network.add(Azimuth("i", "j", 0.3, sigma=0.01, id="17"))
    with pytest.raises(InputError, match=r"azimuth i j \(id 17\): the sight is vertical"):
        build_graph(network)
    network.points["j"] = replace(network.points["j"], coordinates=(1.0, 3.0, 8.0))
    built = build_graph(network)
    built.values.update(gtsam.symbol("p", 1), np.array([1.0, 2.0, 8.0]))
    with pytest.raises(InputError, match=r"azimuth i j \(id 17\): the sight is vertical"):
        built.graph.linearize(built.values)


@LONG
def test_a_graph_that_is_no_longer_used_is_freed() -> None:
    """A callback that knew its own factor would keep it alive for ever."""

    def alive() -> int:
        gc.collect()
        return sum(isinstance(x, factors._Observations) for x in gc.get_objects())

    before = alive()
    built = build_graph(mixed_network())
    built.graph.linearize(built.values)
    assert alive() > before
    del built
    assert alive() == before


def test_start_values_that_are_not_given_are_found() -> None:
    network = Network()
    network.add_point("A", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("B", (100.0, 0.0, 0.0), fixed="xyz")
    network.add_point("C", (np.nan, np.nan, 0.0), fixed="z")
    network.add(
        Direction("A", "B", 0.2, sigma=1e-5),
        Direction("A", "C", 0.2 - np.pi / 4, sigma=1e-5),
        SlopeDistance("A", "C", 50.0, sigma=0.003),
    )
    built = build_graph(network)
    at = built.values.atVector(built.keys.key("point", "C"))
    np.testing.assert_allclose(at, np.array([1.0, 1.0, 0.0]) * 50.0 / np.sqrt(2.0), atol=1e-6)
    orientation = built.values.atVector(built.keys.key("orientation", "A/1"))
    assert orientation == pytest.approx([np.pi / 2 - 0.2], abs=1e-9)
    assert built.error == pytest.approx(0.0, abs=1e-9)


def test_only_the_weighted_coordinates_of_a_photo_are_observations() -> None:
    """Neither a coordinate without a weight nor a held one counts."""
    network = two_points()
    network.add_camera("camera", NoDistortion(), {"c": 50.0})
    rotation = world_R_camera(0.2, -0.3, 0.7)
    at = (2.0, 1.0, 40.0)
    network.add_photo(
        "f", "camera", position=at, rotation=rotation, sigma_position=(0.1, np.inf, 0.3)
    )
    held = (False, False, False, True, False, False)
    network.add_photo("g", "camera", position=at, rotation=rotation, sigma_position=0.2, fixed=held)
    equations = compile_network(network)
    names = [equations.label(row) for row in range(equations.n_rows)]
    assert names == [
        "weighted photo f position x",
        "weighted photo f position z",
        "weighted photo g position y",
        "weighted photo g position z",
    ]
    np.testing.assert_array_equal(equations.sigmas(), [0.1, 0.3, 0.2, 0.2])
    assert_graph_is_the_equations(equations)
