"""Observation file of SNAP (``.dat``): lines, groups and covariances as sets of readings.

Format: LINZ, SNAP help, "SNAP observation file format", and ``snapdata.c`` of the program (BSD-3).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from ...types import Array
from ...units import ANGLE, ARCSEC
from ..numbers import PACKED_DEGREES
from ..source import Field, Problems, TextSource
from .snap_coordinates import dms_angle
from .snap_data_commands import (
    CLASS_ITEMS,
    VECTOR_KINDS,
    DataDefinition,
    SnapDataState,
    SnapErrors,
    data_command,
    only_words,
)
from .snap_lines import parsed_date, records

REJECTED, MISSING = "*", "-"
DEFAULT = "default"
"""Form of the errors of vectors that the commands of the file state."""
SIGNS = {"LT": {"N": 1.0, "S": -1.0}, "LN": {"E": 1.0, "W": -1.0}}
ANGLES = frozenset(("HA", "ZD", "AZ", "PB", "LT", "LN"))
"""Kinds of readings that are angles."""
ERRORS_OF_VECTORS = {"full": 6, "correlation": 6, "diagonal": 3, "enu": 3}
"""Number of values that state the errors of one vector, by ``#gps_error_type``."""
ERRORS_IN_GROUPS = {"full": 0, "correlation": 3, "diagonal": 3, "enu": 3}
"""The same in groups, which a matrix may follow."""


@dataclass(frozen=True)
class SnapReading:
    """One observation of a file."""

    kind: str
    """Two letters: SD, HA …"""
    station: str
    """Code of the station of the instrument; of the point of a point observation."""
    target: str
    """Code of the target; empty for a point observation."""
    instrument_height: float
    """Height of the instrument, metres."""
    target_height: float
    """Height of the target, metres."""
    values: tuple[float, ...]
    """Value in metres or radians, three of vectors."""
    errors: tuple[float, ...] | None
    """Stated standard errors in metres or radians, or what ``error_type`` says; None: defaults."""
    rejected: bool
    """Whether ``*`` rejects it."""
    classes: Mapping[str, str]
    """Values of its classifications by name in small letters."""
    date: datetime | None
    """When it was observed; None: unknown."""
    projection: str
    """Code of the projection of bearings."""
    defaults: SnapErrors
    """Default errors in force."""
    line: int
    """Line of the file."""
    factor: float = 1.0
    """Factor of its standard errors."""
    own_variance: tuple[float, float] = (0.0, 0.0)
    """Variances of plan and height that are added to those of a vector, metres²."""
    joint_variance: tuple[float, float] = (0.0, 0.0)
    """Variances of plan and height that all vectors of its set have in common, metres²."""
    translated: bool = False
    """Whether its set of positions has an unknown translation."""
    ratio: bool = True
    """Whether its group of distances has an unknown scale."""


@dataclass(frozen=True)
class SnapSet:
    """Readings that belong together: of a line, a group of directions, vectors with a matrix."""

    readings: tuple[SnapReading, ...]
    """The readings."""
    source: TextSource
    """The file."""
    error_type: str = DEFAULT
    """Form of the errors of vectors: ``full``, ``correlation``, ``diagonal``, ``enu``, default."""
    matrix: Array | None = None
    """Covariance (``full``) or correlation matrix of a group, (3n, 3n)."""

    @property
    def kind(self) -> str:
        """Kind of its readings."""
        return self.readings[0].kind


@dataclass
class _Group:
    """A group of lines that is being read."""

    line: int
    station: str = ""
    height: float = 0.0
    rejected: bool = False
    readings: list[SnapReading] = field(default_factory=list)


class _Words:
    """Words of a line, taken one by one."""

    def __init__(self, source: TextSource, line: int, words: list[str]) -> None:
        self.source = source
        self.line = line
        self.words = words

    def __len__(self) -> int:
        return len(self.words)

    def peek(self) -> str:
        """Return the next word; empty at the end."""
        return self.words[0] if self.words else ""

    def next(self, what: str) -> Field:
        """Return the next word as a field."""
        return self.source.field(self.line, self.words.pop(0) if self.words else None, what)


