"""Reader of the text reports of Leica total stations: TCR 705 and System 1200, "Data Export".

System 1200 prints sections with a title over dashes, a line of columns, and rows::

    TPS Measurements
    ----------------
    Point ID    Hz        V         SD      HD      dH      hr      Add. Const   atm/geom ppm
    OA9         73.0632   90.2450   3.513   3.513   1.632   0.000   0.0344       0/   0

TCR 705 prints ``SETUP SN``, ``IH`` and rows of point, E, N, H and code. Both are formats of users:
styles of the instrument's software, which others may have otherwise.

Grammar: the reports in the samples of Total Open Station.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Literal

from ...network.network import Network
from ...units import ANGLE, GON
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader, begins_with
from ..numbers import ROUNDED_PACKED_DEGREES, parse_quantity
from ..source import LeftOutReason, TextSource
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import (
    NEEDED,
    RecordField,
    Scales,
    read_angle,
    read_length,
    read_name,
    read_record,
)

AngleUnit = Literal["dms", "deg", "gon"]
REPORT_ANGLES: dict[AngleUnit, float | str] = {
    "dms": ROUNDED_PACKED_DEGREES,
    "deg": ANGLE["deg"],
    "gon": GON,
}
"""Radians of the unit of angles, or its name: dms is D.MMSS."""
ROUNDING_M = 2e-3
"""Difference of printed horizontal distances, in mm, from those of slope distance and zenith."""
COORDINATES = tuple(
    RecordField(name, key, read_length, key, NEEDED)
    for name, key in (("east", "E"), ("north", "N"), ("up", "H"))
)
POINT_COLUMNS = (RecordField("point", "point", read_name, "Point ID", NEEDED), *COORDINATES)
STATION_COLUMNS = (
    RecordField("point", "station", read_name, "Station ID", NEEDED),
    *COORDINATES,
    RecordField("height", "height of the instrument", read_length, "hi", NEEDED),
)
SIGHT_COLUMNS = (
    RecordField("target", "target", read_name, "Point ID", NEEDED),
    RecordField("direction", "Hz", read_angle, "Hz"),
    RecordField("zenith", "V", read_angle, "V"),
    RecordField("distance", "SD", read_length, "SD"),
    RecordField("horizontal", "HD", read_length, "HD"),
    RecordField("target_height", "hr", read_length, "hr"),
)
TEXT_COLUMNS = ("Class", "Point Code", "Line ID", "Line Code")
"""Columns of texts, which may be blank and are not read; they are the last ones."""
DERIVED_COLUMNS = ("dH", "Add. Const", "atm/geom ppm")
REPORT_SECTIONS: Mapping[str, tuple[RecordField, ...]] = {
    "Job": (),
    "Points": POINT_COLUMNS,
    "Lines": POINT_COLUMNS,
    "TPS Station": STATION_COLUMNS,
    "TPS Measurements": SIGHT_COLUMNS,
}
"""Columns that are read, by the title of a section."""
REPORT_BEGIN = "System 1200 Data Export - File Begin"
REPORT_END = "System 1200 Data Export - File End"
TCR_END = "File End."
TCR_POINT = (
    RecordField("point", "point", read_name, default=NEEDED),
    RecordField("east", "E", read_length, default=NEEDED),
    RecordField("north", "N", read_length, default=NEEDED),
    RecordField("up", "H", read_length, default=NEEDED),
    RecordField("code", "code", read_name),
)
TCR_UNMEASURED = (1.0, 1.0, 1.0)
"""Coordinates that the report has for a point without any."""
WITHOUT_COORDINATES = LeftOutReason("points", "the report has 1.00, 1.00, 1.00 for coordinates")
_PPM = re.compile(r"/\s+")
"""Blanks between the corrections by atmosphere and geometry, which are one value."""
_TCR_HEAD = re.compile(r"(JOB|OPERATOR|DATE|INS\. NO\.|INS\. TYPE\.|IH|Orientation Station)\s+(.+)")
_TCR_STATION = re.compile(r"SETUP SN\s+(\S.*)")


def read_leica_text(
    path: str | Path,
    *,
    angles: AngleUnit | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a text report of a Leica total station, TCR 705 or System 1200.

    Of System 1200, read are coordinates (Points, Lines), stations with height of the instrument
    (TPS Station), and sights with Hz, V, SD and hr (TPS Measurements) from the station before them;
    lengths are metres. Distances have the constant of the prism and the atmosphere already. The
    report does not state the unit of angles: without ``angles`` it is that of D.MMSS, degrees and
    gon with which all horizontal distances (HD) are those of SD and V, which a remark says.

    Of TCR 705 the points are read, which it prints without readings; coordinates of 1.00, 1.00,
    1.00 stand for none, and these rows are counted.

    Coordinates are approximate ones, held where ``fixed`` names the point; of several the first
    ones count. Not read: job and instrument, classes and codes, height differences (dH), constants
    of prisms; of TCR 705 also set-ups, which have no readings. Other sections and columns are
    refused.

    Tried on a report of each instrument, with 710 and 101 rows of points.

    Args:
        path: the file.
        angles: unit of the angles: ``dms`` (D.MMSS), ``deg`` or ``gon``.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(source, accuracies, fixed)
    system_1200 = any(REPORT_BEGIN[:23] in text for text in source.lines[:5])
    end = REPORT_END if system_1200 else TCR_END
    if not any(text.strip() == end for text in source.lines):
        source.wrong(source.last, f"the report has no line {end!r}: it is cut off")
    if system_1200:
        _Report(book, angles).read()
    else:
        _read_tcr(book)
    return book.network()


# -- System 1200 ----------------------------------------------------------------------------------


class _Report:
    def __init__(self, book: FieldBook, angles: AngleUnit | None) -> None:
        self.book = book
        self.source = book.source
        self.angles = angles
        self.rows: list[tuple[int, str, dict[str, str]]] = []
        """Line, section and values by column of each row."""

    def read(self) -> None:
        """Read all sections, then use their rows in the unit of angles that fits them."""
        self._sections()
        scales = Scales(angle=REPORT_ANGLES[self.angles or self._unit()])
        for line, section, given in self.rows:
            fields = REPORT_SECTIONS[section]
            unread = (*TEXT_COLUMNS, *DERIVED_COLUMNS)
            of = read_record(fields, given, self.source, line, scales, unread=unread)
            if section == "TPS Measurements":
                self.book.sight(line, of.pop("target"), **of)
                continue
            name, height = of.pop("point"), of.pop("height", None)
            self.book.point(line, name, **of, agree=False)
            if section == "TPS Station":
                self.book.begin(line, name, height)

    def _sections(self) -> None:
        """Split the lines into sections and rows."""
        assert isinstance(self.source, TextSource)
        lines = [text.strip() for text in self.source.lines]
        section, columns = "", list[str]()
        for line, text in enumerate(lines, 1):
            below = lines[line] if line < len(lines) else ""
            if not text or set(text) <= set("+") or text in (REPORT_BEGIN, REPORT_END):
                continue
            if set(text) == {"-"}:
                if not section or columns:
                    self.source.wrong(line, "dashes without a title above")
            elif below and set(below) == {"-"}:
                field = self.source.field(line, text, "section")
                section = text if field.choice(REPORT_SECTIONS) is not None else ""
                columns = []
            elif not section:
                self.source.wrong(line, f"{text[:40]!r} stands in no section that is read")
            elif section == "Job":
                if ":" not in text:
                    self.source.wrong(line, f"a line of Job must have a colon, not {text[:40]!r}")
            elif not columns:
                columns = self._columns(line, section, re.split(r"\s{2,}", text))
            else:
                self._row(line, section, columns, re.split(r"\s{2,}", _PPM.sub("/", text)))

    def _columns(self, line: int, section: str, columns: list[str]) -> list[str]:
        """Return the columns of a section; wrong ones are noted."""
        fields = REPORT_SECTIONS[section]
        known = (*(f.key for f in fields), *TEXT_COLUMNS, *DERIVED_COLUMNS)
        for column in columns:
            self.source.field(line, column, f"column of {section}").choice(dict.fromkeys(known, 1))
        for f in fields:
            if f.key not in columns:
                self.source.wrong(line, f"section {section} has no column {f.key}")
        return columns

    def _row(self, line: int, section: str, columns: list[str], cells: list[str]) -> None:
        """Keep a row; the texts at its end may be blank."""
        needed = [c for c in columns if c not in TEXT_COLUMNS]
        if not len(needed) <= len(cells) <= len(columns):
            valid = " to ".join(str(n) for n in sorted({len(needed), len(columns)}))
            what = f"a row of {section} has {valid} values, not {len(cells)}"
            self.source.wrong(line, what)
            return
        self.rows.append((line, section, dict(zip(needed, cells, strict=False))))

    def _unit(self) -> AngleUnit:
        """Return the unit of angles with which V makes SD to HD in all rows, or note it is open."""
        sights = [of for _, section, of in self.rows if section == "TPS Measurements"]
        given = [(of.get("V", ""), of.get("SD", ""), of.get("HD", "")) for of in sights]
        fitting = [unit for unit in REPORT_ANGLES if all(_fits(unit, *row) for row in given)]
        if not sights:
            return "dms"  # there is no angle
        if len(fitting) != 1:
            line = next(n for n, section, _ in self.rows if section == "TPS Measurements")
            what = "unit of angles is open: HD is that of SD and V "
            what += f"in {' and '.join(fitting)}" if fitting else "in none of dms, deg, gon"
            self.source.wrong(line, f"{what}; give {option_text('angles', 'dms')}, deg or gon")
            return "dms"
        text = f"angles are {UNIT_NAMES[fitting[0]]}: HD is that of SD and V in all "
        self.source.problems.remarks.append(f"{text}{len(sights)} sights in no other unit")
        return fitting[0]


UNIT_NAMES = {"dms": "degrees, minutes and seconds (D.MMSS)", "deg": "degrees", "gon": "gon"}


def _fits(unit: AngleUnit, vertical: str, slope: str, horizontal: str) -> bool:
    """Return whether a vertical reading in a unit makes a slope distance to a horizontal one.

    What is no number in any unit is noted elsewhere.
    """
    size = REPORT_ANGLES[unit]
    name, scale = (size, 1.0) if isinstance(size, str) else ("", size)
    try:
        s, h = parse_quantity(slope, ""), parse_quantity(horizontal, "")
    except ValueError:
        return True
    try:
        angle = parse_quantity(vertical, name) * scale
    except ValueError:
        return False
    return abs(abs(s * math.sin(angle)) - h) <= ROUNDING_M


# -- TCR 705 --------------------------------------------------------------------------------------


def _read_tcr(book: FieldBook) -> None:
    """Read the points of a report of TCR 705."""
    source, begun = book.source, False
    assert isinstance(source, TextSource)
    for line, text in source.filled():
        text = text.strip()
        cells = [c.strip() for c in text.split(",")]
        if text == TCR_END or set(text) <= {"-", " "}:
            continue
        if _TCR_HEAD.fullmatch(text) or _TCR_STATION.fullmatch(text):
            begun = True
        elif len(cells) == len(TCR_POINT):
            of: dict[str, Any] = read_record(TCR_POINT, cells, source, line)
            if (of["east"], of["north"], of["up"]) == TCR_UNMEASURED:
                source.leave_out(line, WITHOUT_COORDINATES, of["point"])
            else:
                book.point(line, of["point"], of["east"], of["north"], of["up"], agree=False)
        elif begun:  # titles of the user stand above the job
            what = f"{text[:40]!r} is neither a line of the set-up nor point, E, N, H and code"
            source.wrong(line, what)


def _is_report() -> Callable[[Path], bool]:
    job = rb"JOB\s+\S[^\n]*\n\s*OPERATOR\s[^\n]*\n\s*DATE\s[^\n]*\n\s*INS\. NO\.\s"
    return begins_with(
        rb"(?:\s*System 1200 Data Export - File Begin\s|(?:[^\n]*\n){0,5}?\s*" + job + rb")"
    )


READER = Reader(
    "leica_text",
    (".txt",),
    "text report of Leica (TCR 705, System 1200)",
    NetworkReader(read_leica_text),
    recognises=_is_report(),
)
