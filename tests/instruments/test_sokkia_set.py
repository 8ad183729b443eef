"""Answers of a Sokkia SET: check sums, packed degrees, records with commas."""

import math

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.instruments import ReceivedLine
from factorgraph_adj.instruments.grammars import grammar_record
from factorgraph_adj.instruments.readings import Occupation, Sight
from factorgraph_adj.instruments.sokkia_set import SokkiaSet


def read(text, **options):
    return SokkiaSet(**{"target": "P", **options}).read(ReceivedLine(text.encode(), 0.0, 1))


def answer(text):
    return f"{text} {sum((text + ' ').encode()) & 0xFF:02X}"


def record(text):
    return f"{text},{sum((text + ',').encode()) & 0xFF:02X}"


@pytest.mark.published
def test_the_check_sum_is_that_of_the_manual():
    """SET300 manual, chapter 23: 1234567 1234567 1234567 has the sum A4; its minutes are 67."""
    with pytest.raises(InputError, match="60 or more"):
        read("1234567 1234567 1234567 A4\r")
    with pytest.raises(InputError, match="whose sum is A4"):
        read("1234567 1234567 1234567 A5")


def test_an_answer_is_a_sight_of_the_stated_target():
    (sight,) = read(answer("0012345 0901530 3595959"))
    assert isinstance(sight, Sight)
    assert sight.target == "P" and sight.distance == pytest.approx(12.345)
    assert math.degrees(sight.zenith) == pytest.approx(90 + 15 / 60 + 30 / 3600)
    assert math.degrees(sight.direction) == pytest.approx(359 + 59 / 60 + 59 / 3600)


def test_a_distance_of_zero_was_not_measured():
    (sight,) = read(answer("0000000 0901530 0000000"))
    assert sight.distance is None and sight.direction == 0.0


def test_the_vertical_circle_may_count_from_the_horizon():
    (sight,) = read(answer("0012345 3594430 0000000"), vertical="horizon")
    assert math.degrees(sight.zenith) == pytest.approx(90 + 15 / 60 + 30 / 3600)


def test_sums_may_be_switched_off():
    (sight,) = read("0012345 0901530 0000000", check_sums="optional")
    assert sight.distance == pytest.approx(12.345)
    with pytest.raises(InputError, match="does not fit"):
        read("0012345 0901530 0000000")
    with pytest.raises(InputError, match="does not fit"):
        read("0012345 0901530 0000000 00", check_sums="optional")


def test_records_name_station_target_and_units():
    station = record("M,26.6.1,S1,,1.500,20,1013,0.000,0.000,0.000,0,0,0,0,1,0,0,0,0,0,0,0")
    (occupation,) = read(station, target="")
    assert isinstance(occupation, Occupation)
    assert (occupation.station, occupation.instrument_height) == ("S1", 1.5)
    (sight,) = read(record("7,Ea,0100,,1.700,0,6.570,101.2345,200.0000"), target="")
    assert (sight.target, sight.target_height, sight.distance) == ("7", 1.7, 6.57)
    assert sight.zenith == pytest.approx(101.2345 * math.pi / 200)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (answer("E200000 0901530 0000000"), "no answer"),
        (answer("E200 E200 E200"), "error E200"),
        (answer("0012345 0901560 0000000"), "60 or more"),
        ("0012345 0901530", "no answer"),
        ("0012345 0901530 0000000 ZZ", "does not fit"),
        ("7,Ea,0100,,1.700,0,6.570,101.2345,200.0000", "missing or does not fit"),
        (record("7,Ea,0900,,1.700,0,6.570,101.2345,200.0000"), "unit of angles"),
        (record("7,Ea,0100,,1.700,0,6.570"), "fields"),
        ("", "no answer"),
    ],
)
def test_what_cannot_be_read_is_refused_with_the_reason(text, message):
    with pytest.raises(InputError, match=message):
        read(text)


def test_every_changed_digit_of_an_answer_is_found():
    line = answer("0012345 0901530 3595959")
    for i, character in enumerate(line):
        for other in "05 ":
            if other != character:
                with pytest.raises(InputError):
                    read(line[:i] + other + line[i + 1 :])


def test_an_answer_without_a_target_is_refused():
    with pytest.raises(InputError, match="state target"):
        read(answer("0012345 0901530 0000000"), target="")


def test_options_are_checked():
    for options in ({"vertical": "nadir"}, {"check_sums": "no"}):
        with pytest.raises(InputError, match="must be one of"):
            SokkiaSet(**options)
    assert grammar_record("sokkia-set").make is SokkiaSet
