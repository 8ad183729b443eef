"""GSI as instruments write it: 60 seconds, words without observations, lines of levels."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.gsi_words import is_gsi
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, KNOWN, STATION, gsi

MM = 2e-3
"""Two last digits of the coordinates of the file, and the errors of the circles."""


def read(folder, text: str, **options) -> fga.Network:
    path = folder / "book.gsi"
    path.write_bytes(text.encode())
    return fga.read(path, **options)


def said(folder, text: str, **options) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(folder, text, **options)
    return [str(p) for p in caught.value.problems]


# -- total stations -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("digits", "degrees"),
    [
        ("08400600", 84 + 1 / 60),
        ("08459600", 85.0),
        ("00000600", 1 / 60),
        ("35959600", 360.0),
        ("08400599", 84 + 59.9 / 3600),
    ],
)
def test_an_angle_may_have_60_seconds(tmp_path, digits, degrees):
    network = read(tmp_path, f"110001+000000P1 21.324+{digits} 22.324+09000000 \n", station="S")
    found = next(o.value for o in network.observations.values() if o.kind == "direction")
    assert math.degrees(found) % 360.0 == pytest.approx(degrees % 360.0, abs=1e-10)


def test_more_than_60_seconds_are_no_angle(tmp_path):
    for digits in ("08400601", "08460000"):
        text = f"110001+000000P1 21.324+{digits} 22.324+09000000 \n"
        assert "has 60 or more minutes or seconds" in said(tmp_path, text, station="S")[0]


def test_words_without_an_observation_are_counted(tmp_path):
    text = gsi().replace("31...6", "25.322+0000000012345678 33...0+0000000000001234 31...6", 1)
    network = read(tmp_path, text)
    assert network.observations == read(tmp_path, gsi()).observations
    (left,) = network.left_out
    assert str(left) == (
        "words: 2 left out, as they hold no observation: 25, 33; first in book.gsi:5"
    )


def test_coordinates_of_an_instrument_that_occur_twice_are_said(tmp_path):
    words = "81..10+{:08d} 82..10+00200000 83..10+{}"
    rows = [(100000, "00050000"), (100002, "00-----".zfill(8)), (100000, "00050690")]
    text = "".join(f"11000{i}+00009003 {words.format(*r)}\n" for i, r in enumerate(rows, 1))
    network = read(tmp_path, text)
    assert network.points["9003"].coordinates == (100.0, 200.0, 50.0)
    assert network.remarks == [
        "coordinates of 1 point are stated again with other values, of which the first count; "
        "they differ in 9003 by 0.6900 m (book.gsi:3)"
    ]


def test_a_height_of_the_instrument_in_each_sight_is_one_set_up(tmp_path):
    sights = [row for row in gsi().splitlines() if " 21" in row]
    text = "\n".join(f"{row.strip()} 88...0+0000000000001500" for row in sights) + "\n"
    network = read(tmp_path, text)
    assert "they are one set-up, whose station is called 'station'" in network.remarks[0]
    assert {o.instrument_height for o in network.observations.values()} == {1.5}
    lines = text.splitlines()
    lines[1] = lines[1].removesuffix("1500") + "1510"
    what = "height of the instrument 1.510 m differs from that of the set-up"
    assert what in said(tmp_path, "\n".join(lines))[0]


def test_coordinates_beside_the_sights_give_a_station_that_opens_the_file(tmp_path):
    """The station of the first sights is that of the surveyor's project, (15, 20, 102)."""
    rows = []
    for row in gsi().splitlines():
        name = row[8:24].lstrip("0")
        if " 21" in row and name in KNOWN:
            axes = zip(("81", "82", "83"), KNOWN[name], strict=True)
            beside = (f"{w}..00{'-' if v < 0 else '+'}{abs(round(1e3 * v)):016d}" for w, v in axes)
            rows.append(" ".join((row.strip(), *beside)))
    network = read(tmp_path, "\n".join(rows) + "\n")
    assert np.allclose(
        network.points["station"].coordinates, np.add(STATION, (0, 0, HEIGHT)), atol=MM
    )
    assert "coordinates beside 6 of them give 'station' at 15.000 20.000 m" in network.remarks[0]
    named = read(tmp_path, "\n".join(rows) + "\n", station="S")
    assert np.allclose(named.points["S"].coordinates[:2], STATION[:2], atol=MM)


