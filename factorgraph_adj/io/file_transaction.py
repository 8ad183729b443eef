"""A transaction of files: all are written, or none after an error or an interruption.

Several outputs of one run are one transaction (`one_transaction`): no file is moved into place
before all files are computed and written to folders beside their targets. Signals that would end
the process wait until all files are in place. After an error the old files are put back. Where that
fails too, an error says which files are new and which are old, and nothing is removed. The next
process that reads or writes in a folder puts back what such an error, or a process that was killed,
left unfinished (`factorgraph_adj.io.transaction_folders`).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from pathlib import Path

from ..errors import InputError, Problem, system_reason
from ..files import note_written, refuse_replacing
from .transaction_folders import (
    MOVE_MARK,
    FileChange,
    UnfinishedError,
    WritingFolder,
    content_digest,
    deferred_ending_signals,
    folders_in_use,
    move_error,
    new_path,
    recover_folder,
    remove_folders,
    restore_files,
    sync_folder,
    write_synced,
)

FileContents = Mapping[str, str | bytes | None]
"""Contents by file name; None removes the file."""
_PENDING_FILES: ContextVar[list[tuple[Path, FileContents]] | None] = ContextVar(
    "files to write", default=None
)


def write_files(folder: str | Path, files: FileContents) -> None:
    """Write files into a folder; create the folder if it does not exist.

    All files are first written to a temporary folder inside the target and then moved into
    place. After an error the old files are put back; those of a process that was killed are put
    back by the next one. Within `one_transaction` this happens at its end, with the files of all
    folders.

    Args:
        folder: the target folder.
        files: text (UTF-8) or bytes by file name; None removes the file, for example one of an
            earlier run.

    Raises:
        InputError: the folder cannot be written to, or a file was read by this run
            (`factorgraph_adj.files.keeping_inputs`); no file has changed.
        UnfinishedError: files that were in place already cannot be put back; it says which.
    """
    target = Path(folder)
    refuse_replacing(target / name for name in files)
    pending = _PENDING_FILES.get()
    if pending is None:
        _write([(target, files)])
    else:
        pending.append((target, files))


@contextmanager
def one_transaction() -> Iterator[None]:
    """Write the files of all folders together at the end, or none after an error.

    Raises:
        InputError: a folder cannot be written to, or two outputs that differ are one file; no file
            has changed.
        UnfinishedError: as `write_files`.
    """
    pending: list[tuple[Path, FileContents]] = []
    token = _PENDING_FILES.set(pending)
    try:
        yield
    finally:
        _PENDING_FILES.reset(token)
    _write(pending)


def _write(outputs: Sequence[tuple[Path, FileContents]]) -> None:
    """Write the files of all folders beside their targets, and then move them into place."""
    if not outputs:
        return
    made: list[Path] = []
    paths: list[Path] = []
    where = Path()
    with deferred_ending_signals():
        try:
            for where, _ in outputs:
                made += [p for p in (where, *where.parents) if not p.exists()]
                where.mkdir(parents=True, exist_ok=True)
                recover_folder(where)
            content = _by_folder(outputs)
            paths += map(new_path, content)
            with folders_in_use(paths):
                members = []
                for path, files in zip(paths, content.values(), strict=True):
                    where = path.parent
                    members.append(_new_folder(path, paths, files))
                for member in members:
                    member.save()
                    member.keep_old()
                _move(members)
                remove_folders(paths)
        except BaseException as error:
            left = [] if isinstance(error, UnfinishedError) else remove_folders(paths)
            for path in sorted(made, key=lambda p: -len(p.parts)):
                with suppress(OSError):
                    path.rmdir()
            if isinstance(error, OSError):
                why = f"cannot be written: {system_reason(error)}"
                problems = [Problem(why, _place_of_error(error, where))]
                what = "is left of it, and not needed: the next run that writes there removes it"
                raise InputError([*problems, *(Problem(what, str(p)) for p in left)]) from None
            raise


def _by_folder(
    outputs: Sequence[tuple[Path, FileContents]],
) -> dict[Path, dict[str, str | bytes | None]]:
    """Return the contents by folder and name.

    Raises:
        InputError: two outputs that differ are one file.
    """
    content: dict[Path, dict[str, str | bytes | None]] = {}
    problems = []
    for folder, files in outputs:
        there = content.setdefault(folder.resolve(), {})
        for name, new in files.items():
            if there.setdefault(name, new) != new:
                what = "is named for two outputs of this run: give each a name of its own"
                problems.append(Problem(what, str(folder / name)))
    if problems:
        raise InputError(problems)
    return content


def _new_folder(path: Path, paths: Sequence[Path], files: FileContents) -> WritingFolder:
    """Make the folder with the new files of the folder around it."""
    path.mkdir(mode=0o700)
    changes = []
    for name, content in files.items():
        new = None
        if content is not None:
            data = content.encode("utf-8") if isinstance(content, str) else content
            write_synced(path / name, data)
            new = content_digest(data)
        changes.append(FileChange(name, new, os.path.lexists(path.parent / name)))
    every = tuple(paths) if path == paths[0] else ()
    return WritingFolder(path, paths[0], every, tuple(changes))


def _move(members: Sequence[WritingFolder]) -> None:
    """Move all files into place; on any error put the old ones back.

    Raises:
        UnfinishedError: they cannot be put back.
    """
    mark = members[0].path / MOVE_MARK
    moved, late = False, None
    try:
        write_synced(mark, b"")
        sync_folder(mark.parent)
        for member in members:
            member.move()
        moved = True
        mark.unlink()
    except BaseException as error:
        if not moved or os.path.lexists(mark):
            if problems := restore_files(members):
                raise move_error(members, [_stop_problem(error, members), *problems]) from error
            raise
        late = None if isinstance(error, OSError) else error
    note_written(member.folder / c.name for member in members for c in member.changes)
    with suppress(OSError):
        sync_folder(mark.parent)
    if late is not None:
        raise late


def _place_of_error(error: OSError, where: Path) -> str:
    """Return the file that an error is about: the one that was to be replaced, if it names it."""
    return str(error.filename2 or error.filename or where)


def _stop_problem(error: BaseException, members: Sequence[WritingFolder]) -> Problem:
    """Return the problem that stopped the moves."""
    if isinstance(error, OSError):
        where = _place_of_error(error, members[0].folder)
        return Problem(f"cannot be written: {system_reason(error)}", where)
    return Problem(f"writing was stopped: {type(error).__name__}", str(members[0].folder))
