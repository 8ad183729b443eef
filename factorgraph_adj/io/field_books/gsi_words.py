"""Words and blocks of Leica's GSI-8 and GSI-16.

A word has a word index of two digits, four characters of information (the last one names the unit),
a sign and 8 digits, or 16 in blocks that begin with ``*``; a blank follows. Some indices have a
third digit in the place of the first character. A block is a line, or begins where a word index 11
or 41 comes again.

Word indices: Leica Geosystems, GSI ONLINE for TPS and DNA, "Word Indexes".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ...units import ANGLE, FOOT
from ..numbers import ROUNDED_PACKED_DEGREES
from ..source import Field, LeftOutReason, Source, TextSource
from ..text_files import file_beginning
from .field_records import SI, Scales

GSI_WORD_PATTERN = re.compile(r"(\d\d)([0-9?./ ]{4})([+-].{1,16})", re.ASCII)
GSI_LENGTHS = {
    "0": (1.0, 1e3),
    "6": (1.0, 1e4),
    "8": (1.0, 1e5),
    "1": (FOOT, 1e3),
    "7": (FOOT, 1e4),
}
"""Metres of the unit, and how many of the last digit make one, by the sixth character; 1 and 7 are
feet. A division gives the float of the decimal number, 151.2 and not 151.20000000000002."""
GSI_ANGLES: dict[str, float | str] = {
    "2": 1e-5 * ANGLE["gon"],
    "3": 1e-5 * ANGLE["deg"],
    "4": ROUNDED_PACKED_DEGREES,
    "5": 1e-4 * math.pi / 3200,
}
"""Radians of one unit of the last digit, 5 are mils, 6400 of a circle; 4 is packed as DDDMMSSs."""
THREE_DIGIT_INDICES = ("33", "37", "39", "53", "56", "57", "59", "91")
"""First digits of word indices that have a third one."""
WITHOUT_OBSERVATION = LeftOutReason("words", "they hold no observation")
VALUES_MISSING = LeftOutReason("values", "the file has dashes in their place")
RECOGNISED_LINES = 10
"""Number of lines by which a file is recognised."""
_LINE = re.compile(
    rb"(?:(?:11|41)[0-9?./ ]{4}[+-].{8}(?: \d\d[0-9?./ ]{4}[+-].{8})*"
    rb"|\*(?:11|41)[0-9?./ ]{4}[+-].{16}(?: \d\d[0-9?./ ]{4}[+-].{16})*)\s*"
)


@dataclass
class GsiBlock:
    """The words of a measurement or of a code."""

    line: int
    words: list[tuple[str, str]]
    """Index of each word, and the rest of it: information, sign and data."""

    def first(self, index: str) -> str | None:
        """Return the first word with an index."""
        return next((word for i, word in self.words if i == index), None)


def gsi_blocks(source: TextSource) -> Iterator[GsiBlock]:
    """Iterate over the blocks of a file; what is not GSI is noted as a problem."""
    for line, text in source.numbered():
        yield from blocks_of_line(source, line, text)


def blocks_of_line(
    source: Source, line: int, text: str, *, whole: bool = False
) -> Iterator[GsiBlock]:
    """Iterate over the blocks of a line; what is not GSI is noted as a problem.

    Args:
        source: the file.
        line: number of the line.
        text: the line.
        whole: whether the last word must have all characters, as one that an instrument sends has;
            in files the last word may be shorter.
    """
    block: GsiBlock | None = None
    rest = text.strip("\x1a\x00").lstrip()
    size = 16 if rest.startswith("*") else 8
    rest = rest.removeprefix("*")
    while rest.strip():
        word, rest = rest[: 7 + size], rest[7 + size :].removeprefix(" ")
        match = GSI_WORD_PATTERN.fullmatch(word)
        if match is None or ((rest or whole) and len(word) < 7 + size):
            what = f"{word[:24]!r} is not a word of GSI: two digits, four characters, a sign"
            source.wrong(line, f"{what} and {size} characters, such as 21.322+16901313")
            break
        if block is None or match[1] in ("11", "41"):
            if block is not None:
                yield block
            block = GsiBlock(line, [])
        info = match[2].replace(" ", ".")
        index = match[1] + info[0] * (match[1] in THREE_DIGIT_INDICES and info[0].isdigit())
        block.words.append((index, info + match[3]))
    if block is not None:
        yield block


def text_of(word: str) -> str:
    """Return the data of a word as a name: without the zeros that fill it from the left."""
    return word[5:].strip().lstrip("0") or "0"


def read_text(field: Field, scales: Scales = SI) -> str:
    """Return the name in a word; '' after a problem."""
    field.value = text_of(field.value) if isinstance(field.value, str) else None
    return field.name()


def read_millimetres(field: Field, scales: Scales = SI) -> float:
    """Return the length in a word of a code, metres; NaN after a problem."""
    field.value = field.value[4:] if isinstance(field.value, str) else None
    return field.number(scale=1e-3)


def read_gsi_length(field: Field, scales: Scales = SI) -> float:
    """Return the length in a word, metres; NaN after a problem."""
    units = _unit(field, "0 mm, 6 1/10 mm, 8 1/100 mm, 1 and 7 feet").choice(GSI_LENGTHS)
    metres, parts = units or (math.nan, 1.0)
    return _whole_number(field) * metres / parts


def read_gsi_angle(field: Field, scales: Scales = SI) -> float:
    """Return the angle in a word, radians; NaN after a problem."""
    units = "2 gon, 3 degrees, 4 degrees-minutes-seconds, 5 mil"
    unit, value = _unit(field, units).choice(GSI_ANGLES), _whole_number(field)
    if unit is None or math.isnan(value):
        return math.nan
    if isinstance(unit, float):
        return value * unit
    digits = f"{value:+09.0f}"
    field.value = f"{digits[:-5]}.{digits[-5:]}"
    return field.number(unit)


def _unit(field: Field, units: str) -> Field:
    what = f"unit ({units}) of {field.what}"
    return Field(str(field.value)[3], what, field.where, field.problems)


def _whole_number(field: Field) -> float:
    sign, digits = str(field.value)[4], str(field.value)[5:].strip()
    if digits.isascii() and digits.isdigit():
        return float(sign + digits)
    field.wrong(f"must be a whole number, not {digits!r}")
    return math.nan


def leave_out_words(source: Source, line: int, indices: list[str]) -> None:
    """Count words that hold no observation."""
    for index in indices:
        source.leave_out(line, WITHOUT_OBSERVATION, index)


def is_missing(word: str) -> bool:
    """Return whether a word has dashes in the place of its value."""
    return not text_of(word).strip("-")


def is_gsi(path: Path) -> bool:
    """Return whether half of the first lines of a file are blocks of GSI."""
    lines = [line for line in re.split(rb"[\r\n]+", file_beginning(path)) if line.strip()]
    found = [_LINE.fullmatch(line.strip(b" \t\x1a\0") + b" ") for line in lines[:RECOGNISED_LINES]]
    return 2 * sum(m is not None for m in found) > len(found)
