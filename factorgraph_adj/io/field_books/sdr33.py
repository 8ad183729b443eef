"""Reader of Sokkia's field books SDR33 and SDR2x: points, set-ups and sights of total stations.

Records of fixed width: Sokkia Technology, "Interfacing with the SOKKIA SDR Electronic Field Book",
1999, chapter 3. A record has a type of two digits, a derivation code of two characters, and fields:
names of 16 characters and numbers of 16 (SDR33), or of 4 and 10 (SDR2x).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...network.network import Network
from ...units import ANGLE, FOOT, GON, US_SURVEY_FOOT
from ..format_reader import NetworkReader, Reader
from ..source import DERIVED_OBSERVATIONS, ROWS_SWITCHED_OFF, TextSource
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
    read_number,
    read_record,
)

SDR_ANGLES = {"1": ANGLE["deg"], "2": GON, "4": math.pi / 3200}
SDR_LENGTHS = {"1": 1.0, "2": FOOT, "3": US_SURVEY_FOOT}
SDR_ORDERS = {"1": False, "2": True, "3": True}
"""Whether east is first, by option 5 of the header."""
SDR_VERTICAL_READINGS = {
    "1": lambda reading: reading,
    "2": lambda reading: (math.pi / 2 - reading) % (2 * math.pi),
}
"""Zenith reading of a vertical one, by what the instrument (01) states: from zenith or horizon."""
SDR_HEADER_PATTERN = re.compile(r"00..(SDR\s?\S+).*?([0-9]{6})\s*", re.ASCII)
COORDINATES = tuple(RecordField(t, "coordinate", read_length) for t in ("first", "second", "up"))
SDR_RECORDS = {
    "02": (
        RecordField("station", "station", read_name, default=NEEDED),
        *COORDINATES,
        RecordField("height", "height of the instrument", read_length, default=0.0),
    ),
    "03": (RecordField("height", "target height", read_length, default=0.0),),
    "04": (
        RecordField("vertical", "vertical collimation", read_number),
        RecordField("horizontal", "horizontal collimation", read_number),
    ),
    "08": (RecordField("point", "point", read_name, default=NEEDED), *COORDINATES),
    "09": (
        RecordField("station", "station", read_name, default=NEEDED),
        RecordField("target", "target", read_name, default=NEEDED),
        RecordField("distance", "slope distance", read_length),
        RecordField("vertical", "vertical reading", read_angle),
        RecordField("direction", "horizontal reading", read_angle),
    ),
}
"""Fields behind the derivation code, by type of record."""
SDR_FACES = {"F1": 1, "F2": 2, "MD": None}
"""Face by derivation code of an observation."""
UNREAD_RECORDS = {
    "05": "atmosphere, which is in the distances",
    "06": "scale factor, which raw distances do not have",
    "07": "backsight; its readings stand in records 09",
    "10": "job",
    "11": "reduced observation, derived from 09",
    "13": "note",
}
"""Records that are not read, and why none is needed."""
SDR_TYPES: dict[str, tuple[RecordField, ...]] = {
    **dict.fromkeys(("00", "01", *UNREAD_RECORDS), ()),
    **SDR_RECORDS,
}
"""Fields that are read, by type of record."""


def read_sdr33(
    path: str | Path,
    *,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Sokkia, SDR33 or SDR2x.

    Read are stations (02), heights of targets (03), coordinates (08), observations (09 F1, F2, MD)
    and the units of the header; the instrument (01) states whether vertical readings begin at the
    zenith. Coordinates of points are approximate ones, held where ``fixed`` names them; of several
    the first ones count. Prism constant and atmosphere are in the distances. Not needed and not
    read: atmosphere, scale, backsight, job, reduced and corrected observations (05, 06, 07, 10, 11,
    09 MC), notes (13) and deleted records, which begin with DD; 04 with corrections other than 0,
    sets (12) and all other records are refused.

    Args:
        path: the file.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    reader = _Reader(FieldBook(source, accuracies, fixed))
    for number, line in source.numbered():
        reader.read(number, line.lstrip("\x02\x03").rstrip("\x03\x1a\x00"))
    return reader.book.network()


class _Reader:
    def __init__(self, book: FieldBook) -> None:
        self.book = book
        self.source = book.source
        self.name_width, self.number_width = 16, 16
        self.scales = Scales(angle=GON)
        self.east_first = False
        self.header = False
        self.vertical = "1"
        self.target_height = 0.0

    def read(self, line: int, text: str) -> None:
        """Read a record."""
        code, derivation = text[:2], text[2:4]
        if not text.strip() or re.fullmatch(r"\d{1,6}\s*", text):
            return  # a check sum is alone at the end
        if code == "DD":
            self.source.leave_out(line, ROWS_SWITCHED_OFF, text[:40].strip())
        elif code == "00":
            self._header(line, text)
        elif not self.header:
            what = "a record before the header, which begins with 00NMSDR33 or 00NMSDR2"
            self.source.wrong(line, what)
            self.header = True
        elif code == "01":
            self.vertical = text[50:51].strip() or "1"
        elif code == "13" and derivation == "DU":
            what = "unit of length in a note (13DU) is not read: correct the header"
            self.source.wrong(line, what)
        elif code == "12":
            what = "sets (12) are not read: take the record out, and its observations if "
            self.source.wrong(line, f"{what}the set is marked bad")
        elif code == "11" or (code == "09" and derivation == "MC"):
            self.source.leave_out(line, DERIVED_OBSERVATIONS, derivation if code == "09" else code)
        elif fields := self.source.field(line, code, "record").choice(SDR_TYPES):
            widths = [self.name_width if f.read is read_name else self.number_width for f in fields]
            texts = in_columns(text, widths, 4)
            values = read_record(fields, texts, self.source, line, self.scales)
            self._use(line, code, derivation, values)

    def _header(self, line: int, text: str) -> None:
        match = SDR_HEADER_PATTERN.fullmatch(text)
        self.header = True
        if match is None or not match[1].replace(" ", "").startswith(("SDR33", "SDR2")):
            what = "the header must be 00, a code, SDR33 or SDR2x and six options, such as "
            self.source.wrong(line, f"{what}00NMSDR33 V04-04.02     01-Jan-04 16:26 211111")
            return
        if match[1].replace(" ", "").startswith("SDR2"):
            self.name_width, self.number_width = 4, 10
        options: dict[int, Any] = {
            number: self.source.field(line, match[2][number - 1], f"option {number}, {what},")
            for number, what in (
                (1, "angles (1 degrees, 2 gon, 4 mil)"),
                (2, "distances (1 metres, 2 feet, 3 US feet)"),
                (5, "coordinates (1 north first, 2 east first)"),
                (6, "angles (1 clockwise)"),
            )
        }
        options[6].choice({"1": 1})
        self.scales = Scales(
            options[2].choice(SDR_LENGTHS) or 1.0, options[1].choice(SDR_ANGLES) or GON
        )
        self.east_first = bool(options[5].choice(SDR_ORDERS))

    def _use(self, line: int, code: str, derivation: str, values: dict[str, Any]) -> None:
        """Use the values of a record."""
        if code == "03":
            self.target_height = values["height"]
        elif code == "04":
            if any(values.values()):
                what = "corrections of collimation other than 0 are not applied: read both faces"
                self.source.wrong(line, what)
        elif code == "09":
            self._observation(line, derivation, values)
        else:
            point = values["station" if code == "02" else "point"]
            first, second, up = (values[axis] for axis in ("first", "second", "up"))
            east, north = (first, second) if self.east_first else (second, first)
            self.book.point(line, point, east, north, up, agree=False)
            if code == "02":
                self.book.begin(line, point, values["height"])

    def _observation(self, line: int, derivation: str, values: dict[str, Any]) -> None:
        problems, book = self.source.problems.count, self.book
        face = self.source.field(line, derivation, "derivation of an observation").choice(SDR_FACES)
        if self.source.problems.count > problems:
            return
        station, vertical = values["station"], values["vertical"]
        if book.current is None or book.current.station != station:
            at = "before any station" if book.current is None else f"at {book.current.station!r}"
            self.source.wrong(line, f"observation from {station!r} {at}: record 02 is missing")
            return
        zenith = None
        if vertical is not None:
            what = "vertical readings of the instrument (1 zenith, 2 horizon)"
            turned = self.source.field(line, self.vertical, what).choice(SDR_VERTICAL_READINGS)
            zenith = math.nan if turned is None else turned(vertical)
        book.sight(
            line,
            values["target"],
            direction=values["direction"],
            zenith=zenith,
            distance=values["distance"],
            target_height=self.target_height,
            face=face,
        )


READER = Reader("sdr33", ((".sdr",)), "Sokkia SDR33 or SDR2x", NetworkReader(read_sdr33))
