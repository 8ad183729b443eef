"""Records of DynAdjust's files of stations and measurements in fixed columns, version by version.

Grammar: the tables of columns of DynAdjust's reader, include/io/dnaiodnatypes.hpp
(icsm-au/DynAdjust, Apache-2.0).
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..source import Field, Problems, TextSource
from .dynadjust_measurements import GNSS_TYPES, STATION_TYPES
from .dynadjust_records import (
    DirectionRecord,
    MeasurementRecord,
    MemberRecord,
    RecordFile,
    StationRecord,
)

Columns = dict[str, tuple[int, int]]
"""First column, counted from 0, and width of fields by name."""

STATION_COLUMNS: dict[str, Columns] = {
    "1.00": {
        "name": (0, 10), "constraints": (10, 3), "type": (14, 3), "first": (17, 14),
        "second": (31, 14), "third": (45, 14), "zone": (59, 3), "description": (63, 128),
    },
    "3.00": {
        "name": (0, 20), "constraints": (20, 3), "type": (24, 3), "first": (27, 14),
        "second": (41, 14), "third": (55, 14), "zone": (69, 3), "description": (73, 128),
    },
    "3.01": {
        "name": (0, 20), "constraints": (20, 3), "type": (24, 3), "first": (27, 20),
        "second": (47, 20), "third": (67, 20), "zone": (87, 3), "description": (91, 128),
    },
}  # fmt: skip
"""Fields of a station by version."""
MEASUREMENT_COLUMNS: dict[str, Columns] = {
    "1.00": {
        "station": (2, 10), "target": (12, 10), "target2": (22, 10), "length": (32, 14),
        "value": (32, 14), "vcv1": (46, 11), "vcv2": (57, 11), "vcv3": (68, 11),
        "vscale": (32, 14), "pscale": (46, 11), "lscale": (57, 11), "hscale": (68, 11),
        "frame": (79, 10), "epoch": (89, 10), "degrees": (46, 4), "minutes": (50, 4),
        "seconds": (54, 6), "sigma": (60, 9), "instrument": (69, 7), "height": (76, 7),
        "id": (83, 10), "cluster": (93, 10),
    },
    "3.00": {
        "station": (2, 20), "target": (22, 20), "target2": (42, 20), "length": (62, 14),
        "value": (62, 14), "vcv1": (76, 14), "vcv2": (90, 14), "vcv3": (104, 14),
        "vscale": (62, 7), "pscale": (69, 7), "lscale": (76, 7), "hscale": (83, 7),
        "frame": (90, 14), "epoch": (104, 14), "degrees": (76, 4), "minutes": (80, 2),
        "seconds": (82, 8), "sigma": (90, 9), "instrument": (99, 7), "height": (106, 7),
        "id": (118, 10), "cluster": (128, 10),
    },
    "3.01": {
        "station": (2, 20), "target": (22, 20), "target2": (42, 20), "length": (62, 14),
        "value": (62, 20), "vcv1": (82, 20), "vcv2": (102, 20), "vcv3": (122, 20),
        "vscale": (62, 10), "pscale": (72, 10), "lscale": (82, 10), "hscale": (92, 10),
        "frame": (102, 20), "epoch": (122, 20), "degrees": (76, 4), "minutes": (80, 2),
        "seconds": (82, 8), "sigma": (90, 9), "instrument": (99, 7), "height": (106, 7),
        "id": (142, 10), "cluster": (152, 10),
    },
}  # fmt: skip
"""Fields of a line of measurements by version; lines of different types overlap."""
ANGLE = ("degrees", "minutes", "seconds")
SCALES = ("vscale", "pscale", "lscale", "hscale")
COVARIANCE = ("vcv1", "vcv2", "vcv3")
ACCURACY = ("sigma", "instrument", "height")
HEIGHT_TYPES = ("S", "V", "Z")
"""Types whose lines have heights of instrument and target."""
FRAME = ("frame", "epoch")
IDS = ("id", "cluster")
NAMES = {
    "station": "station", "target": "target", "target2": "second target", "length": "value",
    "value": "value", "vcv1": "first covariance", "vcv2": "second covariance",
    "vcv3": "third covariance", "vscale": "scale V", "pscale": "scale P", "lscale": "scale L",
    "hscale": "scale H", "frame": "reference frame", "sigma": "standard deviation",
    "instrument": "height of the instrument", "height": "height of the target",
    "id": "identifier", "cluster": "identifier of the cluster",
}  # fmt: skip
"""Names of fields in messages; others are called by their key."""
HEADER = re.compile(r"!#=DNA\s+(?P<version>\S+)\s+(?P<kind>STN|MSR)\b", re.IGNORECASE)
STATION_LINE = re.compile(
    r"\S.{9}[CF]{3} (?:LLH|LLh|XYZ|UTM|ENU)[ \d.-]{14}[ \d.-]{14}[ \d.-]{1,14}"
)
"""A station of a file without header, which is of version 1.00."""
MAX_MEMBERS = 20_000
"""Largest number of members of a cluster that a line may announce."""
FRAME_COLUMNS, EPOCH_COLUMNS = slice(29, 43), slice(43, 57)
"""Columns of the header."""


def dynadjust_records(path: Path, problems: Problems, *, driver: bool = False) -> RecordFile:
    """Return the records of a file of stations or of measurements.

    Args:
        path: the file.
        problems: those of all files.
        driver: whether measurements have stations alone.

    Raises:
        InputError: the file cannot be read.
    """
    source = TextSource(path, problems)
    head = source.lines[0]
    found = HEADER.match(head)
    if found:
        kind = found["kind"].upper()
    else:
        kind = "STN" if has_stations(source.lines) else path.suffix[1:].upper()
    version = found["version"] if found else "1.00"
    if head.startswith("!#=DNA") and not found:
        source.wrong(1, "the header must be !#=DNA, a version, and STN or MSR")
    if kind not in ("STN", "MSR"):
        source.wrong(1, "must begin with !#=DNA, a version, and STN or MSR, or have such a suffix")
        return RecordFile(source, "", (), ())
    if source.field(1, version, "version").choice(dict.fromkeys(STATION_COLUMNS, True)) is None:
        return RecordFile(source, "", (), ())
    frame = head[FRAME_COLUMNS].strip() if found and version != "1.00" else ""
    epoch = head[EPOCH_COLUMNS].strip() if found and version != "1.00" else ""
    first = 2 if found else 1
    if kind == "STN":
        return RecordFile(source, frame, tuple(_stations(source, version, first)), ())
    lines = _Lines(source, version, frame, epoch, driver=driver)
    return RecordFile(source, frame, (), tuple(lines.measurements(first)))


def has_stations(lines: Sequence[str]) -> bool:
    """Return whether lines without a header are stations of version 1.00."""
    rows = [t for t in lines if t.strip() and not t.startswith("*")]
    return bool(rows) and all(STATION_LINE.match(t) for t in rows)


def _stations(source: TextSource, version: str, first: int) -> Iterator[StationRecord]:
    columns = STATION_COLUMNS[version]
    for line, text in source.filled():
        if line < first or text.startswith("*"):
            continue
        _refuse_between(source, line, text, [columns[c] for c in columns])
        name, constraints, kind, *xyz, zone = (
            source.field(line, text[begin : begin + width], what)
            for what, (begin, width) in columns.items()
            if what != "description"
        )
        coordinates = _named(xyz, str(kind.value))
        yield StationRecord(source, line, name, constraints, kind, coordinates, zone)


def _named(fields: list[Field], kind: str) -> tuple[Field, Field, Field]:
    """Return the coordinates of a station under their own names."""
    names = {"XYZ": ("X", "Y", "Z"), "UTM": ("easting", "northing", "height")}
    for field, what in zip(
        fields, names.get(kind, ("latitude", "longitude", "height")), strict=True
    ):
        field.what = what
    return (fields[0], fields[1], fields[2])


def _refuse_between(
    source: TextSource, line: int, text: str, used: list[tuple[int, int]], begin: int = 0
) -> None:
    """Note text of a line that is in none of the columns of its fields."""
    rest = list(text)
    for first, width in used:
        rest[first : first + width] = " " * len(rest[first : first + width])
    words = "".join(rest)[begin:].split()
    if words:
        column = "".join(rest).index(words[0], begin) + 1
        what = f"{words[0][:40]!r} stands outside of the columns of the record, at column {column}"
        source.wrong(line, what)


class _Lines:
    """The lines of a file of measurements."""

    def __init__(
        self, source: TextSource, version: str, frame: str, epoch: str, *, driver: bool
    ) -> None:
        """Take the file and what its header states."""
        self.source = source
        self.columns = MEASUREMENT_COLUMNS[version]
        self.frame = frame
        self.epoch = epoch
        self.driver = driver
        begin = self.columns["sigma"][0]
        # Version 3.01 alone has an epoch beside heights; in others it overlaps them.
        apart = self.columns["epoch"][0] >= sum(self.columns["height"])
        self.last = ("epoch",) if apart else ()
        """Fields of sights after their heights."""
        end = self.columns["epoch" if apart else "id"][0]
        self.accuracy = (begin, end - begin)
        """Columns from the standard deviation to the heights."""
        self.at = 1
        """Number of the next line."""

    def measurements(self, first: int) -> Iterator[MeasurementRecord]:
        """Yield the measurements from a line on."""
        self.at = first
        while self.at <= len(self.source.lines):
            line, text = self.at, self.source.lines[self.at - 1]
            self.at += 1
            if text.strip() and not text.startswith("*"):
                yield self._measurement(line, text)

    def _field(self, line: int, name: str, what: str = "") -> Field:
        """Return a field of a line; an absent one after the end of the file."""
        text = self.source.lines[line - 1] if line <= len(self.source.lines) else ""
        begin, width = self.columns[name]
        return self.source.field(line, text[begin : begin + width], what or NAMES.get(name, name))

    def _angle(self, line: int) -> Field:
        """Return the field of an angle in packed degrees."""
        degrees, minutes, seconds = (str(self._field(line, n).value) for n in ANGLE)
        return self.source.field(line, packed(degrees, minutes, seconds), "value")

    def _accuracy(self, line: int) -> tuple[Field, Field, Field]:
        """Return standard deviation and heights of instrument and target.

        Files of DynAdjust itself have the heights a column beside theirs, which cuts a number:
        three numbers are taken in their order, fewer by their columns.
        """
        text, words = self.source.lines[line - 1], self._words(line)
        if len(words) == len(ACCURACY):
            pairs = zip(words, ACCURACY, strict=True)
            found = [self.source.field(line, w, NAMES[n]) for w, n in pairs]
            return found[0], found[1], found[2]
        for name in ACCURACY[1:]:
            edge = self.columns[name][0]
            if len(text) > edge and text[edge - 1 : edge + 1].strip() == text[edge - 1 : edge + 1]:
                self.source.wrong(line, f"a number goes on beyond column {edge}, where it must end")
        sigma, instrument, target = (self._field(line, n) for n in ACCURACY)
        return sigma, instrument, target

    def _words(self, line: int) -> list[str]:
        """Return the words from the standard deviation to the heights."""
        begin, width = self.accuracy
        return self.source.lines[line - 1][begin : begin + width].split()

    def _check(self, line: int, *used: str, area: tuple[int, int] = (0, 0)) -> None:
        """Note text outside of the columns of some fields, of an area, of type and switch."""
        text = self.source.lines[line - 1]
        columns = [(0, 2), area, *(self.columns[n] for n in used)]
        end = max(map(sum, columns))
        ids = [n for n in IDS if self.columns[n][0] >= end]  # in version 1.00 others overlap them
        _refuse_between(self.source, line, text, [*columns, *(self.columns[n] for n in ids)])
        for name in ids:
            self._field(line, name).integer(default=0)

    def _measurement(self, line: int, text: str) -> MeasurementRecord:
        kind = text[:1].upper()
        ignored = self._ignored(line)
        stations = ["station", "target", "target2"]
        count = 1 if kind in STATION_TYPES else 3 if kind == "A" else 2
        total = self.source.field(line, None, "number")
        members: tuple[MemberRecord, ...] = ()
        directions: tuple[DirectionRecord, ...] = ()
        coordinates = self.source.field(line, None, "type of the coordinates")
        angular = kind in "ABDKVZ"
        value = self._angle(line) if angular else self._field(line, "length")
        if kind in GNSS_TYPES:
            if kind == "Y":
                coordinates = self._field(line, "target", "type of the coordinates")
            if kind != "G":
                total = self._field(line, "target2", "number of members")
            self._check(line, *stations, *SCALES, *FRAME)
            members = tuple(self._members(line, kind, total))
        elif kind == "D":
            total = self._field(line, "target2", "number of further directions")
            self._check(line, *stations, *ANGLE, "sigma", *self.last)
            directions = tuple(self._directions(line, total))
        else:
            used = [*stations[:count], *self.last, *(ANGLE if angular else ("length",))]
            if kind in HEIGHT_TYPES:
                area = self.accuracy if len(self._words(line)) == len(ACCURACY) else (0, 0)
                self._check(line, *used, *ACCURACY, area=area)
            elif kind.isalpha():
                self._check(line, *used, "sigma")
        absent = self.source.field(line, None, "second target")
        ends = [self._field(line, s) if i < count else absent for i, s in enumerate(stations)]
        sigma, *heights = (
            self._accuracy(line)
            if kind in HEIGHT_TYPES
            else (self._field(line, "sigma"), absent, absent)
        )
        return MeasurementRecord(
            self.source,
            line,
            kind,
            ignored,
            (ends[0], ends[1], ends[2]),
            value,
            sigma,
            (heights[0], heights[1]),
            self._stated(line, "frame", self.frame),
            self._stated(line, "epoch", self.epoch),
            (
                self._field(line, "vscale"),
                self._field(line, "pscale"),
                self._field(line, "lscale"),
                self._field(line, "hscale"),
            ),
            coordinates,
            total,
            members,
            directions,
        )

    def _ignored(self, line: int) -> bool:
        """Return whether the second column switches a line off."""
        mark = self.source.lines[line - 1][1:2]
        if mark not in ("", " ", "*"):
            self.source.wrong(line, f"the second column must be blank or *, not {mark!r}")
        return mark == "*"

    def _stated(self, line: int, name: str, default: str) -> Field:
        field = self._field(line, name)
        if field.is_absent and default:
            return self.source.field(line, default, NAMES.get(name, name))
        return field

    def _next(self, line: int, kind: str, what: str) -> int | None:
        """Return the number of the next line, which continues a record; None after a problem."""
        if self.at > len(self.source.lines) or not self.source.lines[self.at - 1].strip():
            self.source.wrong(line, f"type {kind} ends before {what}")
            return None
        text = self.source.lines[self.at - 1]
        continues = text[:1].strip().upper() in ("", kind) and not text.startswith("*")
        if not continues:
            self.source.wrong(self.at, f"type {kind} of line {line} must go on with {what}")
            return None
        self.at += 1
        return self.at - 1

    def _directions(self, line: int, total: Field) -> Iterator[DirectionRecord]:
        yield self._direction(line, "target")
        for i in range(total.integer(least=1, largest=MAX_MEMBERS) or 0):
            row = self._next(line, "D", f"direction {i + 2}")
            if row is None:
                return
            self._check(row, "target2", *ANGLE, "sigma", *self.last)
            yield self._direction(row, "target2")

    def _direction(self, line: int, target: str) -> DirectionRecord:
        ignored = self._ignored(line) and target == "target2"
        where = self._field(line, target, "target")
        return DirectionRecord(line, ignored, where, self._angle(line), self._field(line, "sigma"))

    def _members(self, line: int, kind: str, total: Field) -> Iterator[MemberRecord]:
        """Yield the members of a cluster: names, lines of values, lines of covariances."""
        number = 1 if kind == "G" else total.integer(least=1, largest=MAX_MEMBERS) or 0
        names = ("station",) if kind == "Y" else ("station", "target")
        row: int | None = line
        for i in range(number):
            if i:
                row = self._next(line, kind, f"member {i + 1} of {number}")
                if row is not None:
                    self._check(row, *names, *(SCALES if self.driver else ()), *FRAME)
            if row is None:
                return
            first = self._field(row, "station")
            second = first if kind == "Y" else self._field(row, "target")
            if self.driver:
                empty = self.source.field(row, None, "value")
                yield MemberRecord(row, first, second, (empty,) * 3, (empty,) * 6, ())
                continue
            rows = [self._matrix_row(line, kind, j, with_value=True) for j in range(3)]
            if any(r is None for r in rows):
                return
            own = [r for r in rows if r is not None]
            crosses = []
            for _ in range(number - 1 - i):
                block = [self._matrix_row(line, kind, 2, with_value=False) for _ in range(3)]
                if any(r is None for r in block):
                    return
                crosses.append(
                    tuple(self._field(r, c) for r in block if r is not None for c in COVARIANCE)
                )
            (x, y, z) = (self._field(r, "value") for r in own)
            yield MemberRecord(
                row,
                first,
                second,
                (x, y, z),
                (
                    self._field(own[0], "vcv1"),
                    self._field(own[1], "vcv1"),
                    self._field(own[2], "vcv1"),
                    self._field(own[1], "vcv2"),
                    self._field(own[2], "vcv2"),
                    self._field(own[2], "vcv3"),
                ),
                tuple(crosses),
            )

    def _matrix_row(self, line: int, kind: str, last: int, *, with_value: bool) -> int | None:
        """Return the number of the next line, which has covariances and perhaps a value.

        Args:
            line: line of the cluster.
            kind: its type.
            last: number of the last covariance, from 0.
            with_value: whether it has a value before.
        """
        row = self._next(line, kind, "a line of its covariance")
        if row is None:
            return None
        if self._field(row, "station").value:
            self.source.wrong(row, f"type {kind} of line {line} must go on with its covariance")
            self.at = row
            return None
        used = (("value",) if with_value else ()) + COVARIANCE[: last + 1]
        self._check(row, *used)
        return row


def packed(degrees: str, minutes: str, seconds: str) -> str:
    """Return degrees, minutes and seconds as packed degrees; the text itself if they are none.

    >>> packed("-0", "56", "33.0467")
    '-0.56330467'
    >>> packed("91", "6x", "33")
    '91 6x 33'
    """
    given = " ".join(filter(None, (degrees, minutes, seconds)))
    whole = re.fullmatch(r"[+-]?\d{1,3}", degrees, re.ASCII)
    part = re.fullmatch(r"(\d{1,2})(?:\.(\d*))?", seconds, re.ASCII)
    if not whole or not re.fullmatch(r"\d{1,2}", minutes, re.ASCII) or not part:
        return given
    return f"{degrees}.{int(minutes):02d}{int(part[1]):02d}{part[2] or ''}"
