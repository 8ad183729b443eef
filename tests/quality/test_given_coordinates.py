"""Given coordinates that data snooping rejects: it is not known whether the mark is wrong."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import GnssVector
from factorgraph_adj.quality.rejections import rejected_coordinates
from factorgraph_adj.report.adjustment_report import Report
from factorgraph_adj.report.options import Provenance

OFF = np.array([0.08, 0.0, 0.0])


def surveyed(given: dict[str, int], marks: dict[str, int], *, seed: int = 3) -> fga.Network:
    """Return vectors between points with weighted coordinates.

    Args:
        given: points whose given coordinates are wrong, by `OFF` times a number.
        marks: points whose neighbour, so far away, was observed in their place.
        seed: of the errors of the readings.
    """
    rng, network = np.random.default_rng(seed), fga.Network("control")
    places = {f"K{i}": rng.uniform(-90, 90, 3) for i in range(6)}
    for name, at in places.items():
        stated = at + rng.normal(0, 0.002, 3) + OFF * given.get(name, 0)
        network.add_point(name, stated, sigma=0.002)
    seen = {name: at + OFF * marks.get(name, 0) for name, at in places.items()}
    for a, b in permutations(places, 2):
        value = seen[b] - seen[a] + rng.normal(0, 0.003, 3)
        network.add(GnssVector(a, b, tuple(value.tolist()), sigma=(0.003,) * 3))
    return network


def doubts(network: fga.Network) -> list[str]:
    found = fga.snoop(network)
    return Report(found.solution, provenance=Provenance(found, network)).doubts


def test_wrong_given_coordinates_and_another_mark_raise_the_same_doubt() -> None:
    wrong, other = doubts(surveyed({"K4": 1}, {})), doubts(surveyed({}, {"K4": -1}))
    assert any(d.startswith("given coordinates of point 'K4' were rejected") for d in wrong)
    assert any(d.startswith("given coordinates of point 'K4' were rejected") for d in other)


def test_all_points_are_named() -> None:
    network = surveyed({"K1": 1, "K4": -1}, {})
    found = rejected_coordinates(fga.snoop(network), network)
    assert found is not None
    assert found.points == ("K1", "K4")
    assert "points 'K1', 'K4' were rejected" in str(found)


@pytest.mark.parametrize("seed", range(3))
def test_good_given_coordinates_raise_no_doubt(seed: int) -> None:
    network = surveyed({}, {}, seed=seed)
    assert rejected_coordinates(fga.snoop(network), network) is None
    assert not doubts(network)


def test_a_reading_that_is_set_aside_is_no_given_coordinate() -> None:
    network = surveyed({}, {})
    ident, first = next(iter(network.observations.items()))
    assert isinstance(first, GnssVector)
    x, y, z = first.value
    network.observations[ident] = GnssVector(
        first.station, first.target, (x + 0.5, y, z), sigma=(0.003,) * 3, id=ident
    )
    found = fga.snoop(network)
    assert [r.id for r in found.rejected] == [ident]
    assert rejected_coordinates(found, network) is None