def test_gsi_is_recognised_by_its_blocks_whatever_the_suffix(tmp_path):
    for size in (8, 16):
        path = tmp_path / f"book{size}.txt"
        path.write_text(gsi(size), encoding="utf-8")
        assert is_gsi(path)
        path.write_text(gsi(size).replace("\n", "\r"), encoding="utf-8")
        assert is_gsi(path)
    for text in ("", "110001 12.5 13.5\n", "A 1 2 3\n", "11 21+00000100\n"):
        path.write_text(text, encoding="utf-8")
        assert not is_gsi(path)


# -- levels ---------------------------------------------------------------------------------------


def staff(number: int, point: str, index: str, reading: float, distance: float = 20.0) -> str:
    """Return a block with a reading of the staff, 0.01 mm."""
    sign = "-" if reading < 0 else "+"
    height = f"{index}.28{sign}{abs(round(reading * 1e5)):08d}"
    return f"11{number:04d}+{point:0>8} 32...8+{round(distance * 1e5):08d} {height} \n"


def height(number: int, point: str, value: float, info: str = "..6") -> str:
    return f"11{number:04d}+{point:0>8} 83.{info}+{round(value * 1e4):08d} \n"


def levelled(network: fga.Network) -> list[tuple[str, str, float]]:
    return [
        (o.station, o.target, round(o.value, 6))
        for o in network.observations.values()
        if o.kind == "height_difference"
    ]


BFFB = (
    "410001+?......2\n"
    + height(2, "M1", 120.5)
    + staff(3, "M1", "331", 1.62345, 22.5)
    + staff(4, "T", "332", 1.10220, 22.8)
    + staff(5, "T", "336", 1.10232, 22.8)
    + staff(6, "M1", "335", 1.62351, 22.5)
    + "110007+0000000T 571..8+00000006 572..8+00000006 573..8-00030000 574..8+04530000 "
    + "83..08+12102122 \n"
    + staff(8, "T", "331", 1.31010)
    + staff(9, "M2", "332", 1.95544)
    + staff(10, "M2", "336", 1.95540)
    + staff(11, "T", "335", 1.31018)
    + staff(12, "X", "333", -0.5)
)
"""Two set-ups and an intermediate sight to a staff that hangs from a ceiling."""
EXAMPLE_FILES = {
    "gsi-level": Example(
        "gsi",
        {"levels.gsi": BFFB},
        "levels.gsi",
        {"fixed": "M1"},
        unread=(r"11000[7]\+",),  # what the level has computed
    )
}


def test_both_readings_of_each_staff_are_meaned(tmp_path):
    network = read(tmp_path, BFFB, fixed="M1")
    first = (1.62345 + 1.62351) / 2 - (1.10220 + 1.10232) / 2
    second = (1.31010 + 1.31018) / 2 - (1.95544 + 1.95540) / 2
    up = (1.31010 + 1.31018) / 2 + 0.5
    assert levelled(network) == [
        ("M1", "T", round(first, 6)), ("T", "M2", round(second, 6)), ("T", "X", round(up, 6))
    ]  # fmt: skip
    solution = fga.adjust(network)
    assert abs(solution.point("M2")[2] - (120.5 + first + second)) < 1e-6
    (left,) = network.left_out
    assert left.count == 5 and left.names == ("571", "572", "573", "574", "83")


@pytest.mark.parametrize(("method", "needed"), [("1", 1), ("3", 1), ("2", 2), ("4", 2)])
def test_the_method_says_how_often_a_staff_is_read(tmp_path, method, needed):
    text = f"410001+?......{method}\n" + staff(2, "A", "331", 1.5) + staff(3, "B", "332", 1.2)
    if needed == 1:
        assert levelled(read(tmp_path, text)) == [("A", "B", 0.3)]
    else:
        assert "incomplete set-up" in said(tmp_path, text)[0]
    text += staff(4, "B", "336", 1.2) + staff(5, "A", "335", 1.5)
    if needed == 2:
        assert levelled(read(tmp_path, text)) == [("A", "B", 0.3)]


