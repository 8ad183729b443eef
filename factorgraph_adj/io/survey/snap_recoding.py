"""Recoding of stations in SNAP: other codes, between dates, left out or rejected.

Format: LINZ, SNAP help, "The recode command" and "Station recode file".
"""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from datetime import datetime

from ..source import TextSource
from .snap_coordinates import SnapStations
from .snap_lines import found_file, parsed_date
from .snap_selections import JobLine, station_test

LEFT_OUT, REJECTED = "*", "*"
"""New code of a station that is left out, and sign before one whose observations are rejected."""
COLUMNS = ("codefrom", "codeto", "datefrom", "dateto")
UNCERTAIN = ("hv_error", "disconnected")


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


@dataclass
class Recodings:
    """Statements in their order; of those that hold the last dated one counts."""

    by_code: dict[str, list[Recoding]] = field(default_factory=dict)
    """Statements by code in capital letters."""

    def add(self, recoding: Recoding) -> None:
        """Add a statement."""
        self.by_code.setdefault(recoding.old, []).append(recoding)

    def new_code(self, code: str, date: datetime | None) -> tuple[str, bool]:
        """Return the code of a station of an observation, and whether it is rejected.

        The code is empty where the station is left out.
        """
        stated = self.by_code.get(code.upper()) or self.by_code.get(LEFT_OUT, [])
        valid = [r for r in stated if r.holds(date)]
        dated = [r for r in valid if r.dated]
        chosen = (dated or valid)[-1:]
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
        if any(w.lower() in UNCERTAIN for w in words):
            at.wrong("recode with an uncertainty (hv_error, disconnected) has no counterpart")
            return
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
                        self.add(Recoding(code, station.code + suffix, *dates))

            waiting.append(("recode", at, act))
            return
        if len(words) < 3 or words[1].lower() != "to":
            at.wrong("recode must be CODE to NEW, suffix SUFFIX … for STATIONS, or file FILE")
            return
        stated = self._dates(at, words[3:])
        if stated is not None:
            old, new = words[0].upper(), words[2]
            self.add(Recoding(old, new, *stated))
            if new != LEFT_OUT:
                # Lists of stations behind this line know the new code.
                place = new.removeprefix(REJECTED)
                waiting.append(("recode", at, lambda s: with_station(s, place, old)))

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


def with_station(stations: SnapStations, code: str, old: str) -> None:
    """Add a station with a new code at the place of an old one, if it is not there."""
    own = stations.find(old)
    if own is not None and stations.find(code) is None:
        stations.by_code[code.upper()] = replace(own, code=code)
