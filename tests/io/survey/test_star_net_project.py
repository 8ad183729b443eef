"""Projects of STAR*NET: settings, instruments, data files that they use or include, plans."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.survey.star_net import is_star_net
from factorgraph_adj.io.survey.star_net_project import star_net_system_code
from factorgraph_adj.units import ARCSEC
from tests.hostile.examples import Example
from tests.networks.star_net_projects import STAR_NET_PROJECT as PROJECT

FIRST = """\
C A 0 0 100 ! ! !
C B 120 10 104 ! ! !
C C 60 140 98 ! ! !
.INCLUDE sets/s.dat
L A-S 1.0001 80
"""
SET = """\
.INST SX12
DB S
DM A 211-20-24.7 64.0391 90-53-41.1
DM B 93-11-54.9 76.2168 87-44-39.0
DM C 345-42-38.1 100.5435 91-42-35.4
DE
"""
SECOND = """\
C T 20 70 100.5
B S-C 5-42-38.1
DB T
DM A 195-56-43.4 72.8028 90-23-36.6 ! ! &
DM S 135-00-00.0 42.4294 89-19-29.2
DE
"""
FILES = {
    "job.snproj": PROJECT,
    "first day.dat": FIRST,
    "second.dat": SECOND,
    "s.dat": SET,
}
FLAT = {**FILES, "first day.dat": FIRST.replace("sets/s.dat", "s.dat")}
NO_INFLUENCE = (
    # Comments, the version, other sections, and what concerns the solution.
    r"(?s)\|#|^job\.snproj\|.*(STAR\*NET|print_input_file|converge_limit|\[Listing\]|\[USER\]|username)",
    # Nothing uses them: the project is local and has neither bearings, vectors nor instrument S 9.
    r"\|(coordinate_system_name|project_elevation|common_datum|geoid_|longitude_|gps_factor)",
    r"\|(delta_elev_|angle_std_err|earth_radius|instrument_name                S 9)",
)
EXAMPLE_FILES = {
    "star-net project": Example("star-net-project", FLAT, "job.snproj", unread=NO_INFLUENCE),
}
OPTIONS: dict[str, Any] = {
    **{"adjustment": "3D", "linear": "Meters", "angular": "DMS", "order": "EN"},
    **{"stations": "AtFromTo", "distances": "slope", "refraction": 0.07, "level": 0.0015},
    **{"weight_levels_by": "length", "distance": 0.001, "distance_ppm": 1.5, "angle": 1.414},
    **{"direction": 1.0, "azimuth": 1.414, "zenith": 1.2, "elevation": 0.01524},
    **{"elevation_ppm": 0.0, "centring_instrument": 0.00075, "centring_target": 0.0008},
    "centring_vertical": 0.0005,
    "instruments": {
        "SX12": {
            **{"distance": 0.002, "distance_ppm": 2.0, "angle": 2.0, "direction": 2.0},
            **{"azimuth": 2.0, "zenith": 2.5, "elevation": 0.01524, "elevation_ppm": 0.0},
            **{"centring_instrument": 0.001, "centring_target": 0.001},
            "centring_vertical": 0.001,
        }
    },
}
"""The settings of the project as options of its data files."""


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return folder / "job.snproj"


def read(folder: Path, *changes: tuple[str, str], **options: Any) -> fga.Network:
    text = PROJECT
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return fga.read(write(folder, {**FLAT, "job.snproj": text}), **options)


def problems(folder: Path, *changes: tuple[str, str]) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(folder, *changes)
    return [str(p) for p in caught.value.problems]


def plain(network: fga.Network) -> list[Any]:
    """Return kinds, names, values and standard deviations of the observations."""
    return [
        (o.kind, o.points(), getattr(o, "value", None), o.sigma)
        for o in network.observations.values()
    ]


def test_a_project_is_its_data_files_with_its_settings(tmp_path: Path) -> None:
    network = read(tmp_path)
    second = tmp_path / "second.dat"
    same = fga.read_star_net(tmp_path / "first day.dat", options=OPTIONS, files=[second])
    assert len(network.observations) == 17
    for one, other in zip(plain(network), plain(same), strict=True):
        assert one[:3] == other[:3]
        for part in ("constant", "centring_instrument", "vertical_target"):
            a, b = (getattr(o[3], part, None) or 0.0 for o in (one, other))
            assert a == pytest.approx(b, rel=1e-9)
    assert network.name == "job"
    assert network.points["S"].held == ""
    solution = fga.adjust(network)
    np.testing.assert_allclose(solution.point("S"), (50.0, 40.0, 101.0), atol=0.001)


def test_an_included_file_stands_in_its_place_and_its_options_end_with_it(tmp_path: Path) -> None:
    nested = {**FILES, "sets/s.dat": ".INCLUDE ../s.dat # once more\nD A-S 64.0391\n"}
    network = fga.read(write(tmp_path, nested))
    found = [o for o in network.observations.values() if o.points() in (("S", "A"), ("A", "S"))]
    assert [o.source for o in found] == ["s.dat:3"] * 3 + ["s.dat:2", "first day.dat:5"]
    zenith, after = found[2], found[3]
    assert zenith.sigma.constant == pytest.approx(2.5 * ARCSEC)
    assert after.sigma.constant == pytest.approx(0.001)


def test_joined_codes_fix_and_free(tmp_path: Path) -> None:
    """Each of the two ends is what stands in the project, fixed_…_std_err."""
    changes = ("fixed_linear_std_err           1.000000000000000e-05", "fixed_linear_std_err 2e-6")
    network = read(tmp_path, changes)
    direction, distance, zenith = (
        o for o in network.observations.values() if o.source == "second.dat:4"
    )
    assert direction.sigma == pytest.approx(0.01 * ARCSEC)
    assert distance.sigma == pytest.approx(2e-6)
    assert zenith.sigma.constant == pytest.approx(1.2 * ARCSEC)


def test_what_a_project_has_beside_the_network_is_left_out_by_name(tmp_path: Path) -> None:
    network = read(
        tmp_path, ("[Listing]", "[Listing]"), ("gps_centering ", "new_key 1\ngps_centering ")
    )
    said = [str(left) for left in network.left_out]
    assert [s.split(" left out")[0] for s in said] == [
        "settings: 1",
        "sections: 2",
        "data files: 1",
    ]
    assert "new_key" in said[0] and "old.dat" in said[2]


def test_points_that_no_line_observes_are_left_out(tmp_path: Path) -> None:
    files = {**FLAT, "second.dat": SECOND + "C LOOSE 1 2 3\nC HELD 4 5 6 ! ! !\n"}
    network = fga.read(write(tmp_path, files))
    assert "LOOSE" not in network.points and "HELD" not in network.points
    assert any("LOOSE, HELD" in str(left) for left in network.left_out)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ([("linear_units                   Meters\n", "")],
         "section [Adjustment] lacks linear_units"),
        ([("linear_units                   Meters", "linear_units   Yards")],
         "job.snproj:7: linear_units 'Yards' is unknown; valid: Meters"),
        ([("zenith_std_err                 1.2", "zenith_std_err                 -1.2")],
         "zenith_std_err must be at least 0"),
        ([("zenith_std_err                 2.5000000000\n", "")],
         "instrument 'SX12' lacks zenith_std_err"),
        ([('3 "first day.dat"', '3 "lost.dat"')], "there is no data file 'lost.dat'"),
        ([('3 "first day.dat"', "3 first")], "a data file is a number and a name"),
        ([('3 "first day.dat"', '3 "../first day.dat"')], "lies outside the folder"),
        ([('3 "first day.dat"', '2 "first day.dat"'), ('1 "second.dat"', '0 "second.dat"')],
         "uses no data file"),
        ([("[USER]", "[UNKNOWN]")], "section 'UNKNOWN' is unknown"),
        ([("[USER]", "[Instrument]")], "section [Instrument] stands twice"),
        ([("instrument_name                SX12", "instrument_name                S 9")],
         "instrument 'S 9' stands twice"),
        ([("gps_transformations            0", "gps_transformations            1")],
         "gps_transformations is 1: transformations of GPS vectors are not read"),
        ([("vert_defl_east                 0.0", "vert_defl_east                 3.0")],
         "vert_defl_east is 3: deflections"),
        ([("local_default_datum            1", "local_default_datum            0")],
         "a common elevation of a local project is not read"),
    ],
)  # fmt: skip
def test_what_is_wrong_in_a_project_is_told(tmp_path: Path, changes: Any, said: str) -> None:
    assert said in "\n".join(problems(tmp_path, *changes))


GRID_PROJECT = (
    ("local_or_grid_adjustment       0", "local_or_grid_adjustment       1"),
    ("coordinate_order               EN", "coordinate_order               NE"),
    ("geoid_height                   0.0", "geoid_height                   -21.5"),
)


def test_the_coordinate_system_of_a_project_is_one_of_epsg(tmp_path: Path) -> None:
    pytest.importorskip("pyproj", reason="the extra crs is not installed")
    files = {"second.dat": "C A 5090000 682000 100 ! ! !\nD A-T 100 0.001\n"}
    only = ('3 "first day.dat"', '0 "first day.dat"')
    text = PROJECT
    for old, new in (*GRID_PROJECT, only):
        text = text.replace(old, new)
    network = fga.read(write(tmp_path, {**files, "job.snproj": text}))
    assert network.crs.name == "NAD83 / UTM zone 19N"
    place = np.array([network.points["A"].coordinates])
    found = network.crs.from_frame(network.frame, place, ["A"])
    np.testing.assert_allclose(found, [(682000, 5090000, 100)], atol=1e-6)
    at = network.crs.geodetic(network.frame, np.array([network.points["A"].coordinates]))
    assert float(at[2][0]) == pytest.approx(100 - 21.5, abs=1e-6)
    other = fga.read(tmp_path / "job.snproj", crs="EPSG:26919", geoid=0.0)
    at = other.crs.geodetic(other.frame, np.array([other.points["A"].coordinates]))
    assert float(at[2][0]) == pytest.approx(100, abs=1e-6)
    with pytest.raises(InputError, match=r"coordinate system 'UTM17-19' is unknown: state crs="):
        fga.read(write(tmp_path, {**files, "job.snproj": text.replace("UTM83", "UTM17")}))
    with pytest.raises(InputError, match="the project has a geoid model: state its file, geoid="):
        model = text.replace("geoid_modeling                 0", "geoid_modeling 1")
        fga.read(write(tmp_path, {**files, "job.snproj": model}))


@pytest.mark.parametrize(
    ("name", "code"),
    [
        ("UTM83-19", "EPSG:26919"),
        ("UTM83/CSRS-11N", "EPSG:2955"),
        ("NewBrunswick83", "EPSG:2953"),
        ("UTM83/CSRS-5N", None),
        ("Nowhere", None),
    ],
)
def test_names_of_coordinate_systems(name: str, code: str | None) -> None:
    assert star_net_system_code(name) == code


def test_a_local_project_has_a_scale_factor_and_its_lines_another(tmp_path: Path) -> None:
    """Horizontal lengths are multiplied: with tan z' = k tan z the heights stay."""
    scale = ("scale_factor                   1.0", "scale_factor                   0.9996")
    both = "DV A-T 72.8028 80-00-00\n"
    lines = f"D A-T 72.8028\n{both}V A-T 80-00-00\n.SCALE 1\n{both}"
    text = PROJECT.replace(*scale).replace('3 "first day.dat"', '0 "first day.dat"')
    files = {"job.snproj": text, "second.dat": SECOND.partition("DB")[0] + lines[14:]}
    network = fga.read(write(tmp_path, files))
    _, s, z, alone, s1, z1 = network.observations.values()
    assert s1.value == 72.8028 and z1.value == pytest.approx(np.radians(80))
    assert s.value * np.sin(z.value) == pytest.approx(0.9996 * s1.value * np.sin(z1.value))
    assert s.value * np.cos(z.value) == pytest.approx(s1.value * np.cos(z1.value))
    assert alone.value == z.value
    with pytest.raises(InputError, match=r"second\.dat:3: a slope distance needs its zenith angle"):
        fga.read(write(tmp_path, {**files, "second.dat": "C A 0 0 0\nC T 1 1 1\n" + lines}))


