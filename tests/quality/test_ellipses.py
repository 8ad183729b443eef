"""Error ellipses and ellipsoids: conventions, confidence, published ones; relative precision.

Findings about published ellipses:

- Comp3D prints azimuth and inclination of each axis of its ellipsoids between 0 and 200 gon, the
  inclination for either end of the axis: its printed axes are perpendicular to one another only
  after some of the signs are changed. Lengths and azimuths are ours.
- Gama's ``alpha`` of an ellipse counts clockwise from its x axis; with axes "en" that is east,
  so that the azimuth is 100 gon more. (Its covariance matrix is mirrored there, see test_gama;
  the ellipses are not.)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
import scipy.stats

import factorgraph_adj as fga
from factorgraph_adj.frames import LEFT_HANDED_AXES, LocalFrame, TopocentricFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Correlated,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalDistance,
    SlopeDistance,
)
from factorgraph_adj.quality.datum_change import s_transform
from factorgraph_adj.quality.error_ellipses import (
    confidence_factor,
    error_ellipse,
    error_ellipses,
    error_ellipsoid,
    error_ellipsoids,
    height_interval,
    height_intervals,
)
from factorgraph_adj.quality.point_precision import Place, distance_precision
from factorgraph_adj.solve.factorisation import Factorisation
from factorgraph_adj.types import Array
from factorgraph_adj.units import GON
from tests.loaders import comp3d
from tests.loaders.gama_result import NAMESPACE
from tests.networks.aicon import MM, point_reference, read_aicon
from tests.networks.comp3d import network_of_topo
from tests.networks.gama import FOLDER, NETWORKS, solved
from tests.networks.small_block import small_block
from tests.support.dense import Dense
from tests.support.places import data_dir

LONG = pytest.mark.slow("ellipsoids of a whole real block; short tests take single points")

DEGREE = math.pi / 180
MILLIMETRE = 1e-3
EIGHT_AXES = ("en", "nw", "ws", "se", *LEFT_HANDED_AXES)


def positioned(covariance: Array, *, frame: fga.LocalFrame | None = None, at=(0.0, 0.0, 0.0)):
    """Return the solution of one point whose covariance (3, 3) is the one given."""
    network = Network("one point", frame=frame)
    network.add_point("P", at)
    network.add(GnssPosition("P", at, covariance=covariance))
    return fga.adjust(network)


def along(azimuth: float, dip: float) -> Array:
    """Return the unit vector east, north, up of an azimuth and a dip below the horizon."""
    level = math.cos(dip)
    return np.array([level * math.sin(azimuth), level * math.cos(azimuth), -math.sin(dip)])


def turned_plan(azimuth: float, major: float, minor: float) -> Array:
    """Return the covariance east, north, up of an ellipse in the plan, 1 mm in height."""
    a, b = along(azimuth, 0.0), along(azimuth + math.pi / 2, 0.0)
    up = np.array([0.0, 0.0, 1.0])
    return major**2 * np.outer(a, a) + minor**2 * np.outer(b, b) + MILLIMETRE**2 * np.outer(up, up)


# -- conventions ----------------------------------------------------------------------------------


def test_an_ellipse_computed_by_hand():
    """3 and 2 cm at an azimuth of 30°: σe² = 5.25, σn² = 7.75, σen = 5 √3/4 cm²."""
    cm2 = 1e-4
    q = np.diag([5.25, 7.75, 1.0])
    q[0, 1] = q[1, 0] = 5 * math.sqrt(3) / 4
    ellipse = error_ellipse(positioned(cm2 * q), "P", confidence=None)
    assert ellipse.semi_axes == pytest.approx((0.03, 0.02), rel=1e-9)
    assert ellipse.azimuth == pytest.approx(30 * DEGREE, abs=1e-9)
    assert (ellipse.confidence, ellipse.factor) == (None, 1.0)
    assert ellipse.centre == pytest.approx([0, 0, 0], abs=1e-12)


@pytest.mark.parametrize("degrees", [0, 1e-7, 45, 90, 120, 179.9999999])
def test_azimuths_count_clockwise_from_north(degrees):
    ellipse = error_ellipse(positioned(turned_plan(degrees * DEGREE, 0.003, 0.001)), "P")
    assert 0 <= ellipse.azimuth < math.pi
    away = (ellipse.azimuth - degrees * DEGREE + math.pi / 2) % math.pi - math.pi / 2
    assert away == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("axes", EIGHT_AXES)
def test_north_is_where_the_axes_of_the_frame_say(axes):
    frame = LocalFrame(axes=axes)
    east, north = frame.east_north
    rows = np.stack([east, north, [0.0, 0.0, 1.0]])
    q = rows.T @ turned_plan(110 * DEGREE, 0.003, 0.001) @ rows
    solution = positioned(q, frame=frame)
    ellipse = error_ellipse(solution, "P", confidence=None)
    assert ellipse.semi_axes == pytest.approx((0.003, 0.001))
    assert ellipse.azimuth == pytest.approx(110 * DEGREE)
    ellipsoid = error_ellipsoid(solution, "P", confidence=None)
    assert ellipsoid.azimuths[0] == pytest.approx(110 * DEGREE)
    assert abs(ellipsoid.directions[0] @ rows.T @ along(110 * DEGREE, 0)) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("azimuth", "dip"), [(40.0, 25.0), (140.0, -60.0), (0.0, 10.0), (90.0, -5.0), (170.0, 89.0)]
)
def test_the_dip_is_positive_where_an_axis_goes_down(azimuth, dip):
    a = along(azimuth * DEGREE, dip * DEGREE)
    b = along((azimuth + 90) * DEGREE, 0.0)
    c = np.cross(a, b)
    q = sum(s**2 * np.outer(v, v) for s, v in ((0.003, a), (0.002, b), (0.001, c)))
    ellipsoid = error_ellipsoid(positioned(q), "P", confidence=None)
    assert ellipsoid.semi_axes == pytest.approx((0.003, 0.002, 0.001))
    assert ellipsoid.azimuths[0] == pytest.approx(azimuth * DEGREE, abs=1e-7)
    assert ellipsoid.dips[0] == pytest.approx(dip * DEGREE, abs=1e-7)
    for found, v in zip(ellipsoid.directions, (a, b, c), strict=True):
        assert abs(found @ v) == pytest.approx(1.0)
    for i in range(3):
        v = along(ellipsoid.azimuths[i], ellipsoid.dips[i])
        np.testing.assert_allclose(v, ellipsoid.directions[i], atol=1e-12)
        assert 0 <= ellipsoid.azimuths[i] < math.pi


def test_a_vertical_axis_has_azimuth_zero_and_dips_by_a_right_angle():
    ellipsoid = error_ellipsoid(positioned(np.diag([1e-6, 4e-6, 9e-6])), "P", confidence=None)
    assert ellipsoid.semi_axes == pytest.approx((0.003, 0.002, 0.001))
    assert ellipsoid.azimuths == pytest.approx((0.0, 0.0, math.pi / 2), abs=1e-9)
    assert ellipsoid.dips == pytest.approx((math.pi / 2, 0.0, 0.0), abs=1e-9)


def test_the_thin_axis_of_a_long_ellipse_is_not_lost():
    """1 m by 10 nm: the difference of the eigenvalues' halves would leave nothing of it."""
    ellipse = error_ellipse(positioned(np.diag([1e-16, 1.0, 1.0])), "P", confidence=None)
    assert ellipse.semi_axes == pytest.approx((1.0, 1e-8), rel=1e-6)


