"""Mapping of a table guessed from its header and cells, as TOML to be corrected.

Words of the header (`header_words`) say what columns are; cells say separator, decimal comma, line
of the header, encoding, and units where these are certain. What the file leaves open is ``?`` in
the TOML, which the reader refuses: nothing is adjusted on a guess in silence.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...errors import InputError, Problem
from ...files import read_bytes
from .header_words import header_unit, is_level_book, meanings
from .workbook import is_workbook, sheet_rows

OPEN = "?"
"""Value of a key that the file leaves open."""
EXAMINED_ROWS = 200
"""Number of rows from which a mapping is guessed."""
MAX_FILES_BESIDE = 20
"""Largest number of files beside a table that are examined for points."""
MAX_HEADER_ROW = 20
"""Largest row in which a header is looked for."""
READ_COLUMNS = {
    "levelling": ("station", "target", "difference", "length"),
    "readings": ("station", "target", "set", "face", "direction", "zenith", "distance",
                 "horizontal_distance", "instrument_height", "target_height"),
    "points": ("name", "x", "y", "z", "fixed"),
}  # fmt: skip
"""Columns that are guessed for each section, in the order in which sections are tried."""
SIGHT_COLUMNS = ("direction", "zenith", "distance", "horizontal_distance")
LARGEST_SIGMA = 0.1
"""A column s of levelled lines whose values are all smaller has σ in metres, not lengths."""
MIN_METRES = 100.0
"""Length of a levelled line from which its number without a unit is one of metres."""
_POINT = re.compile(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", re.IGNORECASE)
_COMMA = re.compile(r"[+-]?\d+,\d+")
_DMS = re.compile(r"\d{1,3}-\d{1,2}-\d{1,2}(\.\d*)?")
_NAMED = {",": "comma", ";": "semicolon", "\t": "tab", " ": "blank"}


@dataclass
class GuessedMapping:
    """A mapping that a table suggests."""

    path: Path
    columns: list[str]
    """Headers of the table, or the numbers of its columns."""
    keys: dict[str, Any] = field(default_factory=dict)
    """Keys beside the tables."""
    section: str = ""
    """Table of the mapping; '' where the header fits none."""
    mapped: dict[str, str] = field(default_factory=dict)
    """Header by column of the table."""
    units: dict[str, str] = field(default_factory=dict)
    points: dict[str, str] = field(default_factory=dict)
    """Table of points in another file beside it, with its name; empty: there is none."""
    why: dict[str, str] = field(default_factory=dict)
    """Comment of a key, a column, or, behind ``units.``, a unit."""

    @property
    def open_keys(self) -> list[str]:
        """What the file leaves open."""
        found = [*self.units.items(), *self.mapped.items()]
        return [k for k, v in found if v in (OPEN, f"={OPEN}")] + ["a table"] * (not self.section)

    def toml(self) -> str:
        """Return the mapping as TOML with comments."""
        lines = ["# Guessed from the header: correct it where it is wrong."]
        lines += [self._line(k, v) for k, v in self.keys.items()]
        if self.units:
            lines += ["[units]", *(self._line(k, v, "units.") for k, v in self.units.items())]
        if self.section:
            lines += [f"[{self.section}]", *(self._line(k, v) for k, v in self.mapped.items())]
        else:
            lines.append("# [points], [readings], [levelling] or [observations]: column = header")
        if self.points:
            lines += ["[points]", *(f"{k} = {_quoted(v)}" for k, v in self.points.items())]
        used = set(self.mapped.values())
        if rest := [c for c in self.columns if c not in used and c]:
            lines.append(f"# not mapped: {', '.join(_quoted(c) for c in rest)}")
        return "\n".join(lines) + "\n"

    def _line(self, key: str, value: object, of: str = "") -> str:
        text = str(value) if isinstance(value, int) else _quoted(str(value))
        comment = f"  # {self.why[of + key]}" if of + key in self.why else ""
        return f"{key} = {text}{comment}"

    def proposal(self) -> str:
        """Return what an error says where no mapping is given."""
        name = f"{self.path.stem}.toml"
        what = "needs a mapping of its columns. Guessed from its header, to be corrected"
        if self.open_keys:
            what += f" where it says {OPEN!r} ({', '.join(self.open_keys)})"
        whole = "" if self.open_keys else "; or, where all of it is right, --set mapping=guess"
        command = f"factorgraph-adj guess-columns {self.path.name} > {name}"
        return f"{what}: {command}, then --set mapping={name}{whole}\n\n{self.toml()}"

    def checked(self) -> dict[str, Any]:
        """Return the mapping as a dictionary.

        Raises:
            InputError: the file leaves something open.
        """
        if self.open_keys:
            raise InputError(Problem(self.proposal(), self.path.name))
        out: dict[str, Any] = {**self.keys, self.section: dict(self.mapped)}
        out |= {"units": dict(self.units)} if self.units else {}
        return {**out, "points": dict(self.points)} if self.points else out

    def remark(self) -> str:
        """Return what a network says that was read by a guess."""
        columns = ", ".join(f"{k} = {v!r}" for k, v in self.mapped.items())
        units = ", ".join(f"{k} {v}" for k, v in (self.units | self.keys).items())
        if self.points:
            columns += f"; points of {self.points['file']}"
        return f"columns as {self.section} by a guess from the header: {columns}; {units}"


def _quoted(text: str) -> str:
    """Return a text as a string of TOML."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\t", "\\t")
    return f'"{escaped}"'


