"""Files of Comp3D: project (.comp), points (.cor), joint covariance (.csv), lines with includes.

Lines have comments. Points have a code, coordinates, standard deviations and deflections of the
vertical.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError, Problem
from ...files import astray
from ...network.network import Network
from ...observations import ControlPoint, Correlated
from ...types import Array
from ...units import ARCSEC
from ..source import ROWS_SWITCHED_OFF, Problems, TextSource

MAX_FILE_DEPTH = 8
"""Largest depth of files in files."""
MAX_FILE_NAME_CHARACTERS = 200
"""Largest number of characters of the name of a file."""
COMPANION_FOLDERS = ("", "origin")
"""Folders, from that of a file, in which the files lie that it names."""
POINT_CODES: dict[int, tuple[str, str]] = {
    0: ("", ""),
    1: ("", "xyz"),
    2: ("", "xy"),
    3: ("", "z"),
    4: ("xy", ""),
    5: ("xy", "z"),
    6: ("z", ""),
    7: ("z", "xy"),
    8: ("z", ""),
    9: ("z", "xy"),
}
"""Components that are held, and that are weighted, by the code of the point."""
IGNORED_POINT_CODE = -1
"""Code of points that take no part, nor do their observations."""


@dataclass(frozen=True)
class Comp3dLine:
    """A line of a file that is not empty."""

    file: TextSource
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
        self.file.wrong(self.number, what)

    def switched_off(self) -> None:
        """Count and name the line as one that is left out: its code and points."""
        name = " ".join(self.words[:3])
        self.file.leave_out(self.number, ROWS_SWITCHED_OFF, name)

    def number_at(self, at: int, name: str, **bounds: Any) -> float:
        """Return a word as a number; NaN, and a problem, if it is none."""
        if at >= len(self.words):
            self.wrong(f"has no {name} (word {at + 1})")
            return math.nan
        return self.file.field(self.number, self.words[at], name).number(**bounds)

    def attempt(self, make: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Return what a function makes; note its problems here, and return None."""
        return self.file.attempt(self.number, make, *arguments, **options)


class Comp3dFiles:
    """The files of a project that have been read so far."""

    def __init__(self) -> None:
        """Start without files."""
        self.problems = Problems()
        self.files: list[TextSource] = []

    def open(self, path: Path) -> TextSource:
        """Read a file; its problems are among those of all files."""
        self.files.append(TextSource(path, self.problems, code_page="cp1252"))
        return self.files[-1]

    def lines(self, path: Path, depth: int = 0) -> Iterator[Comp3dLine]:
        """Iterate over the lines of a file and of the files that lines ``@file`` name."""
        file = self.open(path)
        for number, text in file.numbered():
            words = text.split("*")[0].split()
            if not words:
                continue
            line = Comp3dLine(file, number, words)
            if words[0].startswith("@"):
                if len(words) > 1:
                    line.wrong(f"{words[0][:40]} takes no words, not {words[1][:40]!r}")
                inner = self.beside(line, words[0])
                if depth >= MAX_FILE_DEPTH:
                    line.wrong(f"is a file in more than {MAX_FILE_DEPTH} files, or in itself")
                elif inner is not None:
                    yield from self.lines(inner, depth + 1)
                continue
            yield line

    def beside(self, line: Comp3dLine, word: str) -> Path | None:
        """Return the path of a file that a line names; note a problem where there is none."""
        name = word.removeprefix("@")
        parent = line.file.path.parent
        if why := astray(parent, name):
            line.wrong(f"must name a file beside this one as @file: {word[:40]!r} {why}")
            return None
        for folder in COMPANION_FOLDERS:
            found = parent / folder / name
            if (
                len(name) <= MAX_FILE_NAME_CHARACTERS
                and found.is_file()
                and not astray(parent / folder, name)
            ):
                return found
        line.wrong(f"names the file {name[:60]!r}, which is not beside this one")
        return None


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


