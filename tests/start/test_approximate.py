"""Approximate values: simulated networks forget their coordinates, and get them back."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from copy import copy
from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.adjustment import adjust
from factorgraph_adj.entities import FREE_ORIENTATION
from factorgraph_adj.errors import ApproximationError
from factorgraph_adj.frames import GeocentricFrame, LocalFrame, TopocentricFrame
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.models.inverse_lens import sight_lines
from factorgraph_adj.models.lens import BrownForwardLens, BrownLens, HarmonicLens, Lens
from factorgraph_adj.models.lens_registry import LENSES
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    AstronomicLatitude,
    Azimuth,
    ControlPoint,
    Direction,
    GnssPosition,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    Observation,
    PhotoPosition,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from factorgraph_adj.simulation.measurement import look_at, measure
from factorgraph_adj.start import approximate_values as start_search
from factorgraph_adj.start.approximate_values import approximate
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC, GON
from tests.networks import aicon, dbat
from tests.networks.photo_block import block
from tests.support.places import data_dir

LONG = pytest.mark.slow(
    "all points of a real block of 60 photos; short tests intersect simulated ones"
)

MILLIMETRE = 1e-3
MGON = 1e-3 * GON


def forget(network: Network, *, points: Iterable[str] = (), photos: Iterable[str] = ()) -> Network:
    """Return a copy without approximate values of some points and photos, and of orientations."""
    out = copy(network)
    out.points = dict(network.points)
    for name in points:
        p = network.points[name]
        kept = tuple(c if f else np.nan for c, f in zip(p.coordinates, p.fixed, strict=True))
        out.points[name] = replace(p, coordinates=kept)
    out.photos = dict(network.photos)
    for name in photos:
        out.photos[name] = replace(network.photos[name], position=None, rotation=None)
    out.orientations = dict.fromkeys(network.orientations, FREE_ORIENTATION)
    return out


def forget_free(network: Network) -> Network:
    """Return a copy that has forgotten every point that is not held or weighted altogether."""
    loose = [n for n, p in network.points.items() if not all(p.fixed) and p.sigma is None]
    return forget(network, points=loose, photos=network.photos)


def sights(
    station: str,
    targets: str | Iterable[str],
    *,
    use: str = "dsz",
    set: str = "1",
    **heights: float,
) -> list[Observation]:
    """Return directions (d), slope (s) or horizontal (h) distances, zenith angles (z)."""
    out: list[Observation] = []
    for t in targets:
        if "d" in use:
            out.append(Direction(station, t, 0.0, set=set, sigma=0.5 * MGON, **heights))
        if "s" in use:
            out.append(SlopeDistance(station, t, 1.0, sigma=2 * MILLIMETRE, **heights))
        if "h" in use:
            out.append(HorizontalDistance(station, t, 1.0, sigma=2 * MILLIMETRE, **heights))
        if "z" in use:
            out.append(ZenithAngle(station, t, 1.0, sigma=0.5 * MGON, **heights))
        if "v" in use:
            out.append(VerticalAngle(station, t, 1.0, sigma=0.5 * MGON, **heights))
    return out


PLACES = {
    "A": (10.0, 20.0, 5.0),
    "B": (230.0, 45.0, 12.0),
    "C": (190.0, 260.0, -3.0),
    "D": (-20.0, 240.0, 8.0),
    "P": (120.0, 150.0, 20.0),
    "Q": (60.0, 90.0, 1.0),
    "R": (160.0, 90.0, 30.0),
    "S": (330.0, 180.0, 14.0),
    "T": (300.0, 320.0, 25.0),
}
"""Points of the networks, metres."""


def network_of(
    names: str,
    observations: Iterable[Observation],
    *,
    held: str = "",
    held_axes: str = "xyz",
    all_axes: str = "",
    frame: LocalFrame | None = None,
    datum: str = "given",
    seed: int = 7,
) -> Network:
    """Return a measured network of some of the places; coordinates are the true ones."""
    plan = Network(frame=frame or LocalFrame(), datum=datum)  # type: ignore[arg-type]
    for name in names:
        fixed = (held_axes if name in held else "") + all_axes
        plan.add_point(name, PLACES[name], fixed=fixed)
    plan.add(*observations)
    for n, (station, number) in enumerate(plan.orientations):
        plan.set_orientation(station, set=number, value=-2.0 + 1.7 * n)
    return measure(plan, seed=seed)


def off(network: Network, truth: Network, **options: object) -> float:
    """Return the largest error of the approximate coordinates and centres, metres."""
    state = approximate(compile_network(network), **options)  # type: ignore[arg-type]
    assert not any(np.isnan(v).any() for v in state.values())
    true = compile_network(truth).unknowns
    error = np.abs(state["point"] - true["point"].values).max()
    if len(true["pose"].names):
        error = max(error, np.abs(state["pose"] - true["pose"].values)[:, 9:].max())
        error = max(error, np.abs(state["pose"] - true["pose"].values)[:, :9].max())
    return float(error)


def levelled(*pairs: str) -> list[Observation]:
    return [HeightDifference(i, j, 0.0, sigma=MILLIMETRE) for i, j in pairs]


def angles(*triples: str) -> list[Observation]:
    return [HorizontalAngle(i, j, k, 0.0, sigma=0.5 * MGON) for i, j, k in triples]


HEIGHTS = {"instrument_height": 1.55, "target_height": 1.3}

GIVEN: dict[str, Callable[[], Network]] = {
    "polar points from an oriented station": lambda: network_of(
        "ABPQR", sights("A", "BPQR", **HEIGHTS), held="AB"
    ),
    "polar with horizontal distances and vertical angles": lambda: network_of(
        "ABPQR", sights("A", "BPQR", use="dhv", **HEIGHTS), held="AB"
    ),
    "a traverse that starts with an azimuth": lambda: network_of(
        "APQRST",
        [
            Azimuth("A", "P", 0.0, sigma=MGON),
            *sights("A", "P"),
            *sights("P", "AQ"),
            *sights("Q", "PR"),
            *sights("R", "QS"),
            *sights("S", "RT"),
        ],
        held="A",
    ),
    "a traverse between two points without orientation": lambda: network_of(
        "APQRS",
        [*sights("P", "AQ"), *sights("Q", "PR"), *sights("R", "QS")],
        held="AS",
    ),
    "a free station that sees two known points": lambda: network_of(
        "ABPQ", sights("P", "ABQ", **HEIGHTS), held="AB"
    ),
    "a polar point backwards over an azimuth": lambda: network_of(
        "AP",
        [Azimuth("P", "A", 0.0, sigma=MGON), *sights("P", "A", use="sz", **HEIGHTS)],
        held="A",
    ),
    "intersection of two directions": lambda: network_of(
        "ABPQ", [*sights("A", "BPQ", use="dz"), *sights("B", "APQ", use="dz")], held="AB"
    ),
    "resection by three directions": lambda: network_of(
        "ABDP", sights("P", "ABD", use="dz"), held="ABD"
    ),
    "resection by angles": lambda: network_of(
        "ABCDP",
        [*angles("PAB", "PBC", "PCD"), *levelled("AP")],
        held="ABCD",
    ),
    "intersection of three distances": lambda: network_of(
        "ABDPQ",
        [*sights("P", "ABD", use="h"), *sights("Q", "ABD", use="h")],
        held="ABD",
        all_axes="z",
    ),
    "distances that only a later point makes clear": lambda: network_of(
        "ABCPQ",
        [*sights("P", "AB", use="h"), *sights("Q", "ABC", use="h"), *sights("P", "Q", use="h")],
        held="ABC",
        all_axes="z",
    ),
    "two doubtful points that make each other clear": lambda: network_of(
        "ABCDPQ",
        [
            *sights("P", "AB", use="h"),
            *sights("Q", "CD", use="h"),
            *sights("P", "Q", use="h"),
            *angles("PAQ"),
        ],
        held="ABCD",
        all_axes="z",
    ),
    "a direction and a distance from different points": lambda: network_of(
        "ABDP",
        [*sights("A", "BP", use="d"), *sights("B", "P", use="h"), *sights("D", "P", use="h")],
        held="ABD",
        all_axes="z",
    ),
    "angles and distances in a polygon": lambda: network_of(
        "ABPQR",
        [
            *angles("BAP", "PBQ", "QPR", "RQA"),
            *sights("B", "P", use="h"),
            *sights("P", "Q", use="h"),
            *sights("Q", "R", use="h"),
            *sights("R", "A", use="h"),
        ],
        held="AB",
        all_axes="z",
    ),
    "slope distances reduced by levelled heights": lambda: network_of(
        "ABDPQ",
        [*sights("P", "ABDQ", use="s"), *sights("Q", "ABD", use="s"), *levelled("AP", "PQ")],
        held="ABD",
    ),
    "four slope distances in space": lambda: network_of(
        "ABCDPQ",
        [*sights("P", "ABCD", use="s"), *sights("Q", "ABCDP", use="s")],
        held="ABCD",
    ),
    "heights by levelling": lambda: network_of(
        "ABCDP", levelled("AB", "CB", "CD", "PD", "AP"), held="A", all_axes="xy"
    ),
    "heights by zenith angles over a known plan": lambda: network_of(
        "ABPQ", sights("A", "BPQ", use="z", **HEIGHTS), held="A", all_axes="xy"
    ),
    "triangulation from a far base": lambda: network_of(
        "ABPQRS",
        [
            *sights("P", "AQR", use="dz"),
            *sights("Q", "APRS", use="dz"),
            *sights("R", "PQSB", use="dz"),
            *sights("S", "QRB", use="dz"),
        ],
        held="AB",
    ),
}
"""Terrestrial networks with a datum; everything that is not held is forgotten."""


@pytest.mark.parametrize("name", GIVEN)
def test_a_forgotten_network_comes_back(name):
    truth = GIVEN[name]()
    assert off(forget_free(truth), truth) < 0.05


@pytest.mark.parametrize("name", GIVEN)
def test_what_comes_back_converges_to_the_same_adjustment(name):
    truth = GIVEN[name]()
    found, direct = adjust(forget_free(truth)), adjust(truth)
    assert found.converged
    assert found.vtpv == pytest.approx(direct.vtpv, abs=1e-6, rel=1e-6)
    for point in truth.points:
        np.testing.assert_allclose(found.point(point), direct.point(point), atol=1e-6)


def far_apart(network: Network) -> Network:
    """Return a network with the same observations that is free."""
    out = forget_free(network)
    out.datum = "free"
    return out


FREE: dict[str, Callable[[], Network]] = {
    "total stations": lambda: network_of(
        "ABPQRS",
        [*sights("P", "ABQR"), *sights("Q", "PRAS"), *sights("R", "PQBS")],
        datum="free",
    ),
    "total stations with an azimuth": lambda: network_of(
        "ABPQRS",
        [*sights("P", "ABQR"), *sights("R", "PQBS"), Azimuth("R", "B", 0.0, sigma=MGON)],
        datum="free",
    ),
    "horizontal distances": lambda: network_of(
        "ABCPQ",
        [
            *sights("A", "BCPQ", use="h"),
            *sights("B", "CPQ", use="h"),
            *sights("C", "PQ", use="h"),
            *sights("P", "Q", use="h"),
        ],
        datum="free",
        all_axes="z",
    ),
    "directions only": lambda: network_of(
        "ABCDP",
        [d for p in "ABCDP" for d in sights(p, sorted({*"ABCDP"} - {p}), use="d")],
        datum="free",
        all_axes="z",
    ),
    "slope distances in space": lambda: network_of(
        "ABCDP",
        [d for i, p in enumerate("ABCDP") for d in sights(p, "ABCDP"[:i], use="s")],
        datum="free",
    ),
    "levelling": lambda: network_of(
        "ABCDP", levelled("AB", "BC", "CD", "DP", "PA"), datum="free", all_axes="xy"
    ),
}


@pytest.mark.parametrize("name", FREE)
def test_a_free_network_starts_anywhere_and_fits_as_well_as_from_the_truth(name):
    truth = FREE[name]()
    forgotten = forget(truth, points=truth.points)
    found, direct = adjust(forgotten), adjust(truth)
    assert found.converged
    assert found.datum_defect == direct.datum_defect > 0
    assert found.vtpv == pytest.approx(direct.vtpv, rel=1e-5, abs=1e-9)


@pytest.mark.parametrize("name", [n for n in FREE if n != "levelling"])
def test_without_a_free_network_asked_for_a_missing_datum_is_the_error(name):
    forgotten = forget(FREE[name](), points=PLACES.keys() & FREE[name]().points)
    forgotten.datum = "given"
    with pytest.raises(ApproximationError) as caught:
        approximate(compile_network(forgotten))
    assert "nothing to start from" in str(caught.value) or "not reached" in str(caught.value)
    assert not any(
        np.isnan(v).any() for v in approximate(compile_network(forgotten), datum="free").values()
    )


# -- frames -----------------------------------------------------------------------------------


def town(frame: GeocentricFrame | TopocentricFrame | LocalFrame, place: Array) -> Network:
    """Return a network of every terrestrial kind about a place of the frame, with deflections."""
    there = frame.basis(place[None], np.zeros((1, 2))).enu[0]
    plan = Network(frame=frame)
    for name, at in PLACES.items():
        plan.add_point(
            name, place + 10.0 * np.array(at) @ there, fixed="xyz" if name == "A" else ""
        )
    for name in "PQ":
        plan.set_vertical(name, xi=8 * ARCSEC, eta=-6 * ARCSEC, sigma=2 * ARCSEC)
    plan.set_refraction(value=0.13, sigma=0.05)
    plan.add(
        Azimuth("A", "P", 0.0, sigma=0.5 * MGON, **HEIGHTS),
        *sights("A", "PQ", **HEIGHTS),
        *sights("P", "AQRB", **HEIGHTS),
        *sights("Q", "APRD", **HEIGHTS),
        *sights("R", "PQBS", use="dz", **HEIGHTS),
        *sights("B", "PRS", use="dz"),
        *levelled("RS", "DC"),
        GnssVector("S", "T", (0.0, 0.0, 0.0), sigma=(0.01,) * 3, **HEIGHTS),
        GnssVector("C", "P", (0.0, 0.0, 0.0), sigma=(0.01,) * 3),
    )
    for n, (station, number) in enumerate(plan.orientations):
        plan.set_orientation(station, set=number, value=1.0 + 2.1 * n)
    if not isinstance(frame, LocalFrame):
        plan.add(AstronomicLatitude("P", 0.0, sigma=0.5 * ARCSEC))
    return measure(plan, seed=3)


def geocentric(latitude: float, longitude: float) -> Array:
    at = (np.radians([latitude]), np.radians([longitude]), np.array([500.0]))
    return GeocentricFrame().ellipsoid.to_cartesian(*at)[0]


TOWNS = {
    "geocentric": lambda: town(GeocentricFrame(), geocentric(47.3, 11.2)),
    "geocentric in the south": lambda: town(GeocentricFrame(), geocentric(-33.0, -70.5)),
    "geocentric across 180 degrees": lambda: town(GeocentricFrame(), geocentric(-20.0, 180.0)),
    "topocentric": lambda: town(
        TopocentricFrame(np.radians(47.0), np.radians(11.0), 250.0), np.array([1500.0, 800.0, 60.0])
    ),
    "local": lambda: town(LocalFrame(), np.array([500.0, 100.0, 0.0])),
    "local with curvature": lambda: town(
        LocalFrame(curvature=True, origin=(100.0, 0.0, 0.0)), np.array([500.0, 100.0, 0.0])
    ),
    "local with axes north and east": lambda: town(LocalFrame(axes="ne"), np.zeros(3)),
    "local with axes south and east and curvature": lambda: town(
        LocalFrame(axes="se", curvature=True), np.zeros(3)
    ),
}


@pytest.mark.parametrize("name", TOWNS)
def test_every_frame_gets_its_coordinates_back(name):
    truth = TOWNS[name]()
    forgotten = forget_free(truth)
    assert off(forgotten, truth) < 0.5
    found, direct = adjust(forgotten), adjust(truth)
    assert found.converged
    assert found.vtpv == pytest.approx(direct.vtpv, rel=1e-5)


def test_control_and_gnss_positions_are_where_the_search_starts():
    truth = TOWNS["geocentric"]()
    places = {n: np.array(p.coordinates) for n, p in truth.points.items()}
    free = copy(truth)
    free.points = {n: replace(p, fixed=(False,) * 3) for n, p in truth.points.items()}
    free.observations = dict(truth.observations)
    free.add(
        GnssPosition("A", tuple(places["A"]), sigma=(0.01,) * 3),
        ControlPoint("B", tuple(places["B"]), axes="en", sigma=(0.01, 0.01)),
        ControlPoint("T", tuple(places["T"]), axes="u", sigma=(0.01,)),
    )
    assert off(forget_free(free), truth) < 0.5


# -- photos -----------------------------------------------------------------------------------

LENS_VALUES: dict[str, tuple[Lens, dict[str, float]]] = {
    "none": (Lens(), {"c": 24.0, "x0": 0.1, "y0": -0.05}),
    "brown": (BrownLens(), {"c": 24.0, "x0": 0.1, "k1": -2e-4, "p1": 3e-5, "b1": 1e-3}),
    "brown_forward": (BrownForwardLens(), {"c": 24.0, "y0": 0.1, "k1": -2e-4, "k2": 1e-7}),
    "harmonic": (HarmonicLens(reference_radius=10.0), {"c": 24.0, "a20": 1e-3, "a31": 1e-4}),
}


def camera_block(
    *,
    kind: str = "brown",
    control: int = 5,
    planar: bool = False,
    photos: int = 9,
    points: int = 60,
    sigma: float = 0.002,
) -> Network:
    """Return a measured block of photos around points, the first of them held."""
    rng = np.random.default_rng(11)
    lens, values = LENS_VALUES[kind]
    plan = Network(frame=LocalFrame())
    plan.add_camera("K", lens, values)
    at = rng.uniform(-5.0, 5.0, (points, 3)) * [1.0, 1.0, 0.0 if planar else 0.3]
    at[:4, :2] = [[-4, -4], [4, -4], [4, 4], [-4, 4]]
    names = [f"P{i}" for i in range(points)]
    for i, name in enumerate(names):
        plan.add_point(name, at[i], fixed="xyz" if i < control else "")
    for f in range(photos):
        turn = 2 * np.pi * f / photos
        centre = np.array([9.0 * np.cos(turn), 9.0 * np.sin(turn), 7.0 + f % 3])
        rotation = look_at(centre, np.array([0.3 * np.cos(3 * turn), 0.2, 0.0]))
        roll = np.pi / 2 * (f % 4)
        c, s = np.cos(roll), np.sin(roll)
        rotation = rotation @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        plan.add_photo(f"F{f}", "K", position=centre, rotation=rotation)
        plan.add_image_points(f"F{f}", names, np.zeros((points, 2)), sigma=sigma)
    return measure(plan, seed=5)


@pytest.mark.parametrize("kind", LENS_VALUES)
@pytest.mark.parametrize("planar", [False, True])
def test_photos_come_back_from_control_and_points_from_photos(kind, planar):
    truth = camera_block(kind=kind, planar=planar)
    forgotten = forget_free(truth)
    assert off(forgotten, truth) < 0.05
    assert adjust(forgotten).vtpv == pytest.approx(adjust(truth).vtpv, rel=1e-6)


@pytest.mark.parametrize("planar", [False, True])
def test_four_control_points_start_a_block(planar):
    truth = camera_block(control=4, planar=planar)
    forgotten = forget_free(truth)
    assert off(forgotten, truth) < 0.2
    assert adjust(forgotten).vtpv == pytest.approx(adjust(truth).vtpv, rel=1e-6)


def test_photos_join_through_points_that_other_photos_gave():
    """Half of the photos see no control; their points come from the others."""
    truth = camera_block(control=6)
    photo, point, *_ = truth.images.columns()
    truth.image_mask((point >= 6) | (photo < 4))
    assert off(forget_free(truth), truth) < 0.05


def test_a_given_projection_centre_or_attitude_needs_two_points_only():
    truth = camera_block(control=2, photos=5)
    forgotten = forget_free(truth)
    for name, photo in truth.photos.items():
        part = {"rotation": None} if name in ("F0", "F1", "F2") else {"position": None}
        forgotten.photos[name] = replace(photo, **part)
    assert off(forgotten, truth) < 0.05


def test_observed_projection_centres_start_a_block():
    truth = camera_block(control=3)
    truth.add(
        *(
            PhotoPosition(name, photo.position, sigma=(0.02,) * 3)
            for name, photo in truth.photos.items()
        )
    )
    assert off(forget_free(truth), truth) < 0.1


def test_wrong_image_points_do_not_spoil_a_photo_or_a_point():
    truth = camera_block(control=12)
    _, _, xy, _ = truth.images.columns()
    rng = np.random.default_rng(1)
    wrong = rng.choice(len(xy), len(xy) // 20, replace=False)
    xy[wrong] += rng.uniform(2.0, 5.0, (len(wrong), 2))
    assert off(forget_free(truth), truth) < 0.1


def test_points_come_from_one_ray_with_a_height_a_plan_or_distances():
    truth = camera_block(control=4, photos=1, points=7)
    at = {n: np.array(p.coordinates) for n, p in truth.points.items()}
    truth.add(
        HeightDifference("P0", "P4", float((at["P4"] - at["P0"])[2]), sigma=MILLIMETRE),
        *(
            SlopeDistance(a, "P5", float(np.linalg.norm(at["P5"] - at[a])), sigma=MILLIMETRE)
            for a in ("P0", "P1")
        ),
        ControlPoint("P6", tuple(at["P6"][:2]), axes="xy", sigma=(MILLIMETRE, MILLIMETRE)),
    )
    assert off(forget_free(truth), truth) < 0.02


def test_a_point_with_nearly_parallel_rays_starts_at_the_depth_of_the_scene():
    """Two photos 1 mm apart: noise decides where their rays meet, perhaps behind them."""
    truth = camera_block(control=6)
    first = truth.photos["F0"]
    beside = np.add(first.position, (0.0, 0.001, 0.0))
    truth.add_photo("twin", "K", position=beside, rotation=first.rotation)
    photo, _, xy, _ = truth.images.columns()
    truth.add_image_points("twin", list(truth.points), xy[photo == 0], sigma=0.002)
    photo, point, *_ = truth.images.columns()
    truth.image_mask((point != 20) | (photo == 0) | (photo == 9))
    forgotten = forget(truth, points=[f"P{i}" for i in range(6, 60)])
    state = approximate(compile_network(forgotten))
    d = state["point"][20] - np.array(first.position)
    seen = np.array(truth.points["P20"].coordinates) - np.array(first.position)
    assert d @ seen / np.linalg.norm(d) / np.linalg.norm(seen) > 1 - 1e-6
    assert np.linalg.norm(d) == pytest.approx(np.linalg.norm(seen), rel=0.5)


def test_terrestrial_points_carry_photos_and_photos_carry_terrestrial_points():
    """Three control points; a station gives more; photos give the rest and a second station."""
    truth = camera_block(control=3, points=30)
    at = {n: np.array(p.coordinates) for n, p in truth.points.items()}
    truth.add_point("station", (1.0, -12.0, 1.5))
    truth.add_point("far", (40.0, 3.0, 2.0))
    at |= {n: np.array(truth.points[n].coordinates) for n in ("station", "far")}
    for i, j in [*(("station", f"P{k}") for k in range(8)), ("P20", "far"), ("P20", "P21")]:
        d = at[j] - at[i]
        level = float(np.hypot(d[0], d[1]))
        truth.add(
            Direction(i, j, float(np.arctan2(d[0], d[1])) - 0.7, sigma=MGON),
            SlopeDistance(i, j, float(np.linalg.norm(d)), sigma=MILLIMETRE),
            ZenithAngle(i, j, float(np.arctan2(level, d[2])), sigma=MGON),
        )
    photo, point, *_ = truth.images.columns()
    truth.image_mask((point < 30) & ((point > 0) | (photo > 2)))
    assert off(forget_free(truth), truth) < 0.1


@pytest.mark.parametrize("kind", [k for k in LENSES if k != "rpc"])  # it is nothing at zero
def test_rays_of_measured_points_give_the_measured_points(kind):
    lens = LENSES[kind]()
    k = np.zeros((1, len(lens.names)))
    k[0, :3] = 24.0, 0.2, -0.1
    for name, value in {
        "k1": -3e-4,
        "A1": -3e-4,
        "p1": 2e-5,
        "a20": 2e-3,
        "b1": 1e-3,
        "w": 0.9,
        "beta": 1.0,
    }.items():
        if name in lens.names:
            k[0, lens.names.index(name)] = value
    xy = np.random.default_rng(2).uniform(-12.0, 12.0, (50, 2))
    start, rays = sight_lines(lens, xy, k)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0, atol=1e-14)
    along = start + 7.0 * rays
    v = lens.seen(tuple(along.T), *xy.T, np.repeat(k, 50, axis=0), jacobians=False).v
    assert np.abs(v).max() < 1e-5


# -- what is given, blunders, and cost --------------------------------------------------------


def test_what_is_given_stays_as_given():
    truth = GIVEN["a traverse that starts with an azimuth"]()
    forgotten = forget(truth, points="RS")
    forgotten.points["Q"] = replace(truth.points["Q"], coordinates=(61.0, 91.0, 2.0))
    forgotten.points["T"] = replace(truth.points["T"], coordinates=(np.nan, np.nan, 77.0))
    state = approximate(compile_network(forgotten))
    names = list(truth.points)
    np.testing.assert_array_equal(state["point"][names.index("Q")], (61.0, 91.0, 2.0))
    assert state["point"][names.index("T"), 2] == 77.0
    np.testing.assert_allclose(state["point"][names.index("T"), :2], PLACES["T"][:2], atol=5.0)


def test_a_rough_coordinate_does_not_turn_the_network():
    """Given coordinates that contradict what is held are not built upon."""
    truth = GIVEN["a traverse that starts with an azimuth"]()
    rough = forget(truth, points="QRST")
    rough.points["P"] = replace(truth.points["P"], coordinates=(150.0, -20.0, 20.0))
    state = approximate(compile_network(rough))
    names = list(truth.points)
    for name in "QRST":
        np.testing.assert_allclose(state["point"][names.index(name)], PLACES[name], atol=0.1)


def test_one_wrong_direction_or_distance_does_not_spoil_the_rest():
    observations = [
        *sights("P", "ABDQR"),
        *sights("Q", "ABDPR"),
        *sights("R", "ABCDPQ"),
    ]
    truth = network_of("ABCDPQR", observations, held="ABCD")
    for ident, shift in (("1", 40 * GON), ("20", 30.0), ("33", 20 * GON)):
        o = truth.observations[ident]
        truth.observations[ident] = replace(o, value=o.value + shift)
    assert off(forget_free(truth), truth) < 5.0


def test_complete_values_are_not_looked_at(monkeypatch):
    """A big block with all its values must not wait for the search."""
    equations = compile_network(camera_block(points=10, photos=3))

    def search(*_: object) -> None:
        raise AssertionError("nothing is missing")

    monkeypatch.setattr(start_search, "_search_input", search)
    monkeypatch.setattr(start_search, "orient_sets_by_model", search)
    state = approximate(equations)
    for kind, values in equations.unknowns.start().items():
        np.testing.assert_array_equal(state[kind], values)


def calls_of(function: Callable[..., object], *arguments: object) -> int:
    """Return how many functions of Python and of C are called."""
    calls = 0

    def count(frame: object, event: str, argument: object) -> None:
        nonlocal calls
        calls += event in ("call", "c_call")

    sys.setprofile(count)
    try:
        function(*arguments)
    finally:
        sys.setprofile(None)
    return calls


def test_ninety_thousand_rays_are_intersected_at_once():
    """All in the same calls as nine thousand, but for some rounds more: no loop runs over them."""
    held = ("P0", "P1", "P2", "P3")
    calls = []
    for points in (300, 3000):
        truth = camera_block(points=points, photos=30, kind="brown_forward", control=4)
        forgotten = forget(truth, points=[n for n in truth.points if n not in held])
        equations = compile_network(forgotten)
        calls.append(calls_of(approximate, equations))
    found, true = approximate(equations)["point"], compile_network(truth).unknowns["point"].values
    assert np.abs(found - true).max() < 0.02
    assert calls[1] < 1.5 * calls[0]


@LONG
def test_points_of_roma_are_those_of_dbat():
    """26 321 points from 90 561 rays: DBAT starts from √vᵀPv = 8641.39 with its intersection."""
    equations = compile_network(dbat.read_roma(data_dir("dbat_roma")))
    v = equations.residuals(approximate(equations))
    assert np.sqrt(v @ v) == pytest.approx(8641.39, abs=5e-3)


def test_photos_of_a_close_range_block_come_back_from_its_points():
    """115 photos turned every way, 58 gross errors among 9972 image points."""
    given = aicon.read_aicon(data_dir("aicon_jaicov"))
    assert off(forget(given, photos=given.photos), given) < 0.001


# -- what cannot be reached -------------------------------------------------------------------


def problems_of(network: Network) -> str:
    with pytest.raises(ApproximationError) as caught:
        approximate(compile_network(network))
    return str(caught.value)


def test_every_point_that_cannot_be_reached_is_listed_with_its_reason():
    truth = network_of(
        "ABCDPQRST",
        [
            *sights("A", "BP"),
            *sights("Q", "A", use="h"),
            *sights("R", "S", use="hz"),
            *sights("A", "D", use="dh"),
            *sights("T", "AB", use="h"),
            HeightDifference("A", "T", 0.0, sigma=MILLIMETRE),
        ],
        held="AB",
    )
    text = problems_of(forget_free(truth))
    assert "point C: no observation joins it to anything" in text
    assert "point Q: 1 horizontal distance: not enough" in text
    assert "point R: 1 horizontal distance, 1 zenith angle, joined only to points" in text
    assert "not reached themselves: S" in text
    assert "point D: its height is not observed; observe it, hold z, or make the network" in text
    assert "point T: two positions fit equally well" in text
    assert "P" not in [line.split(":")[0].removeprefix("point ") for line in text.splitlines()]


def test_a_network_without_observed_heights_is_taken_for_a_plane_one():
    plane = network_of("ABD", sights("A", "BD", use="dh"), held="AB")
    text = problems_of(forget_free(plane))
    assert "point D: its height is not observed; hold z in a plane network" in text


def test_a_mirrored_position_in_space_is_said_to_be_doubtful():
    truth = network_of("ABCP", sights("P", "ABC", use="s"), held="ABC")
    assert "point P: two positions fit its slope distances equally well" in problems_of(
        forget_free(truth)
    )


def test_points_and_photos_without_enough_rays_are_listed():
    truth = camera_block(control=4, points=12)
    photo, point, *_ = truth.images.columns()
    keep = (point != 5) | (photo == 0)  # one ray
    keep &= (photo != 3) | (point < 3)  # three points
    keep &= point != 6  # none
    truth.image_mask(keep)
    text = problems_of(forget_free(truth))
    assert "point P5: 1 image ray, no distance" in text
    assert "point P6: no observation joins it to anything" in text
    assert "photo F3: only 3 of its 3 image points" in text
    assert len(text.splitlines()) == 3


def test_photos_that_no_pose_fits_say_so():
    truth = camera_block(control=8, photos=2, points=8)
    photo, _, xy, _ = truth.images.columns()
    xy[photo == 1] = np.random.default_rng(3).uniform(-9.0, 9.0, (8, 2))
    assert "photo F1: 8 of its 8 image points belong to known points, but no pose" in problems_of(
        forget_free(truth)
    )


def test_points_with_the_same_reason_are_listed_together():
    truth = camera_block(control=4, points=12)
    photo, point, *_ = truth.images.columns()
    truth.image_mask((point < 6) | (photo == 0))
    text = problems_of(forget_free(truth))
    assert text == "points P6, P7, P8, P9, P10, P11: 1 image ray, no distance"


def test_a_network_that_knows_nothing_asks_for_a_start():
    truth = camera_block(control=0, photos=3, points=12)
    forgotten = forget(truth, points=truth.points, photos=truth.photos)
    assert "nothing to start from: no point has coordinates" in problems_of(forgotten)
    forgotten.datum = "free"
    assert "give the orientation of two photos" in problems_of(forgotten)


@pytest.mark.slow(
    "values of many random networks are compared with an independent search; short tests "
    "take single ones"
)
@pytest.mark.parametrize("axes", ["xy exchanged", "y the wrong way"])
def test_a_mirrored_photo_without_orientation_is_said_to_be_one(axes: str) -> None:
    network = block(0)
    for name, photo in network.photos.items():
        network.photos[name] = replace(photo, position=None, rotation=None)
    f, p, xy, sigma = network.images.columns()
    mine = f == network.photo_number["F5"]
    points = [list(network.points)[i] for i in p[mine].tolist()]
    other = xy[mine][:, ::-1] if axes == "xy exchanged" else xy[mine] * [1.0, -1.0]
    network.image_mask(~mine)
    network.add_image_points("F5", points, other, sigma=sigma[mine])
    with pytest.raises(ApproximationError, match="one of its mirror image does") as error:
        adjust(network)
    assert sum("F5" in f"{p}" and "photo" in f"{p}" for p in error.value.problems) == 1
    network.image_mask(np.arange(network.n_image_points) < network.n_image_points - len(points))
    names = [points[i] for i in np.random.default_rng(1).permutation(len(points))]
    network.add_image_points("F5", names, xy[mine], sigma=sigma[mine])
    with pytest.raises(ApproximationError, match="check names, coordinates and calibration"):
        adjust(network)


def test_heights_of_a_free_network_begin_where_its_plan_does():
    """A part whose plan is not reached has the first heights; the other part is left without."""
    network = fga.Network("two parts", datum="free")
    for name in ("U", "V", "A", "B", "C"):
        network.add_point(name)
    places = {"A": (0, 0, 0), "B": (60, 10, 2), "C": (20, 50, -1)}
    network.add(fga.HeightDifference("U", "V", 1.0, sigma=MILLIMETRE))  # before all others
    for a, b in ("AB", "BC", "CA"):
        d = np.subtract(places[b], places[a])
        network.add(fga.SlopeDistance(a, b, float(np.linalg.norm(d)), sigma=MILLIMETRE))
        network.add(fga.HeightDifference(a, b, float(d[2]), sigma=MILLIMETRE))
    solution = fga.adjust(network, leave_out_undetermined=True)
    assert {x.name for x in solution.network.unknowns_left_out} == {"U", "V"}
    assert solution.converged
    for a, b in ("AB", "BC", "CA"):
        d = np.linalg.norm(np.subtract(places[b], places[a]))
        assert np.linalg.norm(solution.point(b) - solution.point(a)) == pytest.approx(d, abs=1e-6)
