"""Reader of Sokkia's field books SDR33 and SDR2x: points, set-ups and sights of total stations.

Records of fixed width: Sokkia Technology, "Interfacing with the SOKKIA SDR Electronic Field Book",
1999, chapter 3. A record has a type of two digits, a derivation code of two characters, and fields:
names of 16 characters and numbers of 16 (SDR33), or of 4 and 10 (SDR2x). What Nikon and Spectra
write in the format: Spectra Precision, "Focus 6 user guide", p. 183 to 186.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from ...network.network import Network
from ...units import ANGLE, FOOT, GON, US_SURVEY_FOOT
from ..format_reader import NetworkReader, Reader, begins_with
from ..numbers import NUMBER_PATTERN
from ..source import DERIVED_OBSERVATIONS, NOTES, ROWS_SWITCHED_OFF, LeftOutReason, TextSource
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

MIL = math.pi / 3200
SDR_ANGLES = {"1": ANGLE["deg"], "2": GON, "3": MIL}
NIKON_SDR_ANGLES = {**SDR_ANGLES, "4": MIL}
"""Units of angles of Nikon and Spectra, whose headers have no blank before the version."""
SDR_LENGTHS = {"1": 1.0, "2": FOOT, "3": US_SURVEY_FOOT}
SDR_ORDERS = {"1": False, "2": True, "3": True}
"""Whether east is first, by option 5 of the header."""
SDR_VERTICAL_READINGS = {
    "1": lambda reading: reading,
    "2": lambda reading: (math.pi / 2 - reading) % (2 * math.pi),
}
"""Zenith reading of a vertical one, by what the instrument (01) states: from zenith or horizon."""
INSTRUMENT_COLUMN = 49
"""Columns of the instrument (01) before its mount and the code of its vertical readings."""
NIKON_NUMBER_WIDTH = 10
"""Width of the three numbers at the end of an instrument of Nikon and Spectra: their names have a
column more, so mount and code are found from there."""
SDR_HEADER_PATTERN = re.compile(r"00..(SDR\s?\S+).*?([0-9]{6})\s*", re.ASCII)
COORDINATES = tuple(RecordField(t, "coordinate", read_length) for t in ("first", "second", "up"))
SDR_RECORDS = {
    "02": (
        RecordField("station", "station", read_name, default=NEEDED),
        *COORDINATES,
        RecordField("height", "height of the instrument", read_length, default=0.0),
    ),
    "03": (RecordField("height", "target height", read_length, default=0.0),),
    "07": (
        RecordField("station", "station", read_name, default=NEEDED),
        RecordField("target", "backsight", read_name, default=NEEDED),
        RecordField("azimuth", "azimuth", read_angle),
        RecordField("direction", "horizontal reading", read_angle),
    ),
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
    "10": "job",
    "11": "reduced observation, derived from 09",
    "12": "set, of which the marker alone is read",
    "13": "note, of which the unit of length and readings of resections are read",
}
"""Records that are not read, and why none is needed."""
BAD_SET = "2"
"""Marker of a set that is not to be used."""
RESECTION_NOTE = "Start of Resection"
SAME_CIRCLE = ANGLE["deg"] / 60
"""Readings of a backsight that differ by less are of one position of the circle: those of several
rounds differ by seconds."""
BAD_SETS = LeftOutReason("observations", "their set is marked as bad")
UNUSED_RESECTIONS = LeftOutReason(
    "readings of resections", "the resection was begun again, or no station follows"
)
TYPED_AZIMUTHS = LeftOutReason(
    "typed azimuths", "coordinates of held points orient the readings of the circle"
)
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
    """Read a field book of Sokkia, SDR33 or SDR2x, also those of Nikon, Spectra and Trimble.

    Read are stations (02), heights of targets (03), coordinates (08), observations (09 F1, F2, MD)
    and the units of the header; the instrument (01) states whether vertical readings begin at the
    zenith, and a note (13DU) whether feet are those of the USA. Coordinates of points are
    approximate ones, held where ``fixed`` names them; of several the first ones count.

    A backsight (07) is a reading of the circle where no observation of its set repeats it; one that
    states another backsight, or another reading of it, begins a set of directions of its own, since
    the circle was turned. So does a set (12); observations of a set that is marked as bad are left
    out. Readings of a resection, which Spectra writes as notes (13F1, 13F2), are a set of the
    station that follows; those of a resection that was begun again are left out.

    Prism constant and atmosphere are in the distances. Not needed and not read: atmosphere, scale,
    job, reduced and corrected observations (05, 06, 10, 11, 09 MC) and deleted records, which
    begin with DD. Other notes (13) are left out and counted; 04 with corrections other than 0 and
    all other records are refused.

    Tried on files of Sokkia SET5F, SET630RK, SET1030R3 and Spectra Focus 6.

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
    return reader.finish()