def test_other_names_of_points_are_theirs(tmp_path: Path) -> None:
    text = (
        ".ALIAS OLD=A\n.ALIAS PREFIX R_ T\n.ALIAS SUFFIX _x _1\nC A 0 0 100 ! ! !\n"
        "DB OLD\nDN R_1 0-0-0\nDN R_2_x 90-0-0\nDE\nTB OLD\nT T1 90-0-0 10 90-0-0\nTE R_2_x\n"
        ".ALIAS OFF\nD OLD-T1 10\n"
    )
    only = PROJECT.replace('3 "first day.dat"', '0 "first day.dat"')
    network = fga.read(write(tmp_path, {"job.snproj": only, "second.dat": text}))
    names = [o.points() for o in network.observations.values()]
    assert names[:2] == [("A", "T1"), ("A", "T2_1")]
    assert names[2] == ("T1", "A", "T2_1") and names[-1] == ("OLD", "T1")


# -- plans ----------------------------------------------------------------------------------------


def without_values(text: str) -> str:
    """Return the DM lines of a file with their targets alone."""
    rows = [(line, line.split()) for line in text.splitlines()]
    return "\n".join(
        " ".join([*words[:2], *words[5:]]) if words[0] == "DM" else line for line, words in rows
    )


def test_lines_without_values_are_readings_to_come(tmp_path: Path) -> None:
    """Its standard deviations are those of the adjustment of readings at the planned place."""
    measured = fga.adjust(read(tmp_path))
    east, north, up = measured.point("S").tolist()
    files = {
        **FLAT,
        "s.dat": without_values(SET) + f"\nC S {east:.9f} {north:.9f} {up:.9f}\n",
        "second.dat": without_values(SECOND.replace("C T", "# T"))
        + "\nC T {:.9f} {:.9f} {:.9f}\n".format(*measured.point("T")),
    }
    path = write(tmp_path, files)
    with pytest.raises(InputError, match=r"s\.dat:3: 5 lines from here have no values: .* plan"):
        fga.read(path)
    planned = fga.plan(fga.read_star_net_project(path, readings=False))
    for name in "ST":
        np.testing.assert_allclose(
            planned.solution.covariance(name), measured.covariance(name), rtol=2e-3, atol=1e-12
        )


def test_the_command_plans_a_project_and_refuses_to_adjust_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    from factorgraph_adj.cli.command_line import main

    path = write(tmp_path, {**FLAT, "s.dat": without_values(SET) + "\nC S 50 40 101\n"})
    assert main(["plan", str(path)]) == 0
    assert "Plan of job" in capsys.readouterr().out
    assert main(["adjust", str(path)]) == 2
    assert "readings to come (pre-analysis), which plan takes" in capsys.readouterr().err


def test_projects_and_data_are_known_by_their_content(tmp_path: Path) -> None:
    from factorgraph_adj.io.readers import READERS

    path = write(tmp_path, FLAT)
    old = tmp_path / "old.prj"
    old.write_text(PROJECT.partition("\n")[2], encoding="utf-8")
    assert {READERS.of(p).name for p in (path, old)} == {"star-net-project"}
    assert READERS.of(tmp_path / "second.dat").name == "star-net"
    for other in ("1,N,5000,1000\n2,N,5010,1000\n", "0.1 0.2 0.3\n4 5 6\n", "# only a comment\n"):
        (tmp_path / "table.dat").write_text(other, encoding="utf-8")
        assert not is_star_net(tmp_path / "table.dat")
    assert is_star_net(tmp_path / "s.dat")
