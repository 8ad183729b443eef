"""Levelled lines in the GSI files of Leica's digital levels.

A code block ``41 ?`` begins a line and says its method: BF and aBF read each staff once (331, 332),
BFFB and aBFFB twice (335, 336). 333 and 334 are intermediate sights from the instrument of the last
backsight. A reading that comes again at once replaces the one before, as the instrument repeats it.

Grammar: Leica Geosystems, GSI ONLINE for TPS and DNA, "Word Indexes of the DNA"; turning points
with the number 0 as JAG3D reads them.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..source import LeftOutReason
from .field_book import FieldBook
from .gsi_words import VALUES_MISSING, GsiBlock, is_missing, leave_out_words, read_gsi_length

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


@dataclass(frozen=True)
class StaffReading:
    """A reading of a staff, metres."""

    stated: str
    """Number of the point as the file has it."""
    point: str
    """Name of the point."""
    height: float
    distance: float
    """Distance of the staff; 0: unknown."""
    line: int


class LevelledLine:
    """The present line: readings of the set-up whose height difference is not noted so far."""

    def __init__(self, book: FieldBook) -> None:
        """Start without a line."""
        self.book = book
        self.source = book.source
        self.in_line = False
        self.needed: int | None = None
        """Number of readings of each staff; None: the file does not state a method."""
        self.readings: dict[str, StaffReading] = {}
        """Readings of the set-up, by word index."""
        self.turning = ""
        """Name of the turning point on which the next backsight stands."""
        self.turning_points = 0

    def begin(self, line: int, word: str) -> None:
        """Begin a line; the code ``?......2`` has the method."""
        self.end()
        method = word.rpartition("?")[2].strip(".+ ")
        field = self.source.field(
            line, method, "method of levelling (1 BF, 2 BFFB, 3 aBF, 4 aBFFB)"
        )
        self.needed = field.choice(LEVEL_METHODS, default=None)
        self.in_line, self.turning = True, ""

    def takes(self, block: GsiBlock, name: str) -> bool:
        """Read a block of a line; return whether it is one."""
        indices = [index for index, _ in block.words]
        found = [(index, word) for index, word in block.words if index in STAFF_WORDS]
        alone = block.first(READING_ALONE)
        staff = found or alone is not None or any(i in WORDS_WITHOUT_OBSERVATION for i in indices)
        if not staff and (not self.in_line or any(i in TOTAL_STATION_WORDS for i in indices)):
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
            if self.needed == 0:
                self.source.leave_out(block.line, CHECKS, name)
            else:
                self._reading(index, StaffReading(name, name, value, length, block.line))
        return True

    def _height(self, line: int, name: str, word: str) -> None:
        """Note the height of a point if it was typed or begins a line: others are computed."""
        if is_missing(word):
            self.source.leave_out(line, VALUES_MISSING, f"{name} 83")
        elif word[2] in TYPED or not self.readings:
            self.book.point(line, name, up=self._length(line, "83", word), agree=False)
        else:
            leave_out_words(self.source, line, ["83"])

    def _length(self, line: int, index: str, word: str) -> float:
        return read_gsi_length(self.source.field(line, word, f"word {index}"))

    # -- set-ups --------------------------------------------------------------------------------

    def _of(self, sight: str) -> list[StaffReading]:
        """Return the readings of a sight of the set-up."""
        return [r for index, r in self.readings.items() if STAFF_WORDS[index] == sight]

    def _is_complete(self) -> bool:
        return all(len(self._of(sight)) >= (self.needed or 1) for sight in ("back", "fore"))

    def _reading(self, index: str, r: StaffReading) -> None:
        """Add a reading to the set-up, or begin the next one with it."""
        sight, before = STAFF_WORDS[index], self.readings.get(index)
        if sight == "intermediate":
            self._intermediate(r)
            return
        last = next(reversed(self.readings), "")
        repeats = before is not None and before.stated == r.stated
        if self._is_complete():
            # Turning points without a name may be others.
            repeats &= index == last and r.stated != TURNING_POINT
            extends = self.needed is None and index in SECOND_READINGS and before is None
            extends &= any(other.stated == r.stated for other in self._of(sight))
            if not repeats and not extends:
                self._note()
                before = None
        if repeats and before is not None:
            self.source.leave_out(before.line, REPEATED, before.point)
            del self.readings[index]
        others = self._of(sight)
        r = self._named(r, sight, others)
        if before is not None and not repeats:
            others = [before]
        if others and others[0].point != r.point:
            what = f"{sight}sight of {r.point!r} in a set-up whose {sight}sight is "
            self.source.wrong(r.line, f"{what}{others[0].point!r}")
        self.readings[index] = r

    def _named(self, r: StaffReading, sight: str, others: list[StaffReading]) -> StaffReading:
        """Return a reading with the name of its point; turning points have names by their order."""
        if r.stated != TURNING_POINT:
            return r
        name = self.turning
        if others:
            name = others[0].point
        elif sight != "back":
            self.turning_points += 1
            name = f"{TURNING_POINT}_{self.turning_points}"
        elif not name:
            what = "backsight of the turning point 0, to which no foresight was read before"
            self.source.wrong(r.line, what)
        return StaffReading(r.stated, name, r.height, r.distance, r.line)

    def _intermediate(self, r: StaffReading) -> None:
        if not (back := self._of("back")):
            what = f"intermediate reading of {r.stated!r} without a backsight"
            self.source.wrong(r.line, what)
            return
        r = self._named(r, "intermediate", [])
        height, distance = _mean(back)
        self.book.levelled(r.line, back[0].point, r.point, height - r.height, distance + r.distance)

    def _note(self) -> None:
        """Note the height difference of the set-up, and begin another one."""
        back, fore = self._of("back"), self._of("fore")
        (of_back, near), (of_fore, far) = _mean(back), _mean(fore)
        line = max(r.line for r in self.readings.values())
        self.book.levelled(line, back[0].point, fore[0].point, of_back - of_fore, near + far)
        self.turning = fore[0].point if fore[0].stated == TURNING_POINT else ""
        self.readings = {}

    def end(self) -> None:
        """Note the last set-up of a line, or that it is not complete."""
        if not self.readings:
            return
        if self._is_complete():
            self._note()
            return
        line = max(r.line for r in self.readings.values())
        sights = {STAFF_WORDS[index] for index in self.readings}
        what = f"the line ends with a {next(iter(sights))}sight alone"
        if len(sights) == 2:
            what = "the line ends with an incomplete set-up: the method reads backsight and "
            what += "foresight twice"
        self.source.wrong(line, what)
        self.readings = {}


def _mean(readings: list[StaffReading]) -> tuple[float, float]:
    """Return the means of readings and of the distances that are known; 0 without any."""
    distances = [r.distance for r in readings if r.distance]
    height = sum(r.height for r in readings) / len(readings)
    return height, sum(distances) / len(distances) if distances else 0.0
