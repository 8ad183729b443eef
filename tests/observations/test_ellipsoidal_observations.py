"""Distances, azimuths and heights on the ellipsoid against geodesics and independent formulas."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations.ellipsoidal_observations import (
    ellipsoid_distance,
    ellipsoid_height_difference,
    geodetic_azimuth,
)
from factorgraph_adj.types import Array

TENTH_MM = 1e-4
FRAME = GeocentricFrame()
NO_METER = np.zeros((1, 2))


def place(latitude: float, longitude: float, height: float) -> Array:
    at = np.radians([latitude]), np.radians([longitude]), np.array([height])
    return np.asarray(FRAME.ellipsoid.to_cartesian(*at))


def distance(a: Array, b: Array, n: tuple[float, float] = (0.0, 0.0), chord: bool = False) -> float:
    options = {"station_surface": np.array(n[:1]), "target_surface": np.array(n[1:])}
    found = ellipsoid_distance(
        FRAME,
        a,
        b,
        NO_METER,
        observed=np.zeros((1, 1)),
        along_chord=np.array([float(chord)]),
        **options,
    )
    return float(found.residual[0, 0])


@pytest.mark.parametrize("azimuth", [0.0, 37.0, 90.0, 211.0])
@pytest.mark.parametrize("length", [50.0, 20e3, 100e3])
@pytest.mark.parametrize("latitude", [-37.8, 3.0, 68.0])
def test_an_arc_is_the_geodesic(latitude: float, length: float, azimuth: float) -> None:
    """Karney's geodesics; heights of the points do not matter."""
    geod = pytest.importorskip("pyproj").Geod(ellps="GRS80")
    lon, lat, _ = geod.fwd(145.0, latitude, azimuth, length)
    found = distance(place(latitude, 145.0, 870.0), place(lat, lon, 12.0))
    assert found == pytest.approx(length, abs=TENTH_MM)


def test_a_chord_is_that_of_the_feet() -> None:
    feet = place(-36.0, 145.0, 0.0), place(-36.2, 145.3, 0.0)
    a, b = place(-36.0, 145.0, 1500.0), place(-36.2, 145.3, 300.0)
    assert distance(a, b, chord=True) == pytest.approx(np.linalg.norm(feet[1] - feet[0]), abs=1e-8)


def test_a_distance_at_sea_level_is_longer_by_the_undulation() -> None:
    """On a sphere of the radius r a length at the height N is longer by N/r."""
    a, b = place(45.0, 7.0, 1500.0), place(45.0, 7.2, 300.0)
    on, at_sea = distance(a, b), distance(a, b, (48.0, 48.0))
    r = float(FRAME.ellipsoid.radii(np.radians(45.0))[1])  # an arc to the east
    assert at_sea / on == pytest.approx(1.0 + 48.0 / r, abs=1e-9)


def test_a_geodetic_azimuth_does_not_know_of_deflections() -> None:
    """It is that of the normal section, to which the deflections of the ends say nothing."""
    a, b = place(-37.8, 144.95, 40.0), place(-37.81, 144.99, 0.0)
    tilted = np.array([[-7.0, -4.0]]) / 206264.8
    more = {name: np.zeros(1) for name in ("instrument_height", "target_height")}
    with_tilt = geodetic_azimuth(FRAME, a, tilted, b, tilted, observed=np.zeros((1, 1)), **more)
    without = geodetic_azimuth(FRAME, a, 0 * tilted, b, tilted, observed=np.zeros((1, 1)), **more)
    assert with_tilt.residual[0, 0] == without.residual[0, 0]
    geod = pytest.importorskip("pyproj").Geod(ellps="GRS80")
    forward, _, _ = geod.inv(144.95, -37.8, 144.99, -37.81)
    # A target on the ellipsoid, 3.7 km away: geodesic and normal section differ by less than 1e-4".
    assert math.degrees(with_tilt.residual[0, 0]) == pytest.approx(forward, abs=2e-4 / 3600)


