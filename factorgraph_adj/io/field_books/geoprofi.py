"""Reader of the Hungarian field book of GeoProfi, `.mjk`: lines of two letters and columns.

Grammar: GeoEasy's reader (src/profigeo.tcl) and two field books of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ...network.network import Network
from ..format_reader import NetworkReader, Reader
from ..numbers import PACKED_DEGREES
from ..source import Field, TextSource
from ..text_files import file_beginning
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import (
    NEEDED,
    RecordField,
    Scales,
    in_columns,
    read_angle,
    read_length,
    read_name,
    read_record,
)

HUNGARIAN_CODE_PAGE = "cp852"
"""Code page of DOS in Central Europe."""
GEOPROFI_SCALES = Scales(angle=PACKED_DEGREES)


def _read_blank(field: Field, scales: Scales) -> None:
    """Note that characters between two columns are not blank: what stands there was shifted."""
    if not field.is_absent:
        field.wrong(f"must be blank, not {str(field.value)[:20]!r}")


def _blank(what: str) -> RecordField:
    return RecordField("", what, _read_blank)


TARGET = (
    _blank("column 3"),
    RecordField("target", "target", read_name, default=NEEDED),
    _blank("column 16"),
    RecordField("", "code", read_name),
    _blank("column 27"),
    RecordField("direction", "horizontal reading", read_angle),
    _blank("column 36"),
    RecordField("zenith", "zenith reading", read_angle),
    RecordField("distance", "slope distance", read_length),
    _blank("the line behind column 56"),
)
TARGET_WIDTHS = (1, 12, 1, 10, 1, 8, 1, 9, 11, 10_000)
GEOPROFI_RECORDS: dict[str, tuple[Sequence[int], tuple[RecordField, ...]]] = {
    "AP": (
        (1, 12, 1, 10, 7),
        (
            _blank("column 3"),
            RecordField("station", "station", read_name, default=NEEDED),
            _blank("column 16"),
            RecordField("", "code", read_name),
            RecordField("height", "height of the instrument", read_length),
        ),
    ),
    "JM": (
        (1, 6, 10_000),
        (
            _blank("column 3"),
            RecordField("height", "target height", read_length),
            _blank("the line behind column 9"),
        ),
    ),
    "KE": (TARGET_WIDTHS, TARGET),
    "RP": (TARGET_WIDTHS, TARGET),
}
"""Widths and fields behind the letters that are read."""
UNREAD_RECORDS = {
    "MT": "file of coordinates",
    "AR": "instrument",
    "FN": "surveyor",
    "DT": "date",
}
"""Letters of records that are not read."""
GEOPROFI_LETTERS = dict.fromkeys((*GEOPROFI_RECORDS, *UNREAD_RECORDS), True)
_LETTERS = rb"(?:MT|AR|FN|DT|AP|JM|KE|RP)"
_RECOGNISED = re.compile(
    rb"(?:(?!AP )" + _LETTERS + rb"(?: [^\n]*)?\r?\n|[ \t\r]*+\n)*+AP [^\n]*\r?\n"
    rb"(?:" + _LETTERS + rb"(?: [^\n]*)?\r?\n|[ \t\r]*+\n)*?"
    rb"(?:KE|RP) .{12}.{11}[ ]{1,4}\d{1,3}\.\d{4}[ \r\n]"
)
"""Records of the format up to the first sight of the first station."""


def read_geoprofi(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of GeoProfi.

    Read are stations (AP), target heights (JM), which count for all sights that follow, sights of
    control and detail points (KE, RP): horizontal and zenith reading in packed degrees, slope
    distance in metres. The files have no coordinates. Text that is not UTF-8 is read in code page
    852. Not read: file of coordinates, instrument, surveyor, date (MT, AR, FN, DT), codes of
    points, what stands behind the height of the instrument.

    Tried on two field books of GeoEasy, of which robuj.mjk has its survey three times.

    Args:
        path: the file.
        fixed: names of points that are held; the file has no coordinates: they must be joined.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page=HUNGARIAN_CODE_PAGE)
    reader = _Reader(FieldBook(source, accuracies, fixed))
    for line, text in source.filled():
        reader.read(line, text.rstrip("\r"))
    return reader.book.network()


@dataclass
class _Reader:
    book: FieldBook
    target_height: float = 0.0

    def read(self, line: int, text: str) -> None:
        """Read a record."""
        source, letters = self.book.source, text[:2]
        if source.field(line, letters, "record").choice(GEOPROFI_LETTERS) is None:
            return
        if letters in UNREAD_RECORDS:
            return
        widths, fields = GEOPROFI_RECORDS[letters]
        found = read_record(fields, in_columns(text, widths, 2), source, line, GEOPROFI_SCALES)
        if letters == "AP":
            self.book.begin(line, found["station"], found["height"])
        elif letters == "JM":
            self.target_height = found["height"] or 0.0
        else:
            self.book.sight(
                line,
                found["target"],
                direction=found["direction"],
                zenith=found["zenith"],
                distance=found["distance"],
                target_height=self.target_height,
            )


def is_geoprofi(path: Path) -> bool:
    """Return whether a file begins as a field book of GeoProfi."""
    return _RECOGNISED.match(file_beginning(path, 16_384)) is not None


READER = Reader(
    "geoprofi",
    (".mjk",),
    "field book of GeoProfi",
    NetworkReader(read_geoprofi),
    recognises=is_geoprofi,
)
