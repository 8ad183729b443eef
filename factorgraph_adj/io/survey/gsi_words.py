"""Words and blocks of Leica's Geo Serial Interface, GSI-8 and GSI-16.

A word has a word index of two digits, four characters of information (the last one names the unit),
a sign and 8 digits, or 16 in blocks that begin with ``*``; a blank follows. A block is a line, or
begins where a word index 11 or 41 comes again.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass

from ...units import ANGLE
from .notes import Notes

WORD = re.compile(r"(\d\d)([0-9?./ ]{4})([+-])(.{1,16})", re.ASCII)
LENGTHS = {
    "0": (1.0, 1e3),
    "6": (1.0, 1e4),
    "8": (1.0, 1e5),
    "1": (0.3048, 1e3),
    "7": (0.3048, 1e4),
}
"""Metres of the unit, and how many of the last digit make one, by the sixth character; 1 and 7 are
feet. A division gives the float of the decimal number, 151.2 and not 151.20000000000002."""
ANGLES = {"2": 1e-5 * ANGLE["gon"], "3": 1e-5 * ANGLE["deg"], "5": 1e-4 * math.pi / 3200}
"""Radians of one unit of the last digit; 4 is DDDMMSSs, 5 are mils, 6400 of a circle."""
DMS = "4"


@dataclass(frozen=True)
class Word:
    """A word."""

    index: str
    """Word index, two digits."""
    info: str
    """Four characters of information."""
    data: str
    """Sign and data."""
    line: int
    """Line of the file."""

    @property
    def text(self) -> str:
        """The data as a name: without the zeros that fill it from the left."""
        return self.data[1:].strip().lstrip("0") or "0"

    def number(self, notes: Notes) -> float:
        """Return length or angle, metres or radians; note a problem and return NaN otherwise."""
        digits = self.data[1:].strip()
        unit, sign = self.info[3], -1.0 if self.data[0] == "-" else 1.0
        if not (digits.isascii() and digits.isdigit()):
            notes.add(self.line, f"word {self.index} has {digits!r}, which is not a number")
            return math.nan
        if self.index in ("21", "22"):
            if unit == DMS:
                return sign * self._dms(digits.rjust(8, "0"), notes)
            if unit in ANGLES:
                return sign * int(digits) * ANGLES[unit]
            valid = "2 gon, 3 degrees, 4 degrees-minutes-seconds, 5 mil"
        else:
            if unit in LENGTHS:
                metres, parts = LENGTHS[unit]
                return sign * int(digits) * metres / parts
            valid = "0 mm, 6 1/10 mm, 8 1/100 mm, 1 and 7 feet"
        notes.add(self.line, f"word {self.index} has unit {unit!r}; valid: {valid}")
        return math.nan

    def _dms(self, digits: str, notes: Notes) -> float:
        degrees, minutes, tenths = int(digits[:-5]), int(digits[-5:-3]), int(digits[-3:])
        if minutes >= 60 or tenths > 600:
            notes.add(self.line, f"word {self.index}: {digits} has 60 or more minutes or seconds")
            return math.nan
        return math.radians(degrees + minutes / 60 + tenths / 36000)


@dataclass
class Block:
    """The words of a measurement or of a code."""

    line: int
    words: list[Word]

    def first(self, index: str) -> Word | None:
        """Return the first word with an index."""
        return next((w for w in self.words if w.index == index), None)

    @property
    def is_code(self) -> bool:
        """Whether the block is a code."""
        return self.words[0].index == "41"


def blocks(text: str, notes: Notes) -> Iterator[Block]:
    """Iterate over the blocks of a file; what is not GSI is noted as a problem."""
    current: Block | None = None
    for number, line in enumerate(text.split("\n"), start=1):
        rest = line.strip("\x1a\x00")
        size = 16 if rest.lstrip().startswith("*") else 8
        rest = rest.lstrip().removeprefix("*")
        while rest.strip():
            word, rest = rest[: 7 + size], rest[7 + size :].removeprefix(" ")
            match = WORD.fullmatch(word)
            if match is None or (rest and len(word) < 7 + size):
                what = f"{word[:24]!r} is not a word of GSI: two digits, four characters, a sign"
                notes.add(number, f"{what} and {size} characters, such as 21.322+16901313")
                break
            found = Word(match[1], match[2], match[3] + match[4], number)
            if current is None or found.index in ("11", "41") or current.line != number:
                if current is not None:
                    yield current
                current = Block(number, [])
            current.words.append(found)
    if current is not None:
        yield current
