"""Tables of an HSQLDB database: its script, and the file of its cached tables.

A database ``name`` is up to three files. ``name.script`` has the tables as CREATE statements and
the rows of memory tables as INSERT statements. ``name.data`` has the rows of cached tables; the
script then says where each table begins: ``SET TABLE … INDEX '7 7 0 0 2'`` gives the roots of the
trees of its two indexes, two numbers that are not used here, and the number of rows. ``name.log``
has statements that the program did not yet write into the others.

A row of ``name.data`` begins at root × scale bytes (``SET FILES SCALE``). Numbers are big-endian:

    size of the row                                  int32
    for each index: balance, left, right, parent     4 × int32; 0: none
    for each column: 0 for NULL, otherwise 1         int8
        SMALLINT, TINYINT int16; INTEGER int32; DOUBLE float64; BOOLEAN int8;
        VARCHAR int32 and bytes; TIMESTAMP int64 and int32

Source: documentation of HSQLDB 2.7, chapters "Deployment Guide" and "System Management"; the
layout of rows was found in files that HSQLDB 2.7.4 wrote.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import InputError, Problem
from ..collected import LinesOfFile

_CREATE = re.compile(r'CREATE (MEMORY |CACHED |)TABLE (?:"?\w+"?\.)?"?(\w+)"?\s*\((.*)\)\s*;?\s*$')
_COLUMN = re.compile(r'"?(\w+)"? (\w+)')
_ADDED = re.compile(r'ALTER TABLE (?:"?\w+"?\.)?"?(\w+)"? ADD (?:COLUMN )?"?(\w+)"? (\w+)')
_INSERT = re.compile(r'INSERT INTO (?:"?\w+"?\.)?"?(\w+)"? VALUES\s*\((.*)\)\s*;?\s*$')
_INDEX = re.compile(r"SET TABLE (?:\"?\w+\"?\.)?\"?(\w+)\"? INDEX\s*'([\d ]+)'")
_SCALE = re.compile(r"SET FILES SCALE (\d+)")
_VALUE = re.compile(r"\s*(?:'((?:[^']|'')*)'|([^,']*))\s*(,|$)")
_NUMBER = re.compile(r"-?\d+(\.\d*)?(E-?\d+)?", re.ASCII)
_ESCAPE = re.compile(r"\\u([0-9a-fA-F]{4})")
_NOT_FINITE = {"1E0/0": math.inf, "-1E0/0": -math.inf, "0E0/0E0": math.nan}
STATEMENTS = ("SET", "CREATE", "ALTER", "INSERT", "GRANT", "REVOKE", "COMMENT", "DECLARE")
"""First words of the statements of a script; read are tables, their columns and their rows."""
CONSTRAINTS = ("PRIMARY", "CONSTRAINT", "UNIQUE", "FOREIGN", "CHECK")
"""Words with which an entry of CREATE TABLE begins that is no column."""
MOST_ROWS = 10_000_000
"""Largest number of rows of a table."""


@dataclass(frozen=True)
class Row:
    """A row of a table."""

    values: Mapping[str, Any]
    """Values by column: numbers, text, truth values; None for NULL."""
    source: str
    """Where the row stands."""


@dataclass
class Table:
    """A table: its columns and rows."""

    name: str
    """Its name."""
    columns: dict[str, str]
    """Type by column, in the order of the columns."""
    cached: bool
    """Whether its rows stand in the file of cached tables."""
    rows: list[Row] = field(default_factory=list)
    """Its rows."""


def read_tables(path: Path, wanted: Collection[str]) -> dict[str, Table]:
    """Return some tables of a database by name; those that it lacks are left out.

    Args:
        path: the script, ``name.script``. Cached rows are read from ``name.data`` beside it.
        wanted: names of the tables.

    Raises:
        InputError: the files are damaged or missing, or statements wait in ``name.log``.
    """
    lines = LinesOfFile(path)
    tables: dict[str, Table] = {}
    roots: dict[str, tuple[int, list[int]]] = {}
    named: set[str] = set()
    scale = 1
    for number, line in lines.numbered():
        if found := _CREATE.match(line):
            name = found[2]
            named.add(name)
            if name in wanted:
                tables[name] = Table(name, _columns(found[3]), found[1] == "CACHED ")
        elif (found := _ADDED.match(line)) and found[1] in tables:
            tables[found[1]].columns[found[2]] = found[3]
        elif found := _SCALE.match(line):
            scale = int(found[1])
        elif found := _INDEX.match(line):
            roots[found[1]] = number, [int(w) for w in found[2].split()]
        elif (found := _INSERT.match(line)) and found[1] in tables:
            _insert(lines, number, tables[found[1]], found[2])
        elif line.startswith("INSERT") and not found:
            lines.add(number, "an INSERT statement is cut or damaged")
        elif found and found[1] not in named:
            what = f"a row of the table {found[1][:40]!r}, which the file does not create"
            lines.add(number, what)
        elif line.strip() and line.split(None, 1)[0] not in STATEMENTS:
            word = line.split(None, 1)[0][:40]
            lines.add(number, f"unknown statement {word!r}; valid: {', '.join(STATEMENTS)}")
    _refuse_waiting(path, lines)
    cached = {n: r for n, r in roots.items() if n in tables and tables[n].cached}
    if cached and not lines.problems:
        _read_cached(path.with_suffix(".data"), tables, cached, scale, lines)
    lines.raise_all()
    return tables


def _columns(text: str) -> dict[str, str]:
    """Return type by name of the columns of a CREATE statement."""
    out = {}
    depth, start = 0, 0
    for i, c in enumerate(text + ","):
        depth += (c == "(") - (c == ")")
        if c == "," and depth == 0:
            entry = text[start:i].strip()
            start = i + 1
            found = _COLUMN.match(entry)
            if found and entry.split(None, 1)[0] not in CONSTRAINTS:
                out[found[1]] = found[2]
    return out


def _insert(lines: LinesOfFile, number: int, table: Table, text: str) -> None:
    values: list[Any] = []
    at = 0
    while at <= len(text):
        found = _VALUE.match(text, at)
        if found is None:
            lines.add(
                number, f"the values of table {table.name} are damaged: {text[at : at + 30]!r}"
            )
            return
        values.append(_literal(found[1], found[2]))
        at = found.end()
        if found[3] != ",":
            break
    if len(values) != len(table.columns):
        what = f"a row of table {table.name} has {len(table.columns)} values, not {len(values)}"
        lines.add(number, what)
        return
    row: dict[str, Any] = {}
    for (name, kind), value in zip(table.columns.items(), values, strict=True):
        row[name] = _typed(kind, value)
        if isinstance(row[name], _Damaged):
            lines.add(number, f"{name} of table {table.name} is no {kind}: {str(value)[:40]!r}")
            return
    table.rows.append(Row(row, lines.place(number)))


def _literal(quoted: str | None, bare: str | None) -> Any:
    if quoted is not None:
        return _ESCAPE.sub(lambda m: chr(int(m[1], 16)), quoted.replace("''", "'"))
    word = (bare or "").strip()
    if word in ("TRUE", "FALSE"):
        return word == "TRUE"
    if word == "NULL":
        return None
    if word in _NOT_FINITE:
        return _NOT_FINITE[word]
    if _NUMBER.fullmatch(word) is None or len(word) > 400:
        return _Damaged(word)
    value = int(word) if word.lstrip("-").isdigit() else float(word)
    return value if abs(value) < _LARGEST else _Damaged(word)


_LARGEST = 1e18
"""Size from which a number is taken for damage."""


class _Damaged(str):
    """A word that is no literal of SQL."""


_TYPES: dict[str, type] = {
    "DOUBLE": float,
    "INTEGER": int,
    "SMALLINT": int,
    "TINYINT": int,
    "BOOLEAN": bool,
    "VARCHAR": str,
}


def _typed(kind: str, value: Any) -> Any:
    """Return a value of a column of a type; `_Damaged` if it cannot stand there."""
    wanted = _TYPES.get(kind)
    if value is None or wanted is None:
        return value
    if wanted is float and type(value) is int:
        value = float(value) if abs(value) < 2**1000 else _Damaged(value)
    if wanted is int and type(value) is int and abs(value) >= 2**63:
        value = _Damaged(value)
    return value if type(value) is wanted else _Damaged(value)


def _refuse_waiting(path: Path, lines: LinesOfFile) -> None:
    log = path.with_suffix(".log")
    try:
        waiting = log.is_file() and log.stat().st_size > 0
    except OSError:
        waiting = False
    if waiting:
        what = (
            f"{log.name} holds statements that are not yet in the database: open the project in "
            "its program and close it there"
        )
        lines.add(0, what)


# -- cached tables ------------------------------------------------------------------------------

Decoder = Callable[[bytes, int], tuple[Any, int]]


def _number(form: str) -> Decoder:
    code = struct.Struct(form)
    return lambda data, at: (code.unpack_from(data, at)[0], at + code.size)


def _truth(data: bytes, at: int) -> tuple[bool, int]:
    if data[at] > 1:
        raise ValueError("a truth value is neither 0 nor 1")
    return data[at] == 1, at + 1


def _text(data: bytes, at: int) -> tuple[str, int]:
    (size,) = struct.unpack_from(">i", data, at)
    end = at + 4 + size
    if size < 0 or end > len(data):
        raise ValueError("a text is longer than the file")
    return data[at + 4 : end].decode("utf-8"), end


def _time(data: bytes, at: int) -> tuple[None, int]:
    struct.unpack_from(">qi", data, at)
    return None, at + 12


DECODERS: dict[str, Decoder] = {
    "SMALLINT": _number(">h"),
    "TINYINT": _number(">h"),
    "INTEGER": _number(">i"),
    "BIGINT": _number(">q"),
    "DOUBLE": _number(">d"),
    "BOOLEAN": _truth,
    "VARCHAR": _text,
    "TIMESTAMP": _time,
}
"""Function of data and place → value and the place behind it, by type of column."""


def _read_cached(
    path: Path,
    tables: dict[str, Table],
    roots: dict[str, tuple[int, list[int]]],
    scale: int,
    lines: LinesOfFile,
) -> None:
    try:
        data = path.read_bytes()
    except OSError:
        what = (
            f"the rows of the tables stand in {path.name}, which cannot be read: copy it beside "
            "the script"
        )
        lines.add(0, what)
        return
    for name, (number, words) in roots.items():
        table = tables[name]
        try:
            table.rows += _cached_rows(data, table, words, scale, path.name)
        except (ValueError, struct.error, IndexError, KeyError, UnicodeDecodeError) as error:
            what = f"table {name} of {path.name} is damaged, or of another version of HSQLDB"
            raise InputError(Problem(f"{what} ({error})", lines.place(number))) from None


def _cached_rows(data: bytes, table: Table, words: list[int], scale: int, file: str) -> list[Row]:
    """Return the rows of a table in the order of its first index."""
    if len(words) < 3 or len(words) % 2 == 0 or words[-1] > MOST_ROWS:
        raise ValueError("the roots of its indexes are not understood")
    n_indexes, count = len(words) // 2, words[-1]
    rows: list[Row] = []
    seen: set[int] = set()
    stack: list[tuple[int, bool]] = [(words[0], False)]
    while stack:
        place, ready = stack.pop()
        if place == 0:
            continue
        at = place * scale
        if not 0 < at <= len(data) - 4:
            raise ValueError("a row lies outside the file")
        if ready:
            rows.append(_cached_row(data, at + 4 + 16 * n_indexes, table, f"{file}@{at}"))
            continue
        if place in seen:
            raise ValueError("its tree of rows has a loop")
        seen.add(place)
        if len(seen) > count:
            raise ValueError(f"it has more than {count} rows")
        _, left, right, _ = struct.unpack_from(">4i", data, at + 4)
        stack += [(right, False), (place, True), (left, False)]
    if len(rows) != count:
        raise ValueError(f"it has {len(rows)} rows, not {count}")
    return rows


def _cached_row(data: bytes, at: int, table: Table, source: str) -> Row:
    values: dict[str, Any] = {}
    for name, kind in table.columns.items():
        there = data[at]
        if there > 1:
            raise ValueError("the mark of a value is neither 0 nor 1")
        at += 1
        values[name] = None
        if there:
            values[name], at = DECODERS[kind](data, at)
    return Row(values, f"{source} ({table.name})")
