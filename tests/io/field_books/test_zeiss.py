"""Field books of Zeiss and Trimble: four layouts of one survey, stationings, levels, damage."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction, HeightDifference, SlopeDistance
from factorgraph_adj.units import FOOT, GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, STATION, TARGET, sights

TENTH_MM = 1e-4


@dataclass(frozen=True)
class Line:
    """A line of a recorder in any layout."""

    values: tuple[tuple[str, str, str], ...] = ()
    """Types, numbers and units."""
    text: str = ""
    code: str = ""
    name: str = ""


def coordinates(name: str, xyz: Iterable[float], code: str = "") -> Line:
    """Return the line of a point with coordinates."""
    x, y, z = (f"{v:.3f}" for v in xyz)
    return Line((("Y", x, "m"), ("X", y, "m"), ("Z", z, "m")), code=code, name=name)


def survey() -> list[Line]:
    """Return the lines of the small survey, gon."""
    lines = [coordinates(n, xyz) for n, xyz in KNOWN.items()]
    lines.append(coordinates("S", STATION, "S"))
    lines.append(Line(text="POLAR"))
    lines.append(Line((("th", f"{TARGET:.3f}", "m"), ("ih", f"{HEIGHT:.3f}", "m")), text="INPUT"))
    for s in sights():
        hz, v = (f"{a / GON:.6f}" for a in (s.direction, s.zenith))
        values = (("SD", f"{s.distance:.5f}", "m"), ("Hz", hz, "gon"), ("V1", v, "gon"))
        lines.append(Line(values, name=s.target))
    return lines


def barred(values: Iterable[tuple[str, str, str]], width: int) -> str:
    """Return three values between strokes."""
    out = [f"{t:2} {n:>{width}} {u:4}|" for t, n, u in values]
    return "".join(out + [" " * (width + 8) + "|"] * (3 - len(out)))


def m5(lines: Iterable[Line]) -> str:
    """Return lines as M5, of an instrument with the markings of delivery."""
    out = []
    for i, line in enumerate(lines, start=1):
        info = line.text.ljust(27) if line.text else f"{line.code:>15}{line.name:>12}"
        block = "TI " if line.text else "PI1"
        out.append(f"For M5|Adr {i:05d}|{block} {info}|{barred(line.values, 14)} ")
    return "\r\n".join([*out, "END".ljust(119)]) + "\r\n"


def r_layout(lines: Iterable[Line], number: int) -> str:
    """Return lines as R4 or R5."""
    out = []
    for i, line in enumerate(lines, start=1):
        info = f"TR {line.text:7}" if line.text else f"KR {line.code:3}{line.name:>4}"
        address = f"Adr {i:04d}|" if number == 5 else ""
        out.append(f"For R{number}|{address}{info}|{barred(line.values, 11)}")
    return "\n".join([*out, "END"]) + "\n"


def rec500(lines: Iterable[Line]) -> str:
    """Return lines as REC 500, which has no units."""
    out = []
    for i, line in enumerate(lines, start=1):
        info = line.text.ljust(27) if line.text else f"{line.name:>19}{line.code:5}   "
        values = "".join(
            f"{t:2}{n:>{w}} " for (t, n, _), w in zip(line.values, (12, 13, 11), strict=False)
        )
        out.append(f"   {i:04d} {info} {values}".ljust(80))
    return "\n".join([*out, "END"]) + "\n"


def levelled(*rows: str) -> str:
    """Return lines of a level as M5, of rows such as ``12 Rb 1.5 20.1``, ``12 Z 100`` and texts."""
    out = []
    for i, row in enumerate(rows, start=1):
        words = row.split()
        kinds = ("Rb", "Rf", "Rz", "Z", "Lr", "Lv", "Sh")
        at = next((n for n, w in enumerate(words) if w in kinds), None)
        if at is None:
            out.append(f"For M5|Adr {i:5d}|TO  {row:27}|{barred((), 14)} ")
            continue
        name = words[0] if at else ""
        values = [(words[at], words[at + 1], "m")]
        values += [("HD", words[at + 2], "m")] if len(words) > at + 2 else []
        out.append(f"For M5|Adr {i:5d}|KD1 {name:>8}      07:47:275   3|{barred(values, 14)} ")
    return "\n".join(out) + "\n"


LEVELLED = levelled(
    "NIVEL.DAT",
    "Start-Line        BFFB    3",
    "A Z 100.00000",
    "A Rb 1.52300 25.340",
    "1 Rf 1.21100 24.870",
    "1 Rf 1.21120 24.870",
    "A Rb 1.52320 25.360",
    "1 Z 100.31200",
    "1 Rb 0.98750 30.120",
    "1 Rb 0.98770 30.120",
    "Measurement repeated",
    "B Rf 1.88420 29.650",
    "B Rf 1.88420 29.650",
    "1 Rb 0.98750 30.120",
    "Intermediate sight.",
    "C Rz 2.10500 12.300",
    "End-Line",
    "B Sh -0.58440",
)
EXAMPLE_FILES = {
    "m5": Example("zeiss", {"book.m5": m5(survey())}, "book.m5", HELD, is_field_book=True),
    "zeiss r5": Example(
        "zeiss", {"book.r5": r_layout(survey(), 5)}, "book.r5", HELD, is_field_book=True
    ),
    "zeiss r4": Example(
        "zeiss", {"book.r4": r_layout(survey(), 4)}, "book.r4", HELD, is_field_book=True
    ),
    "rec 500": Example(
        "zeiss", {"book.rec": rec500(survey())}, "book.rec", {**HELD, "angle_unit": "gon"}
    ),
    "m5 level": Example("zeiss", {"line.dat": LEVELLED}, "line.dat", {"fixed": "A"}),
}


def read(tmp_path, text: str, name: str = "book.m5", **options) -> fga.Network:
    """Read a text."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return fga.read(path, format="zeiss", **options)


