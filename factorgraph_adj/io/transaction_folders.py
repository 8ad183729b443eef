"""Folders ``.writing-…`` of a transaction: new and old files, restoration, recovery, signals.

Every folder in which a transaction (`factorgraph_adj.io.file_transaction`) replaces files has
one during the transaction. The first of them has a mark while files are moved. Whoever finds the
mark without its process puts the old files back (`recover_folder`). The mark is removed after all
moves, not before.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import signal
import socket
import stat
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from uuid import uuid4

from ..errors import InputError, Problem, system_reason
from ..files import read_bytes

ENDING_SIGNALS = tuple(
    getattr(signal, name)
    for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK")
    if hasattr(signal, name)
)
"""Signals that end a process which does not handle them."""
WRITING_PREFIX = ".writing-"
"""Beginning of the names of these folders."""
MAX_RESTORE_ATTEMPTS = 2
"""Number of times that the process which began a transaction tries to put old files back."""
LIST, MOVE_MARK, OLD_FILES = ".moves.json", ".moving", ".old"
"""What is in one: the list of its files, the mark that files are moved, and the old files."""
_FOLDERS_IN_USE: set[str] = set()
"""Names of the folders of this process that are in use."""
_NO_FOLLOWING = {"follow_symlinks": False} if os.link in os.supports_follow_symlinks else {}


@contextmanager
def deferred_ending_signals() -> Iterator[None]:
    """Let the signals of `ENDING_SIGNALS` take effect only at the end of the context.

    Signals that the program handles in its own way, or ignores, are left to it; so are all of
    them in threads, to which Python hands no signals. After an error SIGINT has no further
    effect: the error ends what was to be interrupted.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []

    def hold(number: int, frame: FrameType | None) -> None:
        came.append(number)

    before = {}
    failed = True
    try:
        for number in ENDING_SIGNALS:
            handler = signal.getsignal(number)
            if handler in (signal.SIG_DFL, signal.default_int_handler):
                before[number] = handler
                signal.signal(number, hold)
        yield
        failed = False
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in dict.fromkeys(came):
            if not (failed and number == signal.SIGINT):
                signal.raise_signal(number)


if sys.platform != "win32":
    import fcntl


class UnfinishedError(InputError):
    """Files could not be put back: some are new and some are old."""


@dataclass(frozen=True)
class FileChange:
    """Change of one file."""

    name: str
    """Its name."""
    new: str | None
    """SHA-256 of the new content; None: the file is removed."""
    existed: bool
    """Whether there is an old one."""


