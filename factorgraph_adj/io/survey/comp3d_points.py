"""Points of Comp3D (.cor): codes, coordinates, standard deviations, deflections of the vertical."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...network.network import Network
from ...observations import ControlPoint, Correlated
from ...types import Array
from ...units import ARCSEC
from .comp3d_files import Comp3dFiles, Line

CODES: dict[int, tuple[str, str]] = {
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
IGNORED = -1
"""Code of points that take no part, nor do their observations."""


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
    """Deflection of the vertical, radians; none: not stated."""
    line: Line
    """Where it stands."""


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
    line: Line, cartesian: Callable[[Array], Array], radius: float, centre: tuple[float, float]
) -> Comp3dPoint | None:
    words, before = line.words, len(line.file.problems)
    codes = [str(c) for c in (*CODES, IGNORED)]
    if words[0] not in codes or len(words) < 2:
        line.wrong(f"a point begins with a code ({', '.join(codes)}) and a name")
        return None
    code, name = int(words[0]), words[1]
    nothing, free = np.zeros(3), np.full(3, math.inf)
    if code == IGNORED:
        line.switched_off()
        return Comp3dPoint(name, code, nothing, nothing, "", free, None, line)
    if len(words) not in (5, 8, 10):
        what = "a point has a code, a name, E, N, h, three standard deviations or none, and two "
        line.wrong(f"{what}deflections or none, not {len(words)} words")
        return None
    held, weighted = CODES[code]
    at = np.array([line.number_at(2 + i, "ENh"[i]) for i in range(3)])
    if weighted and len(words) == 5:
        line.wrong(f"a point with the code {code} needs standard deviations")
    given = [line.number_at(5 + i, "a standard deviation") for i in range(3)] if len(
        words) > 5 else [0.0] * 3  # fmt: skip
    eta_xi = None
    if len(words) == 10:
        eta, xi = (line.number_at(i, "a deflection") * ARCSEC for i in (8, 9))
        eta_xi = (eta, xi)
    if len(line.file.problems) > before:
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


def observed_together(points: Mapping[str, Comp3dPoint]) -> set[str]:
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
        file.add(0, f"the covariance file {path.name!r} is not beside the project")
        return set()
    rows = [Line(f, n, t.replace(",", " ").split()) for f in [files.open(path)]
            for n, t in f.numbered() if t.strip()]  # fmt: skip
    names = rows[0].words[1:] if rows else []
    parts = [n.rpartition("_") for n in names]
    wrong = [n for n, p in zip(names, parts, strict=True) if p[2] not in "xyz" or not p[2]]
    file = files.files[-1]
    if not names or wrong or len(rows) != len(names) + 1:
        file.add(1, "needs a header of parameters such as A_x, and a row for each of them")
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
        file.add(1, f"has no weighted coordinate {missing[0]!r}")
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
    if members and not file.problems:
        joint = file.attempt(1, Correlated, tuple(members), matrix[np.ix_(order, order)])
        if joint is not None:
            file.attempt(1, network.add, joint)
    return {m.point for m in members}