def test_one_survey_in_four_layouts_is_one_network(tmp_path):
    """Places differ, and REC 500 says in a remark that its lengths are metres."""
    texts = [m5(survey()), r_layout(survey(), 5), r_layout(survey(), 4)]
    networks = [read(tmp_path, text) for text in texts]
    networks.append(read(tmp_path, rec500(survey()), angle_unit="gon"))

    def of(network):
        points = [(p.name, tuple(p.coordinates)) for p in network.points.values()]
        return points, [replace(o, source=None) for o in network.observations.values()]

    assert all(of(n) == of(networks[0]) for n in networks[1:])
    assert [len(n.remarks) for n in networks] == [0, 0, 0, 1]
    assert "lengths are read as metres; length_unit" in networks[3].remarks[0]


# -- stationings ----------------------------------------------------------------------------------


def dms(value: float) -> str:
    """Return radians as D.MMSS."""
    seconds = round(math.degrees(value) % 360 * 3600)
    return f"{seconds // 3600}.{seconds // 60 % 60:02d}{seconds % 60:02d}"


def known_station() -> list[Line]:
    """Return a station with the orientation of the circle, and the first sight of a real file.

    Numbers of the point: 180416-1.m5 of a Trimble M3, in the test data of GeoEasy (7b3baf63).
    """
    return [
        Line(text="KN STAT"),
        Line((("Hz", "110.0849", "DMS"), ("V1", "78.4020", "DMS")), code="A", name="9"),
        coordinates("1", (0.0, 0.0, 0.0), "S"),
        Line((("Om", "249.5111", "DMS"),), text=" "),
        Line(text="POLAR"),
        Line((("th", "0.000", "m"), ("ih", "1.645", "m")), text="INPUT"),
        Line((("th", "1.534", "m"), ("PC", "-0.018", "m"), ("A", "0.017", "m")), text="PR"),
        Line((("T_", "20", "C"), ("P", "29.9", "inHg")), text="INPUT"),
        Line((("SD", "6.552", "m"), ("Hz", "340.0105", "DMS"), ("V1", "91.1619", "DMS")), name="2"),
        coordinates("2", (-2.239, 6.156, -0.034)),
        Line(text="COM-OFF"),
    ]


