"""Readings between given points: what contradicts is told with both values, what fits is not."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_rows
from factorgraph_adj.validate.contradicting_readings import contradicting_readings
from factorgraph_adj.validate.loop_misclosures import lines_between_given
from tests.field_mistakes.projects import yard, yard_on_earth
from tests.field_mistakes.site import site


def told(network: fga.Network) -> list[str]:
    """Return what contradicts given coordinates."""
    equations = compile_rows(network)
    return [str(f) for f in (*contradicting_readings(equations), *lines_between_given(equations))]


@pytest.mark.parametrize("make", [site, yard])
@pytest.mark.parametrize("seed", range(25))
def test_good_readings_contradict_nothing(make, seed, tmp_path) -> None:
    assert told(fga.read_project(make(seed).write(tmp_path / "p"))) == []


def test_good_readings_on_earth_contradict_nothing(tmp_path) -> None:
    assert told(fga.read_project(yard_on_earth().write(tmp_path / "p"))) == []


@pytest.mark.parametrize(("sigma", "n"), [(0.001, 1), (0.03, 0)])
def test_standard_deviations_of_given_coordinates_count(sigma: float, n: int) -> None:
    network = fga.Network("weighted")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (60, 80, 0), sigma=(sigma, sigma, sigma))
    network.add(fga.SlopeDistance("A", "B", 100.03, sigma=0.002))
    found = told(network)
    assert len(found) == n
    assert all("observed 100.030, computed 100.000 m" in f for f in found)


@pytest.mark.parametrize(("height", "named"), [(0.0, False), (0.02, False), (0.2, True)])
def test_units_are_told_of_lengths_that_differ_from_zero(height: float, named: bool) -> None:
    network = fga.Network("levelled")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (60, 80, height), fixed="xyz")
    network.add(fga.HeightDifference("A", "B", height / 0.3048 + 0.07 * (not named), sigma=0.01))
    (found,) = told(network)
    assert "contradicts the given coordinates" in found
    assert ("feet" in found) == named


def test_a_coordinate_that_is_not_given_is_not_compared() -> None:
    network = fga.Network("without heights")
    network.add_point("A", (0, 0, np.nan), fixed="xy")
    network.add_point("B", (60, 80, np.nan), fixed="xy")
    network.add_point("C", (10, 5, 3))
    network.add(fga.SlopeDistance("A", "B", 130.0, sigma=0.002))  # heights may differ
    network.add(fga.HorizontalDistance("A", "C", 20.0, sigma=0.002))  # C is roughly given
    assert told(network) == []
    network.add(fga.HorizontalDistance("A", "B", 130.0, sigma=0.002))
    (found,) = told(network)
    assert "horizontal_distance A B contradicts" in found


@pytest.mark.parametrize("factor", [1 / 0.3048, 1e3, 1e-3, 100.0])
@pytest.mark.parametrize("kind", [fga.SlopeDistance, fga.HorizontalDistance])
def test_the_factor_of_a_unit_is_named(kind, factor: float) -> None:
    network = fga.Network("units")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("B", (60, 80, 0), fixed="xyz")
    network.add(kind("A", "B", 100.0 * factor, sigma=0.002))
    (found,) = told(network)
    assert f"(factor {1 / factor:.4g})" in found


def test_a_direction_is_compared_with_the_others_of_its_set() -> None:
    rng = np.random.default_rng(4)
    network = fga.Network("set")
    network.add_point("S", (0, 0, 0), fixed="xyz")
    places = {"A": (80, 10), "B": (-30, 60), "C": (5, -70), "D": (-50, -20)}
    for name, (x, y) in places.items():
        network.add_point(name, (x, y, 1.0), fixed="xyz")
        error = 1e-5 * rng.normal() + (0.002 if name == "C" else 0.0)
        network.add(fga.Direction("S", name, float(np.arctan2(x, y) + 1.2 + error), sigma=1e-5))
    (found,) = told(network)
    assert "direction S C beside" in found


def test_a_long_sight_is_bent_by_refraction() -> None:
    for length, n in ((100.0, 1), (5000.0, 0)):
        network = fga.Network("sight")
        network.add_point("A", (0, 0, 0), fixed="xyz")
        network.add_point("B", (length, 0, 0), fixed="xyz")
        network.add(fga.ZenithAngle("A", "B", np.pi / 2 + 1.2e-4, sigma=5e-6))
        assert len(told(network)) == n


@pytest.mark.parametrize(
    ("azimuth", "wrong", "n"),
    [
        # Of two targets side by side a doubtful station moves both directions by the same angle.
        (0.0, 6e-4, 1),
        # Of two on opposite sides it moves them against one another, by 2 · 5 σ / 30 m here.
        (np.pi, 2 * 5 * 0.005 / 30.0, 0),
    ],
)
def test_two_directions_have_their_station_in_common(azimuth: float, wrong: float, n: int) -> None:
    network = fga.Network("weighted station")
    network.add_point("S", (0, 0, 0), sigma=(0.005, 0.005, 0.005))
    for name, a in (("A", 0.0), ("B", azimuth + 1e-3)):
        network.add_point(name, (30 * np.sin(a), 30 * np.cos(a), 0), fixed="xyz")
    network.add(fga.Direction("S", "A", 1.0, sigma=1e-5))
    network.add(fga.Direction("S", "B", (1.001 + azimuth + wrong) % (2 * np.pi), sigma=1e-5))
    assert len(told(network)) == n