class SnapDataFile:
    """Reads one observation file."""

    def __init__(self, path: Path, problems: Problems) -> None:
        """Open the file."""
        self.source = TextSource(path, problems, code_page="cp1252")
        self.state = SnapDataState()
        self.sets: list[SnapSet] = []
        self.group: _Group | None = None
        self._numbers: list[Field] = []
        self._matrix: _Group | None = None

    def read(self) -> list[SnapSet]:
        """Return the sets of readings; what is wrong is noted."""
        lines = records(self.source)
        if next(lines, None) is None:
            self.source.wrong(0, "needs a title in its first line")
        for line, text in lines:
            if text.startswith("#"):
                self._command(line, text[1:])
            elif self._matrix is not None:
                self._numbers += [
                    self.source.field(line, w, "element of the matrix") for w in text.split()
                ]
                self._complete_matrix()
            else:
                self._data(line, text)
        self._end_matrix()
        self._end_group(self.source.last, at_end=False)
        return self.sets

    # -- commands -----------------------------------------------------------------------------

    def _command(self, line: int, text: str) -> None:
        name, _, rest = text.strip().partition(" ")
        name, _, more = name.partition("\t")
        low = name.lower()
        if low == "note":
            return
        self._end_matrix()
        self._end_group(line, at_end=low in ("end_set", "end", ""))
        if low in ("end_set", "end", ""):
            only_words(self.source, line, low, f"{more} {rest}".split(), 0)
            return
        self.state = data_command(self.source, line, low, f"{more} {rest}".strip(), self.state)

    # -- lines of data ------------------------------------------------------------------------

    def _data(self, line: int, text: str) -> None:
        definition = self.state.definition
        if definition is None:
            self.source.wrong(line, "a line of data before its definition; valid: #data first")
            return
        if not definition.kinds:  # its definition is wrong, which is noted there
            return
        rejected = text.startswith(REJECTED)
        words = _Words(self.source, line, text.removeprefix(REJECTED).split())
        before = self.source.problems.count
        station, height = self._station(words, definition)
        if self.source.problems.count > before:
            return
        if definition.grouped and not definition.point:
            if self.group is None or (not definition.needs_end and not len(words)):
                self._end_group(line, at_end=False)
                self.group = _Group(line, station, height, rejected)
                if len(words):
                    self._too_much(words, "the line of a station")
                return
            self.group.readings += self._readings(
                words, definition, self.group.station, station, self.group.height, height,
                rejected or self.group.rejected,
            )  # fmt: skip
            return
        target, target_height = "", 0.0
        if not definition.point:
            target, target_height = self._station(words, definition)
            if self.source.problems.count > before:
                return
        readings = self._readings(
            words, definition, station, target, height, target_height, rejected
        )
        if definition.grouped:
            self.group = self.group or _Group(line)
            self.group.readings += readings
            return
        for reading in readings:
            stated = "enu" if reading.errors else DEFAULT
            self._add(
                SnapSet(
                    (reading,),
                    self.source,
                    self.state.error_type if definition.states_errors else stated,
                )
            )

    def _station(self, words: _Words, definition: DataDefinition) -> tuple[str, float]:
        code = words.next("code of a station").name()
        height = words.next("height above the station").number() if definition.heights else 0.0
        return code, height

    def _too_much(self, words: _Words, what: str) -> None:
        self.source.wrong(
            words.line, f"{what} has {len(words)} words too many, from {words.peek()[:40]!r}"
        )

    def _readings(
        self,
        words: _Words,
        definition: DataDefinition,
        station: str,
        target: str,
        height: float,
        target_height: float,
        rejected: bool,
    ) -> Iterator[SnapReading]:
        before = self.source.problems.count
        out = []
        state = self.state
        for item in definition.leading:
            state = self._dated(words, item, state)
        for kind, items in definition.kinds:
            if words.peek() == MISSING:
                words.next(kind)
                continue
            values: tuple[float, ...] = ()
            errors: tuple[float, ...] | None = None
            classes = dict(state.classes.get(kind, {}))
            out_rejected = rejected
            own = state
            for item in items:
                if item == "value":
                    starred, values, stated = self._value(words, kind, "error" in items)
                    out_rejected |= starred
                    errors = stated if errors is None else errors
                elif item == "error":
                    errors = self._errors(words, kind, definition.grouped)
                elif item in ("date", "time"):
                    own = self._dated(words, item, own)
                else:
                    classes[CLASS_ITEMS.get(item, item)] = words.next(item).name()
            reading = SnapReading(
                kind,
                station,
                target,
                height,
                target_height,
                values,
                errors,
                out_rejected,
                classes,
                own.date,
                own.projection,
                own.errors,
                words.line,
            )
            out.append(reading)
        if self.source.problems.count == before and len(words):
            self._too_much(words, "the line")
        return iter(out if self.source.problems.count == before else [])

    def _dated(self, words: _Words, item: str, state: SnapDataState) -> SnapDataState:
        """Return the state with the date or time of a line."""
        given = words.next(item)
        text = str(given.value or "")
        if item == "time":
            return state if state.date is None else replace(state, date=_timed(given, state.date))
        found = parsed_date(text)
        if found is None and text.lower() != "unknown":
            given.wrong(f"must be a date such as 2008-01-13, or unknown, not {text[:40]!r}")
        return replace(state, date=found)

    def _value(
        self, words: _Words, kind: str, stated_after: bool
    ) -> tuple[bool, tuple[float, ...], tuple[float, ...] | None]:
        """Return whether ``*`` rejects a reading, its values, and errors behind ``error``."""
        starred = words.peek().startswith(REJECTED)
        if starred:
            rest = words.words.pop(0)[1:]
            if rest:
                words.words.insert(0, rest)
        if kind in VECTOR_KINDS:
            values = tuple(words.next(f"{axis} of {kind}").number() for axis in "XYZ")
        elif kind in ANGLES:
            values = (self._angle(words, kind),)
        else:
            values = (words.next(f"value of {kind}").number(),)
        errors = None
        if not stated_after and words.peek().lower() in ("error", "err"):
            words.next("error")
            if kind in VECTOR_KINDS:
                errors = tuple(words.next(f"error of {kind}").sigma() for _ in "enu")
            else:
                errors = self._errors(words, kind, False)
        return starred, values, errors

    def _angle(self, words: _Words, kind: str) -> float:
        form = self.state.angles
        what = f"angle of {kind}"
        if form == "deg":
            return words.next(what).number(scale=ANGLE["deg"])
        if form == "hp":
            angle = words.next(what).number(PACKED_DEGREES)
        else:
            parts = ("degrees", "minutes", "seconds")
            angle = dms_angle([words.next(f"{p} of {kind}") for p in parts])
        if kind in SIGNS:
            letter = words.next(f"hemisphere of {kind}")
            letter.value = str(letter.value or "").upper()
            sign = letter.choice(SIGNS[kind])
            return math.nan if sign is None else sign * angle
        return angle

    def _errors(self, words: _Words, kind: str, grouped: bool) -> tuple[float, ...]:
        """Return the errors of a reading, metres or radians, or those of a vector as stated."""
        if kind in VECTOR_KINDS:
            numbers = ERRORS_IN_GROUPS if grouped else ERRORS_OF_VECTORS
            size = numbers[self.state.error_type]
            return tuple(words.next(f"error of {kind}").number() for _ in range(size))
        unit = 1.0
        if kind in ANGLES:
            unit = ANGLE["deg"] if self.state.angles == "deg" else ARCSEC
        return (words.next(f"error of {kind}").sigma(scale=unit),)

    # -- sets ---------------------------------------------------------------------------------

    def _add(self, found: SnapSet) -> None:
        if found.readings:
            self.sets.append(found)

    def _end_group(self, line: int, *, at_end: bool) -> None:
        """End a group, which a matrix follows or not."""
        group, self.group = self.group, None
        if group is None:
            return
        definition = self.state.definition
        assert definition is not None
        if definition.needs_end:
            if not at_end:
                self.source.wrong(
                    line, f"the matrix of the group of line {group.line} is missing: #end_set"
                )
                return
            if group.readings:
                self._matrix, self._numbers = group, []
                self._complete_matrix()
            return
        if not definition.vectors:
            for kind in dict.fromkeys(r.kind for r in group.readings):
                self._add(SnapSet(tuple(r for r in group.readings if r.kind == kind), self.source))
            return
        error_type = self.state.error_type if definition.states_errors else DEFAULT
        self._add(SnapSet(tuple(group.readings), self.source, error_type))

    def _complete_matrix(self) -> None:
        """Make a set of a group as soon as its matrix is complete."""
        group = self._matrix
        assert group is not None
        size, full = 3 * len(group.readings), self.state.error_type == "full"
        needed = size * (size + (1 if full else -1)) // 2
        if len(self._numbers) < needed:
            return
        if len(self._numbers) > needed:
            what = f"has {len(self._numbers)} elements, {len(self._numbers) - needed} too many"
            self.source.wrong(group.line, f"the matrix of the group that begins here {what}")
        matrix = np.eye(size)
        rows = np.triu_indices(size, 0 if full else 1) if self.state.upper else None
        lower = np.tril_indices(size, 0 if full else -1) if rows is None else rows
        values = [f.number() for f in self._numbers[:needed]]
        matrix[lower] = values
        matrix[lower[::-1]] = values
        self._add(SnapSet(tuple(group.readings), self.source, self.state.error_type, matrix))
        self._matrix = None

    def _end_matrix(self) -> None:
        """Note a matrix that is not complete."""
        group, self._matrix = self._matrix, None
        if group is not None:
            size = 3 * len(group.readings)
            needed = size * (size + (1 if self.state.error_type == "full" else -1)) // 2
            self.source.wrong(
                group.line,
                f"the matrix of the group that begins here has {len(self._numbers)} elements of "
                f"{needed}",
            )


def _timed(given: Field, day: datetime) -> datetime:
    """Return a date with the time of a field, hh:mm or hh.mm."""
    hour, _, minute = str(given.value or "").replace(".", ":").partition(":")
    if hour.isdigit() and minute.isdigit() and int(hour) < 24 and int(minute) < 60:
        return day.replace(hour=int(hour), minute=int(minute))
    given.wrong(f"must be a time hh:mm, not {str(given.value)[:40]!r}")
    return day


def read_data_file(path: Path, problems: Problems) -> list[SnapSet]:
    """Return the sets of readings of an observation file."""
    return SnapDataFile(path, problems).read()
