"""Selections of SNAP's jobs: lists of stations, and criteria of observations.

Format: LINZ, SNAP help, "Station lists" and "The reject_observations command".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ...errors import InputError, known
from ...types import Array
from ..source import TextSource
from .snap_coordinates import SnapStation, SnapStations
from .snap_data_commands import KINDS, kind_of
from .snap_lines import found_file, parsed_date, records, unquoted, wildcard_pattern
from .snap_readings import SnapReading
from .snap_systems import read_system

StationTest: TypeAlias = Callable[[SnapStation], bool]
LIST_SUFFIX, POLYGON_SUFFIX = ".stl", ".wkt"
MISSING_WORDS = {"ignore_missing": False, "warn_missing": False, "fail_missing": True}
"""Whether a name that the job does not have is an error, by word."""
TURN = 360.0
"""Degrees of longitude after which a polygon is at the same place."""
OPERATORS = ("and", "or", "except")
_RING = re.compile(r"\(([^()]+)\)")
_DIGITS = re.compile(r"[0-9]+")


@dataclass(frozen=True)
class JobLine:
    """A line of a job, with its file."""

    source: TextSource
    """The file."""
    line: int
    """Number of the line."""
    words: tuple[str, ...]
    """Words behind the command."""

    @property
    def folder(self) -> Path:
        """Folder of the file, from which names of files count."""
        return self.source.path.parent

    def wrong(self, what: str) -> None:
        """Note a problem of the line."""
        self.source.wrong(self.line, what)


def is_code_before(first: str, second: str) -> bool:
    """Return whether a code is the same as another or stands before it in ranges.

    Behind what both begin with, up to a digit, numbers count as such, and letters without case.
    """
    a, b = first.upper(), second.upper()
    same = 0
    while same < min(len(a), len(b)) and a[same] == b[same] and not a[same].isdigit():
        same += 1
    numbers = [_DIGITS.match(code, same) for code in (a, b)]
    if numbers[0] is not None and numbers[1] is not None:
        values = int(numbers[0][0]), int(numbers[1][0])
        if values[0] != values[1]:
            return values[0] < values[1]
    return a[same:] <= b[same:]


def station_test(at: JobLine, words: Sequence[str], stations: SnapStations) -> StationTest:
    """Return the test of a list of stations; what is wrong is noted.

    Args:
        at: the line of the list.
        words: its words.
        stations: stations of the job.
    """
    if words and words[0].lower() in OPERATORS:
        at.wrong(f"a list of stations cannot begin with {words[0]!r}")
    parts: list[list[StationTest]] = [[]]
    excepted: list[list[StationTest]] | None = None
    rest, strict = list(words), True
    while rest:
        word = rest.pop(0)
        low = word.lower()
        current = parts if excepted is None else excepted
        if low in MISSING_WORDS:
            strict = MISSING_WORDS[low]
        elif low == "and":
            current.append([])
        elif low == "except":
            if excepted is not None:
                at.wrong("a list of stations has one 'except' at most")
            excepted = [[]]
        elif low == "all":
            current[-1].append(lambda _: True)
        elif low in ("inside", "outside"):
            if len(rest) < 2:
                at.wrong(f"{low} needs a coordinate system and a file with a polygon")
                return lambda _: False
            current[-1].append(_polygon_test(at, low, rest.pop(0), rest.pop(0), stations))
        elif low != "or":
            current[-1].append(_item_test(at, word, stations, strict))

    def every(groups: list[list[StationTest]], station: SnapStation) -> bool:
        return all(any(test(station) for test in group) for group in groups)

    def chosen(station: SnapStation) -> bool:
        left = excepted is not None and every(excepted, station)
        return every(parts, station) and not left

    return chosen


def _item_test(at: JobLine, word: str, stations: SnapStations, strict: bool) -> StationTest:
    """Return the test of a code, a range, a pattern, a class or a file."""
    if word.startswith("@") and "=" not in word:
        return _file_test(at, word[1:], stations)
    if word.startswith("\\"):
        return _code_test(at, word[1:], stations, strict)
    name, equals, values = word.removeprefix("@").partition("=")
    if equals:
        patterns = [wildcard_pattern(unquoted(v)) for v in unquoted(values).split("/")]
        low = name.lower()
        return lambda s: any(
            p.fullmatch(value) for key, value in s.classes if key == low for p in patterns
        )
    if stations.find(word) is None and "-" in word.strip("-"):
        first, _, last = word.partition("-")
        return lambda s: is_code_before(first, s.code) and is_code_before(s.code, last)
    if "*" in word or "?" in word:
        pattern = wildcard_pattern(word)
        return lambda s: pattern.fullmatch(s.code) is not None
    return _code_test(at, word, stations, strict)


def _code_test(at: JobLine, code: str, stations: SnapStations, strict: bool) -> StationTest:
    if strict and stations.find(code) is None:
        codes = known([s.code for s in stations.by_code.values()], meant=code, most=12)
        at.wrong(f"unknown station {code[:40]!r}; known: {codes}")
    low = code.upper()
    return lambda s: s.code.upper() == low


def _file_test(at: JobLine, name: str, stations: SnapStations) -> StationTest:
    """Return the test of a file, each of whose lines is a list."""
    path = found_file(at.folder, name, LIST_SUFFIX)
    if path is None:
        at.wrong(f"the list of stations {name!r} is not there")
        return lambda _: False
    source = TextSource(path, at.source.problems)
    tests = [
        station_test(JobLine(source, line, tuple(text.split())), text.split(), stations)
        for line, text in records(source)
    ]
    return lambda s: any(test(s) for test in tests)


def _polygon_test(
    at: JobLine, sort: str, code: str, name: str, stations: SnapStations
) -> StationTest:
    """Return the test whether a station is inside or outside of polygons of a file."""
    stated = read_system(at.source.field(at.line, code, "coordinate system"))
    path = found_file(at.folder, name, POLYGON_SUFFIX)
    if path is None:
        at.wrong(f"the polygon {name!r} is not there")
    if stated is None or path is None:
        return lambda _: False
    if stated.system.datum != stations.system.datum or stated.system.form == "geocentric":
        at.wrong(
            f"polygons in {code} are not read: valid are those of the datum of the stations, "
            f"{stations.system.datum}, in latitude and longitude or in a projection"
        )
        return lambda _: False
    source = TextSource(path, at.source.problems)
    rings = []
    for ring in _RING.findall(" ".join(text for _, text in records(source))):
        pairs = [pair.split() for pair in ring.split(",")]
        numbers = [
            [source.field(0, v, "coordinate of the polygon").number() for v in pair[:2]]
            for pair in pairs
            if len(pair) > 1
        ]
        if len(numbers) > 2:
            rings.append(np.array(numbers))
    codes = list(stations.by_code)
    if not codes:
        return lambda _: False
    latitude, longitude, height = stations.geodetic(codes)
    places = np.degrees(np.column_stack([longitude, latitude]))
    if stated.system.form == "projection":
        try:
            system = stated.system.reference_system.checked()
            places = system.from_geodetic(latitude, longitude, 0.0 * height, codes)[:, :2]
        except InputError as error:
            at.wrong(str(error))
            return lambda _: False
    else:
        middle = np.mean(places[:, 0])
        for ring in rings:
            ring[:, 0] -= TURN * np.round((ring[:, 0] - middle) / TURN)
    wanted = sort == "inside"
    chosen = {c for c, p in zip(codes, places, strict=True) if is_inside(p, rings) == wanted}
    return lambda s: s.code.upper() in chosen


def is_inside(place: Array, rings: Sequence[Array]) -> bool:
    """Return whether a ray from a place (2,) crosses rings (n, 2) an odd number of times."""
    crossings = 0
    for ring in rings:
        a, b = ring - place, np.roll(ring, -1, axis=0) - place
        above = (a[:, 1] > 0) != (b[:, 1] > 0)
        rise = np.where(above, b[:, 1] - a[:, 1], 1.0)
        x = a[:, 0] - a[:, 1] * (b[:, 0] - a[:, 0]) / rise
        crossings += int(np.sum(above & (x > 0)))
    return crossings % 2 == 1


@dataclass
class ObservationTest:
    """Criteria of observations, all of which must hold."""

    classes: list[tuple[str, tuple[re.Pattern[str], ...]]] = field(default_factory=list)
    """Classifications with the patterns of their values."""
    files: list[re.Pattern[str]] = field(default_factory=list)
    """Patterns of names of files."""
    before: datetime | None = None
    """Date before which observations were made."""
    after: datetime | None = None
    """Date after which they were made."""
    undated: bool = False
    """Whether their date must be unknown."""
    using: list[frozenset[str]] = field(default_factory=list)
    """Codes of stations, of which each observation has one."""
    between: list[frozenset[str]] = field(default_factory=list)
    """Codes of stations, of which each observation has all of its own."""

    def ends(self, reading: SnapReading) -> tuple[bool, bool]:
        """Return whether the station and the target of a reading are of the chosen stations."""
        stations = [*self.using, *self.between]
        station, target = (
            all(code.upper() in chosen for chosen in stations)
            for code in (reading.station, reading.target)
        )
        return station, target

    def holds(self, reading: SnapReading, file: str) -> bool:
        """Return whether an observation of a file is chosen."""
        own = {**reading.classes, "data_type": reading.kind}
        if any(
            not any(p.fullmatch(own.get(name, "")) for p in patterns)
            for name, patterns in self.classes
        ):
            return False
        plain = file.replace("\\", "/")
        if any(
            p.fullmatch(plain) is None and p.fullmatch(plain.rpartition("/")[2]) is None
            for p in self.files
        ):
            return False
        date = reading.date
        if self.undated and date is not None:
            return False
        if self.before is not None and (date is None or date >= self.before):
            return False
        if self.after is not None and (date is None or date <= self.after):
            return False
        codes = {c.upper() for c in (reading.station, reading.target) if c}
        return all(codes & chosen for chosen in self.using) and all(
            codes <= chosen for chosen in self.between
        )


def observation_test(
    at: JobLine, words: Sequence[str], stations: SnapStations, files: Sequence[str]
) -> ObservationTest:
    """Return the criteria of a line; what is wrong is noted.

    Args:
        at: the line.
        words: words of the criteria.
        stations: stations of the job.
        files: names of the observation files that the job has named.
    """
    out, rest, strict, any_word = ObservationTest(), list(words), True, False
    while rest:
        word = rest.pop(0)
        low = word.lower()
        any_word = True
        if low in MISSING_WORDS:
            strict = MISSING_WORDS[low]
        elif low in ("before", "after"):
            text = rest.pop(0) if rest else ""
            date = parsed_date(unquoted(text))
            if date is None:
                at.wrong(f"{low} needs a date such as 2008-01-13, not {text[:40]!r}")
            elif low == "before":
                out.before = date
            else:
                out.after = date
        elif low == "date_unknown":
            out.undated = True
        elif low in ("using_stations", "between_stations"):
            listed = []
            while rest and rest[0].lower() != "end_stations":
                listed.append(rest.pop(0))
            rest = rest[1:]
            test = station_test(at, listed, stations)
            chosen = frozenset(s.code.upper() for s in stations.by_code.values() if test(s))
            (out.using if low == "using_stations" else out.between).append(chosen)
        elif "=" in word:
            _class_criterion(at, word, out, strict, files)
        elif low != "all_observations":
            valid = "NAME=VALUE, before, after, date_unknown, using_stations, between_stations"
            at.wrong(f"criterion {word[:40]!r} is unknown; valid: {valid}, all_observations")
    if not any_word:
        at.wrong("needs criteria of observations; valid: all_observations, or @NAME=VALUE …")
    return out


def _class_criterion(
    at: JobLine, word: str, out: ObservationTest, strict: bool, files: Sequence[str]
) -> None:
    name, _, text = word.removeprefix("@").partition("=")
    low = name.lower()
    if low == "data_file":
        pattern = wildcard_pattern(unquoted(text).replace("\\", "/"), path=True)
        out.files.append(pattern)
        if strict and not any(
            pattern.fullmatch(f) or pattern.fullmatch(f.rpartition("/")[2]) for f in files
        ):
            valid = known(files, meant=text, most=12)
            at.wrong(f"no data_file before this line is {text[:40]!r}; known: {valid}")
        return
    values = [unquoted(text)] if text[:1] in "\"'" else text.split("/")
    if low == "data_type":
        kinds = [kind_of(v) for v in values]
        if "" in kinds:
            at.wrong(f"data_type must be some of {', '.join(KINDS)}, not {text[:40]!r}")
        values = [k for k in kinds if k]
    out.classes.append((low, tuple(wildcard_pattern(v) for v in values)))
