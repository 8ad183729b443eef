"""What is wrong in a file: problems with file and line, and numbers and names in its text.

A reader of several files in a row numbers their lines on; `Notes.place` tells the file of a line.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

from ...errors import Problem
from ..collected import Collected

NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?", re.ASCII)
LARGEST = 1e12
"""Size from which a number of a survey file is taken for damage: metres, or units of angle."""


class Notes(Collected):
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
