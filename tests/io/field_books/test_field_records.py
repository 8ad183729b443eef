"""Records by keys: nothing of a line is passed over; set-ups: heights may follow their sights."""

from __future__ import annotations

import pytest

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.io.field_books.field_book import DEFAULT_ACCURACIES, FieldBook
from factorgraph_adj.io.field_books.field_records import (
    NEEDED,
    RecordField,
    Scales,
    by_key,
    read_angle,
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
