"""Levelled lines of field books: readings of staffs become height differences of set-ups."""

from __future__ import annotations

from dataclasses import dataclass, field

from .field_book import FieldBook


@dataclass
class StaffReadings:
    """Readings of one staff, metres."""

    point: str
    heights: list[float] = field(default_factory=list)
    distances: list[float] = field(default_factory=list)

    @property
    def height(self) -> float:
        """Mean of the readings."""
        return sum(self.heights) / len(self.heights)

    @property
    def distance(self) -> float:
        """Mean of the distances; 0 without any."""
        return sum(self.distances) / len(self.distances) if self.distances else 0.0


class LevelledLine:
    """The present line: readings of the set-up that is not noted yet."""

    def __init__(self, book: FieldBook) -> None:
        """Start without a line."""
        self.book = book
        self.source = book.source
        self.in_line = False
        self.needed = 1
        """Number of readings of each staff."""
        self.sights: dict[str, StaffReadings] = {}
        self.order: list[str] = []
        """Staffs of the set-up in the order of their readings."""
        self.noted = False
        """Whether the height difference of the set-up is in the book."""
        self.line = 0

    def begin_line(self, needed: int) -> None:
        """Begin a line.

        Args:
            needed: number of readings of each staff in a set-up, which its method says.
        """
        self.end()
        self.needed, self.in_line = needed, True
        self._begin_setup()

    def reading(self, line: int, sight: str, name: str, value: float, length: float) -> None:
        """Note the reading of a staff.

        Args:
            line: line of the file.
            sight: ``back``, ``fore`` or ``intermediate``.
            name: point of the staff.
            value: reading, metres.
            length: distance of the staff, metres; 0: unknown.
        """
        if sight == "intermediate":
            self._note()
            back = self.sights.get("back")
            if back is None:
                self.source.wrong(line, f"intermediate reading of {name!r} without a backsight")
            else:
                dh = back.height - value
                self.book.levelled(line, back.point, name, dh, back.distance + length)
            return
        if self.is_complete:
            self._note()
            self._begin_setup()
        staff = self.sights.setdefault(sight, StaffReadings(name))
        if staff.point != name:
            what = f"{sight}sight of {name!r} in a set-up whose {sight}sight is {staff.point!r}"
            self.source.wrong(line, what)
        staff.heights.append(value)
        staff.distances += [length] if length else []
        self.order.append(sight)
        self.line = line

    @property
    def is_complete(self) -> bool:
        """Whether the set-up has all readings of both staffs."""
        return len(self.sights) == 2 and all(
            len(s.heights) >= self.needed for s in self.sights.values()
        )

    def note_complete(self) -> None:
        """Note the height difference of the set-up, if it has all readings."""
        self._note()

    def take_back(self, *, setup: bool) -> bool:
        """Take back the last reading, or all of the set-up; return whether there was any."""
        if self.noted or not self.order:
            return False
        if setup:
            self._begin_setup()
            return True
        sight = self.order.pop()
        staff = self.sights[sight]
        staff.heights.pop()
        del staff.distances[len(staff.heights) :]
        if not staff.heights:
            del self.sights[sight]
        return True

    def end(self) -> None:
        """Note the last set-up of a line; one that is not complete is wrong."""
        if self.is_complete:
            self._note()
        elif self.sights:
            what = f"the line ends with a {next(iter(self.sights))}sight alone"
            if len(self.sights) == 2:
                what = "the line ends with an incomplete set-up: the method reads backsight and "
                what += "foresight twice"
            self.source.wrong(self.line, what)

    def _begin_setup(self) -> None:
        self.sights, self.order, self.noted = {}, [], False

    def _note(self) -> None:
        """Note the height difference of a complete set-up once."""
        if self.noted or not self.is_complete:
            return
        back, fore = self.sights["back"], self.sights["fore"]
        length = back.distance + fore.distance
        self.book.levelled(self.line, back.point, fore.point, back.height - fore.height, length)
        self.noted = True
