"""Reader of tables of any program by a column map: points, readings, levelling, observations."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

from ...errors import InputError, Problem, known
from ...files import inside, read_bytes
from ...frames import LocalFrame
from ...network.network import Network
from ...observations import Observation
from ...units import LENGTH
from .. import numbers
from ..csv_tables import unguarded_cell
from ..field_books.accuracies import DEFAULT_ACCURACIES, Accuracies
from ..field_books.field_book import FieldBook
from ..field_books.plane_readings import NOT_IN_PLAN, plane_readings
from ..format_reader import NetworkReader, Reader
from ..observation_fields import RecordContext
from ..observation_records import observation_from_record
from ..source import LeftOutReason, Problems, Source
from .column_map import (
    MAPPED_ANGLES,
    MAPPED_LENGTHS,
    TEXT_COLUMNS,
    ColumnMap,
    MappedSection,
    column_map,
)
from .proposed_column_map import guessed_mapping
from .workbook import is_workbook, sheet_rows

MAX_CELL = 500
"""Characters of a cell; more are a missing quotation mark."""
HELD_BY_WORD = {
    **dict.fromkeys(
        ("yes", "true", "1", "ja", "oui", "si", "sí", "sim", "tak", "igen", "да"), "xyz"
    ),
    **dict.fromkeys(("no", "false", "0", "", "nein", "non", "não", "nee", "nie", "nem", "нет"), ""),
    "x": "x",
}
"""Words in the column ``fixed``, beside axes such as xyz, xy and z."""
FACE_BY_WORD = {"1": 1, "i": 1, "f1": 1, "l": 1, "2": 2, "ii": 2, "f2": 2, "r": 2}
"""Words in the column ``face``."""
KINDS_OF_HEIGHT = (
    "height_difference",
    "height",
    "zenith_angle",
    "vertical_angle",
    "slope_distance",
)
"""Kinds of observations that a plane network cannot have; a network of heights has the first."""
IN_PLAN_ALONE = LeftOutReason(
    "readings and observations", "a network of heights (dimension = 1) has levelled ones alone"
)
NOT_FREE = {1: "xy", 2: "z"}
"""Axes in which all points are held, by dimension."""
SIGHT_COLUMNS = ("direction", "zenith", "distance", "horizontal_distance")
"""Columns of what is read to a target; a reading has one of them at least."""


def read_columns(
    path: str | Path,
    *,
    mapping: ColumnMap | Mapping[str, Any] | str | Path | None = None,
    sheet: str | None = None,
    dimension: Literal[1, 2, 3] | None = None,
    fixed: str | Iterable[str] = (),
    accuracies: Accuracies = DEFAULT_ACCURACIES,
) -> Network:
    """Read points, readings, levelled lines and observations from tables of any program.

    The mapping, a dictionary or a TOML file, says for each column of this package which header of
    the file it is, or, after ``=``, a constant. It has up to four tables, which are read from the
    same file or, with ``file`` and ``sheet``, from another beside it or another sheet:

    - ``points``: name, x, y, z, fixed (yes, no or axes such as xy);
    - ``readings``: station, target, direction, zenith, distance, horizontal_distance, set, face,
      instrument_height, target_height: a field book, whose faces are reduced;
    - ``levelling``: station, target, difference, length of the line;
    - ``observations``: kind and the columns of this kind in observations.csv.

    Keys beside them: ``delimiter`` (from the header if absent), ``decimal`` (``.`` or ``,``),
    ``encoding``, ``header`` (line of the header; 0: none, columns are named 1, 2, …), which a table
    may also state for itself, ``axes`` (en or ne: what x and y are; default en), ``sheet``,
    ``dimension``, ``units`` (length, also ft and us-ft; angle, also packed, D.MMSS; line) and
    ``sigma``, standard deviations by kind as in project.toml. Columns of the file that are not
    mapped are not read. A row of points without coordinates and empty rows of another table are no
    error; a point that only readings or observations name is unknown. Points that no table states
    are added; those that are levelled alone are held in plan.

    Without a mapping the error proposes one that is guessed from the header, in TOML; ``"guess"``
    uses it where the file leaves nothing open, and a remark of the network has it.

    Args:
        path: the table: text with separators, or a workbook of Excel.
        mapping: the mapping, a TOML file with it, or "guess".
        sheet: sheet of a workbook; None: that of the mapping, or its only one.
        dimension: 1: heights alone, all points are held in plan; 2: a plane network, all points are
            held in height and slope distances are reduced by zenith readings; None: that of the
            mapping, or 3.
        fixed: names of points that are held, beside those whose column says so.
        accuracies: standard deviations, faces and refraction, see `factorgraph_adj.Accuracies`.

    Raises:
        InputError: every problem of mapping and tables, each with file and line.
    """
    source = Path(path)
    remark = ""
    if mapping is None or mapping == "guess":
        guess = guessed_mapping(source, sheet)
        if mapping is None:
            raise InputError(Problem(guess.proposal(), source.name))
        mapping, remark = guess.checked(), guess.remark()
    found = column_map(mapping)
    found = replace(
        found,
        sheet=found.sheet if sheet is None else sheet,
        dimension=found.dimension if dimension is None else dimension,
    )
    return _Reader(source, found, accuracies, fixed, remark).network()


class _Reader:
    def __init__(
        self,
        path: Path,
        mapping: ColumnMap,
        accuracies: Accuracies,
        fixed: str | Iterable[str],
        remark: str,
    ) -> None:
        self.path = path
        self.map = mapping
        self.accuracies = accuracies
        self.problems = Problems()
        self.problems.remarks += [remark] if remark else []
        self.source = Source(path, self.problems)
        self.book = FieldBook(self.source, accuracies, fixed, zero_is_unmeasured=False)
        self.held: dict[str, str] = {}
        self.observations: list[Observation] = []
        self.decimal = "."
        self.at: tuple[str, float, str] | None = None
        self.context: RecordContext | None = None
        if mapping.units.of_project is not None:
            self.context = RecordContext(units=mapping.units.of_project, sigma=mapping.sigma)

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
                "levelling": self._levelled,
                "observations": self._observation,
            }[section.name]
            self.book.source = self.source = Source(file, self.problems)
            self.book.current = None
            self.decimal = section.layout.decimal
            for line, row in self._rows(file, section):
                read(line, row)
        self.book.source = self.source = Source(self.path, self.problems)
        for o in self.observations:
            levelled = o.kind == "height_difference"
            for name in o.points():
                self.book.point(0, name)
                (self.book.levelled_points if levelled else self.book.sighted).add(name)
        self.problems.raise_all()
        self.book.others += self.observations
        network = self.book.network()
        zenith = any(o.kind in ("zenith_angle", "vertical_angle") for o in self.observations)
        if zenith and self.accuracies.refraction is not None:
            network.set_refraction(value=self.accuracies.refraction - 1.0, fixed=True)
        return self._with_held(network)

    def _with_held(self, network: Network) -> Network:
        """Return the network with the axes and the dimension of the mapping, and points held."""
        not_free = NOT_FREE.get(self.map.dimension or 3, "")
        if not any(self.held.values()) and self.map.axes == "en" and not not_free:
            return network
        held = any(self.held.values()) or bool(self.book.held)
        out = Network(
            network.name,
            frame=LocalFrame(axes=self.map.axes),  # type: ignore[arg-type]
            datum="given" if held else "free",
        )
        for p in network.points.values():
            axes = {*p.held, *self.held.get(p.name, ""), *not_free}
            place = [
                0.0 if math.isnan(v) and a in not_free else v
                for a, v in zip("xyz", p.coordinates, strict=True)
            ]
            out.add_point(p.name, place, fixed="".join(a for a in "xyz" if a in axes))
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
        header: list[str] | None = None
        problems = self.problems.count
        for line, found in self._table(file, section):
            cells = [unguarded_cell(c.strip()) for c in found]
            if any(len(c) > MAX_CELL for c in cells):
                what = f"a cell has more than {MAX_CELL} characters: a missing quotation mark?"
                self.source.wrong(line, what)
                return
            if header is None:
                header = self._header(file, line, cells, section)
                if header is None:
                    return
                if section.layout.header:
                    continue
            if any(cells):
                yield line, self._cells(file, line, header, cells, section)
        if header is None and self.problems.count == problems:
            self.source.wrong(0, "has no header, or no rows")

    def _table(self, file: Path, section: MappedSection) -> Iterator[tuple[int, list[str]]]:
        """Iterate over the rows from that of the header on: line and cells."""
        start = max(section.layout.header - 1, 0)
        if is_workbook(file):
            rows = self.problems.attempt(
                file.name, sheet_rows, file, section.sheet or self.map.sheet
            )
            yield from ((line, cells) for line, cells in rows or () if line > start)
            return
        lines = self._lines(file, section)
        if len(lines) <= start:
            return
        delimiter = section.layout.delimiter or next((d for d in ";\t," if d in lines[start]), ",")
        found = csv.reader(lines[start:], delimiter=delimiter, skipinitialspace=delimiter == " ")
        try:
            for cells in found:
                if delimiter == " ":
                    cells = [c for c in cells if c]
                yield start + found.line_num, cells
        except csv.Error as error:
            self.source.wrong(start + 1, f"is not a table: {error}")

    def _lines(self, file: Path, section: MappedSection) -> list[str]:
        try:
            text = read_bytes(file).decode(section.layout.encoding)
        except InputError as error:
            self.problems.extend(error.problems)
            return []
        except UnicodeDecodeError as error:
            line = error.object[: error.start].count(b"\n") + 1
            encoding = section.layout.encoding
            what = f"is not {encoding} text: state encoding, such as cp1252, in the mapping"
            self.source.wrong(line, what)
            return []
        text = text.replace("\r\n", "\n").replace("\r", "\n").replace("\0", "\ufffd")
        return [f"{line}\n" for line in text.split("\n")]

    def _header(
        self, file: Path, line: int, cells: list[str], section: MappedSection
    ) -> list[str] | None:
        """Return the names of the columns; None, and a problem, if mapped ones are missing."""
        header = cells if section.layout.header else [str(i + 1) for i in range(len(cells))]
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
            is_number = ours not in TEXT_COLUMNS and not theirs.startswith("=")
            if section.layout.decimal == "," and is_number:
                text = text.replace(".", "").replace(",", ".") if "," in text else text
            if text:
                out[ours] = text
        return out

    # -- points, readings, observations ---------------------------------------------------------

    def _number(self, line: int, row: dict[str, str], name: str, unit: str) -> float | None:
        if name not in row:
            return None
        try:
            # Feet are no unit of a project, whose numbers keep every bit.
            if unit in MAPPED_LENGTHS and unit not in LENGTH:
                return numbers.parse_quantity(row[name]) * MAPPED_LENGTHS[unit]
            return numbers.parse_quantity(row[name], unit)
        except ValueError as error:
            comma = self.decimal == "." and "," in row[name]
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
            if not set(word) <= set("xyz"):
                axes = "".join(a for a in axes if a not in missing)
            else:
                self.source.wrong(line, f"{', '.join(missing)} is held, but has no value")
        self.held[row["name"]] = axes or ""

    def _reading(self, line: int, row: dict[str, str]) -> None:
        station, target = row.get("station", ""), row.get("target", "")
        if not station or not target:
            self.source.wrong(line, "a reading needs station and target")
            return
        length, angle = self.map.units.length, MAPPED_ANGLES[self.map.units.angle]
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
        lengths = {n: value[n] for n in ("zenith", "distance")}
        lengths["horizontal"] = value["horizontal_distance"]
        if self.map.dimension == 1:
            self.source.leave_out(line, IN_PLAN_ALONE, target)
            return
        if self.map.dimension == 2:
            lengths = {"horizontal": plane_readings(self.source, line, target, **lengths)}
            if value["direction"] is lengths["horizontal"] is None:
                return
        self.book.sight(
            line,
            self.source.field(line, target, "target").name(),
            direction=value["direction"],
            zenith=lengths.get("zenith"),
            distance=lengths.get("distance"),
            horizontal=lengths["horizontal"],
            target_height=value["target_height"] or 0.0,
            face=FACE_BY_WORD.get(word),
        )

    def _levelled(self, line: int, row: dict[str, str]) -> None:
        station, target = (
            self.source.field(line, row.get(n), n).name() for n in ("station", "target")
        )
        units = self.map.units
        value = self._number(line, row, "difference", units.length)
        length = self._number(line, row, "length", units.line or units.length)
        if value is None:
            self.source.wrong(line, "a levelled line needs the column difference")
        elif self.map.dimension == 2:
            self.source.leave_out(line, NOT_IN_PLAN, target)
        elif station and target:
            self.book.levelled(line, station, target, value, length or 0.0)

    def _observation(self, line: int, row: dict[str, str]) -> None:
        place = self.source.place(line)
        if self.context is None:
            what = "other observations have units of a project: use readings or levelling, "
            self.problems.wrong(f"{what}or convert feet and packed degrees", place)
            return
        with self.problems.collect(place):
            found = observation_from_record(row, context=self.context, source=place)
            if found.kind in KINDS_OF_HEIGHT and self.map.dimension == 2:
                self.source.leave_out(line, NOT_IN_PLAN, found.kind)
            elif found.kind not in KINDS_OF_HEIGHT[:2] and self.map.dimension == 1:
                self.source.leave_out(line, IN_PLAN_ALONE, found.kind)
            else:
                self.observations.append(found)


READER = Reader("columns", (".csv", ".xlsx"), "table with a mapping", NetworkReader(read_columns))