@pytest.mark.parametrize("confidence", [None, 0.95])
def test_held_components_give_zero_axes(confidence):
    network = Network("held")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (100, 0, 0), fixed="yz")
    network.add_point("C", (0, 0, 3), fixed="xy")
    network.add(
        SlopeDistance("A", "B", 100.0, sigma=0.002), HeightDifference("A", "C", 3.0, sigma=0.001)
    )
    solution = fga.adjust(network)
    # What is left of an ellipse with one axis is an interval, with the factor of intervals.
    plan = space = confidence_factor(1, confidence)
    a, b, c = error_ellipses(solution, confidence=confidence)
    assert a.semi_axes == (0.0, 0.0)
    assert b.semi_axes == pytest.approx((0.002 * plan, 0.0))
    assert b.azimuth == pytest.approx(math.pi / 2)
    assert c.semi_axes == (0.0, 0.0)
    assert (a.azimuth, c.azimuth) == (0.0, 0.0)
    a, b, c = error_ellipsoids(solution, confidence=confidence)
    assert a.semi_axes == (0.0, 0.0, 0.0)
    assert b.semi_axes == pytest.approx((0.002 * space, 0.0, 0.0))
    assert c.semi_axes == pytest.approx((0.001 * space, 0.0, 0.0))
    assert c.dips[0] == math.pi / 2
    for ellipsoid in (a, b, c):
        assert np.isfinite([*ellipsoid.azimuths, *ellipsoid.dips]).all()
        np.testing.assert_allclose(
            ellipsoid.directions @ ellipsoid.directions.T, np.eye(3), atol=1e-12
        )
    assert height_interval(solution, "A", confidence=confidence).half_width == 0.0
    assert height_interval(solution, "C", confidence=None).half_width == pytest.approx(0.001)
    assert error_ellipse(solution, "A", "C").semi_axes == (0.0, 0.0)


