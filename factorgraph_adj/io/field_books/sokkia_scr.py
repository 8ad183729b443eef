"""Reader of the text that Sokkia's SET total stations send: `.scr`, records with check sums.

A record is a line of fields with commas, of which the last is a check sum of two hexadecimal digits
unless the instrument was set to send none. Grammar: the records that GeoEasy reads (src/sokkia.tcl)
and Sokkia's "Two way communication commands" and SET300 manual (chapter 23), which define the
digits of units, of circles and the check sum.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...network.network import Network
from ...units import FOOT, GON
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import NOTES, TextSource
from ..text_files import file_beginning
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import (
    NEEDED,
    RecordField,
    Scales,
    read_angle,
    read_length,
    read_name,
    read_number,
    read_record,
)

SET_LENGTHS = {"0": 1.0, "1": FOOT}
SET_ANGLES: dict[str, float | str] = {"0": PACKED_DEGREES, "1": GON, "2": math.pi / 3200}
SET_ORDERS = {"0": False, "1": True}
"""Whether east is first."""
SET_VERTICAL: dict[str, Callable[[float], float]] = {
    "0": lambda reading: reading,
    "1": lambda reading: (math.pi / 2 - reading) % (2 * math.pi),
    "2": lambda reading: (math.pi / 2 - reading) % (2 * math.pi),
}
"""Zenith reading of a vertical one: from the zenith, or from the horizon, to 360° or ±90°."""
SET_CIRCLES: dict[str, Callable[[float], float]] = {
    "0": lambda reading: reading,
    "1": lambda reading: -reading % (2 * math.pi),
}
"""Clockwise direction of a horizontal reading that grows to the right, or to the left."""
SET_STATUS: tuple[tuple[str, Mapping[str, Any]], ...] = (
    ("unit of distance (0 metres, 1 feet)", SET_LENGTHS),
    ("unit of angles (0 degrees, 1 gon, 2 mil)", SET_ANGLES),
    ("vertical circle (0 from the zenith, 1 and 2 from the horizon)", SET_VERTICAL),
    ("horizontal circle (0 to the right, 1 to the left)", SET_CIRCLES),
)
"""Digits of the status of a record of a point."""


def _read_text(field: Any, scales: Scales) -> None:
    """Pass over a field."""


def _unread(*names: str) -> tuple[RecordField, ...]:
    return tuple(RecordField("", what, _read_text) for what in names)


TILT = tuple(RecordField("", f"tilt {a}", read_number) for a in ("x", "y"))
PLACE = (
    RecordField("first", "first coordinate", read_length, default=NEEDED),
    RecordField("second", "second coordinate", read_length, default=NEEDED),
    RecordField("up", "height", read_length, default=NEEDED),
)
TARGET = (
    *_unread("code"),
    RecordField("target_height", "target height", read_length),
    RecordField("", "ppm", read_number),
)
DISTANCE = RecordField("distance", "slope distance", read_length, default=NEEDED)
CIRCLES = (
    RecordField("vertical", "vertical reading", read_angle, default=NEEDED),
    RecordField("direction", "horizontal reading", read_angle, default=NEEDED),
)
OFFSET = (
    RecordField("", "direction of the prism", read_number),
    RecordField("", "offset", read_length),
)
POINT_RECORDS: dict[str, tuple[tuple[RecordField, ...], ...]] = {
    "Ea": ((*TARGET, DISTANCE, *CIRCLES), (*TARGET, *OFFSET, DISTANCE, *CIRCLES)),
    "Ee": ((*TARGET, *CIRCLES, *TILT),),
    "Ed": ((*TARGET, *PLACE),),
    "Fd": ((*TARGET, *PLACE),),
    "Eh": ((*TARGET, *PLACE, DISTANCE, *CIRCLES),),
}
"""Fields behind point, type and status, by type; a point beside its prism has two more."""
HEIGHT_OF_STATION = RecordField("height", "height of the instrument", read_length)
STATION_FIELDS = (
    *_unread("date"),
    RecordField("station", "station", read_name, default=NEEDED),
    *_unread("code"),
    HEIGHT_OF_STATION,
    *(RecordField("", what, read_number) for what in ("temperature", "pressure")),
    *PLACE,
    *(RecordField(n, n, read_name, default=NEEDED) for n in ("unit of distance",)),
    *_unread("unit of temperature and pressure", "refraction", "prism constant"),
    *_unread("unit of angles", "resolution", "vertical circle", "compensation"),
    *_unread("index of the vertical circle", "index of the horizontal circle"),
    RecordField("order", "order of coordinates", read_name, default=NEEDED),
    *_unread("end of the record"),
)
"""Fields behind the M of a record of a station."""
UNREAD_RECORDS = ("A", "B", "N", "C")
"""Instrument, its settings, notes and codes."""
_CHECK_SUM = re.compile(r"[0-9A-F]{2}")
_RECOGNISED = re.compile(
    rb"M,\d+\.\d+\.\d+,[^,\n]*,[^,\n]*(?:,[-+.\d]*){6},[01],[0-4],[0-2],-?\d+,[0-2],"
    rb"|[^,\n]+,(?:E[aedh]|Fd),[01][0-2][0-2][0-2],[^,\n]*(?:,[-+.\d]*){5}"
)
"""A record of a station up to the unit of angles, or one of a point."""


def read_sokkia_scr(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read the text of a Sokkia SET total station.

    Read are stations (M), sights with or without distance (Ea, Ee), coordinates (Ed, Fd) and both
    (Eh). Units, and what the circles count, stand in the status of each record; angles are packed
    degrees, gon or mil. Coordinates that the instrument computed with a sight (Eh), and those of
    stations other than 0, 0, 0, are approximate values, held where ``fixed`` names them; of several
    the first ones count. Distances of a point beside its prism (offset) have been corrected by the
    instrument. Prism constant and atmosphere are in the distances. Check sums of all records are
    verified; an instrument record that has lost its letter A is known by its sum. Not read:
    instrument, settings, notes and codes (A, B, N, C), the state of the air, tilts.

    Tried on three field books of GeoEasy, of which terrain.scr has coordinates beside the sights.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    reader = _Reader(FieldBook(source, accuracies, fixed))
    for number, line in source.filled():
        reader.read(number, line.strip())
    if reader.without_order:
        what = "coordinates without their order, which stands in the record of a station (M)"
        source.wrong(reader.without_order[0][0], what)
    return reader.book.network()


def records_of_line(book: FieldBook, line: int, text: str) -> None:
    """Note what one record says, see `read_sokkia_scr`; its coordinates have north first."""
    _Reader(book, east_first=False).read(line, text)


def check_sums(text: str) -> tuple[str, str]:
    """Return the check sums of the characters before it: two's complement of the sum, the sum.

    The SET4C sends the former, the SET300 the latter.
    """
    total = sum(text.encode("cp1252", errors="replace"))
    return f"{-total & 0xFF:02X}", f"{total & 0xFF:02X}"


@dataclass
class _Reader:
    book: FieldBook
    east_first: bool | None = None
    """Whether east is first: what the last record of a station says; None: there was none."""
    without_order: list[tuple[int, str, Mapping[str, Any], bool]] = field(default_factory=list)
    """Coordinates before the first record of a station, which has their order."""

    def read(self, line: int, text: str) -> None:
        """Read a record."""
        code, *cells = text.split(",")
        if cells and cells[0] in POINT_RECORDS:  # a point may be named as a record, A or M
            self._point(line, text, code, cells)
        elif code in UNREAD_RECORDS:
            self._instrument_or_note(line, text)
        elif code == "M":
            self._station(line, text, cells)
        elif not code and len(text) > 3 and text[-2:] in check_sums("A" + text[:-2]):
            self.book.source.problems.remarks.append(
                f"the record of the instrument lacks its A in {self.book.source.place(line)}"
            )
        elif len(cells) > 2:
            self._point(line, text, code, cells)
        else:
            what = "is no record: the first field is A, B, C, M or N, or the second Ea to Eh or Fd"
            self.book.source.wrong(line, what)

    def _instrument_or_note(self, line: int, text: str) -> None:
        """Verify the check sum of a record that is not read."""
        before, _, last = text.rpartition(",")
        summed = _CHECK_SUM.fullmatch(last) is not None and before != ""
        if summed:
            self._verify(line, text)
        if text.startswith("N,"):
            note = (before if summed else text).removeprefix("N,").strip()
            self.book.source.leave_out(line, NOTES, note)

    def _verify(self, line: int, text: str) -> None:
        stated, right = text[-2:], check_sums(text[:-2])
        if stated not in right:
            what = f"check sum {stated!r} does not fit the line, whose sum is {right[0]}: a "
            self.book.source.wrong(
                line, f"{what}character is lost, or the line was changed by hand"
            )

    def _without_sum(
        self, line: int, text: str, cells: list[str], sizes: Iterable[int]
    ) -> list[str] | None:
        """Return the fields of a record, whose check sum is verified; None: they are too many."""
        wanted = sorted(sizes)
        if len(cells) in wanted:
            return cells
        if len(cells) - 1 in wanted:
            if _CHECK_SUM.fullmatch(cells[-1]) is None:
                what = f"check sum {cells[-1][:20]!r} must be two digits from 0 to F"
                self.book.source.wrong(line, what)
                return None
            problems = self.book.source.problems.count
            self._verify(line, text)
            return cells[:-1] if self.book.source.problems.count == problems else None
        before = text.count(",") + 1 - len(cells)
        valid = " or ".join(str(n + before) for n in wanted)
        what = f"has {len(cells) + before} fields; valid: {valid}, and a check sum"
        self.book.source.wrong(line, what)
        return None

    def _station(self, line: int, text: str, cells: list[str]) -> None:
        given = self._without_sum(line, text, cells, [len(STATION_FIELDS)])
        if given is None:
            return
        at = next(i for i, f in enumerate(STATION_FIELDS) if f.name == "unit of distance")
        source = self.book.source
        size = source.field(line, given[at], SET_STATUS[0][0]).choice(SET_LENGTHS)
        found = read_record(STATION_FIELDS, given, source, line, Scales(size or math.nan))
        order = "order of coordinates (0 north first, 1 east first)"
        self.east_first = bool(source.field(line, found["order"], order).choice(SET_ORDERS))
        for at, name, stated, agree in self.without_order:
            self._coordinates(at, name, stated, agree=agree)
        self.without_order.clear()
        self._coordinates(line, found["station"], found, agree=False)
        self.book.begin(line, found["station"], found["height"])

    def _coordinates(self, line: int, name: str, found: Mapping[str, Any], *, agree: bool) -> None:
        """Note the coordinates of a point; those that an instrument has before any are 0, 0, 0."""
        first, second, up = (found[n] for n in ("first", "second", "up"))
        if self.east_first is None:
            self.without_order.append((line, name, found, agree))
            return
        if first == second == up == 0.0:
            return
        east, north = (first, second) if self.east_first else (second, first)
        self.book.point(line, name, east, north, up, agree=agree)

    def _point(self, line: int, text: str, point: str, cells: list[str]) -> None:
        source = self.book.source
        kind, status, *rest = cells
        variants = source.field(line, kind, "record").choice(POINT_RECORDS)
        if variants is None:
            return
        after = self._without_sum(line, text, rest, map(len, variants))
        if after is None:
            return
        if len(status) != len(SET_STATUS):
            source.wrong(line, f"status {status[:20]!r} must have 4 digits")
            return
        said: list[Any] = [
            source.field(line, digit, what).choice(table)
            for digit, (what, table) in zip(status, SET_STATUS, strict=True)
        ]
        if None in said:
            return
        size, angle, vertical, circle = said
        fields = next(f for f in variants if len(f) == len(after))
        found = read_record(fields, after, source, line, Scales(size, angle))
        name = source.field(line, point, "point").name()
        if "first" in found:
            self._coordinates(line, name, found, agree=kind == "Fd")
        if "direction" in found:
            self.book.sight(
                line,
                name,
                direction=circle(found["direction"]),
                zenith=vertical(found["vertical"]),
                distance=found.get("distance"),
                target_height=found["target_height"],
            )


def is_sokkia_scr(path: Path) -> bool:
    """Return whether a file has a record of a station or a point of a Sokkia SET."""
    return any(_RECOGNISED.match(row) for row in file_beginning(path).splitlines())


READER = Reader(
    "sokkia-scr",
    (".scr",),
    "text of a Sokkia SET",
    NetworkReader(read_sokkia_scr),
    recognises=is_sokkia_scr,
)
