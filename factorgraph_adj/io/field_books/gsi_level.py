"""Levelled lines in the GSI files of Leica's digital levels.

A code block ``41 ?`` begins a line and says its method: BF and aBF read each staff once (331, 332),
BFFB and aBFFB twice (335, 336). 333 and 334 are intermediate sights from the instrument of the last
backsight. A reading that comes again at once replaces the one before, as the instrument repeats it.

Grammar: Leica Geosystems, GSI ONLINE for TPS and DNA, "Word Indexes of the DNA"; turning points
with the number 0 as JAG3D reads them.
"""

from __future__ import annotations

from ..source import LeftOutReason
from .field_book import FieldBook
from .gsi_words import VALUES_MISSING, GsiBlock, is_missing, leave_out_words, read_gsi_length
from .levelled_line import LevelledLine

STAFF_WORDS = {
    **dict.fromkeys(("331", "335"), "back"),
    **dict.fromkeys(("332", "336"), "fore"),
    **dict.fromkeys(("333", "334"), "intermediate"),
}
"""Sight of a reading of the staff by word index."""
READING_ALONE = "330"
"""Word index of a reading that belongs to no line."""
SECOND_READINGS = ("335", "336")
LEVEL_METHODS = {"1": 1, "2": 2, "3": 1, "4": 2, "10": 0}
"""Number of readings of each staff by method: BF, BFFB, aBF, aBFFB; 10 checks the instrument."""
WORDS_WITHOUT_OBSERVATION = (
    *("35", "374", "390", "391", "392", "531", "538", "560", "561", "562"),
    *("571", "572", "573", "574", "95"),
)
"""Differences, sums, numbers of readings and their spread, correction, time, temperature."""
WORDS_OF_LEVELS = (
    *("11", "12", "13", "17", "18", "19", "32", "83", READING_ALONE, *STAFF_WORDS),
    *(*WORDS_WITHOUT_OBSERVATION, *(str(i) for i in range(71, 80))),
)
"""Word indices that a block of a level has."""
TOTAL_STATION_WORDS = ("21", "22", "31", "81", "82", *(str(i) for i in range(84, 89)))
TYPED = ".1"
"""Fifth characters of a height that was typed: the others were computed."""
TURNING_POINT = "0"
"""Number of the points that the instrument does not name."""
NO_LINE = LeftOutReason("readings of the staff", "they belong to no line")
CHECKS = LeftOutReason("readings of the staff", "they check the instrument")
REPEATED = LeftOutReason("readings of the staff", "they were repeated at once")


