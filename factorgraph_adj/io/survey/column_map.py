"""Column map of a table: which header is which column, units, decimals, sheet, dimension.

A mapping is a dictionary or a TOML file. It has up to four tables, for points, readings, levelled
lines and other observations, each of which names a header for each column of this package.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...errors import InputError, Problem, known
from ...files import path_objection
from ...units import FOOT, LENGTH, US_SURVEY_FOOT
from ..numbers import ANGLE_UNITS, PACKED_DEGREES, Units
from ..text_files import read_toml

MAPPED_SECTIONS = ("points", "readings", "levelling", "observations")
MAPPED_POINT_COLUMNS = ("name", "x", "y", "z", "fixed")
MAPPED_READING_COLUMNS = (
    *("station", "target", "set", "face", "direction", "zenith", "distance"),
    *("horizontal_distance", "instrument_height", "target_height"),
)
MAPPED_LEVELLING_COLUMNS = ("station", "target", "difference", "length")
SECTION_COLUMNS = {
    "points": MAPPED_POINT_COLUMNS,
    "readings": MAPPED_READING_COLUMNS,
    "levelling": MAPPED_LEVELLING_COLUMNS,
    "observations": None,
}
"""Columns of the sections; those of observations depend on the kind."""
REQUIRED_COLUMNS = {
    "points": ("name",),
    "readings": ("station", "target"),
    "levelling": ("station", "target", "difference"),
    "observations": ("kind",),
}
TEXT_COLUMNS = (
    "name",
    "fixed",
    "station",
    "target",
    "target2",
    "point",
    "set",
    "face",
    "kind",
    "id",
    "instrument",
    "refraction",
    "axes",
    "photo",
)
"""Columns that are no numbers: a decimal comma is not searched for in them."""
LAYOUT_KEYS = ("delimiter", "decimal", "encoding", "header")
"""Keys of the mapping that a table may state for itself."""
MAPPING_KEYS = (
    *LAYOUT_KEYS,
    "sheet",
    "axes",
    "dimension",
    "units",
    "sigma",
    *MAPPED_SECTIONS,
)
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "}
MAPPED_LENGTHS = {**LENGTH, "ft": FOOT, "us-ft": US_SURVEY_FOOT}
"""Metres in the units of lengths of a mapping."""
MAPPED_ANGLES = {**{name: name for name in ANGLE_UNITS}, "packed": PACKED_DEGREES}
"""Units of angles of a mapping, as `numbers.parse_quantity` knows them."""


@dataclass(frozen=True)
class MappedUnits:
    """Units of the cells of a table."""

    length: str = "m"
    """Unit of coordinates, distances, heights and height differences."""
    angle: str = "gon"
    """Unit of directions and zenith angles; packed: D.MMSS."""
    line: str = ""
    """Unit of the lengths of levelled lines; default: that of lengths."""

    def __post_init__(self) -> None:
        """Check the names; InputError lists all unknown ones."""
        problems = [
            Problem(f"unknown unit {given!r}; valid: {known(valid, meant=given, most=20)}", key)
            for key, given, valid in (
                ("length", self.length, MAPPED_LENGTHS),
                ("angle", self.angle, MAPPED_ANGLES),
                ("line", self.line or self.length, MAPPED_LENGTHS),
            )
            if given not in valid
        ]
        if problems:
            raise InputError(problems)

    @property
    def of_project(self) -> Units | None:
        """The units as those of a project, which has neither feet nor packed degrees; or None."""
        if self.length in LENGTH and self.angle in ANGLE_UNITS:
            return Units(self.length, self.angle)
        return None


@dataclass(frozen=True)
class TableLayout:
    """How the text of a table is divided."""

    delimiter: str | None = None
    """Character between cells; None: it follows from the header."""
    decimal: str = "."
    """Decimal point or comma."""
    encoding: str = "utf-8-sig"
    """Encoding of the text."""
    header: int = 1
    """Line of the header; 0: there is none, and columns are named 1, 2, …"""


@dataclass(frozen=True)
class MappedSection:
    """One table of the mapping."""

    name: str
    """points, readings or observations."""
    file: str | None
    """File beside the one that is read; None: that one."""
    sheet: str | None
    """Sheet of a workbook; None: that of the mapping."""
    columns: Mapping[str, str]
    """Header of the file for each column of this package; ``=text`` is a constant."""
    layout: TableLayout = field(default_factory=TableLayout)
    """Layout of its file: that of the mapping, unless the table states its own."""
    where: str = ""
    """Where the mapping states it, for messages."""


@dataclass(frozen=True)
class ColumnMap:
    """How a table is read."""

    axes: str = "en"
    """Axes of x and y."""
    sheet: str | None = None
    """Sheet of a workbook; None: its only one."""
    dimension: int | None = None
    """1: heights alone; 2: a plane network; 3 or None: what the observations determine."""
    units: MappedUnits = field(default_factory=MappedUnits)
    """Units of lengths and angles."""
    sigma: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Standard deviations by kind of observation, as in project.toml."""
    sections: tuple[MappedSection, ...] = ()
    """The tables."""


