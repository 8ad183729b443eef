"""Reader of Nikon's field books RAW V2.00, which Ruide, Trimble M3 and Spectra Focus write, too.

Lines of values between commas; the first value is the type of record. Units and directions of the
circles stand in comments (CO). Grammar: Nikon, "DTM-330 instruction manual", p. 7-5 and 7-6, and
Trimble, "M3 user guide", appendix B9.2, which have the same tables.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ...errors import known
from ...network.network import Network
from ...units import ANGLE, FOOT, GON, US_SURVEY_FOOT
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader, begins_with
from ..numbers import PACKED_DEGREES
from ..source import NOTES, ROWS_SWITCHED_OFF, Field, LeftOutReason, TextSource
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook, name_list
from .field_records import (
    SI,
    RecordField,
    Scales,
    read_angle,
    read_length,
    read_name,
    read_record,
)

NIKON_LENGTHS = {"Metres": 1.0, "Meters": 1.0, "Feet": FOOT, "Feet US": US_SURVEY_FOOT}
"""Metres of ``Dist Units``; the foot of 0.3048 m is ``Feet``, that of the USA ``Feet US``."""
NIKON_ANGLES: dict[str, float | str] = {
    "Gons": GON,
    "DDDMMSS": PACKED_DEGREES,
    "MIL": math.pi / 3200,
    "Dec.Degrees": ANGLE["deg"],
    "Degrees": ANGLE["deg"],
}
"""Radians of ``Angle Units``; DDDMMSS are written as D.MMSS."""
NIKON_ZENITHS = {
    "Zenith": lambda reading, face: reading,
    "Horizon": lambda reading, face: (math.pi / 2 - reading) % (2 * math.pi),
    "Compass": lambda reading, face: (
        math.pi / 2 - reading if face == 1 else 3 * math.pi / 2 + reading
    ),
}
"""Zenith reading by ``Zero VA``: readings of 360° from the zenith, or from the horizon, or
elevations, which are the same in both faces."""
NIKON_ORDERS = {"NEZ": False, "ENZ": True, "XYZ": False, "YXZ": True}
"""Whether east is first by ``Coord Order``; X of Nikon is north."""
NIKON_SETTINGS: dict[str, Mapping[str, Any]] = {
    "Dist Units": NIKON_LENGTHS,
    "Angle Units": NIKON_ANGLES,
    "Zero VA": NIKON_ZENITHS,
    "VA": NIKON_ZENITHS,
    "Coord Order": NIKON_ORDERS,
}
"""Settings in comments, and their words; Ruide writes VA for Zero VA."""
SETTING_PATTERN = re.compile(rf"({'|'.join(NIKON_SETTINGS)})\s*:\s*(.*)")
CIRCLE_PATTERN = re.compile(r"TI\s.*\bHz\b")
"""Comment of the M3: the circle was turned."""
HEIGHT_PATTERN = re.compile(r"TI\s.*\bih\s+(\S+) m\b")
"""Comment of the M3 with the height of the instrument."""
CLOCK_PATTERN = re.compile(r"\s*[0-9]{1,2}:[0-9]{2}:[0-9]{2}\s*")
NIKON_BEGINNING = rb"[\s\x00-\x1f]*(?:CO,[^\r\n]*[\r\n]+)+?CO,\s*(?:Dist|Angle) Units\s*:"
"""Comments (CO), one of which states a unit."""
SAME_CIRCLE = 0.02 * GON
"""Readings of a backsight that differ by less are of one position of the circle."""

WITHOUT_TARGET = LeftOutReason("sights", "neither they nor the station (ST) name a target")


def read_clock(field: Field, scales: Scales = SI) -> str:
    """Return the time of a sight, which is not used; '' after a problem."""
    if CLOCK_PATTERN.fullmatch(str(field.value)):
        return str(field.value)
    field.wrong(f"must be hh:mm:ss, not {str(field.value)[:40]!r}")
    return ""


def read_anything(field: Field, scales: Scales = SI) -> str:
    """Return a text that is not used."""
    return str(field.value)


def _reading(*after: RecordField) -> tuple[RecordField, ...]:
    """Return the fields of a sight behind its names, and those after them."""
    return (
        RecordField("target_height", "target height", read_length),
        RecordField("distance", "slope distance", read_length),
        RecordField("direction", "horizontal reading", read_angle),
        RecordField("vertical", "vertical reading", read_angle),
        *after,
    )


POINT = RecordField("point", "point", read_name)
IDENTIFIER = RecordField("identifier", "identifier of the point", read_name)
CODE = RecordField("code", "code", read_anything)
CLOCK = RecordField("clock", "time", read_clock)
COORDINATE_FIELDS = (
    POINT,
    IDENTIFIER,
    *(RecordField(name, "coordinate", read_length) for name in ("first", "second", "up")),
    CODE,
)
COORDINATE_RECORDS = ("UP", "MP", "MC", "CC", "RE")
"""Points that were uploaded, typed (two codes), calculated, or found by resection."""
CALCULATED_RECORDS = ("CC", "RE")
"""Results of the instrument, which need not agree with other coordinates of a point."""
NIKON_RECORDS = {
    **dict.fromkeys(COORDINATE_RECORDS, COORDINATE_FIELDS),
    "ST": (
        POINT,
        IDENTIFIER,
        RecordField("backsight", "backsight", read_name),
        RecordField("backsight_identifier", "identifier of the backsight", read_name),
        RecordField("height", "height of the instrument", read_length),
        RecordField("azimuth", "azimuth of the backsight", read_angle),
        RecordField("direction", "horizontal reading of the backsight", read_angle),
    ),
    **dict.fromkeys(("F1", "F2"), (POINT, *_reading(CLOCK))),
    # An edited line without a time has its code there.
    "SS": (POINT, *_reading(RecordField("clock", "time", read_anything), CODE)),
    "SO": (
        POINT,
        RecordField("staked", "point that is staked out", read_anything),
        *_reading(CLOCK, RecordField("nothing", "end of the line", read_anything)),
    ),
    "CP": (POINT, IDENTIFIER, *_reading(CLOCK, CODE)),
}
"""Fields behind the type of record."""
NIKON_TYPES: dict[str, tuple[RecordField, ...]] = {"CO": (), **NIKON_RECORDS}


def read_nikon_raw(
    path: str | Path,
    *,
    station: str | Iterable[str] = (),
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book of Nikon RAW V2.00, also those of Ruide, Trimble M3 and Spectra Focus.

    Read are points (UP, MP, MC, CC, RE), set-ups (ST) and sights: F1 and F2 of the orientation of a
    set-up, side shots (SS), points that were staked out (SO) and control points (CP). Units, order
    of coordinates and zero of vertical readings are those of the comments, in which the instrument
    states them. Points that were calculated (CC, RE) are approximate ones; those that were uploaded
    or typed must agree. Coordinates are held where ``fixed`` names the point.

    The reading of the backsight in ST is a sight of a set-up, unless F1 or F2 repeats it. Where F1
    to the backsight has another reading, the circle was turned after it: F1 and F2 are then a set
    of directions of their own, and the other sights are oriented by the reading in ST.

    The M3 may measure without a station: its comments ``TI`` have height of instrument and a
    turning of the circle, which begin a set-up, and ``station`` names the points of them.

    Not needed and not read: azimuth of the backsight, times, codes, comments ``TI`` that repeat
    readings; prism constant and atmosphere are in the distances. All other comments are left out
    and counted as notes, and so are lines that begin with an asterisk, which are deleted in the
    instrument, and sights of an orientation without the name of a target.

    Tried on files of Nikon DTM-330, NPL-350 and NPL-352, Trimble M3 and Ruide R2.

    Args:
        path: the file.
        station: names of the points of set-ups, in their order, of a file without stations.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    reader = _Reader(FieldBook(source, accuracies, fixed), name_list(station))
    for line, text in source.filled():
        reader.read(line, text.strip("\x02\x03\x1a\x00 \t"))
    return reader.finish()


class _Reader:
    def __init__(self, book: FieldBook, stations: tuple[str, ...]) -> None:
        self.book = book
        self.source = book.source
        self.settings: dict[str, Any] = {}
        self.stations = stations
        self.nameless: list[int] = []
        """Lines of set-ups that no ST begins."""
        self.at: dict[str, Any] | None = None
        """Station of the set-up: values of ST, or of the comments of an M3."""
        self.height: float | None = None
        """Height of the instrument in a comment."""
        self.circle_turned = False
        self.orientation: list[tuple[int, str, dict[str, Any]]] = []
        """Sights F1 and F2 of the set-up that wait for the first of another type."""

    def read(self, line: int, text: str) -> None:
        """Read a line."""
        if not text:
            return
        code, _, rest = text.partition(",")
        code = code.strip()
        if code.startswith("*"):
            self.source.leave_out(line, ROWS_SWITCHED_OFF, rest.split(",")[0].strip())
            return
        fields = self.source.field(line, code, "record").choice(NIKON_TYPES)
        if code == "CO":
            self._comment(line, rest.strip())
        elif fields:
            self._record(line, code, rest.split(","), fields)

    def finish(self) -> Network:
        """Return the network."""
        self._use_orientation(None)
        if self.nameless:
            lines = ", ".join(map(str, self.nameless))
            several = len(self.nameless) > 1
            said = f"set-ups begin in the lines {lines}" if several else "one set-up begins here"
            if len(self.stations) != len(self.nameless):
                n = len(self.nameless)
                example = ",".join(f"S{i}" for i in range(1, n + 1))
                what = f"{said}, without a station (ST): give {option_text('station', example)}, "
                what += f"{n} names in their order" if several else "its name"
                what += f", not {known(self.stations)}" if self.stations else ""
                self.source.wrong(self.nameless[0], what)
        elif self.stations:
            self.source.wrong(1, "station: every set-up of the file has a station (ST)")
        return self.book.network()

    # -- comments -------------------------------------------------------------------------------

    def _comment(self, line: int, text: str) -> None:
        if found := SETTING_PATTERN.fullmatch(text):
            name = "Zero VA" if found[1] == "VA" else found[1]
            self.settings[name] = self.source.field(line, found[2], name).choice(
                NIKON_SETTINGS[name]
            )
        elif not text.startswith("TI ") and text:
            self.source.leave_out(line, NOTES, text)
        if CIRCLE_PATTERN.match(text):
            self.circle_turned = True
        if found := HEIGHT_PATTERN.match(text):
            height = self.source.field(line, found[1], "ih").number()
            self.circle_turned |= self.height is not None and height != self.height
            self.height = height

    def _setting(self, line: int, name: str) -> Any:
        """Return the value of a setting; one that is missing is a problem, which is noted once."""
        if name not in self.settings:
            valid = known(NIKON_SETTINGS[name])
            self.source.wrong(line, f"comment 'CO,{name}: …' is missing before; valid: {valid}")
            self.settings[name] = None
        return self.settings[name]

    # -- records --------------------------------------------------------------------------------

    def _record(self, line: int, code: str, texts: list[str], fields: Any) -> None:
        length = self._setting(line, "Dist Units")
        angle = GON
        if code not in COORDINATE_RECORDS:
            angle = self._setting(line, "Angle Units") or GON
        values = read_record(fields, texts, self.source, line, Scales(length or 1.0, angle))
        name = values["point"] or values.get("identifier") or ""
        if code in COORDINATE_RECORDS:
            east_first = self._setting(line, "Coord Order")
            a, b = values["first"], values["second"]
            east, north = (a, b) if east_first else (b, a)
            self._named(line, name)
            self.book.point(
                line, name, east, north, values["up"], agree=code not in CALCULATED_RECORDS
            )
        elif code == "ST":
            self._use_orientation(None)
            self._named(line, name)
            values["point"] = name
            values["backsight"] = values["backsight"] or values["backsight_identifier"] or ""
            self.at = values
            self.circle_turned = False
            self.height = None
            self.book.begin(line, name, values["height"])
        elif code in ("F1", "F2"):
            name = name or (self.at["backsight"] if self.at else "")
            self.orientation.append((line, name, {**values, "face": int(code[1])}))
        else:
            self._use_orientation(line)
            if self.circle_turned or self.at is None:
                self._begin_without_record(line)
            self._named(line, name)
            self._sight(line, name, values)

    def _named(self, line: int, name: str) -> None:
        self.source.field(line, name, "point").name()

    def _begin_without_record(self, line: int) -> None:
        """Begin a set-up whose circle was turned, or which an M3 has without a station."""
        self.circle_turned = False
        if self.at is not None and "azimuth" in self.at:
            height = self.at["height"] if self.height is None else self.height
            self.at = {**self.at, "height": height}
        else:
            i = len(self.nameless)
            self.nameless.append(line)
            # Without a name of its own the set-up has one that the problem of `finish` replaces.
            name = self.stations[i] if i < len(self.stations) else "?"
            self.at = {"point": name, "backsight": "", "height": self.height}
        self.book.begin(line, self.at["point"], self.at["height"])

    def _use_orientation(self, line: int | None) -> None:
        """Use the sights of the orientation, and the reading of the backsight of the station.

        Args:
            line: line of the first sight after the orientation; None: there is none.
        """
        at, sights = self.at, self.orientation
        waits = at is not None and not at.get("oriented", False)
        if at is not None:
            at["oriented"] = True
        self.orientation = []
        turned = False
        for where, name, values in sights:
            if not name:
                self.source.leave_out(where, WITHOUT_TARGET, at["point"] if at else "")
                continue
            if at is not None and name == at["backsight"]:
                turned |= not _is_same_circle(values, at.get("direction"))
            self._sight(where, name, values)
        if line is None or not waits or at is None or not at["backsight"]:
            return
        repeated = any(name == at["backsight"] for _, name, _ in sights)
        if turned or (sights and not repeated):
            self.book.begin(line, at["point"], at["height"])
        self.book.backsight(line, at["backsight"], at.get("direction"))

    def _sight(self, line: int, name: str, values: dict[str, Any]) -> None:
        vertical, face = values["vertical"], values.get("face")
        zenith = None
        if vertical is not None:
            turned = self._setting(line, "Zero VA")
            zenith = math.nan if turned is None else turned(vertical, face or 1)
        self.book.sight(
            line,
            name,
            direction=values["direction"],
            zenith=zenith,
            distance=values["distance"],
            target_height=values["target_height"],
            face=face,
        )


def _is_same_circle(values: dict[str, Any], stated: float | None) -> bool:
    """Return whether the reading of a backsight is that of the station, in either face."""
    if stated is None or values["direction"] is None:
        return True
    difference = values["direction"] - stated - (math.pi if values["face"] == 2 else 0.0)
    return abs(math.remainder(difference, 2 * math.pi)) < SAME_CIRCLE


READER = Reader(
    "nikon_raw",
    (".raw", ".sdr"),
    "Nikon RAW V2.00",
    NetworkReader(read_nikon_raw),
    recognises=begins_with(NIKON_BEGINNING),
)
