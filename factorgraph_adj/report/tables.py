"""Tables of results: columns declared once, rendered as text, HTML, CSV, JSON and arrays.

A `Column` says what is in a cell of a row, in the units of the solution, and how people read
it. `as_text` and `as_html` write what people read; `as_csv`, `as_json` and `as_frame` keep all
digits. A column that is added to a table appears in all five.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from math import isfinite
from typing import Any, Generic, Literal, TypeAlias, TypeVar, overload

import numpy as np

from ..columns import Columns
from ..io.csv_tables import write_columns
from ..io.numbers import parse_quantity, write_quantity
from ..types import Array, Index, Mask
from ..units import ANGLE, LENGTH, decimal, format_angle, format_turn
from .catalogue import Texts
from .layout import figure, short, table

Row = TypeVar("Row")

Rendering: TypeAlias = Literal["text", "html", "csv", "json", "frame"]
"""Ways of writing a table."""
READ: tuple[Rendering, ...] = ("text", "html")
"""Renderings for people."""
DATA: tuple[Rendering, ...] = ("csv", "json", "frame")
"""Renderings for programs."""
ENGLISH = Texts("en")
"""Texts of everything but a page in another language."""
NO_FIGURE = "–"
"""What a page shows for a figure that does not exist."""
MIN_LONG_TEXT, MAX_CELLS_EXAMINED = 31, 1000
"""Number of letters from which a text is long, and number of cells that are examined for it."""
ROWS_PER_PAGE = 25
"""Number of rows that a table shows at a time, and has in a page whose script does not run."""


FIGURE_SPACE, POINT_SPACE = "\u2007", "\u2008"
"""Blanks as wide as a digit and as a decimal point."""
DECIMAL_NUMBER = re.compile(r"-?\d+(\.\d+)?")
"""A number without an exponent."""


@dataclass(frozen=True)
class Unit:
    """Unit in which a figure is shown."""

    name: str = ""
    """Name: m, mgon, dms, px …; empty for a number."""
    size: float = 1.0
    """Size in the unit of the solution: SI, or image units."""
    turn: bool = False
    """Whether figures are angles of the whole circle, from 0 to less than 2π."""

    def shown(self, value: float, digits: int | None) -> str:
        """Write a figure with so many decimals; None: with three significant digits."""
        if digits is None:
            return short(value / self.size)
        if self.turn or self.name == "dms" or self.name in ANGLE:
            return (format_turn if self.turn else format_angle)(value, self.name, digits)
        return decimal(value / self.size, digits)

    def exact(self, value: float) -> str:
        """Write a figure with all its digits; −0 is 0."""
        return write_quantity(value + 0.0, "" if self.size == 1.0 else self.name)


def unit_of(name: str, *, turn: bool = False) -> Unit:
    """Return a unit of lengths or angles; ``dms`` has the size of a second."""
    return Unit(name, ANGLE["arcsec"] if name == "dms" else {**LENGTH, **ANGLE}[name], turn)


NUMBER = Unit()
"""Unit of numbers and image coordinates."""


@dataclass(frozen=True, eq=False)
class FiguresByNumber:
    """The figures of rows, by the number of the row: of one row, or of many as an array."""

    values: Array | Mask | Index | Callable[[], Array]
    """Figures by number; a function that returns them, where they are long to compute."""
    signed: bool = False
    """Whether they have the axes of the network; the sign of a row turns them into its own."""

    def __call__(self, row: Any) -> Any:
        """Return the figure of a row."""
        found = self._every[row.number]
        return row.sign * found if self.signed else found

    def array(self, rows: Sequence[Any]) -> np.ndarray[Any, Any]:
        """Return the figures of rows."""
        found = self._array[_field(rows, "number").astype(np.intp)]
        return np.asarray(_field(rows, "sign") * found if self.signed else found)

    @cached_property
    def _array(self) -> np.ndarray[Any, Any]:
        return self.values() if callable(self.values) else self.values

    @cached_property
    def _every(self) -> list[Any]:
        return list(self._array.tolist())


@dataclass(frozen=True, eq=False)
class ArrayRows(Sequence[Row]):
    """Rows whose fields are arrays; the rows themselves are made when one is asked for.

    Data frames of all observations thus need no object for each of them.
    """

    fields: Mapping[str, np.ndarray[Any, Any]]
    """Fields of the rows, (n,) each, by name."""
    make: Callable[[], Sequence[Row]]
    """Function that returns all rows."""

    @classmethod
    def of(
        cls, row: Callable[..., Row], **fields: np.ndarray[Any, Any] | Sequence[str]
    ) -> ArrayRows[Row]:
        """Return rows of a class, from its fields by name; texts may be any sequence."""
        arrays = {
            n: v if isinstance(v, np.ndarray) else np.array(v, dtype=object)
            for n, v in fields.items()
        }
        return cls(
            arrays,
            lambda: list(map(row, *(v.tolist() for v in arrays.values()))),
        )

    def __len__(self) -> int:
        return len(next(iter(self.fields.values())))

    @overload
    def __getitem__(self, at: int) -> Row: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Row]: ...
    def __getitem__(self, at: int | slice) -> Row | Sequence[Row]:
        """Return one row, or several."""
        return self._made[at]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._made)

    @cached_property
    def _made(self) -> Sequence[Row]:
        return self.make()


def _field(rows: Sequence[Any], name: str) -> np.ndarray[Any, Any]:
    """Return a field of rows as an array."""
    if isinstance(rows, ArrayRows) and name in rows.fields:
        return rows.fields[name]
    return np.array([getattr(row, name) for row in rows])


@dataclass(frozen=True, kw_only=True)
class Column(Generic[Row]):
    """One column of a table."""

    title: str
    """Heading: a symbol, or an identifier ``col_TITLE`` of the catalogue without its ``col_``."""
    value: str | Callable[[Row], Any]
    """The cell, a function of the row or the name of a field of it: a figure in the unit of the
    solution, an integer, a truth value or a text; None: the cell is empty."""
    unit: Unit | Callable[[Row], Unit] = NUMBER
    """Unit in which the figure is shown; that of the whole column is in its heading."""
    digits: int | Callable[[Row], int | None] | None = None
    """Decimals of the figure where people read it; None: three significant digits."""
    help: str = ""
    """Identifier of the sentence that explains the column, without its ``help_``; empty: none."""
    key: str = ""
    """Name in CSV, JSON and frames; empty: the title."""
    frame_key: str = ""
    """Name in frames where it is another."""
    only: Collection[str] = (*READ, *DATA)
    """Renderings that have the column."""
    shown: Callable[[Row], str | None] | None = None
    """Words that people read in place of the figure, such as ``held``; None for the figure."""
    resolved: int | None = None
    """Decimals of the figure in CSV, without zeros at its end; None: as `exact` says."""
    exact: bool = False
    """Whether CSV has the figure with all its digits; otherwise it has nine."""
    suffix: bool = False
    """Whether the name in CSV ends in the unit."""
    with_unit: bool = False
    """Whether the unit stands behind each figure of the text, as rows have several."""
    short_heading: bool = False
    """Whether the heading in text lacks the unit, which a sentence below the table states."""
    below: str | None = None
    """Where the cell is in text: None: in a column of its own; title of a column: below the
    cell of that column; empty: in a paragraph below the row."""
    translated: bool = False
    """Whether cells are names of kinds or states, which a page has in its language."""
    english: bool = False
    """Whether cells are sentences of the adjustment itself, English in every language."""

    @property
    def name(self) -> str:
        """Name in JSON."""
        return self.key or self.title

    @property
    def csv_name(self) -> str:
        """Name in CSV."""
        unit = self.unit.name if self.suffix and isinstance(self.unit, Unit) else ""
        return f"{self.name}_{unit}" if unit else self.name

    def of(self, row: Row) -> Any:
        """Return the cell of a row; a number of numpy becomes one of Python."""
        if callable(self.value):
            found = self.value(row)
        else:
            found = row[self.value] if isinstance(row, dict) else getattr(row, self.value)
        return found.item() if isinstance(found, np.generic) else found

    def array(self, rows: Sequence[Row]) -> np.ndarray[Any, Any]:
        """Return the cells of rows: at once, where they are figures by number or fields in arrays.

        Cells that are not all numbers or truth values make an array of objects.
        """
        if isinstance(self.value, FiguresByNumber):
            return self.value.array(rows)
        if (
            isinstance(self.value, str)
            and isinstance(rows, ArrayRows)
            and self.value in rows.fields
        ):
            return rows.fields[self.value]
        cells = [self.of(row) for row in rows]
        texts = not all(isinstance(v, bool | int | float) for v in cells)
        texts = texts or not (cells or _is_figure(self, ()))
        return np.array(cells, dtype=object if texts else None)

    def read(self, row: Row, *, missing: str = "") -> str:
        """Return the cell as people read it."""
        words = None if self.shown is None else self.shown(row)
        if words is not None:
            return words
        value = self.of(row)
        if isinstance(value, float):
            if not isfinite(value):
                return missing
            digits = self.digits(row) if callable(self.digits) else self.digits
            return self._unit(row).shown(value, digits)
        return missing if value is None else _plain(value)

    def written(self, row: Row) -> str:
        """Return the cell for CSV."""
        value = self.of(row)
        if not isinstance(value, float):
            return "" if value is None else _plain(value)
        if not isfinite(value):
            return ""
        unit = self._unit(row)
        if self.resolved is not None:
            value = parse_quantity(unit.shown(value, self.resolved), unit.name)
            return unit.exact(value)
        return unit.exact(value) if self.exact else figure(value / unit.size)

    def heading(self, t: Texts, *, short: bool = False) -> str:
        """Return the heading with the unit of the whole column; a short one has none."""
        unit = "" if short or callable(self.unit) else self.unit.name
        return f"{t.heading(self.title)} [{unit}]" if unit else t.heading(self.title)

    def _unit(self, row: Row) -> Unit:
        return self.unit(row) if callable(self.unit) else self.unit


def _plain(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return str(value)


@dataclass(frozen=True)
class Table(Generic[Row]):
    """Rows with the columns that say what is in their cells."""

    name: str
    """Name, by which pages and files know the table."""
    rows: Sequence[Row]
    """The rows."""
    columns: Sequence[Column[Row]]
    """The columns of all renderings, in their order."""

    def within(self, rendering: Rendering) -> list[Column[Row]]:
        """Return the columns of a rendering."""
        return [c for c in self.columns if rendering in c.only]


# -- for people -----------------------------------------------------------------------------------


def as_text(made: Table[Row], t: Texts = ENGLISH) -> list[str]:
    """Return a table as lines of text, without columns that no row fills.

    Columns of texts are flush left, until the first of figures.
    """
    columns = [c for c in made.within("text") if c.below is None]
    cells = [text_cells(c, made.rows) for c in columns]
    lower = {c.below: text_cells(c, made.rows) for c in made.within("text") if c.below}
    kept = [i for i, c in enumerate(columns) if any(cells[i]) or any(lower.get(c.title, ()))]
    sentences = [c for c in made.within("text") if c.below == ""]
    rows: list[list[str]] = []
    notes: list[str] = []
    for number, row in enumerate(made.rows):
        rows.append([cells[i][number] for i in kept])
        below = (lower.get(columns[i].title) for i in kept)
        second = ["" if column is None else column[number] for column in below]
        note = " ".join(filter(None, (c.read(row) for c in sentences)))
        rows += [second] if any(second) else []
        notes += ["", note] if any(second) else [note]
    left = next((n for n, i in enumerate(kept) if _is_figure(columns[i], made.rows)), len(kept))
    heads = [columns[i].heading(t, short=columns[i].short_heading) for i in kept]
    return table(heads, rows, left=left, notes=notes if sentences else ())


def text_cells(column: Column[Row], rows: Sequence[Row]) -> list[str]:
    """Return the cells of a column as text has them."""
    texts = [column.read(row) for row in rows]
    if not column.with_unit:
        return texts
    units = [column._unit(row).name for row in rows]
    width = max(map(len, units), default=0)
    return [f"{x} {u:{width}}" if width and x else x for x, u in zip(texts, units, strict=True)]


def _is_figure(column: Column[Row], rows: Sequence[Row]) -> bool:
    """Return whether a column has figures: it has a unit, or its first cell is a number."""
    if column.unit is not NUMBER or column.digits is not None:
        return True
    first = next((v for row in rows if (v := column.of(row)) is not None), None)
    return isinstance(first, int | float) and not isinstance(first, bool)


@dataclass(frozen=True)
class SheetColumn:
    """One column of a table of a page."""

    title: str
    """Its heading, with the unit in brackets."""
    values: Sequence[str]
    """Its cells."""
    numeric: bool = False
    """Whether it is sorted as numbers, which are aligned at their decimal points."""
    help: str = ""
    """What the heading means, in a sentence; empty where it says so itself."""
    english: bool = False
    """Whether its cells are words of the adjustment itself, English in every language."""

    @property
    def look(self) -> str:
        """Class of its cells in the style sheet: ``number``, ``long`` for long texts, or none."""
        if self.numeric:
            return "number"
        some = self.values[:MAX_CELLS_EXAMINED]
        return "long" if any(len(v) >= MIN_LONG_TEXT for v in some) else ""

    @cached_property
    def decimals(self) -> int:
        """Largest number of decimals of its figures; −1 where there are none."""
        return max(map(_decimals, self.values), default=-1) if self.numeric else -1

    def pad(self, cell: str) -> str:
        """Return blanks as wide as what a cell lacks behind its last digit, see `decimals`."""
        own = _decimals(cell)
        if self.decimals <= 0 or own == self.decimals:
            return ""
        return (POINT_SPACE if own <= 0 else "") + FIGURE_SPACE * (self.decimals - max(own, 0))


@dataclass(frozen=True)
class Sheet:
    """One table of a page."""

    id: str
    """Name of the table in the page."""
    caption: str
    """What the rows are."""
    columns: Sequence[SheetColumn]
    """The columns, all of the same length."""
    notes: Sequence[str] = field(default_factory=tuple)
    """Sentences below the table."""
    order: str = ""
    """How the rows are ordered at first, for the caption; empty: as in the network."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.columns[0].values) if self.columns else 0

    @property
    def first(self) -> Iterator[tuple[str, ...]]:
        """Rows that stand in the page before its script has run."""
        return zip(*(c.values[:ROWS_PER_PAGE] for c in self.columns), strict=True)

    @property
    def data(self) -> dict[str, Any]:
        """What the script of the page needs."""
        return {
            "looks": [c.look for c in self.columns],
            "english": [c.english for c in self.columns],
            "decimals": [c.decimals for c in self.columns],
            "columns": [list(c.values) for c in self.columns],
        }


