"""Journal file: JSON lines in a chain of digests, appended under a lock; torn last line left out.

`factorgraph_adj.io.journal_lines` has the format of the lines. A line counts as recorded when all
of it is in the file. Whatever stops the process, the file holds whole lines and at most one torn
line at its end, which is found and left out on opening. Lines that are missing at the end break
nothing: the journal is then that of an earlier moment. While a journal is open, its file is
examined before every entry.
"""

from __future__ import annotations

import os
import sys
import weakref
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, NoReturn

from ..errors import InputError, Problem, system_reason
from ..files import note_read, refuse_replacing, refuse_special
from .journal_lines import (
    INITIAL_LINK,
    JOURNAL_VERSION,
    ChainLink,
    JournalStore,
    journal_line,
    whole_lines,
)

if sys.platform != "win32":
    import fcntl


class Journal:
    """An open journal, to which only this process appends.

    Opened by `create` or `open`; closed by `close`, at the end of a ``with``, or when it is no
    longer in use.
    """

    def __init__(
        self, path: Path, descriptor: int, *, durable: bool, last: ChainLink | None = None
    ) -> None:
        """Take over an open, locked file whose lines are all whole, with the link of the last."""
        self.path = path
        """The file."""
        self.durable = durable
        """Whether an entry is on the disk, not only with the operating system, once appended."""
        self._descriptor = descriptor
        self._last = last or INITIAL_LINK
        self._size = os.fstat(descriptor).st_size
        self._unusable = ""
        self._close = weakref.finalize(self, os.close, descriptor)

    # -- opening ------------------------------------------------------------------------------

    @classmethod
    def create(
        cls, path: str | Path, header: Mapping[str, object], *, durable: bool = True
    ) -> Journal:
        """Start a journal.

        Args:
            path: the file; it must not exist or be empty.
            header: what the first line holds beside ``journal``.
            durable: wait with every entry until it is on the disk; otherwise a crash of the
                process loses nothing, but one of the computer may.

        Raises:
            InputError: the file holds something or is in use, or cannot be written; the header
                cannot be written as JSON. What was there is left as it was.
        """
        path = Path(path)
        refuse_replacing([path])
        line, link = journal_line({"journal": JOURNAL_VERSION, **header}, str(path), INITIAL_LINK)
        existed = path.exists()
        descriptor = _open(path, os.O_CREAT)
        journal = None
        try:
            _lock(descriptor, path)
            if os.fstat(descriptor).st_size > 0:
                what = "holds something already: resume this journal, or choose another name"
                raise InputError(Problem(what, str(path)))
            journal = cls(path, descriptor, durable=durable)
            journal._write(line)
            journal._last = link
            if durable:
                _sync_folder(path.parent)
        except BaseException as error:
            if journal is None:
                os.close(descriptor)
            else:
                with suppress(OSError):
                    os.ftruncate(descriptor, 0)
                    if not existed:
                        path.unlink()
                journal.close()
            _explain(error, path)
        return journal

    @classmethod
    def open(
        cls, path: str | Path, *, durable: bool = True
    ) -> tuple[Journal, dict[str, Any], list[dict[str, Any]], str]:
        """Open a journal to continue it.

        A last line that is not an object of JSON was torn when the process was stopped; it is
        cut off, so that the next entry starts on a line of its own. A last line that is one
        and lacks only the end of the line is whole, as no beginning of an object is an object
        itself; it is kept and gets its end.

        Args:
            path: the file.
            durable: as for `create`.

        Returns:
            The journal, its header, its entries, and what was torn: number and beginning of
            the line; empty where nothing was.

        Raises:
            InputError: no such file, empty, not a journal, of another version, in use; nothing
                but a torn header; lines before the last one that cannot be read, and lines that
                do not follow from those before them, all of them. The file is left as it was.
        """
        path = Path(path)
        descriptor = _open(path)
        journal = None
        try:
            _lock(descriptor, path)
            with os.fdopen(descriptor, "rb", closefd=False) as stream:
                data = stream.read()
            lines, torn, keep, last = whole_lines(data, str(path))
            if keep < len(data):
                os.ftruncate(descriptor, keep)
            journal = cls(path, descriptor, durable=durable, last=last)
            if not data[:keep].endswith(b"\n"):
                journal._write(b"\n")
            elif keep < len(data) and durable:
                os.fsync(descriptor)
        except BaseException as error:
            if journal is None:
                os.close(descriptor)
            else:
                journal.close()
            _explain(error, path)
        return journal, lines[0], lines[1:], torn

    @property
    def where(self) -> str:
        """The file, for messages."""
        return str(self.path)

    @property
    def folder(self) -> Path:
        """Folder of the file."""
        return self.path.parent

    # -- use ----------------------------------------------------------------------------------

    def append(self, entry: Mapping[str, object]) -> None:
        """Record an entry: one line, in the file when this returns.

        Raises:
            InputError: the entry cannot be written as JSON; the file cannot be written, was
                deleted, replaced or changed by another process; or the journal is closed.
                Nothing was recorded then.
        """
        line, link = journal_line(entry, str(self.path), self._last)
        self._refuse_other_file()
        self._write(line)
        self._last = link

    def close(self) -> None:
        """Close the file, and so unlock it; closing again does nothing."""
        self._close()

    def __enter__(self) -> Journal:
        """Return the journal, to be closed at the end of the ``with``."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Close the file."""
        self.close()

    def _refuse_other_file(self) -> None:
        """Refuse to continue where the file under our name is not the one that we wrote."""
        if not self._close.alive or self._unusable:
            return  # writing says so
        what = ""
        try:
            own, named = os.fstat(self._descriptor), os.stat(self.path)
        except FileNotFoundError:
            what = "was deleted or renamed"
        except OSError as error:
            what = f"cannot be looked at any more ({system_reason(error)})"
        else:
            if not os.path.samestat(own, named):
                what = "was replaced by another file"
            elif own.st_size < self._size:
                what = f"was truncated from {self._size} to {own.st_size} bytes"
            elif own.st_size > self._size or not self._ends_as_written():
                what = "was changed by somebody else"
        if what:
            what += (
                " since the last entry; nothing was recorded. What is in memory is not in the "
                "file: save it elsewhere (network(), `write` of the stream), and begin a new "
                "journal with that"
            )
            raise InputError(Problem(what, str(self.path)))

    def _ends_as_written(self) -> bool:
        """Return whether the file ends with the link of the last line."""
        end = self._last.end() + b"\n"
        os.lseek(self._descriptor, self._size - len(end), os.SEEK_SET)  # appending needs no place
        return os.read(self._descriptor, len(end)) == end

    def _write(self, line: bytes) -> None:
        """Append bytes, all or none of them."""
        if not self._close.alive:
            raise InputError(Problem("the journal is closed", str(self.path)))
        if self._unusable:
            raise InputError(Problem(self._unusable, str(self.path)))
        try:
            done = os.write(self._descriptor, line)
            while done < len(line):  # a disk that is nearly full takes a part
                done += os.write(self._descriptor, line[done:])
            if self.durable:
                os.fsync(self._descriptor)
        except BaseException as error:
            # An interruption counts as well: the caller takes the entry for not recorded.
            self._take_back()
            if isinstance(error, OSError):
                what = f"cannot be written: {system_reason(error)}; nothing was recorded"
                raise InputError(Problem(what, str(self.path))) from None
            raise
        self._size += len(line)

    def _take_back(self) -> None:
        """Cut off what an append that failed has left."""
        try:
            os.ftruncate(self._descriptor, self._size)
        except OSError as error:
            why = system_reason(error)
            self._unusable = f"a torn line could not be cut off ({why}): resume from this journal"