def read_comp3d_project(path: Path, problems: Problems) -> Comp3dProject:
    """Read a project file: JSON behind ``data=``.

    Args:
        path: the file.
        problems: collection of all files of the project.

    Raises:
        InputError: the file is no such file, or lacks something.
    """
    file = TextSource(path, problems, code_page="cp1252")
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
        file.wrong(
            at("use_proj"), "the project is in a grid, and proj_def does not name its projection"
        )
    if config.get("internal_constraints"):
        file.wrong(
            at("internal_constraints"),
            "internal constraints are not read: give datum='free' to the network",
        )
    names = {}
    for key in ("root_COR_file", "root_OBS_file", "coord_cov_file"):
        name = config.get(key) or ""
        why = "is no text" if not isinstance(name, str) else name and astray(path.parent, name)
        if why:
            what = f"{key} must name a file beside this one: {str(name)[:60]!r} {why}"
            file.wrong(at(key), what)
        elif key != "coord_cov_file" and not (name and (path.parent / name).is_file()):
            file.wrong(at(key), f"{key} names the file {name!r}, which is not beside this one")
        names[key] = str(name)
    wanted = dict(config) if projection is None else {**config, "center_latitude": 0.0}
    numbers = [
        file.field(at(k), wanted.get(k), k).number() for k in ("center_latitude", "refraction")
    ]
    centre = config.get("local_center") or [0.0, 0.0]
    if not isinstance(centre, list) or len(centre) < 2:
        file.wrong(at("local_center"), "local_center must be two numbers")
        centre = [0.0, 0.0]
    x, y = file.field(at("local_center"), centre[:2], "local_center").numbers(2)
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


@dataclass(frozen=True)
class Comp3dPoint:
    """A line of the .cor file."""

    name: str
    """Name."""
    code: int
    """Code."""
    projected: Array
    """X, Y and height of the file, (3,), metres."""
    xyz: Array
    """Coordinates in the frame of the network, (3,), metres."""
    fixed: str
    """Components that are held."""
    sigma: Array
    """Standard deviations (3,), metres; infinite where a component is free."""
    eta_xi: tuple[float, float] | None
    """Deflection of the vertical, radians; None: not stated."""
    line: Comp3dLine
    """Its place in the file."""


def read_points(
    files: Comp3dFiles,
    path: Path,
    *,
    cartesian: Callable[[Array], Array],
    radius: float,
    centre: tuple[float, float] = (0.0, 0.0),
) -> dict[str, Comp3dPoint]:
    """Return the points of a .cor file by name; those with code −1 too.

    Args:
        files: gets the files that are read, and their problems.
        path: the file.
        cartesian: turns projected coordinates into those of the frame.
        radius: R, metres: σ of plane coordinates are 1 + h/R times as large on the ground;
            infinite: they are those of the plane.
        centre: X and Y of the centre of the project, which are subtracted, metres.
    """
    points: dict[str, Comp3dPoint] = {}
    for line in files.lines(path):
        point = _point(line, cartesian, radius, centre)
        if point is None:
            continue
        if point.name in points:
            where = points[point.name].line.source
            line.wrong(f"point {point.name[:40]!r} stands in {where} already")
            continue
        points[point.name] = point
    return points


def _point(
    line: Comp3dLine,
    cartesian: Callable[[Array], Array],
    radius: float,
    centre: tuple[float, float],
) -> Comp3dPoint | None:
    words, before = line.words, line.file.problems.count
    codes = [str(c) for c in (*POINT_CODES, IGNORED_POINT_CODE)]
    if words[0] not in codes or len(words) < 2:
        line.wrong(f"a point begins with a code ({', '.join(codes)}) and a name")
        return None
    code, name = int(words[0]), words[1]
    nothing, free = np.zeros(3), np.full(3, math.inf)
    if code == IGNORED_POINT_CODE:
        line.switched_off()
        return Comp3dPoint(name, code, nothing, nothing, "", free, None, line)
    if len(words) not in (5, 8, 10):
        what = "a point has a code, a name, E, N, h, three standard deviations or none, and two "
        line.wrong(f"{what}deflections or none, not {len(words)} words")
        return None
    held, weighted = POINT_CODES[code]
    at = np.array([line.number_at(2 + i, "ENh"[i]) for i in range(3)])
    if weighted and len(words) == 5:
        line.wrong(f"a point with the code {code} needs standard deviations")
    given = [line.number_at(5 + i, "a standard deviation") for i in range(3)] if len(
        words) > 5 else [0.0] * 3  # fmt: skip
    eta_xi = None
    if len(words) == 10:
        eta, xi = (line.number_at(i, "a deflection") * ARCSEC for i in (8, 9))
        eta_xi = (eta, xi)
    if line.file.problems.count > before:
        return None
    at[:2] -= centre
    on_ground = [1.0 + at[2] / radius] * 2 + [1.0]
    fixed, sigma = held, free.copy()
    for i, axis in enumerate("xyz"):
        if axis not in weighted or given[i] < 0:
            continue
        if given[i] > 0:
            sigma[i] = given[i] * on_ground[i]
        else:
            fixed += axis
    return Comp3dPoint(name, code, at, cartesian(at), fixed, sigma, eta_xi, line)


