"""Files inside ZIP archives and folders, with limits on their size."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ...errors import InputError, Problem

MOST_BYTES = 4_000_000_000
"""Largest size of an unpacked file, bytes: a longer one is an archive made to fill the memory."""
MOST_GROWTH = 2_000
"""Largest ratio of the size of an unpacked file to that in the archive; zlib reaches 1032."""


@dataclass(frozen=True)
class Archive:
    """A ZIP archive."""

    path: Path
    """The file."""

    def where(self, member: str) -> str:
        """Return the name of a file inside, for messages."""
        return f"{self.path.name}/{member}"

    def names(self) -> list[str]:
        """Return the names of the files inside.

        Raises:
            InputError: the file is no ZIP archive.
        """
        try:
            with zipfile.ZipFile(self.path) as opened:
                return opened.namelist()
        except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            raise InputError(Problem(f"is no ZIP archive: {error}", str(self.path))) from None

    def read(self, member: str) -> bytes:
        """Return the content of a file inside.

        Raises:
            InputError: the file is no ZIP archive, has no such member, or the member is damaged.
        """
        where = self.where(member)
        try:
            with zipfile.ZipFile(self.path) as opened:
                size = opened.getinfo(member)
                if size.file_size > min(MOST_BYTES, MOST_GROWTH * max(size.compress_size, 1)):
                    raise InputError(Problem(f"unpacks to {size.file_size} bytes", where))
                return opened.read(member)
        except KeyError:
            raise InputError(Problem("the archive has no such file", where)) from None
        except (
            OSError,
            EOFError,
            ValueError,
            RuntimeError,
            NotImplementedError,
            OverflowError,
            zipfile.BadZipFile,
            zlib.error,
        ) as error:
            raise InputError(Problem(f"is damaged, cannot be unpacked: {error}", where)) from None


def inside(folder: Path, name: str, where: str) -> Path:
    """Return a path in a folder by a name that a file states.

    Raises:
        InputError: the name leads out of the folder.
    """
    pure = PurePosixPath(name.replace("\\", "/"))
    if not name or pure.is_absolute() or ".." in pure.parts or ":" in name or "\0" in name:
        raise InputError(Problem(f"path {name!r} must lead into the folder of the project", where))
    return folder / pure
