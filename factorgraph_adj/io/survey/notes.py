"""What is wrong in a file: problems with file and line, and numbers and names in its text.

A reader of several files in a row numbers their lines on; `Notes.place` tells the file of a line.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

from ...errors import InputError, Problem
from ...observations.base import Observation

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
LARGEST = 1e12
"""Size from which a number of a survey file is taken for damage: metres, or units of angle."""
MOST_PROBLEMS = 100
"""Number of problems of a file that are listed; a file of another format has one in each line."""


class Notes:
    """The problems found in a file so far."""

    def __init__(self, path: Path) -> None:
        """Start without problems."""
        self.path = path
        self.starts: list[tuple[int, Path]] = [(0, path)]
        self.problems: dict[Problem, int] = {}
        self.more = 0

    def place(self, line: int) -> str:
        """Return file and line."""
        before, path = next(s for s in reversed(self.starts) if s[0] < max(line, 1))
        return f"{path.name}:{line - before}"

    def go_on(self, path: Path, lines: int) -> None:
        """Go on with another file, whose lines are numbered on.

        Args:
            path: the file.
            lines: number of lines of all files before it.
        """
        self.starts.append((lines, path))

    def add(self, line: int, what: str) -> None:
        """Note a problem of a line; the same problem is noted once."""
        problem = Problem(what, self.place(line))
        if problem not in self.problems and len(self.problems) >= MOST_PROBLEMS:
            self.more += 1
        else:
            self.problems.setdefault(problem, line)

    def __bool__(self) -> bool:
        """Return whether there are problems."""
        return bool(self.problems)

    def raise_problems(self) -> None:
        """Raise InputError with the problems in the order of lines, if there are any."""
        if not self.problems:
            return
        listed = sorted(self.problems, key=lambda p: self.problems[p])
        if self.more:
            listed.append(Problem(f"and {self.more} more problems", self.path.name))
        raise InputError(listed)

    def number(self, line: int, text: str, what: str, scale: float = 1.0) -> float:
        """Return a finite number times ``scale``; otherwise note a problem and return NaN."""
        value = float(text) if NUMBER.fullmatch(text) else math.nan
        if abs(value) < LARGEST:
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

    def attempt(self, line: int, make: Callable[[], Observation]) -> Observation | None:
        """Return an observation; note what its kind refuses, and return None then."""
        try:
            return make()
        except InputError as error:
            for p in error.problems:
                self.add(line, p.what)
        return None
