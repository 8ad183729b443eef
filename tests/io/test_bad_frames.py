"""What is wrong in frames.csv, and in coordinates in frames, is told with file, line and advice."""

from __future__ import annotations

from pathlib import Path

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.io.observation_records import observation_from_record
from factorgraph_adj.io.project import load_project
from factorgraph_adj.validate.network_structure import check

POINTS = "name,x,y,z,fixed\nA,0,0,0,xyz\nB,9,0,1,xyz\nC,0,7,2,xyz\nD,8,8,0,xyz\nT,4,4,1,\n"
MEASURED = {"A": "0,0,0", "B": "9,0,1", "C": "0,7,2", "D": "8,8,0"}
TEXTS = {
    "project.toml": 'name = "room"\n[sigma.frame_coordinate]\nsigma_mm = 2\n',
    "points.csv": POINTS,
    "frames.csv": "name,free,origin,level,rx_gon,sigma_ln_scale\n"
    "M1,rotation offset scale,,,,\nS1,rz,T,yes,,1e-5\n",
    "observations.csv": "kind,frame,point,photo,x,y,z,axes\n"
    + "".join(
        f"frame_coordinate,{f},{p},,{xyz},\n" for f in ("M1", "S1") for p, xyz in MEASURED.items()
    ),
}
FIRST = "frame_coordinate,M1,A,,0,0,0,"
VALID = "rotation, offset, scale, rx, ry, rz, x, y, z, ln_scale"
WRONG = {
    # name: table, what stands there, what is put there, the problem
    "a misspelt word of free": (
        *("frames.csv", "rotation offset", "rotatoin offset"),
        f"frames.csv:2: frame 'M1': free must be some of {VALID}, not 'rotatoin'; did you mean "
        "'rotation'?",
    ),
    "an unknown origin": (
        *("frames.csv", "rz,T", "rz,U"),
        "frames.csv:3: frame 'S1': unknown point 'U'; known: A, B, C, D, T",
    ),
    "a word for level": (
        *("frames.csv", "T,yes", "T,maybe"),
        "frames.csv:3: frame 'S1': level must be yes or no, not 'maybe'",
    ),
    "the origin as a place": (
        *("observations.csv", "frame_coordinate,S1,A,", "frame_coordinate,S1,T,"),
        "observations.csv:6: frame_coordinate S1 T: point 'T' is the origin of frame 'S1', so that "
        "its coordinates there are minus the offset: state or weight that offset, and take the "
        "observation out",
    ),
    "a rotation that is no number": (
        *("frames.csv", "scale,,,,", "scale,,,abc,"),
        "frames.csv:2: frame 'M1': rx_gon: 'abc' is not a number",
    ),
    "an infinite rotation": (
        *("frames.csv", "scale,,,,", "scale,,,inf,"),
        "frames.csv:2: frame 'M1': rx_gon: 'inf' is not a finite number",
    ),
    "a negative standard deviation": (
        *("frames.csv", "1e-5", "-1e-5"),
        "frames.csv:3: frame 'S1': sigma_ln_scale must be greater than zero, not -1e-5",
    ),
    "a component free and weighted": (
        *("frames.csv", "S1,rz,", "S1,rz scale,"),
        "frames.csv:3: frame 'S1': ln_scale: either free or sigma, not both",
    ),
    "an unknown unit of a rotation": (
        *("frames.csv", "rx_gon", "rx_foot"),
        "frames.csv:1: unknown unit 'foot' in 'rx_foot'; valid: rad, mrad, gon, mgon, cc, deg, "
        "arcmin, arcsec",
    ),
    "an unknown column of frames": (
        *("frames.csv", "level", "levl"),
        "frames.csv:1: unknown column 'levl'; did you mean 'level'?",
    ),
    "one tilt weighted alone": (
        *("frames.csv", "sigma_ln_scale", "sigma_rx_mgon"),
        "frames.csv:3: frame 'S1': weight rx and ry, the tilts, or all three rotations: they do "
        "not commute",
    ),
    "an unknown frame": (
        *("observations.csv", FIRST, "frame_coordinate,M2,A,,0,0,0,"),
        "observations.csv:2: frame_coordinate M2 A: unknown frame 'M2'; known: M1, S1"
        "; rows of frames.csv state them, or add_frame of Network",
    ),
    "no frame": (
        *("observations.csv", FIRST, "frame_coordinate,,A,,0,0,0,"),
        "observations.csv:2: frame_coordinate A: frame is missing",
    ),
    "an unknown point in a frame": (
        *("observations.csv", FIRST, "frame_coordinate,M1,Z,,0,0,0,"),
        "observations.csv:2: frame_coordinate M1 Z: unknown point 'Z'; known: A, B, C, D, T",
    ),
    "an unknown photo in a frame": (
        *("observations.csv", FIRST, "frame_coordinate,M1,,7,0,0,0,"),
        "observations.csv:2: frame_coordinate M1 7: unknown photo '7'; known: none",
    ),
    "no place": (
        *("observations.csv", FIRST, "frame_coordinate,M1,,,0,0,0,"),
        "observations.csv:2: frame_coordinate M1: give either a point or a photo",
    ),
    "a point and a photo": (
        *("observations.csv", FIRST, "frame_coordinate,M1,A,7,0,0,0,"),
        "observations.csv:2: frame_coordinate M1 A 7: give either a point or a photo",
    ),
    "axes east and north": (
        *("observations.csv", FIRST, "frame_coordinate,M1,A,,0,0,0,en"),
        "observations.csv:2: frame_coordinate M1 A: axes must be some of x, y, z, not 'en'",
    ),
    "a coordinate of an axis that was not measured": (
        *("observations.csv", FIRST, "frame_coordinate,M1,A,,0,0,0,xy"),
        "observations.csv:2: frame_coordinate M1 A: z has no use here",
    ),
    "a coordinate that is missing": (
        *("observations.csv", FIRST, "frame_coordinate,M1,A,,,0,0,"),
        "observations.csv:2: frame_coordinate M1 A: x is missing",
    ),
    "a coordinate that is no number": (
        *("observations.csv", FIRST, "frame_coordinate,M1,A,,0,0o,0,"),
        "observations.csv:2: frame_coordinate M1 A: y: '0o' is not a number",
    ),
    "a default standard deviation below zero": (
        *("project.toml", "sigma_mm = 2", "sigma_mm = -2"),
        "project.toml:3: [sigma.frame_coordinate]: sigma_mm must be greater than zero, not -2",
    ),
}