def _decimals(cell: str) -> int:
    """Return the number of decimals of a figure; −1 of other texts."""
    found = DECIMAL_NUMBER.fullmatch(cell)
    return len(found[1] or ".") - 1 if found else -1


def as_html(
    made: Table[Row], t: Texts, *, caption: str = "", notes: Sequence[str] = (), order: str = ""
) -> Sheet | None:
    """Return the sheet of a table for a page; None for a table without rows.

    Args:
        made: the table; columns that no row fills are left out.
        t: texts of the language.
        caption: what the rows are; by default the text ``NAME_caption``.
        notes: sentences below it; empty ones are left out.
        order: how the rows are ordered.
    """
    columns = []
    for c in made.within("html"):
        cells = [c.read(row, missing=NO_FIGURE) for row in made.rows]
        if all(v in ("", NO_FIGURE) for v in cells):
            continue
        if c.translated:
            names = {v: t.kind(v) for v in set(cells)}
            cells = [names[v] for v in cells]
        helped = t(f"help_{c.help}") if c.help else ""
        # Degrees-minutes-seconds are no numbers to a script that sorts.
        numeric = _is_figure(c, made.rows) and (callable(c.unit) or c.unit.name != "dms")
        columns.append(SheetColumn(c.heading(t), cells, numeric, helped, c.english))
    if not columns:
        return None
    said = caption or t(f"{made.name}_caption")
    return Sheet(made.name, said, columns, tuple(n for n in notes if n), order)


