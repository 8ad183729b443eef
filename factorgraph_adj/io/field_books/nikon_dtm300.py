"""Reader of the text of Nikon's DTM-300: stations, coordinates and sights of one face or two.

A line has values between commas: state (1: valid), type, units, point, and three numbers, of a
sight also the height of the target. Nothing is published about the format by Nikon; this is the
grammar of GeoEasy (Z. Siki, ``nikon.tcl``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from ...errors import InputError, Problem
from ...network.network import Network
from ...units import FOOT, GON, US_SURVEY_FOOT
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader, begins_with
from ..numbers import PACKED_DEGREES
from ..source import ROWS_SWITCHED_OFF, TextSource
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

DTM_LENGTHS = {"M": 1.0, "F": US_SURVEY_FOOT, "N": FOOT}
DTM_ANGLES: dict[str, float | str] = {"D": PACKED_DEGREES, "G": GON, "M": math.pi / 3200}
"""Radians of the second character of the units; D is written as D.MMSS."""
DTM_UNITS = {a + b: Scales(m, r) for a, m in DTM_LENGTHS.items() for b, r in DTM_ANGLES.items()}
NAME = RecordField("point", "point", read_name, default=NEEDED)
COORDINATES = (
    NAME,
    *(RecordField(a, "coordinate", read_length) for a in ("first", "second", "up")),
)
DTM_RECORDS = {
    "0": (
        NAME,
        RecordField("distance", "slope distance", read_length),
        RecordField("direction", "direction", read_angle),
        RecordField("zenith", "zenith reading", read_angle),
        RecordField("target_height", "target height", read_length),
    ),
    **dict.fromkeys("123", COORDINATES),
}
"""Fields behind the units, by type: sight; coordinates computed, typed, uploaded."""
COMPUTED, TYPED = "1", "2"
STATION_PATTERN = re.compile(r"(.*?[^-])(--?)([0-9.]*)")
"""Name of a station with the height of the instrument behind it."""
DTM_BEGINNING = rb"\s*[0-9]\s*,\s*[0-3]\s*,\s*[MFN][DGM]\s*,[^,\r\n]+[,\r\n]"
"""State, type, units and a point."""


def read_nikon_dtm300(
    path: str | Path,
    *,
    order: Literal["NE", "EN"] = "NE",
    double_hyphen: Literal["separator", "minus"] | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read the text of a Nikon DTM-300.

    Read are sights (type 0), coordinates that were computed, typed or uploaded (1, 2, 3), and
    stations: a typed line whose point is followed by a hyphen and the height of the instrument,
    such as ``1002-1.63``. Heights of instrument and target, and distances, have the unit of their
    line. Coordinates are approximate ones, held where ``fixed`` names the point; those that are
    stated first count. Lines with another state than 1 are deleted, and are left out. Directions
    have no face: a zenith reading above 180° is one in face 2.

    Tried on one file of two set-ups, which measure each other: with the second hyphen as a
    separator the height differences of its stations agree to 5 mm, as a minus they contradict each
    other by 2.9 m.

    Args:
        path: the file.
        order: order of coordinates, which the file does not state: NE, north first, or EN.
        double_hyphen: what the second hyphen of ``1001--1.455`` is: ``separator``, the height is
            1.455 m, or ``minus``, it is −1.455 m, of an instrument that hangs; without it such a
            line is refused.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    if order not in ("NE", "EN"):
        raise InputError(Problem(f"must be NE or EN, not {order!r}", "order"))
    if double_hyphen not in ("separator", "minus", None):
        what = f"must be separator or minus, not {double_hyphen!r}"
        raise InputError(Problem(what, "double_hyphen"))
    source = TextSource(path)
    book = FieldBook(source, accuracies, fixed)
    for line, text in source.filled():
        state, kind, units, *texts = (t.strip() for t in [*text.strip("\x1a").split(","), "", ""])
        texts = texts[:-2]
        if state != "1":
            source.field(line, state, "state (1 valid, 0 deleted)").integer()
            source.leave_out(line, ROWS_SWITCHED_OFF, texts[0] if texts else "")
            continue
        fields = source.field(line, kind, "type").choice(DTM_RECORDS)
        scales = source.field(line, units, "units of lengths and angles").choice(DTM_UNITS)
        if fields is None or scales is None:
            continue
        values = read_record(fields, texts, source, line, scales)
        if kind == "0":
            _sight(book, line, values)
        else:
            _point(book, line, kind, values, scales, order == "EN", double_hyphen)
    hint = ": it begins with a line of type 2 whose point is name-height, such as 1002-1.63"
    return book.network(hint=hint)


def _sight(book: FieldBook, line: int, values: dict[str, Any]) -> None:
    book.sight(
        line,
        values["point"],
        direction=values["direction"],
        zenith=values["zenith"],
        distance=values["distance"],
        target_height=values["target_height"],
    )


def _point(
    book: FieldBook,
    line: int,
    kind: str,
    values: dict[str, Any],
    scales: Scales,
    east_first: bool,
    double_hyphen: str | None,
) -> None:
    """Note a point, which is a station where the height of the instrument follows its name."""
    name, a, b = values["point"], values["first"], values["second"]
    east, north = (a, b) if east_first else (b, a)
    station = STATION_PATTERN.fullmatch(name) if kind == TYPED else None
    if station is None:
        book.point(line, name, east, north, values["up"], agree=False)
        return
    name, hyphens, text = station.groups()
    height = book.source.field(line, text, "height of the instrument").number_or_none()
    if hyphens == "--" and double_hyphen is None:
        what = f"the height of the instrument is {text} or −{text}: give "
        book.source.wrong(line, what + option_text("double_hyphen", "separator") + " or minus")
    if height is not None:
        height *= -scales.length if hyphens == "--" and double_hyphen == "minus" else scales.length
    book.point(line, name, east, north, values["up"], agree=False)
    book.begin(line, name, height)


READER = Reader(
    "nikon_dtm300",
    (".nik",),
    "text of Nikon DTM-300",
    NetworkReader(read_nikon_dtm300),
    recognises=begins_with(DTM_BEGINNING),
)