def test_readings_behind_a_known_station_are_oriented(tmp_path):
    """The coordinates that the instrument computed come out to their last digit."""
    network = read(tmp_path, m5(known_station()), refraction=None)
    back, *others = network.observations.values()
    assert (back.kind, back.points()) == ("direction", ("1", "9"))
    assert abs(math.remainder(back.value, 2 * math.pi)) < 1e-9  # its azimuth is 0
    sight = {o.kind: o for o in others}
    assert sight["direction"].set == back.set == "1"
    assert (back.instrument_height, sight["direction"].target_height) == (1.645, 1.534)
    hz, z, d = (sight[k].value for k in ("direction", "zenith_angle", "slope_distance"))
    computed = (d * math.sin(z) * math.sin(hz), d * math.sin(z) * math.cos(hz))
    computed += (d * math.cos(z) + 1.645 - 1.534,)
    assert computed == pytest.approx((-2.239, 6.156, -0.034), abs=0.001)
    assert tuple(network.points["2"].coordinates) == (-2.239, 6.156, -0.034)
    assert [left.names for left in network.left_out] == [("9",)]


def test_an_orientation_point_with_the_number_of_the_station_is_another_point(tmp_path):
    """OR.COOR of an Elta: both have the present number; the station's height follows."""
    lines = [
        Line(text="OR.COOR"),
        Line((("X", "1.000", "m"), ("Y", "2.000", "m")), code="A", name="0"),
        Line((("m", "0.999198", ""), ("Om", "21.9645", "grd")), text=" "),
        coordinates("0", (46.475, 23.926, 0.0), "S"),
        Line(text="POLAR"),
        Line((("Z", "12.232", "m"),), code="S", name="1"),
    ]
    for text in (m5(lines), r_layout(lines, 5), r_layout(lines, 4), rec500(lines)):
        points = read(tmp_path, text).points
        assert list(points) == ["0 A", "0"]
        assert tuple(points["0"].coordinates) == (46.475, 23.926, 12.232)
        assert tuple(points["0 A"].coordinates[:2]) == (2.0, 1.0)


def free_station() -> list[Line]:
    """Return a free station, whose circle is turned behind its stationing."""
    begin = [Line(text="UN STAT")]
    begin.append(Line((("th", f"{TARGET}", "m"), ("ih", f"{HEIGHT}", "m")), text="INPUT"))
    shots = [s for s in sights() if s.face == 1]
    for code, s in zip("ABC", shots, strict=True):
        given = ("SD", f"{s.distance:.5f}", "m"), ("Hz", f"{s.direction / GON:.6f}", "gon")
        begin.append(
            Line((*given, ("V1", f"{s.zenith / GON:.6f}", "gon")), code=code, name=s.target)
        )
    begin.append(coordinates("S", STATION, "S"))
    begin.append(Line(text="POLAR"))
    hz = f"{(shots[0].direction + 1.0) / GON:.6f}"
    zenith = f"{shots[0].zenith / GON:.6f}"
    values = ("SD", f"{shots[0].distance:.5f}", "m"), ("Hz", hz, "gon"), ("V1", zenith, "gon")
    return [coordinates(n, xyz) for n, xyz in KNOWN.items()] + begin + [Line(values, name="P")]


def test_sights_of_a_free_station_are_a_set_of_their_own(tmp_path):
    network = read(tmp_path, m5(free_station()), fixed="A,B,C", refraction=None)
    directions = [o for o in network.observations.values() if isinstance(o, Direction)]
    assert [(o.target, o.set) for o in directions] == [
        ("A", "1"),
        ("B", "1"),
        ("C", "1"),
        ("P", "2"),
    ]
    assert {o.instrument_height for o in directions} == {HEIGHT}
    solution = fga.adjust(network, leave_out_undetermined=True)
    assert math.dist(solution.point("S"), STATION) < 0.005  # the index error of one face


def test_a_stationing_in_height_gives_the_station_its_height(tmp_path):
    sight = ("SD", "7.674", "m"), ("Hz", "7.5439", "DMS"), ("V1", "89.1413", "DMS")
    lines = [
        *known_station()[:6],
        Line(text="EL STAT"),
        Line((("Z", "0.000", "m"),), code="!", name="2"),
        Line(sight, code="A", name="2"),
        Line((("Z", "-0.102", "m"),), code="S", name="A"),
    ]
    network = read(tmp_path, m5(lines))
    assert tuple(network.points["1"].coordinates) == (0.0, 0.0, -0.102)
    directions = [o for o in network.observations.values() if isinstance(o, Direction)]
    assert [(o.target, o.set) for o in directions] == [("9", "1"), ("2", "1")]
    assert "A" not in network.points