# -- files ----------------------------------------------------------------------------------------


def _explain(error: BaseException, path: Path) -> NoReturn:
    """Raise an error of the operating system as one for people, others as they are."""
    if isinstance(error, OSError):
        problem = Problem(f"cannot be used as a journal: {system_reason(error)}", str(path))
        raise InputError(problem) from None
    raise error


def _open(path: Path, flags: int = 0) -> int:
    try:
        flags |= os.O_RDWR | os.O_APPEND | getattr(os, "O_BINARY", 0)
        descriptor = os.open(path, flags, 0o666)
    except (OSError, ValueError) as error:  # ValueError: the path has a zero byte
        what = f"cannot be opened: {system_reason(error)}"
        raise InputError(Problem(what, str(path))) from None
    try:
        refuse_special(os.fstat(descriptor), str(path))
    except InputError:
        os.close(descriptor)
        raise
    note_read(path)
    return descriptor


def _lock(descriptor: int, path: Path) -> None:
    """Keep other processes out, where the system and the file system can do that."""
    if sys.platform == "win32":
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        what = "is in use already: two cannot record in one journal"
        raise InputError(Problem(what, str(path))) from None
    except OSError:
        return  # a file system without locks


def _sync_folder(folder: Path) -> None:
    """Bring the name of a new file to the disk, where the system has that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


# -- any store -------------------------------------------------------------------------------------


def begun_journal(
    at: str | Path | JournalStore, header: Mapping[str, object]
) -> Journal | JournalStore:
    """Return a new journal in a file or in another store.

    A file may lose its last entries when the computer, not only the process, ends.

    Raises:
        InputError: as `Journal.create`, or the store cannot be written.
    """
    if isinstance(at, str | os.PathLike):
        return Journal.create(at, header, durable=False)
    at.begin(header)
    return at


def opened_journal(
    at: str | Path | JournalStore,
) -> tuple[Journal | JournalStore, dict[str, Any], list[dict[str, Any]], str]:
    """Return a journal to be continued, with its header, its entries, and what was torn.

    Raises:
        InputError: as `Journal.open`, or the store cannot be read.
    """
    if isinstance(at, str | os.PathLike):
        return Journal.open(at, durable=False)
    return at, *at.read()
