"""Observations of SNAP in delimited text, with a format definition file.

Format: LINZ, SNAP help, "CSV observation file format", and ``snapcsvobs.cpp`` of the program
(BSD-3).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import datetime, timedelta
from pathlib import Path

from ...units import ANGLE, ARCSEC
from ..source import Field, TextSource, is_unread
from .snap_csv_formats import CsvDefinition, CsvRow, CsvValue, DefinitionLine, class_columns
from .snap_csv_stations import ANGLE_FORMATS, text_angle
from .snap_data_commands import (
    BEARING_ERROR,
    BEARINGS,
    DISTANCE_SCALE,
    DISTANCES,
    ERROR_UNITS,
    ERRORS_OF_KINDS,
    KINDS,
    POINT_KINDS,
    REFERENCE_FRAME,
    REFRACTION,
    VECTOR_KINDS,
    Angles,
    SnapErrors,
    kind_of,
    stated_errors,
)
from .snap_lines import MONTHS
from .snap_readings import ANGLES, DEFAULT, SnapReading, SnapSet

VALUES = (
    *("type", "set_id", "instrument_station", "instrument_height", "target_station"),
    *("target_height", "value", "error", "error_factor", "datetime", "projection", "id", "note"),
    "rejected",
)
"""Commands that state a value of an observation."""
NEEDED = ("type", "instrument_station", "value", "error")
CLASSES = {
    "reference_frame": REFERENCE_FRAME,
    "refraction_coefficient": REFRACTION,
    "bearing_orientation_error": BEARING_ERROR,
    "distance_scale_factor": DISTANCE_SCALE,
}
"""Commands that state a classification of parameters."""
CALCULATED = "calculated"
FORMS_OF_ERRORS = {"value": "value", "error": "value", CALCULATED: CALCULATED}
KINDS_OF_ERRORS = {
    "distance_error_type": DISTANCES,
    "angle_error_type": ("HA", *BEARINGS),
    "zenith_distance_error_type": ("ZD",),
    "height_difference_error_type": ("LV",),
}
"""Kinds of readings whose errors a command concerns."""
VECTOR_ERRORS = {
    **dict.fromkeys(("full", "correlation", "enu_correlation"), 6),
    **dict.fromkeys(("diagonal", "enu"), 3),
    CALCULATED: 0,
}
"""Number of values that state the error of a vector."""
ERROR_UNITS_OF_ANGLES = {"default": None, "degrees": ANGLE["deg"], "seconds": ARCSEC}
HEMISPHERES = {"LT": "NS", "LN": "EW"}
REJECTED = {"Y": True, "YES": True, "N": False, "NO": False}
PARTS_OF_DATES = "YMDNhms"
USUAL_DATE = "YMDhms"
_NUMBER_OR_UNIT = re.compile(r"[-+]?[\d.]+(?:[eE][-+]?\d+)?|[A-Za-z]+|\S")
_RUN = re.compile(r"([\d.]+)\s*mmrkm\s+sqrt\s+(\S+)", re.IGNORECASE)
"""An error for the root of the length of a run in kilometres, which is in metres behind it."""
KM = 1000.0


@dataclass
class CsvObservation:
    """An observation that each record of a file has."""

    line: int
    """Line where its definition begins."""
    values: dict[str, CsvValue] = field(default_factory=dict)
    """Its values by command."""
    classes: dict[str, CsvValue] = field(default_factory=dict)
    """Its classifications by name in small letters."""
    class_columns: list[str] = field(default_factory=list)
    """Names of columns that are classifications."""
    angles: Angles = "deg"
    """Form of angles."""
    error_unit: float | None = None
    """Unit of the errors of angles, radians; None: that of the form of angles."""
    calculated: set[str] = field(default_factory=set)
    """Kinds of readings whose errors are those of instruments, with units."""
    vector_errors: str = "enu"
    """Form of the errors of vectors."""
    dates: str = USUAL_DATE
    """Order of the parts of dates."""
    may_lack_value: bool = False
    """Whether a record without a value is left out."""


def observations_of(definition: CsvDefinition) -> list[CsvObservation]:
    """Return the observations that a format defines; what is wrong is noted."""
    out: list[CsvObservation] = []
    own: CsvObservation | None = None
    for stated in definition.lines:
        if stated.name in ("observation", "end_observation", "ignore_missing_observations"):
            definition.alone(stated.line, stated.name, stated.rest)
        if stated.name == "observation":
            own = CsvObservation(stated.line)
            out.append(own)
        elif stated.name == "end_observation":
            own = None
        elif own is None:
            definition.source.wrong(
                stated.line, f"{stated.name[:40]!r} is not within OBSERVATION and END_OBSERVATION"
            )
        else:
            _take(own, stated, definition)
    for found in out:
        for name in NEEDED:
            if name not in found.values:
                definition.source.wrong(found.line, f"the observation needs {name.upper()}")
    if not out:
        definition.source.wrong(0, "defines no observation; valid: OBSERVATION … END_OBSERVATION")
    return out


def _take(own: CsvObservation, stated: DefinitionLine, definition: CsvDefinition) -> None:
    """Take a line of the definition of an observation."""
    name = stated.name
    if name in VALUES:
        own.values[name] = definition.value(stated)
    elif name in CLASSES:
        own.classes[CLASSES[name]] = definition.value(stated)
    elif name == "classification":
        class_name, value = definition.named(stated)
        own.classes[class_name] = value
    elif name == "classification_columns":
        own.class_columns += definition.class_columns(stated)
    elif name == "angle_format":
        own.angles = definition.setting(stated).choice(ANGLE_FORMATS) or own.angles
    elif name in ("angle_error_unit", "angle_error_units"):
        own.error_unit = definition.setting(stated).choice(ERROR_UNITS_OF_ANGLES, default=None)
    elif name in KINDS_OF_ERRORS:
        form = definition.setting(stated).choice(FORMS_OF_ERRORS)
        change = own.calculated.update if form == CALCULATED else own.calculated.difference_update
        change(KINDS_OF_ERRORS[name])
    elif name == "vector_error_type":
        own.vector_errors = definition.setting(stated).word(VECTOR_ERRORS) or own.vector_errors
    elif name == "datetime_format":
        own.dates = _date_form(definition, stated)
    elif name == "ignore_missing_observations":
        own.may_lack_value = True
    else:
        valid = (
            *(*VALUES, *CLASSES, "classification", "classification_columns", "angle_format"),
            *("angle_error_unit", *KINDS_OF_ERRORS, "vector_error_type", "datetime_format"),
            *("ignore_missing_observations", "end_observation"),
        )
        definition.source.field(stated.line, name, "command of an observation").word(valid)


def _date_form(definition: CsvDefinition, stated: DefinitionLine) -> str:
    """Return the order of the parts of dates, whose letters have a case."""
    given = definition.value(stated).text(CsvRow(definition.source, stated.line, {}))
    form = given.replace(" ", "")
    if not form or set(form) - set(PARTS_OF_DATES) or len(set(form)) < len(form):
        definition.source.wrong(
            stated.line,
            f"the form of dates {given[:40]!r} is unknown; valid: Y, M, D, N (day of the year), "
            "h, m, s in their order",
        )
    return form


def read_csv_observations(path: Path, definition: CsvDefinition) -> list[SnapSet]:
    """Return the sets of readings of a file of delimited text; what is wrong is noted.

    Readings of consecutive records from one station with the same set are a set of directions, or
    of ratios.

    Args:
        path: the file.
        definition: its format.
    """
    problems = definition.source.problems
    before = problems.count
    defined = observations_of(definition)
    source = TextSource(path, problems, code_page="cp1252")
    if problems.count > before:
        return []
    sets: list[SnapSet] = []
    together: list[SnapReading] = []
    of_set = ("", "")
    for row in definition.rows(source):
        for own in defined:
            found = _reading(row, own)
            if found is None:
                continue
            reading, error_type = found
            name = row.field(own.values.get("set_id"), "set").name(default="")
            vector = reading.kind in VECTOR_KINDS
            if vector or not name or of_set != (name, reading.station):
                sets += _by_kind(together, source)
                together = []
            if vector:
                sets.append(SnapSet((reading,), source, error_type))
            else:
                together.append(reading)
            of_set = ("", "") if vector else (name, reading.station)
    return sets + list(_by_kind(together, source))


def _by_kind(readings: Sequence[SnapReading], source: TextSource) -> Iterator[SnapSet]:
    """Yield a set for each kind of some readings."""
    for kind in dict.fromkeys(r.kind for r in readings):
        yield SnapSet(tuple(r for r in readings if r.kind == kind), source)


def _reading(row: CsvRow, own: CsvObservation) -> tuple[SnapReading, str] | None:
    """Return the reading of a record, and the form of its errors; None after a problem."""
    before = row.source.problems.count

    def given(name: str) -> Field:
        return row.field(own.values.get(name), name.replace("_", " "))

    if own.may_lack_value and given("value").is_absent:
        return None
    stated = given("type")
    kind = kind_of(str(stated.value or ""))
    if not kind:
        stated.value = str(stated.value or "").upper()
        stated.word(KINDS)
        return None
    point = kind in POINT_KINDS
    station = given("instrument_station").name()
    target = "" if point else given("target_station").name()
    heights = [given(f"{end}_height").number(default=0.0) for end in ("instrument", "target")]
    if kind in VECTOR_KINDS:
        values = given("value").numbers(3)
    elif kind in ANGLES:
        values = (text_angle(given("value"), own.angles, HEMISPHERES.get(kind, "")),)
    else:
        values = (given("value").number(),)
    error_type, errors, defaults = _errors(given("error"), kind, own)
    rejected = given("rejected")
    rejected.value = str(rejected.value or "").upper()
    starred = rejected.choice(REJECTED, default=False)
    factor = given("error_factor").number(above=0.0, default=1.0)
    classes = class_columns(own.class_columns, row)
    for name, value in own.classes.items():
        text = value.text(row).strip()
        classes |= {name: text} if text else {}
    date = _date(given("datetime"), own.dates)
    if row.source.problems.count > before:
        return None
    reading = SnapReading(
        kind,
        station,
        target,
        heights[0],
        0.0 if point else heights[1],
        values,
        errors,
        bool(starred),
        classes,
        date,
        given("projection").name(default=""),
        defaults,
        row.line,
        factor,
    )
    return reading, error_type


def _errors(
    given: Field, kind: str, own: CsvObservation
) -> tuple[str, tuple[float, ...] | None, SnapErrors]:
    """Return the form of the errors of a reading, its errors, and those of instruments."""
    if kind in VECTOR_KINDS and own.vector_errors != CALCULATED:
        form = own.vector_errors
        return form, given.numbers(VECTOR_ERRORS[form]), {}
    if kind not in own.calculated and kind not in VECTOR_KINDS:
        unit = 1.0
        if kind in ANGLES:
            usual = ANGLE["deg"] if own.angles == "deg" else ARCSEC
            unit = usual if own.error_unit is None else own.error_unit
        return DEFAULT, (given.sigma(scale=unit),), {}
    if kind == "LV":
        return DEFAULT, (_levelling_error(given),), {}
    words = _NUMBER_OR_UNIT.findall(str(given.value or ""))
    code = ERRORS_OF_KINDS[kind]
    return DEFAULT, None, {code: stated_errors(given, words, ERROR_UNITS[code])}


def _levelling_error(given: Field) -> float:
    """Return an error such as ``2.5 mm 2 mmrkm sqrt 1440``, the run in metres; NaN if wrong."""
    text = str(given.value or "")
    run = _RUN.search(text)
    parts = [0.0]
    if run is not None:
        per_root, length = (
            Field(run[i], given.what, given.where, given.problems).number(least=0.0) for i in (1, 2)
        )
        if is_unread(per_root, length):
            return math.nan
        parts.append(1e-3 * per_root * math.sqrt(length / KM))
        text = text[: run.start()] + text[run.end() :]
    if run is None or text.strip():
        words = _NUMBER_OR_UNIT.findall(text)
        parts += stated_errors(given, words, ERROR_UNITS["lv"]).get("mm", (math.nan,))
    sigma = math.hypot(*parts)
    if sigma == 0.0:
        given.wrong("must be greater than zero")
    return sigma


def _date(given: Field, form: str) -> datetime | None:
    """Return the date of a field in the order of its parts; None: unknown, or after a problem."""
    text = str(given.value or "")
    if not text:
        return None
    words = re.findall(r"\d+|[A-Za-z]+", text)
    part: dict[str, int] = {}
    for letter, word in zip(form, words, strict=False):
        month = word[:3].lower()
        if letter == "M" and month in MONTHS:
            part[letter] = MONTHS.index(month) + 1
        elif word.isdigit():
            part[letter] = int(word)
    of_year = part.get("N", 1)
    try:
        # Names that are no months, and words too many, leave a part without a value.
        if len(part) != len(words) or len(words) < min(len(form), 2 if "N" in form else 3):
            raise ValueError
        day = datetime(
            part["Y"], part.get("M", 1), part.get("D", 1),
            part.get("h", 0), part.get("m", 0), part.get("s", 0),
        )  # fmt: skip
        return day.replace(month=1, day=1) + timedelta(of_year - 1) if "N" in form else day
    except (ValueError, KeyError, OverflowError):
        given.wrong(f"must be a date in the order {form}, not {text[:40]!r}")
        return None