# -- confidence -----------------------------------------------------------------------------------


def test_factors_at_95_per_cent_are_those_of_the_textbooks():
    factors = [confidence_factor(d, 0.95) for d in (1, 2, 3)]
    assert factors == pytest.approx([1.96, 2.45, 2.80], abs=0.005)


@pytest.mark.parametrize("p", [0.3, 0.6827, 0.95, 0.999])
def test_factors_in_closed_form(p):
    """Normal and Rayleigh quantiles, Maxwell's; with σ̂0 Student's t, and F of two dimensions."""
    assert confidence_factor(1, p) == pytest.approx(scipy.stats.norm.ppf((1 + p) / 2))
    assert confidence_factor(2, p) == pytest.approx(math.sqrt(-2 * math.log(1 - p)))
    assert confidence_factor(3, p) == pytest.approx(scipy.stats.maxwell.ppf(p))
    for r in (1, 2, 5, 40):
        t = scipy.stats.t.ppf((1 + p) / 2, r)
        assert confidence_factor(1, p, redundancy=r) == pytest.approx(t)
        f = math.sqrt(r * ((1 - p) ** (-2 / r) - 1))
        assert confidence_factor(2, p, redundancy=r) == pytest.approx(f)
    for d in (1, 2, 3):
        many = confidence_factor(d, p, redundancy=10**7)
        assert many == pytest.approx(confidence_factor(d, p), rel=1e-5)


@pytest.mark.parametrize("name", [n for names in NETWORKS.values() for n in names])
def test_the_factor_of_an_interval_is_gamas_confidence_scale(name):
    """Normal or t quantile for all its networks; Gama prints 8 digits of an approximation."""
    root = ElementTree.parse(data_dir(FOLDER[name]) / f"{name}.xml").getroot()

    def text(tag: str) -> str:
        return next(e.text or "" for e in root.iter(NAMESPACE + tag))

    estimated = text("used") == "aposteriori"
    factor = confidence_factor(
        1,
        float(text("probability")),
        redundancy=int(text("degrees-of-freedom")) if estimated else None,
    )
    assert factor == pytest.approx(float(text("confidence-scale")), rel=GAMAS_QUANTILES)


GAMAS_QUANTILES = 1e-6
"""Relative: what Gama's series for quantiles is off by. With three redundant observations it prints
3.1824491; t = 3.1824463 (any table of Student's distribution: 3.1824)."""


def vectors(rng: np.random.Generator) -> Network:
    """Return three points, positioned and joined by vectors, 6 redundant; truth (0, 0, 0)."""
    network = Network("vectors")
    root = 1e-3 * np.array([[3.0, 0, 0], [1, 2, 0], [-0.5, 1, 4]])
    for name in "ABC":
        network.add_point(name, (0.0, 0.0, 0.0))
    for name in "AB":
        value = tuple((2 * root @ rng.normal(size=3)).tolist())
        network.add(GnssPosition(name, value, covariance=4 * root @ root.T))
    for a, b in ("AB", "BC"):
        value = tuple((root @ rng.normal(size=3)).tolist())
        network.add(GnssVector(a, b, value, covariance=root @ root.T))
    return network