# -- for programs ---------------------------------------------------------------------------------


def as_csv(made: Table[Any], *further: Table[Any]) -> str:
    """Return a table as CSV, without columns that no row fills.

    Args:
        made: the table.
        further: tables whose rows follow, in the columns of the first that they have.
    """
    return write_columns(csv_columns(made, *further))


def csv_columns(made: Table[Any], *further: Table[Any]) -> dict[str, list[str]]:
    """Return the columns of `as_csv`."""
    out = {c.csv_name: [c.written(row) for row in made.rows] for c in made.within("csv")}
    for more in further:
        columns = {c.csv_name: c for c in more.within("csv")}
        for name, cells in out.items():
            c = columns.get(name)
            cells += [""] * len(more.rows) if c is None else [c.written(row) for row in more.rows]
    return out


def as_json(made: Table[Row]) -> list[dict[str, Any]]:
    """Return the rows of a table as objects, with figures in the units of the solution."""
    columns = made.within("json")
    return [{c.name: c.of(row) for c in columns} for row in made.rows]


def as_json_by_name(made: Table[Row]) -> dict[str, dict[str, Any]]:
    """Return the rows as objects by their first cell, without the members that are None."""
    first, *others = made.within("json")
    return {
        first.of(row): {c.name: v for c in others if (v := c.of(row)) is not None}
        for row in made.rows
    }


def as_json_columns(made: Table[Row]) -> dict[str, list[Any]]:
    """Return the columns of a table as lists, as `as_json` does with rows."""
    return {c.name: [c.of(row) for row in made.rows] for c in made.within("json")}


def as_frame(made: Table[Row]) -> Columns:
    """Return a table as arrays, which become data frames and show themselves in notebooks."""
    return Columns(
        made.name, {c.frame_key or c.name: c.array(made.rows) for c in made.within("frame")}
    )
