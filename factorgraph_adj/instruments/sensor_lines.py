"""Lines of sensors as CSV or JSON: inclinometers, piezometers, extensometers, weather stations.

Loggers write tables of their own, so that the mapping says what the columns are:

    grammar = "sensor-lines"
    columns = ["time", "serial", "X", "Y", "T"]     # of CSV; JSON objects have names
    separator = ","
    time = "time"                                   # column of the time; none: the receipt
    time_format = "iso"                             # or "s", "ms" since 1970, or as strptime
    missing = ["", "NaN", "-9999"]                  # there is no value
    where = {serial = "4711"}                       # other lines are passed over
    [instrument.sensors]                            # quantities and their units
    temperature = "T degC"
    [[instrument.observations]]                     # fields of a row of observations.csv
    kind = "frame_inclination"
    frame = "pier"
    point = "P1"
    value = "$X"                                    # $: a column
    unit = "mrad"                                   # unit of the observed values
    sigma_mrad = 0.01

An observation takes names and numbers from columns with ``$``; what it observes is any kind of
the network: a tilt against the plumb line is a ``frame_inclination`` or ``vertical_angle``, a
pendulum a ``wire_reading``, a hydrostatic level a ``hydrostatic_reading``, an extensometer a
``slope_distance``. Readings in volts or digits have no unit of the network: convert them in the
logger. Quantities of ``sensors`` are kept by the site, for corrections of distances
(``temperature``, ``pressure``, ``humidity``) and for series; that of a piezometer is a pressure.

A line of CSV has as many fields as ``columns``; a line that repeats the names is passed over, as
loggers write it at every start. A JSON object may be nested: ``payload.T`` is T in payload, and
``columns`` is not needed; a JSON array holds several. Decimal points are points. A value in
``missing`` leaves out the observations and quantities that use it. Everything else that is no
number is refused with the whole line.

Units: of temperature degC, degF, K; of pressure Pa, hPa, mbar, kPa, bar, mmHg, inHg; of humidity %
or 1; of lengths and angles those of the files of a project; 1 for numbers.

Times without an offset are those of the clock of the instrument, see ``utc_offset``.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from ..errors import InputError, Problem, counted, known
from ..io.numbers import MAX_NUMBER
from ..io.observation_fields import known_fields, name_fields, sigma_fields
from ..io.observation_records import observation_from_record
from ..observations import KINDS, Observation
from ..units import ANGLE, LENGTH
from .grammars import GrammarRecord
from .readings import Observed, Reading, ReceivedLine, SensorValues

UNITS: dict[str, tuple[float, float]] = {
    "degC": (1.0, 273.15),
    "degF": (5.0 / 9.0, 273.15 - 32.0 * 5.0 / 9.0),
    "K": (1.0, 0.0),
    "Pa": (1.0, 0.0),
    "hPa": (100.0, 0.0),
    "mbar": (100.0, 0.0),
    "kPa": (1e3, 0.0),
    "bar": (1e5, 0.0),
    "mmHg": (133.322387415, 0.0),
    "inHg": (3386.388640341, 0.0),
    "%": (0.01, 0.0),
    "1": (1.0, 0.0),
    **{unit: (size, 0.0) for unit, size in (*LENGTH.items(), *ANGLE.items())},
}
"""Factor and constant of each unit to SI: kelvin, pascal, ratio, metres, radians."""
AIR_UNITS = {
    "temperature": ("degC", "degF", "K"),
    "pressure": ("Pa", "hPa", "mbar", "kPa", "bar", "mmHg", "inHg"),
    "humidity": ("%", "1"),
}
"""Units of the quantities that corrections of distances use."""
EPOCH_UNITS = {"s": 1.0, "ms": 1e-3}
"""Seconds of numeric times since 1970 UTC."""
COLUMN = "$"
"""First character of a text that names a column."""
USUAL_MISSING = ("", "NaN", "nan", "null")
"""Values that say there is none."""


class SensorLines:
    """Grammar of tables of sensors."""

    def __init__(
        self,
        *,
        columns: list[str] | None = None,
        separator: str = ",",
        time: str | None = None,
        time_format: str = "iso",
        missing: list[str] | None = None,
        where: dict[str, Any] | None = None,
        sensors: dict[str, Any] | None = None,
        observations: list[Any] | None = None,
    ) -> None:
        """Take the options of [[instrument]], see the module.

        Raises:
            InputError: all problems of the options.
        """
        self.columns = list(columns or ())
        self.separator, self.time, self.time_format = separator, time, time_format
        self.missing = frozenset(USUAL_MISSING if missing is None else missing)
        self.where = {name: str(value) for name, value in (where or {}).items()}
        self.problems: list[Problem] = []
        if len(set(self.columns)) < len(self.columns):
            self.problems.append(Problem("two columns have the same name", "columns"))
        if len(separator) != 1:
            self.problems.append(Problem(f"must be one character, not {separator!r}", "separator"))
        if time is not None:
            self._known(time, "time")
        for name in self.where:
            self._known(name, "where")
        self.sensors = {
            name: found
            for name, text in (sensors or {}).items()
            if (found := self._sensor(name, text)) is not None
        }
        self.records = [self._record(i, r) for i, r in enumerate(observations or (), 1)]
        if not sensors and not observations:
            self.problems.append(Problem("state sensors, observations or both"))
        if self.problems:
            raise InputError(self.problems)

    def _known(self, column: str, where: str) -> None:
        """Note the problem that a column is not one of CSV."""
        if self.columns and column not in self.columns:
            valid = known(self.columns, meant=column)
            self.problems.append(Problem(f"unknown column {column!r}; known: {valid}", where))

    def _sensor(self, name: str, text: object) -> tuple[str, str] | None:
        """Return the column and the unit of a quantity."""
        place = f"sensors.{name}"
        column, _, unit = text.rpartition(" ") if isinstance(text, str) else ("", "", "")
        if not column.strip():
            what = f"must be a column and a unit such as 'T degC', not {text!r}"
            self.problems.append(Problem(what, place))
            return None
        valid = AIR_UNITS.get(name, UNITS)
        if unit not in valid:
            what = f"unknown unit {unit!r}; valid: {known(valid, meant=unit, most=40)}"
            self.problems.append(Problem(what, place))
            return None
        self._known(column.strip(), place)
        return column.strip(), unit

    def _record(self, number: int, given: object) -> dict[str, Any]:
        """Return the fields of an observation, whose structure is checked with invented numbers."""
        place = f"observations {number}"
        if not isinstance(given, dict):
            self.problems.append(Problem("must be a table of fields", place))
            return {}
        numeric = set(known_fields()) - {"kind", "id", "unit"}
        invented: dict[str, Any] = {}
        for name, value in given.items():
            column = _column(value)
            if column is not None:
                self._known(column, f"{place}: {name}")
            invented[name] = value if column is None else 0.5
        kind = given.get("kind")
        if not isinstance(kind, str) or kind not in KINDS:
            valid = known(KINDS, meant=str(kind), most=80)
            self.problems.append(Problem(f"unknown kind {kind!r}; valid: {valid}", place))
            return given
        if "unit" not in given and "unit" in known_fields(kind):
            what = "the unit of the values is missing: a line does not state it"
            self.problems.append(Problem(what, place))
        if not any(name in given for name in sigma_fields(kind)):
            what = "no standard deviation: state one, such as sigma_mm or sigma_mgon"
            self.problems.append(Problem(what, place))
        if not any(_column(v) is not None for n, v in given.items() if n in numeric):
            self.problems.append(Problem("no field is a column, such as value = '$X'", place))
        for name in (*name_fields(kind), *KINDS[kind].texts, "id"):
            if invented.get(name) == 0.5:
                invented[name] = f"{name} {number}"
        if not self.problems:
            try:
                observation_from_record(invented, source="")
            except InputError as error:
                self.problems += [Problem(p.what, place) for p in error.problems]
        return given

    def read(self, line: ReceivedLine) -> Sequence[Reading]:
        """Return the quantities and observations of a line.

        Raises:
            InputError: all problems of the line.
        """
        out: list[Reading] = []
        problems: list[Problem] = []
        for row in self._rows(line):
            try:
                out += self._readings(row)
            except InputError as error:
                problems += error.problems
        if problems:
            raise InputError(problems)
        return out

    def _rows(self, line: ReceivedLine) -> list[Mapping[str, Any]]:
        """Return the values by column of each row that a line holds."""
        try:
            text = line.text.decode("utf-8").strip()
        except UnicodeDecodeError:
            raise InputError("the line is not UTF-8 text") from None
        if text[:1] in ("{", "["):
            try:
                found = json.loads(text)
            except (ValueError, RecursionError) as error:
                raise InputError(f"the line is not JSON: {error}") from None
            rows = found if isinstance(found, list) else [found]
            if not all(isinstance(row, dict) for row in rows):
                raise InputError("a JSON array must hold objects {…}")
            return [_flat(row) for row in rows]
        if not self.columns:
            raise InputError("the line is no JSON object, and columns of CSV are not stated")
        try:
            (row,) = csv.reader([text], delimiter=self.separator)
        except (csv.Error, ValueError) as error:  # it has no row, or several
            raise InputError(f"the line is no row of CSV: {error}") from None
        fields = [field.strip() for field in row]
        if fields == self.columns:
            return []
        if len(fields) != len(self.columns):
            columns = counted(len(self.columns), "stated column")
            raise InputError(f"{counted(len(fields), 'field')} for {columns}")
        return [dict(zip(self.columns, fields, strict=True))]

    def _readings(self, row: Mapping[str, Any]) -> list[Reading]:
        """Return what a row says."""
        problems: list[Problem] = []
        for name, wanted in self.where.items():
            if _text(self._value(row, name, problems)) != wanted:
                if problems:
                    raise InputError(problems)
                return []
        stamped, identity = None, ""
        if self.time is not None:
            identity = _text(self._value(row, self.time, problems))
            stamped = self._stamp(identity, problems) if not problems else None
        values: dict[str, float] = {}
        for name, (column, unit) in self.sensors.items():
            given = self._value(row, column, problems)
            if self._is_missing(given):
                continue
            factor, constant = UNITS[unit]
            values[name] = factor * _number(given, column, problems) + constant
        found: list[Observation] = []
        for record in self.records:
            filled = {
                n: v if (c := _column(v)) is None else self._value(row, c, problems)
                for n, v in record.items()
            }
            if any(
                self._is_missing(filled[n]) for n, v in record.items() if _column(v) is not None
            ):
                continue
            try:
                found.append(observation_from_record(filled, source=""))
            except InputError as error:
                problems += error.problems
        if problems:
            raise InputError(problems)
        of: dict[str, Any] = {"stamped": stamped, "identity": identity}
        out: list[Reading] = []
        if values:
            out.append(SensorValues(values=values, **of))
        if found:
            out.append(Observed(observations=tuple(found), **of))
        return out

    def _value(self, row: Mapping[str, Any], column: str, problems: list[Problem]) -> Any:
        """Return the value of a column; a column that is not there is a problem."""
        if column not in row:
            what = f"{column!r} is not there; known: {known(row, meant=column)}"
            if what not in [p.what for p in problems]:
                problems.append(Problem(what))
            return None
        return row[column]

    def _is_missing(self, value: Any) -> bool:
        return value is None or _text(value) in self.missing

    def _stamp(self, text: str, problems: list[Problem]) -> float | None:
        """Return a time, seconds since 1970 UTC; None after a problem."""
        try:
            if self.time_format in EPOCH_UNITS:
                seconds = EPOCH_UNITS[self.time_format] * float(text)
                if not 0.0 <= seconds < 1e11:
                    raise ValueError
                return seconds
            if self.time_format == "iso":
                at = datetime.fromisoformat(text)
            else:
                at = datetime.strptime(text, self.time_format)
        except ValueError:
            what = f"{self.time!r}: {text[:40]!r} is no time of the format {self.time_format!r}"
            problems.append(Problem(what))
            return None
        return (at if at.tzinfo is not None else at.replace(tzinfo=UTC)).timestamp()


def _column(value: object) -> str | None:
    """Return the column that a field names; None: the field is the value itself."""
    return value[1:] if isinstance(value, str) and value.startswith(COLUMN) else None


def _text(value: Any) -> str:
    return "" if value is None else value if isinstance(value, str) else json.dumps(value)


def _number(value: Any, column: str, problems: list[Problem]) -> float:
    """Return a number; NaN after a problem."""
    text = _text(value).strip()
    try:
        found = float(text) if not isinstance(value, bool) else math.nan
    except ValueError:
        found = math.nan
    # float() takes 1_000 and words such as inf.
    if "_" in text or not abs(found) <= MAX_NUMBER:
        problems.append(Problem(f"{column!r} must be a number, not {text[:40]!r}"))
        return math.nan
    return found


def _flat(row: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Return the values of nested objects by their names with points between."""
    out: dict[str, Any] = {}
    for name, value in row.items():
        if isinstance(value, dict):
            out |= _flat(value, f"{before}{name}.")
        else:
            out[before + name] = value
    return out


GRAMMAR = GrammarRecord(
    "sensor-lines", "CSV and JSON lines of sensors, by a table of columns and units", SensorLines
)
