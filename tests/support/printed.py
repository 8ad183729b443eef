"""The words of a printed report."""

from __future__ import annotations

import re

HALF_UNIT = 0.5 + 1e-9
"""Of the last printed digit."""
CELL = re.compile(r"\S+(?: \S+)*")
"""A cell of a printed table: two blanks part it from the next one."""


def section(text: str, heading: str) -> list[list[str]]:
    """Return the rows of a section as words, without its heading."""
    return [line.split() for line in lines_of(text, heading)]


def lines_of(text: str, heading: str) -> list[str]:
    """Return the lines of a section, without its heading."""
    lines = text.splitlines()
    first = next(i for i, line in enumerate(lines) if line.startswith(heading)) + 2
    after = (i for i, line in enumerate(lines[first:], first) if not line)
    return lines[first : next(after, len(lines))]


def row(text: str, heading: str, name: str) -> list[str]:
    """Return the words of the row that starts with a name."""
    return next(words for words in section(text, heading) if words[0] == name)


def cells(text: str, heading: str, name: str) -> dict[str, str]:
    """Return the cells of the row that starts with a name, by column heading without its unit.

    A cell stands below its heading, whatever columns the table has beside it; an empty one is "".
    """
    header, _, *rows = lines_of(text, heading)
    line = next(line for line in rows if line.split()[0] == name)
    found = list(CELL.finditer(line))
    out = {}
    for title in CELL.finditer(header):
        below = [c[0] for c in found if c.start() < title.end() and c.end() > title.start()]
        assert len(below) < 2, (title[0], below)
        out[title[0].partition(" [")[0]] = "".join(below)
    return out


def assert_printed(text: str, value: float) -> None:
    """A printed number agrees with a value to half its last digit."""
    last = 10.0 ** -len(text.partition(".")[2]) if "." in text else 1.0
    assert abs(float(text) - value) <= HALF_UNIT * last, (text, value)
