"""CSV tables with line numbers, read and written; fields of any row, with all their problems."""

from __future__ import annotations

import csv
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from ..control_characters import escaped, has_control_characters, why_refused
from ..errors import InputError, Problem, known
from .numbers import checked_number
from .source import FALSE_WORDS, TRUE_WORDS
from .text_files import read_text

MAX_CELL_CHARACTERS = 500
"""Largest number of characters of a cell."""
EXCERPT = 20
"""Number of characters of a longer one that a message quotes."""
REMARK_COLUMNS = ("remark",)
"""Columns for human readers; programs ignore them."""
_POINT = re.compile(r"[+-]?[0-9]*\.[0-9]*")
_WHOLE = re.compile(r"[+-]?[0-9]+")
_QUOTED = re.compile(r'^#|[,;\t\n"]')
_NUMBER = re.compile(
    r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?|[+-]?(inf|nan)"
    r"|[+-]?[0-9]+-[0-9]+-[0-9]+(\.[0-9]*)?"
)
"""Numbers, with angles in degrees, minutes and seconds: programs read them as they are."""
_FORMULA = re.compile("'*[=@+\\-\t\r＝＠＋－]")
"""Beginning of a text that a spreadsheet computes, also in the wide characters of East Asia, or
that would be read as such a text behind its apostrophe."""
Found = TypeVar("Found")
_GUARDED = re.compile("'+[=@+\\-\t\r＝＠＋－]")


@dataclass(frozen=True)
class CsvTable:
    """A CSV table: a header and rows with their line numbers."""

    name: str
    """Name of the file, for messages."""
    columns: tuple[str, ...]
    """Names of the columns."""
    rows: tuple[tuple[int, list[str]], ...]
    """Line and cells of each row; one cell for each column, stripped of blanks at both ends."""

    def where(self, line: int) -> str:
        """Return file:line."""
        return f"{self.name}:{line}"

    def records(self) -> Iterator[tuple[int, dict[str, str]]]:
        """Iterate over the rows: line, and filled fields by column."""
        for line, cells in self.rows:
            yield line, {c: v for c, v in zip(self.columns, cells, strict=True) if v}


def read_table(path: Path, problems: list[Problem]) -> CsvTable | None:
    """Read a table; None if it has no usable header.

    The encoding is UTF-8. The header determines the separator: comma, semicolon or tabulator.
    Empty lines and lines that start with # are skipped.

    Args:
        path: the file.
        problems: list to which problems are added: no such file, not UTF-8, no header, a column
            named twice, a row with more or fewer cells than the header.
    """
    name = path.name
    try:
        text = read_text(path, name)
    except InputError as error:
        problems += error.problems
        return None
    lines = ["\n" if line.startswith("#") else line + "\n" for line in text.split("\n")]
    first = next((line for line in lines if line.strip()), "")
    separator = next((s for s in ",;\t" if s in first), ",")
    reader = csv.reader(lines, delimiter=separator, strict=True)
    found: list[tuple[int, list[str]]] = []
    begun = 1
    try:
        for cells in reader:
            begun = reader.line_num + 1
            if any(cell.strip() for cell in cells):
                found.append((reader.line_num, [unguarded_cell(cell.strip()) for cell in cells]))
    except csv.Error as error:
        problems.append(Problem(f"is not CSV: {error}", f"{name}:{begun}"))
        return None
    for line, cells in found:
        long = next((c for c in cells if len(c) > MAX_CELL_CHARACTERS), None)
        if long is not None:
            what = (
                f"a cell of {len(long)} characters begins with {long[:EXCERPT]!r}: is a quotation "
                f"mark missing? A cell has {MAX_CELL_CHARACTERS} at most"
            )
            problems.append(Problem(what, f"{name}:{line}"))
            return None
    if not found:
        problems.append(Problem("is empty: the first line must name the columns", name))
        return None
    line, header = found[0]
    twice = sorted(c for c, n in Counter(header).items() if n > 1)
    if twice:
        what = "a column without a name" if twice == [""] else f"duplicate column {twice[0]!r}"
        problems.append(Problem(what, f"{name}:{line}"))
        return None
    rows = []
    for number, cells in found[1:]:
        if len(cells) == len(header):
            rows.append((number, cells))
            continue
        what = f"{len(cells)} cells, but the header has {len(header)} columns"
        # A cell of the header has one decimal comma at most.
        may_join = separator == "," and len(header) < len(cells) <= 2 * len(header)
        joined = _joined(cells, len(cells) - len(header)) if may_join else None
        if joined is not None:
            what += "; is one of the commas a decimal comma? Write numbers with a decimal point"
            cells = joined
        problems.append(Problem(what, f"{name}:{number}"))
        # Cells that fit the header are kept, so that later checks see the row.
        rows.append((number, (cells + [""] * len(header))[: len(header)]))
    return CsvTable(name, tuple(header), tuple(rows))