@pytest.mark.slow(
    "counts 400 adjustments: fewer do not tell 90 % from 75 %; short tests compare the factors "
    "with quantiles"
)
def test_regions_cover_the_truth_as_often_as_they_promise():
    """400 seeded adjustments with three redundant observations; bounds of 3.5 binomial σ.

    With the factor of a known σ0 where σ̂0 is estimated, the 90 % of an ellipse would become 75 %:
    F₂,₃ of half of χ²₂.
    """
    rng = np.random.default_rng(7)
    trials, confidence = 400, 0.9
    inside = np.zeros((2, 6))
    for _ in range(trials):
        known = fga.adjust(vectors(rng))
        assert known.redundancy == 3
        for j, solution in enumerate((known, replace(known, variance="a-posteriori"))):
            inside[j] += covered(solution, "C", None, confidence)
            inside[j] += np.roll(covered(solution, "B", "C", confidence), 3)
    bound = 3.5 * math.sqrt(confidence * (1 - confidence) / trials)
    assert bound < (0.90 - 0.75) / 2
    np.testing.assert_allclose(inside / trials, confidence, rtol=0, atol=bound)


def covered(solution: fga.Solution, a: str, b: str | None, confidence: float) -> Array:
    """Return whether ellipse, ellipsoid and height interval cover the truth, then zeros, (6,)."""
    d = solution.point(a) if b is None else solution.point(b) - solution.point(a)
    ellipse = error_ellipse(solution, a, b, confidence=confidence)
    plan = [along(ellipse.azimuth + t, 0.0) @ d for t in (0.0, math.pi / 2)]
    ellipsoid = error_ellipsoid(solution, a, b, confidence=confidence)
    space = ellipsoid.directions @ d
    height = height_interval(solution, a, b, confidence=confidence)
    out = np.zeros(6)
    out[0] = np.sum((np.array(plan) / ellipse.semi_axes) ** 2) < 1
    out[1] = np.sum((space / ellipsoid.semi_axes) ** 2) < 1
    out[2] = abs(d[2]) < height.half_width
    return out


def test_without_redundancy_an_a_posteriori_solution_has_the_factor_of_a_known_sigma():
    network = Network("one point")
    network.add_point("P", (0, 0, 0))
    network.add(GnssPosition("P", (0, 0, 0), sigma=(0.01,) * 3))
    solution = fga.adjust(network, variance="a-posteriori")
    assert solution.redundancy == 0
    assert error_ellipse(solution, "P").factor == pytest.approx(confidence_factor(2, 0.95))


# -- laws -----------------------------------------------------------------------------------------


def trilateration(angle: float) -> Network:
    """Return a plane network of distances, turned clockwise by an angle."""
    rng = np.random.default_rng(4)
    places = {
        "A": (0.0, 0.0),
        "B": (120.0, 10.0),
        "C": (100.0, 90.0),
        "D": (-10.0, 140.0),
        "E": (300.0, 60.0),
    }
    c, s = math.cos(angle), math.sin(angle)
    network = Network("trilateration", datum="free")
    for name, (x, y) in places.items():
        network.add_point(name, (c * x + s * y, c * y - s * x, 0.0), fixed="z")
    names = list(places)
    for i, a in enumerate(names):
        for b in names[i + 1 :]:
            d = math.dist(places[a], places[b])
            sigma = float(rng.uniform(0.001, 0.004))
            network.add(HorizontalDistance(a, b, d, sigma=sigma))
    return network


def test_a_turned_network_has_turned_ellipses():
    plain, turned = fga.adjust(trilateration(0.0)), fga.adjust(trilateration(0.7))
    pairs: list[tuple[str, str | None]] = [("E", None), ("A", None), ("A", "E"), ("B", "D")]
    for a, b in pairs:
        one, two = error_ellipse(plain, a, b), error_ellipse(turned, a, b)
        assert two.semi_axes == pytest.approx(one.semi_axes, rel=1e-7)
        assert two.azimuth == pytest.approx((one.azimuth + 0.7) % math.pi, abs=1e-7)


