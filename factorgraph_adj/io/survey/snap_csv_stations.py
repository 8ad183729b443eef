"""Stations of SNAP in delimited text, with a format definition file.

Format: LINZ, SNAP help, "CSV format station coordinate files", and ``snapcsvstn.cpp`` of the
program (BSD-3).
"""

from __future__ import annotations

import math
import re
from pathlib import Path

from ...units import ANGLE, ARCSEC
from ..numbers import PACKED_DEGREES
from ..source import Field, TextSource
from .snap_coordinates import (
    SnapStations,
    StationRow,
    StationRows,
    dms_angle,
    read_station_system,
    stations_of_rows,
)
from .snap_csv_formats import CsvDefinition, CsvRow, CsvValue, class_columns
from .snap_data_commands import Angles
from .snap_systems import SystemCode

ANGLE_FORMATS: dict[str, Angles] = {
    **dict.fromkeys(("degrees", "deg", "deg_angles"), "deg"),
    **dict.fromkeys(("dms", "dms_angles"), "dms"),
    **dict.fromkeys(("hp", "hp_angles"), "hp"),
}
HEMISPHERES = {"latitude": "NS", "longitude": "EW"}
_DMS = re.compile(r"([-A-Z]?)\s*(\d+)\s+(\d+)\s+(\d+(?:\.\d*)?)\s*([A-Z]?)", re.IGNORECASE)
"""An angle in degrees, minutes and seconds, with a sign before or the hemisphere at an end."""

COMMANDS = {
    "code": "code",
    "name": "name",
    **dict.fromkeys(("longitude", "easting", "x"), "first"),
    **dict.fromkeys(("latitude", "northing", "y"), "second"),
    **dict.fromkeys(("height", "z"), "third"),
    "geoid_undulation": "undulation",
    # The program takes the one called east as ξ, which is positive to the north.
    "deflection_east": "xi",
    "deflection_north": "eta",
    "coordinate_system": "system",
    "height_type": "heights",
}
"""Values of a station by their commands."""
NAMES_OF_AXES = {
    "geodetic": ("longitude", "latitude", "height"),
    "projection": ("easting", "northing", "height"),
    "geocentric": ("X", "Y", "Z"),
}
ORTHOMETRIC = {"ellipsoidal": False, "orthometric": True}


def text_angle(given: Field, form: Angles, signs: str) -> float:
    """Return the angle of a field, radians; NaN after a problem.

    Args:
        given: the field.
        form: its form.
        signs: letters of the hemispheres where it is positive and negative; empty: none has a sign.
    """
    if form == "deg":
        return given.number(scale=ANGLE["deg"])
    least = -math.inf if signs else 0.0
    if form == "hp":
        return given.number(PACKED_DEGREES, least=least)
    found = _DMS.fullmatch(str(given.value or ""))
    letters = "" if found is None else (found[1] + found[5]).upper()
    if found is None or letters not in ("", *(("-", *signs) if signs else ())):
        ends = f", with {' or '.join(signs)}" if signs else ""
        shown = f"must be such as 41 28 15.8{ends}, not {str(given.value)[:40]!r}"
        given.wrong("is missing" if given.is_absent else shown)
        return math.nan
    parts = [Field(found[i], given.what, given.where, given.problems) for i in (2, 3, 4)]
    angle = dms_angle(parts)
    return -angle if letters and letters in f"-{signs[1:]}" else angle


