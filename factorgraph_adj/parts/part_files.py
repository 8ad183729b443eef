"""Parts of a network and their run as files: stored parts, set-ups, states, results, progress.

A killed run resumes from its folder. Every file is written beside its place and then moved into it,
so that a killed process leaves either the old file or the new one. All of them are arrays and JSON,
which hold no code.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import weakref
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeAlias
from uuid import uuid4
from zipfile import BadZipFile

import numpy as np

from ..errors import InputError, Problem, system_reason
from ..files import refuse_replacing
from ..graph.variables import Unknowns
from ..io.json_records import network_files, network_of
from ..io.readers import read
from ..network.network import Network
from ..start.start_values import Start
from ..types import Array, Keys
from .junctions import JunctionSetup, Variable

PROGRESS_FILE = "run.json"
"""File with the progress of the root."""
NETWORK_FILE = "network"
"""Name of the arrays of a part in its folder."""
SETUP_FILE = "setup"
"""Name of what a part has to know about its junctions."""


@dataclass(frozen=True)
class RunFolder:
    """A folder that the root and all processes of the parts can reach."""

    path: Path
    """Where it is."""

    def of_part(self, number: int) -> RunFolder:
        """Return the folder of a part; it is made if there is none."""
        inner = RunFolder(self.path / f"part-{number:04d}")
        inner.path.mkdir(parents=True, exist_ok=True)
        return inner

    def write_arrays(self, name: str, arrays: Mapping[str, Array | Keys]) -> None:
        """Write arrays under a name."""
        with _Replacement(self.path / f"{name}.npz") as path, path.open("wb") as stream:
            np.savez(stream, **arrays)  # type: ignore[arg-type]

    def arrays(self, name: str) -> dict[str, Array]:
        """Return the arrays under a name.

        Raises:
            InputError: they are not there.
        """
        path = self.path / f"{name}.npz"
        with (
            _reaching(path),
            path.open("rb") as stream,
            np.load(stream, allow_pickle=False) as stored,
        ):
            return {key: stored[key] for key in stored.files}

    def write(self, name: str, value: object) -> None:
        """Write texts and numbers, in lists and tables, as JSON."""
        with _Replacement(self.path / f"{name}.json") as path:
            path.write_text(json.dumps(value), encoding="utf-8")

    def read(self, name: str) -> Any:
        """Return what was written under a name.

        Raises:
            InputError: it is not there.
        """
        path = self.path / f"{name}.json"
        with _reaching(path):
            return json.loads(path.read_text(encoding="utf-8"))

    def forget(self, name: str) -> None:
        """Remove arrays; nothing happens where there are none."""
        (self.path / f"{name}.npz").unlink(missing_ok=True)

    def made(self) -> RunFolder:
        """Make the folder if there is none, and return it.

        Raises:
            InputError: it cannot be made.
        """
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except (OSError, ValueError) as error:
            what = f"the folder of the run cannot be made: {system_reason(error)}"
            raise InputError(Problem(what, str(self.path))) from None
        return self

    # -- progress -----------------------------------------------------------------------------

    def progress(self) -> dict[str, Any] | None:
        """Return what the root has noted; none: the run has not begun.

        Raises:
            InputError: the file cannot be read.
        """
        path = self.path / PROGRESS_FILE
        if not path.exists():
            return None
        try:
            found = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            what = "this is not the progress of a run: give an empty folder"
            raise InputError(Problem(what, str(path))) from None
        return dict(found)

    def note(self, progress: dict[str, Any]) -> None:
        """Write the progress of the root."""
        with _Replacement(self.path / PROGRESS_FILE) as path:
            path.write_text(json.dumps(progress, indent=1), encoding="utf-8")


class TemporaryFolder:
    """A temporary folder that disappears with this object, at the latest with the process."""

    def __init__(self) -> None:
        """Make the folder."""
        self.path = Path(tempfile.mkdtemp(prefix="factorgraph-adj-"))
        weakref.finalize(self, shutil.rmtree, self.path, ignore_errors=True)


@contextmanager
def _reaching(path: Path) -> Iterator[None]:
    """Raise InputError where a file of the run is missing or damaged."""
    try:
        yield
    except FileNotFoundError:
        what = "is missing: every worker must reach the folder of the run under this path"
        if path.with_suffix(".pickle").exists():
            what = (
                "is missing: the folder is of an earlier version, whose pickled objects could run "
                "code and are not read; give an empty folder, in which the run begins again"
            )
        raise InputError(Problem(what, str(path))) from None
    except (BadZipFile, ValueError, EOFError, KeyError):
        what = "is damaged: give an empty folder, in which the run begins again"
        raise InputError(Problem(what, str(path))) from None


class _Replacement:
    """A path beside another one, which takes its place if nothing fails."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._beside = path.with_name(f".{path.name}.{uuid4().hex}")

    def __enter__(self) -> Path:
        refuse_replacing((self._path,))
        return self._beside

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            os.replace(self._beside, self._path)
        else:
            self._beside.unlink(missing_ok=True)


