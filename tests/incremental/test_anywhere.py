"""A point that may be anywhere waits, however many readings it has.

Three standard deviations that reach the instrument, or infinity, say that partials at the place
where the point is taken to be hold nowhere else; adjustments with it hardly come to rest.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from typing import Literal

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import (
    Azimuth,
    ControlPoint,
    GnssVector,
    HeadingDifference,
    HeightDifference,
    ImagePoint,
    Observation,
    PlanarVector,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.simulation.measurement import measure
from tests.networks.small_block import small_block
from tests.support.arrivals import batch, difference

LONG = pytest.mark.slow("what waits again after a removal; short tests let it wait once")

AT = np.array([2.0, 9.0, 1.5])
"""Where the new point is."""


def pillar(sigma: tuple[float, float, float] | None = None) -> fga.Network:
    """Return two set-ups on the same pillar, half a millimetre apart, and two others.

    Args:
        sigma: standard deviations of the new point's given coordinates.
    """
    network = fga.Network("pillar")
    network.add_point("first", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("again", (0.0, 0.0005, 0.0), fixed="xyz")
    network.add_point("east", (7.0, 0.0, 0.2), fixed="xyz")
    network.add_point("north", (0.0, 15.0, 4.0), fixed="xyz")
    network.add_point("P", (2.2, 8.9, 1.3), sigma=sigma)
    return network


def distance(network: fga.Network, station: str) -> SlopeDistance:
    """Return the true distance to the new point."""
    at = np.array(network.points[station].coordinates)
    return SlopeDistance(station, "P", float(np.linalg.norm(AT - at)), sigma=0.001, id=station)


def test_three_distances_from_two_places_say_nothing_yet() -> None:
    """A fourth from elsewhere does; all of them enter with it."""
    network = pillar()
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.add([distance(network, n) for n in ("first", "again", "east")])
    assert len(inc) == 0
    for w in inc.waiting:
        assert w.lacks.startswith("point 'P' may be anywhere: its standard deviation is ")
        assert w.lacks.endswith(" m even with all else held, its farthest sight 10.4 m")
    arrival = inc.add(distance(network, "north"))
    assert {v.id: v.verdict for v in arrival.verdicts} == dict.fromkeys(
        ("first", "again", "east", "north"), "accepted"
    )
    assert np.abs(inc.estimate("P") - AT).max() < 1e-4
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-2


def test_its_own_weight_says_where_it_is() -> None:
    """A weighted point is where its given coordinates are, however large their σ is."""
    network = pillar((50.0, 50.0, 50.0))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    arrival = inc.add([distance(network, n) for n in ("first", "again", "east")])
    assert {v.verdict for v in arrival.verdicts} == {"accepted"}


def test_a_weight_says_something_along_its_own_axes_only() -> None:
    """A known height leaves a point on a circle about a pillar."""
    network = pillar((np.inf, np.inf, 0.01))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.add([distance(network, n) for n in ("first", "again")])
    assert len(inc) == 0 and all("may be anywhere" in w.lacks for w in inc.waiting)


@pytest.mark.parametrize("order", [(0, 1), (1, 0), None])
def test_control_may_be_less_precise_than_sights_are_long(order: tuple[int, ...] | None) -> None:
    """It says where the point is, whatever arrives first; none: both together."""
    network = pillar()
    readings: list[Observation] = [
        ControlPoint("P", (2.1, 9.1, 1.4), sigma=(4.0, 4.0, 4.0)),
        distance(network, "first"),
    ]
    inc = fga.IncrementalAdjustment(network, policy="accept")
    for some in [readings] if order is None else [[readings[i]] for i in order]:
        inc.add(some)
    assert len(inc) == 2


def test_how_well_the_datum_is_known_does_not_matter() -> None:
    """Photos of an object 5 m away, whose positions are known to 3 m."""
    rng = np.random.default_rng(1)
    network = fga.Network("tagged")
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    down = np.diag([1.0, -1.0, -1.0])
    at = np.column_stack((rng.uniform(-2, 2, (12, 2)), rng.uniform(-0.5, 0.5, 12)))
    images = []
    for k in range(4):
        centre = np.array([-2 + 1.3 * k, (-1.0) ** k, 5.0])
        sigma = (3.0, 3.0, 3.0)
        network.add_photo(f"{k}", "camera", position=centre, rotation=down, sigma_position=sigma)
        for i, d in enumerate(at - centre):
            x, y = 50.0 * d[:2] / -d[2]
            images.append(ImagePoint(f"{k}", f"{i}", x, y, sigma=0.005))
    for i, x in enumerate(at):
        network.add_point(f"{i}", tuple(x))
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.add(images)
    assert len(inc) == len(images)
    assert max(inc.standard_deviations("0")) > 5.0 / 3.0


def test_one_of_a_free_network_does_not_take_the_others_with_it() -> None:
    """Its σ is in that of all others, of which inner constraints are a mean."""
    rng = np.random.default_rng(1)
    network = fga.Network("free", datum="free")
    at = {f"P{i}": rng.uniform(-5, 5, 3) for i in range(6)}
    at |= {"first": np.zeros(3), "again": np.array([0, 0.0005, 0.0]), "V": np.array([2, 9, 1.5])}
    for name, x in at.items():
        network.add_point(name, tuple(x))
    readings = [
        SlopeDistance(a, b, float(np.linalg.norm(at[a] - at[b])), sigma=0.0005)
        for a, b in combinations(at, 2)
        if (a, b) != ("first", "again") and ("V" not in (a, b) or a in ("P0", "first", "again"))
    ]
    inc = fga.IncrementalAdjustment(network, policy="accept", datum="free")
    inc.add(readings)
    assert {w.lacks.split(":")[0] for w in inc.waiting} == {"point 'V' may be anywhere"}
    assert inc.n_waiting == 3


@pytest.mark.parametrize(
    "reading",
    [
        HeightDifference("first", "Q", 0.001, sigma=0.005),
        GnssVector("first", "Q", (0.0, 0.0, 0.001), sigma=(0.005, 0.005, 0.005)),
    ],
    ids=lambda o: o.kind,
)
def test_linear_readings_may_be_less_precise_than_they_are_long(reading: Observation) -> None:
    """Their partials are the same everywhere."""
    network = pillar()
    xy = "xy" if reading.kind == "height_difference" else ""
    network.add_point("Q", (0.0, 0.0, 0.0), fixed=xy)
    inc = fga.IncrementalAdjustment(network, policy="accept")
    (verdict,) = inc.add(reading).verdicts
    assert verdict.verdict == "accepted"


@pytest.mark.parametrize("sigma", [0.1, 1.0, 100.0])
def test_a_vehicle_begins_with_its_first_step_however_poor_that_is(sigma: float) -> None:
    """Steps in axes of a vehicle are linear in the place that they reach."""
    network = fga.Network("drive")
    network.add_point("0", (0.0, 0.0, 0.0), fixed="xyz")
    network.add_point("1", (1.0, 0.0, 0.0), fixed="z")
    network.set_unknown("heading", "0", (0.3,), fixed=True)
    network.set_unknown("heading", "1", (0.0,))
    inc = fga.IncrementalAdjustment(network)
    step = PlanarVector("0", "1", (1.0, 0.1), sigma=(sigma, sigma))
    inc.add([HeadingDifference("0", "1", -0.2, sigma=0.1), step])
    assert len(inc) == 2 and not inc.n_waiting
    assert inc.standard_deviations("1")[:2] == pytest.approx([sigma, sigma])


def test_linear_readings_to_a_point_with_a_short_sight() -> None:
    """A bolt and a mark 5 cm beside it, each with a GNSS vector of 2 cm."""
    network = pillar()
    network.add_point("bolt", (100.0, 50.0, 5.0))
    network.add_point("mark", (100.05, 50.0, 5.0))
    sigma = (0.02, 0.02, 0.02)
    inc = fga.IncrementalAdjustment(network, policy="accept")
    inc.add(SlopeDistance("bolt", "mark", 0.05, sigma=0.001))
    inc.add(
        [
            GnssVector("first", "bolt", (100.0, 50.0, 5.0), sigma=sigma),
            GnssVector("first", "mark", (100.05, 50.0, 5.0), sigma=sigma),
        ]
    )
    assert len(inc) == 3


def test_a_short_sight_among_long_ones_does_not_count() -> None:
    """The farthest one does: two points a millimetre from each other are well known from afar."""
    network = pillar()
    network.add_point("beside", (2.001, 9.0, 1.5), fixed="xyz")
    inc = fga.IncrementalAdjustment(network, policy="accept")
    near = SlopeDistance("beside", "P", 0.001, sigma=0.01)
    arrival = inc.add([near, *(distance(network, n) for n in ("first", "east", "north"))])
    assert {v.verdict for v in arrival.verdicts} == {"accepted"}


def rays(depth: float) -> tuple[fga.Network, list[ImagePoint]]:
    """Return three photos, two of them 0.1 m apart, and a point with rays from these two."""
    network = fga.Network("far")
    network.add_camera("camera", BrownLens(), {"c": 50.0})
    down = np.diag([1.0, -1.0, -1.0])
    for name, x in {"left": 0.0, "right": 0.1, "third": 0.1 * depth}.items():
        network.add_photo(name, "camera", position=(x, 0, 0), rotation=down, fixed=True)
    network.add_point("P", (1.0, 0.0, -depth))
    images = [
        ImagePoint(name, "P", 50.0 * (1.0 - f.position[0]) / depth, 0.0, sigma=0.001)
        for name, f in network.photos.items()
        if f.position is not None
    ]
    return network, images


@pytest.mark.parametrize(("depth", "verdict"), [(800.0, "accepted"), (2000.0, "waiting")])
def test_rays_that_are_parallel_within_three_standard_deviations(
    depth: float, verdict: str
) -> None:
    """The parallax b c/Z is 1.41 µm × 3 at 1180 m."""
    network, (left, right, third) = rays(depth)
    inc = fga.IncrementalAdjustment(network, policy="accept")
    arrival = inc.add([left, right])
    assert {v.verdict for v in arrival.verdicts} == {verdict}
    inc.add(third)
    assert not inc.n_waiting
    assert inc.estimate("P")[2] == pytest.approx(-depth, rel=1e-6)


@LONG
@pytest.mark.parametrize("datum", ["given", "free"])
def test_it_waits_again_when_what_said_where_it_is_is_taken_out(
    datum: Literal["given", "free"],
) -> None:
    """Without its zenith angle a height hangs on a nearly horizontal distance that is too short.

    There is no minimum with the point; everything else has its own.
    """
    network = fga.Network("site", datum=datum)
    at = {"A": (0.0, 0.0, 0.0), "B": (30.0, 0.0, 1.0), "C": (12.0, -25.0, 6.0), "P": (10, 20, 0.3)}
    for name, x in at.items():
        held = "xyz" if datum == "given" and name in "AB" else ""
        network.add_point(name, x, fixed=held)
    scratch = measure(sights(network), seed=1, noise=False)
    short = scratch.observations["A-P"]
    assert isinstance(short, SlopeDistance)
    scratch.observations["A-P"] = replace(short, value=short.value - 0.005)
    inc = fga.IncrementalAdjustment(scratch, policy="accept", datum=datum)
    assert inc.solution().converged
    waits = inc.remove("zenith").waits
    assert {w.label.split()[2] for w in inc.waiting} == {"P"} and len(waits) == 3
    assert all("'P'" in w.lacks for w in inc.waiting)
    assert inc.solution().converged
    found = difference(inc.solution(), batch(inc))
    assert max(found.estimates, found.sigmas) < 1e-2
    inc.add(scratch.observations["zenith"])
    assert not inc.n_waiting and inc.solution().converged


def sights(network: fga.Network) -> fga.Network:
    """Add distances and zenith angles between all others, and what determines P."""
    for a, b in combinations("ABC", 2):
        network.add(SlopeDistance(a, b, 1.0, sigma=0.001), ZenithAngle(a, b, 1.0, sigma=2e-5))
        network.add(Azimuth(a, b, 1.0, sigma=2e-5))
    network.add(
        Azimuth("A", "P", 1.0, sigma=2e-5),
        Azimuth("B", "P", 1.0, sigma=2e-5),
        SlopeDistance("A", "P", 1.0, sigma=0.001, id="A-P"),
        ZenithAngle("A", "P", 1.0, sigma=2e-5, id="zenith"),
    )
    return network


def test_two_rays_that_do_not_meet_wait_for_a_third_that_tells_which_is_wrong() -> None:
    """Redundancy 1: both rays fail the same test, and without either the point is nowhere."""
    measured = small_block(4)
    rays = [o for o in measured.image_points() if o.point == "P9"]
    ids = [f"{o.photo}/{o.point}" for o in rays]
    network = fga.without(measured, [o.id or i for o, i in zip(rays, ids, strict=True)])
    inc = fga.IncrementalAdjustment(network)
    wrong = replace(rays[1], x=rays[1].x + 0.5, y=rays[1].y + 0.5)
    told = inc.add([rays[0], wrong]).verdicts
    assert [v.verdict for v in told] == ["waiting", "waiting"]
    assert all("contradict each other" in v.lacks for v in told)
    told = inc.add(rays[2:]).verdicts
    assert {v.id for v in told if v.verdict == "suspect"} == {ids[1]}
    assert {v.id for v in told if v.verdict == "accepted"} == {*ids} - {ids[1]}
