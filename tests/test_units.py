"""Units and the writing of angles."""

from __future__ import annotations

import math

import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.units import angle_unit, format_angle, parse_angle, significant


@pytest.mark.parametrize(
    ("text", "degrees"),
    [
        ("41-28-15.8", 41 + 28 / 60 + 15.8 / 3600),
        ("41 28 15.8", 41 + 28 / 60 + 15.8 / 3600),
        ("-0°00′30″", -30 / 3600),
        # 59.996″ is often printed as 60.00.
        ("10-59-60.00", 11.0),
    ],
)
def test_degrees_minutes_and_seconds_are_read(text: str, degrees: float) -> None:
    assert parse_angle(text, "dms") == pytest.approx(math.radians(degrees), rel=1e-15)


@pytest.mark.parametrize("unit", ["rad", "deg", "gon", "mgon", "arcsec", "dms"])
def test_an_angle_that_is_written_is_the_one_that_is_read(unit: str) -> None:
    for angle in (-1.234567, -1e-6, 0.0, 0.7, 3.0):
        text = format_angle(angle, unit, 9)
        assert parse_angle(text, unit) == pytest.approx(angle, abs=1e-8), text


def test_seconds_that_round_to_sixty_are_a_minute() -> None:
    assert format_angle(math.radians(-(10 + 59 / 60 + 59.996 / 3600)), "dms", 2) == "-11-00-00.00"


@pytest.mark.parametrize("text", ["41.5", "41-28", "north", ""])
def test_what_is_not_degrees_minutes_and_seconds_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="is not degrees-minutes-seconds such as"):
        parse_angle(text, "dms")


@pytest.mark.parametrize("text", ["41-60-00", "41-28-60.01"])
def test_too_many_minutes_or_seconds_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="has 60 or more minutes or more than 60 seconds"):
        parse_angle(text, "dms")


def test_unknown_units_are_refused_with_the_valid_ones() -> None:
    with pytest.raises(InputError, match=r"unknown unit of angle 'grad'; valid: rad, .*gon.*, dms"):
        angle_unit("grad")


@pytest.mark.parametrize(
    ("value", "shown"),
    [(37690.4, "37690"), (-123456.7, "-123457"), (1234.4, "1234"), (1.23456, "1.235")],
)
def test_sizes_in_sentences_are_plain_numbers(value, shown):
    assert significant(value, 4) == shown
