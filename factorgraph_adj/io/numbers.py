"""Numbers and units of files: read and written in any unit, and in dms, without losing a bit.

A cell is read as the float64 nearest to the exact decimal product text × unit. A value is written
with as many digits as are needed to read the same float64 back. 0.5 mm is therefore the same
float as 0.0005 m, and a project stays the same after any number of round trips in any unit.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Context, Decimal
from functools import lru_cache

from ..errors import InputError, Problem
from ..units import ANGLE, LENGTH, parse_angle

_PI = Decimal("3.14159265358979323846264338327950288419716939937510582")
_EXACT = Context(prec=60)
NUMBER_PATTERN = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eEdD][+-]?[0-9]+)?")
"""A number of a file: decimal point, exponent as in C or in Fortran."""
MAX_NUMBER = 1e12
"""Largest absolute value of a number of a file, in its unit: more than any place on the Earth in
micrometres is damage."""
_COMMA = re.compile(r"[+-]?[0-9.' ]*,[0-9]+(?:[eE][+-]?[0-9]+)?")
_HINTS = {
    "write a decimal point": _COMMA,
    "write it without separators of thousands": re.compile(
        r"[+-]?[0-9]{1,3}(?:[,.'’ \u00a0\u202f][0-9]{3})+(?:[.,][0-9]+)?"
    ),
    "its minus is another character: write '-'": re.compile("[\u2010-\u2015\u2212].*[0-9].*"),
    "a spreadsheet may have made a date of it: format the column as text": re.compile(
        r"[0-9]{1,2}\.? ?[^\W\d_]{3,}\.? ?[0-9]{0,4}|[^\W\d_]{3,}[ .-][0-9]{2,4}"
        r"|[0-9]{1,4}[./][0-9]{1,2}[./][0-9]{2,4}"
    ),
    "degrees, minutes and seconds are read with the unit dms": re.compile(
        r"[0-9]{1,3}[- °][0-9]{1,2}[- '’′][0-9]{1,2}(?:\.[0-9]*)?[\"”″]?"
    ),
}
"""What a text that is no number may be, by what is to be done."""
_MOST_QUOTED = 40
"""Largest number of characters of a number that a message quotes."""
_NOT_FINITE = re.compile(r"[+-]?(?:nan|inf|infinity)", re.IGNORECASE)
_PLAIN = {"": Decimal(1), "ppm": Decimal("1e-6"), "km": Decimal(1000), "px": Decimal(1)}
_PLAIN["image"] = Decimal(1)  # unit of a camera, whatever it is

PACKED_DEGREES = "D.MMSSs"
"""Unit of angles in packed degrees: 123.45300 is 123° 45′ 30.0″, and so is 123.453."""
ROUNDED_PACKED_DEGREES = "D.MMSSs, rounded"
"""Packed degrees of instruments, which round 59.96″ to 60″: 123.4560 is 123° 46′."""
PACKED_PATTERN = re.compile(r"([+-]?)(?=\.?[0-9])0*([0-9]{0,3})(?:\.([0-9]*))?")
"""An angle in packed degrees, less than 1000°."""
ANGLE_UNITS = (*ANGLE, "dms")
"""Units of observed angles; standard deviations may have all of them except dms."""
SIGMA_OF_ANGLE = {
    "rad": "mrad",
    "mrad": "mrad",
    "gon": "mgon",
    "mgon": "mgon",
    "cc": "cc",
    "deg": "arcsec",
    "arcmin": "arcsec",
    "arcsec": "arcsec",
    "dms": "arcsec",
}
"""Default unit of the standard deviations of angles, by unit of angle."""


@dataclass(frozen=True)
class Units:
    """Units of a project's files and reports; values in memory are metres and radians."""

    length: str = "m"
    """Unit of coordinates, heights of instruments and targets, and observed lengths."""
    angle: str = "gon"
    """Unit of observed angles, ω φ κ and orientation unknowns; dms: degrees-minutes-seconds."""
    geographic: str = "deg"
    """Unit of latitudes and longitudes."""
    sigma_length: str = "mm"
    """Unit of standard deviations and residuals of lengths in written files and reports."""
    sigma_angle: str = ""
    """Unit of standard deviations and residuals of angles; default: `SIGMA_OF_ANGLE`."""

    def __post_init__(self) -> None:
        """Check the names of the units; InputError lists all unknown ones."""
        problems = [
            Problem(f"unknown unit {getattr(self, key)!r}; valid: {', '.join(valid)}", key)
            for key, valid in (
                ("length", LENGTH),
                ("angle", ANGLE_UNITS),
                ("geographic", ANGLE_UNITS),
                ("sigma_length", LENGTH),
                ("sigma_angle", ("", *ANGLE)),
            )
            if getattr(self, key) not in valid
        ]
        if problems:
            raise InputError(problems)
        if not self.sigma_angle:
            object.__setattr__(self, "sigma_angle", SIGMA_OF_ANGLE[self.angle])


