"""The folder of a run in parts: states, results and progress, which a killed run resumes from.

Every file is written beside its place and then moved into it, so that a killed process leaves
either the old file or the new one. All of them are arrays and JSON, which hold no code.
"""

from __future__ import annotations

import json
import os
import shutil
import tempfile
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from uuid import uuid4
from zipfile import BadZipFile

import numpy as np

from ..errors import InputError, Problem, system_reason
from ..files import refuse_replacing
from ..types import Array, Keys

PROGRESS = "run.json"
"""File with the progress of the root."""


@dataclass(frozen=True)
class Folder:
    """A folder that the root and all processes of the parts can reach."""

    path: Path
    """Where it is."""

    def of_part(self, number: int) -> Folder:
        """Return the folder of a part; it is made if there is none."""
        inner = Folder(self.path / f"part-{number:04d}")
        inner.path.mkdir(parents=True, exist_ok=True)
        return inner

    def write_arrays(self, name: str, arrays: Mapping[str, Array | Keys]) -> None:
        """Write arrays under a name."""
        with _beside(self.path / f"{name}.npz") as path, path.open("wb") as stream:
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
        with _beside(self.path / f"{name}.json") as path:
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

    def made(self) -> Folder:
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
        path = self.path / PROGRESS
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
        with _beside(self.path / PROGRESS) as path:
            path.write_text(json.dumps(progress, indent=1), encoding="utf-8")


class Scratch:
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
                "code and are not read; give an empty folder, in which the run begins anew"
            )
        raise InputError(Problem(what, str(path))) from None
    except (BadZipFile, ValueError, EOFError, KeyError):
        what = "is damaged: give an empty folder, in which the run begins anew"
        raise InputError(Problem(what, str(path))) from None


class _beside:
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
