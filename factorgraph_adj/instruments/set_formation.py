"""Sets of sights in two faces, formed while they come, and their observations.

Readings of a set-up are gathered and reduced by a `FieldBook`, as those of a file are: the same
rounds, means of faces, index and collimation errors, doubts and standard deviations. A target that
is read again in a face begins another round, ``readings`` rounds are one pass, and each round of a
pass is posted as a set of its own when the pass ends, which is

- when each of ``targets`` was read in all faces of all its rounds;
- when its first sight is repeated once more, or more than half of its targets are read once more:
  the next pass has begun, and what this one lacks does not come, such as the second face of a prism
  that was hidden;
- when nothing was read for ``set_pause``, the instrument moves to another station, or its lines
  end.

With ``post = "sights"`` each sight is reduced and posted alone, with the orientation unknown of its
set-up.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem
from ..io.field_books.field_book import FieldBook
from ..io.source import Source
from ..observations import Observation
from .instrument_settings import InstrumentSettings
from .message_rules import iso
from .readings import ReceivedLine, Sight


@dataclass
class ReadingSet:
    """Lines of a set, and when they were measured."""

    first: float
    """Measurement of its first sight, seconds since 1970 UTC."""
    stamped: float | None
    """The same by the clock of the instrument, which lines that come again have too; None: the
    line has no time."""
    last: float
    """Measurement of its last sight."""
    lines: list[ReceivedLine] = field(default_factory=list)
    faces: dict[str, int] = field(default_factory=dict)
    """Number of sights by target."""
    first_sight: tuple[str, int] = ("", 0)
    """Target and face of its first sight."""


@dataclass(frozen=True)
class FormedSet:
    """The observations of a set."""

    observations: tuple[Observation, ...]
    doubts: tuple[Problem, ...]
    """Targets whose faces do not agree."""
    of: ReadingSet
    period: tuple[float, float]
    """First and last sight of its pass, seconds since 1970 UTC; the pass after it begins later."""
    round: int
    """Number of its round in the pass, from 1."""

    @property
    def time(self) -> float:
        """The middle of the measurements, seconds since 1970 UTC."""
        return 0.5 * (self.of.first + self.of.last)


class SetFormation:
    """The present set-up of an instrument, and its sets that are not complete."""

    def __init__(self, settings: InstrumentSettings) -> None:
        """Start on the station of the mapping, if it states one."""
        self.settings = settings
        self.station = settings.station
        self.height = settings.instrument_height
        self.since: float | None = None
        """First sight of the set-up, which names its sets where each sight is posted alone."""
        self.sets: dict[int, ReadingSet] = {}
        """Open sets by number of their round."""
        self._base = 0
        """Number of the first round of the present pass."""
        self._book: FieldBook | None = None

    def occupy(self, station: str, height: float | None) -> Iterator[FormedSet]:
        """Move to a station; yield the sets of the station before."""
        yield from self.finish()
        if height is None and station == self.station:
            height = self.height
        elif height is None:
            height = self.settings.instrument_height
        self.station, self.height, self._book, self.since = station, height, None, None
        self._base = 0

    def set_height(self, height: float) -> None:
        """Give the height of the instrument.

        Raises:
            InputError: it changes within the set-up.
        """
        self._begun_book()
        self._book_of_set_up().set_height(0, height)
        self._raise()
        self.height = height

    def sight(self, line: ReceivedLine, sight: Sight, time: float) -> Iterator[FormedSet]:
        """Take a sight; yield the sets that it completes.

        Args:
            line: its line.
            sight: with the names of the network, and its corrected distance.
            time: of the measurement.

        Raises:
            InputError: its readings are not valid, or it has no station.
        """
        if self.sets and time - max(s.last for s in self.sets.values()) > self.settings.set_pause:
            yield from self.finish()
        self._begun_book()
        if self.since is None:
            self.since = time if sight.stamped is None else sight.stamped
        of_sight: dict[str, Any] = {
            n: getattr(sight, n)
            for n in ("direction", "zenith", "distance", "horizontal", "target_height", "face")
        }
        book = self._book_of_set_up()
        number = book.sight(line.number, sight.target, **of_sight)
        try:
            self._raise()
        except InputError:
            self._forget()
            raise
        if number is None:
            number = max(self.sets, default=book.current.taken if book.current else 0)
        face = sight.face or (2 if sight.zenith is not None and sight.zenith > math.pi else 1)
        aimed = (sight.target, face)
        of = self.sets.get(number)
        if of is None:
            of = ReadingSet(time, sight.stamped, time, first_sight=aimed)
            self.sets[number] = of
        of.last = max(of.last, time)
        if not of.lines or of.lines[-1] is not line:
            of.lines.append(line)
        of.faces[sight.target] = of.faces.get(sight.target, 0) + 1
        while self.sets and self._has_ended(number, aimed):
            yield from self._take_pass()

    def pause(self, now: float) -> Iterator[FormedSet]:
        """Yield the sets that a pause ends; ``now``: seconds since 1970 UTC."""
        # Receipts: the clock of the instrument may be another, and its lines may be late.
        received = [s.lines[-1].received for s in self.sets.values()]
        if received and now - max(received) > self.settings.set_pause:
            yield from self.finish()

    def finish(self) -> Iterator[FormedSet]:
        """Yield all sets that are open."""
        while self.sets:
            self._base += (
                (min(self.sets) - self._base) // self.settings.readings * (self.settings.readings)
            )
            yield from self._take_pass()

    # -- rounds -----------------------------------------------------------------------------------

    def _book_of_set_up(self) -> FieldBook:
        assert self._book is not None
        return self._book

    def _begun_book(self) -> None:
        """Begin the book of the set-up."""
        if self.station is None:
            raise InputError(
                "no line before it states the station: give station = NAME in [[instrument]]"
            )
        if self._book is None:
            source = Source(Path(self.settings.name))
            self._book = FieldBook(source, self.settings.accuracies)
            self._book.begin(0, self.station, self.height)

    def _raise(self) -> None:
        """Raise what the book has noted."""
        problems = self._book_of_set_up().source.problems
        found = [Problem(p.what) for p in problems.ordered()]
        if found:
            problems.problems.clear()
            raise InputError(found)

    def _forget(self) -> None:
        """Begin another book after a problem if it has no readings of open sets."""
        if not self.sets:
            self._book, self._base = None, 0

    @property
    def _pass(self) -> range:
        """Numbers of the rounds of the present pass."""
        return range(self._base, self._base + self.settings.readings)

    def _has_ended(self, number: int, aimed: tuple[str, int]) -> bool:
        """Return whether nothing more belongs to the present pass.

        Args:
            number: round of the last sight.
            aimed: its target and face.
        """
        if self.settings.post == "sights":
            return True
        of_pass = [self.sets[n] for n in self._pass if n in self.sets]
        targets = {t for s in of_pass for t in s.faces}
        again = {t for n, s in self.sets.items() if n not in self._pass for t in s.faces}
        if number not in self._pass and of_pass and aimed == of_pass[0].first_sight:
            return True
        if 2 * len(again) > len(targets):
            return True
        stated, faces = self.settings.targets, self.settings.faces
        whole = len(of_pass) == self.settings.readings
        return (
            whole
            and bool(stated)
            and all(s.faces.get(t, 0) >= faces for s in of_pass for t in stated)
        )

    def _take_pass(self) -> Iterator[FormedSet]:
        """Yield the sets of the present pass, and begin the next one."""
        base = self._base
        taken = {n: self.sets[n] for n in self._pass if n in self.sets}
        self._base += self.settings.readings
        begin = min((s.first for s in taken.values()), default=0.0)
        next_begin = min(
            (s.first for n, s in self.sets.items() if n not in taken), default=math.inf
        )
        end = min(max((s.last for s in taken.values()), default=0.0), max(begin, next_begin))
        for n in taken:
            yield from self._take(n, (begin, end), n - base + 1)

    def _take(self, number: int, period: tuple[float, float], of_pass: int) -> Iterator[FormedSet]:
        """Yield the observations of a set, and end it with those before.

        Args:
            number: its number.
            period: first and last sight of its pass.
            of_pass: number of its round in the pass.
        """
        of = self.sets.pop(number)
        book = self._book_of_set_up()
        reduced = book.take_set(number)
        others, book.others = book.others, []
        if book.current is not None:
            book.current.horizontals.clear()
        try:
            self._raise()
        finally:
            if not self.sets:
                self._book, self._base = None, 0  # memory does not grow
        found = [*others, *(reduced.observations if reduced is not None else ())]
        begin = of.first if of.stamped is None else of.stamped
        if self.settings.post == "sights" and self.since is not None:
            begin = self.since
        name = f"{self.settings.name} {iso(begin)}"
        if found:
            doubts = reduced.doubts if reduced is not None else ()
            named = tuple(self._named(o, name) for o in found)
            yield FormedSet(named, doubts, of, period, of_pass)

    def _named(self, o: Observation, name: str) -> Observation:
        """Return an observation with its set, and names of the network that are stated."""
        s = self.settings
        stated = {"set": name, "instrument": s.distance_meter, "refraction": s.refraction}
        own = {n: v for n, v in stated.items() if n in o.record.attributes}
        return replace(o, **own, source=None)