def column_map(given: ColumnMap | Mapping[str, Any] | str | Path) -> ColumnMap:
    """Return the mapping that a dictionary or a TOML file states.

    Raises:
        InputError: the file cannot be read, or keys or values are wrong: all are listed.
    """
    if isinstance(given, ColumnMap):
        return given
    where, places = "mapping", None
    if isinstance(given, str | Path):
        where = Path(given).name
        given, places = read_toml(Path(given))
    problems = [
        Problem(f"unknown key {k!r}; valid: {known(MAPPING_KEYS, meant=k, most=20)}", where)
        for k in given
        if k not in MAPPING_KEYS
    ]
    out: dict[str, Any] = {}
    out["axes"] = given.get("axes", "en")
    if out["axes"] not in ("en", "ne"):
        problems.append(Problem(f"axes must be one of en, ne, not {out['axes']!r}", where))
    layout = _layout(given, TableLayout(), where, problems)
    out["sheet"] = given.get("sheet")
    if out["sheet"] is not None and not isinstance(out["sheet"], str):
        problems.append(Problem(f"sheet must be a name, not {out['sheet']!r}", where))
    out["dimension"] = given.get("dimension")
    if out["dimension"] not in (None, 1, 2, 3):
        what = f"dimension must be 1 (heights), 2 (plane) or 3, not {out['dimension']!r}"
        problems.append(Problem(what, where))
    out["units"] = _units(given.get("units", {}), where, problems)
    sigma = given.get("sigma", {})
    if not isinstance(sigma, Mapping) or not all(isinstance(v, Mapping) for v in sigma.values()):
        problems.append(Problem("sigma must have a table for each kind, as in project.toml", where))
        sigma = {}
    out["sigma"] = sigma
    out["sections"] = tuple(
        s
        for name in MAPPED_SECTIONS
        if name in given and (s := _section(name, given[name], layout, where, problems))
    )
    if not any(name in given for name in MAPPED_SECTIONS):
        problems.append(Problem(f"needs one of the tables {known(MAPPED_SECTIONS)}", where))
    if problems:
        raise InputError(problems if places is None else map(places.placed, problems))
    return ColumnMap(**out)


def _units(given: object, where: str, problems: list[Problem]) -> MappedUnits:
    if not isinstance(given, Mapping) or not set(given) <= {"length", "angle", "line"}:
        problems.append(Problem("units takes length, angle and line", where))
        return MappedUnits()
    try:
        return MappedUnits(**{k: str(v) for k, v in given.items()})
    except InputError as error:
        problems += [Problem(f"{p.where}: {p.what}", f"{where}: units") for p in error.problems]
        return MappedUnits()


def _layout(
    given: Mapping[str, Any], default: TableLayout, where: str, problems: list[Problem]
) -> TableLayout:
    """Return the layout that a mapping or one of its tables states."""
    stated = {key: given[key] for key in LAYOUT_KEYS if key in given}
    delimiter = stated.get("delimiter")
    if delimiter is not None:
        stated["delimiter"] = DELIMITERS.get(str(delimiter), delimiter)
        if not isinstance(delimiter, str) or len(stated["delimiter"]) != 1:
            what = f"delimiter must be a character or {known(DELIMITERS)}, not {delimiter!r}"
            problems.append(Problem(what, where))
    if (decimal := stated.get("decimal", ".")) not in (".", ","):
        problems.append(Problem(f"decimal must be one of ., ,, not {decimal!r}", where))
    if "encoding" in stated:
        try:
            "".encode(stated["encoding"])
        except (LookupError, TypeError, UnicodeError):
            what = f"unknown encoding {stated['encoding']!r}; valid: utf-8, cp1252 …"
            problems.append(Problem(what, where))
    header = stated.get("header", 1)
    if isinstance(header, bool) or not isinstance(header, int) or not 0 <= header <= 10_000:
        problems.append(Problem(f"header must be a line, or 0, not {header!r}", where))
    return replace(default, **stated)


def _section(
    name: str, given: object, layout: TableLayout, where: str, problems: list[Problem]
) -> MappedSection | None:
    if not isinstance(given, Mapping) or not all(
        isinstance(v, str) for k, v in given.items() if k not in LAYOUT_KEYS
    ):
        what = f"{name} must name a header of the file for each column, all of them texts"
        problems.append(Problem(what, f"{where}: [{name}]"))
        return None
    columns = {k: v for k, v in given.items() if k not in ("file", "sheet", *LAYOUT_KEYS)}
    layout = _layout(given, layout, f"{where}: [{name}]", problems)
    valid = SECTION_COLUMNS[name]
    for key in columns:
        if valid is not None and key not in valid:
            what = f"{name} has no column {key!r}; valid: {known(valid, meant=key)}"
            problems.append(Problem(what, f"{where}: [{name}]"))
    for key in REQUIRED_COLUMNS[name]:
        if key not in columns:
            problems.append(Problem(f"{name} needs the column {key!r}", f"{where}: [{name}]"))
    file = given.get("file")
    if file is not None and (why := path_objection(file)):
        problems.append(Problem(f"file of {name}: {file!r} {why}", f"{where}: [{name}]"))
        return None
    return MappedSection(name, file, given.get("sheet"), columns, layout, f"{where}: [{name}]")
