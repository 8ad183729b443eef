"""Table of the formats that can be read, by suffix and content; `read` of a file of any of them.

A new format needs one module of `io.field_books`, `io.gnss`, `io.photogrammetry` or `io.survey`
with a function that reads a file and its ``READER``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from ..errors import InputError, Problem, known
from ..files import named_by_user
from ..network.network import Network
from . import field_books, gnss, photogrammetry, survey
from .format_options import fitting_options, refuse_unknown_options
from .format_reader import NetworkReader, Reader
from .project import Project, load_project, project_table_names
from .transaction_folders import recover_folder

MAX_FOLDER_ENTRIES = 200
"""Largest number of entries of a folder that are examined for what it may have."""
MAX_PROPOSED_FOLDERS = 5
"""Largest number of folders that a message proposes."""
PROJECT_READER = Reader(
    "project", (".toml",), "project", load_project, folders=True, main_file="project.toml"
)


@dataclass
class Readers:
    """A table of readers; its text lists their suffixes and descriptions.

    Raises:
        InputError: a reader has no suffix and reads no folders, a suffix has no dot, two readers
            have one name, or two that recognise no content claim the same suffix or folders.
    """

    entries: tuple[Reader, ...]
    """One reader for each format."""

    def __post_init__(self) -> None:
        """Refuse readers that neither the name of a file nor its content distinguishes."""
        problems = []
        owners: dict[str, str] = {}
        for reader in self.entries:
            where = f"reader of {reader.description}"
            if not reader.claims():
                problems.append(Problem("has no suffix; valid: at least one, such as .txt", where))
            for suffix in reader.suffixes:
                if not suffix.startswith(".") or suffix.endswith("."):
                    what = f"suffix {suffix!r} is none; valid: a dot and letters, such as .txt"
                    problems.append(Problem(what, where))
            claims = [f"name {reader.name}"]
            if reader.recognises is None:
                claims += reader.claims()
            elif len(set(reader.suffixes)) < len(reader.suffixes):
                problems.append(Problem("names a suffix twice", where))
            for claim in claims:
                if claim in owners:
                    what = f"{claim}: claimed by the reader of {owners[claim]} already"
                    problems.append(Problem(what, where))
                owners.setdefault(claim, reader.description)
        if problems:
            raise InputError(problems)

    def add(self, reader: Reader) -> None:
        """Add a reader; InputError where it cannot be distinguished from the others."""
        self.entries = Readers((*self.entries, reader)).entries

    def __str__(self) -> str:
        """Return the suffixes with the names of their formats."""
        return ", ".join(
            f"{', '.join(r.suffixes) or 'a folder'} ({r.description})" for r in self.entries
        )

    def load(
        self,
        path: str | Path,
        *,
        readings: bool = True,
        allow_outside: bool = False,
        format: str | None = None,
        options: Mapping[str, Any] | None = None,
    ) -> Project:
        """Read a file of any of the formats, or a folder.

        Args:
            path: file or folder.
            readings: whether observations need observed values; those of a design do not.
            allow_outside: whether a project may name files outside its folder.
            format: name of the format; None: it follows from suffix and content.
            options: options of the function that reads this format, by name.

        Raises:
            InputError: the file does not exist, no reader has its suffix or its name, the reader
                has no such option or another kind of value for it, or the file has problems (all
                are listed).
        """
        source = Path(path)
        for folder in (source.parent, source):
            recover_folder(folder)
        if not source.exists():
            raise InputError(Problem("no such file or folder", str(path)))
        given = dict(options or {})
        if format is None and not given:
            _refuse_table_of_project(source)
        reader = self.reader(source, format)
        doing = f"reading {reader.description}"
        refuse_unknown_options(given, reader.options, doing=doing, where=str(path))
        if isinstance(reader.load, NetworkReader):
            given = fitting_options(reader.load.read, given, doing=doing, where=str(path))
        with named_by_user(source, *given.values()):
            return reader.load(source, readings=readings, allow_outside=allow_outside, **given)

    def reader(self, path: Path, format: str | None = None) -> Reader:
        """Return the reader of a format, or of a file. Raises as `named` and `of`."""
        return self.of(path) if format is None else self.named(format)

    def named(self, name: str) -> Reader:
        """Return the reader of a format by its name.

        Raises:
            InputError: no reader has the name.
        """
        for reader in self.entries:
            if reader.name == name:
                return reader
        names = [r.name for r in self.entries]
        raise InputError(f"no format {name!r} can be read; valid: {known(names, meant=name)}")

    def of(self, path: Path) -> Reader:
        """Return the reader of a file or folder, by its suffix and, among several, its content.

        Raises:
            InputError: no reader has the suffix, or none recognises the content.
        """
        if path.is_dir():
            fitting = [r for r in self.entries if r.folders]
        else:
            end = "".join(path.suffixes)
            ends = [(len(s), r) for r in self.entries for s in r.suffixes if end.endswith(s)]
            longest = max((n for n, _ in ends), default=0)
            fitting = [r for n, r in ends if n == longest]
        sure = [r for r in fitting if r.recognises is not None and r.recognises(path)]
        rest = [r for r in fitting if r.recognises is None and r.may_be(path)]
        for found in (sure, rest):
            if len(found) == 1:
                return found[0]
        if len(sure) > 1:
            what = f"could be {' or '.join(r.description for r in sure)}; say format= or --from"
            raise InputError(Problem(f"{what}: {', '.join(r.name for r in sure)}", str(path)))
        if fitting:
            what = f"is none of {', '.join(r.description for r in fitting)} by its content"
            if tables := _tables_without_project(path):
                raise InputError(Problem(tables, str(path)))
            inside = self._inside(path)
            what += f"; valid: {', '.join(inside)}" if inside else "; or say format= or --from"
            raise InputError(Problem(what, str(path)))
        outside = self._of_folder(path.parent)
        if outside:
            what = f"unknown kind of file; valid: its folder {path.parent} ({outside.description})"
            raise InputError(Problem(what, str(path)))
        raise InputError(Problem(f"unknown kind of file; valid: {self}", str(path)))

    def _of_folder(self, path: Path) -> Reader | None:
        """Return the first reader that a folder may belong to; None where it is of none."""
        for reader in self.entries:
            if not reader.folders:
                continue
            named = bool(reader.main_file) and reader.may_be(path)
            if named if reader.recognises is None else reader.recognises(path):
                return reader
        return None

    def _inside(self, path: Path) -> list[str]:
        """Return the folders inside a folder that can be read, with their formats."""
        if not path.is_dir():
            return []
        inner = [
            p for pattern in ("*", "*/*") for p in sorted(path.glob(pattern))[:MAX_FOLDER_ENTRIES]
        ]
        return [
            f"{folder} ({reader.description})"
            for folder in inner
            if folder.is_dir() and (reader := self._of_folder(folder))
        ][:MAX_PROPOSED_FOLDERS]


def _readers_of_modules() -> Iterator[Reader]:
    """Yield every reader that a module of a room of formats states, in the order of the names."""
    for room in (field_books, gnss, photogrammetry, survey):
        for found in iter_modules(room.__path__, f"{room.__name__}."):
            stated = vars(import_module(found.name)).values()
            yield from (value for value in stated if isinstance(value, Reader))


READERS = Readers((PROJECT_READER, *_readers_of_modules()))
"""The formats that can be read."""


def register_reader(reader: Reader) -> Reader:
    """Add the reader of a format to those that `read` and the command take; return it.

    Args:
        reader: the reader.

    Raises:
        InputError: neither name, suffix nor content distinguishes it from another one.
    """
    READERS.add(reader)
    return reader


def read(path: str | Path, *, format: str | None = None, **options: Any) -> Network:
    """Read the network of a file of any format that `READERS` lists.

    Suffix and content determine the format. The readers of the formats (`read_project`,
    `read_gama`, `read_bal`, …) document how they convert a file, and have options of their own.

    Args:
        path: the file, or the folder that has a project as ``project.toml``.
        format: name of the format, where suffix and content do not determine it.
        options: options of the reader of the format.

    Raises:
        InputError: the file does not exist, no reader has its suffix (the message lists the
            valid suffixes), the reader has no such option, or the file has problems (all are
            listed).
    """
    return READERS.load(path, format=format, options=options).network_alone()


def _tables_without_project(folder: Path) -> str:
    """Return that a folder has tables of a project without its TOML file; empty if not so."""
    if not folder.is_dir():
        return ""
    tables = [f"{n}.csv" for n in project_table_names() if (folder / f"{n}.csv").is_file()]
    if not tables:
        return ""
    others = sorted(str(f) for f in folder.glob("*.toml"))
    advice = f"; valid: {known(others)}" if others else "; write it, or name the right folder"
    return f"project.toml is missing beside {known(tables)}{advice}"


def _refuse_table_of_project(source: Path) -> None:
    """Refuse a table that lies beside a project.toml, and is read as a part of that project.

    Raises:
        InputError: which folder is to be given.
    """
    main = source.parent / "project.toml"
    if source.suffix.lower() == ".csv" and source.is_file() and main.is_file():
        raise InputError(
            Problem(
                f"is a table of the project in its folder: give the folder, {source.parent}, or "
                f"{main}; a table of its own is read with the option mapping",
                str(source),
            )
        )
