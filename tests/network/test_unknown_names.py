"""Messages about names and arguments that a new user leaves out or misspells."""

from __future__ import annotations

from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import known, similar
from factorgraph_adj.models.lens import BrownLens
from factorgraph_adj.observations import FrameDistance, PhotoPosition, SlopeDistance


def tracker(name: str) -> fga.Network:
    network = fga.Network("hall")
    network.add_frame(name)
    for i in range(6):
        network.add_point(f"P{i}", (1.0 + i, 2.0 * i, i % 2), fixed="xyz")
        network.add(FrameDistance(name, f"P{i}", 1.0, sigma=1e-4))
    return network


def test_a_missing_row_of_a_frame_is_told_once_with_its_table(tmp_path: Path) -> None:
    fga.write_project(tracker("LT2"), tmp_path / "project.toml")
    (tmp_path / "frames.csv").write_text("name,free\nLT1,rotation offset\n")
    with pytest.raises(fga.InputError) as error:
        fga.read_project(tmp_path)
    (problem,) = error.value.problems
    assert problem.where.startswith("observations.csv:2: ")
    assert problem.what == (
        "unknown frame 'LT2'; known: LT1; rows of frames.csv state them, or add_frame of Network "
        "(and in 5 more observations)"
    )


def test_a_kind_without_a_function_of_its_own_is_stated_by_set_unknown() -> None:
    network = fga.Network("robot")
    for name in "AB":
        network.add_point(name, (0, 0, 0))
    with pytest.raises(fga.InputError, match="or set_unknown of Network"):
        network.add(fga.HeadingDifference("A", "B", 0.1, sigma=0.01))
    for name in "AB":
        network.set_unknown("heading", name)
    network.add(fga.HeadingDifference("A", "B", 0.1, sigma=0.01))


def test_names_with_other_numbers_are_not_asked_for() -> None:
    assert similar("LT2", ["LT1", "LT3"]) == ""
    assert similar("lt2", ["LT1", "LT2"]) == "; did you mean 'LT2'?"
    assert similar("scan_2", ["scan1", "scan2"]) == "; did you mean 'scan2'?"


def test_the_kind_of_a_shape_is_told_before_its_origin() -> None:
    network = fga.Network("pipe")
    with pytest.raises(fga.InputError, match=r"'cylindre'.*did you mean 'cylinder'"):
        network.add_shape("Q", "cylindre")
    with pytest.raises(fga.InputError, match="shape 'Q': it needs an origin"):
        network.add_shape("Q", "cylinder")
    assert not network.frames


def test_a_drift_without_times_is_told_of_the_time() -> None:
    network = fga.Network("flight")
    network.add_camera("C", BrownLens(), {"c": 100.0}, free=())
    network.set_drift("flight", free=("x", "x_t"))
    for i in range(4):
        at = (100.0 * i, 0.0, 500.0)
        network.add_photo(f"F{i}", "C", position=at, omega_phi_kappa=(0, 0, 0), fixed=True)
        network.add(PhotoPosition(f"F{i}", at, sigma=(0.1,) * 3, drift="flight"))
    with pytest.raises(fga.DatumError) as error:
        fga.adjust(network)
    assert "`time` is 0 in those that leave it out" in str(error.value)


def test_the_empty_name_of_a_default_is_not_listed() -> None:
    network = fga.Network("photos")
    for name in ("A", "B"):
        network.add_point(name, (10.0 * (name == "B"), 0, 0), fixed="xyz" if name == "A" else "yz")
    network.add(SlopeDistance("A", "B", 10.0, sigma=1e-3))
    solution = fga.adjust(network)
    assert "" in solution.equations.unknowns["photo_motion"].names
    with pytest.raises(fga.InputError, match=r"unknown motion 'Q'; known: none$"):
        solution.unknown("photo_motion", "Q")
    assert known(["", "U1"]) == "U1"
