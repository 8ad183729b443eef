"""Unit values of tilts, sights, heights of profiles and levels, and azimuths of gyros."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame, direction_of
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.directions import across
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import exp_rotation, world_R_camera

DOWN = world_R_camera(0.0, 0.0, 0.0)


def photo(rotation=DOWN, *, frame=None, position=(0.0, 0.0, 100.0)) -> fga.Network:
    network = fga.Network("photo", frame=LocalFrame() if frame is None else frame)
    network.add_camera("c", NoDistortion(), {"c": 1.0})
    network.add_photo("f", "c", position=position, rotation=rotation)
    network.add_point("P", (3.0, 4.0, 5.0))
    network.add_point("Q", (103.0, 4.0, 5.0))
    return network


def residual(network: fga.Network, *observations: fga.Observation) -> np.ndarray:
    network.add(*observations)
    equations = compile_network(network)
    v = [b.evaluate(network.frame, equations.unknowns.start()) for b in equations.blocks]
    return np.concatenate([x.residual.ravel() for x in v])


# -- tilts ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kappa", [0.0, 2.0])
@pytest.mark.parametrize("tilt", [-0.3, 0.02, 1.2])
def test_the_inclination_of_an_axis_is_its_angle_above_the_horizon(tilt, kappa) -> None:
    """Of a photo that is turned about its y axis alone, whatever its direction."""
    # World from photogrammetric axes: the heading first, then the turn about y.
    turn = exp_rotation(np.array([0.0, 0.0, kappa])) @ exp_rotation(np.array([0.0, -tilt, 0.0]))
    rotation = turn @ np.diag([1.0, -1.0, -1.0])
    x_axis = turn[:, 0]
    assert x_axis[2] == pytest.approx(np.sin(tilt))  # raised by the tilt
    v = residual(photo(rotation), o.PhotoTilt("f", (0.0, 0.0), sigma=(1.0, 1.0)))
    np.testing.assert_allclose(v, [tilt, 0.0], atol=1e-12)


def test_tilts_are_those_of_omega_and_phi() -> None:
    """φ raises the y–z plane, ω turns about x: the zenith is (−sin φ, …) in axes of the camera."""
    omega, phi = 0.03, -0.05
    rotation = world_R_camera(omega, phi, 0.0)
    v = residual(photo(rotation), o.PhotoTilt("f", (0.0, 0.0), sigma=(1.0, 1.0)))
    up = np.array([-np.cos(omega) * np.sin(phi), np.sin(omega), np.cos(omega) * np.cos(phi)])
    wanted = np.arctan2(up[:2], up[2])
    assert v == pytest.approx(wanted, abs=1e-12)
    assert v == pytest.approx([-phi, omega], abs=2e-3)


def test_the_mount_of_a_level_camera_turns_its_clinometer_upright() -> None:
    """A camera that looks north, with a clinometer whose z axis is the camera's y axis."""
    network = photo(world_R_camera(np.pi / 2, 0.0, 0.0))
    network.set_mount("clino", values={"rx": -np.pi / 2})
    v = residual(network, o.PhotoTilt("f", (0.01, -0.02), sigma=(1.0, 1.0), mount="clino"))
    np.testing.assert_allclose(v, [-0.01, 0.02], atol=1e-12)


def test_an_axis_that_points_up_has_no_inclination_about_the_other() -> None:
    network = photo(world_R_camera(np.pi / 2, 0.0, 0.0))  # its y axis points up
    with pytest.raises(fga.InputError, match="photo_tilt f: the y axis of the instrument is verti"):
        residual(network, o.PhotoTilt("f", (0.0, 0.0), sigma=(1.0, 1.0)))
    network = photo(world_R_camera(np.pi / 2, 0.0, 0.0))
    # That about x is a right angle, and has a value.
    v = residual(network, o.PhotoTilt("f", (0.0,), axes="y", sigma=(1.0,)))
    assert v == pytest.approx([np.pi / 2])


