"""Data files of STAR*NET: examples of its manual, each data type by hand, writing and damage."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.stochastic_model import StandardDeviation
from factorgraph_adj.units import ARCSEC, GON
from tests.hostile.damage import DAMAGES
from tests.networks.survey_files import STAR_NET_OPTIONS as METRIC

FOOT = 1200.0 / 3937.0
OPTIONS = {**METRIC, "linear": "FeetUS", "angular": "DMS"}

TRAVERSE_2D = """# STAR*NET V6, A Tour of STAR*NET, example 1: 2D job with multi-loop traverses
C 1 5045.572 5495.338 ! !      # fixed coordinates
C 6 5000 5190                  # approximate coordinates
TB 6
T 1 99-47-25 205.03
T 2 115-10-00 134.19
T 3 94-51-53 105.44
T 4 216-46-09 161.57 'Existing post
T 5 106-26-42 160.71 'Iron pipe
T 6 86-57-49 308.30
TE 1
TB 2
T 3 225-47-02 115.41
T 7 97-31-36 284.40
T 8 115-14-57 191.66
T 9 156-15-44 166.90
M 9-8-5 83-45-28 161.95
T 10 106-12-32 151.34
TE 6 164-00-42 1
B 8-7 n79-52-31e !
"""
LEVELS = """# STAR*NET V6, A Tour of STAR*NET, example 8: level network with 4 fixed benchmarks
E TIDAL1 1.375 ! 'NGS Ref 1
E TIDAL2 2.165 !
E BM75 23.768 !
E BM26 57.129 !
L TIDAL1-129 12.345 20100
L BM75-129 -10.023 25300
L BM75-125 15.920 31200
L 129-130 22.130 37400 'Central
L 130-125 3.833 28100
L 129-128 11.810 41700
L 128-130 10.336 32100
L 125-BM26 17.458 37500
L BM26-126 2.814 39200
L 130-126 24.065 40900
L 128-126 34.422 52200
L 126-127 -15.485 48100
L 128-127 18.95 45300
L TIDAL2-127 42.321 17700
.2D
C TIDAL1 11.0 12.0
C 125 8.7 3.9
"""
TRAVERSE_3D = """# STAR*NET V6, Reference Manual, page 69: 3D traverse with negative (left) angles
C 1 5000 5000 900 ! ! !
C 4 5000 5300 970
B 3-2 N75-02-21W !
TB 4 'Albert B. Cadwell Boundary
T 1 -90-00-00 274.00 85-14-00 5.25/5.24
T 2 -75-00-00 311.10 82-50-00 5.22/5.24
T 3 -105-00-00 193.50 93-28-00 5.20/5.21
M 3-2-5 75-00-00 100.00 90-00-00 5.20/5.18
M 3-2-6 165-00-00 75.00 90-00-00 5.20/5.22
T 4 -90-00-00 302.30 99-30-00 5.25/5.21
TE 1
"""
LOOPS = """# STAR*NET V6, Reference Manual, page 70: traverse from a fixed bearing
C 1 5000.00 5000.00 ! !
C 5 4427.12 7245.55 ! !
TB N45-30-40W
T 1 123-40-28 537.52
T 2 217-11-37 719.56
T 3 113-52-15 397.66
T 4 260-19-24 996.23
TE 5
TB 1
T 2 120-11-12 473.25
T 6 -101-32-30 625.76
T 7 198-13-09 533.66
T 8 172-07-27 753.22
T 9 -84-32-20 661.01
TE 5 -73-02-46 4
D 4-8 361.30
"""


def read(tmp_path, text: str, **changes: Any):
    path = tmp_path / "job.dat"
    path.write_text(text, encoding="utf-8")
    return fga.read_star_net(path, options={**OPTIONS, **changes})


def only(tmp_path, line: str, **changes: Any):
    """Return the observations of one line."""
    return list(read(tmp_path, line, **changes).observations.values())


def problems(tmp_path, text: str, **changes: Any) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(tmp_path, text, **changes)
    return [str(p) for p in caught.value.problems]


# -- examples of the manual -----------------------------------------------------------------------


def test_the_2d_traverses_of_the_tour_fit_and_hold_their_bearing(tmp_path):
    network = read(tmp_path, TRAVERSE_2D, adjustment="2D")
    solution = fga.adjust(network)
    # 12 distances, 13 angles and a bearing for 9 points in plan.
    assert (len(network.observations), solution.redundancy) == (26, 8)
    assert 0.5 < solution.sigma0 < 1.5
    e, n = (solution.point("7") - solution.point("8"))[:2]
    bearing = math.radians(79 + 52 / 60 + 31 / 3600)
    assert abs(math.atan2(e, n) - bearing) < 0.1 * ARCSEC
    assert np.allclose(solution.point("1")[:2] / FOOT, (5495.338, 5045.572), atol=1e-9)
    # The figures that stand in the file: sides agree within the tolerance of the job.
    side = np.linalg.norm(solution.point("10") - solution.point("6")) / FOOT
    assert abs(side - 151.34) < 0.02 * 3


def test_the_level_network_of_the_tour_is_that_of_normal_equations(tmp_path):
    network = read(tmp_path, LEVELS, adjustment="LEV")
    solution = fga.adjust(network)
    rows = [line.split()[1:4] for line in LEVELS.splitlines() if line.startswith("L ")]
    known = {"TIDAL1": 1.375, "TIDAL2": 2.165, "BM75": 23.768, "BM26": 57.129}
    free = sorted({n for r in rows for n in r[0].split("-")} - set(known))
    a, b, w = np.zeros((len(rows), len(free))), np.zeros(len(rows)), np.zeros(len(rows))
    for i, (names, dh, length) in enumerate(rows):
        start, end = names.split("-")
        b[i] = float(dh)
        for name, sign in ((start, -1.0), (end, 1.0)):
            if name in known:
                b[i] -= sign * known[name]
            else:
                a[i, free.index(name)] = sign
        w[i] = 1.0 / (0.025**2 * float(length) / 5280.0)  # 0.025 ft per √mile
    heights = np.linalg.solve(a.T @ (w[:, None] * a), a.T @ (w * b))
    ours = [solution.point(n)[2] / FOOT for n in free]
    assert np.max(np.abs(np.array(ours) - heights)) < 1e-8
    v = a @ heights - b
    assert math.isclose(solution.sigma0, math.sqrt(v @ (w * v) / 8), rel_tol=1e-9)
    assert solution.redundancy == 8


def test_the_3d_traverse_with_left_angles_closes(tmp_path):
    solution = fga.adjust(read(tmp_path, TRAVERSE_3D))
    assert solution.redundancy == 4
    e, n = (solution.point("2") - solution.point("3"))[:2]
    assert abs(math.atan2(e, n) + math.radians(75 + 2 / 60 + 21 / 3600)) < 0.1 * ARCSEC
    five = solution.point("5")[2] - solution.point("3")[2]
    # Horizontal sight, HI − HT = 0.02 ft, curvature less refraction below 1 mm.
    assert abs(five / FOOT - 0.02) < 0.003
    assert solution.sigma0 < 1.0


def test_a_traverse_from_a_fixed_bearing_is_read_as_the_manual_draws_it(tmp_path):
    """The data of the page is made up and does not close; the first leg has azimuth −45° + 124°."""
    network = read(tmp_path, LOOPS, adjustment="2D")
    first = next(iter(network.observations.values()))
    assert isinstance(first, Azimuth)
    assert (first.station, first.target) == ("1", "2")
    expected = -(45 + 30 / 60 + 40 / 3600) + 123 + 40 / 60 + 28 / 3600
    assert math.isclose(math.degrees(first.value), expected, abs_tol=1e-10)
    kinds = [type(o) for o in network.observations.values()]
    assert kinds.count(HorizontalDistance) == 10
    assert kinds.count(HorizontalAngle) == 9  # 3 of the first traverse, 5 and a closing one
    last = [o for o in network.observations.values() if isinstance(o, HorizontalAngle)][-1]
    assert (last.station, last.target, last.target2) == ("5", "9", "4")


# -- data types by hand ---------------------------------------------------------------------------


def test_an_angle_with_its_own_standard_error(tmp_path):
    (o,) = only(tmp_path, "A 3-2-4 102-34-12.5 2.5")
    assert (o.station, o.target, o.target2) == ("3", "2", "4")
    assert math.isclose(o.value, math.radians(102 + 34 / 60 + 12.5 / 3600))
    assert math.isclose(o.sigma, 2.5 * ARCSEC)
    (o,) = only(tmp_path, "A 2-3-4 102-34-12.5", stations="FromAtTo")
    assert (o.station, o.target) == ("3", "2")
    (o,) = only(tmp_path, "A 3-2-4 -102-34-12.5 !")
    assert math.isclose(o.value, 2 * math.pi - math.radians(102 + 34 / 60 + 12.5 / 3600))
    assert o.sigma < 0.1 * ARCSEC
    (o,) = only(tmp_path, "A 3-2-4 102.34125")  # packed
    assert math.isclose(o.value, math.radians(102 + 34 / 60 + 12.5 / 3600))


def test_default_standard_errors_have_the_centring_of_the_project(tmp_path):
    (o,) = only(tmp_path, "A 3-2-4 102-34-12.5")
    c = 0.005 * FOOT
    assert o.sigma == StandardDeviation(4 * ARCSEC, 0.0, 0.0, c, c)
    (o,) = only(tmp_path, "D 1-2 342.45 5.4/5.1")
    assert isinstance(o, SlopeDistance)
    assert o.sigma == StandardDeviation(0.0075 * FOOT, 2.0, 0.0, c, c, "mixed", 0.0, 0.0)
    assert math.isclose(o.value, 342.45 * FOOT)
    assert np.allclose((o.instrument_height, o.target_height), (5.4 * FOOT, 5.1 * FOOT))
    (o,) = only(tmp_path, ".ADDCENTERING ON\nA 3-2-4 102-34-12.5 2.5")
    assert o.sigma == StandardDeviation(2.5 * ARCSEC, 0.0, 0.0, c, c)


def test_a_free_observation_has_no_influence(tmp_path):
    (o,) = only(tmp_path, "B 51-52 150-33-44 *")
    assert math.isclose(o.sigma, 5e4 * ARCSEC)


@pytest.mark.parametrize(
    ("bearing", "degrees"),
    [("N30-00-00E", 30), ("S30-00-00E", 150), ("S30-00-00W", 210), ("n30-00-00w", 330)],
)
def test_bearings_are_azimuths_by_quadrant(tmp_path, bearing, degrees):
    (o,) = only(tmp_path, f"B 1-2 {bearing}")
    assert math.isclose(math.degrees(o.value), degrees)


def test_zenith_angles_of_the_second_face_are_those_of_the_first(tmp_path):
    (a,) = only(tmp_path, "V oak-new 275-30-00 10.0 5.4/5.1")
    (b,) = only(tmp_path, "V oak-new 84-30-00 10.0 5.4/5.1")
    assert isinstance(a, ZenithAngle)
    assert math.isclose(a.value, b.value)


def test_delta_makes_horizontal_distances_and_differences(tmp_path):
    a, b, c = only(tmp_path, ".DELTA ON\nM 2-1-3 12-34-13 1102.31 15.22 5.2/5.1")
    assert [type(o) for o in (a, b, c)] == [HorizontalAngle, HorizontalDistance, HeightDifference]
    assert math.isclose(c.value, 15.22 * FOOT)
    assert math.isclose(c.sigma, 0.02 * FOOT)
    (d,) = only(tmp_path, ".DELTA ON\nV post-pipe 13.46")
    assert math.isclose(d.value, 13.46 * FOOT)
    text = ".DELTA ON\nV post-pipe 13.46"
    assert "grows with the distance" in problems(tmp_path, text, elevation_ppm=5.0)[0]


def test_a_measure_line_may_lack_what_was_not_measured(tmp_path):
    (a,) = only(tmp_path, "M 33-32-55 95-38-44.5 ? ? 4.5 & &")
    assert isinstance(a, HorizontalAngle)
    b, c = only(tmp_path, "M 8-DUMMY-5 ? 1502.55 93-44-52 5.25/5.10")
    assert [type(o) for o in (b, c)] == [SlopeDistance, ZenithAngle]
    assert (b.station, b.target) == ("8", "5")
    found = only(tmp_path, "M 2-1-3 12-34-13 1102.42 89-13-12 & .03 10 5.25/5.55")
    assert math.isclose(found[1].sigma, 0.03 * FOOT)
    assert math.isclose(found[2].sigma, 10 * ARCSEC)
    said = problems(tmp_path, "M 2-1-3 12-34-13 1102.42 89-13-12 .03 10")
    assert "no or 3 standard errors" in said[0]


def test_other_lines_of_several_observations(tmp_path):
    kinds = [type(o) for o in only(tmp_path, "BM 1-2 N45-00-00E 100.0 90-00-00")]
    assert kinds == [Azimuth, SlopeDistance, ZenithAngle]
    assert [type(o) for o in only(tmp_path, "DV 1-2 100.0 90-00-00 5/5")] == kinds[1:]
    kinds = [type(o) for o in only(tmp_path, "SS 1-2-3 45-00-00 100.0 90-00-00 'tree")]
    assert kinds == [HorizontalAngle, SlopeDistance, ZenithAngle]


def test_a_set_of_directions_has_its_own_orientation(tmp_path):
    text = "DB 1\nDN 2 0-00-00\nDM 3 12-34-13 1346.33 91-55-31 5.25/5.55\nDE\nDB 1\nDN 2 5-0-0\nDE"
    found = only(tmp_path, text)
    sets = [(o.target, o.set) for o in found if isinstance(o, Direction)]
    assert sets == [("2", "1"), ("3", "1"), ("2", "2")]
    assert len(found) == 5
    assert "DE is missing" in problems(tmp_path, "DB 1\nDN 2 0-0-0\nDB 2\nDE")[0]


def test_a_3d_line_in_a_2d_project_is_reduced(tmp_path):
    _, distance = only(tmp_path, ".3D\nM 2-1-3 12-34-13 100.0 60-00-00", adjustment="2D")
    assert isinstance(distance, HorizontalDistance)
    assert math.isclose(distance.value, 100 * FOOT * math.sin(math.radians(60)))


def test_levels_weighted_by_turns_or_length(tmp_path):
    (o,) = only(tmp_path, "L BM1-BM2 1.4521 4", weight_levels_by="turns")
    assert math.isclose(o.sigma, 0.025 * FOOT * 2)
    (o,) = only(tmp_path, "L BM1-BM2 1.4521 1500", linear="Meters", level=0.002)
    assert math.isclose(o.sigma, 0.002 * math.sqrt(1.5))
    assert o.length_km == 1.5
    (o,) = only(tmp_path, "L BM1-BM2 1.4521 1500 0.01")
    assert math.isclose(o.sigma, 0.01 * FOOT)


def test_points_are_free_fixed_or_weighted(tmp_path):
    text = "C A 1000 2000 700\nC B 1 2 3 ! ! !\nC D 1492 1776 745.29 * 0.5 !\nE F 12.5 0.02"
    points = read(tmp_path, text).points
    assert np.allclose(points["A"].coordinates, np.array([2000, 1000, 700]) * FOOT)
    assert points["A"].held == "" and points["B"].held == "xyz"
    assert points["D"].held == "z"
    assert np.allclose(points["D"].sigma, (0.5 * FOOT, math.inf, math.inf))  # E is weighted
    assert math.isclose(points["F"].sigma[2], 0.02 * FOOT)
    assert math.isnan(points["F"].coordinates[0])


def test_inline_options_change_what_follows(tmp_path):
    text = (
        "D 1-2 100.0 .01\n.UNITS Meters\nD 1-2 100.0 .01\n.U FeetI\nD 1-2 100.0 .01\n.UNITS\n"
        "D 1-2 100.0 .01\n.MULT 2\nD 1-2 100.0 .01\n.MULT\n.SEP :\nD 1:2 100.0 .01\n"
        ".DATA OFF\nnonsense\n.DATA ON\n.LOSTSTATIONS\n"
    )
    lengths = [o.value for o in only(tmp_path, text)]
    expected = [FOOT, 1.0, 0.3048, FOOT, 2 * FOOT, FOOT]
    assert np.allclose(lengths, 100 * np.array(expected))
    (a, b) = only(tmp_path, ".UNITS GONS\nA 1-2-3 100.5 2\n.UNITS DMS\nA 1-2-3 90-27-00 2")
    assert math.isclose(a.value, b.value)
    assert math.isclose(a.sigma, 2e-3 * GON)
    network = read(tmp_path, ".ORDER EN\nC A 1 2 3\n.ORDER NE\nC B 1 2 3")
    assert network.points["A"].coordinates[:2] == network.points["B"].coordinates[1::-1]


def test_refraction_is_that_of_star_net(tmp_path):
    """Half of Gauss's k: the line of sight falls by (1 − 2·0.07) D²/2R."""
    network = read(tmp_path, "V 1-2 90-00-00\n.REFRACTION 0.1\nV 1-3 90-00-00")
    assert math.isclose(network.refractions[""].values[0], -0.86)
    assert math.isclose(network.refractions["0.1"].values[0], -0.8)
    assert [o.refraction for o in network.observations.values()] == [None, "0.1"]


