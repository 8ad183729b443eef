"""Sentences of NMEA 0183: checksum, fields, times of day, degrees and minutes.

A sentence is ``$``, a talker of two letters, a type, fields between commas, ``*`` and a checksum:
the exclusive or of all characters between ``$`` and ``*``, two hexadecimal digits. A sentence
without a checksum or with another one is an error, since serial lines lose characters.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from ..errors import InputError, Problem
from ..io.source import Field

_SENTENCE = re.compile(r"\$([A-Z]{2})([A-Z]{3})((?:,[^,*]*)*)\*([0-9A-Fa-f]{2})", re.ASCII)
_PROPRIETARY = re.compile(r"\$P([A-Z0-9]+)((?:,[^,*]*)*)\*([0-9A-Fa-f]{2})", re.ASCII)
_TIME_OF_DAY = re.compile(r"([0-9]{2})([0-9]{2})([0-9]{2}(?:\.[0-9]*)?)", re.ASCII)
_DEGREES = re.compile(r"([0-9]{1,3})([0-9]{2}(?:\.[0-9]*)?)", re.ASCII)


@dataclass(frozen=True)
class Sentence:
    """A sentence whose checksum is right."""

    talker: str
    """Two letters, such as GP or GN; P for a proprietary one."""
    type: str
    """Three letters, such as GGA; all characters after P for a proprietary one."""
    fields: tuple[str, ...]
    """Fields after the type."""

    def text(self, number: int) -> str:
        """Return a field by its number from 1; '' if the sentence has no such field."""
        return self.fields[number - 1].strip() if number <= len(self.fields) else ""


def checksum(text: str) -> int:
    """Return the exclusive or of all characters."""
    found = 0
    for character in text.encode("latin-1", "replace"):
        found ^= character
    return found


def sentence_of(line: str) -> Sentence:
    """Return the sentence of a line.

    Raises:
        InputError: the line is no sentence, or has no checksum or another one.
    """
    text = line.strip()
    match = _SENTENCE.fullmatch(text)
    own = None if match is not None else _PROPRIETARY.fullmatch(text)
    found = match or own
    if found is None:
        shown = repr(text[:60])
        if text.startswith("$") and not re.search(r"\*[0-9A-Fa-f]{2}$", text):
            raise InputError(f"{shown} ends without a checksum (* and two hexadecimal digits)")
        raise InputError(f"{shown} is no sentence of NMEA 0183: $, talker, type, fields, *checksum")
    stated, own_sum = int(found.groups()[-1], 16), checksum(text[1 : text.rindex("*")])
    if stated != own_sum:
        what = f"checksum {own_sum:02X}, but the sentence states {stated:02X}: characters were lost"
        raise InputError(Problem(what, text[:6]))
    if own is not None:
        return Sentence("P", own[1], tuple(own[2].split(",")[1:]))
    assert match is not None
    return Sentence(match[1], match[2], tuple(match[3].split(",")[1:]))


def time_of_day(value: Field) -> float:
    """Return the seconds of ``hhmmss.ss``; NaN after a problem."""
    match = _TIME_OF_DAY.fullmatch(str(value.value or ""))
    if match is None or int(match[1]) > 23 or int(match[2]) > 59 or float(match[3]) >= 61.0:
        value.wrong(f"must be hhmmss.ss, not {str(value.value)[:20]!r}")
        return math.nan
    return 3600.0 * int(match[1]) + 60.0 * int(match[2]) + float(match[3])


def angle_of(value: Field, hemisphere: Field, letters: str, largest: float) -> float:
    """Return a latitude or longitude of ``dddmm.mmmm`` and a letter, radians; NaN after a problem.

    Args:
        value: the degrees and minutes.
        hemisphere: the letter.
        letters: the two letters: positive and negative.
        largest: largest number of degrees.
    """
    match = _DEGREES.fullmatch(str(value.value or ""))
    minutes = math.nan if match is None else float(match[2])
    degrees = math.nan if match is None else int(match[1]) + minutes / 60.0
    if match is None or minutes >= 60.0 or degrees > largest:
        value.wrong(
            f"must be degrees and minutes (dddmm.mmmm) up to {largest:g} degrees, "
            f"not {str(value.value)[:20]!r}"
        )
        degrees = math.nan
    sign = hemisphere.choice({letters[0]: 1.0, letters[1]: -1.0})
    return math.nan if sign is None else sign * math.radians(degrees)