def add_point(network: Network, point: Comp3dPoint, *, weighted: bool = True) -> None:
    """Add a point to a network; problems go to its line.

    Args:
        network: the network.
        point: the point.
        weighted: whether its standard deviations enter.
    """
    sigma = point.sigma.tolist() if weighted and np.isfinite(point.sigma).any() else None
    point.line.attempt(
        network.add_point, point.name, point.xyz.tolist(), fixed=point.fixed, sigma=sigma
    )


def jointly_observed_points(points: Mapping[str, Comp3dPoint]) -> set[str]:
    """Return the names of the points with weighted coordinates."""
    return {p.name for p in points.values() if np.isfinite(p.sigma).any()}


def add_joint_covariance(
    files: Comp3dFiles, network: Network, points: dict[str, Comp3dPoint], path: Path
) -> set[str]:
    """Observe weighted coordinates with the joint covariance of a file; return their points.

    The header of the file (.csv, words separated by blanks or commas) names the parameters: point
    and axis, ``A_x``. Only the upper triangle is used. The covariance is that of projected
    coordinates, whose axes are those of the frame within X/R.
    """
    if not path.is_file():
        file = next(iter(points.values())).line.file
        file.wrong(0, f"the covariance file {path.name!r} is not beside the project")
        return set()
    file = files.open(path)
    rows = [Comp3dLine(file, n, t.replace(",", " ").split()) for n, t in file.filled()]
    names = rows[0].words[1:] if rows else []
    parts = [n.rpartition("_") for n in names]
    wrong = [n for n, p in zip(names, parts, strict=True) if p[2] not in "xyz" or not p[2]]
    if not names or wrong or len(rows) != len(names) + 1:
        file.wrong(1, "needs a header of parameters such as A_x, and a row for each of them")
        return set()
    matrix = np.zeros((len(names), len(names)))
    for i, row in enumerate(rows[1:]):
        if len(row.words) != len(names) + 1:
            row.wrong(f"has {len(row.words)} words, the header {len(names) + 1}")
            return set()
        matrix[i] = [row.number_at(j + 1, "a covariance") for j in range(len(names))]
    upper = np.triu(matrix)
    matrix = upper + np.triu(upper, 1).T
    weighted = {
        (p.name, a): f"{p.name}_{a}"
        for p in points.values()
        for i, a in enumerate("xyz")
        if np.isfinite(p.sigma[i])
    }
    missing = sorted(set(weighted.values()) - set(names))
    if missing:
        file.wrong(1, f"has no weighted coordinate {missing[0]!r}")
    used = [i for i, n in enumerate(names) if n in set(weighted.values())]
    members, order = [], []
    for name in dict.fromkeys(parts[i][0] for i in used):
        axes = "".join(a for a in "xyz" if (name, a) in weighted and f"{name}_{a}" in names)
        order += [names.index(f"{name}_{a}") for a in axes]
        value = tuple(float(points[name].xyz["xyz".index(a)]) for a in axes)
        members.append(
            ControlPoint(
                name,
                value,
                axes=axes,
                sigma=(1.0,) * len(axes),
                id=f"{name} control",
                source=path.name,
            )
        )
    if members and not file.problems.count:
        joint = file.attempt(1, Correlated, tuple(members), matrix[np.ix_(order, order)])
        if joint is not None:
            file.attempt(1, network.add, joint)
    return {m.point for m in members}
