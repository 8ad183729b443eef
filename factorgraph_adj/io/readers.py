"""Readers of files by suffix: the table of the formats that can be read.

A new format needs one module with a function that reads a file, and one line in `READERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from ..errors import InputError, Problem
from ..network.network import Network
from .bal import read_bal
from .gama import read_gama
from .project import Project, load_project


class Load(Protocol):
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

    suffixes: tuple[str, ...]
    """Suffixes of file names, with dots; packed files have two parts: ``.txt.gz``."""
    description: str
    """Name of the format for help and messages."""
    load: Load
    """The function that reads a file."""
    folders: bool = False
    """Whether the reader also reads folders."""


@dataclass(frozen=True)
class Readers:
    """A table of readers; its text lists their suffixes and descriptions.

    Raises:
        InputError: a reader has no suffix, a suffix has no dot, or two readers claim the same
            suffix or both read folders.
    """

    entries: tuple[Reader, ...]
    """One reader for each format."""

    def __post_init__(self) -> None:
        """Refuse readers that the name of a file does not distinguish."""
        problems = []
        owners: dict[str, str] = {}
        for reader in self.entries:
            where = f"reader of {reader.description}"
            if not reader.suffixes:
                problems.append(Problem("has no suffix; valid: at least one, such as .txt", where))
            for suffix in reader.suffixes:
                if not suffix.startswith(".") or suffix.endswith("."):
                    what = f"suffix {suffix!r} is none; valid: a dot and letters, such as .txt"
                    problems.append(Problem(what, where))
            claims = [f"suffix {s}" for s in reader.suffixes]
            for claim in [*claims, *(["folders"] if reader.folders else [])]:
                if claim in owners:
                    what = f"{claim}: claimed by the reader of {owners[claim]} already"
                    problems.append(Problem(what, where))
                owners.setdefault(claim, reader.description)
        if problems:
            raise InputError(problems)

    def __str__(self) -> str:
        """Return the suffixes with the names of their formats."""
        return ", ".join(f"{', '.join(r.suffixes)} ({r.description})" for r in self.entries)

    def load(
        self, path: str | Path, *, readings: bool = True, allow_outside: bool = False
    ) -> Project:
        """Read a file of any of the formats, or a folder.

        Args:
            path: file or folder.
            readings: whether observations need observed values; those of a design do not.
            allow_outside: whether a project may name files outside its folder.

        Raises:
            InputError: the file does not exist, no reader has its suffix, or the file has
                problems (all are listed).
        """
        source = Path(path)
        if not source.exists():
            raise InputError(Problem("no such file or folder", str(path)))
        reader = self._of_folders() if source.is_dir() else self._of_file(source)
        if reader is None:
            raise InputError(Problem(f"unknown kind of file; valid: {self}", str(path)))
        return reader.load(source, readings=readings, allow_outside=allow_outside)

    def _of_folders(self) -> Reader | None:
        return next((r for r in self.entries if r.folders), None)

    def _of_file(self, path: Path) -> Reader | None:
        """Return the reader with the longest suffix that ends the name; None if no suffix does."""
        end = "".join(path.suffixes)
        fitting = [(len(s), r) for r in self.entries for s in r.suffixes if end.endswith(s)]
        return max(fitting, key=lambda entry: entry[0], default=(0, None))[1]


def network_alone(read: Callable[[Path], Network]) -> Load:
    """Return the reader of a format that holds only a network with all readings.

    Args:
        read: function that reads a file as a network.

    Returns:
        A reader of projects in default units, with default options.
    """

    def load(path: Path, /, *, readings: bool, allow_outside: bool) -> Project:
        return Project(read(path), path)

    return load


READERS = Readers(
    (
        Reader((".toml",), "project", load_project, folders=True),
        Reader((".gkf",), "GNU Gama", network_alone(read_gama)),
        Reader(
            (".txt", ".txt.bz2", ".txt.gz"),
            "Bundle Adjustment in the Large",
            network_alone(read_bal),
        ),
    )
)
"""The formats that can be read."""


def read(path: str | Path) -> Network:
    """Read the network of a file of any format that `READERS` lists.

    The suffix determines the format. The readers of the formats (`read_project`, `read_gama`,
    `read_bal`) document how they convert a file, and may have options of their own.

    Args:
        path: the file, or the folder that has a project as ``project.toml``.

    Raises:
        InputError: the file does not exist, no reader has its suffix (the message lists the
            valid suffixes), or the file has problems (all are listed).
    """
    return READERS.load(path).network