def guessed_mapping(path: Path, sheet: str | None = None, *, beside: bool = True) -> GuessedMapping:
    """Return the mapping that a table suggests.

    Args:
        path: text with separators, or a workbook of Excel.
        sheet: sheet of the workbook; None: its only one.
        beside: whether files beside it may have the points.

    Raises:
        InputError: the file cannot be read, or is a level book.
    """
    keys: dict[str, Any] = {}
    if is_workbook(path):
        rows = [(i, cells) for i, cells in sheet_rows(path, sheet)][:EXAMINED_ROWS]
        if sheet is not None:
            keys["sheet"] = sheet
    else:
        rows = _text_rows(path, keys)
    line, header, body = _header(rows)
    keys["header"] = line
    if is_level_book(header):
        what = (
            "is a level book of backsights and foresights, which is not read as a table: give "
            "height differences (from, to, difference, length), or the file of the level, such as "
            "GSI or DiNi M5"
        )
        raise InputError(Problem(what, f"{path.name}:{line}"))
    guess = GuessedMapping(path, header, keys)
    if any(_COMMA.fullmatch(c) for cells in body for c in cells):
        keys["decimal"] = ","
        body = [[c.replace(",", ".") if _COMMA.fullmatch(c) else c for c in r] for r in body]
    of_column = {h: [r[i] for r in body if i < len(r) and r[i]] for i, h in enumerate(header)}
    if line:
        _map_by_words(guess, of_column)
    else:
        _map_by_cells(guess, of_column)
    _guess_units(guess, of_column)
    if beside and guess.section not in ("", "points"):
        guess.points = _points_beside(path, guess)
    return guess


def _points_beside(path: Path, guess: GuessedMapping) -> dict[str, str]:
    """Return the table of the only file beside one that has points, and the same keys."""
    out = []
    for other in sorted(path.parent.glob(f"*{path.suffix}"))[:MAX_FILES_BESIDE]:
        if other == path or not path.suffix:
            continue
        try:
            found = guessed_mapping(other, beside=False)
        except InputError:
            continue
        keys = {k: v for k, v in found.keys.items() if k != "axes"}
        length = found.units.get("length")
        same_unit = guess.units.get("length", "m") == length
        if found.section == "points" and keys == guess.keys and same_unit:
            out.append({"file": other.name, **found.mapped})
    return out[0] if len(out) == 1 else {}


