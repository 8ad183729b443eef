"""Records by keys: nothing of a line is passed over; set-ups: heights may follow their sights."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.accuracies import DEFAULT_ACCURACIES
from factorgraph_adj.io.field_books.field_book import FieldBook
from factorgraph_adj.io.field_books.field_records import (
    NEEDED,
    RecordField,
    Scales,
    by_key,
    read_angle,
    read_choice,
    read_length,
    read_name,
    read_record,
)
from factorgraph_adj.io.numbers import PACKED_DEGREES
from factorgraph_adj.io.source import Source
from factorgraph_adj.units import FOOT, GON

SIGHT = (
    RecordField("target", "target", read_name, "TO", NEEDED),
    RecordField("direction", "direction", read_angle, "HZ"),
    RecordField("horizontal", "horizontal distance", read_length, "HD"),
)


def said(source: Source) -> list[str]:
    return [str(p) for p in source.problems.problems]


def test_units_of_a_record_are_those_of_its_file():
    source = Source("a.raw")
    words = by_key(["TO=B", "HZ=12.3000", "HD=100"], source, 3)
    of = read_record(SIGHT, words, source, 3, Scales(FOOT, PACKED_DEGREES))
    assert of == {"target": "B", "direction": 12.5 * fga.units.ANGLE["deg"], "horizontal": 30.48}
    assert read_record(SIGHT, words, source, 3, Scales(angle=GON))["direction"] == 12.3 * GON
    assert not said(source)


def test_words_without_keys_twice_and_unknown_are_stated():
    source = Source("a.raw")
    words = by_key(["TO=B", "HZ:1", "HZ=2", "HZ=3", "HX=4", "PC=5"], source, 7)
    of = read_record(SIGHT, words, source, 7, unread=["PC"])
    assert of == {"target": "B", "direction": 2.0, "horizontal": None}
    assert said(source) == [
        "a.raw:7: word 'HZ:1' must be a key and a text with '=' between",
        "a.raw:7: word 'HZ' stands twice",
        "a.raw:7: word 'HX' is unknown; valid: HD, HZ, PC, TO",
    ]


def test_a_field_too_many_is_stated():
    source = Source("a.raw")
    read_record(SIGHT, ["B", "1", "2", "3"], source, 1)
    assert said(source) == [
        "a.raw:1: has 4 fields; valid: at most 3, target, direction, horizontal distance"
    ]


# -- set-ups --------------------------------------------------------------------------------------


def two_sights(*, height: float | None, later: float | None = None) -> fga.Network:
    book = FieldBook(Source("a.raw"), DEFAULT_ACCURACIES)
    book.point(1, "B", 10.0, 20.0, 3.0)
    book.begin(2, "A", height)
    book.sight(3, "B", direction=0.1, zenith=1.5, distance=20.0, target_height=1.6)
    book.sight(4, "B", direction=3.2, zenith=4.8, distance=20.0, target_height=1.6)
    book.sight(5, "C", horizontal=12.0)
    if later is not None:
        book.set_height(6, later)
    book.sight(7, "C", horizontal=12.1)
    return book.network()


def test_a_height_of_the_instrument_may_follow_the_sights_of_a_set_up():
    at_once, later = two_sights(height=1.5), two_sights(height=None, later=1.5)
    assert later.observations == at_once.observations
    assert {o.instrument_height for o in later.observations.values()} == {1.5}
    unstated = two_sights(height=None).observations
    assert {o.instrument_height for o in unstated.values()} == {0.0}


def test_a_second_height_of_a_set_up_must_be_the_first():
    assert two_sights(height=1.5, later=1.5).observations == two_sights(height=1.5).observations
    with pytest.raises(InputError, match=r"a\.raw:6: height of the instrument 1\.600 m differs"):
        two_sights(height=1.5, later=1.6)


def test_what_stands_before_any_station_is_stated_with_its_line():
    book = FieldBook(Source("a.raw"), DEFAULT_ACCURACIES)
    book.set_height(2, 1.5)
    for line in (3, 4):
        book.sight(line, "B", direction=0.1)
    book.begin(5, "A")
    book.sight(6, "B", direction=0.1)
    with pytest.raises(InputError) as caught:
        book.network(hint="; begin with a station")
    assert [str(p) for p in caught.value.problems] == [
        "a.raw:2: a height of the instrument before any station",
        "a.raw:3: 2 sights from here have no station; begin with a station",
    ]


# -- what records leave open ----------------------------------------------------------------------


def new_book(**options) -> FieldBook:
    return FieldBook(Source("a.raw"), DEFAULT_ACCURACIES, **options)


def values(network: fga.Network) -> list[tuple[str, str, str, float]]:
    return [(o.kind, o.station, o.target, o.value) for o in network.observations.values()]


def test_a_word_of_a_record_is_a_value_of_a_table():
    source = Source("a.raw")
    face = (RecordField("face", "face", read_choice({"F1": 1, "F2": 2}), "F"),)
    assert read_record(face, {"F": "F2"}, source, 1) == {"face": 2}
    assert read_record(face, {}, source, 2) == {"face": None}
    assert read_record(face, {"F": "F3"}, source, 3) == {"face": None}
    assert said(source) == ["a.raw:3: face 'F3' is unknown; valid: F1, F2"]


def test_a_sight_without_a_reading_is_left_out_and_counted():
    book = new_book()
    book.begin(1, "A")
    book.sight(2, "B", direction=0.1, zenith=1.5, distance=10.0)
    book.sight(3, "C", target_height=1.5)
    book.sight(4, "D", distance=0.0, horizontal=0.0)
    network = book.network()
    assert set(network.points) == {"A", "B"}
    (left,) = network.left_out
    assert str(left) == "sights: 2 left out, as they have no reading: C, D; first in a.raw:3"


@pytest.mark.parametrize("zero_is_unmeasured", [True, False])
def test_a_distance_of_0_was_not_measured_in_files_of_instruments(zero_is_unmeasured):
    book = new_book(zero_is_unmeasured=zero_is_unmeasured)
    book.begin(1, "A")
    book.sight(2, "B", direction=0.1, zenith=1.5, distance=0.0)
    kinds = [kind for kind, *_ in values(book.network())]
    expected = ["direction", "zenith_angle"] + ["slope_distance"] * (not zero_is_unmeasured)
    assert kinds == expected


def test_the_circle_reading_of_a_backsight_is_a_direction_unless_a_sight_has_it():
    book = new_book()
    book.begin(1, "A")
    book.backsight(2, "R", 0.0)
    book.backsight(3, "Q", None)
    book.sight(4, "B", direction=1.0, zenith=1.5, distance=10.0)
    book.begin(5, "B")
    book.backsight(6, "A", 2.0)
    book.sight(7, "A", direction=2.0001, zenith=1.5, distance=10.0)
    network = book.network()
    directions = [v for v in values(network) if v[0] == "direction"]
    assert directions == [
        ("direction", "A", "B", 1.0),
        ("direction", "A", "R", 0.0),
        ("direction", "B", "A", 2.0001),
    ]
    assert set(network.points) == {"A", "B", "R"}
    (left,) = network.left_out
    assert str(left) == (
        "circle readings of backsights: 1 left out, as sights of their set-ups have the "
        "directions: A; first in a.raw:6"
    )
    early = new_book()
    early.backsight(1, "R", 0.0)
    with pytest.raises(InputError, match=r"a\.raw:1: a backsight before any station"):
        early.network()


def plane_book(**options) -> FieldBook:
    """Return a station with three known points, seen by directions and horizontal distances."""
    book = new_book(**options)
    for i, (name, x, y) in enumerate((("A", 0.0, 0.0), ("B", 60.0, 10.0), ("C", -20.0, 50.0)), 1):
        book.point(i, name, x, y)
    book.begin(4, "S", 1.5)
    for i, (name, (x, y, _)) in enumerate(list(book.points.items())[:3], 5):
        dx, dy = x - 15.0, y - 20.0
        book.sight(i, name, direction=math.atan2(dx, dy) - 0.3, horizontal=math.hypot(dx, dy))
    return book


def test_a_book_without_a_reading_of_heights_is_a_plane_network():
    network = plane_book(fixed="A,B,C").network()
    assert {p.held for p in network.points.values()} == {"xyz", "z"}
    assert network.remarks == [
        "no reading gives a height: the network is plane, and holds the heights of all points, at "
        "0 where the file has none"
    ]
    assert not network.refractions
    solution = fga.adjust(network)
    assert np.allclose(solution.point("S"), (15.0, 20.0, 0.0), atol=1e-6)
    assert solution.redundancy == 6 - 3
    assert fga.adjust(plane_book().network()).redundancy == 0  # three targets of one station


def test_heights_that_are_missing_of_held_points_are_named():
    book = plane_book(fixed="A,B,C")
    book.point(9, "D", 5.0, 6.0, 7.0)
    book.sight(10, "D", zenith=1.5)
    network = book.network()
    assert network.remarks == ["A, B, C are held in plan alone: the file has no height"]
    assert network.points["A"].held == "xy" and network.points["S"].held == ""


def test_names_of_points_to_hold_say_which_have_coordinates():
    book = plane_book(fixed="A,S,X")
    with pytest.raises(InputError) as caught:
        book.network()
    advice = "points with coordinates: A, B, C: give fixed=A,B (--set fixed=A,B)"
    assert [str(p) for p in caught.value.problems] == [
        f"a.raw:1: fixed: the file has no coordinates of point 'S'; {advice}",
        f"a.raw:1: fixed: there is no point 'X'; known: A, B, C, S; {advice}",
    ]


def test_coordinates_that_differ_are_a_problem_or_a_remark_that_names_them():
    book = new_book()
    book.point(1, "A", 1.0, 2.0, 3.0)
    book.point(2, "A", 1.0, 2.002, 3.0, agree=False)
    book.point(3, "A", 1.0, 2.0, 3.7, agree=False)
    book.point(4, "B", 1.0, 2.0)
    book.point(5, "B", 1.0, 2.01, 7.0, agree=False)
    network = book.network()
    assert network.points["A"].coordinates == (1.0, 2.0, 3.0)
    assert network.points["B"].coordinates == (1.0, 2.0, 7.0)
    assert network.remarks == [
        "coordinates of 2 points are stated again with other values, of which the first count; "
        "they differ in A by 0.7000 m (a.raw:3), B by 0.0100 m (a.raw:5)"
    ]
    assert not network.doubts
    book.point(6, "A", 1.0, 2.002, 3.0)
    with pytest.raises(InputError, match=r"a\.raw:6: coordinates of point 'A' differ from those "):
        book.network()


def test_a_number_that_is_given_to_points_at_two_places_is_doubted():
    book = new_book()
    for line, (name, north) in enumerate([("A", 2.0), ("B", 5.0), ("A", 9.0), ("B", 5.9)], 1):
        book.point(line, name, 1.0, north, 3.0, agree=False)
    network = book.network()
    (doubt,) = network.doubts
    assert str(doubt) == (
        "a.raw:3: 1 point has coordinates of another place, too: A by 7.0000 m (a.raw:3); points "
        "that have one number are one point here: give each its own"
    )
    assert "they differ in B by 0.9000 m (a.raw:4)" in network.remarks[0]
