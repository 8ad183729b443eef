"""Nikon RAW: the survey of all field books, orientations, instruments without stations."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction
from factorgraph_adj.units import FOOT, GON, US_SURVEY_FOOT
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, left_out_but_notes, sights

HEAD = """\
CO,Nikon RAW data format V2.00
CO,QUARRY
CO,Instrument: Nikon DTM-322
CO,Dist Units: Metres
CO,Angle Units: Gons
CO,Zero azimuth: North
CO,Zero VA: Zenith
CO,Coord Order: NEZ
CO,HA Raw data: Azimuth
"""


def nikon_raw() -> str:
    """Return the survey as Nikon RAW, gon."""
    lines = [f"MP,{n},,{y:.3f},{x:.3f},{z:.3f},PEG" for n, (x, y, z) in KNOWN.items()]
    lines.append(f"ST,S,,,,{HEIGHT:.3f},0.0000,0.0000")
    for s in sights():
        readings = f"{s.distance:.6f},{s.direction / GON:.8f},{s.zenith / GON:.8f}"
        lines.append(f"SS,{s.target},{TARGET:.3f},{readings},09:15:10,PEG")
    return HEAD + "\n".join(lines) + "\n"


EXAMPLE_FILES = {
    "nikon_raw": Example(
        "nikon_raw",
        {"book.raw": nikon_raw()},
        "book.raw",
        HELD,
        unread=(
            r"\|CO,",  # comments, of which settings alone are read
            r"\|value\|(PEG|09:15:10)\|",
            r"\|value\|0\.0000\|ST,",  # azimuth and circle of a backsight that has no name
            r"\|word\|",  # further words belong to codes
        ),
        is_field_book=True,
    ),
}


def read(folder, text: str, **options) -> fga.Network:
    path = folder / "book.raw"
    path.write_bytes(text.encode("latin-1"))
    return fga.read(path, **options)


def directions(network: fga.Network) -> list[tuple[str, str, float]]:
    return [
        (o.set, o.targets[0] if hasattr(o, "targets") else o.target, round(o.value / GON, 4))
        for o in network.observations.values()
        if isinstance(o, Direction)
    ]


def test_the_reading_of_a_backsight_without_sight_orients_a_traverse(tmp_path):
    text = HEAD + (
        "ST,1,,,,1.400,0.0000,0.0000\nSS,2,1.500,60.000,0.0000,100.0000,10:00:00,\n"
        "ST,2,,1,,1.450,200.0000,200.0000\nSS,3,1.500,60.000,100.0000,100.0000,10:20:00,\n"
    )
    network = read(tmp_path, text)
    assert directions(network) == [("1", "2", 0.0), ("1", "3", 100.0), ("1", "1", 200.0)]
    points = fga.adjust(network)
    assert math.dist(points.point("1")[:2], points.point("3")[:2]) == pytest.approx(
        60.0 * math.sqrt(2.0)
    )


@pytest.mark.parametrize(
    ("orientation", "expected"),
    [
        # F1 repeats the reading of the station: one position of the circle, no reading twice
        (
            "F1,1,1.5,60.0,200.0010,100.0,10:10:00\n",
            [("1", "1", 200.001), ("1", "3", 100.0)],
        ),
        # both faces, whose collimation also corrects the sight in one
        (
            "F1,1,1.5,60.0,200.0010,100.0,10:10:00\nF2,1,1.5,60.0,0.0030,300.0,10:10:00\n",
            [("1", "1", 200.002), ("1", "3", 100.001)],
        ),
        # the name of the backsight stands in the station alone
        ("F1,,1.5,,200.0000,100.0,10:10:00\n", [("1", "1", 200.0), ("1", "3", 100.0)]),
        # the circle was set to the azimuth after F1
        (
            "F1,1,1.5,60.0,14.2000,100.0,10:10:00\n",
            [("1", "1", 14.2), ("2", "1", 200.0), ("2", "3", 100.0)],
        ),
        # points of a resection, and the backsight to which the circle was set
        (
            "F1,7,1.5,60.0,14.2000,100.0,10:10:00\nF1,8,1.5,60.0,74.2000,100.0,10:10:00\n",
            [("1", "7", 14.2), ("1", "8", 74.2), ("2", "1", 200.0), ("2", "3", 100.0)],
        ),
    ],
)
def test_orientations_of_one_circle_are_one_set(tmp_path, orientation, expected):
    text = HEAD + "ST,2,,1,,1.450,200.0000,200.0000\n" + orientation
    text += "SS,3,1.500,60.000,100.0000,100.0000,10:20:00,\n"
    assert sorted(directions(read(tmp_path, text))) == sorted(expected)


def test_an_orientation_without_the_name_of_a_target_is_left_out(tmp_path):
    text = HEAD + "ST,2,,,,1.450,0.0000,0.0000\nF1,,1.5,,0.0,100.0,10:10:00\n"
    network = read(tmp_path, text + "SS,3,1.500,60.000,100.0000,100.0000,10:20:00,\n")
    assert [str(left) for left in left_out_but_notes(network)] == [
        "sights: 1 left out, as neither they nor the station (ST) name a target: 2; "
        "first in book.raw:11"
    ]


def test_deleted_lines_are_left_out_and_other_sights_are_read(tmp_path):
    text = HEAD + (
        "ST,2,,,,1.450,0.0000,0.0000\n*SS,3,1.5,60.0,100.0,100.0,10:20:00,\n"
        "SO,4,99,1.5,60.0,110.0,100.0,10:21:00,\nCP,5,ID,1.5,60.0,120.0,100.0,10:22:00,PEG\n"
        "SS,6,1.5,60.0,130.0,100.0,EDGE\n"
    )
    network = read(tmp_path, text)
    assert [t for _, t, _ in directions(network)] == ["4", "5", "6"]
    assert "1 left out, as they are switched off in the file: 3" in str(
        left_out_but_notes(network)[0]
    )


def test_an_instrument_without_stations_needs_their_names(tmp_path):
    text = HEAD + (
        'CO,Instrument: M3 3"DR\n'
        "CO,TI  HOLD                          Hz         0.0000 grd\n"
        "CO,TI  INPUT      th          1.250 m    ih          1.500 m\n"
        "SS,1,2.0,12.0,104.4,99.0,11:50:34,\nSS,2,2.0,15.0,90.3,99.0,11:52:26,\n"
        "CO,TI  INPUT      th          2.000 m    ih          1.480 m\n"
        "SS,1,2.0,13.0,104.4,99.0,11:50:34,\n"
        "CO,TI  Hz=0                          Hz         0.0000 grd\n"
        "SS,1,2.0,14.0,104.4,99.0,11:50:34,\n"
    )
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert str(error.value) == (
        "book.raw:13: set-ups begin in the lines 13, 16, 18, without a station (ST): give "
        "station=S1,S2,S3 (--set station=S1,S2,S3), 3 names in their order"
    )
    with pytest.raises(InputError, match="3 names in their order, not P"):
        read(tmp_path, text, station="P")
    network = read(tmp_path, text, station="P,Q,R")
    heights = [
        (o.station, o.instrument_height)
        for o in network.observations.values()
        if isinstance(o, Direction)
    ]
    assert heights == [("P", 1.5), ("P", 1.5), ("Q", 1.48), ("R", 1.48)]
    with pytest.raises(InputError, match=r"station: every set-up of the file has a station"):
        read(tmp_path, nikon_raw(), station="P")


@pytest.mark.parametrize(
    ("zero", "face_1", "face_2"),
    [("Zenith", 95.0, 305.0), ("Horizon", 5.0, 195.0), ("Compass", 5.0, 5.0)],
)
def test_vertical_readings_begin_where_the_comment_says(tmp_path, zero, face_1, face_2):
    text = HEAD.replace("Zero VA: Zenith", f"Zero VA: {zero}") + (
        f"ST,2,,,,1.450,0.0000,0.0000\nF1,3,1.5,60.0,100.0,{face_1},10:20:00\n"
        f"F2,3,1.5,60.0,300.0,{face_2},10:20:00\n"
    )
    zeniths = [
        o.value / GON for o in read(tmp_path, text).observations.values() if "zenith" in o.kind
    ]
    assert zeniths == [pytest.approx(95.0)]


@pytest.mark.parametrize(
    ("unit", "metres"), [("Metres", 1.0), ("Feet", FOOT), ("Feet US", US_SURVEY_FOOT)]
)
def test_lengths_have_the_unit_of_the_comment(tmp_path, unit, metres):
    text = nikon_raw().replace("Dist Units: Metres", f"Dist Units: {unit}")
    network = read(tmp_path, text)
    assert network.points["B"].coordinates == pytest.approx(
        [60 * metres, 10 * metres, 101 * metres]
    )
    assert next(iter(network.observations.values())).instrument_height == pytest.approx(
        HEIGHT * metres
    )


def test_ruide_writes_its_own_comments(tmp_path):
    text = nikon_raw().replace("Nikon RAW data format V2.00", "Ruide Raw data")
    text = text.replace("Zero VA", "VA").replace("09:15:10", " 09:15:10")
    text = text.replace("NEZ", "ENZ")
    path = tmp_path / "book.sdr"
    path.write_text(text, encoding="utf-8")
    assert READERS.of(path).name == "nikon_raw"
    assert fga.read(path).points["B"].coordinates == (10.0, 60.0, 101.0)


def test_the_unit_must_be_known_and_packed_degrees_have_less_than_60_minutes(tmp_path):
    text = nikon_raw().replace("CO,Angle Units: Gons\n", "").replace("CO,Coord Order: NEZ\n", "")
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert [p.what.split(";")[0] for p in error.value.problems] == [
        "comment 'CO,Coord Order: …' is missing before",
        "comment 'CO,Angle Units: …' is missing before",
    ]
    text = HEAD.replace("Gons", "DDDMMSS") + "ST,1,,,,1.4,55.4500,55.4500\n"
    text += "SS,3,1.2,330.7,300.8470,20.32,07:13:46,SIGN\n"
    with pytest.raises(InputError, match=r"book\.raw:11: horizontal reading: '300\.8470' has 60"):
        read(tmp_path, text)


def test_wrong_records_are_all_named(tmp_path):
    text = nikon_raw().replace("Zero VA: Zenith", "Zero VA: Nadir")
    text += "XY,1\nSS,,1.5,60.0,1.0,1.0,10:00:00,\nF1,A,1.5,60.0,1.0,1.0,10:00:00,7\n"
    text += "F1,A,1.5,60.0,1.0,1.0,late\nMP,A,,1.0,2.0,3.0,\n"
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    said = str(error.value)
    for what in (
        "book.raw:7: Zero VA 'Nadir' is unknown; valid: Zenith, Horizon, Compass",
        "book.raw:20: record 'XY' is unknown",
        "book.raw:21: point is missing",
        "book.raw:22: has 7 fields; valid: at most 6",
        "book.raw:23: time must be hh:mm:ss, not 'late'",
        "book.raw:24: coordinates of point 'A' differ from those of line 10",
    ):
        assert what in said