def _joined(cells: Sequence[str], extra: int) -> list[str] | None:
    """Return the cells of a row with as many decimal commas as it has cells too many.

    Names and kinds come first in most rows, so that numbers are joined from the right. Beside
    numbers with a decimal point, single digits are rather cells of their own.

    Returns:
        The cells with decimal points; None if so many commas cannot be between digits.
    """
    fewest = 2 if any(_POINT.fullmatch(c) for c in cells) else 1
    out = list(cells)
    at = len(out) - 2
    while extra and at >= 0:
        rest = out[at + 1]
        if _WHOLE.fullmatch(out[at]) and rest.isdecimal() and len(rest) >= fewest:
            out[at : at + 2] = [f"{out[at]}.{rest}"]
            extra -= 1
            at -= 1
        at -= 1
    return None if extra else out


def write_table(columns: Sequence[str], records: Iterable[Mapping[str, str]]) -> str:
    """Return CSV text of records, without empty columns; the first column is always written."""
    rows = list(records)
    return write_columns({c: [r.get(c, "") for r in rows] for c in columns})


def write_columns(columns: Mapping[str, Sequence[str]]) -> str:
    """Return CSV text of columns, without empty ones; the first column is always written."""
    used = [c for i, c in enumerate(columns) if i == 0 or any(columns[c])]
    return write_all_columns({c: columns[c] for c in used})


def write_all_columns(columns: Mapping[str, Sequence[str]]) -> str:
    """Return CSV text of columns.

    Text that a spreadsheet would take for a formula has an apostrophe before it, which
    `unguarded_cell` removes; control characters are escapes.
    """
    header = _cells(list(columns))
    lines = [",".join(header), *map(",".join, zip(*map(_cells, columns.values()), strict=True))]
    return "\n".join(lines) + "\n"


def unguarded_cell(cell: str) -> str:
    """Return the text of a cell without the apostrophe that kept it from being a formula."""
    return cell[1:] if cell.startswith("'") and _GUARDED.match(cell) else cell


def _cells(texts: Sequence[str]) -> Sequence[str]:
    """Return texts as cells: guarded, escaped and quoted where needed; most need nothing."""
    every = "".join(texts)
    if any(c in every for c in "=@+-\t\r＝＠＋－"):
        texts = ["'" + t if _FORMULA.match(t) and not _NUMBER.fullmatch(t) else t for t in texts]
    if not every.isprintable():
        texts = [escaped(t) for t in texts]
    if not any(c in every for c in '#,;\t\n"'):
        return texts
    return ['"' + t.replace('"', '""') + '"' if _QUOTED.search(t) else t for t in texts]


