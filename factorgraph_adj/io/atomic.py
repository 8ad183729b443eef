"""Files written all or not at all: an error or an interruption leaves what was there before."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from ..errors import InputError, Problem


def write_files(folder: str | Path, files: Mapping[str, str | bytes | None]) -> None:
    """Write files into a folder, made if it is not there.

    Everything is written to a temporary folder beside first and then moved into place. If
    that is interrupted half-way, the files moved so far are put back.

    Args:
        folder: where to.
        files: text (UTF-8) or bytes, by name; none: a file that is not to be there, as from an
            earlier run.

    Raises:
        InputError: the folder cannot be written to; nothing has changed.
    """
    target = Path(folder)
    try:
        existed = target.exists()
        target.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=".writing-", dir=target) as name:
            beside = Path(name)
            try:
                for file, content in files.items():
                    if content is None:
                        continue
                    with (beside / file).open("wb") as stream:
                        data = content.encode("utf-8") if isinstance(content, str) else content
                        stream.write(data)
                        stream.flush()
                        os.fsync(stream.fileno())
                _move(beside, target, list(files))
            except BaseException:
                if not existed:
                    shutil.rmtree(target, ignore_errors=True)
                raise
    except OSError as error:
        problem = Problem(f"cannot be written: {error.strerror}", str(error.filename or target))
        raise InputError(problem) from None


def _move(source: Path, target: Path, names: list[str]) -> None:
    """Move files into place; on any error put those that were replaced back."""
    old = source / "old"
    old.mkdir()
    done: list[str] = []
    try:
        for name in names:
            done.append(name)
            if (target / name).exists():
                os.link(target / name, old / name)
            if (source / name).exists():
                os.replace(source / name, target / name)
            else:
                (target / name).unlink(missing_ok=True)
    except BaseException:
        for name in done:
            if (old / name).exists():
                os.replace(old / name, target / name)
            elif not (source / name).exists():
                (target / name).unlink(missing_ok=True)
        raise
