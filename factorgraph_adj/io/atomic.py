"""Write all files or none: an error or an interruption leaves the old files in place.

Several outputs of one run are one transaction (`one_transaction`): nothing is moved into place
before all of them are computed and stand beside their targets on the disk. Then one file, the mark,
says that they are to be moved, and it goes when all are in place. A process that is killed leaves
folders ``.writing-…``; the next one that writes into one of their folders finishes the moves where
the mark stands, in all folders of the transaction, and otherwise only removes what is left.
"""

from __future__ import annotations

import json
import os
import shutil
import socket
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from pathlib import Path

from ..errors import InputError, Problem, system_reason
from ..files import read_bytes, refuse_replacing

Files = Mapping[str, str | bytes | None]
"""Contents by file name; None removes the file."""
PREFIX = ".writing-"
"""Beginning of the names of folders for files that are not in place yet."""

_PENDING: ContextVar[list[tuple[Path, Files]] | None] = ContextVar("files to write", default=None)


def write_files(folder: str | Path, files: Files) -> None:
    """Write files into a folder; create the folder if it does not exist.

    All files are first written to a temporary folder inside the target and then moved into
    place. After an error the replaced files are restored; the moves of a process that was killed
    are finished by the next one. Within `one_transaction`
    this happens at its end, with the files of all folders.

    Args:
        folder: the target folder.
        files: text (UTF-8) or bytes by file name; None removes the file, for example one of an
            earlier run.

    Raises:
        InputError: the folder cannot be written to, or a file was read by this run
            (`factorgraph_adj.files.keeping_inputs`); no file has changed.
    """
    target = Path(folder)
    refuse_replacing(target / name for name in files)
    pending = _PENDING.get()
    if pending is None:
        _write([(target, files)])
    else:
        pending.append((target, files))


@contextmanager
def one_transaction() -> Iterator[None]:
    """Write the files of all folders together at the end, or none after an error.

    Raises:
        InputError: a folder cannot be written to; no file has changed.
    """
    pending: list[tuple[Path, Files]] = []
    token = _PENDING.set(pending)
    try:
        yield
    finally:
        _PENDING.reset(token)
    _write(pending)


LIST, FORWARD, BACK = ".moves.json", ".forward", ".back"
"""Files of a folder ``.writing-…``: what it holds, and the marks that its files are to be moved
into place, or to be restored."""
OLD = ".old"
"""Folder in it with links to the files that are replaced."""


@dataclass(frozen=True)
class _Beside:
    """A folder ``.writing-…`` with the new files of the folder around it."""

    path: Path
    """Where it is."""
    first: Path
    """Folder of the same transaction that has the mark."""
    all: tuple[Path, ...]
    """All folders of the transaction; known to the first one."""
    names: Mapping[str, bool]
    """Names of the files that change: whether there is a new one, or the old one is removed."""
    existed: tuple[str, ...]
    """Names of those that were there before."""

    def save(self) -> None:
        """Write the list of the folder."""
        content = {
            "first": str(self.first),
            "all": [str(p) for p in self.all],
            "names": dict(self.names),
            "existed": self.existed,
        }
        _write_synced(self.path / LIST, json.dumps(content).encode("utf-8"))

    def link_old(self) -> None:
        """Keep the files that are replaced or removed."""
        (self.path / OLD).mkdir()
        for name in self.existed:
            os.link(self.path.parent / name, self.path / OLD / name)

    def move(self) -> None:
        """Move the files into place, as far as they are not yet."""
        for name, new in self.names.items():
            if not new:
                (self.path.parent / name).unlink(missing_ok=True)
            elif (self.path / name).exists():
                os.replace(self.path / name, self.path.parent / name)

    def restore(self) -> None:
        """Put the old files back, as far as they are not yet."""
        for name in self.names:
            if name not in self.existed:
                (self.path.parent / name).unlink(missing_ok=True)
            elif (self.path / OLD / name).exists():
                os.replace(self.path / OLD / name, self.path.parent / name)


