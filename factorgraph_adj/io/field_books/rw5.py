"""Reader of field books RW5 of Carlson SurvCE, and of the TDS files on which they are based.

Lines of fields between commas: the first is the type of record, each other one a header of two
letters with its value behind it, such as ``AR45.1731``; the headers of coordinates are ``N `` and
``E ``, with a blank. A field that begins with ``--`` is a note to the end of the line. Grammar:
Carlson Software, "SurvCE RW5 Format"; Tripod Data Systems, "TDS raw data".
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Literal

from ...errors import known
from ...network.network import Network
from ...units import ANGLE, FOOT, GON, US_SURVEY_FOOT
from ..format_options import option_text
from ..format_reader import NetworkReader, Reader, begins_with
from ..numbers import PACKED_DEGREES, checked_number
from ..source import NOTES, Field, LeftOutReason, TextSource
from .accuracies import DEFAULT_ACCURACIES, Accuracies
from .field_book import FieldBook
from .field_records import (
    NEEDED,
    SI,
    RecordField,
    Scales,
    read_angle,
    read_length,
    read_name,
    read_record,
)
from .stated_coordinates import MAX_COORDINATE_DIFFERENCE_M

RW5_BEGINNING = (
    rb"(?:\s*--[^\r\n]*[\r\n])*\s*(?:JB,NM|MO,(?:AD|UN|SF)|(?:OC|BK|SS|TR|BD|FD),OP|LS,H[IR]|"
    rb"(?:SP|GPS|BP),PN)[^=\r\n]*(?:[\r\n]|$)"
)
"""A record with its first field, which may follow notes."""
LENGTH_CODES = {"0": FOOT, "1": 1.0, "2": US_SURVEY_FOOT}
LENGTH_UNITS = {"m": 1.0, "ft": FOOT, "us-ft": US_SURVEY_FOOT}
ANGLE_CODES: dict[str, float | str] = {"0": PACKED_DEGREES, "1": GON}
ANGLE_UNITS: dict[str, float | str] = {"dms": PACKED_DEGREES, "gon": GON}
LengthUnit = Literal["m", "ft", "us-ft"]
AngleUnit = Literal["dms", "gon"]
BEARING_PATTERN = re.compile(r"([NS])(.*)([EW])")
BEARINGS = {"NE": (0.0, 1.0), "SE": (math.pi, -1.0), "SW": (math.pi, 1.0), "NW": (0.0, -1.0)}
"""Azimuth of a bearing: that of its meridian, and the sign of its angle."""
NOT_SIGHTED_ZENITH = math.pi / 2
"""Zenith reading that SurvCE writes beside a distance of 0 where nothing was measured."""
SAME_AZIMUTH = ANGLE["deg"] / 60


def _read_bearing(field: Field, scales: Scales = SI) -> float:
    """Return the azimuth of a bearing such as N12.3456W, radians; NaN after a problem."""
    found = BEARING_PATTERN.fullmatch(str(field.value))
    if found is None:
        field.wrong(f"must be a bearing such as N12.3456W, not {str(field.value)[:40]!r}")
        return math.nan
    begin, sign = BEARINGS[found[1] + found[3]]
    angle = Field(found[2], field.what, field.where, field.problems)
    return begin + sign * read_angle(angle, scales)


def _coordinates(name: str) -> tuple[RecordField, ...]:
    return (
        RecordField("point", "point", read_name, name, NEEDED),
        RecordField("north", "northing", read_length, "N"),
        RecordField("east", "easting", read_length, "E"),
        RecordField("up", "elevation", read_length, "EL"),
    )


DIRECTIONS = {
    "right": RecordField("right", "angle right", read_angle, "AR"),
    "left": RecordField("left", "angle left", read_angle, "AL"),
    "deflection_right": RecordField("deflection_right", "deflection right", read_angle, "DR"),
    "deflection_left": RecordField("deflection_left", "deflection left", read_angle, "DL"),
    "azimuth": RecordField("azimuth", "azimuth", read_angle, "AZ"),
    "bearing": RecordField("bearing", "bearing", _read_bearing, "BR"),
}
"""Fields of a sight of which one is the direction."""
SIGHT = (
    RecordField("station", "occupied point", read_name, "OP", NEEDED),
    RecordField("target", "foresight point", read_name, "FP", NEEDED),
    *DIRECTIONS.values(),
    RecordField("zenith", "zenith", read_angle, "ZE"),
    RecordField("vertical", "vertical angle", read_angle, "VA"),
    RecordField("change", "change of elevation", read_length, "CE"),
    RecordField("distance", "slope distance", read_length, "SD"),
    RecordField("horizontal", "horizontal distance", read_length, "HD"),
)
FACES = {"BD": 1, "FD": 1, "BR": 2, "FR": 2, "SS": None, "TR": None, "OB": None}
"""Face by type of record; None: it follows from the zenith reading."""
RW5_RECORDS = {
    "MO": (
        RecordField("south", "azimuths from (0 north, 1 south)", read_name, "AD"),
        RecordField("length", "unit of length (0 feet, 1 metres, 2 US feet)", read_name, "UN"),
        RecordField("angle", "unit of angles (0 degrees, 1 gon)", read_name, "AU"),
    ),
    "OC": _coordinates("OP"),
    "SP": _coordinates("PN"),
    "BK": (
        RecordField("station", "occupied point", read_name, "OP", NEEDED),
        RecordField("target", "back point", read_name, "BP"),
        RecordField("azimuth", "azimuth of the backsight", read_angle, "BS"),
        RecordField("circle", "circle reading of the backsight", read_angle, "BC"),
    ),
    "LS": (
        RecordField("height", "height of the instrument", read_length, "HI"),
        RecordField("target_height", "height of the rod", read_length, "HR"),
    ),
    **dict.fromkeys(FACES, SIGHT),
}
"""Fields by their headers, of each type of record."""
UNREAD_OF_MODE = ("SF", "EC", "EO")
"""Fields of MO that are not needed: readings are neither scaled nor corrected by them."""
GNSS_RECORDS = (
    *("GPS", "GS", "GT", "G0", "G1", "G2", "G3", "G4", "BP", "AH", "BL", "CG", "CS", "CT", "CV"),
    *("DG", "EE", "EP", "EQ", "ES", "GK", "GO", "GP", "GR", "HA", "PE", "PJ", "RP", "RX", "VA"),
)
OTHER_RECORDS = (
    "OF",
    "OE",
    "RE",
    "SU",
    "AP",
    "AT",
    "CF",
    "DE",
    "DL",
    "DP",
    "FC",
    "SD",
    "SK",
    "SL",
    "SR",
)
REPEATED_RECORDS = ("RB", "RD", "RF", "RS", "MD")
"""Records of TDS with readings of several sights each."""
RW5_TYPES = dict.fromkeys((*RW5_RECORDS, "JB", *OTHER_RECORDS, *GNSS_RECORDS), True)
GNSS = LeftOutReason(
    "records of GNSS", "sights of total stations alone are read: give vectors as GVX or DynaML"
)
OFFSETS = LeftOutReason(
    "records", "offsets, staking out, attributes and design are no readings of points"
)
NOT_MEASURED = LeftOutReason("zenith readings", "they are 90° beside a distance of 0")


def read_rw5(
    path: str | Path,
    *,
    length_unit: LengthUnit | None = None,
    angle_unit: AngleUnit | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read a field book RW5 of Carlson SurvCE, or of TDS.

    Read are points (OC, SP), heights of instrument and rod (LS), backsights (BK) and sights: SS,
    TR, and BD, BR, FD, FR of sets in both faces, with angle right (AR, the reading of the circle),
    left, deflections, azimuth or bearing; zenith or vertical angle; slope or horizontal distance.
    Units are those of MO; azimuths and angles to the right of one set-up are two sets. Heights of
    LS count until the next ones. Each OC begins a set-up.

    Coordinates are approximate ones, held where ``fixed`` names the point; of several, the last
    ones count, which SurvCE itself uses, and a remark names the largest differences. The circle
    reading of a backsight (BC) is a direction where no sight repeats it. A zenith of exactly 90°
    beside a distance of 0 was not measured, and is left out.

    Not needed and not read: job (JB), scale, curvature and EDM offset of MO, which concern computed
    coordinates, and notes, where SurvCE repeats means and checks. Left out and counted: records of
    GNSS (GPS, BP, …), offsets (OF), staking out, attributes. Changes of elevation (CE), and records
    of TDS with several sights (RB, RF, RD, RS, MD), are refused.

    Tried on a traverse of 19 legs, a file of Leica and 14 files of GNSS.

    Args:
        path: the file.
        length_unit: unit of lengths, where the file has no MO: m, ft (0.3048 m) or us-ft.
        angle_unit: dms, degrees-minutes-seconds as D.MMSS, or gon, instead of that of MO (AU),
            without which angles are dms.
        fixed: names of points that are held at the coordinates of the file; empty: a free network.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of the file, each with its line.
    """
    source = TextSource(path, code_page="cp1252")
    reader = _Reader(FieldBook(source, accuracies, fixed), length_unit, angle_unit)
    for line, text in source.filled():
        if (note := text.strip("\x1a\x00 \t")).startswith("--"):
            source.leave_out(line, NOTES, note.strip("- "))
        else:
            reader.read(line, note)
    return reader.finish()