class GsiLevel:
    """The present line of a level: names of its turning points, readings that were repeated."""

    def __init__(self, book: FieldBook) -> None:
        """Start without a line."""
        self.source, self.book = book.source, book
        self.line = LevelledLine(book)
        self.method: int | None = None
        """Number of readings of each staff by the method; None: the file states none."""
        self.read: list[str] = []
        """Word indices of the readings of the set-up."""
        self.stated: dict[str, str] = {}
        """Numbers of the points of the set-up as the file has them, by sight."""
        self.names: dict[str, str] = {}
        """Names of these points, by sight."""
        self.turning = ""
        """Name of the turning point on which the next backsight stands."""
        self.turning_points = 0

    def begin(self, line: int, word: str) -> None:
        """Begin a line; the code ``?......2`` has the method."""
        method = word.rpartition("?")[2].strip(".+ ")
        what = "method of levelling (1 BF, 2 BFFB, 3 aBF, 4 aBFFB, 10 check)"
        field = self.source.field(line, method, what)
        self.method = field.choice(LEVEL_METHODS, default=None)
        self.line.begin_line(self.method or 1)
        self._begin_setup()
        self.turning = ""

    def end(self) -> None:
        """Note the last set-up of the last line."""
        self.line.end()

    def takes(self, block: GsiBlock, name: str) -> bool:
        """Read a block of a line; return whether it is one."""
        indices = [index for index, _ in block.words]
        found = [(index, word) for index, word in block.words if index in STAFF_WORDS]
        alone = block.first(READING_ALONE)
        staff = found or alone is not None or any(i in WORDS_WITHOUT_OBSERVATION for i in indices)
        if not staff and (not self.line.in_line or any(i in TOTAL_STATION_WORDS for i in indices)):
            return False
        for index in indices:
            if index not in WORDS_OF_LEVELS:
                self.source.wrong(block.line, f"word {index} cannot stand in a block of a level")
        leave_out_words(
            self.source, block.line, [i for i in indices if i in WORDS_WITHOUT_OBSERVATION]
        )
        if (height := block.first("83")) is not None:
            self._height(block.line, name, height)
        distance = block.first("32")
        length = 0.0 if distance is None else abs(self._length(block.line, "32", distance))
        if alone is not None:
            self._length(block.line, READING_ALONE, alone)
            self.source.leave_out(block.line, NO_LINE, name)
        for index, word in found:
            value = self._length(block.line, index, word)
            if self.method == 0:
                self.source.leave_out(block.line, CHECKS, name)
            elif STAFF_WORDS[index] == "intermediate":
                name = self._new_turning_point() if name == TURNING_POINT else name
                self.line.reading(block.line, "intermediate", name, value, length)
            else:
                self._prepare(block.line, index, name)
                sight = STAFF_WORDS[index]
                self.line.reading(block.line, sight, self.names[sight], value, length)
        return True

    def _height(self, line: int, name: str, word: str) -> None:
        """Note the height of a point if it was typed or begins a line: others are computed."""
        if is_missing(word):
            self.source.leave_out(line, VALUES_MISSING, f"{name} 83")
        elif word[2] in TYPED or not self.read:
            self.book.point(line, name, up=self._length(line, "83", word), agree=False)
        else:
            leave_out_words(self.source, line, ["83"])

    def _length(self, line: int, index: str, word: str) -> float:
        return read_gsi_length(self.source.field(line, word, f"word {index}"))

    # -- set-ups --------------------------------------------------------------------------------

    def _begin_setup(self) -> None:
        self.read, self.stated, self.names = [], {}, {}

    def _prepare(self, line: int, index: str, stated: str) -> None:
        """Begin a set-up with a reading where the last is complete, and name its point."""
        sight, complete = STAFF_WORDS[index], self.line.is_complete
        same = self.stated.get(sight) == stated
        if complete and self.method is None and same and index in SECOND_READINGS:
            # Second readings say that each staff is read twice.
            complete, self.line.needed = index in self.read, 2
        repeated = same and index in self.read and not complete
        if complete and self.read[-1] == index and same and stated != TURNING_POINT:
            repeated = True  # turning points without a number may be others
        whole = bool(self.read) and self.read[-1] != index
        if repeated and self.line.take_back(setup=whole):
            self.source.leave_out(line, REPEATED, self.names[sight])
            self.read = [] if whole else self.read[:-1]
        elif complete:
            self.turning = self.names["fore"] if self.stated["fore"] == TURNING_POINT else ""
            self._begin_setup()
        if sight not in self.names:
            self.stated[sight], self.names[sight] = stated, self._name(line, sight, stated)
        elif not same:
            self.names[sight] = stated  # another point than before, which the line refuses
        self.read.append(index)

    def _name(self, line: int, sight: str, stated: str) -> str:
        """Return the name of a point; turning points have names by their order."""
        if stated != TURNING_POINT:
            return stated
        if sight == "fore":
            return self._new_turning_point()
        if not self.turning:
            what = "backsight of the turning point 0, to which no foresight was read before"
            self.source.wrong(line, what)
        return self.turning

    def _new_turning_point(self) -> str:
        self.turning_points += 1
        return f"{TURNING_POINT}_{self.turning_points}"