@dataclass(frozen=True)
class WritingFolder:
    """A folder ``.writing-…`` with the new files of the folder around it."""

    path: Path
    """Where it is."""
    first: Path
    """Folder of the same transaction that has the mark."""
    all: tuple[Path, ...]
    """All folders of the transaction; known to the first one."""
    changes: tuple[FileChange, ...]
    """Changes of the files."""

    @property
    def folder(self) -> Path:
        """The folder around it."""
        return self.path.parent

    def save(self) -> None:
        """Write the list of the folder."""
        content = {
            "first": str(self.first),
            "all": [str(p) for p in self.all],
            "changes": [asdict(c) for c in self.changes],
        }
        write_synced(self.path / LIST, json.dumps(content).encode("utf-8"))

    def keep_old(self) -> None:
        """Keep the files that are replaced or removed."""
        old = self.path / OLD_FILES
        os.mkdir(old)
        for change in self.changes:
            if change.existed:
                _keep_old_file(self.folder / change.name, old / change.name)
        for path in (old, self.path, self.folder):
            sync_folder(path)

    def move(self) -> None:
        """Move the new files into place."""
        for change in self.changes:
            if change.new is None:
                (self.folder / change.name).unlink(missing_ok=True)
            else:
                os.replace(self.path / change.name, self.folder / change.name)
        sync_folder(self.folder)

    def restore(self) -> list[Problem]:
        """Put the old files back, as far as they are not yet; return what could not be."""
        problems = []
        for change in self.changes:
            try:
                why = self._restore(change)
            except OSError as error:
                why = f"cannot be put back: {system_reason(error)}"
            if why:
                problems.append(Problem(why, str(self.folder / change.name)))
        if not problems:
            sync_folder(self.folder)
        return problems

    def _restore(self, change: FileChange) -> str:
        """Put one file back; return why another file in its place forbids that."""
        place, old = self.folder / change.name, self.path / OLD_FILES / change.name
        if not self._is_changed(change):
            return ""
        if change.existed:
            if _digest_of_file(place) not in (None, change.new, _digest_of_file(old)):
                return "was changed by somebody else after writing had stopped, and is not replaced"
            os.replace(old, place)
        elif _digest_of_file(place) == change.new:
            place.unlink()
        return ""

    def _is_changed(self, change: FileChange) -> bool:
        """Return whether the new state of a file is in place, and the old one not back."""
        there = os.path.lexists(self.folder / change.name)
        kept = os.path.lexists(self.path / OLD_FILES / change.name)
        if change.new is None:
            return kept and not there
        moved = not os.path.lexists(self.path / change.name)
        return moved and (kept if change.existed else there)

    def state(self) -> Problem:
        """Say which files are new and which are old, and where the old copies are."""
        names: dict[str, list[str]] = {}
        copies = f"whose old copies are in {self.path / OLD_FILES}"
        for change in self.changes:
            if not self._is_changed(change):
                where = "as before"
            elif change.new is None:
                where = f"removed, {copies}"
            else:
                where = f"new, {copies}" if change.existed else "new, without an old one"
            names.setdefault(where, []).append(change.name)
        said = "; ".join(f"{', '.join(n)}: {where}" for where, n in names.items())
        return Problem(said, str(self.folder))


def new_path(folder: Path) -> Path:
    """Return a path for a folder of this process in another one."""
    unique = f"{socket.gethostname()}-{os.getpid()}-{uuid4().hex[:12]}"
    return folder.resolve() / f"{WRITING_PREFIX}{unique}"


@contextmanager
def folders_in_use(paths: Sequence[Path]) -> Iterator[None]:
    """Keep `recover_folder` from folders of this process."""
    names = {p.name for p in paths}
    _FOLDERS_IN_USE.update(names)
    try:
        yield
    finally:
        _FOLDERS_IN_USE.difference_update(names)


def restore_files(members: Sequence[WritingFolder]) -> list[Problem]:
    """Put all old files back, and remove the mark; return what could not be done.

    It tries again after an error and after an interruption, which has no other effect.

    Args:
        members: all folders of the transaction; the first one has the mark.
    """
    problems: list[Problem] = []
    for _ in range(MAX_RESTORE_ATTEMPTS):
        try:
            problems = [p for member in reversed(members) for p in member.restore()]
            if not problems:
                (members[0].path / MOVE_MARK).unlink(missing_ok=True)
                sync_folder(members[0].path)
                break
        except OSError as error:
            why = f"cannot be finished: {system_reason(error)}"
            problems = [Problem(why, str(error.filename or members[0].path))]
        except BaseException as error:
            problems = [Problem(f"putting back was stopped: {type(error).__name__}")]
    return problems


def move_error(members: Sequence[WritingFolder], problems: Sequence[Problem]) -> UnfinishedError:
    """Return the error that says which files are new, which old, and what to do.

    Args:
        members: all folders of the transaction.
        problems: why files could not be put back.
    """
    advice = (
        "some of these files may be new and some old. The next command on the computer that wrote "
        "them which reads or writes in one of the folders puts the old files back, when what "
        "hinders it is mended; or put the copies back yourself, and then remove the folders "
        f"{WRITING_PREFIX}… there. Nothing has been removed"
    )
    return UnfinishedError([*problems, *(m.state() for m in members), Problem(advice)])