def test_a_line_without_a_method_says_by_its_readings_how_often(tmp_path):
    text = staff(1, "A", "331", 1.5) + staff(2, "B", "332", 1.2)
    assert levelled(read(tmp_path, text)) == [("A", "B", 0.3)]
    text += staff(3, "B", "336", 1.21) + staff(4, "A", "335", 1.51)
    assert levelled(read(tmp_path, text)) == [("A", "B", 0.3)]
    assert "'9' is unknown; valid: 1, 2, 3, 4, 10" in said(tmp_path, "410001+?......9\n" + text)[0]


def test_readings_that_check_the_instrument_or_belong_to_no_line_are_counted(tmp_path):
    check = "410001+?.....10\n" + staff(2, "A", "331", 1.5) + staff(3, "B", "332", 1.2)
    line = "410004+?......1\n" + staff(5, "A", "331", 1.5) + staff(6, "B", "332", 1.25)
    network = read(tmp_path, staff(1, "Q", "330", 1.0) + check + line)
    assert levelled(network) == [("A", "B", 0.25)]
    assert set(network.points) == {"A", "B"}
    assert [str(left) for left in network.left_out] == [
        "readings of the staff: 1 left out, as they belong to no line: Q; first in book.gsi:1",
        "readings of the staff: 2 left out, as they check the instrument: A, B; "
        "first in book.gsi:3",
    ]


def test_a_reading_that_is_repeated_at_once_replaces_the_first(tmp_path):
    begin = "410001+?......1\n"
    back = staff(2, "A", "331", 1.9) + staff(3, "A", "331", 1.5)
    fore = staff(4, "B", "332", 1.7) + staff(5, "B", "332", 1.2)
    again = staff(6, "A", "331", 1.4) + staff(7, "B", "332", 1.1)
    network = read(tmp_path, begin + back + fore + again)
    assert levelled(network) == [("A", "B", 0.3), ("A", "B", 0.3)]
    (left,) = network.left_out
    assert (left.count, left.names) == (2, ("A", "B"))
    twice = "410001+?......2\n" + staff(2, "A", "331", 1.9) + staff(3, "B", "332", 1.7)
    twice += staff(4, "A", "331", 1.5) + staff(5, "B", "332", 1.2) + staff(6, "B", "336", 1.2)
    assert levelled(read(tmp_path, twice + staff(7, "A", "335", 1.5))) == [("A", "B", 0.3)]
    text = begin + staff(2, "A", "331", 1.9) + staff(3, "C", "331", 1.5)
    assert "book.gsi:3: backsight of 'C' in a set-up whose backsight is 'A'" in said(tmp_path, text)


@pytest.mark.parametrize("method", ["1", "3"])
def test_turning_points_without_a_number_are_told_apart(tmp_path, method):
    """BF and, in even set-ups of the alternating method, FB."""
    second = [staff(4, "0", "331", 1.4), staff(5, "0", "332", 1.3)]
    rows = [staff(2, "A", "331", 1.5), staff(3, "0", "332", 1.2)]
    rows += second if method == "1" else second[::-1]
    rows += [staff(6, "0", "331", 1.6), staff(7, "B", "332", 1.0)]
    network = read(tmp_path, f"410001+?......{method}\n" + "".join(rows))
    assert levelled(network) == [("A", "0_1", 0.3), ("0_1", "0_2", 0.1), ("0_2", "B", 0.6)]
    text = "410001+?......1\n" + staff(2, "0", "331", 1.5) + staff(3, "B", "332", 1.0)
    assert "backsight of the turning point 0, to which no foresight" in said(tmp_path, text)[0]


def test_heights_of_dashes_and_typed_ones(tmp_path):
    rows = "410001+?......1\n" + "110002+0000000A 83..18+-------- \n" + staff(3, "A", "331", 1.5)
    rows += staff(4, "B", "332", 1.2) + height(5, "B", 99.3, ".06") + height(6, "K", 77.0, ".16")
    network = read(tmp_path, rows)
    heights = {n: p.coordinates[2] for n, p in network.points.items()}
    assert math.isnan(heights["A"]) and math.isnan(heights["B"]) and heights["K"] == 77.0
    assert [left.names for left in network.left_out] == [("A 83",), ("83",)]


def test_words_of_total_stations_do_not_belong_into_a_line(tmp_path):
    text = BFFB.replace("332.28", "22.322+10000000 332.28", 1)
    assert said(tmp_path, text)[0] == ("book.gsi:4: word 22 cannot stand in a block of a level")