def test_the_vertical_of_a_tilt_is_that_at_the_photo() -> None:
    """At a distance of 20 km from the origin of a topocentric frame it leans by 3 mrad."""
    frame = TopocentricFrame(0.8, 0.2)
    at = (20_000.0, 0.0, 1500.0)
    v = residual(photo(frame=frame, position=at), o.PhotoTilt("f", (0.0, 0.0), sigma=(1.0, 1.0)))
    assert v[0] == pytest.approx(20_000.0 / 6.388e6, rel=2e-3)
    assert abs(v[1]) < 2e-5  # of a meridian's convergence


# -- sights ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_across_is_an_orthonormal_basis(seed: int) -> None:
    w = np.random.default_rng(seed).normal(size=(5, 3))
    w[0] = (0.0, 0.0, -1.0)
    w /= np.linalg.norm(w, axis=1)[:, None]
    t = across(w)
    assert np.allclose(t @ t.transpose(0, 2, 1), np.eye(2), atol=1e-12)
    assert np.allclose(np.einsum("nij,nj->ni", t, w), 0.0, atol=1e-12)
    assert np.allclose(t[0], np.eye(3)[:2])


@pytest.mark.parametrize("angle", [1e-9, 1e-4, 0.3, 2.0, 3.1])
def test_the_residuals_of_a_sight_are_the_angle_to_the_body(angle: float) -> None:
    seen = np.array([0.6, 0.0, 0.8])
    body = exp_rotation(np.array([0.0, angle, 0.0])) @ seen  # towards +x of the photo
    given = (tuple(body.tolist()), tuple(seen.tolist()))
    v = residual(photo(), o.PhotoSight("f", *given, sigma=(1.0, 1.0)))
    assert v == pytest.approx([angle, 0.0], abs=1e-12)


def test_a_body_opposite_to_where_it_was_seen_is_refused() -> None:
    with pytest.raises(fga.InputError, match="photo_sight f: the body stands opposite"):
        residual(photo(), o.PhotoSight("f", (0.0, 0.6, 0.8), (0.0, -0.6, -0.8), sigma=(1.0, 1.0)))


def test_a_sight_of_a_far_point_is_its_image() -> None:
    """A point at infinity: the ray of its image coordinates, in axes of the camera."""
    rotation = world_R_camera(0.1, -0.2, 2.0)
    body = rotation @ np.array([0.1, 0.2, 1.0])  # x right, y down, z forward
    body /= np.linalg.norm(body)
    ray = np.array([0.1, -0.2, -1.0]) / np.linalg.norm([0.1, 0.2, 1.0])
    given = (tuple(body.tolist()), tuple(ray.tolist()))
    v = residual(photo(rotation), o.PhotoSight("f", *given, sigma=(1.0, 1.0)))
    np.testing.assert_allclose(v, 0.0, atol=1e-12)


def test_the_direction_of_a_body_is_in_the_horizon_of_its_place() -> None:
    frame = GeocentricFrame()
    place = frame.ellipsoid.to_cartesian(np.array([0.8]), np.array([0.2]), np.zeros(1))[0]
    zenith = direction_of(frame, place, 1.0, np.pi / 2)
    assert zenith == pytest.approx(
        [np.cos(0.8) * np.cos(0.2), np.cos(0.8) * np.sin(0.2), np.sin(0.8)]
    )
    pole = direction_of(frame, place, 0.0, 0.8)
    assert pole == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)


# -- heights --------------------------------------------------------------------------------------


