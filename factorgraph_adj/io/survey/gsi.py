"""Reader of field books of Leica instruments: GSI-8 and GSI-16.

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
from ...units import ANGLE
from ..file_problems import SurveyProblems
from ..text_files import read_text
from .field_book import DEFAULT_ACCURACIES, Accuracies, FieldBook

GSI_WORD_PATTERN = re.compile(r"(\d\d)([0-9?./ ]{4})([+-])(.{1,16})", re.ASCII)
GSI_LENGTHS = {
    "0": (1.0, 1e3),
    "6": (1.0, 1e4),
    "8": (1.0, 1e5),
    "1": (0.3048, 1e3),
    "7": (0.3048, 1e4),
}
"""Metres of the unit, and how many of the last digit make one, by the sixth character; 1 and 7 are
feet. A division gives the float of the decimal number, 151.2 and not 151.20000000000002."""
GSI_ANGLES = {"2": 1e-5 * ANGLE["gon"], "3": 1e-5 * ANGLE["deg"], "5": 1e-4 * math.pi / 3200}
"""Radians of one unit of the last digit; 4 is DDDMMSSs, 5 are mils, 6400 of a circle."""
GSI_DMS = "4"


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

    def number(self, notes: SurveyProblems) -> float:
        """Return length or angle, metres or radians; note a problem and return NaN otherwise."""
        digits = self.data[1:].strip()
        unit, sign = self.info[3], -1.0 if self.data[0] == "-" else 1.0
        if not (digits.isascii() and digits.isdigit()):
            notes.add(self.line, f"word {self.index} has {digits!r}, which is not a number")
            return math.nan
        if self.index in ("21", "22"):
            if unit == GSI_DMS:
                return sign * self._dms(digits.rjust(8, "0"), notes)
            if unit in GSI_ANGLES:
                return sign * int(digits) * GSI_ANGLES[unit]
            valid = "2 gon, 3 degrees, 4 degrees-minutes-seconds, 5 mil"
        else:
            if unit in GSI_LENGTHS:
                metres, parts = GSI_LENGTHS[unit]
                return sign * int(digits) * metres / parts
            valid = "0 mm, 6 1/10 mm, 8 1/100 mm, 1 and 7 feet"
        notes.add(self.line, f"word {self.index} has unit {unit!r}; valid: {valid}")
        return math.nan

    def _dms(self, digits: str, notes: SurveyProblems) -> float:
        degrees, minutes, tenths = int(digits[:-5]), int(digits[-5:-3]), int(digits[-3:])
        if minutes >= 60 or tenths > 600:
            notes.add(self.line, f"word {self.index}: {digits} has 60 or more minutes or seconds")
            return math.nan
        return math.radians(degrees + minutes / 60 + tenths / 36000)


@dataclass
class GsiBlock:
    """The words of a measurement or of a code."""

    line: int
    words: list[GsiWord]

    def first(self, index: str) -> GsiWord | None:
        """Return the first word with an index."""
        return next((w for w in self.words if w.index == index), None)

    @property
    def is_code(self) -> bool:
        """Whether the block is a code."""
        return self.words[0].index == "41"


def gsi_blocks(text: str, notes: SurveyProblems) -> Iterator[GsiBlock]:
    """Iterate over the blocks of a file; what is not GSI is noted as a problem."""
    current: GsiBlock | None = None
    for number, line in enumerate(text.split("\n"), start=1):
        rest = line.strip("\x1a\x00")
        size = 16 if rest.lstrip().startswith("*") else 8
        rest = rest.lstrip().removeprefix("*")
        while rest.strip():
            word, rest = rest[: 7 + size], rest[7 + size :].removeprefix(" ")
            match = GSI_WORD_PATTERN.fullmatch(word)
            if match is None or (rest and len(word) < 7 + size):
                what = f"{word[:24]!r} is not a word of GSI: two digits, four characters, a sign"
                notes.add(number, f"{what} and {size} characters, such as 21.322+16901313")
                break
            found = GsiWord(match[1], match[2], match[3] + match[4], number)
            if current is None or found.index in ("11", "41") or current.line != number:
                if current is not None:
                    yield current
                current = GsiBlock(number, [])
            current.words.append(found)
    if current is not None:
        yield current


BACKSIGHT_WORDS, FORESIGHT_WORDS, INTERMEDIATE_WORDS = (
    ("331", "335"),
    ("332", "336"),
    ("333", "334"),
)
"""Word indices, with the first character of the information, of readings of the staff."""
SINGLE_READING_METHODS = (1, 10)
"""Methods BF and aBF; the others read backsight and foresight twice."""
UNREAD_LEVEL_WORDS = (
    "11",
    "32",
    "33",
    "39",
    "57",
    "83",
    "71",
    "72",
    "73",
    "74",
    "75",
    "76",
    "77",
    "78",
    "79",
)
LEVELLING_WORDS = (
    *BACKSIGHT_WORDS,
    *FORESIGHT_WORDS,
    *INTERMEDIATE_WORDS,
    "390",
    "391",
    "392",
    "571",
    "572",
    "573",
    "574",
)


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
        self.method: int | None = None
        self.in_line = False
        self.back: StaffReadings | None = None
        self.fore: StaffReadings | None = None
        self.complete = False
        self.line = 0

    def begin(self, word: GsiWord) -> None:
        """Begin a line; the code ``?......2`` has the method."""
        self.end()
        digits = (word.info + word.data).rpartition("?")[2].strip(".+ ")
        self.method = int(digits) if digits.isascii() and digits.isdigit() else None
        self.in_line, self.back, self.fore, self.complete = True, None, None, False

    def takes(self, block: GsiBlock, name: str) -> bool:
        """Read a block of a line; return whether it is one."""
        indices = [w.index + w.info[0] for w in block.words]
        found = [(i, w) for i, w in zip(indices, block.words, strict=True) if i in LEVELLING_WORDS]
        notes = self.book.notes
        if not found:
            height = block.first("83")
            if not self.in_line or any(block.first(i) for i in ("21", "22", "31")):
                return False
            if height is not None and self.back is None:
                self.book.point(block.line, name, up=height.number(notes), agree=False)
            return True
        for w in block.words:
            if w.index not in UNREAD_LEVEL_WORDS:
                notes.add(w.line, f"word {w.index} cannot stand in a block of a level")
        distance = block.first("32")
        length = 0.0 if distance is None else abs(distance.number(notes))
        for index, w in found:
            if index in (*BACKSIGHT_WORDS, *FORESIGHT_WORDS, *INTERMEDIATE_WORDS):
                self._reading(block.line, index, name, w.number(notes), length)
        return True

    def _reading(self, line: int, index: str, name: str, value: float, length: float) -> None:
        if index in INTERMEDIATE_WORDS:
            if self.back is None:
                self.book.notes.add(line, f"intermediate reading of {name!r} without a backsight")
            else:
                dh = self.back.height - value
                self.book.levelled(line, self.back.point, name, dh, self.back.distance + length)
            return
        if self.complete:
            self.back = self.fore = None
            self.complete = False
        which = "back" if index in BACKSIGHT_WORDS else "fore"
        staff: StaffReadings | None = getattr(self, which)
        if staff is None:
            staff = StaffReadings(name)
            setattr(self, which, staff)
        if staff.point != name:
            what = f"{which}sight of {name!r} in a set-up whose {which}sight is {staff.point!r}"
            self.book.notes.add(line, what)
        staff.readings.append(value)
        staff.distances += [length] if length else []
        self.line = line
        needed = 1 if self.method in (None, *SINGLE_READING_METHODS) else 2
        if (
            self.back
            and self.fore
            and min(len(self.back.readings), len(self.fore.readings)) >= needed
        ):
            length = self.back.distance + self.fore.distance
            dh = self.back.height - self.fore.height
            self.book.levelled(line, self.back.point, self.fore.point, dh, length)
            self.complete = True

    def end(self) -> None:
        """Note a set-up that is not complete at the end of a line."""
        if (self.back is None) != (self.fore is None) and not self.complete:
            there = "back" if self.back else "fore"
            self.book.notes.add(self.line, f"the line ends with a {there}sight alone")
        elif self.back and self.fore and not self.complete:
            self.book.notes.add(
                self.line,
                "the line ends with an incomplete set-up: the method "
                "reads backsight and foresight twice",
            )


OBSERVED_WORDS = ("21", "22", "31", "32")
KNOWN_WORDS = {
    *(f"{i}" for i in range(11, 20)),
    *("21", "22", "31", "32", "33", "87", "88"),
    *(f"{i}" for i in range(41, 50)),
    *(f"{i}" for i in range(51, 60)),
    *(f"{i}" for i in range(70, 80)),
    *(f"{i}" for i in range(81, 87)),
}
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

    Harmless and not read: instrument, date and time (12-19), other codes (41-49), remarks (70-79),
    differences and sums that the level has computed (83 of turning points, 390, 571-574).

    Args:
        path: the file.
        station: name of the only station of a file that names none.
        station_code: code of the blocks that begin a set-up.
        fixed: names of points that are held at the coordinates of the file; none: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = Path(path)
    book = FieldBook(source, accuracies, fixed)
    reader = _Reader(book, None if station_code is None else str(station_code))
    if station is not None:
        book.begin(1, str(station), math.nan)
    for block in gsi_blocks(read_text(source), book.notes):
        reader.read(block)
    reader.levelling.end()
    reader.ask_for_stations()
    return book.network()


class _Reader:
    def __init__(self, book: FieldBook, code: str | None) -> None:
        self.book = book
        self.code = code
        self.levelling = LevelledLine(book)
        self.codes: list[str] = []
        self.without_station: list[int] = []

    def read(self, block: GsiBlock) -> None:
        """Read a block."""
        if block.is_code:
            self._code(block)
            return
        if block.words[0].index != "11":
            what = f"a block must begin with word 11 or 41, not {block.words[0].index}"
            self.book.notes.add(block.line, what)
            return
        name = self.book.notes.name(block.line, block.words[0].text, "word 11, the point,")
        if self.levelling.takes(block, name):
            return
        for w in block.words:
            if w.index not in KNOWN_WORDS:
                what = f"word {w.index} is not known; valid: {known(sorted(KNOWN_WORDS), most=60)}"
                self.book.notes.add(w.line, what)
        if any(block.first(i) for i in OBSERVED_WORDS):
            self._sight(block, name)
        else:
            self._station_or_point(block, name)

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
            self.book.notes.add(block.line, what)
            return
        digits = height.data[1:].strip()
        value = self.book.notes.finite(block.line, digits, "word 43, the height in mm,", 1e-3)
        station = self.book.notes.name(block.line, name.text, "word 42, the station,")
        self.book.begin(block.line, station, value if height.data[0] == "+" else -value)

    def _station_or_point(self, block: GsiBlock, name: str) -> None:
        def of(*indices: str) -> list[float]:
            words = [block.first(i) for i in indices]
            return [math.nan if w is None else w.number(self.book.notes) for w in words]

        station = of("84", "85", "86")
        (height,) = of("88")
        if block.first("88") or any(block.first(i) for i in ("84", "85", "86")):
            self.book.point(block.line, name, *station, agree=False)
            self.book.begin(block.line, name, 0.0 if math.isnan(height) else height)
        else:
            self.book.point(block.line, name, *of("81", "82", "83"))

    def _sight(self, block: GsiBlock, name: str) -> None:
        notes, book = self.book.notes, self.book
        if book.current is None:
            self.without_station.append(block.line)
            return

        def number(index: str) -> float | None:
            word = block.first(index)
            return None if word is None else word.number(notes)

        height = number("88")
        if height is not None and book.current.height != height:
            if math.isnan(book.current.height):
                book.current.height = height
            else:
                what = (
                    f"height of the instrument {height:.3f} m differs from that of the set-up, "
                    f"{book.current.height:.3f} m: a new set-up needs a block of its station"
                )
                notes.add(block.line, what)
                return
        if math.isnan(book.current.height):
            book.current.height = 0.0
        zenith = number("22")
        coordinates = [number(i) for i in ("81", "82", "83")]
        if None not in coordinates:
            book.point(block.line, name, *coordinates, agree=False)  # type: ignore[arg-type]
        book.sight(
            block.line,
            name,
            direction=number("21"),
            zenith=zenith,
            distance=number("31") or None,
            horizontal=number("32") or None,
            target_height=number("87") or 0.0,
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
        self.book.notes.add(first, what)
