"""A site on which everything can be observed, and what is there of it in the morning."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np

from factorgraph_adj import Network
from factorgraph_adj.entities import Photo
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import (
    ControlPoint,
    Correlated,
    Direction,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    ImagePoint,
    PhotoPosition,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.simulation.measurement import look_at
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.units import ARCSEC

UNKNOWN = (np.nan, np.nan, np.nan)
CONTROL = {"A": (0.0, 0.0, 0.0), "B": (60.0, 5.0, 1.0), "C": (20.0, 50.0, -1.0)}
STATIONS = {"S1": (10.0, 8.0, 1.0), "S2": (45.0, 12.0, 0.5), "S3": (30.0, 40.0, 2.0)}
LATER = 6
"""Points and photos of the site from this number on arrive during the day."""
NOISE = 1e-3
"""Metres, of distances."""
OTHERS = {
    "A/twin": CONTROL["A"],
    "A/above": (0.0, 0.0, 30.0),
    "S1/above": (10.03, 8.0, 30.0),
    "far": (1e5, 0.0, 0.0),
    "thin": UNKNOWN,
    "unused": UNKNOWN,
}
"""Points of the degenerate cases: at the place of A, exactly above it, steeply above S1 (nearer to
its vertical than some σ there is no answer for the batch either), seen in one direction only."""


def _targets() -> dict[str, tuple[float, float, float]]:
    rng = np.random.default_rng(1986)
    at = rng.uniform([5.0, 5.0, -2.0], [55.0, 45.0, 6.0], (14, 3))
    return {f"P{i}": tuple(row) for i, row in enumerate(at.tolist())}


def _centres() -> dict[str, tuple[float, float, float]]:
    turns = np.arange(8) * np.pi / 4
    at = [(30 + 35 * np.cos(t), 25 + 30 * np.sin(t), 14.0 + np.cos(3 * t)) for t in turns]
    return {f"F{i}": (float(x), float(y), float(z)) for i, (x, y, z) in enumerate(at)}


def plan() -> Network:
    """Return the site with its true values, and everything that can be observed on it, twice."""
    network = Network("site")
    for name, at in CONTROL.items():
        network.add_point(name, at, fixed="xyz")
    for name, at in (STATIONS | _targets()).items():
        network.add_point(name, at)
    network.add_camera("cam", BrownLens(), {"c": 28.0, "k1": 1e-4}, free=("c",), sigma={"x0": 0.01})
    for name, centre in _centres().items():
        rotation = look_at(np.array(centre), np.array([30.0, 25.0, 1.0]))
        network.add_photo(name, "cam", position=centre, rotation=rotation)
    network.set_distance_meter("edm", scale=1e-5, zero=0.002, sigma_scale=1e-5, sigma_zero=0.003)
    network.set_refraction("air", value=0.13, sigma=0.05)
    network.set_vertical("S2", xi=3 * ARCSEC, eta=-2 * ARCSEC, sigma=5 * ARCSEC)
    for name in STATIONS:
        for number in "12":
            network.set_orientation(name, set=number, value=0.4)
    for repeat in "ab":
        _observe(network, repeat)
    return network


def _observe(network: Network, repeat: str) -> None:
    angle = StandardDeviation(5 * ARCSEC, centring_target=0.0003)
    every = [*CONTROL, *STATIONS, *_targets()]
    for s in STATIONS:
        for n, t in enumerate(x for x in every if x != s):
            name, heights = f"{s}-{t}-{repeat}", {"instrument_height": 1.5, "target_height": 0.2}
            number = "1" if repeat == "a" else "2"
            network.add(
                Direction(s, t, 0.0, sigma=angle, set=number, id=f"r{name}", **heights),
                ZenithAngle(
                    s, t, 1.5, sigma=8 * ARCSEC, refraction="air", id=f"z{name}", **heights
                ),
                SlopeDistance(
                    s,
                    t,
                    1.0,
                    sigma=StandardDeviation(NOISE, ppm=2.0),
                    instrument="edm",
                    id=f"d{name}",
                    **heights,
                ),
            )
            if n % 4 == 0:
                network.add(HorizontalAngle(s, "B", t, 0.0, sigma=5 * ARCSEC, id=f"w{name}")) if (
                    t not in ("B", s)
                ) else None
    for n, (a, b) in enumerate(permutations([*CONTROL, *_targets()], 2)):
        if n % 7 == 0:
            network.add(HeightDifference(a, b, 0.0, sigma=0.0008, id=f"h{a}-{b}-{repeat}"))
    c = 1e-6 * np.array([[4.0, 1.0, -0.5], [1.0, 3.0, 0.7], [-0.5, 0.7, 9.0]])
    for n, t in enumerate(_targets()):
        if n % 3 == 0:
            network.add(
                GnssVector("A", t, (0.0, 0.0, 0.0), covariance=c, id=f"v{t}-{repeat}"),
                ControlPoint(t, (0.0, 0.0), axes="xz", sigma=(0.004, 0.005), id=f"k{t}-{repeat}"),
                GnssPosition(t, (0.0, 0.0, 0.0), covariance=4 * c, id=f"g{t}-{repeat}"),
            )
        if n % 4 == 1:
            pair = (
                GnssVector("B", t, (0.0,) * 3, sigma=(0.002,) * 3, id=f"v1{t}-{repeat}"),
                HeightDifference("C", t, 0.0, sigma=0.002, id=f"v2{t}-{repeat}"),
            )
            rho = np.full((4, 4), 0.3) + 0.7 * np.eye(4)
            network.add(Correlated(pair, 4e-6 * rho))
    for f in _centres():
        lever = (0.1, -0.05, 0.1)
        network.add(
            PhotoPosition(f, (0.0,) * 3, sigma=(0.02,) * 3, lever_arm=lever, id=f"q{f}-{repeat}")
        )
        if repeat == "a":
            photo = network.photos[f]
            assert photo.rotation is not None
            for p in every:
                seen = photo.rotation.T @ np.subtract(network.points[p].coordinates, photo.position)
                if seen[2] > 5.0 and max(abs(seen[:2])) < 0.6 * seen[2]:
                    network.add(ImagePoint(f, p, 0.0, 0.0, sigma=0.004))


def empty_site(measured: Network) -> Network:
    """Return what is there in the morning: some points and photos, no observation."""
    out = Network("site")
    for name, p in measured.points.items():
        if name in CONTROL:
            out.add_point(name, p.coordinates, fixed="xyz")
        elif name in STATIONS or int(name[1:]) < LATER:
            known = name in STATIONS or int(name[1:]) % 2
            near = tuple(round(x, 1) for x in p.coordinates)
            out.add_point(name, near if known else UNKNOWN)
    for name, at in OTHERS.items():
        out.add_point(name, at, fixed="" if at is UNKNOWN else "xyz")
    out.cameras = dict(measured.cameras)
    for name, f in measured.photos.items():
        if int(name[1:]) < LATER:
            out.photos[name] = arriving(f)
            out.photo_number[name] = len(out.photo_number)
    for kind in ("distance_meters", "refractions", "verticals"):
        getattr(out, kind).update(getattr(measured, kind))
    return out


def arriving(photo: Photo) -> Photo:
    """Return the photo as it comes: without orientation, every other with a rough one."""
    if int(photo.name[1:]) % 2:
        return Photo(photo.name, photo.camera)
    assert photo.position is not None
    x, y, z = photo.position
    return replace(photo, position=(round(x), round(y), round(z)))
