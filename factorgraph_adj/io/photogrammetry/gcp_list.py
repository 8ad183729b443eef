"""Ground control of OpenSfM and ODM: gcp_list.txt and ground_control_points.json.

The first line of gcp_list.txt names a reference system; each other one is a measurement:

    X Y Z column row image [name [more]]

Pixels count from the centre of the first one. Lines of one place, or of one name, are one point.
A name that begins with CHK- is that of a check point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import InputError, Problem
from ..json_tree import parse_json
from ..left_out import Reason
from ..text import read_text
from .reading import Reading, lines_of

NOT_MEASURED = Reason("marks", "they have no image coordinates")
CHECK = "CHK-"
"""Beginning of the names of check points."""


@dataclass
class Ground:
    """A ground control point."""

    name: str
    """Its name."""
    xyz: tuple[float, float, float] | None
    """Coordinates in the system of the list; NaN for a height that is unknown, None: unknown."""
    where: str
    """File and line."""
    check: bool = False
    """Whether it is a check point."""
    marks: list[tuple[str, float, float, bool, str]] = field(default_factory=list)
    """Image, x, y, whether these are normalised (otherwise pixels), and source of measurements."""


@dataclass(frozen=True)
class GroundList:
    """A list of ground control points."""

    system: str
    """Reference system as the list names it."""
    points: list[Ground]
    """The points."""
    where: str
    """File and line of the reference system."""


def read_gcp_list(path: Path, reading: Reading) -> GroundList:
    """Read gcp_list.txt, or ground_control_points.json by its suffix.

    Raises:
        InputError: the file cannot be read.
    """
    if path.suffix.lower() == ".json":
        return _read_json(path, reading)
    lines = [(n, s) for n, s in lines_of(read_text(path)) if not s.lstrip().startswith("#")]
    if not lines:
        what = "is empty: the first line must name the reference system, such as WGS84"
        raise InputError(Problem(what, f"{path.name}:1"))
    points: dict[tuple[object, ...], Ground] = {}
    names: dict[str, Ground] = {}
    for number, line in lines[1:]:
        where = f"{path.name}:{number}"
        fields = line.split()
        if len(fields) < 6:
            what = f"a row has X Y Z column row image [name], not {len(fields)} fields"
            reading.wrong(what, where)
            continue
        height = math.nan if fields[2].lower() == "nan" else None
        found = reading.numbers(
            [*fields[:2], "0" if height is not None else fields[2], *fields[3:5]], 5, "row", where
        )
        if found is None:
            continue
        xyz = (found[0], found[1], found[2] if height is None else height)
        name = fields[6] if len(fields) > 6 else ""
        key = (name,) if name else tuple(fields[:3])
        point = points.get(key)
        if point is None:
            point = Ground(name or f"gcp {len(points) + 1}", xyz, where, name.startswith(CHECK))
            points[key] = point
            if point.name in names:
                reading.wrong(f"name {point.name!r} belongs to two places", where)
            names[point.name] = point
        elif point.xyz is not None and _differ(point.xyz, xyz):
            reading.wrong(f"point {name!r} has another place in {point.where}", where)
        point.marks.append((fields[5], found[3], found[4], False, where))
    return GroundList(lines[0][1].strip(), list(points.values()), f"{path.name}:{lines[0][0]}")


def _differ(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return any(not (x == y or (math.isnan(x) and math.isnan(y))) for x, y in zip(a, b, strict=True))


def _read_json(path: Path, reading: Reading) -> GroundList:
    root = parse_json(read_text(path), path.name)
    points = []
    for node in root.need("points").list():
        with reading.at(node.where):
            name = str(node.need("id").value)
            position = node.get("position")
            xyz = None
            if position is not None:
                altitude = position.get("altitude")
                xyz = (
                    position.need("longitude").number(),
                    position.need("latitude").number(),
                    math.nan if altitude is None else altitude.number(),
                )
            point = Ground(name, xyz, node.where, name.startswith(CHECK))
            for mark in node.need("observations").list():
                at = mark.get("projection")
                if at is None:
                    reading.leave_out(NOT_MEASURED, name, mark.where)
                    continue
                x, y = at.numbers(2)
                point.marks.append((mark.need("shot_id").text(), x, y, True, mark.where))
            points.append(point)
    return GroundList("WGS84", points, path.name)
