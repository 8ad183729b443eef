"""Laws that the observation models obey, and geometry that has no answer."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from factorgraph_adj.errors import InputError
from factorgraph_adj.frames import (
    MEAN_EARTH_RADIUS,
    Frame,
    GeocentricFrame,
    LocalFrame,
    TopocentricFrame,
)
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.lens import (
    BalancedLens,
    BrownForwardLens,
    BrownLens,
    HarmonicLens,
    Lens,
    NoDistortion,
)
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from factorgraph_adj.rotation import omega_phi_kappa, world_R_camera, world_R_photogrammetric
from factorgraph_adj.types import Array

LONG = pytest.mark.slow("whole networks turned and moved; short tests compute single models")

NANOMETRE = 1e-9
ROUNDING = 1e-11
"""Angles of sights longer than 1 m among coordinates below 10 km, radians."""

angles = st.floats(-math.pi, math.pi)
lengths = st.floats(1.0, 5_000.0)
slopes = st.floats(-1.4, 1.4)
heights = st.floats(0.0, 3.0)


def offset(azimuth: float, slope: float, length: float) -> Array:
    """Return east, north, up of a sight."""
    level = length * math.cos(slope)
    up = length * math.sin(slope)
    return np.array([level * math.sin(azimuth), level * math.cos(azimuth), up])


def computed(
    points: dict[str, Array],
    *observations: Observation,
    frame: Frame | None = None,
    kappa: float | None = None,
    verticals: dict[str, tuple[float, float]] | None = None,
) -> list[float]:
    """Return v of observations in order, orientations zero: computed where 0 is observed."""
    network = Network(frame=LocalFrame() if frame is None else frame)
    for name, at in points.items():
        network.add_point(name, at)
    for name, (xi, eta) in (verticals or {}).items():
        network.set_vertical(name, xi=xi, eta=eta)
    if kappa is not None:
        network.set_refraction(value=kappa)
    idents = [network.add(o)[0] for o in observations]
    equations = compile_network(network)
    state = equations.unknowns.start()
    state["orientation"][:] = 0.0
    values: dict[str, list[float]] = {}
    for block in equations.blocks:
        v = block.evaluate(network.frame, state).residual
        for ident, row in zip(block.ids, v, strict=True):
            values.setdefault(ident, []).extend(row)
    return [x for ident in idents for x in values[ident]]


def wrapped(angle: float) -> float:
    return math.pi - (math.pi - angle) % (2 * math.pi)


S = {"sigma": 0.01}


# -- single observations --------------------------------------------------------------------------


@given(angles, slopes, lengths, heights, heights)
def test_a_sight_has_its_length_azimuth_and_slope(
    azimuth: float, slope: float, length: float, hi: float, ht: float
) -> None:
    i = np.array([10.0, -20.0, 30.0])
    points = {"i": i, "j": i + offset(azimuth, slope, length) + [0.0, 0.0, hi - ht]}
    both = {**S, "instrument_height": hi, "target_height": ht}
    s, level, a, b, z, h = computed(
        points,
        SlopeDistance("i", "j", 0.0, **both),
        HorizontalDistance("i", "j", 0.0, **both),
        Azimuth("i", "j", 0.0, **both),
        VerticalAngle("i", "j", 0.0, **both),
        ZenithAngle("i", "j", 0.0, **both),
        HeightDifference("i", "j", 0.0, **both),
    )
    assert s == pytest.approx(length, abs=NANOMETRE)
    assert level == pytest.approx(length * math.cos(slope), abs=NANOMETRE)
    assert h == pytest.approx(length * math.sin(slope), abs=NANOMETRE)
    assert wrapped(a - azimuth) == pytest.approx(0.0, abs=ROUNDING)
    assert b == pytest.approx(slope, abs=ROUNDING)
    assert z == pytest.approx(math.pi / 2 - slope, abs=ROUNDING)


@given(angles, angles, st.integers(-3, 3))
def test_residuals_of_angles_lie_within_half_a_turn_of_zero(
    azimuth: float, observed: float, turns: int
) -> None:
    points = {"i": np.zeros(3), "j": offset(azimuth, 0.1, 50.0)}
    (v,) = computed(points, Azimuth("i", "j", observed + 2 * math.pi * turns, **S))
    assert -math.pi < v <= math.pi
    # Half a turn away, the sign is rounding's to choose.
    assert math.cos(v) == pytest.approx(math.cos(azimuth - observed), abs=1e-12)
    assert math.sin(v) == pytest.approx(math.sin(azimuth - observed), abs=1e-12)


@given(angles, angles, slopes, slopes, lengths)
def test_a_horizontal_angle_is_the_difference_of_two_directions(
    a: float, b: float, slope_a: float, slope_b: float, length: float
) -> None:
    points = {
        "i": np.zeros(3),
        "j": offset(a, slope_a, length),
        "k": offset(b, slope_b, 2 * length),
    }
    angle, to_j, to_k = computed(
        points,
        HorizontalAngle("i", "j", "k", 0.0, **S),
        Direction("i", "j", 0.0, **S),
        Direction("i", "k", 0.0, **S),
    )
    assert wrapped(angle - (to_k - to_j)) == pytest.approx(0.0, abs=1e-12)


def test_a_direction_is_the_azimuth_less_the_orientation_of_its_set() -> None:
    network = Network()
    network.add_point("i", (0.0, 0.0, 0.0))
    network.add_point("j", (100.0, 100.0, 0.0))
    network.set_orientation("i", set="2", value=0.3)
    network.add(Direction("i", "j", 0.0, set="2", **S))
    equations = compile_network(network)
    v = equations.residuals(equations.unknowns.start(), whitened=False)
    assert v[0] == pytest.approx(math.pi / 4 - 0.3, abs=1e-14)


# -- turned and moved networks --------------------------------------------------------------------

SIGHTS: tuple[Observation, ...] = (
    SlopeDistance("i", "j", 0.0, **S),
    HorizontalDistance("i", "j", 0.0, **S),
    VerticalAngle("i", "j", 0.0, **S),
    ZenithAngle("i", "j", 0.0, **S),
    HeightDifference("i", "j", 0.0, **S),
    HorizontalAngle("i", "j", "k", 0.0, **S),
)
"""What does not depend on where north is."""

coordinates = st.lists(st.floats(-500.0, 500.0), min_size=9, max_size=9)


def three_points(numbers: list[float]) -> dict[str, Array]:
    """Return three points; reject those too close together to have directions."""
    at = np.array(numbers).reshape(3, 3)
    level = [np.hypot(*(at[a] - at[b])[:2]) for a, b in ((0, 1), (0, 2), (1, 2))]
    assume(min(level) > 5.0)
    return dict(zip("ijk", at, strict=True))


@LONG
@given(coordinates, angles, st.lists(st.floats(-1000, 1000), min_size=3, max_size=3))
def test_a_network_turned_about_the_vertical_and_moved_has_the_same_residuals(
    numbers: list[float], turn: float, shift: list[float]
) -> None:
    """In a flat frame. Azimuths change by the turn."""
    points = three_points(numbers)
    c, s = math.cos(turn), math.sin(turn)
    rotation = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # clockwise from above
    moved = {n: rotation @ x + shift for n, x in points.items()}
    *before, a = computed(points, *SIGHTS, Azimuth("i", "j", 0.0, **S))
    *after, b = computed(moved, *SIGHTS, Azimuth("i", "j", 0.0, **S))
    np.testing.assert_allclose(after, before, atol=1e-9)
    assert wrapped(b - a - turn) == pytest.approx(0.0, abs=1e-10)


@given(coordinates, heights, heights)
def test_large_coordinates_cost_no_digits(numbers: list[float], hi: float, ht: float) -> None:
    """Of marks whose coordinates are exact far away too: h u is added to their difference."""
    grid, far = 2.0**-20, 2.0**23
    near = three_points([round(x / grid) * grid for x in numbers])
    raised = {"instrument_height": hi, "target_height": ht}
    sights = (
        SlopeDistance("i", "j", 0.0, sigma=0.01, **raised),
        VerticalAngle("i", "j", 0.0, sigma=0.01, **raised),
        HeightDifference("i", "j", 0.0, sigma=0.01, **raised),
        GnssVector("i", "j", (0.0, 0.0, 0.0), covariance=np.eye(3), **raised),
    )
    here = computed(near, *sights)
    there = computed({n: x + far for n, x in near.items()}, *sights)
    assert there == here


@LONG
@given(coordinates)
@settings(max_examples=30)
def test_axes_of_any_order_and_hand_give_the_same_observations(numbers: list[float]) -> None:
    points = three_points(numbers)
    every = (*SIGHTS, Azimuth("i", "j", 0.0, **S))
    expected = computed(points, *every)
    for axes in ("en", "nw", "ws", "se", "ne", "wn", "sw", "es"):
        frame = LocalFrame(axes=axes)  # type: ignore[arg-type]
        # X, Y of a point whose east and north are known.
        there = {n: frame.east_north.T @ x[:2] + [0.0, 0.0, x[2]] for n, x in points.items()}
        np.testing.assert_allclose(computed(there, *every, frame=frame), expected, atol=1e-10)


latitudes = st.floats(-1.5, 1.5)


@given(coordinates, latitudes, angles)
@settings(max_examples=50)
def test_topocentric_and_geocentric_are_one_model(
    numbers: list[float], latitude: float, longitude: float
) -> None:
    """Every residual is the same, deflections of the vertical included.

    Rounding: coordinates of 6·10⁶ m resolve 1 nm; the shortest level distance is 5 m. Near the
    poles a deflection η turns the horizon by η/cosφ.
    """
    points = three_points(numbers)
    frame = TopocentricFrame(latitude, longitude, 400.0)
    every = (*SIGHTS, Azimuth("i", "j", 0.0, **S))
    verticals = {"i": (4e-5, -7e-5), "j": (1e-5, 2e-5)}
    here = computed(points, *every, frame=frame, verticals=verticals)
    there = {n: frame.to_geocentric(x[None])[0] for n, x in points.items()}
    geocentric = computed(there, *every, frame=GeocentricFrame(), verticals=verticals)
    np.testing.assert_allclose(here, geocentric, atol=2e-8)
    (vector,) = (
        np.array(computed(p, GnssVector("i", "j", (0.0, 0.0, 0.0), sigma=(1.0, 1.0, 1.0)), frame=f))
        for p, f in ((there, GeocentricFrame()),)
    )
    np.testing.assert_allclose(
        np.linalg.norm(vector), np.linalg.norm(points["j"] - points["i"]), atol=1e-8
    )


@given(coordinates, st.floats(-1.2, 1.2))
@settings(max_examples=50)
def test_a_curved_local_frame_is_topocentric_but_for_the_flattening(
    numbers: list[float], latitude: float
) -> None:
    """Verticals tilt by 1/R; on the ellipsoid by 1/M and 1/N, 0.7 % different; azimuths also
    turn with the convergence of meridians, which the local frame has not."""
    points = three_points(numbers)
    local = computed(points, *SIGHTS[:5], frame=LocalFrame(curvature=True))
    ellipsoid = computed(points, *SIGHTS[:5], frame=TopocentricFrame(latitude, 0.3))
    flat = computed(points, *SIGHTS[:5])
    reach = 1500.0
    tilt = 0.01 * reach / MEAN_EARTH_RADIUS
    np.testing.assert_allclose(local[2:4], ellipsoid[2:4], atol=tilt)
    np.testing.assert_allclose(local[4], ellipsoid[4], atol=tilt * reach)
    assert local[0] == pytest.approx(flat[0], abs=NANOMETRE)


# -- curvature and refraction ---------------------------------------------------------------------


@given(st.floats(10.0, 20_000.0), angles, st.floats(0.0, 0.3))
@settings(max_examples=50)
def test_reciprocal_zenith_angles_add_up_to_half_a_turn_and_the_angle_between_the_verticals(
    length: float, azimuth: float, kappa: float
) -> None:
    """z_ij + z_ji = π + (1 − κ) S/R on a spherical Earth."""
    points = {"i": np.zeros(3), "j": offset(azimuth, 0.0, length)}
    there, back = computed(
        points,
        ZenithAngle("i", "j", 0.0, **S),
        ZenithAngle("j", "i", 0.0, **S),
        frame=LocalFrame(curvature=True),
        kappa=kappa,
    )
    # S cosβ at the two ends stands for S, and the frame's angles for those of a sphere.
    second_order = (length / MEAN_EARTH_RADIUS) ** 2
    assert there + back - math.pi == pytest.approx(
        (1.0 - kappa) * length / MEAN_EARTH_RADIUS, abs=ROUNDING + second_order
    )


@given(st.floats(10.0, 20_000.0), st.floats(0.01, 0.5))
def test_a_refracted_ray_leaves_the_station_above_its_chord(length: float, kappa: float) -> None:
    """The ray is an arc of radius R/κ: its tangent rises asin(κ S/2R) above the chord."""
    points = {"i": np.zeros(3), "j": np.array([0.0, length, 0.0])}
    up, zenith = computed(
        points, VerticalAngle("i", "j", 0.0, **S), ZenithAngle("i", "j", 0.0, **S), kappa=kappa
    )
    rise = math.asin(kappa * length / (2.0 * MEAN_EARTH_RADIUS))
    assert up == pytest.approx(rise, rel=1e-6)
    assert up > 0.0
    assert zenith == pytest.approx(math.pi / 2 - rise, abs=1e-9)


def test_eq_10_differs_from_its_small_angle_form_by_13_cm_over_100_m_at_0_2_rad() -> None:
    """½ S (β_ij − β_ji) = S β where S sinβ is meant (MODEL.md, errata)."""
    points = {"i": np.zeros(3), "j": offset(0.7, 0.2, 100.0)}
    h, s, there, back = computed(
        points,
        HeightDifference("i", "j", 0.0, **S),
        SlopeDistance("i", "j", 0.0, **S),
        VerticalAngle("i", "j", 0.0, **S),
        VerticalAngle("j", "i", 0.0, **S),
    )
    assert h == pytest.approx(100.0 * math.sin(0.2), abs=NANOMETRE)
    assert 0.5 * s * (there - back) - h == pytest.approx(0.133, abs=0.0005)


@given(angles, st.floats(-0.02, 0.02), st.floats(10.0, 2000.0))
@settings(max_examples=50)
def test_eq_10_is_its_small_angle_form_for_level_sights(
    azimuth: float, slope: float, length: float
) -> None:
    """With curvature, to S β³/6."""
    points = {"i": np.zeros(3), "j": offset(azimuth, slope, length)}
    h, there, back = computed(
        points,
        HeightDifference("i", "j", 0.0, **S),
        VerticalAngle("i", "j", 0.0, **S),
        VerticalAngle("j", "i", 0.0, **S),
        frame=LocalFrame(curvature=True),
    )
    small = 0.5 * length * (there - back)
    most = max(abs(there), abs(back))
    assert h == pytest.approx(small, abs=length * most**3 / 4 + NANOMETRE)


@given(coordinates)
@settings(max_examples=30)
def test_levelling_back_gives_the_negative(numbers: list[float]) -> None:
    points = three_points(numbers)
    for frame in (LocalFrame(), LocalFrame(curvature=True), TopocentricFrame(0.8, 0.2)):
        there, back = computed(
            points,
            HeightDifference("i", "j", 0.0, **S),
            HeightDifference("j", "i", 0.0, **S),
            frame=frame,
        )
        assert there == pytest.approx(-back, abs=1e-9)


def test_a_deflection_to_the_north_lifts_what_is_seen_in_the_north() -> None:
    """∂β/∂Φ = cosα: the zenith moves north by ξ, towards the target."""
    points = {"i": np.zeros(3), "j": np.array([0.0, 1000.0, 50.0])}
    xi = 1e-4
    tilted = LocalFrame(curvature=True)
    (before,) = computed(points, VerticalAngle("i", "j", 0.0, **S), frame=tilted)
    (after,) = computed(
        points, VerticalAngle("i", "j", 0.0, **S), frame=tilted, verticals={"i": (xi, 0.0)}
    )
    assert after - before == pytest.approx(xi, abs=1e-9)


def test_a_deflection_to_the_east_turns_azimuths_as_laplace_says() -> None:
    """∂α/∂Λ = sinΦ − cosα cosΦ tanβ; η = (Λ − λ) cosφ."""
    latitude, eta = 0.8, 5e-5
    frame = TopocentricFrame(latitude, 0.3)
    points = {"i": np.zeros(3), "j": np.array([300.0, 400.0, 20.0])}
    azimuth = Azimuth("i", "j", 0.0, **S)
    (before,) = computed(points, azimuth, frame=frame)
    (after,) = computed(points, azimuth, frame=frame, verticals={"i": (0.0, eta)})
    cos_a, tan_b = 0.8, 20.0 / 500.0
    expected = eta / math.cos(latitude) * (math.sin(latitude) - cos_a * math.cos(latitude) * tan_b)
    assert after - before == pytest.approx(expected, abs=1e-8)


# -- images ---------------------------------------------------------------------------------------

small_angles = st.floats(-0.5, 0.5)


def image_of(
    lens: Lens, calibration: dict[str, float], rotation: Array, centre: Array, point: Array
) -> Array:
    """Return v of an image point observed at (2, −3)."""
    network = Network()
    network.add_point("P", point)
    network.add_camera("camera", lens, calibration, free=["c"])
    network.add_photo("f", "camera", position=centre, rotation=rotation)
    network.add_image_points("f", ["P"], np.array([[2.0, -3.0]]), sigma=1.0)
    equations = compile_network(network)
    return equations.residuals(equations.unknowns.start(), whitened=False)


@given(small_angles, small_angles, angles, st.lists(st.floats(-3, 3), min_size=3, max_size=3))
def test_the_pinhole_is_the_collinearity_equation(
    omega: float, phi: float, kappa: float, at: list[float]
) -> None:
    """x − x0 = −c q1/q3, y − y0 = −c q2/q3, q = M (P − X0). Eq. 1."""
    centre, point = np.array([1.0, 2.0, 15.0]), np.array(at)
    q = world_R_photogrammetric(omega, phi, kappa).T @ (point - centre)
    x, y = 0.1 - 30.0 * q[0] / q[2], -0.2 - 30.0 * q[1] / q[2]
    rotation = world_R_camera(omega, phi, kappa)
    values = {"c": 30.0, "x0": 0.1, "y0": -0.2}
    v = image_of(NoDistortion(), values, rotation, centre, point)
    np.testing.assert_allclose(v, [x - 2.0, y + 3.0], atol=1e-11)


@given(angles, st.floats(-1.5, 1.5), angles)
def test_omega_phi_kappa_survive_the_way_through_a_rotation(
    omega: float, phi: float, kappa: float
) -> None:
    rotation = world_R_camera(omega, phi, kappa)
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(world_R_camera(*omega_phi_kappa(rotation)), rotation, atol=1e-12)


@given(small_angles, small_angles, angles, angles)
@settings(max_examples=50)
def test_a_turned_block_has_the_same_image_coordinates(
    omega: float, phi: float, kappa: float, turn: float
) -> None:
    turned = world_R_photogrammetric(turn, 0.3 * turn, -turn)
    shift = np.array([100.0, -50.0, 7.0])
    centre, point = np.array([1.0, 2.0, 15.0]), np.array([2.0, -1.0, 0.5])
    rotation = world_R_camera(omega, phi, kappa)
    values = {"c": 30.0, "k1": 1e-4, "p1": 1e-5, "b1": 1e-4}
    before = image_of(BrownLens(), values, rotation, centre, point)
    after = image_of(
        BrownLens(), values, turned @ rotation, turned @ centre + shift, turned @ point + shift
    )
    np.testing.assert_allclose(after, before, atol=1e-10)


def residual_at(lens: Lens, k: dict[str, float], t: tuple[float, float], xy: Array) -> Array:
    values = np.array([[k.get(n, 0.0) for n in lens.names]])
    tx, ty = (np.array([x]) for x in t)
    return lens.residual(tx, ty, xy[None], values, jacobians=False)[0][0]


image_positions = st.tuples(st.floats(-12.0, 12.0), st.floats(-9.0, 9.0))


@given(image_positions)
def test_harmonic_terms_are_those_of_eq_3(at: tuple[float, float]) -> None:
    x, y = at
    lens = HarmonicLens(reference_radius=8.0, residuals="ideal")
    names = lens.names[3:]
    k = dict(zip(names, np.linspace(0.001, 0.01, 10), strict=True))
    rho, angle = math.hypot(x, y) / 8.0, math.atan2(y, x)
    t = (
        k["a00"]
        + k["a11"] * math.cos(angle)
        + k["b11"] * math.sin(angle)
        + k["a20"] * rho
        + rho * (k["a22"] * math.cos(2 * angle) + k["b22"] * math.sin(2 * angle))
        + rho**2 * (k["a31"] * math.cos(angle) + k["b31"] * math.sin(angle))
        + rho**2 * (k["a33"] * math.cos(3 * angle) + k["b33"] * math.sin(3 * angle))
    )
    v = residual_at(lens, {"c": 30.0, **k}, (0.0, 0.0), np.array(at))
    np.testing.assert_allclose(v, [-x - x * t, -y - y * t], atol=1e-12)


@given(image_positions)
def test_brown_in_both_directions_agrees_to_first_order(at: tuple[float, float]) -> None:
    """Same signs of the parameters: corrections are subtracted on the way to the image."""
    k = {"c": 30.0, "k1": 1e-6, "k2": 1e-9, "p1": 1e-6, "p2": -1e-6}
    xy = np.array(at)
    # The ray that the measured → ideal model gives to (x, y) …
    corrected = -residual_at(BrownLens(residuals="ideal"), k, (0.0, 0.0), xy)
    ray = (corrected[0] / 30.0, corrected[1] / 30.0)
    # … comes back to (x, y) but for the change of the correction along itself: its slope,
    # 3 k1 r² + 5 k2 r⁴ + 6 p r at most, is below 1.3e-3 inside the image.
    v = residual_at(BrownForwardLens(), k, ray, xy)
    assert np.linalg.norm(v) <= 1.3e-3 * np.linalg.norm(corrected - xy) + 1e-14


@given(angles)
def test_balanced_distortion_vanishes_at_its_radius(angle: float) -> None:
    lens = BalancedLens(zero_radius=9.0)
    xy = 9.0 * np.array([math.cos(angle), math.sin(angle)])
    k = {"c": 30.0, "A1": -1e-4, "A2": 3e-7, "A3": 1e-10}
    v = residual_at(lens, k, (xy[0] / 30.0, xy[1] / 30.0), xy)
    np.testing.assert_allclose(v, 0.0, atol=1e-13)


def test_nothing_breaks_in_the_image_centre() -> None:
    """The harmonic function has no direction there; its correction is zero."""
    lens = HarmonicLens()
    values = np.array([[30.0, 0.0, 0.0, *np.linspace(0.001, 0.01, 10)]])
    zero = np.zeros(1)
    v, by_t, by_k = lens.residual(zero, zero, np.zeros((1, 2)), values)
    assert by_t is not None
    assert by_k is not None
    np.testing.assert_array_equal(v, 0.0)
    assert np.isfinite(by_t).all()
    assert np.isfinite(by_k).all()


# -- geometry without an answer -------------------------------------------------------------------

COINCIDENT = "station and target coincide: the sight has no length"
VERTICAL = "the sight is vertical: it has no azimuth"


@pytest.mark.parametrize(
    ("observation", "target", "message"),
    [
        (SlopeDistance("i", "j", 1.0, **S, id="7"), (1.0, 2.0, 3.0), COINCIDENT),
        (Direction("i", "j", 1.0, **S, id="7"), (1.0, 2.0, 3.0), COINCIDENT),
        (ZenithAngle("i", "j", 1.0, **S, id="7"), (1.0, 2.0, 3.0), COINCIDENT),
        (Azimuth("i", "j", 1.0, **S, id="7"), (1.0, 2.0, 9.0), VERTICAL),
        (Direction("i", "j", 1.0, **S, id="7"), (1.0, 2.0, 9.0), VERTICAL),
        (HorizontalAngle("i", "j", "k", 1.0, **S, id="7"), (1.0, 2.0, 9.0), VERTICAL),
        (HorizontalAngle("i", "k", "j", 1.0, **S, id="7"), (1.0, 2.0, 9.0), VERTICAL),
        (HorizontalDistance("i", "j", 1.0, **S, id="7"), (1.0, 2.0, 9.0), VERTICAL),
        (VerticalAngle("i", "j", 1.0, **S, id="7"), (1.0, 2.0, -9.0), VERTICAL),
    ],
    ids=lambda p: getattr(p, "kind", None),
)
def test_a_sight_without_an_answer_is_named(
    observation: Observation, target: tuple[float, float, float], message: str
) -> None:
    points = {"i": np.array([1.0, 2.0, 3.0]), "j": np.array(target), "k": np.array([9.0, 9.0, 9.0])}
    with pytest.raises(InputError) as caught:
        computed(points, observation)
    assert str(caught.value) == f"{observation.label()}: {message}"
    assert "(id 7)" in str(caught.value)


def test_every_sight_without_an_answer_is_named_at_once() -> None:
    points = {"i": np.zeros(3), "j": np.array([0.0, 0.0, 5.0]), "k": np.array([0.0, 0.0, -5.0])}
    with pytest.raises(InputError) as caught:
        computed(points, Azimuth("i", "j", 0.0, **S), Azimuth("i", "k", 0.0, **S))
    assert [p.where for p in caught.value.problems] == ["azimuth i j", "azimuth i k"]


def test_a_levelled_or_measured_vertical_line_is_fine() -> None:
    points = {"i": np.zeros(3), "j": np.array([0.0, 0.0, 5.0])}
    s, h = computed(points, SlopeDistance("i", "j", 0.0, **S), HeightDifference("i", "j", 0.0, **S))
    assert (s, h) == (5.0, 5.0)


def test_a_point_in_the_focal_plane_is_named() -> None:
    with pytest.raises(InputError, match="image f P: the point lies in the focal plane"):
        image_of(NoDistortion(), {"c": 30.0}, np.eye(3), np.zeros(3), np.array([1.0, 1.0, 0.0]))


def test_an_observation_from_a_point_to_itself_is_refused() -> None:
    with pytest.raises(InputError, match="slope_distance i i: an observation cannot join a point"):
        SlopeDistance("i", "i", 1.0, **S)
    with pytest.raises(InputError, match="cannot join a point to itself"):
        replace(HorizontalAngle("i", "j", "k", 1.0, **S), target2="j")
