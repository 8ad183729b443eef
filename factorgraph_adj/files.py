"""Safe reading of files: paths, links, sizes, packed content; inputs protected from outputs.

Files may come from anybody. A file of a few kilobytes must not fill the memory, and a message
about it must not show lines of another file of the machine.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import IO, Any, Protocol
from zipfile import ZipFile

import numpy as np

from .errors import InputError, Problem, system_reason

MAX_FILE_BYTES = 4_000_000_000
"""Largest size of a file, or of one that is unpacked, bytes."""
MAX_GROWTH = 100
"""Largest ratio of the size of unpacked data to the size in the file; tables of numbers and XML
reach 30."""
FREE_GROWTH_BYTES = 4_000_000
"""Unpacked data of this size are read whatever the ratio, bytes."""
MAX_ELEMENTS = 10_000_000
"""Largest number of elements of an XML file, and of attributes; an element with three
attributes takes 300 bytes of memory."""
SPARE_ELEMENTS = 200_000
"""Elements, and attributes, that an XML file may have whatever its size."""
MIN_BYTES_OF_ELEMENT = 16
"""Least number of bytes of a file for each further element; those of surveys have 21 and more."""
MIN_BYTES_OF_ATTRIBUTE = 8
"""Least number of bytes of a file for each further attribute; those of surveys have 12 and more."""
PIECE_BYTES = 1 << 16
"""Size of the pieces in which a large file is read, bytes."""
MAX_TAG_BYTES = 1_000_000
"""Largest size of an XML tag with its attributes, bytes."""
MAX_DEPTH = 500
"""Largest number of elements around another one; files that people use have twenty."""
MAX_TOML_BYTES = 16_000_000
"""Largest size of a TOML file, bytes: it takes a second for each megabyte to read."""
MAX_KEY_PARTS = 64
"""Largest number of parts of a TOML key; projects have three."""
MAX_YAML_BYTES = 2_000_000
"""Largest size of a YAML file, bytes; a calibration has some kilobytes."""

OPTION = ", or allow such files (allow_outside=True, --allow-outside)"
"""What a message adds where paths may be allowed to lead outside."""

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


# -- paths ----------------------------------------------------------------------------------------
_NAMED: ContextVar[frozenset[Path]] = ContextVar("paths named by the user", default=frozenset())
_RUN: ContextVar[FilesOfRun | None] = ContextVar("files of the run", default=None)
_NO_WAITING = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)


def inside(folder: Path, name: str, where: str, *, allow_outside: bool | None = None) -> Path:
    r"""Return the path of a file that another file names.

    Every path in a file is resolved here: it leads into the folder of the file that states it, by
    its text and after symbolic links. Files from Windows have ``\`` between folders.

    Args:
        folder: folder of the file that states the path.
        name: the path as stated, relative to the folder.
        where: file and line of the statement, for messages.
        allow_outside: whether the path may lead out of the folder; None: nothing allows that.
            Through symbolic links it never may.

    Raises:
        InputError: the path is empty or has a zero byte, or leads out of the folder.
    """
    if why := astray(folder, name, allow_outside=allow_outside):
        raise InputError(Problem(f"path {name[:200]!r} {why}", where))
    return folder / name.replace("\\", "/")


def astray(folder: Path, name: str, *, allow_outside: bool | None = None) -> str:
    """Return why a path in a file must not be followed; empty if it may be. See `inside`."""
    if why := path_objection(name, allow_outside=allow_outside):
        return why
    try:
        here = folder / name.replace("\\", "/")
        if _outside(name):
            return linked_out(here)
        there = here.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # a loop of links, or a name that no system takes
        return "is none that can be followed"
    return "" if there else "leads out of the folder by a symbolic link: name the file itself"


def path_objection(name: str, *, allow_outside: bool | None = None) -> str:
    """Return why a path must not be followed that leads out by its text; empty if it does not."""
    if not name.strip() or "\0" in name:
        return "is none: it is empty, or has a zero byte"
    if allow_outside or not _outside(name):
        return ""
    return (
        "lies outside the folder of the project, or is named as if it did: move it there and give "
        "its name alone" + OPTION * (allow_outside is False)
    )


def _outside(name: str) -> bool:
    path = PurePosixPath(name.replace("\\", "/"))
    return path.is_absolute() or ".." in path.parts or bool(PureWindowsPath(name).drive)


def linked_out(path: Path) -> str:
    """Return why a file is not read that a symbolic link stands for; empty if it may be."""
    try:
        if (
            path in _NAMED.get()
            or not path.is_symlink()
            or path.resolve().is_relative_to(path.parent.resolve())
        ):
            return ""
    except (OSError, RuntimeError):
        pass
    return "is a symbolic link that leads out of its folder: put the file itself there"


@contextmanager
def named_by_user(*paths: object) -> Iterator[None]:
    """Follow symbolic links that the user names, as whoever names a link knows of it."""
    token = _NAMED.set(_NAMED.get() | {Path(p) for p in paths if isinstance(p, str | Path)})
    try:
        yield
    finally:
        _NAMED.reset(token)


# -- inputs that outputs must not replace ---------------------------------------------------------


@dataclass
class FilesOfRun:
    """Files that a run has read and written."""

    read: set[Path] = field(default_factory=set)
    """Files that were read, and journals that are open."""
    written: list[Path] = field(default_factory=list)
    """Files that are in place."""


@contextmanager
def keeping_inputs() -> Iterator[FilesOfRun]:
    """Note every file that is read, so that `refuse_replacing` keeps it from being written over."""
    run = FilesOfRun()
    token = _RUN.set(run)
    try:
        yield run
    finally:
        _RUN.reset(token)


def note_read(path: Path) -> None:
    """Note a file that is read, or that is open, within `keeping_inputs`."""
    if (run := _RUN.get()) is not None:
        run.read.add(path.resolve())


def note_written(paths: Iterable[Path]) -> None:
    """Note files that are in place within `keeping_inputs`."""
    if (run := _RUN.get()) is not None:
        run.written += paths


def refuse_replacing(paths: Iterable[Path]) -> None:
    """Raise the files that would be replaced though they were read, and those without a folder.

    Missing folders are made when files are written; a file in their place, or a folder without
    permission to write, is a problem that shows before a computation.

    Raises:
        InputError: files that were read within `keeping_inputs`, names with NUL, and folders that
            cannot be made, all of them.
    """
    run = _RUN.get()
    paths, read = list(paths), set() if run is None else run.read
    problems = [
        Problem("no file can have this name: it holds the character NUL", str(path))
        for path in paths
        if "\0" in str(path)
    ]
    if problems:
        raise InputError(problems)
    problems = [
        Problem("was read, and would be written over: write to another file or folder", str(path))
        for path in paths
        if path.exists() and path.resolve() in read
    ]
    folders = dict.fromkeys(path.parent for path in paths)
    problems += [Problem(why, str(f)) for f in folders if (why := folder_objection(f))]
    if problems:
        raise InputError(problems)


def folder_objection(folder: Path) -> str:
    """Return why no files can be written to a folder, which need not exist; empty: they can."""
    try:
        there = next(p for p in (folder, *folder.parents) if p.exists())
    except (OSError, StopIteration) as error:
        reason = system_reason(error) if isinstance(error, OSError) else "no such folder"
        return f"cannot be written: {reason}"
    if not there.is_dir():
        return f"cannot be written: {there} is a file, not a folder"
    if not os.access(there, os.W_OK | os.X_OK):
        return f"cannot be written: no permission to write in {there}"
    return ""


# -- contents -------------------------------------------------------------------------------------


class _Stream(Protocol):
    def read(self, size: int, /) -> bytes: ...


@contextmanager
def opened(path: Path, name: str = "") -> Iterator[IO[bytes]]:
    """Open a file to be read.

    Args:
        path: the file.
        name: its name in messages; default: the path.

    Raises:
        InputError: it cannot be read, is no regular file (a pipe or a device would be waited for,
            or never end), is a symbolic link that leads out of its folder, or is too large.
    """
    name = name or str(path)
    if why := linked_out(path):
        raise InputError(Problem(why, name))
    try:
        descriptor = os.open(path, os.O_RDONLY | _NO_WAITING)
    except (OSError, ValueError) as error:  # ValueError: the path has a zero byte
        raise InputError(_unread(error, name)) from None
    note_read(Path(path))
    try:
        status = os.fstat(descriptor)
        refuse_special(status, name)  # a folder cannot even become a stream
        refuse_growth(status.st_size, _stored(descriptor, status), name)
    except InputError:
        os.close(descriptor)
        raise
    with open(descriptor, "rb") as stream:
        yield stream


def refuse_special(status: os.stat_result, name: str) -> None:
    """Refuse what is no regular file: InputError says what it is."""
    for is_kind, kind in _KINDS:
        if is_kind(status.st_mode):
            raise InputError(Problem(f"cannot be read: it is {kind}, no file", name))


def _unread(error: Exception, name: str) -> Problem:
    return Problem(f"cannot be read: {system_reason(error)}", name)


def read_bytes(path: Path, name: str = "") -> bytes:
    """Return the content of a file; see `opened`."""
    with opened(path, name) as stream:
        try:
            return stream.read()
        except OSError as error:
            raise InputError(_unread(error, name or str(path))) from None


def read_pieces(path: Path, name: str = "") -> Iterator[bytes]:
    """Iterate over the pieces of a file; see `opened`."""
    with opened(path, name) as stream:
        try:
            while piece := stream.read(PIECE_BYTES):
                yield piece
        except OSError as error:
            raise InputError(_unread(error, name or str(path))) from None


def unpacked(stream: _Stream, stored: int, name: str) -> bytes:
    """Return what a packed stream holds, without more memory than its bounds.

    Args:
        stream: gives unpacked bytes.
        stored: size of the packed data, bytes.
        name: name of the file in messages.

    Raises:
        InputError: the data are larger than `refuse_growth` allows.
    """
    pieces, size = [], 0
    while piece := stream.read(1_000_000):
        size += len(piece)
        refuse_growth(size, stored, name, more=True)
        pieces.append(piece)
    return b"".join(pieces)


def read_arrays(path: Path) -> dict[str, Any]:
    """Return the arrays of a file .npz; none of them holds objects, which could run code.

    Raises:
        InputError: see `opened`; or the arrays are larger than `refuse_growth` allows.
    """
    with opened(path) as stream:
        with ZipFile(stream) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        refuse_growth(size, os.fstat(stream.fileno()).st_size, str(path))
        stream.seek(0)
        with np.load(stream, allow_pickle=False) as stored:
            return {name: stored[name] for name in stored.files}


def refuse_growth(size: int, stored: int, name: str, *, more: bool = False) -> None:
    """Refuse data that are larger than any file of a survey.

    Args:
        size: size of the data in memory, bytes.
        stored: size of the file that holds them, bytes.
        name: name of the file in messages.
        more: whether the data go on, and ``size`` is what has been unpacked of them.

    Raises:
        InputError: more than `MAX_FILE_BYTES`; or more than `FREE_GROWTH_BYTES` and than
            `MAX_GROWTH` times the stored size.
    """
    if size > MAX_FILE_BYTES or size > max(FREE_GROWTH_BYTES, MAX_GROWTH * stored):
        what = (
            f"unpacks to {size} bytes{' and more' if more else ''}, from {stored}; valid: at most "
            f"{MAX_GROWTH} times its size, and {MAX_FILE_BYTES} bytes"
        )
        raise InputError(Problem(what, name))


def _stored(descriptor: int, status: os.stat_result) -> int:
    """Return the size that a file has on the disk, bytes; less than its length if it has holes."""
    blocks = getattr(status, "st_blocks", None)
    if blocks is None or status.st_size <= FREE_GROWTH_BYTES:
        return status.st_size
    if blocks > 0:
        return min(512 * int(blocks), status.st_size)
    try:  # file systems that count no blocks have no holes either
        os.lseek(descriptor, os.lseek(descriptor, 0, os.SEEK_DATA), os.SEEK_SET)
    except OSError as error:
        if error.errno == errno.ENXIO:
            return 0
    os.lseek(descriptor, 0, os.SEEK_SET)
    return status.st_size