def test_relative_figures_do_not_depend_on_the_order_nor_on_the_datum():
    solution = fga.adjust(trilateration(0.0))
    other = s_transform(solution, ("A", "B"))
    one, two = error_ellipse(solution, "C", "E"), error_ellipse(solution, "E", "C")
    assert two.semi_axes == pytest.approx(one.semi_axes, rel=1e-9)
    assert two.azimuth == pytest.approx(one.azimuth, abs=1e-9)
    np.testing.assert_allclose(two.centre, (solution.point("C") + solution.point("E")) / 2)
    # Rotation is part of the datum: across the line the ellipse depends on it, along it not.
    before = distance_precision(solution, "C", "E")
    assert distance_precision(other, "C", "E").sigma == pytest.approx(before.sigma, rel=1e-7)
    assert error_ellipse(other, "C", "E").semi_axes != pytest.approx(one.semi_axes, rel=1e-3)


def test_geocentric_and_topocentric_ellipses_are_the_same():
    """Of the same points 5 and 40 km from the origin, in the horizon of each point."""
    frame = TopocentricFrame(47 * DEGREE, 11 * DEGREE, 250.0)
    geo = frame.geocentric
    _, rows = frame._origin
    rng = np.random.default_rng(5)
    local = Network("topocentric", frame=frame)
    world = Network("geocentric", frame=geo)
    places: dict[str, Array] = {"A": np.array([5e3, 0.0, 60.0]), "B": np.array([-9e3, 4e4, 300.0])}
    for name, at in places.items():
        root = 1e-3 * rng.normal(size=(3, 3))
        q = root @ root.T
        there = geo_coordinates = frame.to_geocentric(at[None])[0]
        local.add_point(name, at)
        world.add_point(name, there)
        local.add(GnssPosition(name, tuple(at), covariance=q))
        world.add(GnssPosition(name, tuple(geo_coordinates), covariance=rows.T @ q @ rows))
    d = rows.T @ (places["B"] - places["A"])
    local.add(GnssVector("A", "B", tuple(places["B"] - places["A"]), sigma=(0.001,) * 3))
    world.add(GnssVector("A", "B", tuple(d), sigma=(0.001,) * 3))
    one, two = fga.adjust(local), fga.adjust(world)
    pairs: list[tuple[str, str | None]] = [("A", None), ("B", None), ("A", "B")]
    for a, b in pairs:
        plane, geocentric = error_ellipse(one, a, b), error_ellipse(two, a, b)
        assert geocentric.semi_axes == pytest.approx(plane.semi_axes, rel=1e-7)
        assert geocentric.azimuth == pytest.approx(plane.azimuth, abs=1e-7)
        space, geocentric_space = error_ellipsoid(one, a, b), error_ellipsoid(two, a, b)
        assert geocentric_space.semi_axes == pytest.approx(space.semi_axes, rel=1e-7)
        assert geocentric_space.azimuths == pytest.approx(space.azimuths, abs=1e-6)
        assert geocentric_space.dips == pytest.approx(space.dips, abs=1e-6)
        heights = (height_interval(s, a, b).half_width for s in (one, two))
        assert next(heights) == pytest.approx(next(heights), rel=1e-7)
    # 40 km away the horizon is 6 mrad tilted: in the axes of the origin it is another ellipse.
    flat = one.covariance("B")[:2, :2]
    largest = math.sqrt(float(np.linalg.eigvalsh(flat)[1]))
    assert error_ellipse(one, "B", confidence=None).semi_axes[0] != pytest.approx(largest, rel=1e-4)


def test_ellipsoid_and_ellipse_hold_the_whole_covariance():
    solution = fga.adjust(small_block())
    every = zip(error_ellipsoids(solution, confidence=None), solution.network.points, strict=True)
    for ellipsoid, name in every:
        axes = ellipsoid.directions.T * ellipsoid.semi_axes
        q = solution.covariance(name)
        np.testing.assert_allclose(axes @ axes.T, q, rtol=0, atol=1e-9 * q.max())
    for ellipse in error_ellipses(solution, confidence=None):
        a, b = (along(ellipse.azimuth + t, 0.0)[:2] for t in (0.0, math.pi / 2))
        big, small = ellipse.semi_axes
        q = solution.covariance(str(ellipse.a))[:2, :2]
        found = big**2 * np.outer(a, a) + small**2 * np.outer(b, b)
        np.testing.assert_allclose(found, q, rtol=0, atol=1e-9 * max(q.max(), 1e-30))


# -- relative -------------------------------------------------------------------------------------