@pytest.mark.parametrize("frame", [FRAME, TopocentricFrame(math.radians(-36), math.radians(145))])
def test_height_differences_are_those_of_ellipsoidal_heights(frame: fga.Frame) -> None:
    """60 km apart ½ (u_i + u_j)·d is wrong by millimetres; this difference is exact."""
    a, b = place(-36.0, 145.0, 100.0), place(-36.4, 145.4, 900.0)
    if isinstance(frame, TopocentricFrame):
        a, b = frame.from_geocentric(a), frame.from_geocentric(b)
    flat, more = np.zeros((1, 2)), {}
    for name, value in (("instrument_height", 1.5), ("target_height", 1.2),
                        ("station_surface", 4.0), ("target_surface", 4.5)):  # fmt: skip
        more[name] = np.array([value])
    found = ellipsoid_height_difference(frame, a, flat, b, flat, observed=np.zeros((1, 1)), **more)
    assert found.residual[0, 0] == pytest.approx(800.0 - 0.3 - 0.5, abs=1e-7)


def test_a_flat_local_frame_has_distances_in_plan() -> None:
    network = fga.Network(frame=LocalFrame())
    network.add_point("A", (0.0, 0.0, 10.0), fixed="xyz")
    network.add_point("B", (30.0, 41.0, 25.0), fixed="xz")
    network.add(fga.EllipsoidDistance("A", "B", 50.0, sigma=0.01))
    assert fga.adjust(network).point("B") == pytest.approx([30.0, 40.0, 25.0])


def test_a_trilaterated_point_on_the_ellipsoid() -> None:
    """Chords, an azimuth and a height give the place from which they were computed."""
    true = place(-36.1, 145.2, 321.0)[0]
    network = fga.Network(frame=FRAME)
    for name, at in (("A", (-36.0, 145.0)), ("B", (-36.3, 145.1))):
        network.add_point(name, place(*at, 50.0)[0], fixed="xyz")
    network.add_point("P", true + np.array([30.0, -20.0, 10.0]))
    for name in "AB":
        a = np.array([network.points[name].coordinates])
        d = distance(a, true[None], (12.0, 13.0))
        network.add(
            fga.EllipsoidDistance(name, "P", d, sigma=0.01, station_surface=12.0, target_surface=13)
        )
    network.add(fga.EllipsoidHeight("P", 308.0, sigma=0.01, surface=13.0))
    assert fga.adjust(network).point("P") == pytest.approx(true, abs=1e-6)


def mean_height(a: Array, b: Array, heights: tuple[float, float] = (0.0, 0.0)) -> float:
    network = fga.Network(frame=FRAME)
    network.add_point("A", a[0])
    network.add_point("B", b[0])
    network.set_distance_meter("tape", scale=1e-4, zero=0.5)
    for meter in (None, "tape"):
        network.add(
            fga.MeanHeightDistance(
                *("A", "B", 1.0),
                sigma=0.01,
                instrument=meter,
                instrument_height=heights[0],
                target_height=heights[1],
            )
        )
    equations = compile_network(network)
    (block,) = equations.blocks
    plain, metered = (block.evaluate(FRAME, equations.unknowns.start())[0] + 1.0).ravel()
    assert metered == pytest.approx(1.0001 * plain + 0.5, abs=1e-9)
    return float(plain)


def test_a_distance_at_the_mean_height_does_not_depend_on_which_end_is_high() -> None:
    """1 km with a rise of 200 m: the chord of both places at 200 m."""
    low, high = place(-41.0, 173.0, 100.0), place(-41.0, 173.0119, 300.0)
    level = place(-41.0, 173.0, 200.0), place(-41.0, 173.0119, 200.0)
    chord = float(np.linalg.norm(level[1] - level[0]))
    assert mean_height(low, high) == pytest.approx(chord, abs=1e-8)
    assert mean_height(high, low) == pytest.approx(chord, abs=1e-8)


def test_heights_of_instrument_and_target_raise_the_mean_height() -> None:
    """4 m of both are 2 m of the mean height: c · 2 m/R, R the radius of an arc to the east."""
    low, high = place(-41.0, 173.0, 100.0), place(-41.0, 173.0119, 300.0)
    chord, raised = mean_height(low, high), mean_height(low, high, (1.5, 2.5))
    radius = float(FRAME.ellipsoid.radii(np.radians(-41.0))[1]) + 200.0
    assert raised - chord == pytest.approx(2.0 * chord / radius, abs=1e-7)


def test_lines_are_arcs_or_chords() -> None:
    with pytest.raises(fga.InputError, match="line must be arc or chord, not 'loxodrome'"):
        fga.EllipsoidDistance("A", "B", 1.0, sigma=0.1, line="loxodrome")
