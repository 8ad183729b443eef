"""The table of readings in two faces: what it becomes, and what is wrong with it."""

from __future__ import annotations

from math import pi

import pytest

import factorgraph_adj as fga
from factorgraph_adj.observations import Direction, SlopeDistance, ZenithAngle

PROJECT = """name = "book"
[sigma.direction]
sigma_mgon = 1
[sigma.zenith_angle]
sigma_mgon = 1
[sigma.slope_distance]
sigma_mm = 2
ppm = 2
"""
POINTS = """name,x,y,z,fixed
A,0,0,100,xyz
B,60,10,101,xyz
C,-20,50,103,xyz
S,15,20,102,
"""
READINGS = """station,target,face,direction,zenith,distance,instrument_height,target_height
S,A,I,12.3000,105.3080,25.0865,1.5,1.5
S,A,,212.3040,294.6980,25.0869,1.5,1.5
S,B,1,305.3310,101.3728,46.1073,1.5,1.5
S,B,II,105.3350,298.6332,46.1077,1.5,1.5
S,C,,138.1740,98.6070,46.1080,1.5,1.5
S,C,2,338.1782,301.3980,46.1076,1.5,1.5
"""


def write(folder, *, readings=READINGS, project=PROJECT):
    (folder / "project.toml").write_text(project)
    (folder / "points.csv").write_text(POINTS)
    (folder / "readings.csv").write_text(readings)
    return folder


def problems(folder):
    with pytest.raises(fga.InputError) as error:
        fga.read_project(folder)
    return [str(p) for p in error.value.problems]


def test_readings_become_means_or_observations_of_both_faces(tmp_path):
    means = fga.read_project(write(tmp_path))
    kinds = [type(o) for o in means.observations.values()]
    assert kinds == [Direction, ZenithAngle, SlopeDistance] * 3
    d, z, s = list(means.observations.values())[:3]
    assert d.value == pytest.approx(12.302 * pi / 200) and d.sigma == pytest.approx(
        pi / 2e5 / 2**0.5
    )
    assert z.value == pytest.approx(105.305 * pi / 200) and z.source == "readings.csv:2"
    assert (s.sigma.constant, s.sigma.ppm) == (pytest.approx(0.002 / 2**0.5), 2.0)
    assert d.instrument_height == 1.5
    both = fga.read_project(write(tmp_path, project=PROJECT + '[readings]\nfaces = "both"\n'))
    observed = list(both.observations.values())
    assert [o.face for o in observed if isinstance(o, Direction)] == [1, 2] * 3
    assert observed[1].value == pytest.approx(105.308 * pi / 200)
    assert list(both.of_kind("index_error")) == ["S/1"]
    assert list(both.of_kind("collimation_error")) == ["S/1"]


WRONG = {
    "every row": (
        READINGS.replace("S,A,I,12.3000", "S,A,III,12.3000").replace("S,B,1,", "S,Z,1,"),
        [
            "readings.csv:2: S – A: face must be 1 or 2 (I or II), or empty where zenith tells it, "
            "not 'III'",
            "readings.csv:4: unknown point 'Z'; known: A, B, C, S",
        ],
    ),
    "a face that is not": (
        READINGS.replace("S,A,I,12.3000,105.3080", "S,A,2,12.3000,105.3080"),
        [
            "readings.csv:2: S – A, set 1, face 2: a zenith reading of 105.3080 gon belongs to the "
            "other face"
        ],
    ),
    "a height that differs": (
        READINGS.replace("294.6980,25.0869,1.5,1.5", "294.6980,25.0869,1.5,1.3"),
        [
            "readings.csv:3: S – A, set 1, face 2: its heights differ from those of the other "
            "face: give it another set"
        ],
    ),
    "a target twice": (
        READINGS.replace("S,B,1", "S,A,1"),
        [
            "readings.csv:4: S – A, set 1, face 1: is read twice in this face (first in "
            "readings.csv:2): give the second reading another set"
        ],
    ),
    "a face that nothing implies": (
        READINGS.replace("S,A,,212.3040,294.6980", "S,A,,212.3040,"),
        [
            "readings.csv:3: S – A, set 1: the face is missing: give 1 or 2, or a zenith reading, "
            "which implies it"
        ],
    ),
    "a column": (
        READINGS.replace("zenith,", "zenit,"),
        ["readings.csv:1: unknown column 'zenit'; did you mean 'zenith'?"],
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_is_wrong_is_told_with_file_and_line(tmp_path, name):
    readings, expected = WRONG[name]
    found = problems(write(tmp_path, readings=readings))
    assert set(expected) <= set(found)
    if name != "a column":  # without zenith readings faces are missing too
        assert len(found) == len(expected)


def test_sigma_of_a_reading_and_the_choice_of_faces_are_checked(tmp_path):
    bare = PROJECT.replace("[sigma.zenith_angle]\nsigma_mgon = 1\n", "")
    assert problems(write(tmp_path, project=bare)) == [
        "readings.csv: zenith: no standard deviation of a reading in one face: state "
        "[sigma.zenith_angle]"
    ]
    other = PROJECT + '[readings]\nfaces = "one"\n'
    assert problems(write(tmp_path, project=other)) == [
        "project.toml:10: [readings]: unknown faces 'one'; valid: means, both"
    ]
    centred = PROJECT.replace(
        "[sigma.zenith_angle]\n", "[sigma.zenith_angle]\ncentring_target_mm = 1\n"
    )
    (problem,) = problems(write(tmp_path, project=centred + '[readings]\nfaces = "both"\n'))
    assert problem.startswith("sigma_zenith has centring, which the two faces of a target share")
