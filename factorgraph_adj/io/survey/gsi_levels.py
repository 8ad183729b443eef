"""Levelled lines in GSI: words 331 to 336 of digital levels."""

from __future__ import annotations

from dataclasses import dataclass, field

from .book import FieldBook
from .gsi_words import Block, Word

BACK, FORE, BETWEEN = ("331", "335"), ("332", "336"), ("333", "334")
"""Word indices, with the first character of the information, of readings of the staff."""
ONE_EACH = (1, 10)
"""Methods BF and aBF; the others read backsight and foresight twice."""
HARMLESS = (
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
LEVELLED = (*BACK, *FORE, *BETWEEN, "390", "391", "392", "571", "572", "573", "574")


@dataclass
class Staff:
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


class Levelling:
    """The present line: readings of the set-up that is not complete."""

    def __init__(self, book: FieldBook) -> None:
        """Start without a line."""
        self.book = book
        self.method: int | None = None
        self.in_line = False
        self.back: Staff | None = None
        self.fore: Staff | None = None
        self.complete = False
        self.line = 0

    def begin(self, word: Word) -> None:
        """Begin a line; the code ``?......2`` has the method."""
        self.end()
        digits = (word.info + word.data).rpartition("?")[2].strip(".+ ")
        self.method = int(digits) if digits.isascii() and digits.isdigit() else None
        self.in_line, self.back, self.fore, self.complete = True, None, None, False

    def takes(self, block: Block, name: str) -> bool:
        """Read a block of a line; return whether it is one."""
        indices = [w.index + w.info[0] for w in block.words]
        found = [(i, w) for i, w in zip(indices, block.words, strict=True) if i in LEVELLED]
        notes = self.book.notes
        if not found:
            height = block.first("83")
            if not self.in_line or any(block.first(i) for i in ("21", "22", "31")):
                return False
            if height is not None and self.back is None:
                self.book.point(block.line, name, up=height.number(notes), agree=False)
            return True
        for w in block.words:
            if w.index not in HARMLESS:
                notes.add(w.line, f"word {w.index} cannot stand in a block of a level")
        distance = block.first("32")
        length = 0.0 if distance is None else abs(distance.number(notes))
        for index, w in found:
            if index in (*BACK, *FORE, *BETWEEN):
                self._reading(block.line, index, name, w.number(notes), length)
        return True

    def _reading(self, line: int, index: str, name: str, value: float, length: float) -> None:
        if index in BETWEEN:
            if self.back is None:
                self.book.notes.add(line, f"intermediate reading of {name!r} without a backsight")
            else:
                dh = self.back.height - value
                self.book.levelled(line, self.back.point, name, dh, self.back.distance + length)
            return
        if self.complete:
            self.back = self.fore = None
            self.complete = False
        which = "back" if index in BACK else "fore"
        staff: Staff | None = getattr(self, which)
        if staff is None:
            staff = Staff(name)
            setattr(self, which, staff)
        if staff.point != name:
            what = f"{which}sight of {name!r} in a set-up whose {which}sight is {staff.point!r}"
            self.book.notes.add(line, what)
        staff.readings.append(value)
        staff.distances += [length] if length else []
        self.line = line
        needed = 1 if self.method in (None, *ONE_EACH) else 2
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