# -- what is refused ------------------------------------------------------------------------------


def test_settings_that_nothing_states_are_demanded_by_name(tmp_path):
    path = tmp_path / "job.dat"
    path.write_text(TRAVERSE_2D, encoding="utf-8")
    with pytest.raises(InputError, match="adjustment, linear, angular, order, stations, distances"):
        fga.read_star_net(path)
    with pytest.raises(InputError) as caught:
        fga.read_star_net(path, options={"adjustment": "2D"})
    text = str(caught.value)
    for name in ("linear", "angular", "order", "stations", "angle", "distance", "distance_ppm"):
        assert f"needs the setting {name!r}" in text
    assert "'zenith'" not in text  # no line needs it
    assert "job.dat:2: needs the setting 'order'" in text


def test_settings_may_stand_in_a_toml_file(tmp_path):
    lines = [f"{k} = {v!r}" for k, v in OPTIONS.items()]
    (tmp_path / "job.toml").write_text("\n".join(lines), encoding="utf-8")
    (tmp_path / "job.dat").write_text(TRAVERSE_3D, encoding="utf-8")
    network = fga.read(tmp_path / "job.dat", options=str(tmp_path / "job.toml"))
    assert len(network.observations) == 19
    with pytest.raises(InputError, match=r"unknown setting 'angel'; valid: .*did you mean 'angle'"):
        fga.read_star_net(tmp_path / "job.dat", options={"angel": 4})
    with pytest.raises(InputError, match="linear must be one of Meters, FeetUS, FeetInt"):
        fga.read_star_net(tmp_path / "job.dat", options={"linear": "yards"})


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("G1 1-2 10 20 30", "data type G1 needs the reference system of the grid: crs= and geoid="),
        ("P 1 38-44-27 122-45-21", "data type P needs the reference system"),
        ("CH 1 1 2 3", "data type CH needs the reference system"),
        ("X 1-2 3", "data type 'X' is unknown; valid: C, E, A"),
        (".GRID BEARINGS", "inline option .GRID belongs to projects in a grid"),
        (".SCALE 0", ".SCALE must be greater than zero, not 0"),
        (".SCALE 0.9996\nD 1-2 100", "needs its zenith angle with the scale factor 0.9996"),
        (".INCLUDE other.dat", ".INCLUDE other.dat: there is no such file"),
        (".INCLUDE", ".INCLUDE takes the name of a file"),
        (".INCLUDE ../other.dat", "lies outside the folder"),
        (".INCLUDE job.dat", "a file includes itself"),
        (".ALIAS ADDITIVE 100", ".ALIAS ADDITIVE 100: valid: OTHER=NAME"),
        ("D 1-2", "this line has no values: they are readings to come"),
        ("D 1-2\nDV 1-2 &&", "2 lines from here have no values"),
        (".NONSENSE", "inline option '.NONSENSE' is unknown"),
        (".IN other", "inline option '.IN' could be INSTRUMENT or INCLUDE"),
        (".LWEIGHT 1 2", "the option takes one word, not '1 2'"),
        ("D 1-1 10", "joins a point to itself"),
        ("D 1 2 10", "D begins with 2 names"),
        ("A 1-2-3 102-75-00", "has 60 or more minutes"),
        ("A 1-2-3 abc", "must be an angle, such as 102-34-12.5, not 'abc'"),
        ("D 1-2 1,5", "distance: '1,5' is not a number; write a decimal point"),
        ("D 1-2 10 -1", "standard error of the distance must be at least 0, not -1"),
        ("D 1-2 -10", "a distance cannot be negative"),
        ("C A 1 2", "C takes a name, 3 coordinates and up to 3 standard errors"),
        ("C A 1 2 3\nC A 1 2 4", "Z of 'A' differs from that of line 1"),
        ("DN 2 0-0-0", "DN without DB"),
        ("T 2 0-0-0 10 90-0-0", "T without TB"),
        ("TB 1\nT 2 1-0-0 10 90-0-0", "the last traverse has no end (TE)"),
        ("L 1-2 0.5", "L needs the length of the line or its number of turns"),
        ("", "holds neither points nor observations"),
    ],
)
def test_what_the_reader_does_not_know_is_refused_by_name_and_line(tmp_path, line, said):
    found = problems(tmp_path, line)
    assert said in "\n".join(found)
    assert all(p.startswith("job.dat:") for p in found)