class _Reader:
    def __init__(self, book: FieldBook, length: str | None, angle: str | None) -> None:
        self.book = book
        self.source = book.source
        self.angle_unit = angle
        self.length: float | None = None if length is None else LENGTH_UNITS[length]
        self.stated_length = length is not None
        self.scales = Scales(1.0, PACKED_DEGREES if angle is None else ANGLE_UNITS[angle])
        self.south = 0.0
        self.target_height = 0.0
        self.height: float | None = None
        self.circle, self.azimuth = 0.0, math.nan
        """Circle reading and azimuth of the present backsight."""
        self.by_azimuth: bool | None = None
        """Whether the sights of the present set are azimuths; None: it has none."""
        self.stated: dict[str, list[tuple[int, tuple[float, ...]]]] = {}
        """Lines and coordinates (east, north, elevation) by point."""

    def finish(self) -> Network:
        """Return the network."""
        self._use_coordinates()
        return self.book.network()

    def read(self, line: int, text: str) -> None:
        """Read a record."""
        code, *words = text.split(",")
        code = code.strip()
        if code in REPEATED_RECORDS:
            what = f"record {code!r} has readings of several sights, and is not read: give each "
            self.source.wrong(line, f"{what}as BD, BR, FD or FR, as SurvCE writes them")
            return
        if self.source.field(line, code, "record").choice(RW5_TYPES) is None:
            return
        if code == "JB":
            return
        given = self._by_header(line, words)
        name = next((given[k] for k in ("PN", "FP", "OP") if k in given), code)
        if code in GNSS_RECORDS:
            self.source.leave_out(line, GNSS, name)
        elif code not in RW5_RECORDS:
            self.source.leave_out(line, OFFSETS, name)
        else:
            self._record(line, code, given)

    def _by_header(self, line: int, words: list[str]) -> dict[str, str]:
        """Return the values of fields by their headers, without the note."""
        out: dict[str, str] = {}
        for number, word in enumerate(words):
            field = word.lstrip()
            if field.startswith("--"):
                if note := ",".join(words[number:]).strip("- "):
                    self.source.leave_out(line, NOTES, note)
                break
            if not field.strip():
                continue
            header = field[:2].strip()
            if header in out:
                self.source.wrong(line, f"field {header!r} stands twice")
            out[header] = field[2:]
        return out

    def _record(self, line: int, code: str, given: dict[str, str]) -> None:
        if code != "MO":
            self._need_length(line)
        values = read_record(
            RW5_RECORDS[code],
            given,
            self.source,
            line,
            self.scales,
            unread=UNREAD_OF_MODE if code == "MO" else (),
        )
        if code == "MO":
            self._mode(line, values)
        elif code == "LS":
            self._heights(values)
        elif code in ("OC", "SP"):
            given_place = (values[axis] for axis in ("east", "north", "up"))
            place = tuple(math.nan if v is None else v for v in given_place)
            self.stated.setdefault(values["point"], []).append((line, place))
            self.book.point(line, values["point"])
            if code == "OC":
                self.book.begin(line, values["point"], self.height)
                self.circle, self.azimuth, self.by_azimuth = 0.0, math.nan, None
        elif code == "BK":
            self._backsight(line, given, values)
        elif code in FACES:
            self._sight(line, code, values)

    def _need_length(self, line: int) -> None:
        """Note once that the file does not state its unit of length."""
        if self.length is not None:
            self.scales = Scales(self.length, self.scales.angle)
            return
        self.length = 1.0
        what = "the unit of length is missing: no record MO is before; give "
        self.source.wrong(line, what + option_text("length_unit", "m") + ", ft or us-ft")

    def _mode(self, line: int, values: dict[str, Any]) -> None:
        def chosen(name: str, what: str, table: dict[str, Any], default: Any) -> Any:
            return self.source.field(line, values[name], what).choice(table, default=default)

        length = chosen("length", "unit of length (UN)", LENGTH_CODES, None)
        if length is not None and not self.stated_length:
            self.length = length
        angle = chosen("angle", "unit of angles (AU)", ANGLE_CODES, PACKED_DEGREES)
        if self.angle_unit is not None:
            angle = ANGLE_UNITS[self.angle_unit]
        self.scales = Scales(self.length or 1.0, angle or PACKED_DEGREES)
        self.south = chosen("south", "azimuths from (AD)", {"0": 0.0, "1": math.pi}, 0.0) or 0.0

    def _heights(self, values: dict[str, Any]) -> None:
        if values["target_height"] is not None:
            self.target_height = values["target_height"]
        if values["height"] is not None:
            self.height = values["height"]
            if self.book.current is not None:
                # It holds for the sights that follow, on the same position of the circle.
                self.book.current.height = self.height

    def _backsight(self, line: int, given: dict[str, str], values: dict[str, Any]) -> None:
        if not self._is_here(line, values["station"]):
            return
        if self.by_azimuth is not None:
            self._begin_set(line)
        self.circle = values["circle"] or 0.0
        azimuth = values["azimuth"]
        self.azimuth = math.nan if azimuth is None else azimuth + self.south
        target = values["target"]
        if target:
            self._check_unit(line, given.get("BS", ""), values["station"], target)
            self.book.backsight(line, target, values["circle"])

    def _check_unit(self, line: int, text: str, station: str, target: str) -> None:
        """Refuse gon where coordinates say that the azimuth of a backsight is in D.MMSS.

        Nikon's export for TDS states AU1 beside angles in degrees.
        """
        if self.scales.angle != GON or self.angle_unit is not None or self.azimuth != self.azimuth:
            return
        ends = [self.stated[n][-1][1] for n in (station, target) if n in self.stated]
        if len(ends) < 2:
            return
        computed = math.atan2(ends[1][0] - ends[0][0], ends[1][1] - ends[0][1])
        field = self.source.field(line, text, "azimuth of the backsight")
        in_degrees = _packed(field)
        if in_degrees is None or not _is_near(in_degrees + self.south, computed):
            return
        if not _is_near(self.azimuth, computed):
            what = f"the angles are in degrees, not gon (AU1): BS{text.strip()} in D.MMSS is the "
            what += f"azimuth from {station!r} to {target!r} by their coordinates; give "
            self.source.wrong(line, what + option_text("angle_unit", "dms"))

    def _is_here(self, line: int, station: str) -> bool:
        """Return whether the present set-up is at a station; another one is a problem."""
        at = self.book.current
        if at is not None and at.station == station:
            return True
        if station:  # what is no name has been noted
            where = "before any OC" if at is None else f"at {at.station!r}"
            self.source.wrong(line, f"a reading from {station!r} {where}: record OC is missing")
        return False

    def _begin_set(self, line: int) -> None:
        """Begin another set of directions at the station."""
        at = self.book.current
        if at is not None:
            self.book.begin(line, at.station, at.height)
        self.by_azimuth = None

    # -- sights ---------------------------------------------------------------------------------

    def _direction(self, line: int, values: dict[str, Any]) -> float | None:
        """Return the reading of the circle, or the azimuth, of a sight; None where it has none."""
        found = [name for name in DIRECTIONS if values[name] is not None]
        if len(found) > 1:
            what = known([DIRECTIONS[n].what for n in found])
            self.source.wrong(line, f"has {what}; valid: one of them")
        if not found:
            return None
        name, angle = found[0], values[found[0]]
        by_azimuth = name in ("azimuth", "bearing")
        if self.by_azimuth is not None and by_azimuth != self.by_azimuth:
            self._begin_set(line)
        self.by_azimuth = by_azimuth
        if name == "azimuth":
            return float(angle + self.south)
        back = {"left": -angle, "deflection_right": math.pi + angle}
        back["deflection_left"] = math.pi - angle
        # All but angles to the right, which are readings, are measured from the backsight.
        return float(self.circle + back[name] if name in back else angle) % (2 * math.pi)

    def _sight(self, line: int, code: str, values: dict[str, Any]) -> None:
        if not self._is_here(line, values["station"]):
            return
        if values["change"] is not None:
            what = "change of elevation (CE) is not read: give zenith (ZE) or vertical angle (VA)"
            self.source.wrong(line, what)
        for one, other in (("zenith", "vertical"), ("distance", "horizontal")):
            if values[one] is not None and values[other] is not None:
                self.source.wrong(line, f"has {one} and {other}; valid: one of them")
        zenith, vertical = values["zenith"], values["vertical"]
        if zenith is not None and not (math.isnan(zenith) or 0.0 <= zenith < 2 * math.pi):
            what = "zenith (ZE) must be of the circle, not below 0 and less than 360 degrees or "
            self.source.wrong(line, f"{what}400 gon: correct the line, or take it out")
            return
        if vertical is not None:
            zenith = (math.pi / 2 - vertical) % (2 * math.pi)
        if zenith == NOT_SIGHTED_ZENITH and values["distance"] == 0.0:
            self.source.leave_out(line, NOT_MEASURED, values["target"])
            zenith = None
        self.book.sight(
            line,
            values["target"],
            direction=self._direction(line, values),
            zenith=zenith,
            distance=values["distance"],
            horizontal=values["horizontal"],
            target_height=self.target_height,
            face=FACES[code],
        )

    # -- coordinates ----------------------------------------------------------------------------

    def _use_coordinates(self) -> None:
        """Give the points their last coordinates, and say which are stated with other values."""
        changed = {}
        for name, stated in self.stated.items():
            line = stated[-1][0]
            last = [
                next((v for v in reversed(axis) if v == v), math.nan)
                for axis in zip(*(place for _, place in stated), strict=True)
            ]
            self.book.point(line, name, *last)
            apart = [
                (abs(a - b), at)
                for at, place in stated
                for a, b in zip(place, last, strict=True)
                if a == a and b == b
            ]
            largest = max(apart, default=(0.0, line))
            if largest[0] > MAX_COORDINATE_DIFFERENCE_M:
                changed[name] = largest
        if changed:
            shown = [
                f"{name} by {d:.4f} m ({self.source.place(at)})"
                for name, (d, at) in sorted(changed.items(), key=lambda item: -item[1][0])
            ]
            n = "1 point" if len(changed) == 1 else f"{len(changed)} points"
            what = f"coordinates of {n} are stated again with other values, of which the last count"
            self.source.problems.remarks.append(f"{what}; they differ in {known(shown, most=5)}")


def _packed(field: Field) -> float | None:
    """Return an angle in D.MMSS, radians; None where a text is none."""
    try:
        return checked_number(field.value, field.what, PACKED_DEGREES)
    except ValueError:
        return None


def _is_near(a: float, b: float) -> bool:
    return abs(math.remainder(a - b, 2 * math.pi)) < SAME_AZIMUTH


READER = Reader(
    "rw5",
    (".rw5", ".raw"),
    "Carlson RW5 or TDS",
    NetworkReader(read_rw5),
    recognises=begins_with(RW5_BEGINNING),
)