def test_the_relative_ellipse_of_two_points_is_that_of_the_vector_between_them():
    """A ± 5 cm, a vector of some mm to B: absolute errors add up, the relative one is its own."""
    network = Network("vector")
    network.add_point("A", (0, 0, 0))
    network.add_point("B", (100, 0, 0))
    network.add(GnssPosition("A", (0, 0, 0), sigma=(0.05, 0.05, 0.05)))
    q = turned_plan(70 * DEGREE, 0.004, 0.002)
    network.add(GnssVector("A", "B", (100, 0, 0), covariance=q))
    solution = fga.adjust(network)
    relative = error_ellipse(solution, "A", "B", confidence=None)
    assert relative.semi_axes == pytest.approx((0.004, 0.002), rel=1e-7)
    assert relative.azimuth == pytest.approx(70 * DEGREE, abs=1e-7)
    assert (relative.a, relative.b) == ("A", "B")
    absolute = error_ellipse(solution, "B", confidence=None)
    assert absolute.semi_axes == pytest.approx(
        (math.hypot(0.05, 0.004), math.hypot(0.05, 0.002)), rel=1e-7
    )
    assert height_interval(solution, "A", "B", confidence=None).sigma == pytest.approx(0.001)


PLACES: tuple[Place, ...] = ("P3", "P8", "S2", "S1", ("pose", "F1"), ("pose", "F4"))


@pytest.mark.parametrize("a", PLACES, ids=str)
def test_points_and_projection_centres_against_a_dense_inverse(a):
    """Every pair, with all cross-covariances; S1 is held, S2 partly."""
    solution = fga.adjust(small_block())
    dense = Dense.at(solution.equations, solution.state)
    q = dense.cofactor(np.zeros(solution.equations.unknowns.n_columns, dtype=bool))

    def picked(place: Place) -> Array:
        kind, name = ("point", place) if isinstance(place, str) else place
        number = solution.number(kind, name)
        columns = solution.equations.unknowns.columns(kind, number)[-3:]
        out = np.zeros((3, len(q)))
        out[np.arange(len(columns)), columns] = 1.0
        return out

    for b in PLACES:
        if a == b:
            continue
        d = picked(b) - picked(a)
        expected = np.sqrt(np.maximum(np.linalg.eigvalsh(d @ q @ d.T)[::-1], 0.0))
        found = error_ellipsoid(solution, a, b, confidence=None).semi_axes
        assert found == pytest.approx(expected.tolist(), rel=1e-6, abs=1e-9)
    own = np.sqrt(np.maximum(np.linalg.eigvalsh(picked(a) @ q @ picked(a).T)[::-1], 0.0))
    found = error_ellipsoid(solution, a, confidence=None).semi_axes
    assert found == pytest.approx(own.tolist(), rel=1e-6, abs=1e-12)


def test_a_projection_centre_lies_where_the_photo_says():
    solution = fga.adjust(small_block())
    ellipse = error_ellipse(solution, ("pose", "F2"))
    np.testing.assert_array_equal(ellipse.centre, solution.pose("F2").position)
    (same,) = error_ellipses(solution, [("pose", "F2")])
    assert same.semi_axes == ellipse.semi_axes


# -- many at once ---------------------------------------------------------------------------------


def test_many_ellipses_are_the_same_as_one_by_one():
    solution = fga.adjust(small_block(), variance="a-posteriori")
    places: list[Place] = ["P5", ("pose", "F3"), "P1", "S1"]
    for one, many in zip(places, error_ellipses(solution, places), strict=True):
        single = error_ellipse(solution, one)
        assert many.a == one
        assert many.semi_axes == pytest.approx(single.semi_axes, rel=1e-9, abs=1e-15)
        assert many.azimuth == pytest.approx(single.azimuth, abs=1e-7)
    for one, many in zip(places, error_ellipsoids(solution, places), strict=True):
        assert many.semi_axes == pytest.approx(error_ellipsoid(solution, one).semi_axes, rel=1e-9)
    for one, many in zip(places, height_intervals(solution, places), strict=True):
        assert many.half_width == pytest.approx(height_interval(solution, one).half_width)
    assert error_ellipses(solution, []) == ()
    assert [e.a for e in error_ellipses(solution)] == list(solution.network.points)


