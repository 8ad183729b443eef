"""Text of a Sokkia SET: status of each record, check sums, coordinates beside the readings."""

from __future__ import annotations

import math

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.sokkia_scr import READER, check_sums
from factorgraph_adj.units import FOOT, GON
from tests.hostile.examples import Example
from tests.io.field_books.field_files import HEIGHT, HELD, KNOWN, TARGET, sights


def summed(*cells: object) -> str:
    """Return a record with its check sum."""
    text = ",".join(map(str, cells)) + ","
    return text + check_sums(text)[0]


def station(name: str, height: float, place: tuple[float, ...] = (0.0, 0.0, 0.0)) -> str:
    """Return the record of a station, east first."""
    unit = (0, 1, 0, -30, 1, 0, 0, 1, 0, 0, 1, 0)
    return summed("M", "6.2.16", name, "?", height, 15, 760, *(f"{c:.3f}" for c in place), *unit)


def sokkia_scr() -> str:
    """Return the survey of all field books, gon."""
    rows = [summed("A", "SET4C", "13194", "5802", "5406"), summed("N", "control")]
    rows += [
        summed(n, "Fd", "0100", "?", "", "", *(f"{c:.3f}" for c in xyz)) for n, xyz in KNOWN.items()
    ]
    rows.append(station("S", HEIGHT))
    for s in sights():
        circles = (f"{s.zenith / GON:.8f}", f"{s.direction / GON:.8f}")
        rows.append(summed(s.target, "Ea", "0100", "?", TARGET, 0, f"{s.distance:.6f}", *circles))
    return "\n".join(rows) + "\n"


EXAMPLE_FILES = {
    "sokkia-scr": Example(
        "sokkia-scr",
        lambda _: {"book.scr": sokkia_scr()},
        "book.scr",
        HELD,
        unread=(r"\|word\| qz7x\|[AN],",),  # instrument and notes, which may lack a check sum
        is_field_book=True,
    )
}


def book(tmp_path, *rows: str, **options: object) -> fga.Network:
    """Return the network of records."""
    path = tmp_path / "b.scr"
    path.write_text("\r\n".join(rows) + "\r\n", encoding="ascii")
    return fga.read(path, **options)


def test_a_reading_and_the_coordinates_of_the_instrument_agree(tmp_path):
    """East-first coordinates of a sight (Eh) follow from the packed degrees beside them.

    The sight is 3001 of terrain.scr of GeoEasy: 6.570 m, 95°26′25″, 185°52′00″.
    """
    place = (576814.600, 189073.480, 145.700)
    sight = summed("3001", "Eh", "0000", "?", "1.500", 7, "576813.931", "189066.974", "144.970",
                   "6.570", "95.2625", "185.5200")  # fmt: skip
    network = book(tmp_path, station("5", 1.393, place), sight, fixed="5", refraction=None)
    assert tuple(network.points["3001"].coordinates) == (576813.931, 189066.974, 144.970)
    of = {o.kind: o for o in network.observations.values()}
    slope, zenith, azimuth = (of[k].value for k in ("slope_distance", "zenith_angle", "direction"))
    assert math.isclose(zenith, math.radians(95 + 26 / 60 + 25 / 3600), abs_tol=1e-12)
    level = slope * math.sin(zenith)
    found = (
        place[0] + level * math.sin(azimuth),
        place[1] + level * math.cos(azimuth),
        place[2] + slope * math.cos(zenith) + 1.393 - 1.500,
    )
    assert found == pytest.approx(network.points["3001"].coordinates, abs=0.5e-3)


def test_the_status_says_units_and_what_the_circles_count(tmp_path):
    rows = [
        summed("P", "Ea", "1110", "?", "3.28084", 0, "100.000", "390.0000", "30.0000"),
        summed("Q", "Ea", "0011", "?", "0", 0, "100.000", "10.0000", "30.0000"),
        summed("R", "Ee", "0020", "?", "0", 0, "-10.0000", "30.0000", "0.0010", "-0.0010"),
    ]
    network = book(tmp_path, station("S", 1.5), *rows)
    of = {(o.target, o.kind): o for o in network.observations.values()}
    assert of["P", "slope_distance"].value == pytest.approx(100 * FOOT)
    assert of["P", "slope_distance"].target_height == pytest.approx(3.28084 * FOOT)
    assert of["P", "zenith_angle"].value == pytest.approx(110 * GON)  # 10 gon below the horizon
    assert of["P", "direction"].value == pytest.approx(30 * GON)
    assert of["Q", "zenith_angle"].value == pytest.approx(math.radians(80))
    assert of["Q", "direction"].value == pytest.approx(math.radians(330))  # counted to the left
    assert of["R", "zenith_angle"].value == pytest.approx(math.radians(100))
    assert ("R", "slope_distance") not in of