class FieldRow:
    """The fields of one row, record or TOML table; every method notes problems.

    ``failed`` says whether the row has a problem.
    """

    def __init__(
        self, fields: Mapping[str, object], where: str, problems: list[Problem], of: str = ""
    ) -> None:
        """Take fields; empty fields count as absent."""
        self.fields = {k: v for k, v in fields.items() if v is not None and v != ""}
        self.where = where
        self.of = of
        self.problems = problems
        self.taken: set[str] = set()
        self._before = len(problems)

    @property
    def failed(self) -> bool:
        """Whether a problem was noted since the row was created."""
        return len(self.problems) > self._before

    @property
    def place(self) -> str:
        """Place of the row in its file, and the name of its entity or observation."""
        return ": ".join(part for part in (self.where, self.of) if part)

    def wrong(self, what: str) -> None:
        """Note a problem."""
        self.problems.append(Problem(what, self.place))

    def wrong_all(self, error: InputError) -> None:
        """Note the problems of an error; the place of this row precedes theirs."""
        for p in error.noted:
            inside = p.where if p.where and p.where not in self.place else ""
            inside = inside.removeprefix(f"{self.where}: ")
            where = ": ".join(part for part in (self.where, inside or self.of) if part)
            self.problems.append(Problem(p.what, where))

    def __contains__(self, name: str) -> bool:
        return name in self.fields

    def take(self, name: str, *, required: bool = False) -> object | None:
        """Return a field as it is."""
        self.taken.add(name)
        value = self.fields.get(name)
        if value is None and required:
            self.wrong(f"{name} is missing")
        return value

    def text(
        self, name: str, *, required: bool = False, default: str | None = None, title: bool = False
    ) -> str | None:
        """Return a field as text, such as a name; a title alone may have control characters."""
        value = self.take(name, required=required)
        if value is None:
            return default
        if isinstance(value, bool | float | list | dict):
            self.wrong(f"{name} must be text, not {value!r}")
            return default
        text = str(value)
        if not title and has_control_characters(text):
            self.wrong(why_refused(text))
            return default
        return text

    def choice(self, name: str, choices: Iterable[str], default: str) -> str:
        """Return one of the choices."""
        value = self.text(name, default=default)
        valid = tuple(choices)
        if value not in valid:
            self.wrong(f"unknown {name} {value!r}; valid: {known(valid, meant=value, most=40)}")
            return default
        return value

    def flag(self, name: str) -> bool:
        """Return whether a field says yes."""
        value = self.take(name)
        if isinstance(value, bool):
            return value
        text = "" if value is None else str(value).lower()
        if text not in (*TRUE_WORDS, *FALSE_WORDS):
            self.wrong(f"{name} must be yes or no, not {value!r}")
        return text in TRUE_WORDS

    def letters(self, name: str, valid: Iterable[str]) -> tuple[str, ...]:
        """Return some of the valid words: separated by blanks, or letters in one word."""
        choices = tuple(valid)
        text = self.text(name, default="") or ""
        single = all(len(c) == 1 for c in choices)
        words = tuple(text.replace(" ", "")) if single else tuple(text.split())
        unknown = [w for w in words if w not in choices]
        if unknown:
            self.wrong(f"{name} must be some of {', '.join(choices)}, not {text!r}")
        return tuple(w for w in words if w in choices)

    def number(
        self, name: str, unit: str = "", *, required: bool = False, positive: bool = False
    ) -> float | None:
        """Return a finite number in SI; None if it is absent or wrong (then a problem is noted)."""
        value = self.take(name, required=required)
        if value is None:
            return None
        try:
            return checked_number(value, name, unit, above=0.0 if positive else -math.inf)
        except ValueError as error:
            self.wrong(str(error))
            return None

    def whole(self, name: str, *, least: int = 0, most: float = math.inf) -> int | None:
        """Return a whole number; None if it is absent or wrong (then a problem is noted)."""
        value = self.take(name)
        if value is None:
            return None
        try:
            found = checked_number(value, name)
        except ValueError:
            found = math.nan
        if found.is_integer() and least <= found <= most:
            return int(found)
        valid = f"a whole number from {least}" + (f" to {most}" if most < math.inf else "")
        valid = f"{least} or {most}" if most == least + 1 else valid
        self.wrong(f"{name} must be {valid}, not {value!r}")
        return None

    def texts(self, name: str, what: str, such: str) -> tuple[str, ...] | None:
        """Return a list of texts; None if it is absent or wrong (then a problem is noted).

        Args:
            name: name of the field.
            what: what the texts are, for messages: ``names of points``.
            such: an example, for messages: ``["D1", "D2"]``.
        """
        value = self.take(name)
        if value is None:
            return None
        if isinstance(value, list | tuple) and all(isinstance(v, str) and v for v in value):
            return tuple(value)
        self.wrong(f"{name} must be a list of {what}, such as {such}, not {value!r}")
        return None

    def made(self, make: Callable[[], Found], before: str = "") -> Found | None:
        """Return what a function makes; None after an InputError, whose problems are noted here.

        Args:
            make: the function.
            before: text before each problem, such as the name of the field.
        """
        try:
            return make()
        except InputError as error:
            for p in error.noted:
                self.wrong(f"{before}{p}")
            return None

    def refuse_left(self, valid: Iterable[str] = ()) -> None:
        """Note the filled fields that no method has read; ``valid``: names beside those read."""
        names = list(dict.fromkeys((*self.taken, *valid)))
        for name in self.left():
            listed = known(sorted(names), meant=name, most=60)
            self.wrong(f"unknown key {name!r}; valid: {listed}")

    def present(self, prefix: str, units: Iterable[str]) -> tuple[str, str] | None:
        """Return name and unit of the single filled field ``prefix_unit``."""
        filled = [(f"{prefix}_{u}", u) for u in units if f"{prefix}_{u}" in self.fields]
        if len(filled) > 1:
            self.taken.update(f for f, _ in filled)
            self.wrong("give only one of " + ", ".join(f for f, _ in filled))
        return filled[0] if filled else None

    def quantity(
        self, prefix: str, units: Iterable[str], *, positive: bool = False
    ) -> float | None:
        """Return the number in the field ``prefix_unit``, in SI."""
        found = self.present(prefix, units)
        return None if found is None else self.number(*found, positive=positive)

    def left(self) -> list[str]:
        """Return the filled fields that no method has read."""
        return [f for f in self.fields if f not in self.taken and f not in REMARK_COLUMNS]


def rows_of_tables(given: object, key: str, where: str, problems: list[Problem]) -> list[FieldRow]:
    """Return the fields of tables ``[[key]]`` of a TOML file; problems are noted.

    Args:
        given: value of the key in the document; None: there are no tables.
        key: the key.
        where: name of the file; `factorgraph_adj.io.text_files.TomlPlaces` gives the lines.
        problems: list to which problems are added.
    """
    if given is None:
        return []
    if not isinstance(given, list) or not all(isinstance(table, dict) for table in given):
        what = f"{key} must be tables: write [[{key}]] with two brackets above each"
        problems.append(Problem(what, where))
        return []
    rows = []
    for number, table in enumerate(given, 1):
        name = table.get("name", "")
        of = f"[[{key}]] {number}" + (f" {name!r}" if isinstance(name, str) and name else "")
        rows.append(FieldRow(table, where, problems, of))
    return rows


def row_of_table(given: object, key: str, where: str, problems: list[Problem]) -> FieldRow | None:
    """Return the fields of the table ``[key]`` of a TOML file; None: it is none, which is noted."""
    if isinstance(given, dict):
        return FieldRow(given, f"{where}: [{key}]", problems)
    problems.append(Problem(f"{key} must be a table [{key}], not {given!r}", where))
    return None