def test_every_problem_of_a_file_is_told_at_once(tmp_path):
    text = "D 1-2 x\nA 1-2-3 y\nZ\n"
    assert [p.split(": ")[0] for p in problems(tmp_path, text)] == [
        f"job.dat:{i}" for i in (1, 2, 3)
    ]


# -- writing --------------------------------------------------------------------------------------


def total_station() -> fga.Network:
    """Return a network whose readings fit within their σ."""
    at = {"A": (100.0, 200.0, 10.0), "B-1": (180.0, 230.0, 12.5), "C": (150.0, 120.0, 9.1)}
    network = fga.Network("written", frame=fga.LocalFrame())
    network.add_point("A", at["A"], fixed="xyz")
    network.add_point("B-1", at["B-1"], sigma=(0.005, 0.005, np.inf))
    network.add_point("C", (150.0, 120.0, np.nan))
    network.set_refraction(value=-0.87, fixed=True)
    sigma = StandardDeviation(1e-5, centring_instrument=1e-3, centring_target=1e-3)
    length = StandardDeviation(2e-3, 2.0)
    heights = {"instrument_height": 1.55, "target_height": 1.3}

    def d(a: str, b: str) -> np.ndarray:
        return np.subtract(at[b], at[a])

    def azimuth(a: str, b: str) -> float:
        return math.atan2(d(a, b)[0], d(a, b)[1]) % (2 * math.pi)

    up = np.array([0.0, 0.0, -0.25])
    ab, ac = d("A", "B-1"), d("A", "C")
    network.add(
        Direction("A", "B-1", (azimuth("A", "B-1") - 0.3) % 7, sigma=sigma),
        Direction("A", "C", azimuth("A", "C") - 0.3 + 2e-5, sigma=sigma),
        SlopeDistance("A", "B-1", np.linalg.norm(ab + up) + 0.001, sigma=length, **heights),
        SlopeDistance("A", "C", np.linalg.norm(ac) - 0.001, sigma=length),
        ZenithAngle("A", "C", math.acos((ac + up)[2] / np.linalg.norm(ac + up)), sigma=sigma,
                    **heights),
        ZenithAngle("A", "B-1", math.acos((ab + up)[2] / np.linalg.norm(ab + up)), sigma=1e-5,
                    **heights),
        HorizontalDistance("B-1", "C", np.hypot(*d("B-1", "C")[:2]) + 0.002, sigma=0.003),
        HorizontalAngle("C", "A", "B-1", (azimuth("C", "B-1") - azimuth("C", "A")) % 6.2831853,
                        sigma=2e-5),
        Azimuth("A", "C", azimuth("A", "C"), sigma=1e-4),
        HeightDifference("A", "B-1", 2.501, sigma=0.002, length_km=0.09),
        HeightDifference("A", "C", -1.15, sigma=0.01, **heights),
    )  # fmt: skip
    return network