@lru_cache
def unit_factor(unit: str) -> Decimal:
    """Return the exact size of a unit in metres or radians, of ppm as a ratio; mm2 is squared.

    The sizes follow from the tables of `factorgraph_adj.units`: π is divided by a whole number.
    """
    if unit.endswith("2"):
        return _EXACT.multiply(unit_factor(unit[:-1]), unit_factor(unit[:-1]))
    if unit in _PLAIN:
        return _PLAIN[unit]
    if unit in LENGTH:
        return Decimal(repr(LENGTH[unit]))
    parts = math.pi / ANGLE[unit]
    if abs(parts - round(parts)) < 1e-9 * parts:
        return _EXACT.divide(_PI, Decimal(round(parts)))
    return Decimal(repr(ANGLE[unit]))


def parse_quantity(value: object, unit: str = "") -> float:
    """Read a number (text of a cell, or a number of JSON) in ``unit``.

    Raises:
        ValueError: the message says for users what is wrong; the name of the number precedes it.
    """
    if isinstance(value, bool) or not isinstance(value, str | int | float):
        raise ValueError(f"{value!r} is not a number")
    text = value.strip() if isinstance(value, str) else repr(value)
    return _parse_text(text, unit)


def checked_number(
    value: object,
    what: str,
    unit: str = "",
    *,
    scale: float = 1.0,
    least: float = -math.inf,
    above: float = -math.inf,
    largest: float = math.inf,
) -> float:
    """Return a number of a file in SI; the rule of `Field.number` for those who keep no `Field`.

    Raises:
        ValueError: what is wrong, with the name ``what`` of the number.
    """
    valid = _valid_numbers(least, above)
    if value is None or value == "":
        raise ValueError(f"{what} is missing; valid: {valid}")
    try:
        found = scale * parse_quantity(value, unit)
    except ValueError as error:
        raise ValueError(f"{what}: {error}") from None
    if found >= least and found > above and abs(found) <= largest:
        return found
    limit = valid if abs(found) <= largest else f"at most {largest:g}"
    limit = limit.removeprefix("a number ").removeprefix("of ")
    raise ValueError(f"{what} must be {limit}, not {str(value)[:40]}")


def _valid_numbers(least: float, above: float) -> str:
    """Return in words which numbers are valid."""
    if above > -math.inf:
        return "a number greater than zero" if above == 0 else f"a number > {above:g}"
    return f"a number of at least {least:g}" if least > -math.inf else "a number"


@lru_cache(maxsize=4096)
def _parse_text(text: str, unit: str) -> float:
    if unit == "dms":
        return _parse_dms(text)
    if unit in (PACKED_DEGREES, ROUNDED_PACKED_DEGREES):
        return _parse_packed_degrees(text, rounded=unit == ROUNDED_PACKED_DEGREES)
    if NUMBER_PATTERN.fullmatch(text) is None:
        if _NOT_FINITE.fullmatch(text):
            raise ValueError(f"{_quoted(text)} is not a finite number")
        hints = (f"; {hint}" for hint, form in _HINTS.items() if form.fullmatch(text))
        raise ValueError(f"{_quoted(text)} is not a number{next(hints, '')}")
    size = unit_factor(unit)
    plain = text.replace("D", "E").replace("d", "e")
    try:
        number = float(plain) if size == 1 else float(_EXACT.multiply(Decimal(plain), size))
    except ArithmeticError:  # the exponent is outside the range of Decimal
        raise ValueError(f"{_quoted(text)} is too large or too small a number") from None
    if math.isinf(number):
        raise ValueError(f"{_quoted(text)} is not a finite number")
    return number