def _text_rows(path: Path, keys: dict[str, Any]) -> list[tuple[int, list[str]]]:
    """Return line and cells of the first rows of a text; what is not usual goes into the keys."""
    content = read_bytes(path)
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        text, keys["encoding"] = content.decode("cp1252", errors="replace"), "cp1252"
    lines = [x.rstrip("\r") for x in text.replace("\0", "\ufffd").split("\n")]
    filled = [(i, x) for i, x in enumerate(lines, start=1) if x.strip()][:EXAMINED_ROWS]
    several = [d for d in ";\t," if sum(d in x for _, x in filled) > len(filled) / 2]
    delimiter = several[0] if several else " "
    if filled and delimiter != next((d for d in ";\t," if d in filled[0][1]), ","):
        keys["delimiter"] = _NAMED[delimiter]
    out = []
    for i, x in filled:
        try:
            cells = next(csv.reader([x], delimiter=delimiter, skipinitialspace=True))
        except (csv.Error, StopIteration):
            continue
        out.append((i, [c.strip() for c in cells if c or delimiter != " "]))
    return out


def _is_number(text: str) -> bool:
    return any(p.fullmatch(text) is not None for p in (_POINT, _COMMA, _DMS))


def _header(rows: Sequence[tuple[int, list[str]]]) -> tuple[int, list[str], list[list[str]]]:
    """Return the line of the header (0: none), the headers, and the cells of all rows below."""
    for k, (line, cells) in enumerate(rows):
        if line > MAX_HEADER_ROW:
            break
        words = [c for c in cells if meanings(c)]
        if len(words) >= 2 and not any(_is_number(c) for c in cells):
            return line, cells, [c for _, c in rows[k + 1 :]]
    body = [cells for _, cells in rows]
    if rows and not any(_is_number(c) for c in body[0]) and len(body) > 1:
        return rows[0][0], body[0], body[1:]
    return 0, [str(i + 1) for i in range(max(map(len, body), default=0))], body


def _map_by_words(guess: GuessedMapping, of_column: Mapping[str, Sequence[str]]) -> None:
    """Choose section and columns by the words of the header."""
    means = {h: meanings(h) for h in of_column}
    every = {c for found in means.values() for c in found}
    levels = {"station", "target", "difference"} <= every
    sights = "target" in every and any(c in every for c in SIGHT_COLUMNS)
    section = "levelling" if levels else "readings" if sights else ""
    if not section and "name" in every and {"x", "y"} & every | {"z"} & every:
        section = "points"
    guess.section = section
    for column in READ_COLUMNS.get(section, ()):
        fitting = [h for h, m in means.items() if column in m and h not in guess.mapped.values()]
        if fitting:
            guess.mapped[column] = fitting[0]
        if len(fitting) > 1:
            guess.why[column] = f"or {', '.join(_quoted(h) for h in fitting[1:])}"
    if section == "readings" and "station" not in guess.mapped:
        guess.mapped = {"station": f"={OPEN}", **guess.mapped}
        guess.why["station"] = "= and the name of the station, or the header of its column"
    if section == "levelling":
        _distinguish_sigma(guess, of_column)


def _distinguish_sigma(guess: GuessedMapping, of_column: Mapping[str, Sequence[str]]) -> None:
    """Take small numbers of a column of levelled lines for their standard deviations."""
    header = guess.mapped.get("length", "")
    named = [h for h in of_column if "sigma" in meanings(h)]
    values = [abs(float(c)) for c in of_column.get(header, ()) if _POINT.fullmatch(c)]
    if header in named and values and max(values) < LARGEST_SIGMA:
        guess.why["sigma_m"] = "small numbers: standard deviations in metres, not lengths"
    elif named and header not in named:
        header = named[0]
        unit = header_unit(header)
        guess.why["sigma_m"] = f"in {unit or 'metres'}?"
    else:
        return
    guess.section = "observations"
    m = guess.mapped
    guess.mapped = {
        "kind": "=height_difference",
        "station": m["station"],
        "target": m["target"],
        "value": m["difference"],
        "sigma_mm" if header_unit(header) == "mm" else "sigma_m": header,
    }


