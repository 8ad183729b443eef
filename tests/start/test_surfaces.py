"""Approximate values by water, barometers, and azimuths of gyrotheodolites of any constant."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.validate.network_structure import check

X = {
    "A": (0.0, 0.0),
    "B": (100.0, 5.0),
    "C": (210.0, -20.0),
    "D": (300.0, 40.0),
    "E": (390.0, 10.0),
}


def in_height(known: str = "A", *, datum: str = "given") -> fga.Network:
    network = fga.Network("heights", datum=datum)
    for i, (name, at) in enumerate(X.items()):
        z = 300.0 + 10.0 * i if name in known else np.nan
        network.add_point(name, (*at, z), fixed="xyz" if name in known else "xy")
    return network


def test_heights_come_from_a_held_level() -> None:
    network = in_height(known="")
    network.set_level("lake", 300.0, fixed=True)
    for i, name in enumerate(X):
        network.add(o.LevelHeight(name, "lake", 10.0 * i, sigma=0.01))
    assert list(check(network)) == []
    solution = fga.adjust(network)
    assert solution.point("E")[2] == pytest.approx(340.0)


def test_heights_and_the_level_come_from_one_known_point() -> None:
    network = in_height()
    network.set_level("lake")
    for i, name in enumerate(X):
        height = 10.0 * i - 0.5
        network.add(o.LevelHeight(name, "lake", height, sigma=0.01, slope=1e-3, along=500.0))
    solution = fga.adjust(network)
    assert solution.point("E")[2] == pytest.approx(340.0)
    assert solution.unknown("level", "lake").values[0] == pytest.approx(300.0)


def test_heights_come_from_a_barometer_that_reads_from_anywhere() -> None:
    network = in_height(known="AB")
    network.set_profile("barometer", free=("height", "scale"))
    for i, name in enumerate(X):
        network.add(o.ProfileHeight(name, 1.03 * (10.0 * i - 70.0), profile="barometer", sigma=0.1))
    solution = fga.adjust(network)
    assert solution.point("E")[2] == pytest.approx(340.0)
    values = solution.unknown("profile", "barometer").values
    assert values[[0, 3]] == pytest.approx([370.0, 0.03])


def test_a_free_network_of_heights_starts_anywhere() -> None:
    network = in_height(known="", datum="free")
    network.set_profile("barometer")
    for i, name in enumerate(X):
        network.add(o.ProfileHeight(name, 10.0 * i, profile="barometer", sigma=0.1))
    solution = fga.adjust(network)
    assert solution.datum_defect == 1
    assert solution.point("E")[2] - solution.point("A")[2] == pytest.approx(40.0)


def test_a_surface_of_unknown_height_is_told() -> None:
    network = in_height()
    network.set_level("lake")
    network.set_level("sea", 0.0)
    network.add(o.LevelHeight("A", "sea", 300.0, sigma=0.01))
    network.add(o.LevelHeight("B", "lake", sigma=0.01), o.LevelHeight("C", "lake", sigma=0.01))
    network.add(o.HeightDifference("D", "E", 10.0, sigma=0.01))
    with pytest.raises(fga.AdjustmentError) as error:
        fga.adjust(network)
    assert "points B, C: the height of the surface above which it was measured is not known" in str(
        error.value
    )


def traverse(constant: float, *, value: float | None = None, known: str = "AB") -> fga.Network:
    """Return a traverse in a tunnel: azimuths of a gyrotheodolite and distances."""
    network = fga.Network("tunnel")
    for name, at in X.items():
        held = name in known
        network.add_point(
            name, (*(at if held else (np.nan,) * 2), 0.0), fixed="xyz" if held else "z"
        )
    network.set_gyro("gyro", value)
    for a, b in ("AB", "BA", "BC", "CB", "CD", "DC", "DE", "ED"):
        d = np.subtract(X[b], X[a])
        reading = float((np.arctan2(*d) - constant) % (2 * np.pi))
        network.add(o.GyroAzimuth(a, b, reading, gyro="gyro", sigma=1e-4))
        if a < b:
            network.add(o.HorizontalDistance(a, b, float(np.hypot(*d)), sigma=0.01))
    return network


@pytest.mark.parametrize("constant", [0.0, 0.7, 3.1, -3.1])
def test_a_traverse_of_gyro_azimuths_starts_from_the_constant_that_its_first_line_gives(
    constant: float,
) -> None:
    solution = fga.adjust(traverse(constant))
    assert solution.point("E")[:2] == pytest.approx(X["E"], abs=1e-6)
    found = solution.unknown("gyro", "gyro").values[0]
    assert (found - constant + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0.0, abs=1e-9)


def test_a_known_constant_starts_from_one_point() -> None:
    network = traverse(0.7, value=0.7, known="A")
    network.set_gyro("gyro", 0.7, sigma=1e-4)
    assert fga.adjust(network).point("E")[:2] == pytest.approx(X["E"], abs=1e-6)


def test_a_free_constant_leaves_the_direction_of_a_network_open() -> None:
    network = traverse(0.7, known="A", value=0.7)
    with pytest.raises(fga.DatumError, match="rotation about z"):
        fga.adjust(network)
    network.datum = "free"
    assert fga.adjust(network).datum_defect == 1
