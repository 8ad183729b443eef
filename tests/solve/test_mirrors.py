"""Distances from stations in a plane or on a line fit at the mirror image too, which is told."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance
from factorgraph_adj.types import Array

PLACE = np.array([20.0, 1.0, 0.0])


def sighted(
    stations: dict[str, tuple[float, float, float]], place: Array, start: Array | None = None
) -> fga.Network:
    """Return a point in plan with distances from stations."""
    network = fga.Network("mirror")
    network.add_point("P", place + np.array([0.3, 0.2, 0.0]) if start is None else start, fixed="z")
    for name, x in stations.items():
        network.add_point(name, x, fixed="xyz")
        network.add(SlopeDistance(name, "P", float(np.linalg.norm(place - x)), sigma=1e-3))
    return network


@pytest.mark.parametrize("start", [(20.3, 1.2), (22.0, 15.0), (20.3, -1.2), (8.0, -40.0)])
def test_two_distances_name_the_other_place(start: tuple[float, float]) -> None:
    network = sighted({"A": (0.0, 0.0, 0.0), "B": (40.0, 0.0, 0.0)}, PLACE, np.array([*start, 0.0]))
    solution = fga.adjust(network)
    y = 1.0 if start[1] > 0 else -1.0
    np.testing.assert_allclose(solution.point("P"), [20.0, y, 0.0], atol=1e-6)
    (told,) = solution.second_places
    assert told == f"point 'P' fits equally well at 20.0000, {-y:.4f}, 0.0000"
    assert told in solution.headline()


def test_three_distances_in_space_and_a_levelled_height_are_mirrored_too() -> None:
    place, network = np.array([4.0, 7.0, 9.0]), fga.Network("in space")
    network.add_point("P", place + 0.1)
    stations = {"A": (0.0, 0.0, 1.0), "B": (20.0, 2.0, 0.0), "C": (3.0, 25.0, 2.0)}
    for name, x in stations.items():
        network.add_point(name, x, fixed="xyz")
        network.add(SlopeDistance(name, "P", float(np.linalg.norm(place - x)), sigma=1e-3))
    (told,) = fga.adjust(network).second_places
    assert told.startswith("point 'P' fits equally well at")
    network.add(HeightDifference("A", "P", 8.0, sigma=1e-3))
    assert not fga.adjust(network).second_places


def test_a_levelled_point_is_mirrored_at_the_upright_plane_of_two_stations() -> None:
    network = fga.Network("levelled")
    place = np.array([6.0, 7.0, 3.0])
    network.add_point("P", place + 0.1)
    for name, x in {"A": (0.0, 0.0, 1.0), "B": (20.0, 0.0, 0.0)}.items():
        network.add_point(name, x, fixed="xyz")
        network.add(SlopeDistance(name, "P", float(np.linalg.norm(place - x)), sigma=1e-3))
    network.add(HeightDifference("A", "P", 2.0, sigma=1e-3))
    (told,) = fga.adjust(network).second_places
    assert told == "point 'P' fits equally well at 6.0000, -7.0000, 3.0000"


def test_what_tells_the_side_leaves_one_place() -> None:
    aside = sighted({"A": (0.0, 0.0, 0.0), "B": (40.0, 0.0, 0.0), "C": (15.0, -9.0, 0.0)}, PLACE)
    assert not fga.adjust(aside).second_places
    angles = sighted({"A": (0.0, 0.0, 0.0), "B": (40.0, 0.0, 0.0)}, PLACE)
    angles.add(Direction("A", "B", 0.0, sigma=1e-4))
    angles.add(Direction("A", "P", -float(np.arctan2(1.0, 20.0)), sigma=1e-4))
    assert not fga.adjust(angles).second_places


def test_several_mirrored_points_are_all_named() -> None:
    network = fga.Network("several")
    for name, x in {"A": (0.0, 0.0, 0.0), "B": (40.0, 0.0, 0.0)}.items():
        network.add_point(name, x, fixed="xyz")
    for i in range(4):
        place = np.array([8.0 + 6.0 * i, 3.0 + i, 0.0])
        network.add_point(f"P{i}", place + np.array([0.1, 0.1, 0.0]), fixed="z")
        for s in "AB":
            x = network.points[s].coordinates
            network.add(SlopeDistance(s, f"P{i}", float(np.linalg.norm(place - x)), sigma=1e-3))
    told = fga.adjust(network).second_places
    assert [t.split("'")[1] for t in told] == ["P0", "P1", "P2", "P3"]
