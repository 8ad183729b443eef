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
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import known
from ...network.network import Network
from ...units import ANGLE, FOOT
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import Field, LeftOutReason, TextSource
from .field_book import DEFAULT_ACCURACIES, Accuracies, FieldBook
from .field_records import SI, RecordField, Scales, read_record

GSI_WORD_PATTERN = re.compile(r"(\d\d)([0-9?./ ]{4})([+-])(.{1,16})", re.ASCII)
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


@dataclass(frozen=True)
class GsiWord:
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

    @property
    def is_missing(self) -> bool:
        """Whether the value is dashes."""
        return not self.text.strip("-")

    def number(self, field: Field) -> float:
        """Return length or angle, metres or radians; NaN after a problem.

        Args:
            field: the word as a field of its file.
        """
        digits = self.data[1:].strip()
        if not (digits.isascii() and digits.isdigit()):
            field.wrong(f"must be a whole number, not {digits!r}")
            return math.nan
        sign = -1.0 if self.data[0] == "-" else 1.0
        angular = self.index in ("21", "22")
        units = "2 gon, 3 degrees, 4 degrees-minutes-seconds, 5 mil"
        if not angular:
            units = "0 mm, 6 1/10 mm, 8 1/100 mm, 1 and 7 feet"
        unit = Field(self.info[3], f"unit ({units}) of {field.what}", field.where, field.problems)
        if not angular:
            metres, parts = unit.choice(GSI_LENGTHS) or (math.nan, 1.0)
            return sign * int(digits) * metres / parts
        angle = unit.choice(GSI_ANGLES)
        if isinstance(angle, str):
            field.value = f"{digits[:-5]}.{digits[-5:].rjust(5, '0')}"
            return sign * field.number(angle)
        return sign * int(digits) * (angle or math.nan)


@dataclass
class GsiBlock:
    """The words of a measurement or of a code."""

    line: int
    words: list[GsiWord]

    def first(self, index: str) -> GsiWord | None:
        """Return the first word with an index."""
        return next((w for w in self.words if w.index == index), None)


def gsi_blocks(source: TextSource) -> Iterator[GsiBlock]:
    """Iterate over the blocks of a file; what is not GSI is noted as a problem."""
    current: GsiBlock | None = None
    for number, line in source.numbered():
        rest = line.strip("\x1a\x00")
        size = 16 if rest.lstrip().startswith("*") else 8
        rest = rest.lstrip().removeprefix("*")
        while rest.strip():
            word, rest = rest[: 7 + size], rest[7 + size :].removeprefix(" ")
            match = GSI_WORD_PATTERN.fullmatch(word)
            if match is None or (rest and len(word) < 7 + size):
                what = f"{word[:24]!r} is not a word of GSI: two digits, four characters, a sign"
                source.wrong(number, f"{what} and {size} characters, such as 21.322+16901313")
                break
            found = GsiWord(match[1], match[2], match[3] + match[4], number)
            if current is None or found.index in ("11", "41") or current.line != number:
                if current is not None:
                    yield current
                current = GsiBlock(number, [])
            current.words.append(found)
    if current is not None:
        yield current


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


@dataclass
class StaffReadings:
    """Readings of one staff, metres."""

    point: str
    readings: list[float] = field(default_factory=list)
    distances: list[float] = field(default_factory=list)

    @property
    def height(self) -> float:
        """Mean of the readings."""
        return sum(self.readings) / len(self.readings)

    @property
    def distance(self) -> float:
        """Mean of the distances; 0 without any."""
        return sum(self.distances) / len(self.distances) if self.distances else 0.0


