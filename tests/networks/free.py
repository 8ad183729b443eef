"""Free networks of every datum defect, each with two choices of datum points."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np

import factorgraph_adj as fga
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Azimuth,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    SlopeDistance,
)
from tests.networks.every_kind import FRAMES
from tests.networks.frames import SORTS, network_of_frames
from tests.networks.small_block import images_only, small_block
from tests.networks.total_station import total_station

MILLIMETRE = 1e-3


def with_datum(network: Network, names: tuple[str, ...]) -> Network:
    """Return the network as a free one with other datum points."""
    out = network.copy()
    out.datum = "free"
    for name, point in out.points.items():
        out.points[name] = replace(point, datum=name in names)
    return out


def freed(network: Network) -> Network:
    """Return the network with nothing held or weighted but its dimension."""
    out = network.copy()
    for name, point in out.points.items():
        out.points[name] = replace(point, fixed=(False,) * 3, sigma=None)
    for name, photo in out.photos.items():
        out.photos[name] = replace(
            photo, fixed=(False,) * 6, sigma_position=None, sigma_attitude=None
        )
    return out


def without_scale(network: Network) -> Network:
    """Return the network with a distance meter of unknown scale: one defect more."""
    network.set_distance_meter("new", free=("scale",))
    for ident, o in network.observations.items():
        if isinstance(o, SlopeDistance):
            network.observations[ident] = replace(o, instrument="new")
    return network


def levelled() -> Network:
    rng = np.random.default_rng(1)
    network = Network("levelling")
    heights = dict(zip("ABCDE", (10.0, 12.5, 11.0, 15.2, 9.1), strict=True))
    for name, z in heights.items():
        network.add_point(name, (0.0, 0.0, z + 0.01 * rng.normal()), fixed="xy")
    for a, b in combinations(heights, 2):
        dh = heights[b] - heights[a] + MILLIMETRE * rng.normal()
        network.add(HeightDifference(a, b, dh, sigma=MILLIMETRE))
    return network


PLANE = {
    "A": (0.0, 0.0),
    "B": (110.0, 20.0),
    "C": (90.0, 130.0),
    "D": (-20.0, 95.0),
    "E": (50.0, 60.0),
}


def plane(*, distances: bool = True, azimuth: bool = False) -> Network:
    """Return a plane network of all angles, and distances; heights are not looked at."""
    rng = np.random.default_rng(2)
    network = Network("plane")
    x = {n: np.array(p) for n, p in PLANE.items()}
    for name, p in x.items():
        network.add_point(name, (*(p + 0.01 * rng.normal(size=2)), 0.0), fixed="z")

    def bearing(a: str, b: str) -> float:
        return float(np.arctan2(*(x[b] - x[a])))

    for a in x:
        others = [n for n in x if n != a]
        for b, c in combinations(others, 2):
            angle = bearing(a, c) - bearing(a, b) + 1e-5 * rng.normal()
            network.add(HorizontalAngle(a, b, c, angle % (2 * np.pi), sigma=1e-5))
    for a, b in combinations(x, 2):
        if distances:
            d = float(np.linalg.norm(x[b] - x[a])) + MILLIMETRE * rng.normal()
            network.add(HorizontalDistance(a, b, d, sigma=MILLIMETRE))
    if azimuth:
        network.add(Azimuth("A", "C", bearing("A", "C") % (2 * np.pi), sigma=1e-5))
    return network


def gnss() -> Network:
    """Return vectors between points near a place on the Earth, geocentric."""
    rng = np.random.default_rng(3)
    frame, place = FRAMES["geocentric"]
    network = Network("gnss", frame=frame)
    points = {n: place + 2000.0 * rng.normal(size=3) for n in "ABCDE"}
    for name, at in points.items():
        network.add_point(name, at + 0.02 * rng.normal(size=3))
    root = 1e-3 * rng.normal(size=(3, 3)) + 3e-3 * np.eye(3)
    for a, b in combinations(points, 2):
        value = points[b] - points[a] + root @ rng.normal(size=3)
        network.add(GnssVector(a, b, tuple(value.tolist()), covariance=root @ root.T))
    return network


CORNERS = ("P0", "P1", "P2"), ("P3", "P4", "P5", "P6")
"""Two choices of datum points of networks of frames."""

FREE: dict[str, tuple[Callable[[], Network], int, tuple[str, ...], tuple[str, ...]]] = {
    "total station": (
        lambda: total_station(1, coarse=0.3),
        4,
        ("P0", "P1", "P2", "P4"),
        ("P3", "P5", "P6"),
    ),
    "total station, free verticals": (
        lambda: total_station(1, coarse=0.3, verticals=True),
        6,
        ("P0", "P1", "P2"),
        ("P2", "P3", "P5", "P6"),
    ),
    "total station, free scale": (
        lambda: without_scale(total_station(2, coarse=0.02)),
        5,
        ("P0", "P1"),
        ("P4", "P5"),
    ),
    "images": (images_only, 7, ("P1", "P2", "P7"), ("P4", "P5", "P9", "P12")),
    "images and terrestrial": (lambda: freed(small_block()), 4, ("S1", "S2"), ("P1", "P7", "P9")),
    "levelling": (levelled, 1, ("A",), ("C", "D")),
    "plane": (plane, 3, ("A", "B"), ("C", "D", "E")),
    "plane angles": (lambda: plane(distances=False), 4, ("A", "B"), ("C", "D", "E")),
    "gnss": (gnss, 3, ("A",), ("B", "C", "D")),
    "models": (lambda: network_of_frames(1, ("model",) * 3), 7, *CORNERS),
    "scans": (lambda: network_of_frames(2, ("scan",) * 3), 6, *CORNERS),
    "frames": (lambda: network_of_frames(3, tuple(SORTS)), 4, *CORNERS),
    "tripods": (lambda: network_of_frames(4, ("levelled tripod",) * 3), 4, *CORNERS),
}
"""Networks without datum, their defects, and two choices of datum points."""


@cache
def adjusted(name: str, which: int) -> fga.Solution:
    """Return the network on its first (0) or second (1) choice of datum points."""
    make, _, *choices = FREE[name]
    return fga.adjust(with_datum(make(), choices[which]), tolerance=rest(name))


def rest(name: str) -> float:
    """Return a tolerance at which nothing is left but rounding: 1 nm of geocentric coordinates."""
    return 1e-6 if name == "gnss" else 1e-8
