"""Parts of a network: where a process reads its part from, and what it is called."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeAlias

from ..errors import InputError, Problem
from ..io.readers import read
from ..network.network import Network
from ..solve.start import Start
from .folder import Folder
from .stored import read_part


@dataclass(frozen=True)
class Part:
    """A part of a network, which is read where it is adjusted."""

    name: str
    """Name, for messages and results."""
    load: Callable[[], Network]
    """Function without arguments that returns the network of the part; it can be pickled."""


@dataclass(frozen=True)
class StoredPart:
    """A part that `factorgraph_adj.parts.cut` has written."""

    path: Path
    """Folder with the network and its start."""
    geoids: tuple[str, ...] = ()
    """Paths of geoids that may be read although they lie outside."""

    def __call__(self) -> Network:
        """Return the network."""
        return self.read()[0]

    def read(self) -> tuple[Network, Start | None]:
        """Return the network, and values to start from."""
        return read_part(Folder(self.path), self.geoids)


Source: TypeAlias = Part | str | Path
"""A part, or the file or folder of a project."""


def parts_of(sources: Sequence[Source]) -> tuple[Part, ...]:
    """Return parts with their names.

    Raises:
        InputError: there is no part, or two parts have the same name.
    """
    for source in sources:
        if not isinstance(source, Part | str | Path):
            what = f"a part is a project's file or folder, or `Part`, not {type(source).__name__}"
            raise InputError(what)
        if isinstance(source, Part) and not callable(source.load):
            what = "its load must be a function without arguments that returns a network"
            raise InputError(Problem(what, f"part {source.name!r}"))
    parts = tuple(s if isinstance(s, Part) else _of_file(Path(s)) for s in sources)
    if not parts:
        raise InputError("there are no parts: give at least one project, or `Part`")
    seen: dict[str, int] = {}
    for number, part in enumerate(parts, start=1):
        if part.name in seen:
            what = (
                f"parts {seen[part.name]} and {number} have this name, which is that of the file "
                "or folder: leave one out if they are the same, or rename it"
            )
            raise InputError(Problem(what, f"part {part.name!r}"))
        seen[part.name] = number
    return parts


def _of_file(path: Path) -> Part:
    path = path.resolve()
    named = path.parent if path.name == "project.toml" else path
    return Part(named.stem if named.is_file() else named.name, partial(read, path))