class LevelledLine:
    """The present line: readings of the set-up that is not complete."""

    def __init__(self, book: FieldBook) -> None:
        """Start without a line."""
        self.book = book
        self.source = book.source
        self.method: int | None = None
        self.in_line = False
        self.sights: dict[str, StaffReadings] = {}
        self.complete = False
        self.line = 0

    def begin(self, word: GsiWord) -> None:
        """Begin a line; the code ``?......2`` has the method."""
        self.end()
        digits = (word.info + word.data).rpartition("?")[2].strip(".+ ")
        self.method = int(digits) if digits.isascii() and digits.isdigit() else None
        self.in_line, self.sights, self.complete = True, {}, False

    def takes(self, block: GsiBlock, name: str) -> bool:
        """Read a block of a line; return whether it is one."""
        found = [(w.index + w.info[0], w) for w in block.words]
        found = [(index, w) for index, w in found if index in LEVELLING_WORDS]
        if not found:
            height = block.first("83")
            if not self.in_line or any(block.first(i) for i in ("21", "22", "31")):
                return False
            if height is not None and "back" not in self.sights:
                self.book.point(block.line, name, up=self._number(height), agree=False)
            return True
        for w in block.words:
            if w.index not in WORDS_OF_LEVELS:
                self.source.wrong(w.line, f"word {w.index} cannot stand in a block of a level")
        distance = block.first("32")
        length = 0.0 if distance is None else abs(self._number(distance))
        for index, w in found:
            if index in STAFF_WORDS:
                self._reading(block.line, STAFF_WORDS[index], name, self._number(w), length)
        return True

    def _number(self, word: GsiWord) -> float:
        return word.number(self.source.field(word.line, word, f"word {word.index}"))

    def _reading(self, line: int, sight: str, name: str, value: float, length: float) -> None:
        back = self.sights.get("back")
        if sight == "intermediate":
            if back is None:
                self.source.wrong(line, f"intermediate reading of {name!r} without a backsight")
            else:
                dh = back.height - value
                self.book.levelled(line, back.point, name, dh, back.distance + length)
            return
        if self.complete:
            self.sights, self.complete = {}, False
        staff = self.sights.setdefault(sight, StaffReadings(name))
        if staff.point != name:
            what = f"{sight}sight of {name!r} in a set-up whose {sight}sight is {staff.point!r}"
            self.source.wrong(line, what)
        staff.readings.append(value)
        staff.distances += [length] if length else []
        self.line = line
        needed = 1 if self.method in (None, *SINGLE_READING_METHODS) else 2
        if len(self.sights) == 2 and all(len(s.readings) >= needed for s in self.sights.values()):
            back, fore = self.sights["back"], self.sights["fore"]
            length = back.distance + fore.distance
            dh = back.height - fore.height
            self.book.levelled(line, back.point, fore.point, dh, length)
            self.complete = True

    def end(self) -> None:
        """Note a set-up that is not complete at the end of a line."""
        if self.complete or not self.sights:
            return
        what = f"the line ends with a {next(iter(self.sights))}sight alone"
        if len(self.sights) == 2:
            what = "the line ends with an incomplete set-up: the method reads backsight and "
            what += "foresight twice"
        self.source.wrong(self.line, what)


def _value(field: Field, scales: Scales = SI) -> float:
    word = field.value
    assert isinstance(word, GsiWord)
    return word.number(field)


def _field(name: str, index: str, default: float | None = None) -> RecordField:
    return RecordField(name, f"word {index}", _value, index, default)


def _coordinates(*indices: str, default: float | None = None) -> tuple[RecordField, ...]:
    names = ("east", "north", "up")
    return tuple(_field(n, i, default) for n, i in zip(names, indices, strict=True))


POINT_FIELDS = _coordinates("81", "82", "83", default=math.nan)
STATION_FIELDS = (
    *_coordinates("84", "85", "86", default=math.nan),
    _field("instrument_height", "88", 0.0),
)
SIGHT_FIELDS = (
    _field("direction", "21"),
    _field("zenith", "22"),
    _field("distance", "31"),
    _field("horizontal", "32"),
    _field("target_height", "87", 0.0),
    _field("instrument_height", "88"),
    *_coordinates("81", "82", "83"),
)
OBSERVED_WORDS = ("21", "22", "31", "32")
WORDS_OF_STATIONS = ("84", "85", "86", "88")
MAY_BE_MISSING = (*OBSERVED_WORDS, *(str(i) for i in range(81, 87)))
"""Words that may have dashes for a value; without a height of instrument or target there is no
sight."""
KNOWN_WORDS = dict.fromkeys(
    [
        *(str(i) for i in (*range(11, 20), 21, 22, 25, 31, 32, 33, *range(41, 50))),
        *(str(i) for i in (*range(51, 60), *range(70, 80), *range(81, 89))),
    ],
    True,
)
"""Word indices that the reader knows."""


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
    Zeros that fill a name from the left are not part of it. Face 2 is told by a zenith reading
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
        fixed: names of points that are held at the coordinates of the file; none: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(source, accuracies, fixed)
    reader = _Reader(book, None if station_code is None else str(station_code))
    if station is not None:
        book.begin(1, str(station), math.nan)
    for block in gsi_blocks(source):
        reader.read(block)
    reader.levelling.end()
    reader.ask_for_stations()
    return book.network()