def test_many_ellipses_need_no_solution_of_the_normal_equations(monkeypatch):
    solution = fga.adjust(small_block())
    assert 0.0 < solution.factor.uncertainty < 1e-9  # its probes, once for all, are solutions

    def refuse(self: Factorisation, y: Array) -> Array:
        raise AssertionError("solved")

    monkeypatch.setattr(Factorisation, "solve", refuse)
    assert len(error_ellipses(solution)) == 14
    assert len(error_ellipsoids(solution, ["P1", ("pose", "F1")])) == 2


# -- distances ------------------------------------------------------------------------------------


def test_a_measured_distance_is_as_precise_as_measured():
    network = Network("distance")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (300, 400, 0), fixed="yz")
    network.add(SlopeDistance("A", "B", 500.0, sigma=0.002))
    found = distance_precision(fga.adjust(network), "A", "B")
    assert found.distance == pytest.approx(500.0)
    assert found.sigma == pytest.approx(0.002)
    assert found.ratio == pytest.approx(250_000)
    assert found.ppm == pytest.approx(4.0)


def test_correlated_points_have_a_precise_distance():
    """Both ends ± 1 cm with a correlation of 0.98: √(1 + 1 − 1.96) cm = 2 mm along the line."""
    network = Network("pair")
    network.add_point("A", (0, 0, 0))
    network.add_point("B", (0, 0, 50))
    q = 1e-4 * np.kron([[1.0, 0.98], [0.98, 1.0]], np.eye(3))
    pair = (
        GnssPosition("A", (0, 0, 0), sigma=(0.01,) * 3),
        GnssPosition("B", (0, 0, 50), sigma=(0.01,) * 3),
    )
    network.add(Correlated(pair, q))
    found = distance_precision(fga.adjust(network), "B", "A")
    assert found.sigma == pytest.approx(0.002, rel=1e-9)
    assert found.ratio == pytest.approx(25_000)


def test_between_held_points_the_ratio_is_infinite():
    network = small_block()
    network.points["S2"] = replace(network.points["S2"], fixed=(True,) * 3, sigma=None)
    found = distance_precision(fga.adjust(network), "S1", "S2")
    assert (found.sigma, found.ratio, found.ppm) == (0.0, math.inf, 0.0)


# -- published ------------------------------------------------------------------------------------

SIGMAS = 1e-5
"""Relative: what Comp3D's standard deviations differ by from ours, see test_comp3d."""
TILT = 150.0 / 6.37e6
"""Radians: the horizon of a point 150 m away from the origin, in whose axes Comp3D computes."""


def test_the_ellipsoids_of_comp3d():
    """85 points, 255 axes; a variance that is off by a part ε turns axes by ε λ/(λ₁ − λ₂)."""
    published = comp3d.read_ellipsoids(data_dir("comp3d_topo") / "ex_ref.comp")
    solution = fga.adjust(network_of_topo(), variance="a-posteriori")
    compared = 0
    for ellipsoid in error_ellipsoids(solution, confidence=None):
        axes = published[str(ellipsoid.a)].axes
        assert ellipsoid.semi_axes == pytest.approx(axes[:, 0].tolist(), rel=SIGMAS)
        variances = np.array(ellipsoid.semi_axes) ** 2
        for i in range(3):
            gap = np.abs(np.delete(variances, i) - variances[i]).min() / variances[i]
            if gap < 100 * SIGMAS:
                continue
            # Either end of the axis, and either sign of its inclination: see above.
            both = [along(axes[i, 1] * GON, sign * axes[i, 2] * GON) for sign in (1, -1)]
            ours = along(ellipsoid.azimuths[i], ellipsoid.dips[i])
            off = min(np.linalg.norm(np.cross(ours, theirs)) for theirs in both)
            assert off < TILT + 2 * SIGMAS / gap
            compared += 1
    assert len(published) == 85
    assert compared > 240


def test_the_printed_axes_of_comp3d_are_perpendicular_only_with_other_signs():
    """Point HLLPI0022, its second and third axis: 12 gon off a right angle as printed."""
    axes = comp3d.read_ellipsoids(data_dir("comp3d_topo") / "ex_ref.comp")["HLLPI0022"].axes
    printed = [along(azimuth, -up) for azimuth, up in axes[:, 1:] * GON]
    assert abs(printed[1] @ printed[2]) > 0.2
    changed = along(axes[1, 1] * GON, axes[1, 2] * GON)
    assert abs(changed @ printed[2]) < 1e-6