def write_part(folder: RunFolder, network: Network, start: Start) -> None:
    """Write a network and its start, by arrays and JSON alone.

    Args:
        folder: folder of the part.
        network: the network.
        start: values of its unknowns.

    Raises:
        InputError: the network has something that no file can hold.
    """
    header = {
        "files": network_files(network),
        "words": start.words,
        "doubtful": start.doubtful,
        "unreached": start.unreached,
        "sources": {name: o.source for name, o in network.observations.items()},
    }
    text: Any = np.frombuffer(json.dumps(header).encode("utf-8"), dtype=np.uint8)
    state = {f"state/{kind}": x for kind, x in start.state.items()}
    origin = {f"origin/{kind}": x for kind, x in start.origin.items()}
    folder.write_arrays(NETWORK_FILE, {"header": text, **state, **origin})


def read_part(folder: RunFolder, geoids: Collection[str] = ()) -> tuple[Network, Start]:
    """Return a network and its start.

    Args:
        folder: folder of the part.
        geoids: paths of geoids that may be read although they lie outside.

    Raises:
        InputError: the files are missing, damaged, or of an earlier version.
    """
    arrays = folder.arrays(NETWORK_FILE)
    header = json.loads(arrays["header"].tobytes().decode("utf-8"))
    network = network_of(header["files"], geoids=geoids)
    for name, source in header["sources"].items():  # messages name the file that the user has
        own: Any = network.observations[name]
        network.observations[name] = replace(own, source=source)
    unknowns = Unknowns(network)
    state, origin = (
        {kind: arrays[f"{of}/{kind}"] for kind in unknowns.start()} for of in ("state", "origin")
    )
    words, doubtful, unreached = (tuple(header[n]) for n in ("words", "doubtful", "unreached"))
    return network, Start(unknowns, state, origin, words, doubtful, unreached)


def write_setup(folder: RunFolder, setup: JunctionSetup) -> None:
    """Write what a part has to know about its junctions."""
    record = {
        "variables": [[v.kind, v.name] for v in setup.variables],
        "start": [np.asarray(x).tolist() for x in setup.start],
        "foreign": [bool(f) for f in setup.foreign],
    }
    folder.write(SETUP_FILE, record)


def read_setup(folder: RunFolder) -> JunctionSetup:
    """Return what `write_setup` has written.

    Raises:
        InputError: the file is missing, damaged, or of an earlier version.
    """
    record = folder.read(SETUP_FILE)
    return JunctionSetup(
        tuple(Variable(kind, name) for kind, name in record["variables"]),
        tuple(np.array(x, dtype=float) for x in record["start"]),
        tuple(record["foreign"]),
    )


@dataclass(frozen=True)
class Part:
    """A part of a network, which is read where it is adjusted."""

    name: str
    """Name, for messages and results."""
    load: Callable[[], Network]
    """Function without arguments that returns the network of the part; it can be pickled."""


@dataclass(frozen=True)
class StoredPart:
    """A part that `factorgraph_adj.parts.whole_network` has written."""

    path: Path
    """Folder with the network and its start."""
    geoids: tuple[str, ...] = ()
    """Paths of geoids that may be read although they lie outside."""

    def __call__(self) -> Network:
        """Return the network."""
        return self.read()[0]

    def read(self) -> tuple[Network, Start | None]:
        """Return the network, and values to start from."""
        return read_part(RunFolder(self.path), self.geoids)


PartSource: TypeAlias = Part | str | Path
"""A part, or the file or folder of a project."""


def named_parts(sources: Sequence[PartSource]) -> tuple[Part, ...]:
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
