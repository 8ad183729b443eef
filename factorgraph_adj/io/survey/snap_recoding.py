"""Recoding of stations in SNAP: other codes, between dates, left out or rejected.

Format: LINZ, SNAP help, "The recode command" and "Station recode file".
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field, replace
from datetime import datetime

from ..source import TextSource
from .snap_coordinates import SnapStations
from .snap_lines import found_file, parsed_date
from .snap_selections import JobLine, station_test

LEFT_OUT, REJECTED = "*", "*"
"""New code of a station that is left out, and sign before one whose observations are rejected."""
BEFORE, BETWEEN, AFTER, ALWAYS = range(4)
"""Sorts of dates of statements, in the order in which they count."""
METRES = ("m", "metres")
COLUMNS = ("codefrom", "codeto", "datefrom", "dateto")


@dataclass(frozen=True)
class Recoding:
    """One statement."""

    old: str
    """Code in capital letters; ``*``: every other one."""
    new: str
    """New code as it is written."""
    after: datetime | None = None
    """Date from which it holds."""
    before: datetime | None = None
    """Date until which it holds."""
    errors: tuple[float, float] | None = None
    """Standard deviations, metres, of plan and height of the new station beside the old one; None:
    both have nothing to do with each other."""

    @property
    def dated(self) -> bool:
        """Whether it has a date."""
        return self.after is not None or self.before is not None

    def holds(self, date: datetime | None) -> bool:
        """Return whether it holds for an observation of a date."""
        if not self.dated:
            return True
        if date is None:
            return False
        late = self.after is None or date >= self.after
        return late and (self.before is None or date <= self.before)

    @property
    def order(self) -> tuple[int, float, float]:
        """Return its place: ``before`` by date, ``between``, ``after`` the latest first, others."""
        after, before = (0.0 if d is None else d.timestamp() for d in (self.after, self.before))
        if self.after is None:
            return (ALWAYS, 0.0, 0.0) if self.before is None else (BEFORE, before, 0.0)
        return (AFTER, -after, 0.0) if self.before is None else (BETWEEN, after, before)


@dataclass(frozen=True)
class Colocation:
    """Two stations that are at the same place within standard deviations."""

    code: str
    """Code of the one, in capital letters."""
    other: str
    """Code of the other."""
    errors: tuple[float, float]
    """Standard deviations of plan and height of their difference, metres."""


@dataclass
class Recodings:
    """Statements; the first in their order that holds counts, of equal ones the last stated."""

    by_code: dict[str, list[Recoding]] = field(default_factory=dict)
    """Statements by code in capital letters."""

    def add(self, recoding: Recoding) -> None:
        """Add a statement."""
        stated = self.by_code.setdefault(recoding.old, [])
        for i, other in enumerate(stated):
            if other.order == recoding.order:
                stated[i] = _joined(other, recoding)
                return
        stated.append(recoding)
        stated.sort(key=lambda r: r.order)

    def new_code(self, code: str, date: datetime | None) -> tuple[str, bool]:
        """Return the code of a station of an observation, and whether it is rejected.

        The code is empty where the station is left out.
        """
        stated = self.by_code.get(code.upper()) or self.by_code.get(LEFT_OUT, [])
        chosen = [r for r in stated if r.holds(date)]
        if not chosen:
            return code, False
        new = chosen[0].new
        if new == LEFT_OUT:
            return "", False
        return new.removeprefix(REJECTED), new.startswith(REJECTED)

    # -- statements -------------------------------------------------------------------------------

    def state(
        self,
        at: JobLine,
        waiting: list[tuple[str, JobLine, Callable[[SnapStations], None]]],
    ) -> None:
        """Take a command ``recode``; what needs the stations is put off.

        Args:
            at: the line.
            waiting: gets what is done when the stations are known.
        """
        words = list(at.words)
        errors = self._errors(at, words)
        if len(words) == 2 and words[0].lower() == "file":
            self.read_file(at, words[1])
            return
        if len(words) > 1 and words[0].lower() == "suffix":
            suffix, rest = words[1], words[2:]
            low = [w.lower() for w in rest]
            if "for" not in low:
                at.wrong("recode suffix needs dates, 'for' and a list of stations")
                return
            where = low.index("for")
            dates = self._dates(at, rest[:where])
            if dates is None or dates == (None, None):
                at.wrong("recode suffix needs before, after, or between … and … before 'for'")
                return
            listed = rest[where + 1 :]

            def act(stations: SnapStations) -> None:
                test = station_test(at, listed, stations)
                for code, station in list(stations.by_code.items()):
                    if test(station) and not code.endswith(suffix.upper()):
                        self.add(Recoding(code, station.code + suffix, *dates, errors))
                        with_station(stations, station.code + suffix, code)

            waiting.append(("recode", at, act))
            return
        if len(words) < 3 or words[1].lower() != "to":
            at.wrong("recode must be CODE to NEW, suffix SUFFIX … for STATIONS, or file FILE")
            return
        stated = self._dates(at, words[3:])
        if stated is not None:
            recoding = Recoding(words[0].upper(), words[2], *stated, errors)

            def add(stations: SnapStations) -> None:
                self._refuse_twice(at, recoding)
                self.add(recoding)
                if recoding.new != LEFT_OUT:
                    # Lists of stations behind this line know the new code.
                    with_station(stations, recoding.new.removeprefix(REJECTED), recoding.old)

            waiting.append(("recode", at, add))

    def _refuse_twice(self, at: JobLine, recoding: Recoding) -> None:
        """Refuse a new code that stands for two dates, each before or after which it holds."""
        ends = (BEFORE, AFTER)
        for other in self.by_code.get(recoding.old, []):
            same = other.new.upper() == recoding.new.upper() and other.order != recoding.order
            if same and other.order[0] in ends and recoding.order[0] in ends:
                at.wrong(f"recode of {recoding.old} to {recoding.new} holds from two dates")

    def _errors(self, at: JobLine, words: list[str]) -> tuple[float, float] | None:
        """Take ``hv_error H [V] m`` or ``disconnected`` out of the words of a statement."""
        low = [w.lower() for w in words]
        if "disconnected" in low:
            del words[low.index("disconnected")]
            return None
        if "hv_error" not in low:
            return None
        where = low.index("hv_error")
        end = next((i for i in range(where, len(low)) if low[i] in METRES), 0)
        given = words[where + 1 : end]
        if len(given) not in (1, 2):
            at.wrong("recode: hv_error needs one or two values and m, such as hv_error 0.1 0.3 m")
            return None
        values = [at.source.field(at.line, v, "hv_error").sigma() for v in given]
        del words[where : end + 1]
        if not {"before", "after"} & {w.lower() for w in words}:
            at.wrong("recode: hv_error needs a date: before or after")
        return values[0], values[-1]

    def colocations(self, observed: Collection[str]) -> list[Colocation]:
        """Return which stations are at one place: errors of the steps between add up in squares.

        Args:
            observed: codes, in capital letters, of the stations that observations concern.
        """
        out: list[Colocation] = []
        for old, stated in self.by_code.items():
            last = sorted((r for r in stated if r.order[0] == BEFORE), key=lambda r: r.order)
            later = sorted((r for r in stated if r.order[0] == AFTER), key=lambda r: -r.order[1])
            out += _chain(old, last, observed, reverse=True)
            out += _chain(old, later, observed, reverse=False)
        return out

    def _dates(
        self, at: JobLine, words: list[str]
    ) -> tuple[datetime | None, datetime | None] | None:
        """Return the dates after and before which a statement holds; None after a problem."""
        if not words:
            return None, None
        sort, *rest = words
        low = sort.lower()
        texts = [w for w in rest if w.lower() != "and"]
        if low in ("before", "after"):
            texts = [" ".join(texts)]
        found = [parsed_date(t) for t in texts]
        if low not in ("before", "after", "between") or None in found or not found:
            at.wrong(
                f"recode: {' '.join(words)[:40]!r} are no dates; valid: before 2008-01-13, after "
                "2008-01-13, between 2008-01-13 and 2009-01-13"
            )
            return None
        if low == "between":
            if len(found) != 2:
                at.wrong("recode: between needs two dates with 'and'")
                return None
            return found[0], found[1]
        return (None, found[0]) if low == "before" else (found[0], None)

    def read_file(self, at: JobLine, name: str) -> None:
        """Read a recode file: columns codefrom, codeto, datefrom, dateto."""
        path = found_file(at.folder, name, ".csv")
        if path is None:
            at.wrong(f"the recode file {name!r} is not there")
            return
        source = TextSource(path, at.source.problems)
        rows = list(csv.reader(text for _, text in source.numbered()))
        header = [c.strip().lower() for c in rows[0]] if rows else []
        if not set(header) >= set(COLUMNS[:2]) or not set(header) <= set(COLUMNS):
            source.wrong(1, f"must have the columns {', '.join(COLUMNS)}, dates if there are any")
            return
        for line, row in enumerate(rows[1:], start=2):
            if not any(c.strip() for c in row):
                continue
            given = dict(zip(header, row, strict=False))
            if any(c.strip() for c in row[len(header) :]):
                source.wrong(line, f"has {len(row)} fields, and the header {len(header)}")
            old, new = (source.field(line, given.get(c), c).name() for c in COLUMNS[:2])
            dates: list[datetime | None] = []
            for column in COLUMNS[2:]:
                text = given.get(column, "").strip()
                dates.append(parsed_date(text) if text else None)
                if text and dates[-1] is None:
                    source.wrong(line, f"{column} {text[:40]!r} is no date such as 2008-01-13")
            self.add(Recoding(old.upper(), new, dates[0], dates[1]))


def _joined(first: Recoding, second: Recoding) -> Recoding:
    """Return the statement that counts of two for the same dates: the second, larger errors."""
    if first.new.upper() != second.new.upper() or second.errors is None or first.errors is None:
        return second
    largest = [max(pair) for pair in zip(first.errors, second.errors, strict=True)]
    return replace(second, errors=(largest[0], largest[1]))


def _chain(
    old: str, steps: list[Recoding], observed: Collection[str], *, reverse: bool
) -> Iterator[Colocation]:
    """Yield the co-locations of the steps of a station in time, of which some are not observed.

    Before dates the first step comes first and the station itself last; after dates the station
    itself is first. A step without errors ends the chain.
    """
    begin, variances = ("" if reverse else old), (0.0, 0.0)
    for step in steps:
        new = step.new.removeprefix(REJECTED).upper()
        added = (0.0, 0.0) if step.errors is None else step.errors
        if new not in observed:
            connected = step.errors is not None and begin
            begin = begin if connected else ("" if reverse else new)
            variances = _sum(variances, added) if connected else (0.0, 0.0)
            continue
        if reverse:
            if begin:
                yield Colocation(begin, new, _roots(variances))
            begin = new if step.errors is not None else ""
            variances = _sum((0.0, 0.0), added)
            continue
        if step.errors is not None and begin in observed:
            yield Colocation(new, begin, _roots(_sum(variances, added)))
        begin, variances = new, (0.0, 0.0)
    if reverse and begin:
        yield Colocation(begin, old, _roots(variances))


def _sum(variances: tuple[float, float], errors: tuple[float, float]) -> tuple[float, float]:
    return variances[0] + errors[0] ** 2, variances[1] + errors[1] ** 2


def _roots(variances: tuple[float, float]) -> tuple[float, float]:
    return math.sqrt(variances[0]), math.sqrt(variances[1])


def with_station(stations: SnapStations, code: str, old: str) -> None:
    """Add a station with a new code at the place of an old one, if it is not there."""
    own = stations.find(old)
    if own is not None and stations.find(code) is None:
        stations.by_code[code.upper()] = replace(own, code=code)
        stations.recoded.add(code.upper())