def _quoted(text: str) -> str:
    """Return a text in quotation marks, without its end where it is long."""
    return repr(text if len(text) <= _MOST_QUOTED else f"{text[:_MOST_QUOTED]}…")


def _parse_dms(text: str) -> float:
    parse_angle(text, "dms")  # raises the error for a malformed text
    degrees, minutes, seconds = (Decimal(t) for t in re.findall(r"\d+(?:\.\d*)?", text))
    total = (degrees * 60 + minutes) * 60 + seconds
    value = float(_EXACT.multiply(total, unit_factor("arcsec")))
    return -value if text.lstrip().startswith("-") else value


def _parse_packed_degrees(text: str, *, rounded: bool) -> float:
    """Return an angle, radians; what a calculator drops, zeros at the end, may be absent.

    Args:
        text: the packed degrees.
        rounded: whether there may be 60 seconds.
    """
    match, such = PACKED_PATTERN.fullmatch(text), "such as 102.34125 for 102° 34′ 12.5″"
    if match is None:
        raise ValueError(f"{_quoted(text)} is not packed degrees {PACKED_DEGREES}, {such}")
    digits = (match[3] or "").ljust(4, "0")
    minutes, seconds = int(digits[:2]), float(f"{digits[2:4]}.{digits[4:]}")
    if minutes >= 60 or seconds > 60 or (seconds == 60 and not rounded):
        what = f"has 60 or more minutes or seconds; packed degrees are {PACKED_DEGREES}, {such}"
        raise ValueError(f"{_quoted(text)} {what}")
    value = math.radians(int(match[2] or 0) + minutes / 60 + seconds / 3600)
    return -value if match[1] == "-" else value


def write_quantity(value: float, unit: str = "") -> str:
    """Write a value with the fewest digits (15 or more) that `parse_quantity` reads exactly."""
    if unit == "dms":
        return _write_dms(value)
    if value == 0:
        return "-0" if math.copysign(1.0, value) < 0 else "0"
    size = unit_factor(unit)
    if size == 1:
        return repr(float(value)).removesuffix(".0")
    if unit not in ANGLE or unit in ("rad", "mrad"):
        return _short_decimal(_EXACT.divide(Decimal(repr(float(value))), size))
    exact = _EXACT.divide(Decimal(value), size)
    for digits in range(15, 40):
        text = _short_decimal(Context(prec=digits).plus(exact))
        if _parse_text(text, unit) == value:
            return text
    raise AssertionError(f"{value!r} has no decimal form in {unit}")


def _short_decimal(number: Decimal) -> str:
    """Return a decimal without trailing zeros, and without an exponent if the text is short."""
    number = number.normalize(_EXACT)
    return format(number, "f") if -8 < number.adjusted() < 16 else str(number)


def _write_dms(value: float) -> str:
    total = _EXACT.divide(Decimal(abs(value)), unit_factor("arcsec"))
    sign = "-" if math.copysign(1.0, value) < 0 else ""
    enough = 25 - total.adjusted()
    context = Context(prec=max(enough, 0) + 20)
    for digits in range(6, max(enough, 7)):
        ticks = total.quantize(Decimal(1).scaleb(-digits), context=context)
        whole, seconds = int(ticks // 60), format((ticks % 60).normalize(context), "f")
        text = f"{sign}{whole // 60}-{whole % 60:02d}-{seconds}"
        if _parse_dms(text) == value:
            return text
    raise AssertionError(f"{value!r} has no form in dms")
