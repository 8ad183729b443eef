"""Places and vectors on the Earth in other axes: told by what else is given."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.frames import GeocentricFrame, TopocentricFrame
from factorgraph_adj.observations import GnssVector, SlopeDistance
from factorgraph_adj.types import Array

EARTH = GeocentricFrame()
PLACES = {"A": (48.10, 11.50), "B": (48.16, 11.62), "C": (48.05, 11.66), "D": (48.12, 11.41)}
"""Latitudes and longitudes, degrees."""


def at(latitude: float, longitude: float, height: float = 500.0) -> Array:
    """Return a geocentric place (3,), metres."""
    place = np.array([latitude]), np.array([longitude])
    return EARTH.ellipsoid.to_cartesian(*map(np.deg2rad, place), np.array([height]))[0]


def told(network: fga.Network) -> str:
    """Return everything that the preliminary checks say."""
    return "\n".join(map(str, fga.preliminary(network)))


def vectors(network: fga.Network, turn: Array | None = None) -> fga.Network:
    """Add the vectors between all places, turned by a matrix."""
    names = list(PLACES)
    for a, b in zip(names, [*names[1:], names[0]], strict=True):
        d = (np.eye(3) if turn is None else turn) @ (at(*PLACES[b]) - at(*PLACES[a]))
        network.add(GnssVector(a, b, tuple(d.tolist()), sigma=(0.005,) * 3))
    return network


def geocentric(exchanged: str = "") -> fga.Network:
    """Return the places in a geocentric frame, some with latitude and longitude exchanged."""
    network = fga.Network("geocentric", frame=EARTH)
    for name, (latitude, longitude) in PLACES.items():
        place = at(longitude, latitude) if name in exchanged else at(latitude, longitude)
        network.add_point(name, tuple(place.tolist()), fixed="xyz" if name in "AB" else "")
    return network


def test_nothing_is_told_of_right_places() -> None:
    assert not told(vectors(geocentric()))


@pytest.mark.parametrize("exchanged", ["C", "A"])
def test_a_point_with_latitude_and_longitude_exchanged_is_far_from_the_others(exchanged) -> None:
    found = told(vectors(geocentric(exchanged)))
    assert found.startswith("1 point, far away as given, would be among the others")
    assert f"exchanged: {exchanged}: " in found and len(found.splitlines()) == 1


def test_all_points_exchanged_contradict_the_vectors() -> None:
    found = told(vectors(geocentric("ABCD")))
    assert "times better with latitude and longitude of all points exchanged" in found
    assert len(found.splitlines()) == 1


def test_of_two_points_the_observed_length_tells() -> None:
    for exchanged, lines in (("", 0), ("B", 1)):
        network = fga.Network("two", frame=EARTH)
        for name in "AB":
            latitude, longitude = PLACES[name]
            place = at(longitude, latitude) if name in exchanged else at(latitude, longitude)
            network.add_point(name, tuple(place.tolist()), fixed="xyz")
        length = float(np.linalg.norm(at(*PLACES["B"]) - at(*PLACES["A"])))
        network.add(SlopeDistance("A", "B", length, sigma=0.01))
        found = told(network)
        assert len(found.splitlines()) == lines
        if lines:
            assert "or what they were measured to, would fit the observed lengths" in found


def test_a_network_over_continents_is_not_told() -> None:
    """Points that are thousands of kilometres apart, one of them near its mirror image."""
    network = fga.Network("continents", frame=EARTH)
    places = {"Wien": (48, 16), "Nairobi": (-1, 37), "Ankara": (40, 33), "Rabat": (34, -7)}
    for name, place in places.items():
        network.add_point(name, tuple(at(*place).tolist()), fixed="xyz")
    for name in ("Nairobi", "Ankara", "Rabat"):
        d = at(*places[name]) - at(*places["Wien"])
        network.add(GnssVector("Wien", name, tuple(d.tolist()), sigma=(0.01,) * 3))
    assert not told(network)


@pytest.mark.parametrize("kind", ["topocentric", "geocentric"])
def test_vectors_in_the_axes_of_the_other_frame_are_told_by_their_sums(kind: str) -> None:
    """Only A and C are given: the vectors between them have one end each that is not."""
    frame = TopocentricFrame(*np.deg2rad(PLACES["A"]).tolist(), 500.0)
    rows = frame.from_geocentric(frame.to_geocentric(np.zeros((1, 3))) + np.eye(3)).T
    mine = frame if kind == "topocentric" else EARTH
    network = fga.Network(kind, frame=mine)
    for name, place in PLACES.items():
        inside = at(*place) if mine is EARTH else frame.from_geocentric(at(*place)[None, :])[0]
        network.add_point(name, tuple(inside.tolist()) if name in "AC" else None)
    wrong, right = (np.eye(3), rows) if mine is frame else (rows, np.eye(3))
    assert not told(vectors(network.copy(), right))
    found = told(vectors(network.copy(), wrong))
    other = "geocentric X, Y, Z, in a topocentric" if mine is frame else "east, north, up, in a geo"
    assert f"times better as {other}" in found and len(found.splitlines()) == 1
