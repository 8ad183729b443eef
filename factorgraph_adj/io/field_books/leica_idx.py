"""Reader of Leica's IDX (IDEX), the field book of total stations of the series TPS 300 to 1100.

A file has sections between ``NAME`` and ``END NAME``, which have keywords with a value, or rows of
values by the columns that stand behind the name of the section; ``;`` ends a row, ``,`` a value::

    SETUP
        STN_NO  500002
        STN_ID  "1283"
        INST_HT 1.512;
    END SETUP
    SLOPE(TgtNo, TgtID, CfgNo, Hz, Vz, SDist, RefHt, Date, Ppm, ApplType, Flags)
        500004, "2000", 1, 17.573160, 91.032780, 0.000000, 0.000000, …;
    END SLOPE

Grammar: field books of a Leica TCR705, which describe themselves; idex.tcl of GeoEasy.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...network.network import Network
from ...units import GON
from ..format_reader import NetworkReader, Reader, begins_with
from ..numbers import ROUNDED_PACKED_DEGREES
from ..source import NOTES, LeftOutReason, TextSource
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

IDX_ANGLES: dict[str, float | str] = {"DMS": ROUNDED_PACKED_DEGREES, "GON": GON}
"""Radians of ``ANGULAR``, or the name of the unit: DMS is D.MMSSss."""
IDX_LENGTHS = {"METRE": 1.0}
"""Metres of ``LINEAR``."""
VERTICAL_CIRCLES = {"ZENITH": "zenith"}
"""Vertical reading by ``V_TYPE``."""
POINT_COLUMNS = (
    RecordField("point", "point", read_name, "PointID", NEEDED),
    RecordField("east", "East", read_length, "East"),
    RecordField("north", "North", read_length, "North"),
    RecordField("up", "Elevation", read_length, "Elevation"),
    RecordField("state", "CLASS", read_name, "CLASS", ""),
)
SIGHT_COLUMNS = (
    RecordField("target", "target", read_name, "TgtID", NEEDED),
    RecordField("direction", "Hz", read_angle, "Hz"),
    RecordField("zenith", "Vz", read_angle, "Vz"),
    RecordField("distance", "SDist", read_length, "SDist"),
    RecordField("target_height", "RefHt", read_length, "RefHt"),
)
INSTRUMENT_COLUMNS = (
    RecordField("vertical", "V_TYPE", read_choice(VERTICAL_CIRCLES), "V_TYPE", NEEDED),
)
SETUP_KEYWORDS = (
    RecordField("station", "station", read_name, "STN_ID", NEEDED),
    RecordField("height", "height of the instrument", read_length, "INST_HT", 0.0),
)
COLUMNS: Mapping[str, tuple[tuple[RecordField, ...], tuple[str, ...]]] = {
    "POINTS": (POINT_COLUMNS, ("PointNo", "Code", "Date")),
    "SLOPE": (SIGHT_COLUMNS, ("TgtNo", "CfgNo", "Date", "Ppm", "ApplType", "Flags")),
    "INSTRUMENTS": (INSTRUMENT_COLUMNS, ("Name", "TheoNo", "EDMNo")),
}
"""Columns that are read, and others, by section."""
UNREAD_TABLES = ("THEMINFO", "ANNOTATIONS", "ELEMENTS", "CONFIGS")
"""Sections of rows that are not read: codes, remarks, weather and prism constants."""
UNREAD_SECTIONS = ("PROJECT",)
SECTIONS = (
    *("HEADER", "UNITS", "PROJECT", "DATABASE", "METEO", "THEODOLITE", "SETUP"),
    *(*COLUMNS, *UNREAD_TABLES),
)
KEYWORDS = {
    "HEADER": ("VERSION", "SYSTEM"),
    "UNITS": ("ANGULAR", "LINEAR", "TEMP", "PRESS", "TIME"),
    "SETUP": ("STN_NO", "STN_ID", "INST_HT"),
}
"""Keywords by section."""
COMPUTED = "MEAS"
"""Class of the points that the instrument has computed."""
NO_COORDINATES = (0.0, 0.0, 0.0)
"""Coordinates of a station that the surveyor did not enter."""
OWN_SYSTEMS = LeftOutReason(
    "coordinates", "the instrument computed them from stations without coordinates"
)
_COMMA = re.compile(r',(?=(?:[^"]*"[^"]*")*[^"]*$)')
"""A comma outside of quotation marks."""
_VALUE = re.compile(r'"([^"]*)"|([^\s"]*)')
_OPENING = re.compile(r"([A-Z_]+)\s*(?:\((.*)\))?")


def read_leica_idx(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Leica, IDX.

    Read are units (``ANGULAR`` DMS or GON, ``LINEAR`` METRE), points with coordinates, set-ups with
    station and height of the instrument, and sights (``SLOPE``) with horizontal and vertical
    reading, slope distance and height of the target, whose face follows from the vertical reading.
    A distance of 0 was not measured; distances have ppm and prism constant (``Ppm``, ``AddConst``)
    already. Coordinates are approximate ones, held where ``fixed`` names the point; all of 0 are
    none. Where a set-up has a station without coordinates, those of class MEAS are not used, which
    the instrument then computed from stations at 0, 0, 0; they are counted.

    Not read: project, dates, numbers and codes of points, weather, instruments but for their
    vertical circle. Rows of remarks (ANNOTATIONS) are left out and counted. Other sections, columns
    and units are refused.

    Tried on two field books of GeoEasy, 17 set-ups of a Leica TCR705 in both faces.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    reader = _Reader(FieldBook(source, accuracies, fixed))
    for line, text in source.filled():
        reader.read(line, text.strip())
    return reader.network()


@dataclass
class _Section:
    """A section that is not ended so far."""

    name: str
    line: int
    columns: list[str] = field(default_factory=list)
    """Columns of its rows; empty: it has keywords."""
    words: dict[str, str] = field(default_factory=dict)
    """Values by keyword."""


class _Reader:
    def __init__(self, book: FieldBook) -> None:
        self.book = book
        self.source = book.source
        self.open: list[_Section] = []
        self.scales = Scales(angle=ROUNDED_PACKED_DEGREES)
        self.angle_is_stated = False
        self.points: list[tuple[int, dict[str, Any]]] = []
        self.stations: set[str] = set()

    def read(self, line: int, text: str) -> None:
        """Read a line."""
        section = self.open[-1] if self.open else None
        if text.startswith("END ") or text == "END":
            self._end(line, text[3:].strip())
        elif opening := self._opening(text, section):
            self._begin(line, *opening)
        elif section is None:
            self.source.wrong(
                line, f"{text[:40]!r} stands in no section; valid: HEADER, DATABASE, …"
            )
        elif section.columns:
            self._row(line, text, section)
        elif section.name not in UNREAD_SECTIONS:
            key, *rest = text.rstrip(";").split(None, 1)
            valid = dict.fromkeys(KEYWORDS.get(section.name, ()), key)
            what = f"keyword of {section.name}"
            if self.source.field(line, key, what).choice(valid) is None:
                return
            if key in section.words:
                self.source.wrong(line, f"keyword {key!r} stands twice")
            value = _VALUE.fullmatch(rest[0].strip() if rest else "")
            if value is None:
                what = f"value of {key} must be one word, or stand in quotation marks"
                self.source.wrong(line, what)
                return
            section.words[key] = value[1] or value[2] or ""

    def _opening(self, text: str, section: _Section | None) -> tuple[str, str | None] | None:
        """Return name and columns of the section that a line opens; None: it opens none."""
        match = _OPENING.fullmatch(text)
        if match is None or (section is not None and match[1] in KEYWORDS.get(section.name, ())):
            return None
        return match[1], match[2]

    def _begin(self, line: int, name: str, columns: str | None) -> None:
        if self.source.field(line, name, "section").choice(dict.fromkeys(SECTIONS, True)) is None:
            pass  # it is passed over as one without rows
        elif (name in COLUMNS or name in UNREAD_TABLES) and columns is None:
            self.source.wrong(line, f"section {name} must name its columns, as in {name}(…)")
        section = _Section(name, line, [c.strip() for c in (columns or "").split(",") if c.strip()])
        if name in COLUMNS:
            fields, others = COLUMNS[name]
            valid = dict.fromkeys((*(f.key for f in fields), *others), True)
            for column in section.columns:
                self.source.field(line, column, f"column of {name}").choice(valid)
            for f in fields:
                if f.default is NEEDED and f.key not in section.columns:
                    self.source.wrong(line, f"section {name} has no column {f.key}")
        if name == "SLOPE" and not self.angle_is_stated:
            self.source.wrong(line, "sights need the unit of angles: ANGULAR in HEADER, UNITS")
            self.angle_is_stated = True
        self.open.append(section)

    def _end(self, line: int, name: str) -> None:
        if not self.open or self.open[-1].name != name:
            inside = f"section {self.open[-1].name!r}" if self.open else "no section"
            self.source.wrong(line, f"END {name} in {inside}")
            return
        section = self.open.pop()
        if section.name == "UNITS":
            self._units(section)
        elif section.name == "SETUP":
            of = read_record(
                SETUP_KEYWORDS, section.words, self.source, section.line, self.scales,
                unread=KEYWORDS["SETUP"],
            )  # fmt: skip
            self.stations.add(of["station"])
            self.book.begin(section.line, of["station"], of["height"])

    def _units(self, section: _Section) -> None:
        words, line = section.words, section.line
        angle = self.source.field(line, words.get("ANGULAR"), "unit ANGULAR").choice(IDX_ANGLES)
        length = self.source.field(line, words.get("LINEAR"), "unit LINEAR").choice(IDX_LENGTHS)
        self.angle_is_stated = True
        self.scales = Scales(length or 1.0, angle or ROUNDED_PACKED_DEGREES)

    # -- rows -----------------------------------------------------------------------------------

    def _row(self, line: int, text: str, section: _Section) -> None:
        if not text.endswith(";"):
            self.source.wrong(line, f"a row of {section.name} must end with ;")
            return
        cells = [c.strip().strip('"').strip() for c in _COMMA.split(text.removesuffix(";"))]
        if len(cells) != len(section.columns):
            what = f"a row of {section.name} has {len(section.columns)} values, not {len(cells)}"
            self.source.wrong(line, what)
        elif section.name in COLUMNS:
            self._values(line, cells, section)
        elif section.name == "ANNOTATIONS" and any(cells):
            self.source.leave_out(line, NOTES, ", ".join(c for c in cells if c))

    def _values(self, line: int, cells: list[str], section: _Section) -> None:
        """Use the values of a row."""
        fields, others = COLUMNS[section.name]
        given = dict(zip(section.columns, cells, strict=True))
        given = {k: v for k, v in given.items() if k in others or any(f.key == k for f in fields)}
        of = read_record(fields, given, self.source, line, self.scales, unread=others)
        if section.name == "POINTS":
            self.points.append((line, of))
        elif section.name == "SLOPE":
            self.book.sight(line, of.pop("target"), **of)

    # -- the network ----------------------------------------------------------------------------

    def network(self) -> Network:
        """Return the network."""
        for section in self.open:
            self.source.wrong(section.line, f"section {section.name} has no END {section.name}")
        entered = {
            of["point"]
            for _, of in self.points
            if of["state"] != COMPUTED and _coordinates(of) not in (NO_COORDINATES, NO_NUMBERS)
        }
        own_systems = not self.stations <= entered
        for line, of in self.points:
            at = _coordinates(of)
            if at in (NO_COORDINATES, NO_NUMBERS):
                continue
            if own_systems and of["state"] == COMPUTED:
                self.source.leave_out(line, OWN_SYSTEMS, of["point"])
            else:
                self.book.point(line, of["point"], *at, agree=False)
        return self.book.network()


NO_NUMBERS = (None, None, None)


def _coordinates(of: Mapping[str, Any]) -> tuple[float | None, ...]:
    return of["east"], of["north"], of["up"]


READER = Reader(
    "leica_idx",
    (".idx",),
    "Leica IDX",
    NetworkReader(read_leica_idx),
    recognises=begins_with(
        rb"\s*(?:HEADER\s+VERSION\s+[\d.]+\s"
        rb"|(?:DATABASE|THEODOLITE)\s+[A-Z]+\s*\(\w+(?:,\s*\w+)+\)\s)"
    ),
)
