"""Files inside ZIP archives, with limits on their size."""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import InputError, Problem
from ...files import opened, refuse_growth, unpacked


@dataclass(frozen=True)
class Archive:
    """A ZIP archive."""

    path: Path
    """The file."""
    _unpacked: dict[str, int] = field(default_factory=dict, compare=False, repr=False)
    """Sizes of the files inside that have been read, bytes."""

    def where(self, member: str) -> str:
        """Return the name of a file inside, for messages."""
        return f"{self.path.name}/{member}"

    def names(self) -> list[str]:
        """Return the names of the files inside.

        Raises:
            InputError: the file is no ZIP archive.
        """
        try:
            with opened(self.path) as stream, zipfile.ZipFile(stream) as archive:
                return archive.namelist()
        except (OSError, zipfile.BadZipFile, ValueError, NotImplementedError) as error:
            raise InputError(Problem(f"is no ZIP archive: {error}", str(self.path))) from None

    def read(self, member: str) -> bytes:
        """Return the content of a file inside.

        Raises:
            InputError: the file is no ZIP archive, has no such member, or the member is damaged;
                or it, or all members read so far, are larger than `refuse_growth` allows.
        """
        where = self.where(member)
        try:
            with opened(self.path) as stream, zipfile.ZipFile(stream) as archive:
                size = archive.getinfo(member)
                whole = self.path.stat().st_size
                stored = min(size.compress_size, whole)
                refuse_growth(size.file_size, stored, where)
                self._unpacked[member] = size.file_size  # many small files fill the memory too
                refuse_growth(sum(self._unpacked.values()), whole, self.path.name)
                with archive.open(member) as inner:
                    return unpacked(inner, stored, where)
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
