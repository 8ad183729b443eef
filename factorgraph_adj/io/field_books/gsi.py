"""Reader of field books of Leica, GSI-8 and GSI-16: total stations and levelled lines.

A word has a word index of two digits, four characters of information (the last one names the unit),
a sign and 8 digits, or 16 in blocks that begin with ``*``; a blank follows. A block is a line, or
begins where a word index 11 or 41 comes again.

Digital levels write levelled lines in the words 331 to 336.

Word indices: Leica Geosystems, GSI ONLINE for TPS and DNA, "Word Indexes".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from ...errors import known
from ...network.network import Network
from ...units import ANGLE, FOOT
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import Field, LeftOutReason, TextSource
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import NEEDED, SI, RecordField, Scales, read_record
from .levelled_line import LevelledLine

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
    "4": PACKED_DEGREES,
    "5": 1e-4 * math.pi / 3200,
}
"""Radians of one unit of the last digit, 5 are mils, 6400 of a circle; 4 is packed as DDDMMSSs."""
VALUES_MISSING = LeftOutReason("values", "the file has dashes in their place")
STAFF_WORDS = {
    **dict.fromkeys(("331", "335"), "back"),
    **dict.fromkeys(("332", "336"), "fore"),
    **dict.fromkeys(("333", "334"), "intermediate"),
}
"""Sight of a reading of the staff, by word index with the first character of the information."""
LEVELLING_WORDS = (*STAFF_WORDS, "390", "391", "392", "571", "572", "573", "574")
SINGLE_READING_METHODS = (1, 10)
"""Methods BF and aBF; the others read backsight and foresight twice."""
WORDS_OF_LEVELS = ("11", "32", "33", "39", "57", "83", *(str(i) for i in range(71, 80)))
"""Word indices that a block of a level has."""
MAY_BE_MISSING = ("21", "22", "31", "32", *(str(i) for i in range(81, 87)))
"""Words that may have dashes for a value; without a height of instrument or target there is no
sight."""
KNOWN_WORDS = tuple(
    str(i)
    for i in (
        *range(11, 20),
        21,
        22,
        25,
        31,
        32,
        33,
        *range(41, 60),
        *range(70, 80),
        *range(81, 89),
    )
)
"""Word indices that a block may have."""


# -- words and blocks -----------------------------------------------------------------------------


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
        block: GsiBlock | None = None
        rest = text.strip("\x1a\x00").lstrip()
        size = 16 if rest.startswith("*") else 8
        rest = rest.removeprefix("*")
        while rest.strip():
            word, rest = rest[: 7 + size], rest[7 + size :].removeprefix(" ")
            match = GSI_WORD_PATTERN.fullmatch(word)
            if match is None or (rest and len(word) < 7 + size):
                what = f"{word[:24]!r} is not a word of GSI: two digits, four characters, a sign"
                source.wrong(line, f"{what} and {size} characters, such as 21.322+16901313")
                break
            if block is None or match[1] in ("11", "41"):
                if block is not None:
                    yield block
                block = GsiBlock(line, [])
            block.words.append((match[1], match[2].replace(" ", ".") + match[3]))
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


# -- levelled lines -------------------------------------------------------------------------------


class GsiLevelledLine(LevelledLine):
    """The present line of a level, whose readings are words of GSI."""

    def begin(self, word: str) -> None:
        """Begin a line; the code ``?......2`` has the method."""
        method = word.rpartition("?")[2].strip(".+ ")
        stated = method.isascii() and method.isdigit()
        self.begin_line(1 if not stated or int(method) in SINGLE_READING_METHODS else 2)

    def takes(self, block: GsiBlock, name: str) -> bool:
        """Read a block of a line; return whether it is one."""
        found = [(key, w) for i, w in block.words if (key := i + w[0]) in LEVELLING_WORDS]
        if not found:
            height = block.first("83")
            if not self.in_line or any(block.first(i) for i in ("21", "22", "31")):
                return False
            if height is not None and "back" not in self.sights:
                self.book.point(
                    block.line, name, up=self._length(block.line, "83", height), agree=False
                )
            return True
        for index, _ in block.words:
            if index not in WORDS_OF_LEVELS:
                self.source.wrong(block.line, f"word {index} cannot stand in a block of a level")
        distance = block.first("32")
        length = 0.0 if distance is None else abs(self._length(block.line, "32", distance))
        for key, word in found:
            if key in STAFF_WORDS:
                value = self._length(block.line, key[:2], word)
                self.reading(block.line, STAFF_WORDS[key], name, value, length)
        return True

    def _length(self, line: int, index: str, word: str) -> float:
        return read_gsi_length(self.source.field(line, word, f"word {index}"))


# -- blocks of total stations ---------------------------------------------------------------------


def _lengths(**indices: str) -> tuple[RecordField, ...]:
    return tuple(RecordField(name, f"word {i}", read_gsi_length, i) for name, i in indices.items())


POINT_FIELDS = _lengths(east="81", north="82", up="83")
STATION_FIELDS = _lengths(east="84", north="85", up="86", height="88")
SIGHT_FIELDS = (
    RecordField("direction", "word 21", read_gsi_angle, "21"),
    RecordField("zenith", "word 22", read_gsi_angle, "22"),
    *_lengths(distance="31", horizontal="32"),
    *_lengths(target_height="87", height="88", east="81", north="82", up="83"),
)
CODE_FIELDS = (
    RecordField("station", "word 42, the station,", read_text, "42", NEEDED),
    RecordField("height", "word 43, the height in mm,", read_millimetres, "43", NEEDED),
)
"""Fields of the code that begins a set-up."""
BLOCKS = (
    (("21", "22", "31", "32"), SIGHT_FIELDS),
    (("84", "85", "86", "88"), STATION_FIELDS),
    ((), POINT_FIELDS),
)
"""Fields of a block that has any of some words; the first that fits counts."""


def read_gsi(
    path: str | Path,
    *,
    station: str | None = None,
    station_code: str | int | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of a Leica total station or level, GSI-8 or GSI-16.

    A set-up begins where a block has the point (word 11) with coordinates of the station (84, 85,
    86) or height of the instrument (88) and no reading of a circle; or where a code block (41) has
    ``station_code``, station in word 42 and height of the instrument, mm, in word 43; without
    either, ``station`` names the only one. Sights are blocks with 21, 22, 31 (slope distance) and
    87 (height of the target); a distance of 0 was not measured. 32 (horizontal distance) counts
    without 31. Corrections of the distance (51, 58, 59) are in it already, 33 and the coordinates
    81-83 of a sighted point follow from the readings; the latter serve as approximate coordinates.
    Zeros that fill a name from the left are not part of it. Face 2 follows from a zenith reading
    beyond 200 gon; a direction without one counts as of face 1. Readings in two faces are reduced
    by `factorgraph_adj.reduce_faces`; a target that is read again begins another round, a set of
    directions of its own.

    Of levels, 331 and 335 are readings of the backsight, 332 and 336 of the foresight, 333
    intermediate ones, 32 distances of the staff; a code block with ``?`` begins a line and says the
    method.

    Harmless and not read: instrument, date and time (12-19), the difference of the circle to its
    orientation (25), other codes (41-49), remarks (70-79), differences and sums that the level has
    computed (83 of turning points, 390, 571-574). A value of dashes was not measured.

    Args:
        path: the file.
        station: name of the only station of a file that names none.
        station_code: code of the blocks that begin a set-up.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(
        source,
        accuracies,
        fixed,
        station=None if station is None else str(station),
        may_lack_station=True,
    )
    levelling, codes = GsiLevelledLine(book), dict[str, bool]()
    for block in gsi_blocks(source):
        line, (index, word) = block.line, block.words[0]
        if index == "41" and "?" in word:
            levelling.begin(word)
        elif index == "41":
            codes[text_of(word)] = True
            if text_of(word) == str(station_code):
                words = dict(reversed(block.words))
                of = read_record(CODE_FIELDS, words, source, line, unread=KNOWN_WORDS)
                book.begin(line, **of)
        elif index != "11":
            source.wrong(line, f"a block must begin with word 11 or 41, not {index}")
        else:
            name = read_text(source.field(line, word, "word 11, the point,"))
            if not levelling.takes(block, name):
                _read_block(book, block, name)
    levelling.end()
    hint = ": no block before has words 84-86 or 88"
    if codes:
        code = option_text("station_code", next(iter(codes)))
        hint += f"; give {code} if words 42 and 43 of this code name station and height of the "
        hint += f"instrument (codes of the file: {known(codes)})"
    return book.network(hint=hint)


def _read_block(book: FieldBook, block: GsiBlock, name: str) -> None:
    """Note the sight, the station or the point of a block."""
    source, line, words = book.source, block.line, dict[str, str]()
    for index, word in reversed(block.words):
        if index in MAY_BE_MISSING and not text_of(word).strip("-"):
            source.leave_out(line, VALUES_MISSING, f"{text_of(block.words[0][1])} {index}")
        else:
            words[index] = word
    fields = next(f for need, f in BLOCKS if not need or any(block.first(i) for i in need))
    of = read_record(fields, words, source, line, unread=KNOWN_WORDS)
    coordinates, height = [of.pop(axis) for axis in ("east", "north", "up")], of.pop("height", None)
    if fields is not SIGHT_FIELDS:
        book.point(line, name, *coordinates, agree=False)
    if fields is STATION_FIELDS:
        book.begin(line, name, height)
    elif fields is SIGHT_FIELDS:
        if height is not None:
            book.set_height(line, height)
        e, n, u = (math.nan if v is None else v for v in coordinates)
        book.sight(line, name, **of, coordinates=(e, n, u))


READER = Reader("gsi", ((".gsi",)), "Leica GSI-8 or GSI-16", NetworkReader(read_gsi))
