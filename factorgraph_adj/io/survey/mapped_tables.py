"""Reader of text tables of any program by a column map: points, readings, observations."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import InputError, Problem, known
from ...files import inside, path_objection, read_bytes
from ...frames import LocalFrame
from ...network.network import Network
from ...observations import Observation
from .. import numbers
from ..csv_tables import unguarded_cell
from ..field_books.accuracies import DEFAULT_ACCURACIES, Accuracies
from ..field_books.field_book import FieldBook
from ..format_reader import NetworkReader, Reader
from ..numbers import Units
from ..observation_fields import RecordContext
from ..observation_records import observation_from_record
from ..source import Problems, Source
from ..text_files import read_toml

MAPPED_SECTIONS = ("points", "readings", "observations")
MAPPED_POINT_COLUMNS = ("name", "x", "y", "z", "fixed")
MAPPED_READING_COLUMNS = (
    *("station", "target", "set", "face", "direction", "zenith", "distance"),
    *("horizontal_distance", "instrument_height", "target_height"),
)
SECTION_COLUMNS = {
    "points": MAPPED_POINT_COLUMNS,
    "readings": MAPPED_READING_COLUMNS,
    "observations": None,
}
"""Columns of the sections; those of observations depend on the kind."""
REQUIRED_COLUMNS = {
    "points": ("name",),
    "readings": ("station", "target"),
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
MAPPING_KEYS = (
    "delimiter",
    "decimal",
    "encoding",
    "header",
    "axes",
    "units",
    "sigma",
    *MAPPED_SECTIONS,
)
DELIMITERS = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "}
MAX_CELL = 500
"""Characters of a cell; more are a missing quotation mark."""
HELD_BY_WORD = {
    "yes": "xyz",
    "true": "xyz",
    "1": "xyz",
    "x": "x",
    "no": "",
    "false": "",
    "0": "",
    "": "",
}
"""Words in the column ``fixed``, beside axes such as xyz, xy and z."""
FACE_BY_WORD = {"1": 1, "i": 1, "f1": 1, "l": 1, "2": 2, "ii": 2, "f2": 2, "r": 2}
"""Words in the column ``face``."""
SIGHT_COLUMNS = ("direction", "zenith", "distance", "horizontal_distance")
"""Columns of what is read to a target; a reading has one of them at least."""


@dataclass(frozen=True)
class MappedSection:
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
    """Character between cells; None: it follows from the header."""
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
        for name in MAPPED_SECTIONS
        if name in given and (s := _section(name, given[name], where, problems))
    )
    if not any(name in given for name in MAPPED_SECTIONS):
        problems.append(Problem(f"needs one of the tables {known(MAPPED_SECTIONS)}", where))
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


def _section(name: str, given: object, where: str, problems: list[Problem]) -> MappedSection | None:
    if not isinstance(given, Mapping) or not all(isinstance(v, str) for v in given.values()):
        what = f"{name} must name a header of the file for each column, all of them texts"
        problems.append(Problem(what, f"{where}: [{name}]"))
        return None
    columns = {k: v for k, v in given.items() if k != "file"}
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
    return MappedSection(name, file, columns, f"{where}: [{name}]")


def read_columns(
    path: str | Path,
    *,
    mapping: ColumnMap | Mapping[str, Any] | str | Path,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read points, readings and observations from tables of any program.

    The mapping, a dictionary or a TOML file, says for each column of this package which header of
    the file it is, or, after ``=``, a constant. It has up to three tables, which are read from the
    same file or, with ``file``, from another beside it:

    - ``points``: name, x, y, z, fixed (yes, no or axes such as xy);
    - ``readings``: station, target, direction, zenith, distance, horizontal_distance, set, face,
      instrument_height, target_height: a field book, whose faces are reduced;
    - ``observations``: kind and the columns of this kind in observations.csv.

    Keys beside them: ``delimiter`` (from the header if absent), ``decimal`` (``.`` or ``,``),
    ``encoding``, ``header`` (line of the header; 0: none, columns are named 1, 2, …), ``axes`` (en
    or ne: what x and y are; default en), ``units`` (length, angle) and ``sigma``, standard
    deviations by kind as in project.toml. Columns of the file that are not mapped are not read.
    A row of points without coordinates and empty rows of another table are no error; a point that
    only readings or observations name is unknown. Points that no table states are added.

    Args:
        path: the table.
        mapping: the mapping, or a TOML file with it.
        fixed: names of points that are held, beside those whose column says so.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of mapping and tables, each with file and line.
    """
    source = Path(path)
    return _Reader(source, column_map(mapping), accuracies, fixed).network()


