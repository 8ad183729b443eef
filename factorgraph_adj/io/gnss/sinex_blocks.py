"""Blocks of a SINEX file as read: estimated and a-priori parameters with their matrices.

Format: IERS, SINEX — Solution (Software/technique) INdependent EXchange Format, version 2.02 (2006)
and 2.10.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from ...types import Array
from ..numbers import parse_quantity
from ..source import TextSource

MAX_SINEX_PARAMETERS = 20_000
"""Largest number of parameters: a full matrix of them fills 3.2 GB."""
READ_BLOCKS = (
    "SOLUTION/ESTIMATE",
    "SOLUTION/APRIORI",
    "SOLUTION/MATRIX_ESTIMATE",
    "SOLUTION/MATRIX_APRIORI",
)
IGNORED_BLOCKS = (
    *("FILE/", "INPUT/", "SITE/", "SATELLITE/", "SOURCE/", "NUTATION/", "PRECESSION/"),
    *("SOLUTION/STATISTICS", "SOLUTION/EPOCHS", "SOLUTION/DISCONTINUITY", "SOLUTION/DATA_REJECT"),
    *("SOLUTION/MEAN_EPOCHS", "SOLUTION/NORMAL_EQUATION_", "BIAS/", "MODEL/"),
)
"""Beginnings of the names of blocks that describe the solution and do not change it."""
MATRIX_KINDS = ("CORR", "COVA", "INFO")
METRES_PER_UNIT = {"m": 1.0, "m/y": 1.0, "m/a": 1.0}
"""Units of coordinates and velocities."""
_EPOCH = re.compile(r"(\d{2}|\d{4}):(\d{1,3}):(\d{1,5})", re.ASCII)


@dataclass(frozen=True)
class SinexParameter:
    """A parameter of the solution or its a-priori value."""

    index: int
    """Its number, from 1."""
    kind: str
    """STAX, STAY, STAZ, VELX … or any other type."""
    site: tuple[str, str, str]
    """Code of the site, code of its point, number of the solution."""
    epoch: float
    """Reference epoch, years; NaN: none."""
    unit: str
    """Unit of the value."""
    value: float
    """Value, in the unit."""
    sigma: float
    """Standard deviation, in the unit."""
    line: int
    """Line of the file."""


@dataclass
class SinexMatrix:
    """A symmetric matrix of the file: elements by row and column, from 1."""

    kind: str
    """CORR (standard deviations on the diagonal), COVA or INFO."""
    line: int
    """Line where the block begins."""
    rows: list[int] = field(default_factory=list)
    """Row of each element."""
    columns: list[int] = field(default_factory=list)
    """Column of each element."""
    values: list[float] = field(default_factory=list)
    """The elements."""

    def full(self, n: int) -> Array:
        """Return the symmetric matrix (n, n) as it is in the file."""
        out = np.zeros((n, n))
        i, j = np.array(self.rows, dtype=int) - 1, np.array(self.columns, dtype=int) - 1
        out[i, j] = self.values
        out[j, i] = self.values
        return out


class SinexFile(TextSource):
    """The blocks of a file that make a solution."""

    def __init__(self, path: str | Path) -> None:
        """Read the blocks; problems are collected, see `raise_all`."""
        super().__init__(path)
        self.parameters: dict[str, dict[int, SinexParameter]] = {"ESTIMATE": {}, "APRIORI": {}}
        self.matrices: dict[str, SinexMatrix] = {}
        if not self.lines[0].startswith("%=SNX"):
            self.wrong(1, "is not SINEX: the first line must begin with %=SNX")
            self.raise_all()
        if not any(line.startswith("%ENDSNX") for line in self.lines):
            self.wrong(len(self.lines), "ends without %ENDSNX: the file has been cut")
        self._blocks()

    def _blocks(self) -> None:
        block, begun, seen = "", 0, set()
        for number, line in list(self.numbered())[1:]:
            if line.startswith("%ENDSNX"):
                behind = next((n for n, text in list(self.numbered())[number:] if text.strip()), 0)
                if behind:
                    self.wrong(behind, "stands behind %ENDSNX, the end of the file")
                break
            if not line.strip() or line.startswith("*"):
                continue
            if line.startswith("+"):
                if block:
                    self.wrong(number, f"a block begins in the block {block} of line {begun}")
                words = line[1:].split()
                block, begun = (words or ["?"])[0], number
                if block in seen and block in READ_BLOCKS:
                    self.wrong(number, f"second block {block}")
                seen.add(block)
                self._begin(number, words)
            elif line.startswith("-"):
                words = line[1:].split()
                if block.startswith("SOLUTION/MATRIX_"):
                    words = words[:1] + words[3:]  # some writers repeat L COVA
                if words != [block]:
                    self.wrong(number, f"ends {line[1:].strip()!r}, but the block is {block!r}")
                block = ""
            elif not line.startswith(" "):
                self.wrong(number, f"a line begins with +, -, *, % or a blank, not {line[:1]!r}")
            elif block in ("SOLUTION/ESTIMATE", "SOLUTION/APRIORI"):
                self._parameter(number, line, block.removeprefix("SOLUTION/"))
            elif block.startswith("SOLUTION/MATRIX_"):
                self._elements(number, line, block.removeprefix("SOLUTION/MATRIX_"))
        if block:
            self.wrong(begun, f"the block {block} has no end")

    def _begin(self, number: int, words: list[str]) -> None:
        block = (words or ["?"])[0]
        if block not in READ_BLOCKS and not block.startswith(IGNORED_BLOCKS):
            known = ", ".join(READ_BLOCKS)
            ignored = ", ".join(f"{i}…" for i in IGNORED_BLOCKS)
            what = f"unknown block {block!r}; read are {known}; not needed are {ignored}"
            self.wrong(number, what)
        size = 3 if block.startswith("SOLUTION/MATRIX_") else 1
        if len(words) > size:
            self.wrong(
                number, f"words behind {block} are not read: {' '.join(words[size:])[:60]!r}"
            )
        if not block.startswith("SOLUTION/MATRIX_"):
            return
        triangle, kind = (*words[1:3], "?", "?")[:2]
        if triangle not in ("L", "U") or kind not in MATRIX_KINDS:
            what = (
                f"{block} needs L or U and one of {', '.join(MATRIX_KINDS)}, not {triangle} {kind}"
            )
            self.wrong(number, what)
        self.matrices[block.removeprefix("SOLUTION/MATRIX_")] = SinexMatrix(kind, number)

    def _parameter(self, number: int, line: str, block: str) -> None:
        words = line.split()
        if len(words) != 10:
            what = "a parameter has 10 fields: index, type, code, point, solution, epoch, unit, "
            self.wrong(number, f"{what}constraint, value, standard deviation, not {len(words)}")
            return
        index = int(words[0]) if re.fullmatch(r"\d{1,6}", words[0], re.ASCII) else 0
        if not 0 < index <= MAX_SINEX_PARAMETERS:
            self.wrong(
                number, f"index must be a number from 1 to {MAX_SINEX_PARAMETERS}, not {words[0]}"
            )
            return
        if index in self.parameters[block]:
            first = self.parameters[block][index].line
            self.wrong(number, f"parameter {index} stands in line {first} already")
            return
        self.parameters[block][index] = SinexParameter(
            index,
            words[1],
            (words[2], words[3], words[4]),
            self._epoch(number, words[5]),
            words[6],
            self.field(number, words[8], "the value").number(),
            self.field(number, words[9], "the standard deviation").number(least=0.0),
            number,
        )

    def _epoch(self, number: int, text: str) -> float:
        """Return years of year:day:second; NaN for 00:000:00000."""
        found = _EPOCH.fullmatch(text)
        if found is None:
            self.wrong(number, f"an epoch is year:day:second such as 25:333:43200, not {text!r}")
            return math.nan
        year, day, second = (int(g) for g in found.groups())
        if not day:
            return math.nan
        if len(found[1]) == 2:
            year += 1900 if year > 50 else 2000
        begin = date(max(year, 1), 1, 1)
        length = (date(begin.year + 1, 1, 1) - begin) / timedelta(days=1)
        return year + (day - 1 + second / 86400.0) / length

    def _elements(self, number: int, line: str, block: str) -> None:
        words = line.split()
        matrix = self.matrices.get(block)
        at = [int(w) if re.fullmatch(r"\d{1,6}", w, re.ASCII) else 0 for w in words[:2]]
        if matrix is None or not 3 <= len(words) <= 5 or len(at) != 2 or min(at) < 1:
            self.wrong(number, "a line of a matrix has two indices and one to three elements")
            return
        for k, text in enumerate(words[2:]):
            try:
                value = parse_quantity(text)
            except ValueError as error:
                self.wrong(number, str(error))
                return
            matrix.rows.append(at[0])
            matrix.columns.append(at[1] + k)
            matrix.values.append(value)
