"""Table of the formats that can be read, by suffix and content; `read` of a file of any of them.

A new format needs one module of `io.field_books`, `io.gnss`, `io.photogrammetry`, `io.robotics` or
`io.survey` with a function that reads a file and its ``READER``.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

from ..errors import InputError, Problem, known
from ..files import named_by_user
from ..network.network import Network
from . import field_books, gnss, photogrammetry, robotics, survey
from .file_signatures import description, looks_like
from .format_options import fitting_options, refuse_unknown_options
from .format_reader import NetworkReader, Reader
from .project import Project, load_project, project_table_names
from .transaction_folders import recover_folder

MAX_FOLDER_ENTRIES = 200
"""Largest number of entries of a folder that are examined for what it may have."""
MAX_PROPOSED_PATHS = 5
"""Largest number of folders or files that a message proposes."""
PROJECT_READER = Reader(
    "project", (".toml",), "project", load_project, folders=True, main_file="project.toml"
)


@dataclass
class Readers:
    """A table of readers.

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
                if not suffix.startswith(".") or suffix.endswith(".") or suffix != suffix.lower():
                    what = f"suffix {suffix!r} is none; valid: a dot and small letters, as in .txt"
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
            InputError: the file does not exist, no reader knows it or has the name, the reader
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
            project = reader.load(source, readings=readings, allow_outside=allow_outside, **given)
        if format is None and reader not in self.suffix_readers(source):
            project.network.remarks.append(
                f"{source.name} was read as {reader.description}, by its content"
            )
        return project

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
        """Return the reader of a file or folder, by its content and its suffix.

        A reader that recognises the content has the file, whatever its suffix; among several, those
        with the suffix. A suffix decides alone where only one reader has it, or has no function
        that recognises its files.

        Raises:
            InputError: no reader recognises the content, or several do; the message says what the
                file looks like.
        """
        fitting = self.suffix_readers(path)
        sure = self._recognising(path, fitting if path.is_dir() else self.entries)
        sure = [r for r in sure if r in fitting] or sure
        if len(sure) == 1:
            return sure[0]
        if sure:
            what = f"could be {' or '.join(r.description for r in sure)}; say format= or --from"
            raise InputError(Problem(f"{what}: {', '.join(r.name for r in sure)}", str(path)))
        looks = None if path.is_dir() else looks_like(path)
        if looks is None:
            rest = [r for r in fitting if r.recognises is None and r.may_be(path)]
            for found in (rest, fitting if not path.is_dir() else []):
                if len(found) == 1:  # its problems say, line by line, what is wrong
                    return found[0]
        raise InputError(Problem(self._why_none(path, fitting, looks), str(path)))

    def suffix_readers(self, path: Path) -> list[Reader]:
        """Return the readers with the longest suffix that the name of a file has, or of folders."""
        if path.is_dir():
            return [r for r in self.entries if r.folders]
        end = "".join(path.suffixes).casefold()
        ends = [(len(s), r) for r in self.entries for s in r.suffixes if end.endswith(s)]
        longest = max((n for n, _ in ends), default=0)
        return [r for n, r in ends if n == longest]

    def _why_none(
        self, path: Path, fitting: Sequence[Reader], looks: tuple[str, str] | None
    ) -> str:
        """Return why no reader has a file or folder: what it looks like, and what to do.

        Args:
            path: file or folder.
            fitting: readers with its suffix.
            looks: what it looks like and what to do; None: it is of no known kind.
        """
        if path.is_dir():
            inside = self._inside(path)
            names = ", ".join(r.description for r in self.entries if r.folders)
            if missing := _tables_without_project(path):
                return missing
            valid = f"valid: {', '.join(inside)}" if inside else f"valid: a folder of {names}"
            return f"is a folder that no reader knows; {valid}"
        if outside := self._of_folder(path.parent):
            return f"is a part of {outside.description}: give its folder, {path.parent}"
        if looks is not None:
            return f"looks like {looks[0]}, which is not read: {looks[1]}"
        beside = ", ".join(self._beside(path))
        names = " or ".join(r.description for r in fitting)
        few = 0 < len(fitting) <= MAX_PROPOSED_PATHS
        kind = f"is not {names}" if few else "is of no known kind"
        return f"{kind}: {description(path)}" + (f"; beside it: {beside}" if beside else "")

    def _beside(self, path: Path) -> list[str]:
        """Return the files beside one that can be read, with their formats."""
        files = [p for p in sorted(path.parent.glob("*"))[:MAX_FOLDER_ENTRIES] if p.is_file()]
        sure = [(p, self._sure(p)) for p in files if p != path]
        other = [(p, self._alone(p)) for p, reader in sure if reader is None]
        found = [f"{p.name} ({r.description})" for p, r in (*sure, *other) if r is not None]
        return found[:MAX_PROPOSED_PATHS]

    def _alone(self, path: Path) -> Reader | None:
        """Return the reader of a suffix that no other reader has; None for other files."""
        fitting = self.suffix_readers(path)
        return fitting[0] if len(fitting) == 1 else None

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
        """Return folders, or else files, inside a folder that can be read, with their formats."""
        inner = [
            p for pattern in ("*", "*/*") for p in sorted(path.glob(pattern))[:MAX_FOLDER_ENTRIES]
        ]
        folders = [(p, self._of_folder(p)) for p in inner if p.is_dir()]
        found = [f"{p} ({reader.description})" for p, reader in folders if reader is not None]
        return (found or [f"{p} ({r.description})" for p in inner if (r := self._sure(p))])[
            :MAX_PROPOSED_PATHS
        ]

    def _sure(self, path: Path) -> Reader | None:
        """Return the only reader that recognises the content of a file; None for other files."""
        if not path.is_file():
            return None
        sure = self._recognising(path, self.entries)
        return sure[0] if len(sure) == 1 else None

    @staticmethod
    def _recognising(path: Path, asked: Iterable[Reader]) -> list[Reader]:
        """Return the readers that recognise the content of a file or folder."""
        return [r for r in asked if r.recognises is not None and r.recognises(path)]


def _readers_of_modules() -> Iterator[Reader]:
    """Yield every reader that a module of a room of formats states, in the order of the names."""
    for room in (field_books, gnss, photogrammetry, robotics, survey):
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
        InputError: the file does not exist, no reader knows it (the message says what it looks
            like), the reader has no such option, or the file has problems (all are listed).
    """
    return READERS.load(path, format=format, options=options).network_alone()


def _tables_without_project(folder: Path) -> str:
    """Return that a folder has tables of a project without its TOML file; empty if not so."""
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
