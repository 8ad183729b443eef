"""Wrong heights above surfaces, tilts, sights and azimuths of gyros in projects and in memory."""

from __future__ import annotations

from pathlib import Path

import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o

HEAD = "kind,photo,point,station,target,value,x,y,axes,level,profile,gyro,mount,time,"
HEAD += "body_x,body_y,body_z,seen_x,seen_y,seen_z,sigma_m,sigma_mgon\n"
COLUMNS = HEAD.strip().split(",")


PROJECT = """\
name = "heights"
[[camera]]
name = "C"
lens = { model = "brown" }
unit = "mm"
[camera.parameters]
c = 100.0
"""


def row(**fields: object) -> str:
    return ",".join(str(fields.get(c, "")) for c in COLUMNS) + "\n"


SUN = dict(zip(COLUMNS[14:20], (0, 0.6, 0.8, 0.8, 0, -0.6), strict=True))
GOOD = {
    "statoscope": {
        "kind": "profile_height",
        "photo": "1",
        "value": 9,
        "profile": "s",
        "sigma_m": 1,
    },
    "shore": {"kind": "level_height", "point": "A", "level": "lake", "sigma_m": 1},
    "tilt": {"kind": "photo_tilt", "photo": "1", "x": 0, "y": 0, "sigma_mgon": 1},
    "sun": {"kind": "photo_sight", "photo": "1", "sigma_mgon": 1, **SUN},
    "gyro": {
        "kind": "gyro_azimuth",
        "station": "A",
        "target": "B",
        "value": 1,
        "gyro": "g",
        "sigma_mgon": 1,
    },
}


def read(folder: Path, **rows: dict[str, object]) -> fga.Network:
    tables = {
        "project.toml": PROJECT,
        "points.csv": "name,x,y,z\nA,0,0,0\nB,10,0,0\n",
        "photos.csv": "name,camera,x,y,z\n1,C,0,0,9\n",
        "levels.csv": "name,value_m\nlake,1\n",
        "profiles.csv": "name,free,height_t_mm,sigma_height_t_mm\ns,height,200,100\n",
        "gyros.csv": "name,value_mgon,sigma_mgon\ng,3,1\n",
        "observations.csv": HEAD + "".join(row(**r) for r in rows.values()),
    }
    for name, text in tables.items():
        (folder / name).write_text(text, encoding="utf-8")
    return fga.read_project(folder / "project.toml")


def test_what_is_right_is_read(tmp_path) -> None:
    network = read(tmp_path, **GOOD)
    assert [x.kind for x in network.observations.values()] == [r["kind"] for r in GOOD.values()]
    sun = network.observations["4"]
    assert (sun.value, sun.body, sun.seen) == ((0.0, 0.0), (0.0, 0.6, 0.8), (0.8, 0.0, -0.6))
    assert network.observations["2"].value == 0.0
    profile = network.profiles["s"]
    assert profile.values == (0.0, 0.2, 0.0, 0.0)
    assert profile.fixed == (False, False, True, True)
    assert profile.sigma[1] == pytest.approx(0.1)
    assert network.gyros["g"].values[0] == pytest.approx(3e-3 * 3.14159265 / 200)


WRONG = {
    "a photo and a point": (
        {**GOOD["statoscope"], "point": "A"},
        "observations.csv:2: profile_height A 1: give either a point or a photo",
    ),
    "an unknown profile": (
        {**GOOD["statoscope"], "profile": "z"},
        "observations.csv:2: profile_height 1: unknown height profile 'z'; known: s"
        "; rows of profiles.csv state them, or set_profile of Network",
    ),
    "a point with a mount": (
        {"kind": "profile_height", "point": "A", "value": 9, "mount": "m", "sigma_m": 1},
        "observations.csv:2: profile_height A: a point has neither lever_arm nor mount; give the "
        "photo of an instrument",
    ),
    "an unknown level": (
        {**GOOD["shore"], "level": "sea"},
        "observations.csv:2: level_height A: unknown level surface 'sea'; known: lake"
        "; rows of levels.csv state them, or set_level of Network",
    ),
    "no level": (
        {**GOOD["shore"], "level": ""},
        "observations.csv:2: level_height A: level is missing",
    ),
    "an axis that no clinometer has": (
        {**GOOD["tilt"], "axes": "xx", "y": ""},
        "observations.csv:2: photo_tilt 1: axes must be some of x, y, not 'xx'",
    ),
    "no reading of an axis": (
        {**GOOD["tilt"], "y": ""},
        "observations.csv:2: photo_tilt 1: y is missing",
    ),
    "no unit vector": (
        {**GOOD["sun"], "seen_x": 0.9},
        "observations.csv:2: photo_sight 1: seen must be a unit vector of three numbers, not "
        "(0.9, 0.0, -0.6)",
    ),
    "no body": (
        {**GOOD["sun"], "body_z": ""},
        "observations.csv:2: photo_sight 1: body_z is missing",
    ),
    "an unknown gyrotheodolite": (
        {**GOOD["gyro"], "gyro": "h"},
        "observations.csv:2: gyro_azimuth A B: unknown gyrotheodolite 'h'; known: g"
        "; rows of gyros.csv state them, or set_gyro of Network",
    ),
    "a negative standard deviation": (
        {**GOOD["shore"], "sigma_m": -1},
        "observations.csv:2: level_height A: sigma_m must be greater than zero, not -1",
    ),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_named_with_file_line_and_what_is_valid(what: str, tmp_path) -> None:
    fields, message = WRONG[what]
    with pytest.raises(fga.InputError) as error:
        read(tmp_path, wrong=fields)
    assert message in [str(p) for p in error.value.problems]


@pytest.mark.parametrize(
    ("state", "message"),
    [
        (
            lambda n: n.set_profile("p", free=("slope",)),
            "free must be some of height, height_t, height_tt, scale, not 'slope'",
        ),
        (lambda n: n.set_profile("p", free=("height",), sigma={"height": 1}), "either free or sig"),
        (lambda n: n.set_gyro("g", sigma=1e-4), "gyrotheodolite 'g': it is held or weighted, and"),
    ],
)
def test_what_is_stated_wrongly_is_named(state, message: str) -> None:
    with pytest.raises(fga.InputError, match=message):
        state(fga.Network("wrong"))


def test_a_profile_that_is_weighted_is_not_free() -> None:
    network = fga.Network("weighted")
    network.set_profile("p", sigma={"height": 2.0})
    assert network.profiles["p"].sigma[0] == 2.0
    assert network.profiles["p"].fixed == (False, True, True, True)
    assert isinstance(o.ProfileHeight("A", 1.0, sigma=1.0, profile="p"), fga.Observation)