def problems(folder: Path, texts: dict[str, str]) -> list[str]:
    """Return the problems of reading a project, or else of checking it."""
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    try:
        project = load_project(folder)
    except InputError as error:
        return [str(p) for p in error.problems]
    return [str(p) for p in check(project.network, sources=project.sources)]


def test_the_project_that_the_others_break_has_no_problems(tmp_path) -> None:
    assert problems(tmp_path, TEXTS) == []


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_first(name, tmp_path) -> None:
    table, old, new, message = WRONG[name]
    assert old in TEXTS[table]
    assert problems(tmp_path, TEXTS | {table: TEXTS[table].replace(old, new, 1)})[0] == message


@pytest.mark.parametrize(
    ("columns", "cells", "message"),
    [
        ("origin,origin_x,origin_y,origin_z", "T,1,2,3", "give either the point origin or"),
        ("origin,origin_x,origin_y,origin_z", ",1,,", "are given together, or none of them"),
    ],
)
def test_an_origin_is_a_point_or_three_coordinates(columns, cells, message, tmp_path) -> None:
    texts = TEXTS | {"frames.csv": f"name,free,{columns}\nM1,rotation,{cells}\nS1,rz,T,,,\n"}
    (found,) = [p for p in problems(tmp_path, texts) if "frames.csv" in p]
    assert found.startswith("frames.csv:2: frame 'M1': ")
    assert message in found


def test_a_frame_that_is_there_twice_is_refused_with_both_lines(tmp_path) -> None:
    twice = TEXTS["frames.csv"] + "M1,rz,,,,\n"
    assert problems(tmp_path, TEXTS | {"frames.csv": twice}) == [
        "frames.csv:4: frame 'M1': duplicate name of a frame; first in line 2"
    ]


def test_a_frame_that_is_wrong_does_not_make_its_origin_and_its_readings_wrong(tmp_path) -> None:
    wrong = TEXTS["frames.csv"].replace("T,yes", "T,maybe")
    assert len(problems(tmp_path, TEXTS | {"frames.csv": wrong})) == 1


def test_a_record_without_a_frame_is_refused() -> None:
    with pytest.raises(InputError, match="frame is missing"):
        observation_from_record(
            {"kind": "frame_coordinate", "point": "A", "x": 1, "y": 2, "z": 3, "sigma_mm": 1}
        )