def test_a_network_comes_back_from_the_file_and_adjusts_alike(tmp_path):
    network = total_station()
    path = tmp_path / "out.dat"
    fga.write_star_net(network, path)
    assert ".SEPARATOR :" in path.read_text(encoding="utf-8")
    back = fga.read_star_net(path, options={"adjustment": "3D", "linear": "Meters",
                                            "weight_levels_by": "length"})  # fmt: skip
    assert back.points["A"].held == "xyz"
    assert back.points["B-1"].sigma == network.points["B-1"].sigma
    ours = sorted(network.observations.values(), key=lambda o: (o.kind, o.names()))
    theirs = sorted(back.observations.values(), key=lambda o: (o.kind, o.names()))
    for a, b in zip(ours, theirs, strict=True):
        assert (a.kind, a.names()) == (b.kind, b.names())
        assert math.isclose(a.value, b.value, rel_tol=1e-14)
        assert getattr(a, "length_km", None) == pytest.approx(getattr(b, "length_km", None))
    s, t = fga.adjust(network), fga.adjust(back)
    for name in network.points:
        assert np.max(np.abs(s.point(name) - t.point(name))) < 1e-6
    assert 0.1 < s.sigma0 < 1.0
    assert math.isclose(s.sigma0, t.sigma0, rel_tol=1e-4)