class _Reader:
    def __init__(self, book: FieldBook, code: str | None) -> None:
        self.book = book
        self.source = book.source
        self.code = code
        self.levelling = LevelledLine(book)
        self.codes: list[str] = []
        self.without_station: list[int] = []

    def read(self, block: GsiBlock) -> None:
        """Read a block."""
        line, begin = block.line, block.words[0]
        if begin.index == "41":
            self._code(block)
            return
        if begin.index != "11":
            self.source.wrong(line, f"a block must begin with word 11 or 41, not {begin.index}")
            return
        name = self._name(begin, "word 11, the point,")
        if self.levelling.takes(block, name):
            return
        for w in block.words:
            self.source.field(w.line, w.index, "word").choice(KNOWN_WORDS)
        if any(block.first(i) for i in OBSERVED_WORDS):
            self._sight(block, name)
        elif any(block.first(i) for i in WORDS_OF_STATIONS):
            of = self._values(block, STATION_FIELDS)
            self.book.point(line, name, of["east"], of["north"], of["up"], agree=False)
            self.book.begin(line, name, of["instrument_height"])
        else:
            of = self._values(block, POINT_FIELDS)
            self.book.point(line, name, of["east"], of["north"], of["up"])

    def _name(self, word: GsiWord, what: str) -> str:
        return self.source.field(word.line, word.text, what).name()

    def _values(self, block: GsiBlock, fields: tuple[RecordField, ...]) -> dict[str, float]:
        """Return the values of words by names; those of dashes are left out."""
        words = {}
        for w in reversed(block.words):
            if w.is_missing and w.index in MAY_BE_MISSING:
                self.source.leave_out(w.line, VALUES_MISSING, f"{block.words[0].text} {w.index}")
            else:
                words[w.index] = w
        return read_record(fields, words, self.source, block.line)

    def _code(self, block: GsiBlock) -> None:
        if "?" in block.words[0].info + block.words[0].data:
            self.levelling.begin(block.words[0])
            return
        code = block.words[0].text
        self.codes.append(code)
        if self.code is None or code != self.code:
            return
        name, height = block.first("42"), block.first("43")
        if name is None or height is None:
            what = (
                f"code {code} begins a set-up: it needs words 42, the station, and 43, its height"
            )
            self.source.wrong(block.line, what)
            return
        of = self.source.field(block.line, height.data[1:], "word 43, the height in mm,")
        value = of.number(scale=1e-3)
        station = self._name(name, "word 42, the station,")
        self.book.begin(block.line, station, value if height.data[0] == "+" else -value)

    def _sight(self, block: GsiBlock, name: str) -> None:
        at, line = self.book.current, block.line
        if at is None:
            self.without_station.append(line)
            return
        of = self._values(block, SIGHT_FIELDS)
        height = of["instrument_height"]
        if math.isnan(at.height):
            at.height = 0.0 if height is None else height
        elif height is not None and at.height != height:
            what = f"height of the instrument {height:.3f} m differs from that of the set-up, "
            what += f"{at.height:.3f} m: a new set-up needs a block of its station"
            self.source.wrong(line, what)
            return
        coordinates = [of[axis] for axis in ("east", "north", "up")]
        if None not in coordinates:
            self.book.point(line, name, *coordinates, agree=False)
        self.book.sight(
            line,
            name,
            direction=of["direction"],
            zenith=of["zenith"],
            distance=of["distance"] or None,
            horizontal=of["horizontal"] or None,
            target_height=of["target_height"],
        )

    def ask_for_stations(self) -> None:
        """Note that readings have no station, and how to name it."""
        if not self.without_station:
            return
        first, n = self.without_station[0], len(self.without_station)
        what = f"{n} sights from here have no station: no block before has words 84-86 or 88"
        if self.codes:
            codes = known(dict.fromkeys(self.codes))
            what += (
                f"; state station_code if words 42 and 43 of a code name station and height of the "
                f"instrument (codes of the file: {codes}), or station, the only one"
            )
        else:
            what += "; state station, the name of the only one"
        self.source.wrong(first, what)


READER = Reader("gsi", (".gsi", ".GSI"), "Leica GSI-8 or GSI-16", NetworkReader(read_gsi))