def remove_folders(paths: Sequence[Path]) -> list[Path]:
    """Remove folders that are not needed any more, the first one last; return what is left."""
    for path in (*paths[1:], *paths[:1]):
        if path == paths[0] and any(map(os.path.lexists, paths[1:])):
            break  # the others say that they belong to it
        shutil.rmtree(path, ignore_errors=True)
    return [p for p in paths if os.path.lexists(p)]


# -- what an ended process left -------------------------------------------------------------------


def recover_folder(folder: str | Path) -> None:
    """Put back, in a folder, what ended processes of this computer left half-way.

    What they left in other folders in the same transaction is put back with it. A folder that does
    not exist, or cannot be listed, holds nothing.

    Raises:
        UnfinishedError: files cannot be put back, or another computer moves files there and may
            have been stopped; it says which are new and which old, and where the old copies are.
    """
    try:
        with os.scandir(folder) as entries:
            names = [e.name for e in entries if e.name.startswith(WRITING_PREFIX)]
    except (OSError, ValueError):  # ValueError: the path has a zero byte
        return
    with deferred_ending_signals() if names else nullcontext():
        for name in names:
            path = Path(folder).resolve() / name
            if _is_stale(path):
                _recover_transaction(path)
            else:
                _refuse_moves_of_other_computer(path)


def _recover_transaction(path: Path) -> None:
    """Put back what a stale folder and all others of its transaction have, and remove them."""
    found = _stale_list(path)
    if found is None:
        if os.path.lexists(path / MOVE_MARK) and os.path.lexists(path):
            what = (
                "is left of writing that was stopped, and has no list of its files that can be "
                "followed: look for files there that are needed, and then remove this folder"
            )
            raise UnfinishedError(Problem(what, str(path)))
        shutil.rmtree(path, ignore_errors=True)
        return
    # The name is unique: the folder around it may have been renamed.
    first = found if found.first.name == path.name else _stale_list(found.first)
    if first is None:
        if not os.path.lexists(path):
            return  # another process has just removed it
        why = f"files were written together with some in {found.first.parent}, which have gone"
        raise move_error([found], [Problem(why, str(found.folder))])
    members = [first, *(m for p in first.all if (m := _other_folder(p, first)) is not None)]
    with _recovery_lock(first.path / MOVE_MARK) as marked:
        if marked and (problems := restore_files(members)):
            raise move_error(members, problems)
    remove_folders([m.path for m in members])


def _refuse_moves_of_other_computer(path: Path) -> None:
    """Refuse a folder of another computer, whose processes cannot be asked for from here."""
    host, process = _owner(path)
    if host in ("", socket.gethostname()) or (found := _folder_list(path)) is None:
        return
    if os.path.lexists(found.first / MOVE_MARK) or os.path.lexists(path / MOVE_MARK):
        why = f"process {process} of the computer {host!r} is writing here, or was stopped"
        raise move_error([found], [Problem(why, str(found.folder))])


@contextmanager
def _recovery_lock(mark: Path) -> Iterator[bool]:
    """Keep other processes that recover out, where the system can; yield whether there is work."""
    try:
        descriptor = os.open(mark, os.O_RDONLY)
    except FileNotFoundError:
        yield False
        return
    except OSError:
        yield True
        return
    try:
        if sys.platform != "win32":
            with suppress(OSError):  # a file system without locks
                fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield os.path.lexists(mark)
    finally:
        os.close(descriptor)


def _is_stale(path: Path) -> bool:
    """Return whether a folder is one that a process of this machine left that has ended."""
    host, process = _owner(path)
    if host != socket.gethostname() or not process.isdecimal():
        return False
    if int(process) == os.getpid():
        return path.name not in _FOLDERS_IN_USE
    return not _process_runs(int(process))


