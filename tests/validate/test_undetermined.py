"""Points that their stations leave undetermined, or at either of two places."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, HorizontalDistance, SlopeDistance, ZenithAngle
from tests.networks.building_site import site
from tests.networks.three_frames import STATION, room, three_frames

STATIONS = {"A": (0, 0, 10), "B": (50, 0, 10), "C": (20, 60, 10), "D": (70, 40, 10)}
"""Four stations of one height."""


def observed(
    at: Sequence[float], kinds: str, stations: str = "ABCD", *, plan: bool = False
) -> fga.Network:
    """Return a point P observed from stations without errors: s, h, z, d for each kind."""
    network = fga.Network("a point")
    for name, xyz in STATIONS.items():
        network.add_point(name, xyz, fixed="xyz")
    network.add_point("P", tuple(map(float, at)), fixed="z" if plan else "")
    for name in stations:
        for target in ("P", "C") if "d" in kinds else ("P",):
            to = at if target == "P" else STATIONS[target]
            d = np.subtract(to, STATIONS[name])
            length = float(np.linalg.norm(d))
            if target == "P" and "s" in kinds:
                network.add(SlopeDistance(name, "P", length, sigma=0.002))
            if target == "P" and "h" in kinds:
                network.add(HorizontalDistance(name, "P", float(np.hypot(*d[:2])), sigma=0.002))
            if target == "P" and "z" in kinds:
                network.add(ZenithAngle(name, "P", float(np.arccos(d[2] / length)), sigma=1.5e-5))
            if "d" in kinds:
                azimuth = float(np.arctan2(d[0], d[1]) % (2 * np.pi))
                network.add(Direction(name, target, azimuth, sigma=1.5e-5))
    return network


def told(network: fga.Network) -> list[str]:
    """Return what the preliminary checks say of the geometry of points."""
    return [str(f) for f in fga.preliminary(network) if "by the given coordinates" in f.what]


@pytest.mark.parametrize(
    ("at", "kinds", "stations", "plan", "line"),
    [
        ((30, 20, 10), "s", "ABCD", False, "determines it not in height"),
        ((30, 20, 10.05), "s", "ABCD", False, "determines it hardly in height"),
        ((30, 20, 10.2), "s", "ABCD", False, "fits as well near (30.00, 20.00, 9.8"),
        ((30, 20, 10.5), "s", "ABCD", False, "fits as well near (30.00, 20.00, 9.5"),
        ((30, 0, 10), "h", "AB", True, "determines it not along east 0.00, north 1.00, up 0.00"),
        ((30, 0.3, 10), "h", "AB", True, "fits as well near (30.00, -0."),
        ((30, 0, 10), "d", "AB", True, "determines it not along east 1.00, north 0.00, up 0.00"),
        ((30, 0.02, 10), "d", "AB", True, "determines it hardly along east 1.00, north 0.00"),
    ],
)
def test_a_point_in_the_plane_or_line_of_its_stations_is_told(
    at, kinds: str, stations: str, plan: bool, line: str
) -> None:
    (found,) = told(observed(at, kinds, stations, plan=plan))
    assert f"point 'P' {line}" in found


@pytest.mark.parametrize(
    ("at", "kinds", "stations", "plan"),
    [
        ((30, 20, 25), "s", "ABCD", False),  # the second place is 30 m below
        ((30, 20, 10), "sz", "ABCD", False),
        ((30, 20, 10), "dz", "ABD", False),
        ((30, 30, 10), "h", "AB", True),
        ((30, 30, 10), "d", "AB", True),
        ((30, 0, 10), "dh", "AB", True),
    ],
)
def test_a_point_that_is_determined_is_not(at, kinds: str, stations: str, plan: bool) -> None:
    assert not told(observed(at, kinds, stations, plan=plan))


def test_the_second_place_is_one() -> None:
    """All readings fit there as well: an adjustment from there ends there."""
    network = observed((30, 20, 10.5), "s")
    other = network.copy()
    other.points["P"] = replace(network.points["P"], coordinates=(30.0, 20.0, 9.5))
    here, there = fga.adjust(network), fga.adjust(other)
    assert here.point("P")[2] == pytest.approx(10.5) and here.vtpv < 1e-6
    assert there.point("P")[2] == pytest.approx(9.5) and there.vtpv < 1e-6


def test_what_is_not_determined_cannot_be_adjusted() -> None:
    with pytest.raises(fga.AdjustmentError):
        fga.adjust(observed((30, 0, 10), "d", "AB", plan=True))


def test_a_point_beside_one_without_coordinates_is_left_out() -> None:
    """Nobody knows what the sights to it determine."""
    network = observed((30, 20, 10), "s")
    network.add_point("N")
    network.add(SlopeDistance("N", "P", 20.0, sigma=0.002))
    assert not told(network)


def test_a_weighted_coordinate_counts_unless_it_says_nothing() -> None:
    for sigma, lines in ((0.5, 0), (1000.0, 1)):
        network = observed((30, 20, 10), "s")
        point = network.points["P"]
        network.points["P"] = replace(point, sigma=(np.inf, np.inf, sigma))
        assert len(told(network)) == lines


def test_nothing_is_told_of_building_sites() -> None:
    for seed in range(20):
        network, readings, _ = site(seed)
        network.add(*readings)
        assert not told(network)


def test_frames_at_a_point_without_given_rotation_say_nothing_of_other_points() -> None:
    """All points have coordinates, the station and its direction are not known yet."""
    network = three_frames()
    for name, x in room().items():
        network.points[name] = replace(network.points[name], coordinates=tuple(x.tolist()))
    network.points["T"] = replace(network.points["T"], coordinates=tuple(STATION.tolist()))
    assert fga.adjust(network).converged
    assert not told(network)
