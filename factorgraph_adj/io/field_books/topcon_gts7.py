"""Reader of Topcon GTS-7 raw files, of TopSURV and the GTS-700, and of South's NTS-350.

A line is a keyword and fields between commas: ``SD      74.39010,87.47000,2.1650``. Sources: the
Topcon Link Reference Manual 7010-0522, appendix C (records, fields, order); head of GeoEasy's
``topcon.tcl`` (records OFFSET, PTL_OFF, MLM); specification and converter of South's files
(thanosa/south-total-station-data-converter). The sources differ on the order of coordinates, which
readings decide.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from ...network.network import Network
from ...units import FOOT, GON
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import DERIVED_OBSERVATIONS, NOTES, LeftOutReason, TextSource
from ..text_files import file_beginning
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import (
    NEEDED,
    RecordField,
    Scales,
    read_angle,
    read_choice,
    read_length,
    read_name,
    read_record,
)

REPEATED_COORDINATES = LeftOutReason(
    "coordinates of stations", "they are those of another station, and were not entered anew"
)
LINE_OFFSETS = LeftOutReason("offsets from a reference line", "they are derived")
BACKSIGHTS_WITHOUT_POINT = LeftOutReason("backsight azimuths", "they name no point")
GTS7_LENGTHS = {"M": 1.0, "F": FOOT}
"""Metres in units of lengths; F is the international foot."""
GTS7_ANGLES: dict[str, float | str] = {"D": PACKED_DEGREES, "G": GON}
POINT = (read_name, "", NEEDED)


def _lengths(*names: str) -> tuple[RecordField, ...]:
    return tuple(RecordField(n, n.replace("_", " "), read_length) for n in names)


def _text(name: str) -> RecordField:
    return RecordField(name, name, lambda field, scales: str(field.value))


DIRECTION = RecordField("direction", "horizontal angle", read_angle, default=NEEDED)
ZENITH = RecordField("zenith", "vertical angle", read_angle, default=NEEDED)
TARGET = (
    RecordField("point", "point", *POINT),
    RecordField("target_height", "target height", read_length),
    _text("code"),
    _text("string"),
)
GTS7_RECORDS = {
    "UNITS": (
        RecordField("length", "unit of lengths (M, F)", read_choice(GTS7_LENGTHS), default=NEEDED),
        RecordField("angle", "unit of angles (D, G)", read_choice(GTS7_ANGLES), default=NEEDED),
    ),
    "STN": (
        RecordField("point", "station", *POINT),
        RecordField("height", "height of the instrument", read_length),
        _text("name"),
    ),
    "XYZ": tuple(
        RecordField(axis, "coordinate", read_length, default=NEEDED) for axis in ("first", "second")
    )
    + _lengths("elevation"),
    "BKB": (
        RecordField("point", "backsight", read_name, default=""),
        RecordField("azimuth", "azimuth of the backsight", read_angle),
        RecordField("circle", "circle reading of the backsight", read_angle),
    ),
    "BS": TARGET,
    "FS": TARGET,
    "SS": TARGET,
    "RES_OBS": TARGET,
    "HV": (DIRECTION, ZENITH),
    "SD": (
        DIRECTION,
        ZENITH,
        RecordField("distance", "slope distance", read_length, default=NEEDED),
    ),
    "HD": (
        DIRECTION,
        RecordField("horizontal", "horizontal distance", read_length, default=NEEDED),
        RecordField("vertical", "vertical distance", read_length),
    ),
    "OFFSET": _lengths("radial_offset", "tangential_offset", "vertical_offset"),
    "PTL_OFF": tuple(_text(n) for n in ("along", "across", "up")),
    "MLM": tuple(_text(n) for n in ("from", "to", "horizontal", "vertical", "slope")),
}
"""Fields of the records that are read."""
UNREAD_RECORDS = {"JOB", "DATE", "NAME", "INST", "SCALE", "ATMOS", "TEMP", "NOTE", "CTL"}
"""Records that are not needed: job, date, person, instrument, scale of computed coordinates,
atmosphere, which is in the distances, note, codes."""
TARGET_RECORDS = ("BS", "FS", "SS", "RES_OBS")
LINE = re.compile(r"(?P<word>[A-Z_0-9-]+)(?:\s+(?P<fields>.*))?", re.ASCII)
MAX_AZIMUTH_DIFFERENCE_RAD = math.radians(1.0)
"""Difference of azimuths from coordinates and from the circle beyond which they contradict each
other; half a circle of wrong orders differs by more, but near the diagonals."""


def read_topcon_gts7(
    path: str | Path,
    *,
    order: Literal["ne", "en"] | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Topcon, GTS-7, or of South's NTS-350.

    Read are stations (STN) with heights of the instrument, coordinates (XYZ) of the point before,
    azimuth and circle reading of the backsight (BKB), targets (BS, FS, SS) with their heights, and
    readings of angles (HV), with slope distances (SD) or with horizontal distances (HD). Targets of
    a free station (RES_OBS) stand before their station, and are a set of their own.

    Whether north or east is first in XYZ follows from azimuths and readings of the file: bearings
    between coordinates must be those of the circle. Where they do not decide it, because there are
    too few or a bearing is that of a diagonal, ``order`` does. Coordinates are approximate ones,
    held where ``fixed`` names their point; of several the first ones count. A station that has the
    coordinates of another one has none: the instrument repeats them where none are entered.

    A distance of 0 was not measured. Offsets of the prism (OFFSET) other than 0 are refused; those
    from reference lines (PTL_OFF) and missing lines (MLM) are derived, and left out, and so are
    vertical distances (HD). Not read: codes, and what `UNREAD_RECORDS` has. Files of South's NTS03
    have other records (STA, HVD, SC, SA), and are refused.

    Tried on a file of a GPT-7000 and on one of an NTS-350, all readings of which are those of the
    table of its converter.

    Args:
        path: the file.
        order: order of coordinates: ``ne`` north first, ``en`` east first.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    if order is not None:
        source.field(1, str(order), "order").word(("ne", "en"))
    reader = _Reader(FieldBook(source, accuracies, fixed))
    for i, (line, text) in enumerate(source.filled()):
        reader.read(line, text.strip(), is_first=i == 0)
    reader.end(order)
    return reader.book.network()


@dataclass(frozen=True)
class StatedCoordinates:
    """Coordinates of a point in the order of the file."""

    line: int
    point: str
    first: float
    second: float
    up: float | None
    is_station: bool


@dataclass(frozen=True)
class Bearing:
    """Azimuth of a sight by the circle, radians."""

    station: str
    point: str
    azimuth: float


class _Reader:
    """State of the field book between its lines."""

    def __init__(self, book: FieldBook) -> None:
        self.book = book
        self.source = book.source
        self.scales: Scales | None = None
        self.coordinates: list[StatedCoordinates] = []
        self.bearings: list[Bearing] = []
        self.orientation: float | None = None
        self.subject = ""
        """Point whose coordinates or readings may follow."""
        self.is_station = False
        self.target: dict[str, Any] | None = None
        self.before: list[tuple[int, str, dict[str, Any]]] = []
        """Sights of a free station, whose station follows."""

    def read(self, line: int, text: str, *, is_first: bool) -> None:
        """Read a line; the first one may be a header."""
        found = LINE.fullmatch(text)
        word = "" if found is None else found["word"]
        if word not in GTS7_RECORDS and word not in UNREAD_RECORDS:
            if not is_first:
                words = {w: w for w in (*GTS7_RECORDS, *sorted(UNREAD_RECORDS))}
                self.source.field(line, text.split()[0], "record").choice(words)
            return
        if found is None or word in UNREAD_RECORDS:
            if found is not None and word == "NOTE":
                self.source.leave_out(line, NOTES, (found["fields"] or "").strip())
            return
        if self.scales is None and word != "UNITS":
            what = f"record {word} before the units of the file (UNITS M,D)"
            self.source.wrong(line, what)
            self.scales = Scales(1.0, PACKED_DEGREES)
        fields = [f.strip() for f in (found["fields"] or "").split(",")]
        while fields and not fields[-1]:
            fields.pop()
        of = read_record(GTS7_RECORDS[word], fields, self.source, line, self.scales or Scales())
        use: dict[str, Callable[[int, dict[str, Any]], None]] = {
            "UNITS": self._units,
            "STN": self._station,
            "XYZ": self._xyz,
            "BKB": self._backsight,
            "OFFSET": self._offset,
        }
        if word in use:
            use[word](line, of)
        elif word in TARGET_RECORDS:
            self.subject, self.is_station = of["point"], False
            self.target = {**of, "is_before": word == "RES_OBS"}
        elif word in ("PTL_OFF", "MLM"):
            why = LINE_OFFSETS if word == "PTL_OFF" else DERIVED_OBSERVATIONS
            self.source.leave_out(line, why, self.subject)
        else:
            self._reading(line, word, of)

    def _units(self, line: int, of: dict[str, Any]) -> None:
        self.scales = Scales(of["length"] or 1.0, of["angle"] or PACKED_DEGREES)

    def _station(self, line: int, of: dict[str, Any]) -> None:
        self.subject, self.is_station, self.target = of["point"], True, None
        self.orientation = None
        self.book.begin(line, of["point"], of["height"])
        if self.before:
            for at, name, values in self.before:
                self.book.sight(at, name, **values)
            self.before = []
            self.book.begin(line, of["point"], of["height"])  # the circle was turned

    def _xyz(self, line: int, of: dict[str, Any]) -> None:
        if not self.subject:
            self.source.wrong(line, "coordinates (XYZ) without a point before them")
            return
        stated = StatedCoordinates(
            line, self.subject, of["first"], of["second"], of["elevation"], self.is_station
        )
        self.coordinates.append(stated)

    def _backsight(self, line: int, of: dict[str, Any]) -> None:
        name, azimuth, circle = of["point"], of["azimuth"], of["circle"]
        self.subject, self.is_station = name, False
        if azimuth is not None and circle is not None:
            self.orientation = azimuth - circle
        if not name:
            self.source.leave_out(line, BACKSIGHTS_WITHOUT_POINT, str(line))
            return
        if azimuth is not None:
            self._bearing(name, azimuth)
        self.book.backsight(line, name, _within_circle(circle))

    def _bearing(self, point: str, azimuth: float) -> None:
        if self.book.current is not None and not math.isnan(azimuth):
            self.bearings.append(Bearing(self.book.current.station, point, azimuth))

    def _offset(self, line: int, of: dict[str, Any]) -> None:
        if any(v is not None and abs(v) > 0 for v in of.values()):
            what = f"the offset of the prism from {self.subject!r} is not applied: take the record "
            self.source.wrong(line, f"{what}out, and its sight if the offset is right")

    def _reading(self, line: int, word: str, of: dict[str, Any]) -> None:
        if self.target is None:
            self.source.wrong(line, f"readings ({word}) without a target (BS, FS, SS) before them")
            return
        name = self.target["point"]
        if of.pop("vertical", None) is not None:
            self.source.leave_out(line, DERIVED_OBSERVATIONS, name)
        of["direction"] = _within_circle(of["direction"])
        values = {**of, "target_height": self.target["target_height"]}
        if self.target["is_before"]:
            self.before.append((line, name, values))
            return
        if self.orientation is not None and of.get("zenith", 0.0) < math.pi:
            self._bearing(name, of["direction"] + self.orientation)
        self.book.sight(line, name, **values)

    # -- coordinates ------------------------------------------------------------------------------

    def end(self, order: str | None) -> None:
        """Note coordinates in their order, and sights that have no station."""
        if self.before:
            what = "targets of a free station (RES_OBS) without a station (STN) behind them"
            self.source.wrong(self.before[0][0], what)
        self._leave_out_repeated()
        if not self.coordinates:
            return
        order = order or self._order()
        for of in self.coordinates:
            north, east = (of.first, of.second) if order == "ne" else (of.second, of.first)
            self.book.point(of.line, of.point, east, north, of.up, agree=False)

    def _leave_out_repeated(self) -> None:
        """Leave out the coordinates of a station that are those of another one."""
        of_station: dict[tuple[float, float], str] = {}
        kept = []
        for of in self.coordinates:
            place = (of.first, of.second)
            if of.is_station and of_station.setdefault(place, of.point) != of.point:
                self.source.leave_out(of.line, REPEATED_COORDINATES, of.point)
            else:
                kept.append(of)
        self.coordinates = kept

    def _order(self) -> str:
        """Return the order of coordinates with which bearings are those of the circle."""
        at: dict[str, tuple[float, float]] = {}
        for of in self.coordinates:
            at.setdefault(of.point, (of.first, of.second))
        fits = {"ne": 0, "en": 0}
        n = 0
        for b in self.bearings:
            if b.station not in at or b.point not in at or at[b.station] == at[b.point]:
                continue
            n += 1
            first, second = (q - p for p, q in zip(at[b.station], at[b.point], strict=True))
            for order, computed in (
                ("ne", math.atan2(second, first)),
                ("en", math.atan2(first, second)),
            ):
                difference = math.remainder(computed - b.azimuth, 2 * math.pi)
                fits[order] += abs(difference) < MAX_AZIMUTH_DIFFERENCE_RAD
        valid = [order for order, number in fits.items() if n and number == n]
        if len(valid) == 1:
            return valid[0]
        why = "the file has no azimuth between points with coordinates"
        if len(valid) == 2:
            why = "the azimuths of the file fit both, as they are those of a diagonal"
        elif n:
            why = "coordinates and azimuths of the file contradict each other in both"
        what = f"whether north or east is first in XYZ is not known: {why}; give "
        what += f"{option_text('order', 'ne')} for north first, or en"
        self.source.wrong(self.coordinates[0].line, what)
        return "ne"


def _within_circle(angle: Any) -> Any:
    """Return a reading of the circle from 0 to 2π; files of TopSURV have negative ones, too."""
    return None if angle is None else angle % (2 * math.pi)


def _is_gts7(path: Path) -> bool:
    """Return whether the first lines are records, with a station or units, and a target."""
    text = file_beginning(path).decode("latin-1").replace("\r", "\n")
    lines = [line.strip() for line in text.split("\n")[:200] if line.strip()][:40]
    words = [m["word"] if (m := LINE.fullmatch(line)) else "" for line in lines]
    if words and words[0] not in {*GTS7_RECORDS, *UNREAD_RECORDS}:
        words = words[1:]  # a header
    known = all(w in GTS7_RECORDS or w in UNREAD_RECORDS for w in words)
    return known and "UNITS" in words and bool({*words} & {"STN", *TARGET_RECORDS})


READER = Reader(
    "topcon_gts7",
    (".gts7", ".gt7"),
    "Topcon GTS-7, South NTS",
    NetworkReader(read_topcon_gts7),
    recognises=_is_gts7,
)