def _map_by_cells(guess: GuessedMapping, of_column: Mapping[str, Sequence[str]]) -> None:
    """Choose section and columns of a table without a header by what its cells are."""
    numeric = [h for h, cells in of_column.items() if cells and all(map(_is_number, cells))]
    names = [h for h in of_column if h not in numeric]
    signed = [h for h in numeric if any(c.startswith("-") for c in of_column[h])]
    if len(names) == 2 and len(numeric) in (1, 2) and len(signed) <= 1:
        difference = signed[0] if signed else numeric[-1]
        length = [h for h in numeric if h != difference]
        guess.section = "levelling"
        guess.mapped = {"station": names[0], "target": names[1], "difference": difference}
        guess.mapped |= {"length": length[0]} if length else {}
    elif len(names) <= 1 and 2 <= len(numeric) <= 4:
        name = names[0] if names else numeric.pop(0)
        if numeric:
            guess.section = "points"
            guess.mapped = {"name": name, **dict(zip("xyz", numeric, strict=False))}
    guess.why["header"] = "no line of it has words of a header: columns have numbers"


def _guess_units(guess: GuessedMapping, of_column: Mapping[str, Sequence[str]]) -> None:
    """Choose units by the header and by cells that have only one; others are open."""
    stated = {c: header_unit(h) for c, h in guess.mapped.items()}
    angles = [c for c in ("direction", "zenith") if c in guess.mapped]
    if angles:
        units = {stated[c] for c in angles} - {""}
        cells: Sequence[str] = [x for c in angles for x in of_column.get(guess.mapped[c], ())]
        if len(units) == 1:
            guess.units["angle"] = units.pop()
        elif any(_DMS.fullmatch(x) for x in cells):
            guess.units["angle"] = "dms"
        elif any(float(x) > 360 for x in cells if _POINT.fullmatch(x)):
            guess.units["angle"] = "gon"
            guess.why["units.angle"] = "there are angles above 360"
        else:
            guess.units["angle"] = OPEN
            guess.why["units.angle"] = "the file does not say: gon, deg, dms, packed (D.MMSS), rad"
            cells = of_column.get(guess.mapped.get("zenith", ""), ())
            zeniths = [float(x) for x in cells if _POINT.fullmatch(x)]
            if zeniths:
                guess.why["units.angle"] += f"; zenith readings begin with {zeniths[0]:g}"
    metric = ("x", "y", "z", "distance", "horizontal_distance", "difference", "value")
    lengths = {stated[c] for c in metric if c in stated} - {""}
    if len(lengths) == 1:
        guess.units["length"] = lengths.pop()
    elif guess.section in READ_COLUMNS:
        guess.units["length"] = "m"
        guess.why["units.length"] = "the file does not say: m, mm, ft, us-ft …"
    if stated.get("length") and stated["length"] != guess.units.get("length"):
        guess.units["line"] = stated["length"]
    elif "length" in guess.mapped and not stated["length"]:
        cells = of_column.get(guess.mapped["length"], ())
        lengths_of_lines = [abs(float(c)) for c in cells if _POINT.fullmatch(c)]
        if lengths_of_lines and max(lengths_of_lines) < MIN_METRES:
            guess.units["line"] = OPEN
            longest = max(lengths_of_lines)
            guess.why["units.line"] = (
                f"m or km? the header does not say, the longest is {longest:g}"
            )
    if guess.section == "points" and {"x", "y"} <= set(guess.mapped):
        guess.keys["axes"] = "en"
        guess.why["axes"] = "en: x is east; ne: x is north"
