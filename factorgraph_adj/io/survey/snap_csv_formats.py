"""Format definition files of SNAP (``.dtf``): how columns of delimited text make values.

Format: LINZ, SNAP help, "CSV format definition files", and ``snapcsvbase.cpp``,
``calcdltfile.cpp`` of the program (BSD-3).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..source import Field, Problems, TextSource
from .snap_lines import found_file, unquoted
from .snap_selections import JobLine

ALL, ALL_WITHOUT_PREFIX = "*", "**"
"""Ends of a name of columns: all that begin so; all, without that beginning in their names."""
GENERIC = (
    *("format_name", "format", "columns", "required_columns", "optional_columns"),
    *("required_configuration", "skip_lines", "lookup"),
)
"""Commands of definitions of stations and of observations."""
OPTION_OFF = "N"
"""Value of an option that is written as ``-NAME``."""
_PART = re.compile(
    r"\s*(?:(?P<default>default)|(?P<number>-?\d+\.?\d*)|\"(?P<text>(?:[^\"]|\"\")*)\""
    r"|\$(?P<option>\w+)|@(?P<column>\w+)"
    r"|(?P<table>[a-z_]\w*)\(\s*(?:\$(?P<looked_option>\w+)|@(?P<looked_column>\w+))\s*\)"
    r"|(?P<other>\S+))(?=\s|$)",
    re.IGNORECASE,
)
"""Part of a value: a word, a literal, an option, a column, or what a table has for one of these."""
_FORMAT = re.compile(
    r"(?:(?P<csv>csv)|(?:delimiter=)?(?P<blanks>whitespace)"
    r"|delimiter=(?P<delimiter>\S|tab|space)(?:\s+quote=(?P<quote>\S|tab|space))?"
    r"(?:\s+escape=(?P<escape>\S|tab|space))?)(?:\s+header=(?P<header>[yn]))?",
    re.IGNORECASE,
)
CHARACTERS = {"tab": "\t", "space": " "}


def normalised(name: str) -> str:
    """Return the name of a column: letters and digits, ``_`` for what stands between them.

    >>> normalised("  Obs. type")
    'obs_type'
    """
    return re.sub(r"[^a-z0-9]+", "_", name.strip().lower())


@dataclass
class CsvOptions:
    """Options of a file of delimited text in a command: ``format=NAME`` and what formats use."""

    values: dict[str, str] = field(default_factory=dict)
    """Values by name in small letters."""

    def take(self, at: JobLine, word: str) -> bool:
        """Take an option ``name=value`` or ``-name``; return whether the word is one."""
        name, equals, value = word.partition("=")
        if not equals:
            name, value = word[1:], OPTION_OFF
            if not word.startswith("-"):
                return False
        if name.lower() in self.values:
            at.wrong(f"option {name} is stated twice")
        self.values[name.lower()] = unquoted(value)
        return True


@dataclass
class CsvRow:
    """A record of a file of delimited text."""

    source: TextSource
    """The file."""
    line: int
    """Line where it begins."""
    cells: Mapping[str, str]
    """Cells by normalised name of the column."""

    def field(self, value: CsvValue | None, what: str) -> Field:
        """Return a value of the record as a field; an absent one if the format has none."""
        return self.source.field(self.line, "" if value is None else value.text(self), what)


@dataclass(frozen=True)
class CsvPart:
    """A part of a value: a literal, the cell of a column, or what a table has for it."""

    literal: str = ""
    """Text of a literal."""
    column: str = ""
    """Normalised name of a column."""
    table: Mapping[str, str] | None = None
    """Table in which the cell is looked up, by keys in small letters."""

    def text(self, row: CsvRow) -> str:
        """Return its text in a record."""
        if not self.column:
            return self.literal
        cell = row.cells.get(self.column, "")
        if self.table is None:
            return cell
        found = self.table.get(cell.lower(), self.table.get("default"))
        if found is None:
            valid = ", ".join(self.table)
            row.source.wrong(
                row.line, f"{self.column} {cell[:40]!r} is not in the table; valid: {valid}"
            )
        return found or ""


@dataclass(frozen=True)
class CsvValue:
    """A value that a format definition states: the first alternative that is not blank."""

    alternatives: tuple[tuple[CsvPart, ...], ...]
    """Alternatives in the order in which they count, each of parts that stand together."""

    def text(self, row: CsvRow) -> str:
        """Return its text in a record; blank if all alternatives are."""
        texts = ("".join(part.text(row) for part in parts).rstrip() for parts in self.alternatives)
        return next((text for text in texts if text), "")

    @property
    def columns(self) -> list[str]:
        """Columns of all alternatives."""
        return [part.column for parts in self.alternatives for part in parts if part.column]


@dataclass(frozen=True)
class DefinitionLine:
    """A line of a definition that is not one of all formats."""

    line: int
    """Number of the line."""
    name: str
    """Its command in small letters."""
    rest: str
    """Text behind the command."""


class CsvDefinition:
    """A format definition file."""

    def __init__(self, path: Path, problems: Problems, options: CsvOptions) -> None:
        """Read the file; what is wrong is noted.

        Args:
            path: the file.
            problems: gets what is wrong.
            options: options of the command that names it.
        """
        self.source = TextSource(path, problems, code_page="cp1252")
        self.options = options
        self.lines: list[DefinitionLine] = []
        """What is of stations or observations alone."""
        self.delimiter: str | None = ","
        self.quote: str | None = '"'
        self.escape: str | None = '"'
        self.header = True
        self.skipped = 0
        self.columns: list[str] = []
        self.required: list[str] = []
        self.optional: list[str] = []
        self.tables: dict[str, dict[str, str]] = {}
        self.used: list[str] = []
        """Columns of values without a default."""
        self.classes: list[str] = []
        """Columns that are classifications, without those that only begin so."""
        self._read()

    def _read(self) -> None:
        """Read all lines; tables may stand behind the values that use them."""
        table: dict[str, str] | None = None
        begun = 0
        for line, text in self.source.numbered():
            name, rest = (*text.strip().split(None, 1), "", "")[:2]
            low = name.lower()
            if not low or low.startswith("!"):
                continue
            if table is not None:
                if low == "end_lookup":
                    table = None
                    self.alone(line, name, rest)
                elif low in table:
                    self.source.wrong(line, f"the table has {name[:40]!r} twice")
                else:
                    table[low] = rest.strip()
            elif low == "lookup":
                begun, table = line, {}
                self.tables[rest.strip().lower()] = table
            elif low in GENERIC:
                self._generic(line, low, rest.strip())
            else:
                self.lines.append(DefinitionLine(line, low, rest.strip()))
        if table is not None:
            self.source.wrong(begun, "the table that begins here has no end; valid: END_LOOKUP")
        if self.header and self.columns:
            self.source.wrong(
                0,
                "names of COLUMNS and a header: SNAP's manual takes the names, its program those "
                "of the header; valid: FORMAT … HEADER=N, with SKIP_LINES 1",
            )

    def _generic(self, line: int, name: str, rest: str) -> None:
        words = [normalised(word) for word in rest.split()]
        if name == "format":
            self._format(line, rest)
        elif name == "columns":
            self.columns += words
        elif name == "required_columns":
            self.required += words
        elif name == "optional_columns":
            self.optional += words
        elif name == "required_configuration":
            for word in rest.split():
                if word.lower() not in self.options.values:
                    self.source.wrong(line, f"needs the option {word}=… of the command in the job")
        elif name == "skip_lines":
            self.skipped = self.source.field(line, rest, "SKIP_LINES").integer() or 0

    def _format(self, line: int, text: str) -> None:
        found = _FORMAT.fullmatch(text)
        if found is None:
            self.source.wrong(
                line,
                f"FORMAT {text[:40]!r} is unknown; valid: CSV, WHITESPACE, or DELIMITER=d "
                "[QUOTE=q] [ESCAPE=e], then [HEADER=Y|N]",
            )
            return
        self.header = (found["header"] or "y").lower() == "y"
        if found["blanks"]:
            self.delimiter = None
        elif found["delimiter"]:
            signs = (found[n] for n in ("delimiter", "quote", "escape"))
            self.delimiter, self.quote, self.escape = (
                CHARACTERS.get((s or "").lower(), s) for s in signs
            )

    # -- values -----------------------------------------------------------------------------------

    def value(self, stated: DefinitionLine) -> CsvValue:
        """Return the value that a line states; what is wrong is noted."""
        alternatives: list[list[CsvPart]] = [[]]
        columns: list[str] = []
        for part in _PART.finditer(stated.rest):
            kind = part.lastgroup
            if kind == "default":
                alternatives.append([])
            elif kind == "other":
                self.source.wrong(
                    stated.line,
                    f"{part['other'][:40]!r} is no part of a value; valid: @COLUMN, $OPTION, "
                    '"text", a number, TABLE(@COLUMN), default',
                )
            elif kind == "option":
                alternatives[-1].append(CsvPart(self._option(part["option"])))
            elif kind == "column":
                columns.append(normalised(part["column"]))
                alternatives[-1].append(CsvPart(column=columns[-1]))
            elif part["table"]:
                column = normalised(part["looked_column"] or "")
                columns += [column] if column else []
                alternatives[-1].append(self._looked_up(stated, part, column))
            else:
                literal = part["number"] or (part["text"] or "").replace('""', '"')
                alternatives[-1].append(CsvPart(literal))
        if not all(alternatives):
            self.source.wrong(stated.line, f"{stated.name} needs a value, and one behind 'default'")
        if len(alternatives) == 1:
            self.used += columns
        return CsvValue(tuple(tuple(parts) for parts in alternatives))

    def _looked_up(self, stated: DefinitionLine, part: re.Match[str], column: str) -> CsvPart:
        """Return the part that a table has for a column or an option."""
        table = self.source.field(stated.line, part["table"].lower(), "table").choice(self.tables)
        if table is None or column:
            return CsvPart(column=column, table=table)
        key = self._option(part["looked_option"])
        found = table.get(key.lower(), table.get("default"))
        if found is None:
            self.source.wrong(stated.line, f"the table has no {key[:40]!r}")
        return CsvPart(found or "")

    def _option(self, name: str) -> str:
        return self.options.values.get(name.lower(), "")

    def alone(self, line: int, name: str, rest: str) -> None:
        """Refuse words behind a command that takes none."""
        if rest.strip():
            self.source.wrong(line, f"{name} takes no words, not {rest.strip()[:40]!r}")

    def named(self, stated: DefinitionLine) -> tuple[str, CsvValue]:
        """Return the name in small letters and the value of a line ``COMMAND NAME value``."""
        name, rest = (*stated.rest.split(None, 1), "", "")[:2]
        if not name:
            self.source.wrong(stated.line, f"{stated.name} needs a name and a value")
        return name.lower(), self.value(replace(stated, rest=rest))

    def class_columns(self, stated: DefinitionLine) -> list[str]:
        """Return the names of columns that are classifications, those with wildcards too."""
        names = stated.rest.split()
        self.classes += [normalised(name) for name in names if not name.endswith(ALL)]
        return names

    def setting(self, stated: DefinitionLine) -> Field:
        """Return a value of the whole file, in which columns have no part, as a field."""
        used = list(self.used)
        value = self.value(stated)
        self.used = used
        if value.columns:
            self.source.wrong(stated.line, f"{stated.name} is for the whole file: no columns")
        text = value.text(CsvRow(self.source, stated.line, {}))
        return self.source.field(stated.line, text.strip().lower(), stated.name)

    # -- rows -------------------------------------------------------------------------------------

    def rows(self, source: TextSource) -> Iterator[CsvRow]:
        """Yield the records of a file; what is wrong is noted."""
        names: Sequence[str] | None = None if self.header else self.columns
        for line, cells in self._records(source):
            if names is None:
                names = [normalised(c) for c in cells]
                if not self._has_columns(source, line, names):
                    return
                continue
            if len(cells) > len(names) and not self.columns and not self.header:
                names = [f"col{i + 1}" for i in range(len(cells))]
            if any(c.strip() for c in cells[len(names) :]):
                source.wrong(line, f"has {len(cells)} fields, and {len(names)} columns have names")
                continue
            yield CsvRow(source, line, dict(zip(names, cells, strict=False)))

    def _has_columns(self, source: TextSource, line: int, names: Sequence[str]) -> bool:
        """Return whether a header has all columns, none twice; what is wrong is noted."""
        twice = sorted({n for n in names if n and names.count(n) > 1})
        needed = self.required or [n for n in self.used if n not in self.optional]
        needed = [*needed, *self.classes]
        missing = [n for n in dict.fromkeys(needed) if n not in names]
        if twice:
            source.wrong(line, f"the header has {', '.join(twice)} twice")
        if missing:
            format_name = self.source.path.name
            source.wrong(line, f"lacks the columns {', '.join(missing)} of {format_name}")
        return not twice and not missing

    def _records(self, source: TextSource) -> Iterator[tuple[int, list[str]]]:
        """Yield the first line and the cells of each record that is not blank."""
        lines = [text for _, text in source.numbered()][self.skipped :]
        if self.delimiter is None:
            for line, text in enumerate(lines, self.skipped + 1):
                if text.strip():
                    yield line, text.split()
            return
        doubled = self.escape == self.quote
        reader = csv.reader(
            (text + "\n" for text in lines),
            delimiter=self.delimiter,
            quotechar=self.quote,
            escapechar=None if doubled else self.escape,
            doublequote=doubled,
            quoting=csv.QUOTE_MINIMAL if self.quote else csv.QUOTE_NONE,
            strict=True,
        )
        begun = 1
        try:
            for cells in reader:
                if any(c.strip() for c in cells):
                    yield begun + self.skipped, cells
                begun = reader.line_num + 1
        except csv.Error as error:
            source.wrong(begun + self.skipped, f"is not delimited text: {error}")


def read_definition(
    at: JobLine, data: Path, options: CsvOptions, folders: Sequence[Path], usual: str
) -> CsvDefinition | None:
    """Return the format definition of a file; None if it is not there.

    It is beside the file, in the folder of the command file, or in that of one which includes it.

    Args:
        at: the line that names the file.
        data: the file.
        options: options of the command.
        folders: folders of the command files, the innermost first.
        usual: name of the format where the command states none.
    """
    name = options.values.get("format", usual)
    for folder in (data.parent, *folders):
        found = found_file(folder, name, ".dtf")
        if found is not None:
            return CsvDefinition(found, at.source.problems, options)
    at.wrong(
        f"the format definition {name}.dtf is not there; valid: one beside {data.name} or beside "
        "the job"
    )
    return None


def class_columns(patterns: Sequence[str], row: CsvRow) -> dict[str, str]:
    """Return the classifications of a record in columns that a format names, those not blank.

    Args:
        patterns: names of columns, ``PREFIX*``, or ``PREFIX**`` for names without the prefix.
        row: the record.
    """
    out = {}
    for pattern in patterns:
        prefix = normalised(pattern.rstrip(ALL)) if pattern.rstrip(ALL) else ""
        for column, cell in row.cells.items():
            if column == prefix and not pattern.endswith(ALL):
                out[column] = cell
            elif column.startswith(prefix) and pattern.endswith(ALL):
                cut = len(prefix) if pattern.endswith(ALL_WITHOUT_PREFIX) else 0
                out[column[cut:]] = cell
    return {name: cell.strip() for name, cell in out.items() if name and cell.strip()}