def test_a_station_that_sights_itself_needs_names(tmp_path):
    text = m5([*known_station(), *known_station()])
    lines = text.replace("2|SD", "1|SD")
    with pytest.raises(InputError, match=r"book.m5:9: station '1' sights itself: .*give stations="):
        read(tmp_path, lines)
    network = read(tmp_path, lines, stations="X,Y")
    assert {o.points()[0] for o in network.observations.values()} == {"X", "Y"}
    with pytest.raises(InputError, match="stations names 1; the file has 2 set-ups"):
        read(tmp_path, lines, stations="X")


def test_sights_of_a_stationing_without_its_station_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"book.m5:2: sights of a stationing without a point of"):
        read(tmp_path, m5(known_station()[:2]))


# -- units and columns ----------------------------------------------------------------------------


@pytest.mark.parametrize(("unit", "scale"), [("m", 1.0), ("ft", FOOT)])
@pytest.mark.parametrize(
    ("angle", "hz"), [("DMS", "45.3000"), ("deg", "45.5"), ("grd", "50.5555556")]
)
def test_values_have_their_units(tmp_path, unit, scale, angle, hz):
    values = ("SD", "10.000", unit), ("Hz", hz, angle), ("V1", hz, angle)
    lines = [coordinates("S", (0, 0, 0), "S"), Line(values, name="P")]
    network = read(tmp_path, m5(lines))
    found = {o.kind: o.value for o in network.observations.values()}
    assert found["slope_distance"] == 10.0 * scale
    assert math.degrees(found["direction"]) == pytest.approx(45.5, abs=1e-7)


@pytest.mark.parametrize("kind", ["V2", "V3"])
def test_vertical_readings_from_the_horizon_become_zenith_readings(tmp_path, kind):
    values = ("SD", "10.000", "m"), ("Hz", "0.0", "gon"), (kind, "10.0", "gon")
    lines = [coordinates("S", (0, 0, 0), "S"), Line(values, name="P")]
    zenith = [o.value for o in read(tmp_path, m5(lines)).observations.values()][1]
    assert zenith == pytest.approx(90 * GON, abs=1e-12)


def test_rec_500_asks_for_the_unit_of_its_angles_once(tmp_path):
    with pytest.raises(InputError, match=r"book.m5:7: the file has no unit of angles") as caught:
        read(tmp_path, rec500(survey()))
    assert len(caught.value.problems) == 1
    feet = read(tmp_path, rec500(survey()), angle_unit="gon", length_unit="ft")
    assert not feet.remarks
    assert feet.points["B"].coordinates[0] == 60.0 * FOOT


def test_a_start_block_says_where_point_numbers_stand_and_which_axis_is_north(tmp_path):
    """Elta: number before code, by the blanks behind the code; a START block or an option."""

    def number_first(info_of):
        text = m5([coordinates("7", (1.0, 2.0, 3.0), "S")])
        return text.replace(f"{'S':>15}{'7':>12}", info_of)

    elta = number_first(f"{'7':>19}{'S':5}   ")
    assert list(read(tmp_path, elta).points) == ["7"]
    other = number_first(f"{'7':>12}{'S':>5}          ")
    with pytest.raises(
        InputError, match=r"book.m5:1: the columns of point numbers .*point_columns"
    ):
        read(tmp_path, other)
    assert list(read(tmp_path, other, point_columns="13,1").points) == ["7"]
    start = m5([Line((("20", "18", ""), ("21", "13", ""), ("22", "1", "")), text="START")])
    assert list(read(tmp_path, start.replace("END", "") + other).points) == ["7"]
    axes = m5([Line((("05", "2", ""), ("06", "1", "")), text="START")]).replace("END", "") + elta
    assert tuple(read(tmp_path, axes).points["7"].coordinates) == (2.0, 1.0, 3.0)
    turned = read(tmp_path, axes, x_axis="north")
    assert tuple(turned.points["7"].coordinates) == (1.0, 2.0, 3.0)


# -- levels ---------------------------------------------------------------------------------------