def test_a_point_beside_its_prism_has_two_more_fields(tmp_path):
    row = summed("P", "Ea", "0000", "?", "1.5", 0, 1, "0.250", "10.000", "90.0000", "30.0000")
    network = book(tmp_path, station("S", 1.5), row)
    of = {o.kind: o.value for o in network.observations.values()}
    assert (of["slope_distance"], of["direction"]) == pytest.approx((10.0, math.radians(30)))


def test_check_sums_may_be_absent_or_the_plain_sum(tmp_path):
    """The SET300 sends the sum, the SET4C its complement; both can send none."""
    rows = [station("S", 1.5), summed("P", "Ee", "0000", "?", "0", 0, "90.0000", "0.0000", 0, 0)]
    plain = [r[:-2] + check_sums(r[:-2])[1] for r in rows]
    without = [r[:-3] for r in rows]
    found = [book(tmp_path, *r).observations for r in (rows, plain, without)]
    assert found[0] == found[1] == found[2] and found[0]


def test_coordinates_need_the_order_that_a_station_states(tmp_path):
    with pytest.raises(InputError, match=r"b\.scr:1: coordinates without their order"):
        book(tmp_path, summed("P", "Fd", "0000", "?", "", "", 1, 2, 3))


def test_a_changed_record_is_refused_by_its_check_sum(tmp_path):
    sight = summed("P", "Ea", "0000", "?", "0", 0, "10.000", "90.0000", "30.0000")
    wrong = sight.replace("10.000", "10.009")
    with pytest.raises(InputError) as refused:
        book(tmp_path, station("S", 1.5), wrong, summed("A", "SET4C", "1").replace("4", "5"))
    said = [str(p) for p in refused.value.problems]
    assert said[0].startswith(f"b.scr:2: check sum '{sight[-2:]}' does not fit the line, whose sum")
    assert said[1].startswith("b.scr:3: check sum")


@pytest.mark.parametrize(
    ("row", "said"),
    [
        (("P", "Ex", "0000", 1), "record 'Ex' is unknown; valid: Ea, Ee, Ed, Fd, Eh"),
        (("P", "Ee", "0000", "?"), "has 4 fields; valid: 10, and a check sum"),
        (("P", "Ed", "000", "?", 0, 0, 1, 2, 3), "status '000' must have 4 digits"),
        (("P", "Ed", "3000", "?", 0, 0, 1, 2, 3), "unit of distance (0 metres, 1 feet) '3' is"),
        (
            ("P", "Ee", "0002", "?", 0, 0, "90.0000", "0.0000", 0, 0),
            "horizontal circle (0 to the right, 1 to the left) '2' is unknown",
        ),
        (
            ("P", "Ee", "0000", "?", 0, 0, "90.6000", "0.0000", 0, 0),
            "vertical reading: '90.6000' has 60 or more minutes",
        ),
        (("qz7x",), "is no record"),
    ],
)
def test_wrong_records_are_refused_with_their_line(tmp_path, row, said):
    with pytest.raises(InputError) as refused:
        book(tmp_path, station("S", 1.5), ",".join(map(str, row)))
    assert f"b.scr:2: {said}" in str(refused.value)


def test_an_instrument_record_that_lost_its_letter_is_known_by_its_sum(tmp_path):
    rows = [summed("A", "SET4C", "13194", "5802", "5406")[1:], station("S", 1.5)]
    rows.append(summed("P", "Ee", "0000", "?", "0", 0, "90.0000", "0.0000", 0, 0))
    network = book(tmp_path, *rows)
    assert network.remarks == ["the record of the instrument lacks its A in b.scr:1"]
    with pytest.raises(InputError, match=r"b\.scr:1: record 'SET4C' is unknown"):
        book(tmp_path, rows[0][:-1] + "x", *rows[1:])


def test_the_text_is_recognised_by_its_station_whatever_the_suffix(tmp_path):
    path = tmp_path / "book.txt"
    path.write_text(sokkia_scr(), encoding="ascii")
    assert READER.recognises is not None and READER.recognises(path)
    for other in ("M,1,2,3,4\n", "A,SET4C,13194,5802,5406,E0\n", ""):
        path.write_text(other, encoding="ascii")
        assert not READER.recognises(path)
