"""A point that may be anywhere waits, however many readings it has.

Three standard deviations that reach the instrument, or infinity, say that partials at the place
where the point is taken to be hold nowhere else; adjustments with it hardly come to rest.
"""

from __future__ import annotations

import numpy as np
import pytest
from arrivals import batch, difference

import factorgraph_adj as fga
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import (
    GnssVector,
    HeightDifference,
    ImagePoint,
    Observation,
    SlopeDistance,
)

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
        assert w.lacks.endswith(" m, its farthest sight 10.4 m")
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