def _write(outputs: list[tuple[Path, Files]]) -> None:
    """Write the files of all folders beside their targets, and then move them into place."""
    made: list[Path] = []
    folder = Path()
    try:
        with ExitStack() as stack:
            paths: list[Path] = []
            for folder, _ in outputs:
                made += [p for p in (folder, *folder.parents) if not p.exists()]
                folder.mkdir(parents=True, exist_ok=True)
                _finish_stale(folder)
                prefix = f"{PREFIX}{socket.gethostname()}-{os.getpid()}-"
                temporary = tempfile.TemporaryDirectory(prefix=prefix, dir=folder.resolve())
                paths.append(Path(stack.enter_context(temporary)))
            beside = []
            for path, (folder, files) in zip(paths, outputs, strict=True):
                for name, content in files.items():
                    if content is not None:
                        data = content.encode("utf-8") if isinstance(content, str) else content
                        _write_synced(path / name, data)
                names = {name: content is not None for name, content in files.items()}
                existed = tuple(n for n in names if (folder / n).exists())
                every = tuple(paths) if path == paths[0] else ()
                beside.append(_Beside(path, paths[0], every, names, existed))
            _move(beside)
    except BaseException as error:
        for path in sorted(made, key=lambda p: -len(p.parts)):
            shutil.rmtree(path, ignore_errors=True)
        if isinstance(error, OSError):
            problem = Problem(
                f"cannot be written: {system_reason(error)}", str(error.filename or folder)
            )
            raise InputError(problem) from None
        raise


def _move(beside: Sequence[_Beside]) -> None:
    """Move all files into place; on any error restore the replaced files."""
    if not beside:
        return
    for each in beside:
        each.save()
        each.link_old()
        _sync_folder(each.path)
    forward, back = (beside[0].first / name for name in (FORWARD, BACK))
    try:
        _write_synced(forward, b"")
        _sync_folder(forward.parent)
        for each in beside:
            each.move()
            _sync_folder(each.path.parent)
    except BaseException:
        if forward.exists():
            os.replace(forward, back)
            for each in reversed(beside):
                each.restore()
            back.unlink()
        raise
    forward.unlink()


def _write_synced(path: Path, data: bytes) -> None:
    with path.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def _sync_folder(path: Path) -> None:
    """Bring the names of a folder to the disk, where the system can."""
    if not hasattr(os, "O_DIRECTORY"):
        return
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError:  # some file systems cannot
        pass
    finally:
        os.close(descriptor)


# -- what a killed process left -------------------------------------------------------------------


def _finish_stale(folder: Path) -> None:
    """Finish or remove what processes of this machine left that ended in a transaction."""
    for path in folder.resolve().glob(f"{PREFIX}*"):
        if not _is_stale(path):
            continue
        found = _listed(path)
        first = None if found is None else _listed(found.first)
        members = [] if first is None else [m for p in first.all if (m := _member(p, first.first))]
        if first is not None and (first.path / FORWARD).exists():
            for member in members:
                member.move()
        elif first is not None and (first.path / BACK).exists():
            for member in reversed(members):
                member.restore()
        if first is not None:
            for mark in (FORWARD, BACK):
                (first.path / mark).unlink(missing_ok=True)
        for member in reversed(members):
            shutil.rmtree(member.path, ignore_errors=True)
        shutil.rmtree(path, ignore_errors=True)


def _is_stale(path: Path) -> bool:
    """Return whether a folder is one that a process of this machine left that has ended."""
    own = f"{PREFIX}{socket.gethostname()}-"
    number = path.name.removeprefix(own).partition("-")[0]
    return path.name.startswith(own) and number.isdigit() and not _runs(int(number))


def _member(path: Path, first: Path) -> _Beside | None:
    """Return the list of a folder of a transaction; None if it does not say that it is one."""
    found = _listed(path)
    return found if found is not None and found.first == first else None


def _listed(path: Path) -> _Beside | None:
    """Return the list of a stale folder; None if there is none.

    A folder may come from anybody: its list can name files of the folder around it alone, and
    moves in other folders need a list in each of them that names the same first folder.
    """
    if not _is_stale(path) or path.is_symlink():
        return None
    try:
        given = json.loads(read_bytes(path / LIST))
        names = {str(name): bool(new) for name, new in given["names"].items()}
        existed = tuple(str(name) for name in given["existed"])
        if any(Path(name).name != name for name in (*names, *existed)):
            return None
        every = tuple(Path(p) for p in given["all"])
        return _Beside(path, Path(given["first"]), every, names, existed)
    except (InputError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        return True
    return True
