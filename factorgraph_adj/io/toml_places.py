"""Lines of the keys of a TOML file, since Python's reader of TOML keeps no places.

A problem of a TOML file names its table, and its text names the key concerned. Both together give
the line.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem
from .text import parse_toml, read_text

_HEADER = re.compile(r"\s*\[\[?\s*([^\[\]]+?)\s*\]\]?\s*(?:#.*)?$")
_BARE = r"(?:[\w-]+|\"[^\"]*\"|'[^']*')"
_KEY = re.compile(rf"\s*({_BARE}(?:\s*\.\s*{_BARE})*)\s*=")
_PART = re.compile(r"\"([^\"]*)\"|'([^']*)'|([\w-]+)")
_TABLE = re.compile(r"\[\[?([^\[\]]+?)\]\]?|^: (\w+)")
_NAMED = re.compile(r"\s'([^']*)'|\s(\d+)\b")
_WORD = re.compile(r"[\w-]+")
_INLINE = re.compile(r"[{,]\s*([\w-]+)\s*=")
"""Keys of a table that is written in one line."""


@dataclass
class _Section:
    """A table of the file: its name, the line of its header and those of its keys."""

    name: str
    line: int
    keys: dict[str, int] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)


class TomlPlaces:
    """The tables and keys of a TOML text, with their lines."""

    def __init__(self, text: str, name: str) -> None:
        """Find tables and keys.

        Args:
            text: the text.
            name: name of its file in messages.
        """
        self.name = name
        self.sections = [_Section("", 1)]
        for number, line in enumerate(text.split("\n"), 1):
            header, key = _HEADER.match(line), _KEY.match(line)
            if header is not None:
                self.sections.append(_Section(_plain(header[1]), number))
            elif key is not None:
                here, name = self.sections[-1], _plain(key[1])
                here.texts.setdefault(name, line[key.end() :])
                for part in (name, *_INLINE.findall(line, key.end())):
                    here.keys.setdefault(part, number)

    def placed(self, problem: Problem) -> Problem:
        """Return a problem of the file with its line; problems that have one stay as they are."""
        where = problem.where
        if where.startswith("["):  # a table without its file
            where = f"{self.name}: {where}"
        if where != self.name and not where.startswith(f"{self.name}: "):
            return problem
        rest = where[len(self.name) :]
        line = self._line(rest, problem.what)
        return Problem(problem.what, f"{self.name}:{line}{rest}")

    @contextmanager
    def placing(self) -> Iterator[None]:
        """Give the problems of an InputError inside their lines."""
        try:
            yield
        except InputError as error:
            raise InputError(map(self.placed, error.problems)) from None

    def _line(self, rest: str, what: str) -> int:
        """Return the line of the key that a message is about, or of its table."""
        own = _NAMED.sub(" ", _TABLE.sub(" ", rest))
        words = list(dict.fromkeys(_WORD.findall(f"{what.split(';')[0]} {own}")))
        sections = self._sections(rest)
        for word in words:
            for section in sections:
                if word in section.keys:
                    return section.keys[word]
        if sections and sections[0].name:
            return sections[0].line
        by_header = [s for s in self.sections if s.name and s.name.split(".")[-1] in words]
        return by_header[0].line if by_header else 1

    def _sections(self, rest: str) -> list[_Section]:
        """Return the tables that a place names, the one with the name that it states first."""
        found = _TABLE.search(rest)
        if found is None:
            return self.sections[:1]
        title = _plain(found[1] or found[2])
        fitting = [s for s in self.sections if s.name == title]
        inside = [s for s in self.sections if s.name.startswith(f"{title}.")]
        named = _NAMED.match(rest, found.end())
        if named is not None and named[2] is not None:
            number = int(named[2])
            return fitting[number - 1 : number] or fitting
        if named is not None:
            own = [s for s in fitting if named[1] in s.texts.get("name", "")]
            begun = own[0].line if own else 0
            return own + [s for s in inside if s.line > begun] or fitting
        return fitting + inside or self.sections[:1]


def read_toml(path: Path) -> tuple[dict[str, Any], TomlPlaces]:
    """Return the document of a TOML file, and the places of its keys.

    Raises:
        InputError: the file cannot be read, or is not TOML.
    """
    text = read_text(path)
    return parse_toml(text, path.name), TomlPlaces(text, path.name)


def _plain(name: str) -> str:
    """Return a dotted name without quotation marks and blanks."""
    return ".".join(a or b or c for a, b, c in _PART.findall(name))