def test_a_reading_of_a_profile_by_hand() -> None:
    """(1 + s) (h − a − b t − c t²) at h = 100 + 0.5, s = 0.01, a = 3, b = −2, c = 0.5, t = 4."""
    network = photo()
    values = {"height": 3.0, "height_t": -2.0, "height_tt": 0.5, "scale": 0.01}
    network.set_profile("p", values=values)
    arm, wanted = (0.0, 0.0, 0.5), 1.01 * (100.5 - 3.0 + 8.0 - 8.0)
    v = residual(
        network,
        o.ProfileHeight(
            None, 90.0, photo="f", profile="p", time=4.0, lever_arm=arm, sigma=1.0, id="photo"
        ),
        o.ProfileHeight("P", 1.0, sigma=1.0),
    )
    assert sorted(v) == pytest.approx(sorted([wanted - 90.0, 4.0]))


def test_a_height_above_water_by_hand() -> None:
    """5 − (3 + 0.001 · 200 + 0.05) − 1."""
    network = photo()
    network.set_level("river", 3.0)
    v = residual(
        network,
        o.LevelHeight("P", "river", 1.0, sigma=1.0, slope=1e-3, along=200.0, geoid=0.05),
    )
    assert v == pytest.approx([5.0 - 3.0 - 0.2 - 0.05 - 1.0])


def test_heights_in_a_curved_frame_are_above_the_ellipsoid() -> None:
    frame = TopocentricFrame(0.8, 0.2)
    network = photo(frame=frame, position=(20_000.0, 0.0, 1500.0))
    v = residual(network, o.ProfileHeight(None, 0.0, photo="f", sigma=1.0))
    assert v[0] == pytest.approx(1500.0 + 20_000.0**2 / (2 * 6.39e6), rel=1e-3)


def test_a_profile_height_is_gtsams_barometric_factor() -> None:
    """Its height is that of its pressure, its bias −a; σ 0.25 m."""
    pressure, bias = 95.0, 3.2  # kPa, m
    noise = gtsam.noiseModel.Isotropic.Sigma(1, 0.25)
    theirs = gtsam.BarometricFactor(1, 2, pressure, noise)
    reading = theirs.measurementIn()
    # GTSAM has the formula of the Glenn Research Center: 288.08 K, 6.49 K/km, 101.29 kPa.
    formula = (15.04 + 273.1 - 288.08 * (pressure / 101.29) ** (1 / 5.256)) / 0.00649
    assert reading == pytest.approx(formula, abs=1e-9)
    rotation = world_R_camera(0.2, -0.3, 0.7)
    network = photo(rotation, position=(2.0, 1.0, 560.0))
    network.set_profile("p", values={"height": -bias})
    network.add(o.ProfileHeight(None, reading, photo="f", profile="p", sigma=0.25))
    built = fga.build_graph(network)
    ours = built.graph.at(0)
    values = gtsam.Values()
    values.insert(1, gtsam.Pose3(gtsam.Rot3(rotation), np.array([2.0, 1.0, 560.0])))
    values.insert(2, bias)
    assert ours.error(built.values) == pytest.approx(theirs.error(values), rel=1e-9)
    a = gtsam.JacobianFactor(ours.linearize(built.values))
    b = gtsam.JacobianFactor(theirs.linearize(values))
    assert a.jacobian()[1] == pytest.approx(b.jacobian()[1], rel=1e-9)
    # The pose comes first or last, beside the four components of the profile.
    first = gtsam.Symbol(a.keys()[0]).chr() == ord("c")
    by_pose = a.jacobian()[0][:, :6] if first else a.jacobian()[0][:, 4:]
    np.testing.assert_allclose(by_pose, b.jacobian()[0][:, :6], atol=1e-9)


# -- gyros ----------------------------------------------------------------------------------------


def test_the_azimuth_of_a_gyrotheodolite_is_its_reading_and_its_constant() -> None:
    network = photo()
    network.set_gyro("g", 0.3)
    v = residual(
        network,
        o.GyroAzimuth("P", "Q", 1.2, gyro="g", sigma=1.0),
        o.GyroAzimuth("Q", "P", 1.2, sigma=1.0),
    )
    assert v == pytest.approx([np.pi / 2 - 1.5, 3 * np.pi / 2 - 1.2 - 2 * np.pi])
