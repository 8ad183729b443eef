"""Problems of a file, collected while it is read; its words as numbers and names.

Every method of `FileProblems` and `SurveyProblems` adds a problem with file and line and
continues, so that one error lists all problems of a file. A reader that joins several files numbers
their lines consecutively; `SurveyProblems.place` gives the file of a line. Rows that a reader
leaves out are gathered by their reason, then counted and named.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

from ..errors import InputError, LeftOut, Problem
from ..files import read_bytes
from .text_files import last_line_number, read_text

MAX_FILE_NUMBER = 1e9
"""Largest size of a number of a file, metres or units of angle: more than any place on Earth."""
MIN_FILE_SIGMA = 1e-12
"""Smallest standard deviation of a file, metres or units of angle."""
MAX_LISTED_PROBLEMS = 50
"""Number of problems after which a message only counts the others."""
MAX_SURVEY_NUMBER = 1e12
"""Size from which a number of a survey file is taken for damage: metres, or units of angle."""


@dataclass(frozen=True)
class LeftOutReason:
    """Why rows of a sort are left out."""

    what: str
    """The rows, in words."""
    why: str
    """Why they are left out."""
    doubtful: bool = False
    """Whether they were expected to be used: marks of known points."""


ROWS_SWITCHED_OFF = LeftOutReason("points and observations", "they are switched off in the file")
DERIVED_OBSERVATIONS = LeftOutReason(
    "reduced observations", "they are derived: raw readings alone are read"
)


@dataclass
class RowsLeftOut:
    """The rows that a reader has left out so far."""

    rows: dict[LeftOutReason, list[tuple[str, str]]] = field(default_factory=dict)
    """Name and place of each row, by the reason."""

    def add(self, why: LeftOutReason, name: str, where: str = "") -> None:
        """Note a row.

        Args:
            why: why it is left out.
            name: name of its photo, of its points, or of itself.
            where: file and line.
        """
        self.rows.setdefault(why, []).append((name, where))

    def told(self) -> dict[LeftOutReason, LeftOut]:
        """Return a record for each reason: number of rows, their names, place of the first."""
        return {
            why: LeftOut(
                why.what,
                why.why,
                tuple(dict.fromkeys(name for name, _ in rows)),
                len(rows),
                where=next((where for _, where in rows if where), ""),
                doubtful=why.doubtful,
            )
            for why, rows in self.rows.items()
        }


def left_out_records(parts: Iterable[RowsLeftOut]) -> list[LeftOut]:
    """Return the records of several files together."""
    whole = RowsLeftOut()
    for part in parts:
        for why, rows in part.rows.items():
            whole.rows.setdefault(why, []).extend(rows)
    return list(whole.told().values())


T = TypeVar("T")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
_LINE = re.compile(r":(\d+)(?::|$)")


def parse_number(text: str) -> float:
    """Return a decimal number, with an exponent of C or Fortran; NaN if it is none."""
    if _NUMBER.fullmatch(text) is None:
        return math.nan
    return float(text.replace("D", "E").replace("d", "e"))


class FileProblems:
    """The problems of one file: every method notes what is wrong with its line."""

    def __init__(self, path: Path) -> None:
        """Start without problems."""
        self.path = path
        self.last = 0
        """Line at which a problem of the whole file is told: its last one; 0: none is known."""
        self.problems: list[Problem] = []
        self.left = RowsLeftOut()

    def place(self, line: int) -> str:
        """Return file and line; 0 is the last line of the file."""
        line = line or self.last
        return f"{self.path.name}:{line}" if line else self.path.name

    def add(self, line: int, what: str) -> None:
        """Note a problem; the same problem of a line is noted once. Line 0: the whole file."""
        problem = Problem(what, self.place(line))
        if problem not in self.problems[-MAX_LISTED_PROBLEMS:]:
            self.problems.append(problem)

    def leave_out(self, line: int, why: LeftOutReason, name: str) -> None:
        """Count and name a row that is left out; ``name``: of its points or itself."""
        self.left.add(why, name, self.place(line))

    def number(
        self, line: int, name: str, text: str, *, positive: bool = False, least: float = -math.inf
    ) -> float:
        """Return a number of moderate size; otherwise note a problem and return NaN.

        Args:
            line: where it stands.
            name: what it is, for the message.
            text: its digits.
            positive: whether it must be > 0 (at least `MIN_FILE_SIGMA`), as a standard deviation.
            least: its lower bound.
        """
        value = parse_number(text.strip())
        low = MIN_FILE_SIGMA if positive else least
        if math.isfinite(value) and abs(value) <= MAX_FILE_NUMBER and value >= low:
            return value
        wanted = "a number > 0" if positive else "a number"
        if least > -math.inf and not positive:
            wanted = f"a number ≥ {least:g}"
        size = (
            f" (from {MIN_FILE_SIGMA:g} to {MAX_FILE_NUMBER:g})"
            if positive
            else f" (up to {MAX_FILE_NUMBER:g})"
        )
        found = f"{text.strip()[:40]!r}" if text.strip() else "nothing"
        self.add(line, f"{name} must be {wanted}{size}, not {found}")
        return math.nan

    def attempt(
        self, line: int, make: Callable[..., T], *arguments: Any, **options: Any
    ) -> T | None:
        """Return what a function makes; note the problems of an InputError with the line."""
        try:
            return make(*arguments, **options)
        except InputError as error:
            for p in error.problems:
                where = p.where.removeprefix(self.place(line)).removeprefix(": ")
                self.add(line, f"{where}: {p.what}" if where else p.what)
            return None

    def order(self, problem: Problem) -> tuple[int, int]:
        """Return by what problems are ordered: a number of the file, the line."""
        found = _LINE.search(problem.where)
        return 0, int(found.group(1)) if found else 0

    def raise_all(self) -> None:
        """Raise InputError with all problems in the order of lines, if there are any."""
        if not self.problems:
            return
        ordered = sorted(self.problems, key=self.order)
        rest = len(ordered) - MAX_LISTED_PROBLEMS
        if rest > 0:
            more = Problem(f"and {rest} further problems", self.path.name)
            ordered = [*ordered[:MAX_LISTED_PROBLEMS], more]
        raise InputError(ordered)


def raise_all(files: Iterable[FileProblems]) -> None:
    """Raise InputError with the problems of several files, file by file, if there are any."""
    problems: list[Problem] = []
    for file in files:
        try:
            file.raise_all()
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)


class FileLines(FileProblems):
    """A text file: its lines with their numbers, and the problems found in it so far."""

    def __init__(self, path: str | Path, *, latin: bool = False) -> None:
        """Read the file.

        Args:
            path: the file.
            latin: whether text that is not UTF-8 is Latin-1: files of programs that write
                comments in the encoding of their system.

        Raises:
            InputError: the file cannot be read, or is not text.
        """
        super().__init__(Path(path))
        text = _text(self.path, latin)
        if "\0" in text:
            line = text.count("\n", 0, text.index("\0")) + 1
            raise InputError(Problem("is not text: it has zero bytes", self.place(line)))
        self.lines = text.split("\n")
        self.last = last_line_number(text)

    def numbered(self) -> list[tuple[int, str]]:
        """Return the lines, numbered from 1."""
        return list(enumerate(self.lines, 1))


def _text(path: Path, latin: bool) -> str:
    try:
        return read_text(path)
    except InputError:
        if not latin or not path.is_file():
            raise
        text = read_bytes(path).decode("latin-1")
        return text.replace("\r\n", "\n").replace("\r", "\n")


SURVEY_NUMBER_PATTERN = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)


class SurveyProblems(FileProblems):
    """The problems found so far in a file, or in several whose lines are numbered on."""

    def __init__(self, path: Path) -> None:
        """Start without problems."""
        super().__init__(path)
        self.starts: list[tuple[int, Path]] = [(0, path)]

    def place(self, line: int) -> str:
        """Return file and line."""
        line = max(line, 1)
        before, path = next(s for s in reversed(self.starts) if s[0] < line)
        return f"{path.name}:{line - before}"

    def go_on(self, path: Path, lines: int) -> None:
        """Go on with another file, whose lines are numbered on.

        Args:
            path: the file.
            lines: number of lines of all files before it.
        """
        self.starts.append((lines, path))

    def order(self, problem: Problem) -> tuple[int, int]:
        """Return the number of the file and the line of a problem."""
        named = [i for i, (_, p) in enumerate(self.starts) if problem.where.startswith(p.name)]
        return (named or [0])[-1], super().order(problem)[1]

    def __bool__(self) -> bool:
        """Return whether there are problems."""
        return bool(self.problems)

    def finite(self, line: int, text: str, what: str, scale: float = 1.0) -> float:
        """Return a finite number times ``scale``; otherwise note a problem and return NaN."""
        value = float(text) if SURVEY_NUMBER_PATTERN.fullmatch(text) else math.nan
        if abs(value) < MAX_SURVEY_NUMBER:
            return value * scale
        self.add(line, f"{what} must be a finite number, not {text[:40]!r}")
        return math.nan

    def name(self, line: int, text: str, what: str) -> str:
        """Return a name without blanks at its ends; otherwise note a problem and return ''."""
        name = text.strip()
        if name and name.isprintable():
            return name
        self.add(line, f"{what} must be a name, not {text[:40]!r}")
        return ""
