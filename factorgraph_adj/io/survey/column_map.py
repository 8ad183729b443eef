"""Mapping of the columns of any table to those of this package."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import InputError, Problem, known
from ...files import misnamed
from ..numbers import Units
from ..toml_places import read_toml

SECTIONS = ("points", "readings", "observations")
POINT_COLUMNS = ("name", "x", "y", "z", "fixed")
READING_COLUMNS = (
    *("station", "target", "set", "face", "direction", "zenith", "distance"),
    *("horizontal_distance", "instrument_height", "target_height"),
)
COLUMNS = {"points": POINT_COLUMNS, "readings": READING_COLUMNS, "observations": None}
"""Columns of the sections; those of observations depend on the kind."""
NEEDED = {"points": ("name",), "readings": ("station", "target"), "observations": ("kind",)}
TEXTS = (
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
"""Columns that are no numbers: a decimal comma is not looked for in them."""
KEYS = ("delimiter", "decimal", "encoding", "header", "axes", "units", "sigma", *SECTIONS)
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "}


@dataclass(frozen=True)
class Section:
    """One table of the mapping."""

    name: str
    """points, readings or observations."""
    file: str | None
    """File beside the one that is read; None: that one."""
    columns: Mapping[str, str]
    """Header of the file for each column of this package; ``=text`` is a constant."""
    where: str = ""
    """Where the mapping states it, for messages."""


@dataclass(frozen=True)
class ColumnMap:
    """How a table is read."""

    delimiter: str | None = None
    """Character between cells; None: the header tells it."""
    decimal: str = "."
    """Decimal point or comma."""
    encoding: str = "utf-8-sig"
    """Encoding of the text."""
    header: int = 1
    """Line of the header; 0: there is none, and columns are named 1, 2, …"""
    axes: str = "en"
    """Axes of x and y."""
    units: Units = field(default_factory=Units)
    """Units of lengths and angles."""
    sigma: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Standard deviations by kind of observation, as in project.toml."""
    sections: tuple[Section, ...] = ()
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
        Problem(f"unknown key {k!r}; valid: {known(KEYS, meant=k, most=20)}", where)
        for k in given
        if k not in KEYS
    ]
    out: dict[str, Any] = {}
    for key, valid in (("decimal", (".", ",")), ("axes", ("en", "ne"))):
        out[key] = given.get(key, valid[0])
        if out[key] not in valid:
            problems.append(
                Problem(f"{key} must be one of {known(valid)}, not {out[key]!r}", where)
            )
    delimiter = given.get("delimiter")
    out["delimiter"] = DELIMITERS.get(str(delimiter), delimiter)
    if delimiter is not None and (not isinstance(delimiter, str) or len(out["delimiter"]) != 1):
        what = f"delimiter must be a character or {known(DELIMITERS)}, not {delimiter!r}"
        problems.append(Problem(what, where))
    out["encoding"] = given.get("encoding", "utf-8-sig")
    try:
        "".encode(out["encoding"])
    except (LookupError, TypeError, UnicodeError):
        problems.append(
            Problem(f"unknown encoding {out['encoding']!r}; valid: utf-8, cp1252 …", where)
        )
    out["header"] = given.get("header", 1)
    if not isinstance(out["header"], int) or not 0 <= out["header"] <= 10_000:
        problems.append(Problem(f"header must be a line, or 0, not {out['header']!r}", where))
    out["units"] = _units(given.get("units", {}), where, problems)
    sigma = given.get("sigma", {})
    if not isinstance(sigma, Mapping) or not all(isinstance(v, Mapping) for v in sigma.values()):
        problems.append(Problem("sigma must have a table for each kind, as in project.toml", where))
        sigma = {}
    out["sigma"] = sigma
    out["sections"] = tuple(
        s
        for name in SECTIONS
        if name in given and (s := _section(name, given[name], where, problems))
    )
    if not any(name in given for name in SECTIONS):
        problems.append(Problem(f"needs one of the tables {known(SECTIONS)}", where))
    if problems:
        raise InputError(problems if places is None else map(places.placed, problems))
    return ColumnMap(**out)


def _units(given: object, where: str, problems: list[Problem]) -> Units:
    if not isinstance(given, Mapping) or not set(given) <= {"length", "angle"}:
        problems.append(Problem("units takes length and angle", where))
        return Units()
    try:
        return Units(**{k: str(v) for k, v in given.items()})
    except InputError as error:
        problems += [Problem(p.what, f"{where}: units") for p in error.problems]
        return Units()


def _section(name: str, given: object, where: str, problems: list[Problem]) -> Section | None:
    if not isinstance(given, Mapping) or not all(isinstance(v, str) for v in given.values()):
        what = f"{name} must name a header of the file for each column, all of them texts"
        problems.append(Problem(what, f"{where}: [{name}]"))
        return None
    columns = {k: v for k, v in given.items() if k != "file"}
    valid = COLUMNS[name]
    for key in columns:
        if valid is not None and key not in valid:
            what = f"{name} has no column {key!r}; valid: {known(valid, meant=key)}"
            problems.append(Problem(what, f"{where}: [{name}]"))
    for key in NEEDED[name]:
        if key not in columns:
            problems.append(Problem(f"{name} needs the column {key!r}", f"{where}: [{name}]"))
    file = given.get("file")
    if file is not None and (why := misnamed(file)):
        problems.append(Problem(f"file of {name}: {file!r} {why}", f"{where}: [{name}]"))
        return None
    return Section(name, file, columns, f"{where}: [{name}]")