class _Reader:
    def __init__(self, book: FieldBook) -> None:
        self.book = book
        self.source = book.source
        self.name_width, self.number_width = 16, 16
        self.scales = Scales(angle=GON)
        self.length_option = ""
        self.east_first = False
        self.header = False
        self.vertical = "1"
        self.target_height = 0.0
        self.seen: dict[str, float | None] = {}
        """Direction, as in face 1, by target that the present set of directions has."""
        self.backsight: tuple[str, float] | None = None
        """Name and circle reading of the backsight of the present set."""
        self.bad: float = 0
        """Number of observations to come of a set that is marked as bad."""
        self.in_resection = False
        self.resection: list[tuple[int, str, dict[str, Any], float]] = []
        """Line, derivation, values and target height of readings that wait for their station."""

    def finish(self) -> Network:
        """Return the network."""
        self._drop_resection()
        return self.book.network()

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
            self._instrument(text)
        elif code == "11":
            self._reduced(line, text)
        elif code == "12":
            self._set(line, text)
        elif code == "13":
            self._note(line, derivation, text)
        elif code == "09" and derivation == "MC":
            self.source.leave_out(line, DERIVED_OBSERVATIONS, derivation)
        elif fields := self.source.field(line, code, "record").choice(SDR_TYPES):
            self._use(line, code, derivation, self._values(line, text, fields))

    def _values(self, line: int, text: str, fields: tuple[RecordField, ...]) -> dict[str, Any]:
        """Return the values of a record by their names."""
        widths = [self.name_width if f.read is read_name else self.number_width for f in fields]
        return read_record(fields, in_columns(text, widths, 4), self.source, line, self.scales)

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
                (1, "angles (1 degrees, 2 gon, 3 mil; 4 mil of Nikon)"),
                (2, "distances (1 metres, 2 feet, 3 US feet)"),
                (5, "coordinates (1 north first, 2 east first)"),
                (6, "angles (1 clockwise)"),
            )
        }
        options[6].choice({"1": 1})
        angles = NIKON_SDR_ANGLES if "V" in match[1] else SDR_ANGLES
        self.scales = Scales(
            options[2].choice(SDR_LENGTHS) or 1.0, options[1].choice(angles) or GON
        )
        self.length_option = str(options[2].value)
        self.east_first = bool(options[5].choice(SDR_ORDERS))

    def _instrument(self, text: str) -> None:
        """Note where vertical readings begin, which a column too many of a name moves."""
        at, text = INSTRUMENT_COLUMN + 1, text.rstrip()
        numbers = in_columns(text, [self.number_width] * 3, at + 1)
        end = len(text) - 3 * NIKON_NUMBER_WIDTH
        at_end = in_columns(text, [NIKON_NUMBER_WIDTH] * 3, end)
        shifted = end > at and any(len(n.split()) > 1 for n in numbers)
        if shifted and all(NUMBER_PATTERN.fullmatch(n.strip()) for n in at_end):
            at = end - 1
        self.vertical = text[at : at + 1].strip() or "1"

    def _reduced(self, line: int, text: str) -> None:
        """Leave out a reduced observation, or an azimuth that was typed, without distances."""
        begin = 4 + 2 * self.name_width + self.number_width
        distances = text[begin : begin + 2 * self.number_width].strip()
        why = DERIVED_OBSERVATIONS if distances else TYPED_AZIMUTHS
        self.source.leave_out(line, why, text[4 : 4 + 2 * self.name_width].strip())

    def _note(self, line: int, derivation: str, text: str) -> None:
        """Read what a note says about units, or a reading of a resection in it."""
        if derivation == "DU":
            said = "unit of length of a note (13DU: 1 metres, 2 feet, 3 US feet)"
            length = self.source.field(line, text[4:5], said).choice(SDR_LENGTHS)
            if length is None:
                return
            if text[4] != self.length_option and (self.length_option, text[4]) != ("2", "3"):
                what = f"{said} is {text[4]}, option 2 of the header {self.length_option}"
                self.source.wrong(line, f"{what}: correct one of them")
            self.scales = Scales(length, self.scales.angle)
        elif text[4:].strip() == RESECTION_NOTE:
            self._drop_resection()
            self.in_resection = True
        elif self.in_resection and derivation in SDR_FACES:
            values = self._values(line, text, SDR_RECORDS["09"])
            self.resection.append((line, derivation, values, self.target_height))
        else:
            self.source.leave_out(line, NOTES, text[4:].strip())

    def _drop_resection(self) -> None:
        """Leave out the readings of a resection that no station uses."""
        for line, _, values, _ in self.resection:
            self.source.leave_out(line, UNUSED_RESECTIONS, values["target"])
        self.resection = []
        self.in_resection = False

    # -- sets of directions ---------------------------------------------------------------------

    def _set(self, line: int, text: str) -> None:
        """Begin a set of directions; observations of one that is marked as bad are left out."""
        at = 4 + self.name_width
        self.bad = 0
        if self.name_width > 4 and text[at + 6 : at + 7] == BAD_SET:
            said = "number of observations of a set that is marked as bad"
            number = self.source.field(line, text[at : at + 3], said).integer(default=-1)
            self.bad = math.inf if number == -1 else number or 0
        self._begin_set(line)

    def _begin_set(self, line: int) -> None:
        """Begin another set of directions at the station, if the present one has sights."""
        at = self.book.current
        if at is not None and self.seen:
            self.book.begin(line, at.station, at.height)
        self.seen, self.backsight = {}, None

    def _turn(self, line: int, values: dict[str, Any]) -> None:
        """Read a backsight, which states the position of the circle."""
        name, direction = values["target"], values["direction"]
        if not self._is_here(line, values["station"]) or direction is None:
            return
        # It may begin a set or a round, or follow the observations from which it is derived.
        known = self.seen.get(name)
        if known is None and self.backsight is not None and self.backsight[0] == name:
            known = self.backsight[1]
        if known is not None and _is_same_circle(known, direction):
            if name in self.seen:
                self.book.backsight(line, name, direction)
            return
        self._begin_set(line)
        self.backsight = name, direction
        self.book.backsight(line, name, direction)

    def _is_here(self, line: int, station: str) -> bool:
        """Return whether the present set-up is at a station; another one is a problem."""
        at = self.book.current
        if at is not None and at.station == station:
            return True
        where = "before any station" if at is None else f"at {at.station!r}"
        if station:  # what is no name has been noted
            what = f"observation from {station!r} {where}: record 02 is missing"
            self.source.wrong(line, what)
        return False

    def _use(self, line: int, code: str, derivation: str, values: dict[str, Any]) -> None:
        """Use the values of a record."""
        if code == "03":
            self.target_height = values["height"]
        elif code == "04":
            if any(values.values()):
                what = "corrections of collimation other than 0 are not applied: read both faces"
                self.source.wrong(line, what)
        elif code == "07":
            self._turn(line, values)
        elif code == "09":
            if self.bad:
                self.bad -= 1
                self.source.leave_out(line, BAD_SETS, values["target"])
            else:
                self._observation(line, derivation, values, self.target_height)
        else:
            point = values["station" if code == "02" else "point"]
            first, second, up = (values[axis] for axis in ("first", "second", "up"))
            east, north = (first, second) if self.east_first else (second, first)
            self.book.point(line, point, east, north, up, agree=False)
            if code == "02":
                self._station(line, point, values["height"])

    def _station(self, line: int, name: str, height: float) -> None:
        """Begin a set-up, with the readings of its resection as its first set."""
        self.seen, self.backsight, self.bad = {}, None, 0
        self.book.begin(line, name, height)
        waiting, self.resection = self.resection, []
        self.in_resection = False
        for place, derivation, values, target_height in waiting:
            self._observation(place, derivation, {**values, "station": name}, target_height)
        self._begin_set(line)

    def _observation(
        self, line: int, derivation: str, values: dict[str, Any], target_height: float
    ) -> None:
        problems, book = self.source.problems.count, self.book
        face = self.source.field(line, derivation, "derivation of an observation").choice(SDR_FACES)
        if self.source.problems.count > problems or not self._is_here(line, values["station"]):
            return
        direction, vertical = values["direction"], values["vertical"]
        zenith = None
        if vertical is not None:
            what = "vertical readings of the instrument (1 zenith, 2 horizon)"
            turned = self.source.field(line, self.vertical, what).choice(SDR_VERTICAL_READINGS)
            zenith = math.nan if turned is None else turned(vertical)
        second_face = face == 2 or (face is None and zenith is not None and zenith > math.pi)
        self.seen.setdefault(
            values["target"],
            None if direction is None else direction + (math.pi if second_face else 0.0),
        )
        book.sight(
            line,
            values["target"],
            direction=direction,
            zenith=zenith,
            distance=values["distance"],
            target_height=target_height,
            face=face,
        )


def _is_same_circle(a: float, b: float) -> bool:
    """Return whether two readings of a backsight are of one position of the circle."""
    return abs(math.remainder(a - b, 2 * math.pi)) < SAME_CIRCLE


READER = Reader(
    "sdr33",
    (".sdr",),
    "Sokkia SDR33 or SDR2x",
    NetworkReader(read_sdr33),
    recognises=begins_with(rb"[\s\x02]*00[A-Z]{2}SDR ?(?:33|2)"),
)