def _owner(path: Path) -> tuple[str, str]:
    """Return the computer and the number of the process that made a folder, see `new_path`."""
    if not path.name.startswith(WRITING_PREFIX):
        return "", ""
    host, _, process = path.name.removeprefix(WRITING_PREFIX).rpartition("-")[0].rpartition("-")
    return host, process


def _other_folder(path: Path, first: WritingFolder) -> WritingFolder | None:
    """Return another folder of a transaction; None: it is the first one, or it was removed.

    Raises:
        UnfinishedError: it does not say that it belongs to the transaction.
    """
    if path.name == first.path.name or not os.path.lexists(path):
        return None
    found = _stale_list(path)
    if found is not None and found.first == first.first:
        return found
    if not os.path.lexists(first.path / MOVE_MARK):
        return None
    what = f"is named in {first.path / LIST}, and does not belong to it: look there, and remove it"
    raise UnfinishedError(Problem(what, str(path)))


def _stale_list(path: Path) -> WritingFolder | None:
    """Return the list of a stale folder; None if there is none.

    A folder may come from anybody: its list can name files of the folder around it alone, and
    files in other folders need a list in each of them that names the same first folder.

    Raises:
        UnfinishedError: there is a list, but it cannot be read.
    """
    return _folder_list(path) if _is_stale(path) else None


def _folder_list(path: Path) -> WritingFolder | None:
    """Return the list of a folder; None if none can be followed. See `_stale_list`."""
    if path.is_symlink() or (path / OLD_FILES).is_symlink():
        return None
    try:
        given = json.loads(read_bytes(path / LIST))
        changes = tuple(_change_of_row(each) for each in given["changes"])
        every = tuple(Path(p) for p in given["all"])
        return WritingFolder(path, Path(given["first"]), every, changes)
    except InputError as error:
        if os.path.lexists(path / LIST):
            what = (
                "it lists files that may be new and old, as writing was stopped; nothing has been "
                f"removed, and old copies are in {path / OLD_FILES}"
            )
            raise UnfinishedError([*error.problems, Problem(what, str(path / LIST))]) from None
        return None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None  # a list is on the disk before any file is moved: this one was being written


def _change_of_row(given: Mapping[str, object]) -> FileChange:
    """Return a row of a list; ValueError if it names a file elsewhere."""
    name, new = str(given["name"]), given["new"]
    if Path(name).name != name or name in ("", "..") or "\0" in name:
        raise ValueError(name)
    return FileChange(name, None if new is None else str(new), bool(given["existed"]))


def _process_runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:  # of another user
        return True
    return True


# -- files ----------------------------------------------------------------------------------------


def write_synced(path: Path, data: bytes) -> None:
    """Write a file, and wait until it is on the disk."""
    with path.open("wb") as stream:
        stream.write(data)
        stream.flush()
        os.fsync(stream.fileno())


def sync_folder(path: Path) -> None:
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


def content_digest(data: bytes) -> str:
    """Return the SHA-256 of the content of a file."""
    return hashlib.sha256(data).hexdigest()


def _keep_old_file(place: Path, copy: Path) -> None:
    """Keep an old file: by a link, or by a copy where links are not possible.

    Raises:
        OSError: it is a folder, or cannot be copied.
    """
    mode = os.lstat(place).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(place))
    try:
        os.link(place, copy, **_NO_FOLLOWING)
    except (OSError, NotImplementedError):  # a file system without links, a file of another user
        if stat.S_ISLNK(mode):
            os.symlink(os.readlink(place), copy)
        elif stat.S_ISREG(mode):
            write_synced(copy, place.read_bytes())
            shutil.copystat(place, copy)
        else:
            raise


def _digest_of_file(path: Path) -> str | None:
    """Return the SHA-256 of a file, or where a link leads; None: there is nothing."""
    try:
        status = os.lstat(path)
    except FileNotFoundError:
        return None
    if stat.S_ISLNK(status.st_mode):
        return f"link to {os.readlink(path)}"
    if not stat.S_ISREG(status.st_mode):
        return "no file"
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
