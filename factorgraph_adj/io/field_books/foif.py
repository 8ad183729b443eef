"""Reader of FOIF's field book `.mes`: stations, references, sights with angles in half seconds.

Grammar: the records that GeoEasy reads (src/foif.tcl), and coordinates of the instrument, from
which the units and the sense of the circles follow. A record is a line of fields with commas and
begins with its letter; the first line begins with a blank.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...network.network import Network
from ...units import ANGLE
from ..format_reader import NetworkReader, Reader
from ..source import TextSource
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

HALF_SECOND = ANGLE["arcsec"] / 2
FOIF_SCALES = Scales(angle=HALF_SECOND)
NO_TARGET = "DEFAULT"
"""Name of a reference that is none: the circle was set to a value."""
PLACE = tuple(
    RecordField(n, w, read_length, default=NEEDED)
    for n, w in (("north", "north"), ("east", "east"), ("up", "height"))
)
FOIF_RECORDS = {
    "A": (
        RecordField("point", "station", read_name, default=NEEDED),
        *PLACE,
        RecordField("height", "height of the instrument", read_length, default=NEEDED),
    ),
    "C": (
        RecordField("point", "reference", read_name, default=NEEDED),
        RecordField("direction", "horizontal reading", read_angle, default=NEEDED),
    ),
    "B": (
        RecordField("point", "reference", read_name, default=NEEDED),
        RecordField("", "instruction", lambda field, scales: None),
        *PLACE,
    ),
    "F": (
        RecordField("point", "target", read_name, default=NEEDED),
        RecordField("direction", "horizontal reading", read_angle, default=NEEDED),
        RecordField("zenith", "vertical reading", read_angle, default=NEEDED),
        RecordField("", "horizontal distance", read_length, default=NEEDED),
        RecordField("distance", "slope distance", read_length, default=NEEDED),
        RecordField("", "height difference", read_length, default=NEEDED),
        RecordField("target_height", "target height", read_length, default=NEEDED),
        *PLACE,
    ),
}
"""Fields behind the letter that are read; marks, date and hour follow."""
FOIF_RECORDS |= {"H": FOIF_RECORDS["B"], "G": FOIF_RECORDS["F"]}
FOIF_LETTERS = {**{k: k for k in FOIF_RECORDS}, "D": "", "E": "", "U": ""}
"""Letters of records; those without a text are not read."""
_RECOGNISED = re.compile(
    rb" [^,\n]+,\d+,\d+,\d+,\d+,\d+,\d+,\d+,\d+,[^\n]*\r?\n\s*(?:A|B|U),[^,\n]+,", re.ASCII
)
"""The first line with two counts, a date and an hour, and the beginning of the second."""


def read_foif(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of FOIF.

    Read are stations (A), references with coordinates (B, H) and sights (F, G); angles are in half
    seconds, horizontal ones clockwise, vertical ones from the zenith; lengths are metres, a slope
    distance of 0 was not measured. Coordinates of stations and references are approximate ones,
    held where ``fixed`` names them; 0, 0, 0 is unknown. Horizontal distance,
    height difference and coordinates of a sight are results of the instrument, in its orientation
    and with its corrections, and are not used. The reading to a reference (C) counts where no
    sight of its set-up has a direction to it. Not read: the first line, orientations (D, E), marks
    of targets (U), marks, dates and hours at the end of records.

    Tried on two field books of GeoEasy: coordinates of their sights to 0.1 mm.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    book = FieldBook(source, accuracies, fixed)
    for line, text in source.filled():
        if line > 1:
            _read_record(book, line, [cell.strip() for cell in text.split(",")])
        elif not text.startswith(" "):
            what = "the first line must begin with a blank and the name of the file"
            source.wrong(line, what)
    return book.network()


def _read_record(book: FieldBook, line: int, cells: list[str]) -> None:
    source = book.source
    letter = source.field(line, cells[0], "record").choice(FOIF_LETTERS)
    if not letter:
        return
    fields = FOIF_RECORDS[letter]
    given = cells[1 : 1 + len(fields)]
    if letter in "BHC" and given[:1] == [NO_TARGET]:
        return
    problems = source.problems.count
    found = read_record(fields, given, source, line, FOIF_SCALES)
    if source.problems.count > problems:
        return
    name = found["point"]
    if letter in "FG":
        _sight(book, line, name, found)
        return
    if letter == "C":
        book.backsight(line, name, found["direction"])
        return
    if any(found[n] for n in ("north", "east", "up")):
        book.point(line, name, found["east"], found["north"], found["up"])
    if letter == "A":
        book.begin(line, name, found["height"])


def _sight(book: FieldBook, line: int, name: str, found: dict[str, Any]) -> None:
    """Note a sight; horizontal distance, height difference and coordinates are derived."""
    book.sight(
        line,
        name,
        direction=found["direction"],
        zenith=found["zenith"],
        distance=found["distance"],
        target_height=found["target_height"],
    )


def is_foif(path: Path) -> bool:
    """Return whether a file begins as a field book of FOIF."""
    return _RECOGNISED.match(file_beginning(path)) is not None


READER = Reader(
    "foif", (".mes",), "field book of FOIF", NetworkReader(read_foif), recognises=is_foif
)
