"""Files of Comp3D: lines of words with comments, in files that name other files."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...errors import InputError, Problem
from ...files import astray
from ..collected import LinesOfFile, raise_all
from ..left_out import ROWS_SWITCHED_OFF

DEEPEST = 8
"""Largest depth of files in files."""
LONGEST = 200
"""Largest number of characters of the name of a file."""
BESIDE = ("", "origin")
"""Folders, from that of a file, in which the files lie that it names."""


@dataclass(frozen=True)
class Line:
    """A line of a file that is not empty."""

    file: LinesOfFile
    """The file, which collects the problems."""
    number: int
    """Its number, from 1."""
    words: list[str]
    """Its words, without the comment behind an asterisk."""

    @property
    def source(self) -> str:
        """File and line."""
        return self.file.place(self.number)

    def wrong(self, what: str) -> None:
        """Note a problem."""
        self.file.add(self.number, what)

    def switched_off(self) -> None:
        """Count and name the line as one that is left out: its code and points."""
        name = " ".join(self.words[:3])
        self.file.leave_out(self.number, ROWS_SWITCHED_OFF, name)

    def number_at(self, at: int, name: str, **bounds: Any) -> float:
        """Return a word as a number; NaN, and a problem, if it is none."""
        if at >= len(self.words):
            self.wrong(f"has no {name} (word {at + 1})")
            return float("nan")
        return self.file.number(self.number, name, self.words[at], **bounds)

    def attempt(self, make: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Return what a function makes; note its problems here, and return None."""
        return self.file.attempt(self.number, make, *arguments, **options)


class Comp3dFiles:
    """The files of a project that have been read so far."""

    def __init__(self) -> None:
        """Start without files."""
        self.files: list[LinesOfFile] = []

    def open(self, path: Path) -> LinesOfFile:
        """Read a file; its problems are among those that `raise_all` raises."""
        file = LinesOfFile(path, latin=True)
        self.files.append(file)
        return file

    def lines(self, path: Path, depth: int = 0) -> Iterator[Line]:
        """Iterate over the lines of a file and of the files that lines ``@file`` name."""
        file = self.open(path)
        for number, text in file.numbered():
            words = text.split("*")[0].split()
            if not words:
                continue
            line = Line(file, number, words)
            if words[0].startswith("@"):
                if len(words) > 1:
                    line.wrong(f"{words[0][:40]} takes no words, not {words[1][:40]!r}")
                inner = self.beside(line, words[0])
                if depth >= DEEPEST:
                    line.wrong(f"is a file in more than {DEEPEST} files, or in itself")
                elif inner is not None:
                    yield from self.lines(inner, depth + 1)
                continue
            yield line

    def beside(self, line: Line, word: str) -> Path | None:
        """Return the path of a file that a line names; note a problem where there is none."""
        name = word.removeprefix("@")
        parent = line.file.path.parent
        if why := astray(parent, name):
            line.wrong(f"must name a file beside this one as @file: {word[:40]!r} {why}")
            return None
        for folder in BESIDE:
            found = parent / folder / name
            if len(name) <= LONGEST and found.is_file() and not astray(parent / folder, name):
                return found
        line.wrong(f"names the file {name[:60]!r}, which is not beside this one")
        return None

    def raise_all(self) -> None:
        """Raise InputError with the problems of all files, if there are any."""
        raise_all(self.files)


@dataclass(frozen=True)
class Comp3dProject:
    """What a project file (.comp) says."""

    points: Path
    """File of points."""
    observations: Path
    """File of observations."""
    latitude: float
    """Latitude of the centre, degrees; that of a project in a grid follows from its centre."""
    centre: tuple[float, float] | None
    """X and Y of the centre, metres; of a project in a grid easting and northing; None: not
    stated."""
    refraction: float
    """Refraction coefficient."""
    covariance: Path | None
    """File of the covariance of weighted coordinates."""
    projection: str | None = None
    """Reference system of its grid, a definition of PROJ; None: a local project."""
    ellipsoidal: bool = True
    """Whether heights are above the ellipsoid."""
    place: str = ""
    """File and line of the definition of the projection."""


def read_project(path: Path) -> Comp3dProject:
    """Read a project file: JSON behind ``data=``.

    Raises:
        InputError: the file is no such file, or lacks something.
    """
    file = LinesOfFile(path, latin=True)
    text = "\n".join(file.lines)
    begin = text.find("{")

    def at(key: str) -> int:
        """Return the line of a key, or the last one."""
        found = text.find(f'"{key}"')
        return text.count("\n", 0, found) + 1 if found >= 0 else 0

    try:
        found = json.loads(text[begin:]) if begin >= 0 else None
        config = found["config"] if isinstance(found, dict) else None
    except (ValueError, KeyError, RecursionError) as error:
        line = 0
        if isinstance(error, json.JSONDecodeError):
            line = text.count("\n", 0, begin) + error.lineno
        where = file.place(line)
        raise InputError(Problem(f"is not a project of Comp3D: {error}", where)) from None
    if not isinstance(config, dict):
        raise InputError(Problem("is not a project of Comp3D: it has no config", file.place(0)))
    projection = config.get("proj_def") if config.get("use_proj") else None
    if config.get("use_proj") and not (isinstance(projection, str) and projection.strip()):
        file.add(
            at("use_proj"), "the project is in a grid, and proj_def does not name its projection"
        )
    if config.get("internal_constraints"):
        file.add(
            at("internal_constraints"),
            "internal constraints are not read: give datum='free' to the network",
        )
    names = {}
    for key in ("root_COR_file", "root_OBS_file", "coord_cov_file"):
        name = config.get(key) or ""
        why = "is no text" if not isinstance(name, str) else name and astray(path.parent, name)
        if why:
            what = f"{key} must name a file beside this one: {str(name)[:60]!r} {why}"
            file.add(at(key), what)
        elif key != "coord_cov_file" and not (name and (path.parent / name).is_file()):
            file.add(at(key), f"{key} names the file {name!r}, which is not beside this one")
        names[key] = str(name)
    wanted = dict(config) if projection is None else {**config, "center_latitude": 0.0}
    numbers = [file.number(at(k), k, str(wanted.get(k))) for k in ("center_latitude", "refraction")]
    centre = config.get("local_center") or [0.0, 0.0]
    if not isinstance(centre, list) or len(centre) < 2:
        file.add(at("local_center"), "local_center must be two numbers")
        centre = [0.0, 0.0]
    x, y = (file.number(at("local_center"), "local_center", str(v)) for v in centre[:2])
    file.raise_all()
    covariance = names["coord_cov_file"]
    return Comp3dProject(
        path.parent / names["root_COR_file"],
        path.parent / names["root_OBS_file"],
        numbers[0],
        (x, y),
        numbers[1],
        path.parent / covariance if covariance else None,
        projection,
        config.get("use_ellips_height", True) is not False,
        file.place(at("proj_def")),
    )
