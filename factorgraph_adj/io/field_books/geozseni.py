"""Reader of the Hungarian field book of GeoZseni, `.gjk`: readings in both faces and their means.

Grammar: GeoEasy's reader (src/zsenigeo.tcl) and a field book of it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...network.network import Network
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import NOTES, Field, TextSource
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
    read_record,
)
from .geoprofi import HUNGARIAN_CODE_PAGE

GEOZSENI_SCALES = Scales(angle=PACKED_DEGREES)
FULL_MINUTE = re.compile(r"(\d{1,3}\.[0-5]\d)60")
"""Packed degrees with 60 seconds, which the program writes for 59.5″ and more: it rounds last."""


def read_rounded_angle(field: Field, scales: Scales = GEOZSENI_SCALES) -> float:
    """Return an angle; 60 seconds are a minute more."""
    match = FULL_MINUTE.fullmatch(field.value) if isinstance(field.value, str) else None
    if match is None:
        return read_angle(field, scales)
    field.value = f"{match[1]}00"
    return read_angle(field, scales) + math.radians(1 / 60)


GEOZSENI_READINGS = (
    ("direction", "horizontal reading", read_rounded_angle),
    ("zenith", "zenith reading", read_rounded_angle),
    ("distance", "slope distance", read_length),
)
GEOZSENI_FACES = ((1, " in face I"), (2, " in face II"), (0, ""))
"""Faces of the readings of a sight, in their order; 0: the mean."""
TARGET = (
    RecordField("target", "target", read_name, default=NEEDED),
    RecordField("", "code", read_name),
    RecordField("height", "target height", read_length),
    *(
        RecordField(f"{name} {face}", f"{what}{of_face}", read)
        for name, what, read in GEOZSENI_READINGS
        for face, of_face in GEOZSENI_FACES
    ),
)
GEOZSENI_RECORDS = {
    "AP": (
        RecordField("station", "station", read_name, default=NEEDED),
        RecordField("", "code", read_name),
        RecordField("height", "height of the instrument", read_length),
        *(
            RecordField("", what, read_name)
            for what in ("date", "field book", "surveyor", "instrument", "data collector")
        ),
        RecordField("note", "note", read_name),
    ),
    "AM": TARGET,
    "RM": TARGET,
}
"""Fields behind the letters: station, sights of control points and of detail points."""
_VERSION = re.compile(rb"GJK,\d+\s")


def read_geozseni(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of GeoZseni.

    Read are stations (AP) and sights (AM, RM): readings of both faces where they stand there, and
    otherwise their means, in packed degrees, of which 60 seconds are a minute more, and metres.
    The files have no coordinates. Text that is not UTF-8 is read in code page 852. Not read: means
    beside readings in both faces, codes, date, field book, surveyor, instrument and data collector
    of a station; its note is left out and counted.

    Tried on one field book of GeoEasy, of 248 set-ups.

    Args:
        path: the file.
        fixed: names of points that are held; the file has no coordinates: they must be joined.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page=HUNGARIAN_CODE_PAGE)
    book = FieldBook(source, accuracies, fixed)
    for line, text in source.filled():
        letters, *cells = [cell.strip() for cell in text.split(",")]
        if line == 1 or letters == "GJK":
            if line > 1 or (letters, *cells) != ("GJK", "2"):
                what = f"{text.strip()[:20]!r} must be GJK,2, the version, in the first line alone"
                source.wrong(line, what)
            continue
        fields = source.field(line, letters, "record").choice(GEOZSENI_RECORDS)
        if fields is None:
            continue
        found = read_record(fields, cells, source, line, GEOZSENI_SCALES)
        if letters == "AP":
            book.begin(line, found["station"], found["height"])
            if found["note"]:
                source.leave_out(line, NOTES, found["note"])
        else:
            _sight(book, line, found)
    return book.network()


def _sight(book: FieldBook, line: int, found: dict[str, Any]) -> None:
    """Note the readings of both faces, or their means where there is none of a face."""
    one, two, mean = (
        {name: found[f"{name} {face}"] for name, _, _ in GEOZSENI_READINGS} for face in (1, 2, 0)
    )
    given = {face: r for face, r in ((1, one), (2, two)) if any(v is not None for v in r.values())}
    for face, readings in (given or {1: mean}).items():
        book.sight(line, found["target"], **readings, target_height=found["height"], face=face)


def is_geozseni(path: Path) -> bool:
    """Return whether a file begins with the version of a field book of GeoZseni."""
    return _VERSION.match(file_beginning(path, 100)) is not None


READER = Reader(
    "geozseni",
    (".gjk",),
    "field book of GeoZseni",
    NetworkReader(read_geozseni),
    recognises=is_geozseni,
)
