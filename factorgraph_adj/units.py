"""Units of files and reports: angles and lengths to radians and metres, and numbers as text."""

from __future__ import annotations

import math
import re

from .errors import InputError

ANGLE: dict[str, float] = {
    "rad": 1.0,
    "mrad": 1e-3,
    "gon": math.pi / 200,
    "mgon": math.pi / 200_000,
    "cc": math.pi / 2_000_000,
    "deg": math.pi / 180,
    "arcmin": math.pi / 10_800,
    "arcsec": math.pi / 648_000,
}
"""Radians in one unit of angle; ``dms`` (degrees-minutes-seconds) is read by `parse_angle`."""

LENGTH: dict[str, float] = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "km": 1e3}
"""Metres in one unit of length."""
FOOT, US_SURVEY_FOOT = 0.3048, 1200.0 / 3937.0
"""Metres in an international foot, and in a foot of the surveys of the United States."""

LARGEST = 1e9
"""Size from which numbers in sentences have an exponent."""
TURN = 2.0 * math.pi
"""The whole circle, radians."""
ARCSEC = ANGLE["arcsec"]
GON = ANGLE["gon"]
CC = ANGLE["cc"]
MILLIMETRE = LENGTH["mm"]
KILOMETRE = LENGTH["km"]
PPM = 1e-6
"""Part per million."""

_DMS = re.compile(r"^\s*([+-])?\s*(\d+)[\s:°d-]+(\d+)[\s:'′m-]+(\d+(?:\.\d*)?)\s*[\"″s]?\s*$")


def angle_unit(unit: str) -> float:
    """Return the radians in one ``unit`` of angle; InputError lists the valid ones."""
    if unit not in ANGLE:
        raise InputError(f"unknown unit of angle {unit!r}; valid: {', '.join(ANGLE)}, dms")
    return ANGLE[unit]


def decimal_angle(unit: str) -> str:
    """Return the unit for angles that are plain numbers: ``unit``, or deg instead of dms."""
    return "deg" if unit == "dms" else unit


def parse_angle(text: str, unit: str) -> float:
    """Read an angle in ``unit`` (or ``dms``: ``41 28 15.8``, ``41-28-15.8``) as radians."""
    if unit != "dms":
        return float(text) * angle_unit(unit)
    match = _DMS.match(text)
    if match is None:
        raise ValueError(f"{text!r} is not degrees-minutes-seconds such as 41-28-15.8")
    sign, degrees, minutes, seconds = match.groups()
    if float(minutes) >= 60 or float(seconds) > 60:  # 59.996″ is often printed as 60.00
        raise ValueError(f"{text!r} has 60 or more minutes or more than 60 seconds")
    value = math.radians(float(degrees) + float(minutes) / 60 + float(seconds) / 3600)
    return -value if sign == "-" else value


def decimal(value: float, digits: int) -> str:
    """Write a number with ``digits`` decimals; zero has no sign.

    >>> decimal(-0.0004, 3), decimal(-0.0006, 3)
    ('0.000', '-0.001')
    """
    text = f"{value:.{digits}f}"
    return text[1:] if text.startswith("-") and not text.strip("-0.") else text


def significant(value: float, digits: int) -> str:
    """Write a number with significant digits; the digits before the point are never cut.

    >>> significant(37690.4, 4), significant(0.012345, 3), significant(2.5e11, 3)
    ('37690', '0.0123', '2.5e+11')
    """
    whole = 10.0 ** (digits - 1) <= abs(value) < LARGEST
    return f"{value:.0f}" if whole else f"{value:.{digits}g}"


def format_turn(radians: float, unit: str, digits: int) -> str:
    """Write an angle of the whole circle, from 0 to less than 2π, as `format_angle`."""
    text = format_angle(radians % (2 * math.pi), unit, digits)
    return (
        format_angle(0.0, unit, digits) if text == format_angle(2 * math.pi, unit, digits) else text
    )


def format_angle(radians: float, unit: str, digits: int) -> str:
    """Write an angle in ``unit`` or ``dms`` with ``digits`` decimals; zero has no sign."""
    if unit != "dms":
        return decimal(radians / angle_unit(unit), digits)
    ticks = round(abs(radians) / ARCSEC * 10**digits)
    sign = "-" if radians < 0 and ticks else ""
    seconds, minutes, degrees = (
        ticks % (60 * 10**digits),
        ticks // (60 * 10**digits) % 60,
        ticks // (3600 * 10**digits),
    )
    return f"{sign}{degrees}-{minutes:02d}-{seconds / 10**digits:0{3 + digits}.{digits}f}"