def test_an_adjusted_traverse_is_written_and_read_again(tmp_path):
    solution = fga.adjust(read(tmp_path, TRAVERSE_3D))
    fga.write_star_net(solution.as_network(), tmp_path / "again.dat")
    again = fga.adjust(
        fga.read_star_net(tmp_path / "again.dat", options={"adjustment": "3D", "linear": "Meters"})
    )
    assert math.isclose(again.sigma0, solution.sigma0, rel_tol=1e-6)
    for name in "123456":
        assert np.allclose(again.point(name), solution.point(name), atol=1e-7)


def test_what_star_net_cannot_hold_is_refused_all_at_once_and_nothing_is_written(tmp_path):
    network = fga.Network("free", datum="free")
    network.add_point("a b", (0, 0, 0))
    network.add_point("C", (10, 0, 0))
    network.add_point("D", (10, 9, 0), check=(1, 1, 1))
    network.set_refraction(value=0.13)
    network.add(
        fga.GnssVector("C", "D", (0, 9, 0), sigma=(1, 1, 1)),
        fga.VerticalAngle("C", "D", 0.1, sigma=1e-4),
    )
    with pytest.raises(InputError) as caught:
        fga.write_star_net(network, tmp_path / "no.dat")
    text = str(caught.value)
    for said in ("free network", "a name with ' '", "check points", "gnss vector",
                 "vertical angle", "unknown coefficient of refraction"):  # fmt: skip
        assert said in text
    assert not (tmp_path / "no.dat").exists()


