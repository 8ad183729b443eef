"""Field books of Topcon GTS-7 and South: order of coordinates, backsights, free stations."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction
from factorgraph_adj.units import FOOT, GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, sights


def row(word: str, *fields: object) -> str:
    """Return a record."""
    return f"{word:8}{','.join(map(str, fields))}"


def survey() -> str:
    """Return the small survey, gon: coordinates behind their points, east first."""
    lines = ["TopSURV v6.04(OnBoard)", row("JOB", "SITE", ""), row("UNITS", "M", "G")]
    lines.append(row("STN", "S", HEIGHT, ""))
    for s in sights():
        lines.append(row("SS", s.target, TARGET, "CODE"))
        if s.face == 1:
            lines.append(row("XYZ", *KNOWN[s.target]))
        values = (f"{a / GON:.7f}" for a in (s.direction, s.zenith))
        lines.append(row("SD", *values, f"{s.distance:.5f}"))
    return "\n".join(lines) + "\n"


def station(order: str = "ne", east: float = 40.0, north: float = 10.0) -> str:
    """Return a set-up with a backsight and a target, and their coordinates, degrees."""

    def xyz(e: float, n: float) -> str:
        return row("XYZ", *((n, e) if order == "ne" else (e, n)), 5.0)

    azimuth = math.degrees(math.atan2(east, north))
    seconds = round(azimuth * 3600)
    packed = f"{seconds // 3600}.{seconds // 60 % 60:02d}{seconds % 60:02d}"
    circle = "10.0000"
    lines = [row("UNITS", "M", "D"), row("STN", "S", 1.5, ""), xyz(1000.0, 2000.0)]
    lines += [row("BKB", "B", packed, circle), xyz(1000.0 + east, 2000.0 + north)]
    lines += [row("BS", "B", 1.6), row("HV", circle, "90.0000")]
    return "\n".join([*lines, row("SS", "P", 1.6, ""), row("SD", "20.0000", "90.0000", 7.5)]) + "\n"


EXAMPLE_FILES = {
    "topcon gts7": Example(
        "topcon_gts7",
        {"book.gts7": survey()},
        "book.gts7",
        {**HELD, "order": "en"},
        unread=(r"\|.*\|(TopSURV|JOB)", r"\|(value|word)\|.*\|(SS|STN) "),
    ),
    "topcon gts7 backsight": Example(
        "topcon_gts7",
        {"book.gts7": station()},
        "book.gts7",
        unread=(r"\|(value|word)\|.*\|(SS|BS|STN) ",),
    ),
}


def read(tmp_path, text: str, **options) -> fga.Network:
    """Read a text."""
    path = tmp_path / "book.gts7"
    path.write_text(text, encoding="utf-8")
    return fga.read(path, format="topcon_gts7", **options)


def test_the_station_of_a_known_survey_comes_out(tmp_path):
    network = read(tmp_path, survey(), order="en", **HELD)
    solution = fga.adjust(network)
    assert solution.point("S") == pytest.approx((15.0, 20.0, 102.0), abs=1e-4)
    first = next(iter(network.observations.values()))
    assert (first.instrument_height, first.target_height) == (HEIGHT, TARGET)


# -- order of coordinates -------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["ne", "en"])
def test_azimuth_and_coordinates_decide_the_order(tmp_path, order):
    network = read(tmp_path, station(order))
    assert tuple(network.points["B"].coordinates) == (1040.0, 2010.0, 5.0)


def test_the_sample_of_topcon_s_manual_has_north_first(tmp_path):
    """Link Reference Manual 7010-0522, C-9: the reading gives the coordinates beside it."""
    text = "\n".join(
        [
            row("UNITS", "M", "D"),
            row("STN", "MARK", 1.52, ""),
            row("XYZ", "10.00000", "10.00000", "0.50000"),
            row("BKB", "ST1", "322.33160", "322.33160"),
            row("XYZ", "13.85600", "7.04700", "0.0"),
            row("BS", "ST1", 1.6),
            row("SD", "-37.26440", "97.57060", "4.9020"),
            row("SS", "ST2", 1.6, ""),
            row("SD", "7.56170", "97.13460", "4.9560"),
            row("XYZ", "14.87000", "10.67900", "-0.20400"),
        ]
    )
    network = read(tmp_path, text, refraction=None)
    o = {(o.kind, o.points()[1]): o.value for o in network.observations.values()}
    hz, z, d = (o[k, "ST2"] for k in ("direction", "zenith_angle", "slope_distance"))
    found = (10 + d * math.sin(z) * math.sin(hz), 10 + d * math.sin(z) * math.cos(hz))
    assert found == pytest.approx((10.679, 14.870), abs=0.001)
    assert tuple(network.points["ST2"].coordinates) == (10.679, 14.870, -0.204)
    assert math.degrees(o["direction", "ST1"]) == pytest.approx(360 - (37 + 26 / 60 + 44 / 3600))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (station("ne", 50.0, 50.0), "fit both, as they are those of a diagonal"),
        (station().replace("BKB     B,75", "BKB     B,15"), "contradict each other in both"),
        (station().replace("BKB", "NOTE"), "has no azimuth between points with coordinates"),
    ],
)
def test_an_order_that_nothing_decides_is_asked_for(tmp_path, text, why):
    with pytest.raises(InputError, match=rf"^book\.gts7:3: whether north or east .*{why}; give"):
        read(tmp_path, text)
    network = read(tmp_path, text, order="en")
    assert network.points["S"].coordinates[0] == 2000.0
    with pytest.raises(InputError, match=r"order.*'xy'"):
        read(tmp_path, text, order="xy")


def test_coordinates_that_a_station_repeats_are_left_out(tmp_path):
    other = station().replace("UNITS", "NOTE").replace("STN     S", "STN     T")
    network = read(tmp_path, station() + other)
    assert [left.names for left in network.left_out if "stations" in left.what] == [("T",)]
    assert all(math.isnan(v) for v in network.points["T"].coordinates)


# -- readings -------------------------------------------------------------------------------------


def test_a_backsight_that_is_not_sighted_has_its_circle_reading(tmp_path):
    """One that is has its reading alone."""
    sighted = read(tmp_path, station())
    assert [left.names for left in sighted.left_out] == [("B",)]
    text = station().replace(row("HV", "10.0000", "90.0000") + "\n", "")
    network = read(tmp_path, text)
    directions = {
        o.target: math.degrees(o.value)
        for o in network.observations.values()
        if isinstance(o, Direction)
    }
    assert directions == pytest.approx({"P": 20.0, "B": 10.0})


def test_targets_of_a_free_station_are_a_set_of_their_own(tmp_path):
    lines = [row("UNITS", "F", "G"), row("RES_OBS", "A", 1.6), row("SD", "10.0", "100.0", "50.0")]
    lines += [row("STN", "S", 5.0, ""), row("SS", "P", 5.0, ""), row("HD", "20.0", "10.0", "1.0")]
    network = read(tmp_path, "\n".join(lines))
    directions = [o for o in network.observations.values() if isinstance(o, Direction)]
    assert [(o.target, o.set) for o in directions] == [("A", "1"), ("P", "2")]
    values = {o.kind: o.value for o in network.observations.values()}
    assert values["slope_distance"] == pytest.approx(50 * FOOT)
    assert values["horizontal_distance"] == pytest.approx(10 * FOOT)
    assert {o.instrument_height for o in directions} == {5.0 * FOOT}
    assert sum(left.count for left in network.left_out) == 1  # the vertical distance
    with pytest.raises(InputError, match=r"book\.gts7:3: targets of a free station .*without"):
        read(tmp_path, "\n".join(lines[:3]))


def test_all_problems_are_listed_with_their_lines(tmp_path):
    rows = (row("STN", "S", 1.5), row("UNITS", "X", "D"), row("SD", 1, 2, 3), row("XX", 1))
    rows += (row("SS", "", "x"), row("SD", "1.6000", "90.0"), row("OFFSET", "0.1", "0", "0"))
    text = "\n".join([*rows, row("SS", "P", 1, 2, 3, 4)])
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    said = [str(p) for p in caught.value.problems]
    for line, what in (
        (1, "record STN before the units of the file"),
        (2, "unit of lengths (M, F) 'X' is unknown; valid: M, F"),
        (3, "readings (SD) without a target"),
        (4, "record 'XX' is unknown; valid: UNITS, STN"),
        (5, "point is missing"),
        (5, "target height: 'x' is not a number"),
        (6, "'1.6000' has 60 or more minutes"),
        (6, "slope distance is missing"),
        (7, "the offset of the prism"),
        (8, "has 5 fields; valid: at most 4"),
    ):
        assert any(s.startswith(f"book.gts7:{line}: ") and what in s for s in said), (what, said)


def test_offsets_of_zero_and_from_lines_do_not_matter(tmp_path):
    extra = row("OFFSET", 0.0, 0.0, 0.0) + "\n" + row("PTL_OFF", 1, 2, 3) + "\n"
    network = read(tmp_path, station() + extra)
    assert len(network.observations) == len(read(tmp_path, station()).observations)
    assert ("P",) in [left.names for left in network.left_out]


def test_recognition_asks_for_records_in_every_line(tmp_path):
    reader = READERS.named("topcon_gts7")
    for i, (text, is_one) in enumerate(
        (
            (survey(), True),
            (station(), True),
            ("JOB     X\nINST    NTS-350\nUNITS   M,G\nSTN     S2,1.6, \n", True),
            ("UNITS   M,G\nsomething else\nSTN A\n", False),
            ("C A 1 2 3\nSTN\nSS A\n", False),
            ("JOB     X\nNOTE    text\n", False),
            ("", False),
        )
    ):
        path = tmp_path / f"{i}.dat"
        path.write_text(text, encoding="utf-8")
        assert reader.recognises(path) == is_one, i
