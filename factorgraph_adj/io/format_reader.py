"""Record of the reader of one format: suffixes, recognition by content, function that reads.

A module of `io.field_books`, `io.gnss`, `io.photogrammetry`, `io.robotics` or `io.survey` states
its reader as ``READER``, and `io.readers` finds it; `io.readers.register_reader` takes others.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from ..network.network import Network
from .format_options import arguments_of, options_of
from .project import Project
from .text_files import file_beginning


class LoadFunction(Protocol):
    """Function that reads a file as a project."""

    def __call__(self, path: Path, /, *, readings: bool, allow_outside: bool) -> Project:
        """Return the project.

        Args:
            path: the file.
            readings: whether observations need observed values; those of a design do not.
            allow_outside: whether a project may name files outside its folder.
        """


@dataclass(frozen=True)
class Reader:
    """Reader of one format."""

    name: str
    """Word for the format in the option ``--from`` and in messages: ``gama``."""
    suffixes: tuple[str, ...]
    """Suffixes of file names, with dots; packed files have two parts: ``.txt.gz``. Empty for a
    format that is a folder."""
    description: str
    """Name of the format for help and messages."""
    load: LoadFunction
    """The function that reads a file."""
    folders: bool = False
    """Whether the reader also reads folders."""
    recognises: Callable[[Path], bool] | None = None
    """Tells a file, or folder, of this format by its content from those of all other formats,
    whatever its suffix; None for a format whose suffix alone tells it."""
    own_grid: bool = False
    """Whether the function itself takes the reference system of a grid, as its option ``crs``."""
    main_file: str = ""
    """File that every folder of this format has; empty: any folder may be one."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options that the function takes beside those of every reader."""
        return self.load.options if isinstance(self.load, NetworkReader) else ()

    def may_be(self, path: Path) -> bool:
        """Return whether a path is a file, or a folder with the main file of the format."""
        return path.is_file() or not self.main_file or (path / self.main_file).is_file()

    def claims(self) -> list[str]:
        """Return what the reader reads, in words: suffixes and folders."""
        return [f"suffix {s}" for s in self.suffixes] + (["folders"] if self.folders else [])


READINGS = "readings"
"""Argument of a function that also reads designs."""


@dataclass(frozen=True)
class NetworkReader:
    """Reader of a format that holds only a network with all readings.

    It returns projects in default units, with default options.
    """

    read: Callable[..., Network]
    """Function that reads a file as a network; its keyword-only arguments are options, besides
    ``readings``: with it a function also reads designs, whose observations have no values yet."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the keyword-only arguments of the function, and of fields of groups."""
        return tuple(name for name in options_of(self.read) if name != READINGS)

    def __call__(
        self, path: Path, /, *, readings: bool, allow_outside: bool, **options: Any
    ) -> Project:
        """Read a file."""
        if READINGS in options_of(self.read):
            options[READINGS] = readings
        return Project(self.read(path, **arguments_of(self.read, options)), path)


def beginning_has(word: bytes) -> Callable[[Path], bool]:
    """Return a function that returns whether a word is in the beginning of a file."""
    return lambda path: word in file_beginning(path)


def begins_with(pattern: bytes) -> Callable[[Path], bool]:
    """Return a function that returns whether a file begins with a regular expression of bytes.

    A byte order mark is passed over, and ``$`` ends a line. Every file is asked about: of two ways
    to pass over the same characters one must be possessive (``*+``), or blank lines take hours.
    """
    found = re.compile(rb"(?:\xef\xbb\xbf)?" + pattern, flags=re.MULTILINE)
    return lambda path: found.match(file_beginning(path)) is not None