# -- damage ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", [TRAVERSE_3D, LEVELS, LOOPS])
def test_damaged_files_are_refused_with_file_and_line_or_read(tmp_path, text):
    rng = np.random.default_rng(5)
    small = [d for d in DAMAGES if d.__name__ not in ("long_line", "nest", "paths")]
    path, refused = tmp_path / "job.dat", 0
    for _ in range(200):
        damage = small[int(rng.integers(len(small)))]
        path.write_bytes(damage(rng, "job.dat", text.encode()))
        adjustment = {TRAVERSE_3D: "3D", LEVELS: "LEV", LOOPS: "2D"}[text]
        try:
            network = fga.read_star_net(path, options={**OPTIONS, "adjustment": adjustment})
        except InputError as error:
            refused += 1
            assert all("job.dat" in str(p) for p in error.problems)
            continue
        assert all(math.isfinite(o.value) for o in network.observations.values())
    assert refused > 50


def test_a_setting_that_is_not_stated_is_told_once_with_its_words(tmp_path):
    """Zenith angles are no elevation differences: only what is missing is told."""
    path = tmp_path / "job.dat"
    path.write_text(
        "C A 0 0 0 ! ! !\nC B 50 0 0 ! ! !\nDB A\n"
        "DM B 0-00-00 50.000 89-47-52.2 1.5/1.5\nDM P 33-00-00 40.0 88-01-53.1 1.5/1.5\nDE\n",
        encoding="utf-8",
    )
    stated = {
        **{"adjustment": "3D", "linear": "Meters", "angular": "DMS", "order": "EN"},
        **{"direction": 3, "zenith": 3, "distance": 0.002, "distance_ppm": 2, "refraction": 0.07},
        **{"centring_instrument": 0.001, "centring_target": 0.001, "centring_vertical": 0.001},
    }
    with pytest.raises(fga.InputError) as caught:
        fga.read_star_net(path, options=stated)
    (problem,) = caught.value.problems
    assert str(problem) == (
        "job.dat:4: needs the setting 'distances' of the project, which data files do not have: "
        "state it in options, 'slope' or 'horizontal'"
    )
