"""Answers of Sokkia's SET total stations: standard commands, and the records of their text.

- Answers to the commands 11h (distance and angles) and 00h (angles): slope distance, vertical and
  horizontal reading, each of seven digits, a blank behind each, and the check sum: the last two
  hexadecimal digits of the sum of all characters before it, the blank included. Distances are in
  millimetres and angles DDDMMSS, the settings "m" and "degree" of the instrument; the manual does
  not describe the digits of other units. A distance of 0 was not measured. Errors (``E200``) are
  refused with their number.
- Records with commas (M, Ea, Ee, Eh, Ed, Fd), see `factorgraph_adj.io.field_books.sokkia_scr`;
  their status says the units and what the circles count. Coordinates are not used.

An answer names no target: state ``target``, or set records to be sent. Lines without a check sum
are refused unless ``check_sums = "optional"``, as the instrument can be set to send none.

Sources: Sokkia, Two way communication commands (2001); SET300 manual, chapter 23. Tried on the
examples of the manual. Not read: Topcon's GTS and GPT, Nikon's DTM and Trimble's instruments on
line, whose interface manuals are not public; their files are.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Literal, get_args

from ..errors import InputError, known
from ..io.field_books.sokkia_scr import SET_VERTICAL, check_sums, records_of_line
from ..io.numbers import PACKED_DEGREES
from .grammars import GrammarRecord
from .reading_book import ReadingBook
from .readings import Reading, ReceivedLine

_ANSWER = re.compile(r"([0-9]{7}|E[0-9]{3}) ([0-9]{7}|E[0-9]{3}) ([0-9]{7}|E[0-9]{3})(?: (\S*))?")
_SUM = re.compile(r"[0-9A-F]{2}")
CheckSums = Literal["required", "optional"]
VERTICAL_WORDS = {"zenith": "0", "horizon": "1"}
"""Digit of the status for what the vertical circle counts from."""


class SokkiaSet:
    """Parser of the answers of a SET."""

    def __init__(
        self,
        *,
        target: str = "",
        vertical: str = "zenith",
        check_sums: CheckSums = "required",
    ) -> None:
        """Take the options of [[instrument]].

        Args:
            target: target of answers, which do not name it.
            vertical: what the vertical circle of answers counts from: ``zenith`` or ``horizon``.
            check_sums: whether lines must have one.

        Raises:
            InputError: an option is wrong.
        """
        for name, value, valid in (
            ("vertical", vertical, tuple(VERTICAL_WORDS)),
            ("check_sums", check_sums, get_args(CheckSums)),
        ):
            if value not in valid:
                raise InputError(f"{name} must be one of {known(valid)}, not {value!r}")
        self.target, self.vertical = target, SET_VERTICAL[VERTICAL_WORDS[vertical]]
        self.sums_required = check_sums == "required"

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return the readings of a line.

        Raises:
            InputError: the line is no answer and no record, or its check sum is wrong.
        """
        text = line.decoded().strip("\x06\x02\x03\0\r\n")
        book = ReadingBook(line)
        match = _ANSWER.fullmatch(text.rstrip())
        if match is not None:
            self._answer(book, match)
        elif "," in text:
            last = text.rpartition(",")[2]
            summed = _SUM.fullmatch(last) is not None and last in check_sums(text[:-2])
            if self.sums_required and not summed:
                raise InputError(f"check sum {last[:20]!r} is missing or does not fit the line")
            records_of_line(book, 0, text)
        else:
            raise InputError(
                f"{text[:40]!r} is no answer of a SET: three numbers of seven digits and a check "
                "sum, or a record with commas"
            )
        return book.made()

    def _answer(self, book: ReadingBook, match: re.Match[str]) -> None:
        stated = match[4] or ""
        # The sum is that of the characters, of which the second of the two is the plain one.
        right = check_sums(" ".join(match.group(1, 2, 3)) + " ")[1]
        if stated != right and (stated or self.sums_required):
            raise InputError(f"check sum {stated!r} does not fit the line, whose sum is {right}")
        for value in match.group(1, 2, 3):
            if value.startswith("E"):
                raise InputError(f"the instrument answers with the error {value}")
        if not self.target:
            raise InputError("an answer names no target: state target")
        names = ("vertical reading", "horizontal reading")
        vertical, direction = (
            book.source.field(0, f"{v[:3]}.{v[3:]}", what).number(PACKED_DEGREES)
            for v, what in zip(match.group(2, 3), names, strict=True)
        )
        zenith = vertical if math.isnan(vertical) else self.vertical(vertical)
        distance = 1e-3 * int(match[1])
        book.sight(0, self.target, direction=direction, zenith=zenith, distance=distance)


GRAMMAR = GrammarRecord(
    "sokkia-set", "answers and records of Sokkia's SET total stations", SokkiaSet
)