def test_a_level_gives_one_height_difference_of_each_set_up(tmp_path):
    """Means of both readings; what was repeated does not count."""
    network = read(tmp_path, LEVELLED, fixed="A")
    found = [(o.points(), o.value, o.length_km) for o in network.observations.values()]
    assert [p for p, *_ in found] == [("A", "1"), ("1", "B"), ("1", "C")]
    values = (1.5231 - 1.2111, 0.9875 - 1.8842, 0.9875 - 2.105)
    assert [v for _, v, _ in found] == pytest.approx(values, abs=1e-9)
    assert [k for *_, k in found] == pytest.approx((0.05022, 0.05977, 0.04242))
    solution = fga.adjust(network)
    assert solution.point("B")[2] == pytest.approx(100.0 + 0.312 - 0.8967, abs=TENTH_MM)


def test_turning_points_need_no_names_and_older_names_of_types_are_read(tmp_path):
    rows = ("Start-Line  BF  1", "A Z 5.0", "A Lr 1.5 20.0", "Lv 1.0 20.0", "Lr 2.0 20.0")
    network = read(tmp_path, levelled(*rows, "B Lv 1.0 20.0", "End-Line"))
    found = [(o.points(), o.value) for o in network.observations.values()]
    assert all(isinstance(o, HeightDifference) for o in network.observations.values())
    assert found == [(("A", "turning point 1"), 0.5), (("turning point 1", "B"), 1.0)]


def test_a_line_that_ends_with_one_staff_is_refused(tmp_path):
    rows = ("Start-Line  BF  1", "A Z 5.0", "A Rb 1.5 20.0", "End-Line")
    with pytest.raises(InputError, match=r"book.m5:3: the line ends with a backsight alone"):
        read(tmp_path, levelled(*rows))


# -- wrong files ----------------------------------------------------------------------------------


def test_all_problems_are_listed_with_their_lines(tmp_path):
    text = m5(known_station())
    lines = text.split("\r\n")
    lines[1] = lines[1].replace("110.0849 DMS", "110.0869 DMS")
    lines[5] = lines[5].replace("1.645 m   ", "1.645 yd  ")
    lines[6] = lines[6].replace("|", "/")
    lines[8] = lines[8].replace("SD ", "QQ ").replace("91.1619", "     x1")
    with pytest.raises(InputError) as caught:
        read(tmp_path, "\n".join(lines))
    said = [str(p) for p in caught.value.problems]
    for line, what in (
        (2, "'110.0869' has 60 or more minutes or seconds"),
        (6, "unit of value ih 'yd' is unknown; valid: m, ft"),
        (7, "is no line of M5: 'For M5', an address"),
        (9, "type of a value 'QQ' is unknown"),
        (9, "value V1: 'x1' is not packed degrees"),
    ):
        assert any(s.startswith(f"book.m5:{line}: ") and what in s for s in said), (what, said)


def test_records_that_the_instrument_marks_are_left_out(tmp_path):
    lines = m5(survey()).split("\r\n")
    lines[6] = lines[6][:118] + "e"
    network = read(tmp_path, "\n".join(lines))
    assert [(left.count, left.where) for left in network.left_out] == [(1, "book.m5:7")]
    assert sum(isinstance(o, SlopeDistance) for o in network.observations.values()) == 3


def test_recognition_asks_for_the_form_of_the_lines(tmp_path):
    """Whatever the suffix; texts with single words of the format are others."""
    reader = READERS.named("zeiss")
    for i, (text, is_zeiss) in enumerate(
        (
            (m5(survey()), True),
            (r_layout(survey(), 5), True),
            (r_layout(survey(), 4), True),
            (rec500(survey()), True),
            (LEVELLED, True),
            ("For M5|Adr   1|TO Start-Line  BF  10|        |  |  |\n", True),  # wrong columns
            ("   0001 one\n   0002 two\n", False),
            ("For M5 see the manual\nAdr 1|x|y|z|\n", False),
            ("   1    23.45   66.70\n   2    24.45   67.70\n", False),
            ("", False),
        )
    ):
        path = tmp_path / f"book{i}.txt"
        path.write_text(text, encoding="utf-8")
        assert reader.recognises(path) == is_zeiss, i
