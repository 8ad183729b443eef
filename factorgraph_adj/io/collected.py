"""Problems of a file, collected while it is read, and its words as numbers and names."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

from ..errors import InputError, Problem
from ..files import read_bytes
from .left_out import Reason, RowsLeftOut
from .text import last_line, read_text

T = TypeVar("T")
LARGEST = 1e9
"""Largest size of a number of a file, metres or units of angle: more than any place on Earth."""
SMALLEST = 1e-12
"""Smallest standard deviation of a file, metres or units of angle."""
MOST_LISTED = 50
"""Number of problems after which a message only counts the others."""
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?", re.ASCII)
_LINE = re.compile(r":(\d+)(?::|$)")


def parse_number(text: str) -> float:
    """Return a decimal number, with an exponent of C or Fortran; NaN if it is none."""
    if _NUMBER.fullmatch(text) is None:
        return math.nan
    return float(text.replace("D", "E").replace("d", "e"))


class Collected:
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
        if problem not in self.problems[-MOST_LISTED:]:
            self.problems.append(problem)

    def leave_out(self, line: int, why: Reason, name: str) -> None:
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
            positive: whether it must be > 0 (at least `SMALLEST`), as a standard deviation.
            least: its lower bound.
        """
        value = parse_number(text.strip())
        low = SMALLEST if positive else least
        if math.isfinite(value) and abs(value) <= LARGEST and value >= low:
            return value
        wanted = "a number > 0" if positive else "a number"
        if least > -math.inf and not positive:
            wanted = f"a number ≥ {least:g}"
        size = f" (from {SMALLEST:g} to {LARGEST:g})" if positive else f" (up to {LARGEST:g})"
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
        rest = len(ordered) - MOST_LISTED
        if rest > 0:
            more = Problem(f"and {rest} further problems", self.path.name)
            ordered = [*ordered[:MOST_LISTED], more]
        raise InputError(ordered)


def raise_all(files: Iterable[Collected]) -> None:
    """Raise InputError with the problems of several files, file by file, if there are any."""
    problems: list[Problem] = []
    for file in files:
        try:
            file.raise_all()
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)


class LinesOfFile(Collected):
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
        self.last = last_line(text)

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
