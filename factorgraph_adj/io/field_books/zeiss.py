"""Reader of field books of Zeiss and Trimble: M5, R5, R4 and REC 500, of total stations and levels.

What lines are recorded in which program: Trimble M3 Total Station User Guide, C192E, table B.7;
Trimble DiNi 12/12T/22 User Guide, chapter "The M5 data record format". That the readings behind a
stationing are oriented already, and which axis is north, was found in the coordinates that
instruments record beside their readings, see `read_zeiss`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ...network.network import Network
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader
from ..source import DERIVED_OBSERVATIONS, LeftOutReason, TextSource
from ..text_files import file_beginning
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook, name_list
from .levelled_line import LevelledLine
from .zeiss_layouts import (
    ANGLE_UNITS,
    CODE_THEN_NUMBER,
    LAYOUTS,
    LENGTH_UNITS,
    NUMBER_THEN_CODE,
    PointColumns,
    ZeissLayout,
    ZeissRecord,
    ZeissUnits,
    layout_of,
    zeiss_records,
)

STATIONINGS = ("KN STAT", "UN STAT", "EL STAT", "OR.COOR")
"""Programs that determine the station: known station, free station, height, orientation."""
PROGRAMS = ("POLAR", "INPUT", "START", "END", "PR", "DR", "COM-ON", "COM-OFF", "ADJUST", "")
"""Other texts of the instrument, whose values count."""
ORIENTATION_CODES = tuple("ABCDEFGHIJ")
"""Codes of the sights of a stationing."""
STAFFS = {"Rb": "back", "Rf": "fore", "Rz": "intermediate"}
LEVEL_SUMS = ("Sh", "dz", "Db", "Df", "Sr", "Sv", "Z0")
"""Types of the sums and differences of a levelled line."""
MODIFIED = ("dx", "dy", "dz", "dl", "dq", "dr", "dc", "O")
"""Types of differences that programs of stake-out compute."""
LOCAL = ("x", "y", "z", "n", "e")

TEXTS = LeftOutReason("texts", "they are notes, or name programs whose readings are read as others")
LOCAL_COORDINATES = LeftOutReason(
    "local coordinates", "they refer to the instrument or to a line of the site"
)
ZENITHS_OF_ORIENTATION = LeftOutReason(
    "zenith readings of orientation points", "the file does not state the height of the target"
)
SINGLE_READINGS = LeftOutReason("single staff readings", "they belong to no levelled line")
READINGS_REPEATED = LeftOutReason("staff readings", "the instrument says that they were repeated")
MEASUREMENT_UNIT = re.compile(r"units?\s+(m|ft)\b")
"""Unit of a level in a text of REC 500."""
METHOD = re.compile(r"(?<!\S)a?([BF]{2}(?:[BF]{2})?)(?!\S)")
"""Method of a levelled line: letters of backsight and foresight."""


def read_zeiss(
    path: str | Path,
    *,
    stations: str | Iterable[str] = (),
    length_unit: str | None = None,
    angle_unit: str | None = None,
    point_columns: str | None = None,
    x_axis: Literal["north", "east"] | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Zeiss or Trimble: M5, R5, R4 or REC 500, of a total station or level.

    Total stations: a set-up begins where a point with code S has coordinates; its sights are the
    points with Hz, V1, V2 or V3, and SD or HD, behind it. ``th`` and ``ih`` count from the line
    that has them, ``ih`` for the last station, whose height it follows in the files. Sights of a
    stationing (KN STAT, UN STAT, EL STAT, OR.COOR; codes A to J) precede the point of the station;
    in KN STAT they are readings of the circle before its orientation, which the orientation ``Om``
    brings to that of the sights that follow, and have no zenith reading, unless they have a
    distance, since the height of their target is not stated. In the other programs they are a set
    of their own. An orientation point that has the number of the station, as an Elta counts, has
    its code behind it. Coordinates of points are approximate ones, held where ``fixed`` names them;
    of several the first ones count, and those that follow readings of a point are derived from
    them.

    The point number has the columns 16-27 of the information of M5, its code 11-15, or those that
    a START block states; on an Elta 1-19 and 20-24. Codes other than S and those of a stationing
    are not read. X is north and Y east, unless record 05 of the START block (2) or ``x_axis`` says
    otherwise. SD of 0 was not measured.

    Levels: readings of backsight (Rb), foresight (Rf) and intermediate points (Rz) with HD between
    texts that state the method (BF, BFFB, aBF, …); means of a set-up with two readings of each
    staff are one height difference. Points without a name are turning points of one set-up.

    Not needed and not read: instrument, temperature, pressure, prism constant, scale, errors of
    the circles, height differences (h) beside horizontal distances, sums of levelled lines. REC 500
    has no units: lengths are metres unless ``length_unit`` says otherwise, which a remark states;
    angles need ``angle_unit``.

    Tried on four files of a Trimble M3, of which every point's own coordinates come out to 1 mm
    with the readings as azimuths, six files of coordinates of an Elta R55 (R4, R5, M5, REC
    500), and excerpts of DiNi levels. No public file has readings of a total station in R4, R5 or
    REC 500, or a free station.

    Args:
        path: the file.
        stations: names of the stations in the order of their set-ups, for instruments that number
            stations on instead of naming them.
        length_unit: unit of lengths of REC 500: m or ft.
        angle_unit: unit of angles of REC 500: gon, deg, dms (D.MMSS) or mil.
        point_columns: first columns of code and point number in the information of M5, such as
            ``11,16``, where the file does not show them.
        x_axis: direction of X, where record 05 does not state it or states it wrongly.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    layout = layout_of(source.lines) or LAYOUTS[0]
    records = list(zeiss_records(source, layout))
    reader = _Reader(FieldBook(source, accuracies, fixed), name_list(stations), x_axis)
    for value, name, valid in (
        (length_unit, "length_unit", LENGTH_UNITS),
        (angle_unit, "angle_unit", ANGLE_UNITS),
        (x_axis, "x_axis", ("north", "east")),
    ):
        if value is not None:
            source.field(1, str(value).lower(), name).word(valid)
    reader.units = ZeissUnits(source, length_unit, angle_unit)
    reader.columns = _point_columns(source, layout, records, point_columns)
    for record in records:
        reader.read(record)
    reader.end()
    if reader.units.length is None and any(v.unit is None for r in records for v in r.values):
        remark = f"{source.path.name} states no units: lengths are read as metres; "
        source.problems.remarks.append(f"{remark}{option_text('length_unit', 'ft')} says feet")
    return reader.book.network()


def _point_columns(
    source: TextSource, layout: ZeissLayout, records: list[ZeissRecord], stated: str | None
) -> PointColumns:
    """Return the columns of code and point number of a file, which M5 shows or an option states."""
    if layout.point is not None:
        return layout.point
    if stated is not None:
        starts = [
            source.field(1, part, "point_columns").integer(least=1, largest=27)
            for part in str(stated).split(",")
        ]
        if len(starts) != 2:
            source.wrong(1, "point_columns must be columns of code and number, such as 11,16")
        elif None not in starts:
            code, number = (int(s or 1) - 1 for s in starts)
            return PointColumns(slice(code, code + 5), slice(number, number + 12))
        return CODE_THEN_NUMBER
    marked = {v.type: v.text for r in records if not r.block.startswith("P") for v in r.values}
    if {"21", "22"} <= marked.keys():
        return _point_columns(source, layout, records, f"{marked['21']},{marked['22']}")
    points = [r for r in records if r.block == "PI"]
    if all(r.info[26] != " " for r in points):
        return CODE_THEN_NUMBER
    if all(r.info[18] != " " and r.info[24:] == "   " for r in points):
        return NUMBER_THEN_CODE
    what = "the columns of point numbers follow neither from a START block (22) nor from the "
    what += f"points: give {option_text('point_columns', '11,16')}, the first columns of code and "
    what += "number"
    source.wrong(points[0].line, what)
    return CODE_THEN_NUMBER


@dataclass
class _Orientation:
    """A sight of a stationing."""

    line: int
    name: str
    code: str
    values: dict[str, float]
    target_height: float


class _Reader:
    """State of the field book between its lines."""

    units: ZeissUnits
    columns: PointColumns

    def __init__(self, book: FieldBook, stations: tuple[str, ...], x_axis: str | None) -> None:
        self.book, self.source = book, book.source
        self.stations = stations
        self.used_stations = 0
        self.axis_stated = x_axis is not None
        self.x_north = x_axis != "east"
        self.program = ""
        self.stationing = ""
        """Last program that determined a station."""
        self.orientations: list[_Orientation] = []
        self.known: list[tuple[int, str, str, tuple[float | None, float | None, float | None]]] = []
        """Coordinates of orientation points of the present stationing: line, number, code."""
        self.rotation: float | None = None
        self.station: tuple[int, str] | None = None
        self.begun = False
        self.target_height = 0.0
        self.instrument_height: float | None = None
        self.sighted = ""
        """Point of the reading in the line before, whose coordinates may follow."""
        self.level = LevelledLine(book)
        self.turning_points = 0
        self.last_fore = ""

    def read(self, record: ZeissRecord) -> None:
        """Read a record."""
        values = self.units.read(record)
        is_level = bool(values.keys() & {"R", *STAFFS, *LEVEL_SUMS}) or record.block in ("KD", "KN")
        if record.block.startswith("T") or (not record.block and self._is_text(record, values)):
            self._text(record, values)
        elif is_level or (not record.block and self.level.in_line):
            self._staff(record, values)
        else:
            code = record.info[self.columns.code].strip()
            name = record.info[self.columns.number].strip()
            self._point(record, code, name, values)

    @staticmethod
    def _is_text(record: ZeissRecord, values: dict[str, float]) -> bool:
        """Return whether the information of REC 500 is a text: points have values."""
        return record.text in (*STATIONINGS, *PROGRAMS) or not values

    # -- texts ------------------------------------------------------------------------------------

    def _text(self, record: ZeissRecord, values: dict[str, float]) -> None:
        text, self.sighted = record.text, ""
        method = METHOD.search(text)
        if method is not None:
            self.level.begin_line(len(method[1]) // 2)
        elif text.startswith("End-Line"):
            self.level.end()
            self.level.in_line = False
        elif (stated := MEASUREMENT_UNIT.search(text)) is not None:
            self.units.length = self.units.length or stated[1]
        elif "repeated" in text:
            if not self.level.take_back(setup=text.startswith("Station")):
                self.source.wrong(record.line, f"{text!r} without readings before it")
            self.source.leave_out(record.line, READINGS_REPEATED, text)
        elif text in STATIONINGS:
            if text != "EL STAT":
                self._finish()
                self.stationing = text
            self.program = text
        elif text == "POLAR":
            self.program = text
        elif text not in PROGRAMS:
            self.source.leave_out(record.line, TEXTS, text)
        if "th" in values:
            self.target_height = values["th"]
        if "Om" in values:
            self.rotation = values["Om"]
        if "ih" in values:
            self.instrument_height = values["ih"]
            if self.begun:
                self.book.set_height(record.line, values["ih"])
        if "05" in values and not self.axis_stated:
            what = "coordinate system (1 X north, 2 Y north, 3 N and E)"
            given = f"{values['05']:g}"
            axes = {"1": True, "2": False, "3": True}
            self.x_north = self.source.field(record.line, given, what).choice(axes) is not False

    # -- points of total stations -----------------------------------------------------------------

    def _point(self, record: ZeissRecord, code: str, name: str, values: dict[str, float]) -> None:
        line = record.line
        if not name:
            self.source.wrong(line, f"point number is missing in {record.text!r}")
            return
        is_reading = bool(values.keys() & {"Hz", "V1", "V2", "V3", "SD", "HD"})
        if values.keys() & {*MODIFIED} or (is_reading and "Hz" not in values and "SD" in values):
            self.source.leave_out(line, DERIVED_OBSERVATIONS, name)
        elif values.keys() & {*LOCAL} and not is_reading:
            self.source.leave_out(line, LOCAL_COORDINATES, name)
        elif is_reading:
            self._reading(line, code, name, values)
        elif not values and code != "S":
            self.source.leave_out(line, TEXTS, record.text)
        else:
            self._coordinates(line, code, name, values)

    def _coordinates(self, line: int, code: str, name: str, values: dict[str, float]) -> None:
        first, second = ("X", "Y") if self.x_north else ("Y", "X")
        north = values.get("N_", values.get(first))
        east = values.get("E_", values.get(second))
        up = values.get("Z", values.get("Z_"))
        is_station = code == "S" and name != self.sighted
        if is_station and (north is not None or east is not None or up is None):
            if self.station is not None:
                self._finish()
            if self.stations:
                number, self.used_stations = self.used_stations, self.used_stations + 1
                name = self.stations[number] if number < len(self.stations) else name
            self.station, self.begun = (line, name), False
            self._note_known()
        elif self.program in STATIONINGS and code in ORIENTATION_CODES:
            self.known.append((line, name, code, (east, north, up)))
            return
        elif is_station and up is not None and self.station is not None:
            # A stationing in height replaces the height of the station, whose record has a number
            # of its own where the instrument counts its records.
            at = self.station[1]
            self.book.points[at] = (*self.book.points[at][:2], up)
            return
        self.book.point(line, name, east, north, up, agree=False)

    def _name(self, number: str, code: str) -> str:
        """Return the name of an orientation point, which may have the number of the station."""
        is_stations = self.station is not None and number == self.station[1]
        return f"{number} {code}" if is_stations else number

    def _note_known(self) -> None:
        """Note the coordinates of orientation points."""
        for line, number, code, (east, north, up) in self.known:
            self.book.point(line, self._name(number, code), east, north, up, agree=False)
        self.known = []

    def _reading(self, line: int, code: str, name: str, values: dict[str, float]) -> None:
        of_stationing = self.program in STATIONINGS and code in ORIENTATION_CODES
        if of_stationing and (self.program != "EL STAT" or self.station is None):
            self.orientations.append(_Orientation(line, name, code, values, self.target_height))
            return
        self._start()
        self.sighted = name
        self._sight(line, name, values, self.target_height)

    def _sight(self, line: int, name: str, values: dict[str, float], height: float) -> None:
        """Note a sight of the present set-up."""
        if self.station is not None and name == self.station[1]:
            what = f"station {name!r} sights itself: the instrument may have numbered the station "
            what += (
                f"on; give {option_text('stations', 'NAME,NAME')}, the names of the stations in "
            )
            what += "the order of their set-ups"
            self.source.wrong(line, what)
            return
        zenith = values.get("V1")
        for elevation in ("V2", "V3"):
            if elevation in values:
                zenith = (math.pi / 2 - values[elevation]) % (2 * math.pi)
        if "h" in values:
            self.source.leave_out(line, DERIVED_OBSERVATIONS, f"{name} h")
        self.book.sight(
            line,
            name,
            direction=values.get("Hz"),
            zenith=zenith,
            distance=values.get("SD"),
            horizontal=values.get("HD"),
            target_height=height,
        )

    def _start(self) -> None:
        """Begin the set-up of the station with the sights of its stationing."""
        if self.station is None or self.begun:
            return
        self.begun = True
        line, name = self.station
        height = self.instrument_height
        self.book.begin(line, name, height)
        is_known = self.stationing == "KN STAT"
        rotation = self.rotation if is_known else None
        for of in self.orientations:
            values = dict(of.values)
            if is_known and not values.get("SD"):
                zeniths = [values.pop(v) for v in ("V1", "V2", "V3") if v in values]
                if zeniths:
                    name_of = self._name(of.name, of.code)
                    self.source.leave_out(of.line, ZENITHS_OF_ORIENTATION, name_of)
            if rotation is not None and "Hz" in values:
                values["Hz"] = (values["Hz"] + rotation) % (2 * math.pi)
            self._sight(of.line, self._name(of.name, of.code), values, of.target_height)
        if self.orientations and rotation is None:
            self.book.begin(line, name, height)  # the circle was turned behind the stationing
        self.orientations = []

    def _finish(self) -> None:
        """End the set-up of the present station."""
        self._note_known()
        if self.station is not None and self.orientations:
            self._start()
        elif self.orientations:
            what = "sights of a stationing without a point of code S, the station"
            self.source.wrong(self.orientations[0].line, what)
        self.station, self.begun = None, False
        self.orientations, self.rotation = [], None

    # -- levels -----------------------------------------------------------------------------------

    def _staff(self, record: ZeissRecord, values: dict[str, float]) -> None:
        """Note the reading of a staff, or the height of a point."""
        line, name = record.line, record.info[:8].strip()
        kind = next((k for k in STAFFS if k in values), None)
        if values.keys() & {*LEVEL_SUMS}:
            self.source.leave_out(line, DERIVED_OBSERVATIONS, name or record.text)
            return
        if "R" in values:
            self.source.leave_out(line, SINGLE_READINGS, name or record.text)
            return
        if kind is not None:
            sight = STAFFS[kind]
            name = name or self._turning_point(line, sight)
            length = abs(values.get("HD", 0.0))
            self.level.reading(line, sight, name, values[kind], length)
        elif "Z" not in values:
            self.source.wrong(line, f"neither a reading of a staff nor a height: {record.text!r}")
        if "Z" in values:
            self.book.point(line, name or self.last_fore, up=values["Z"], agree=False)

    def _turning_point(self, line: int, sight: str) -> str:
        """Return the name of a point that the file does not name."""
        present = self.level.sights.get(sight)
        if present is not None and not self.level.is_complete:
            return present.point
        if sight == "fore":
            self.turning_points += 1
            self.last_fore = f"turning point {self.turning_points}"
            return self.last_fore
        if sight == "intermediate" or not self.last_fore:
            self.source.wrong(line, "the point of a staff reading has no name")
        return self.last_fore

    def end(self) -> None:
        """Note what the file ends with."""
        self._finish()
        self.level.end()
        if self.stations and len(self.stations) != self.used_stations:
            what = f"stations names {len(self.stations)}; the file has {self.used_stations} set-ups"
            self.source.wrong(1, what)


def _is_zeiss(path: Path) -> bool:
    """Return whether the first lines of a file have the form of a layout."""
    beginning = file_beginning(path).decode("latin-1").replace("\r\n", "\n")
    return layout_of(beginning.split("\n")) is not None


READER = Reader(
    "zeiss",
    (".m5", ".rec"),
    "Zeiss or Trimble M5, R5, R4, REC 500",
    NetworkReader(read_zeiss),
    recognises=_is_zeiss,
)