def test_the_ellipses_of_gama():
    """Wolf, Ausgleichungsrechnung II: nine points, σ0 a posteriori, free network."""
    name = "Wolf_DistanceDirectionAngle_free"
    case = solved(name)
    root = ElementTree.parse(data_dir(FOLDER[name]) / f"{name}.xml").getroot()
    printed = list(root.iter(f"{NAMESPACE}ellipse"))
    assert len(printed) == 9
    for element in printed:
        values = {e.tag.removeprefix(NAMESPACE): e.text or "" for e in element}
        ellipse = error_ellipse(case.solution, values["id"].strip(), confidence=None)
        mm = (float(values["major"]), float(values["minor"]))
        assert [a / MM for a in ellipse.semi_axes] == pytest.approx(mm, rel=LINEARISED)
        azimuth = (float(values["alpha"]) + math.pi / 2) % math.pi
        ratio = mm[1] ** 2 / (mm[0] ** 2 - mm[1] ** 2)
        assert ellipse.azimuth == pytest.approx(azimuth, abs=2 * LINEARISED * (1 + ratio))


LINEARISED = 2e-7
"""Relative: Gama's covariances belong to the coordinates before its last step, which moves points
by up to 0.2 mm in sights of 1 to 3 km: see test_gama."""


@LONG
def test_the_ellipsoids_of_aicon_have_the_published_variances():
    """150 points: the squares of the semi-axes sum to sX² + sY² + sZ² as published."""
    folder = data_dir("aicon_jaicov")
    solution = fga.adjust(read_aicon(folder), variance="a-posteriori")
    names, values = point_reference(folder)
    published = dict(zip(names, values[:, 3:], strict=True))
    compared = 0
    for ellipsoid in error_ellipsoids(solution, confidence=None):
        sigmas = published[str(ellipsoid.a)]
        size = math.sqrt(sum(s * s for s in ellipsoid.semi_axes))
        assert size == pytest.approx(float(np.linalg.norm(sigmas)), abs=3**0.5 * 0.5e-6 * MM)
        compared += 1
    assert compared == 150


# -- what is wrong --------------------------------------------------------------------------------


def test_places_and_probabilities_that_are_wrong_are_named():
    solution = fga.adjust(small_block())
    wrong: list[tuple[Callable[[], object], str]] = [
        (lambda: error_ellipse(solution, "X"), "unknown point 'X'; known: S1"),
        (lambda: error_ellipse(solution, ("pose", "X")), "unknown photo 'X'; known: F1"),
        (lambda: error_ellipse(solution, ("photo", "F1")), r"must be the name of a point, or"),
        (lambda: error_ellipse(solution, "P1", "P1"), "point 'P1': a difference needs two places"),
        (lambda: error_ellipsoid(solution, "P1", confidence=1.0), "between 0 and 1"),
        (lambda: error_ellipses(solution, confidence=95), "between 0 and 1"),
        (lambda: error_ellipses(solution, "P1"), "must be a list, not the one name 'P1'"),
        (lambda: confidence_factor(2, 0.9, redundancy=0), "needs redundant observations"),
        (lambda: distance_precision(solution, "P1", "P1"), "needs two places"),
    ]
    for call, message in wrong:
        with pytest.raises(fga.InputError, match=message):
            call()
    with pytest.raises(fga.InputError) as error:
        error_ellipses(solution, ["X", "P1", ("pose", "Y")])
    assert len(error.value.problems) == 2


def test_places_that_coincide_have_no_distance():
    network = Network("twice")
    network.add_point("A", (1, 2, 3), fixed="xyz")
    network.add_point("B", (1, 2, 3), fixed="xyz")
    network.add_point("C", (1, 2, 5), fixed="xy")
    network.add(HeightDifference("A", "C", 2.0, sigma=0.01))
    with pytest.raises(fga.InputError, match="point 'A': has the coordinates of point 'B'"):
        distance_precision(fga.adjust(network), "A", "B")
