"""Field books of Geodimeter: faces, reference objects, units, the file of coordinates beside."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.readers import READERS
from factorgraph_adj.observations import Direction, SlopeDistance
from factorgraph_adj.units import FOOT, GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, sights


def packed(value: float) -> str:
    """Return radians as D.MMSSs to 0.0001″."""
    parts = round(math.degrees(value) * 36_000_000)
    degrees, rest = divmod(parts, 36_000_000)
    minutes, rest = divmod(rest, 600_000)
    return f"{degrees}.{minutes:02d}{rest:06d}"


def coordinates() -> str:
    """Return the known points of the small survey."""
    return "".join(f"5={n}\n37={y}\n38={x}\n39={z}\n" for n, (x, y, z) in KNOWN.items())


def survey() -> str:
    """Return the readings of the small survey, both faces of a target in one block."""
    lines = ["50=SITE", "2=S", "23=2112", f"3={HEIGHT}"]
    first = {s.target: s for s in sights() if s.face == 1}
    for second in (s for s in sights() if s.face == 2):
        one = first[second.target]
        lines += [f"5={one.target}", "4=PRISM", f"6={TARGET}", f"9={one.distance:.5f}"]
        lines += [f"24={packed(one.direction)}", f"25={packed(one.zenith)}"]
        lines += [f"17={packed(second.direction)}", f"18={packed(second.zenith)}"]
    return "\n".join(lines) + "\n"


UNREAD = (
    r"\|(value|word)\|.*\|(50|4)=",  # job, code of a point
    r"\|word\| qz7x\|(2|5)=",  # a name may have blanks
)
EXAMPLE_FILES = {
    "geodimeter": Example(
        "geodimeter",
        {"book.job": coordinates() + survey()},
        "book.job",
        HELD,
        unread=UNREAD,
        is_field_book=True,
    ),
    "geodimeter job and are": Example(
        "geodimeter",
        {"book.job": survey(), "book.are": coordinates()},
        "book.job",
        HELD,
        unread=UNREAD,
    ),
}


def read(tmp_path, text: str, name: str = "book.job", **options) -> fga.Network:
    """Read a text."""
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return fga.read(path, format="geodimeter", **options)


def test_coordinates_of_the_file_beside_are_those_of_the_book(tmp_path):
    """The same network as of one file; the file may be named, and a remark says which it was."""
    whole = read(tmp_path, coordinates() + survey(), "whole.job")
    (tmp_path / "book.are").write_text(coordinates(), encoding="utf-8")
    beside = read(tmp_path, survey())
    (tmp_path / "book.are").rename(tmp_path / "other.txt")
    named = read(tmp_path, survey(), coordinates=tmp_path / "other.txt")
    without = read(tmp_path, survey())
    for network, name in ((beside, "book.are"), (named, "other.txt")):
        for n, p in network.points.items():
            assert p.coordinates == pytest.approx(whole.points[n].coordinates, nan_ok=True)
        assert network.remarks == [f"coordinates of 3 points are read from {name}"]
    assert all(math.isnan(v) for p in without.points.values() for v in p.coordinates)
    with pytest.raises(InputError, match="missing"):
        read(tmp_path, survey(), coordinates=tmp_path / "missing.are")


def test_problems_of_the_file_beside_have_its_lines(tmp_path):
    (tmp_path / "book.are").write_text("5=A\n37=x\n38=1\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"^book\.are:2: northing \(37\): 'x' is not a number"):
        read(tmp_path, survey())


def test_a_file_of_coordinates_alone_names_that_of_the_readings(tmp_path):
    (tmp_path / "book.job").write_text(survey(), encoding="utf-8")
    network = read(tmp_path, coordinates(), "book.are")
    assert list(network.points) == ["A", "B", "C"]
    assert network.remarks[0] == "book.are has coordinates alone; the readings are in book.job"
    assert "lengths are read as metres" in network.remarks[1]


def test_heights_of_the_instrument_and_signals_follow_their_station(tmp_path):
    """3 behind the first target is that of the set-up; 6 holds until another one is given."""
    text = "2=S\n23=2112\n62=R\n21=10.0000\n3=1.65\n5=P\n6=1.3\n7=20.0000\n8=90.0000\n9=10.0\n"
    text += "5=Q\n7=30.0000\n8=91.0000\n9=20.0\n2=T\n5=P\n7=0.0\n8=90.0\n9=9.0\n"
    directions = [o for o in read(tmp_path, text).observations.values() if isinstance(o, Direction)]
    found = [(o.target, o.instrument_height, o.target_height) for o in directions]
    assert found == [("P", 1.65, 1.3), ("Q", 1.65, 1.3), ("R", 1.65, 0.0), ("P", 0.0, 0.0)]
    assert math.degrees(directions[2].value) == pytest.approx(10.0)


def test_a_reference_object_that_is_sighted_has_one_direction(tmp_path):
    """The first target of BSG-08-11-19.are of Total Open Station: its numbers, gon."""
    text = "2=1000\n37=498.875\n38=490.567\n39=-0.229\n62=1\n37=500.000\n38=500.000\n39=0.000\n"
    text += "21=92.4461\n11=0.000\n3=1.650\n0=Measured point\n5=3\n4=FIX\n6=0.000\n7=107.1313\n"
    text += "8=100.5089\n9=9.111\n37=497.857\n38=499.622\n39=1.348\n5=1\n7=92.4486\n"
    network = read(tmp_path, text, angle_unit="gon", refraction=None)
    o = {(o.kind, o.points()[1]): o for o in network.observations.values()}
    hz, z = o["direction", "3"].value, o["zenith_angle", "3"].value
    d = o["slope_distance", "3"]
    east = 490.567 + d.value * math.sin(z) * math.sin(hz)
    north = 498.875 + d.value * math.sin(z) * math.cos(hz)
    up = -0.229 + d.value * math.cos(z) + d.instrument_height - d.target_height
    # 0.5 mm of each printed coordinate and of the distance, and the rounding of the station
    assert (east, north, up) == pytest.approx((499.622, 497.857, 1.348), abs=0.0015)
    assert tuple(network.points["3"].coordinates) == (499.622, 497.857, 1.348)
    assert o["direction", "1"].value == pytest.approx(92.4486 * GON)
    assert [left.names for left in network.left_out] == [("1",)]
    assert ("horizontal_distance", "1") not in o


def test_means_of_both_faces_are_not_used_beside_them(tmp_path):
    text = "2=S\n23=2112\n5=P\n7=10.0005\n24=10.0000\n17=190.0010\n11=5.0\n10=1.0\n"
    network = read(tmp_path, text)
    direction = next(o for o in network.observations.values() if isinstance(o, Direction))
    assert math.degrees(direction.value) == pytest.approx(10 + 5 / 3600)
    assert sum(left.count for left in network.left_out) == 2
    single = read(tmp_path, text.replace("24=", "0=").replace("10.0005", "10.0000"))
    assert next(
        iter(o for o in single.observations.values() if isinstance(o, Direction))
    ).value == (pytest.approx(direction.value, abs=1e-12))


# -- units ----------------------------------------------------------------------------------------


def test_units_are_those_of_label_23_or_of_options(tmp_path):
    text = "2=S\n23={}\n5=P\n7=50.3000\n9=10.0\n"
    with pytest.raises(InputError) as caught:
        read(tmp_path, text.format("2121"))
    assert [str(p).split(": give")[0] for p in caught.value.problems] == [
        "book.job:2: the unit of lengths is not known by the third digit 2 of label 23",
        "book.job:2: the unit of angles is not known by the fourth digit 1 of label 23",
    ]
    feet = read(tmp_path, text.format("2121"), angle_unit="gon", length_unit="ft")
    values = {o.kind: o.value for o in feet.observations.values()}
    assert values == pytest.approx({"direction": 50.3 * GON, "slope_distance": 10 * FOOT})
    with pytest.raises(InputError, match="label 23 states the unit dms, the option angle_unit gon"):
        read(tmp_path, text.format("2112"), angle_unit="gon")
    with pytest.raises(InputError, match="must be four digits"):
        read(tmp_path, text.format("12"))
    without = text.replace("23={}\n", "")
    with pytest.raises(InputError, match=r"book\.job:3: the file states no unit of angles"):
        read(tmp_path, without)
    assert "lengths are read as metres" in read(tmp_path, without, angle_unit="deg").remarks[0]
    with pytest.raises(InputError, match="angle_unit 'rad' is unknown; valid: gon, deg, dms"):
        read(tmp_path, without, angle_unit="rad")


def shots(readings) -> str:
    """Return targets read in both faces, without a unit."""
    lines = ["2=S"]
    for i, (first, second) in enumerate(readings):
        lines += [f"5=P{i}", f"7={first}", f"17={second}", "9=10.0"]
    return "\n".join(lines) + "\n"


PACKED = [(f"{10 + i}.{10 + i}5{i % 10}", f"{190 + i}.{10 + i}4{i % 10}") for i in range(10)]


@pytest.mark.parametrize(
    ("readings", "unit", "why"),
    [
        (PACKED, "dms", "differ by 180, and decimals are minutes and seconds"),
        ([*PACKED, ("30.1261", "210.1260")], "deg", "differ by 180, and decimals are no minutes"),
        ([("10.7000", "210.6990")], "gon", "differ by 200"),
        ([("383.1316", "183.1300")], "gon", "383.1316 is beyond 360"),
    ],
)
def test_readings_show_their_unit(tmp_path, readings, unit, why):
    network = read(tmp_path, shots(readings))
    assert f"they are read as {unit}, as " in network.remarks[0]
    assert why in network.remarks[0]
    stated = read(tmp_path, shots(readings), angle_unit=unit)
    assert network.observations == stated.observations


@pytest.mark.parametrize(
    "readings",
    [PACKED[:9], [("10.1000", "200.1000")], [("10.1", "190.1"), ("10.1", "210.1")]],
)
def test_readings_that_do_not_show_their_unit_need_the_option(tmp_path, readings):
    """Too few, another difference, and both differences."""
    with pytest.raises(InputError, match=r"book\.job:3: the file states no unit of angles"):
        read(tmp_path, shots(readings))


# -- wrong files ----------------------------------------------------------------------------------


def test_all_problems_are_listed_with_their_lines(tmp_path):
    text = "7=1.0\n2=S\n23=2112\n5=P\n9=x\nQ\n9=1.0\n200=1\n8=12.6000\n5=\n"
    with pytest.raises(InputError) as caught:
        read(tmp_path, text)
    said = [str(p) for p in caught.value.problems]
    for line, what in (
        (1, "horizontal angle (7) before any station or point"),
        (5, "slope distance (9): 'x' is not a number"),
        (6, "'Q' must be a label, '=' and its value"),
        (7, "slope distance (9) stands twice for 'P'"),
        (8, "label '200' is unknown"),
        (9, "'12.6000' has 60 or more minutes"),
        (10, "point is missing"),
    ):
        assert any(s.startswith(f"book.job:{line}: ") and what in s for s in said), (what, said)


def test_recognition_asks_for_labels_in_every_line(tmp_path):
    reader = READERS.named("geodimeter")
    for i, (text, is_one) in enumerate(
        (
            (survey(), True),
            (coordinates(), True),
            ("15=area\n5=vo\n4=vertex\n37=1.0\n38=2.0\n", True),
            ("a=1\nb=2\n", False),
            ("1=2\n3=4\n", False),
            ("5=P\n37=1.0\nnot a label\n", False),
            ("", False),
        )
    ):
        path = tmp_path / f"{i}.txt"
        path.write_text(text, encoding="utf-8")
        assert reader.recognises(path) == is_one, i


def test_slope_distances_of_zero_were_not_measured(tmp_path):
    text = "2=S\n23=2112\n5=P\n7=10.0000\n9=0.000\n"
    kinds = [type(o) for o in read(tmp_path, text).observations.values()]
    assert kinds == [Direction]
    assert SlopeDistance not in kinds
