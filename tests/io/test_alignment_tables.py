"""Kinds of metrology in tables and records; what is wrong is named with file and line."""

from __future__ import annotations

import json

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from factorgraph_adj.io.observation_records import observation_from_record, observation_record
from factorgraph_adj.io.project import load_project
from tests.networks.alignment import body, measured, offsets

TABLES = {
    "project.toml": 'name = "tunnel"\n[units]\nlength = "m"\nangle = "gon"\n',
    "points.csv": "name,x,y,z,fixed\nA,0,0,0,xyz\nB,0,30,0.01,xyz\nC,0.1,60,0,xyz\n",
    "frames.csv": "name,free,origin_x,origin_y,origin_z,level\nW,rx ry rz x z,0,0,0.1,yes\n",
    "sizes.csv": "name,value_m,fixed\nsag,0.012,yes\n",
    "levels.csv": "name,value_m\ntube,\n",
    "observations.csv": (
        "kind,frame,point,x,z,value,sag,length,level,side,sigma_mm,sigma_mgon\n"
        "wire_reading,W,A,0.01,0.1,,sag,60,,,0.01,\n"
        "wire_reading,W,B,0.02,0.08,,sag,60,,,0.01,\n"
        "wire_reading,W,C,-0.08,0.1,,sag,60,,,0.01,\n"
        "hydrostatic_reading,,A,,,0.11,,,tube,1,0.005,\n"
        "hydrostatic_reading,,B,,,0.10,,,tube,,0.005,\n"
        "frame_roll,W,A,,,0,,,,,,1\n"
    ),
}


def write(folder, name: str = "", old: str = "", new: str = ""):
    """Write the project, with one text of a file replaced."""
    for file, text in TABLES.items():
        if file == name:
            assert old in text
            text = text.replace(old, new, 1)
        (folder / file).write_text(text, encoding="utf-8")
    return folder


def test_the_project_is_read_and_adjusted(tmp_path) -> None:
    network = load_project(write(tmp_path)).network
    kinds = {x.kind for x in network.observations.values()}
    assert kinds == {"wire_reading", "hydrostatic_reading", "frame_roll"}
    s = fga.adjust(network)
    assert s.redundancy == 6 + 2 + 1 - 5 - 1
    assert s.unknown("level", "tube").values[0] == pytest.approx(0.11, abs=1e-3)


FIRST = "wire_reading,W,A,0.01,0.1,,sag,60,,,0.01"
WATER = "hydrostatic_reading,,A,,,0.11,,,tube,1,0.005"
WRONG = {
    "a wire without a sag": (
        *(FIRST, "wire_reading,W,A,0.01,0.1,,,60,,,0.01"),
        "observations.csv:2: wire_reading W A: sag is missing",
    ),
    "a sag that is not stated": (
        *(FIRST, "wire_reading,W,A,0.01,0.1,,sagg,60,,,0.01"),
        "observations.csv:2: wire_reading W A: unknown size 'sagg'",
    ),
    "a wire without a length": (
        *(FIRST, "wire_reading,W,A,0.01,0.1,,sag,,,,0.01"),
        "observations.csv:2: wire_reading W A: length is missing",
    ),
    "a wire of negative length": (
        *(FIRST, "wire_reading,W,A,0.01,0.1,,sag,-60,,,0.01"),
        "observations.csv:2: wire_reading W A: the length of the wire must be greater than zero",
    ),
    "a wire without a reading": (
        *(FIRST, "wire_reading,W,A,0.01,,,sag,60,,,0.01"),
        "observations.csv:2: wire_reading W A: z is missing",
    ),
    "water that is not stated": (
        *(WATER, "hydrostatic_reading,,A,,,0.11,,,tub,1,0.005"),
        "observations.csv:5: hydrostatic_reading A: unknown level surface 'tub'",
    ),
    "a sensor that reads sidewards": (
        *(WATER, "hydrostatic_reading,,A,,,0.11,,,tube,2,0.005"),
        "observations.csv:5: hydrostatic_reading A: side must be 1 (reads upwards) or -1",
    ),
}


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_named(wrong: str, tmp_path) -> None:
    old, new, why = WRONG[wrong]
    with pytest.raises(fga.InputError) as caught:
        load_project(write(tmp_path, "observations.csv", old, new))
        fga.adjust(load_project(tmp_path).network)
    assert why in str(caught.value).replace(f"{tmp_path}/", "")


MADE = {
    "a wire that reads along itself": (
        lambda: o.WireReading("W", "A", (0.0,), axes="y", sag="s", length=1, sigma=(1.0,)),
        "axes must be some of x, z, not 'y'",
    ),
    "a unit vector that is too long": (
        lambda: o.UnitVector("F", "A", "B", (0.9, 0.9), sigma=(1e-5, 1e-5)),
        "a unit vector has no components 0.9, 0.9",
    ),
    "a negative distance from a plumb line": (
        lambda: o.PlumbOffset("F", "A", -1.0, sigma=1.0),
        "cannot be negative",
    ),
    "a line through one point": (
        lambda: o.LineOffset("A", "B", "B", 1.0, sigma=1.0),
        "cannot join a point to itself",
    ),
    "a sight below the nadir": (
        lambda: o.SightOffset("A", "B", 1.0, horizontal=0.0, zenith=4.0, sigma=1.0),
        "a zenith angle lies between 0 and 200 gon",
    ),
    "an inclinometer on nothing": (
        lambda: o.FrameInclination("", "A", 0.0, sigma=1.0),
        "names must be non-empty text",
    ),
}


@pytest.mark.parametrize("wrong", MADE)
def test_wrong_observations_are_refused(wrong: str) -> None:
    make, why = MADE[wrong]
    with pytest.raises(fga.InputError, match=why.replace("(", r"\(")):
        make()


@pytest.mark.parametrize("make", [offsets, body])
def test_a_project_is_written_and_read_again(make, tmp_path) -> None:
    network = measured(make())
    fga.write_project(network, tmp_path / "project.toml")
    again = load_project(tmp_path).network
    for a, b in zip(network.observations.values(), again.observations.values(), strict=True):
        assert a.kind == b.kind
        assert np.allclose(a.value, b.value, rtol=0, atol=1e-15)
    s, t = fga.adjust(network), fga.adjust(again)
    assert s.vtpv == pytest.approx(t.vtpv, rel=1e-6)
    for x in network.observations.values():
        line = json.loads(json.dumps(observation_record(x)))
        assert observation_from_record(line).kind == x.kind


def test_a_table_that_is_missing_is_named(tmp_path) -> None:
    write(tmp_path)
    (tmp_path / "sizes.csv").unlink()
    with pytest.raises(fga.InputError) as caught:
        load_project(tmp_path)
    told = str(caught.value)
    assert "unknown size 'sag'; known: none; rows of sizes.csv state them" in told


def test_readings_that_give_no_coordinates_are_not_called_absent(tmp_path) -> None:
    network = load_project(write(tmp_path, "points.csv", "B,0,30,0.01,xyz", "B,,30,,y")).network
    with pytest.raises(fga.ApproximationError, match="give no approximate coordinates: state some"):
        fga.adjust(network)


def test_the_errors_of_a_reading_may_make_a_unit_vector_a_little_longer() -> None:
    read = o.UnitVector("F", "A", "B", (0.6, 0.80005), sigma=(1e-5, 1e-5))
    assert np.hypot(*read.value) > 1.0
    with pytest.raises(fga.InputError, match="exceeds 1 by more than 10 σ"):
        o.UnitVector("F", "A", "B", (0.6, 0.8002), sigma=(1e-5, 1e-5))
