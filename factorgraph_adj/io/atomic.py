"""Write all files or none: an error or an interruption leaves the old files in place.

Several outputs of one run are one transaction (`one_transaction`): nothing is moved into place
before all of them are computed and stand beside their targets on the disk. A process that is killed
leaves a folder ``.writing-…`` at most, which the next one that writes there removes.
"""

from __future__ import annotations

import os
import shutil
import socket
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from contextvars import ContextVar
from pathlib import Path

from ..errors import InputError, Problem, system_reason
from ..files import refuse_replacing

Files = Mapping[str, str | bytes | None]
"""Contents by file name; None removes the file."""
PREFIX = ".writing-"
"""Beginning of the names of folders for files that are not in place yet."""

_PENDING: ContextVar[list[tuple[Path, Files]] | None] = ContextVar("files to write", default=None)


def write_files(folder: str | Path, files: Files) -> None:
    """Write files into a folder; create the folder if it does not exist.

    All files are first written to a temporary folder inside the target and then moved into
    place. If the move is interrupted, the replaced files are restored. Within `one_transaction`
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


def _write(outputs: list[tuple[Path, Files]]) -> None:
    """Write the files of all folders beside their targets, and then move them into place."""
    made: list[Path] = []
    folder = Path()
    try:
        with ExitStack() as stack:
            moves: list[tuple[Path, Path, str]] = []
            for folder, files in outputs:
                made += [p for p in (folder, *folder.parents) if not p.exists()]
                folder.mkdir(parents=True, exist_ok=True)
                _remove_stale(folder)
                prefix = f"{PREFIX}{socket.gethostname()}-{os.getpid()}-"
                name = stack.enter_context(tempfile.TemporaryDirectory(prefix=prefix, dir=folder))
                for file, content in files.items():
                    moves.append((Path(name), folder, file))
                    if content is None:
                        continue
                    with (Path(name) / file).open("wb") as stream:
                        data = content.encode("utf-8") if isinstance(content, str) else content
                        stream.write(data)
                        stream.flush()
                        os.fsync(stream.fileno())
            _move(moves)
    except BaseException as error:
        for path in sorted(made, key=lambda p: -len(p.parts)):
            shutil.rmtree(path, ignore_errors=True)
        if isinstance(error, OSError):
            problem = Problem(
                f"cannot be written: {system_reason(error)}", str(error.filename or folder)
            )
            raise InputError(problem) from None
        raise


def _remove_stale(folder: Path) -> None:
    """Remove what processes of this machine left that ended before their files were in place."""
    own = f"{PREFIX}{socket.gethostname()}-"
    for path in folder.glob(f"{PREFIX}*"):
        number = path.name.removeprefix(own).partition("-")[0]
        if path.name.startswith(own) and number.isdigit() and not _runs(int(number)):
            shutil.rmtree(path, ignore_errors=True)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        return True
    return True


def _move(moves: list[tuple[Path, Path, str]]) -> None:
    """Move files (from, to, name) into place; on any error restore the replaced files."""
    done: list[tuple[Path, Path, str]] = []
    try:
        for move in moves:
            source, target, name = move
            old = source / "old"
            old.mkdir(exist_ok=True)
            done.append(move)
            if (target / name).exists():
                os.link(target / name, old / name)
            if (source / name).exists():
                os.replace(source / name, target / name)
            else:
                (target / name).unlink(missing_ok=True)
    except BaseException:
        for source, target, name in done:
            if (source / "old" / name).exists():
                os.replace(source / "old" / name, target / name)
            elif not (source / name).exists():
                (target / name).unlink(missing_ok=True)
        raise
