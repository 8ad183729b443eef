"""Text of Nikon DTM-300: the survey of all field books, heights behind names, units."""

from __future__ import annotations

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.units import FOOT, GON, US_SURVEY_FOOT
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, sights


def nikon_dtm300() -> str:
    """Return the survey as text of DTM-300, gon."""
    lines = [f"1 , 3 , MG , {n} , {y:.3f}, {x:.3f}, {z:.3f}" for n, (x, y, z) in KNOWN.items()]
    lines.append(f"1 , 2 , MG , S-{HEIGHT}")
    for s in sights():
        readings = f"{s.distance:.6f} , {s.direction / GON:.8f} , {s.zenith / GON:.8f}"
        lines.append(f"1 , 0 , MG , {s.target} , {readings} , {TARGET:.3f}")
    lines.append("0 , 0 , MG , A , 1.0 , 2.0 , 3.0 , 0.0")
    return "\n".join(lines) + "\n"


EXAMPLE_FILES = {
    "nikon_dtm300": Example(
        "nikon_dtm300",
        {"book.nik": nikon_dtm300()},
        "book.nik",
        HELD,
        unread=(
            r"\|0 , 0 ,",  # a deleted line
            r"\|value\|S-1\.5\||\|value\|MG\|1 , 3",  # units of angles of coordinates
        ),
        is_field_book=True,
    ),
}


def read(folder, text: str, **options) -> fga.Network:
    path = folder / "book.nik"
    path.write_text(text, encoding="utf-8")
    return fga.read(path, **options)


def test_a_second_hyphen_is_a_minus_or_none_as_stated(tmp_path):
    text = "1 , 2 , MD , 12-A--1.455, 0.000, 0.000\n"
    text += "1 , 0 , MD , 46 , 23.515 , 258.51 , 97.5735 , -0.1\n"
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    assert str(error.value) == (
        "book.nik:1: the height of the instrument is 1.455 or −1.455: give "
        "double_hyphen=separator (--set double_hyphen=separator) or minus"
    )
    for said, height in (("separator", 1.455), ("minus", -1.455)):
        network = read(tmp_path, text, double_hyphen=said)
        first = next(iter(network.observations.values()))
        assert (first.station, first.instrument_height, first.target_height) == (
            "12-A",
            height,
            -0.1,
        )
    with pytest.raises(InputError, match="double_hyphen must be 'separator' or 'minus'"):
        read(tmp_path, text, double_hyphen="plus")


def test_a_station_without_a_height_has_horizontal_readings(tmp_path):
    network = read(tmp_path, "1,2,MG,7-,100.0,50.0,3.0\n1,0,MG,8,,12.5,,\n1,2,MG,9,1.0,2.0\n")
    (direction,) = network.observations.values()
    assert direction.value == pytest.approx(12.5 * GON)
    assert network.points["7"].coordinates == (50.0, 100.0, 3.0)
    assert network.points["9"].coordinates[:2] == (2.0, 1.0)
    east_first = read(tmp_path, "1,2,MG,7-,100.0,50.0,3.0\n1,0,MG,8,,12.5,,\n", order="EN")
    assert east_first.points["7"].coordinates == (100.0, 50.0, 3.0)
    with pytest.raises(InputError, match="order must be 'NE' or 'EN'"):
        read(tmp_path, nikon_dtm300(), order="XY")


@pytest.mark.parametrize(("unit", "metres"), [("M", 1.0), ("F", US_SURVEY_FOOT), ("N", FOOT)])
def test_all_lengths_of_a_line_have_its_unit(tmp_path, unit, metres):
    network = read(tmp_path, nikon_dtm300().replace("MG", f"{unit}G"))
    first = next(iter(network.observations.values()))
    assert first.instrument_height == pytest.approx(HEIGHT * metres)
    assert first.target_height == pytest.approx(TARGET * metres)
    assert network.points["B"].coordinates == pytest.approx(
        [60 * metres, 10 * metres, 101 * metres]
    )


def test_wrong_lines_are_all_named(tmp_path):
    text = "1 , 0 , MD , 46 , 23.515 , 258.5100 , 97.6035 , 0\n1 , 0 , MG , 5 , 1.0\n"
    text += "1 , 4 , MX , 1\n1 , 0 , MD\n9\nx\n"
    with pytest.raises(InputError) as error:
        read(tmp_path, text)
    said = str(error.value)
    for what in (
        "book.nik:1: zenith reading: '97.6035' has 60 or more",
        "book.nik:3: type '4' is unknown; valid: 0, 1, 2, 3",
        "book.nik:3: units of lengths and angles 'MX' is unknown",
        "book.nik:4: point is missing",
        "book.nik:6: state (1 valid, 0 deleted) must be a whole number",
        "book.nik:1: 2 sights from here have no station: it begins with a line of type 2",
    ):
        assert what in said
