"""Example of a format: undamaged files, and what of them the format declares as not read.

A module of tests that has such files states them as ``EXAMPLE_FILES``, by a name for the case; the
test of a reader is one. `tests.hostile.formats` finds them.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import factorgraph_adj as fga

Files = dict[str, bytes]
Contents = Mapping[str, str] | Mapping[str, bytes]
"""Contents of files by name."""
OF_ALL = (r"\|<\?xml", r"\|name\|xmlns\|", r"\|value\|http")
"""The declaration of XML and the names of name spaces, which no format reads."""


@dataclass(frozen=True)
class Example:
    """Files of one format.

    A change of them is ``file|way|word|row``: its way, the word that was replaced or added, and the
    row before the change, see `tests.hostile.silence`.
    """

    reader: str
    """Name of the reader in the table of formats."""
    contents: Contents | Callable[[Path], Contents]
    """Contents by name, or a function that makes them in an empty folder."""
    begin: str = ""
    """File with which the reader begins; empty: the folder."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the reader."""
    beside: Mapping[str, str] = field(default_factory=dict)
    """Options that name another file, and its name."""
    unread: tuple[str, ...] = ()
    """Patterns of changes without an effect, such as comments: what docstring and formats.md
    declare as not read."""
    left_out: tuple[str, ...] = ()
    """Patterns of changes that leave out what belongs to what was changed."""
    open_names: bool = False
    """Whether the format grows by elements, attributes and keys: others than the read ones are not
    looked at. Values of what is read are judged as everywhere."""
    places_only: bool = False
    """Whether the files have points or photos, and no observations."""
    is_field_book: bool = False
    """Whether the files have the survey of `tests.io.field_books.field_files`."""

    def files(self, folder: Path) -> Files:
        """Return the contents by name, made in an empty folder."""
        made = self.contents if isinstance(self.contents, Mapping) else self.contents(folder)
        return {n: c.encode() if isinstance(c, str) else c for n, c in made.items()}

    def write(self, folder: Path) -> Path:
        """Write the files into a folder; return the one with which the reader begins."""
        (folder / "made").mkdir(parents=True, exist_ok=True)
        for name, content in self.files(folder / "made").items():
            (folder / name).write_bytes(content)
        return folder / self.begin

    def reads(self, path: Path, **options: Any) -> fga.Network:
        """Read the file with which the reader begins, or the folder."""
        folder = path.parent if self.begin else path
        other = {name: folder / file for name, file in self.beside.items()}
        return fga.read(path, format=self.reader, **{**self.options, **other, **options})

    def declares(self, change: str, *, lost: bool) -> bool:
        """Return whether the format declares that what was changed is not read.

        Args:
            change: the change.
            lost: whether parts of the network are lost by it.
        """
        patterns = self.left_out if lost else (*OF_ALL, *self.unread)
        return any(re.search(p, change) for p in patterns)