class _CsvStations:
    """Reads the records of a file of stations."""

    def __init__(self, source: TextSource, definition: CsvDefinition) -> None:
        """Take what the format definition states."""
        self.source = source
        self.definition = definition
        self.values: dict[str, CsvValue] = {}
        self.classes: dict[str, CsvValue] = {}
        self.class_columns: list[str] = []
        self.angles: Angles = "deg"
        self.system: SystemCode | None = None
        self.code_of_system = ""
        self.orthometric: bool | None = None
        self.rows = StationRows(source)
        for stated in definition.lines:
            if stated.name == "angle_format":
                self.angles = definition.setting(stated).choice(ANGLE_FORMATS) or self.angles
            elif stated.name == "classification":
                name, value = definition.named(stated)
                self.classes[name] = value
            elif stated.name == "classification_columns":
                self.class_columns += definition.class_columns(stated)
            else:
                named = definition.source.field(stated.line, stated.name, "command")
                part = named.choice(COMMANDS)
                if part is not None:
                    self.values[part] = definition.value(stated)
        for needed in ("code", "first", "second", "system"):
            if needed not in self.values:
                commands = " or ".join(c for c, p in COMMANDS.items() if p == needed)
                definition.source.wrong(0, f"stations need {commands}")

    def read(self, row: CsvRow) -> bool:
        """Read a record; return whether the next can be read."""
        system = self._read_system(row)
        if system is None:
            return False
        before = row.source.problems.count
        names = NAMES_OF_AXES[system.system.form]
        first, second, third = (
            row.field(self.values.get(part), name)
            for part, name in zip(("first", "second", "third"), names, strict=True)
        )
        if system.system.form == "geodetic":
            signs = [HEMISPHERES[name] for name in ("latitude", "longitude")]
            phi = text_angle(second, self.angles, signs[0])
            coordinates = [phi, text_angle(first, self.angles, signs[1]), third.number()]
            if abs(phi) > math.pi / 2:
                second.wrong("must be from -90 to 90 degrees")
        else:
            coordinates = [f.number() for f in (first, second, third)]
        geoid = [
            row.field(self.values.get(part), part).number(scale=unit, default=0.0)
            for part, unit in (("xi", ARCSEC), ("eta", ARCSEC), ("undulation", 1.0))
        ]
        code = row.field(self.values.get("code"), "code of a station").name()
        name = row.field(self.values.get("name"), "name").name(default=code)
        classes = class_columns(self.class_columns, row)
        for cls, value in self.classes.items():
            text = value.text(row).strip()
            classes |= {cls: text} if text else {}
        if row.source.problems.count == before:
            found = StationRow(row.line, code, coordinates, geoid, tuple(classes.items()), name)
            self.rows.add(found)
        return True

    def _read_system(self, row: CsvRow) -> SystemCode | None:
        """Return the system, which all records have with the same sort of heights."""
        code = self.values["system"].text(row)
        if self.system is None:
            self.code_of_system = code
            self.system = read_station_system(row.source, row.line, code)
            if self.system is None:
                return None
            if self.system.vertical and "undulation" not in self.values:
                row.source.wrong(
                    row.line,
                    f"geoid heights of {self.system.vertical} are in a grid of SNAP that is not "
                    "read; valid: geoid heights and deflections in this file",
                )
        elif code != self.code_of_system:
            row.source.wrong(
                row.line,
                f"is in {code}, and stations before in {self.code_of_system}: one is valid",
            )
        usual = "orthometric" if self.system.vertical else "ellipsoidal"
        stated = row.field(self.values.get("heights"), "type of heights")
        stated.value = str(stated.value or "").lower()
        heights = stated.choice(ORTHOMETRIC, default=ORTHOMETRIC[usual])
        if self.orthometric is None:
            self.orthometric = heights
        elif heights is not None and heights != self.orthometric:
            stated.wrong("differs from that of stations before: one is valid")
        return self.system


def read_csv_stations(path: Path, definition: CsvDefinition) -> SnapStations | None:
    """Return the stations of a file of delimited text; None after a problem of its form.

    Args:
        path: the file.
        definition: its format.
    """
    problems = definition.source.problems
    before = problems.count
    source = TextSource(path, problems, code_page="cp1252")
    reader = _CsvStations(source, definition)
    if problems.count > before:
        return None
    for row in definition.rows(source):
        if not reader.read(row):
            return None
    if reader.system is None:
        if problems.count == before:
            source.wrong(0, "has no stations")
        return None
    system = reader.system.system
    orthometric = bool(reader.orthometric) and system.form != "geocentric"
    made = stations_of_rows(source, system, reader.rows, orthometric=orthometric)
    return SnapStations(system, f"Read from {path.name}", made)
