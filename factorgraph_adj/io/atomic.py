"""Write all files or none: an error or an interruption leaves the old files in place."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from ..errors import InputError, Problem


def write_files(folder: str | Path, files: Mapping[str, str | bytes | None]) -> None:
    """Write files into a folder; create the folder if it does not exist.

    All files are first written to a temporary folder inside the target and then moved into
    place. If the move is interrupted, the replaced files are restored.

    Args:
        folder: the target folder.
        files: text (UTF-8) or bytes by file name; None removes the file, for example one of an
            earlier run.

    Raises:
        InputError: the folder cannot be written to; no file has changed.
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
    except (OSError, ValueError) as error:  # ValueError: a path has a zero byte
        why = getattr(error, "strerror", None) or error
        place = getattr(error, "filename", None) or target
        problem = Problem(f"cannot be written: {why}", str(place))
        raise InputError(problem) from None


def _move(source: Path, target: Path, names: list[str]) -> None:
    """Move files into place; on any error restore the replaced files."""
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