class _Reader:
    def __init__(
        self,
        path: Path,
        mapping: ColumnMap,
        accuracies: Accuracies,
        fixed: str | Iterable[str],
    ) -> None:
        self.path = path
        self.map = mapping
        self.accuracies = accuracies
        self.problems = Problems()
        self.source = Source(path, self.problems)
        self.book = FieldBook(self.source, accuracies, fixed, zero_is_unmeasured=False)
        self.held: dict[str, str] = {}
        self.observations: list[Observation] = []
        self.at: tuple[str, float, str] | None = None
        self.context = RecordContext(units=mapping.units, sigma=mapping.sigma)

    def network(self) -> Network:
        """Read all tables and return the network."""
        for section in self.map.sections:
            file = self.path
            if section.file is not None:
                try:
                    file = inside(self.path.parent, section.file, section.where)
                except InputError as error:
                    self.problems.extend(error.problems)
                    continue
            read = {
                "points": self._point,
                "readings": self._reading,
                "observations": self._observation,
            }[section.name]
            self.book.source = self.source = Source(file, self.problems)
            self.book.current = None
            for line, row in self._rows(file, section):
                read(line, row)
        self.book.source = self.source = Source(self.path, self.problems)
        for o in self.observations:
            for name in o.points():
                self.book.point(0, name)
        self.problems.raise_all()
        self.book.others += self.observations
        network = self.book.network()
        zenith = any(o.kind in ("zenith_angle", "vertical_angle") for o in self.observations)
        if zenith and self.accuracies.refraction is not None:
            network.set_refraction(value=self.accuracies.refraction - 1.0, fixed=True)
        return self._with_held(network)

    def _with_held(self, network: Network) -> Network:
        """Return the network with the axes of the mapping and the points that the table holds."""
        if not any(self.held.values()) and self.map.axes == "en":
            return network
        held = any(self.held.values()) or bool(self.book.held)
        out = Network(
            network.name,
            frame=LocalFrame(axes=self.map.axes),  # type: ignore[arg-type]
            datum="given" if held else "free",
        )
        for p in network.points.values():
            axes = {*p.held, *self.held.get(p.name, "")}
            out.add_point(p.name, p.coordinates, fixed="".join(a for a in "xyz" if a in axes))
        for group, unknown in network.refractions.items():
            out.set_refraction(str(group), value=unknown.values[0], fixed=True)
        for kind, table in network.parameters.items():
            if kind != "refraction":
                out.parameters[kind] = dict(table)
        out.add(*network.observations.values())
        out.doubts = list(network.doubts)
        out.left_out = list(network.left_out)
        out.remarks = list(network.remarks)
        return out

    # -- rows -----------------------------------------------------------------------------------

    def _rows(self, file: Path, section: MappedSection) -> Iterator[tuple[int, dict[str, str]]]:
        """Iterate over the rows of a file: line, and filled cells by column of this package."""
        lines = self._lines(file)
        start = max(self.map.header - 1, 0)
        if len(lines) <= start:
            self.source.wrong(0, "has no header, or no rows")
            return
        delimiter = self.map.delimiter or next((d for d in ";\t," if d in lines[start]), ",")
        found = csv.reader(lines[start:], delimiter=delimiter, skipinitialspace=delimiter == " ")
        header: list[str] | None = None
        try:
            for cells in found:
                line = start + found.line_num
                cells = [unguarded_cell(c.strip()) for c in cells]
                if delimiter == " ":
                    cells = [c for c in cells if c]
                if any(len(c) > MAX_CELL for c in cells):
                    what = f"a cell has more than {MAX_CELL} characters: a missing quotation mark?"
                    self.source.wrong(line, what)
                    return
                if header is None:
                    header = self._header(file, line, cells, section)
                    if header is None:
                        return
                    if self.map.header:
                        continue
                if any(cells):
                    yield line, self._cells(file, line, header, cells, section)
        except csv.Error as error:
            self.source.wrong(start + 1, f"is not a table: {error}")

    def _lines(self, file: Path) -> list[str]:
        try:
            text = read_bytes(file).decode(self.map.encoding)
        except InputError as error:
            self.problems.extend(error.problems)
            return []
        except UnicodeDecodeError as error:
            line = error.object[: error.start].count(b"\n") + 1
            what = (
                f"is not {self.map.encoding} text: state encoding, such as cp1252, in the mapping"
            )
            self.source.wrong(line, what)
            return []
        text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "\ufffd")
        return [f"{line}\n" for line in text.split("\n")]

    def _header(
        self, file: Path, line: int, cells: list[str], section: MappedSection
    ) -> list[str] | None:
        """Return the names of the columns; None, and a problem, if mapped ones are missing."""
        header = cells if self.map.header else [str(i + 1) for i in range(len(cells))]
        missing = [v for v in section.columns.values() if not v.startswith("=") and v not in header]
        twice = [v for v in section.columns.values() if header.count(v) > 1]
        for name in missing:
            what = f"there is no column {name!r}; columns: {known(header, meant=name, most=30)}"
            self.source.wrong(line, what)
        for name in twice:
            self.source.wrong(line, f"two columns are named {name!r}")
        return None if missing or twice else header

    def _cells(
        self, file: Path, line: int, header: list[str], cells: list[str], section: MappedSection
    ) -> dict[str, str]:
        if len(cells) > len(header) and any(cells[len(header) :]):
            what = f"{len(cells)} cells, but the header has {len(header)} columns"
            self.source.wrong(line, what)
        by_name = dict(zip(header, cells, strict=False))
        out = {}
        for ours, theirs in section.columns.items():
            text = theirs[1:] if theirs.startswith("=") else by_name.get(theirs, "")
            if self.map.decimal == "," and ours not in TEXT_COLUMNS and not theirs.startswith("="):
                text = text.replace(".", "").replace(",", ".") if "," in text else text
            if text:
                out[ours] = text
        return out

    # -- points, readings, observations ---------------------------------------------------------

    def _number(self, line: int, row: dict[str, str], name: str, unit: str) -> float | None:
        if name not in row:
            return None
        try:
            return numbers.parse_quantity(row[name], unit)
        except ValueError as error:
            comma = self.map.decimal == "." and "," in row[name]
            hint = ", or state decimal = ',' in the mapping" if comma else ""
            self.source.wrong(line, f"{name}: {error}{hint}")
            return math.nan

    def _point(self, line: int, row: dict[str, str]) -> None:
        if "name" not in row:
            self.source.wrong(line, "a point without a name")
            return
        values = [self._number(line, row, a, self.map.units.length) for a in "xyz"]
        x, y, z = (math.nan if v is None else v for v in values)
        self.book.point(line, self.source.field(line, row["name"], "name").name(), x, y, z)
        word = row.get("fixed", "").lower()
        axes = word if word and set(word) <= set("xyz") else HELD_BY_WORD.get(word)
        if axes is None:
            self.source.wrong(line, f"fixed must be yes, no or axes such as xy, not {word[:20]!r}")
        elif missing := [a for a, v in zip("xyz", values, strict=True) if a in axes and v is None]:
            if word in ("yes", "true", "1"):
                axes = "".join(a for a in axes if a not in missing)
            else:
                self.source.wrong(line, f"{', '.join(missing)} is held, but has no value")
        self.held[row["name"]] = axes or ""

    def _reading(self, line: int, row: dict[str, str]) -> None:
        station, target = row.get("station", ""), row.get("target", "")
        if not station or not target:
            self.source.wrong(line, "a reading needs station and target")
            return
        length, angle = self.map.units.length, self.map.units.angle
        value = {
            n: self._number(line, row, n, angle if n in ("direction", "zenith") else length)
            for n in (
                "direction",
                "zenith",
                "distance",
                "horizontal_distance",
                "instrument_height",
                "target_height",
            )
        }
        if not any(n in row for n in SIGHT_COLUMNS):
            self.source.wrong(line, f"a reading needs one of {', '.join(SIGHT_COLUMNS)}")
        height, own = value["instrument_height"] or 0.0, row.get("set", "")
        key = (station, height, own)
        if self.book.current is None or key != self.at:
            self.book.begin(line, self.source.field(line, station, "station").name(), height)
            self.at = key
        word = row.get("face", "").lower()
        if word and word not in FACE_BY_WORD:
            self.source.wrong(line, f"face must be 1 or 2 (I, II, L, R), not {word[:20]!r}")
        self.book.sight(
            line,
            self.source.field(line, target, "target").name(),
            direction=value["direction"],
            zenith=value["zenith"],
            distance=value["distance"],
            horizontal=value["horizontal_distance"],
            target_height=value["target_height"] or 0.0,
            face=FACE_BY_WORD.get(word),
        )

    def _observation(self, line: int, row: dict[str, str]) -> None:
        place = self.source.place(line)
        with self.problems.collect(place):
            found = observation_from_record(row, context=self.context, source=place)
            self.observations.append(found)


READER = Reader("columns", (".csv",), "table with a mapping", NetworkReader(read_columns))
