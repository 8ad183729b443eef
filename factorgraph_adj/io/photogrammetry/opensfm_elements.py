"""Cameras of OpenSfM and ODM, and their lists of ground control, as read: .txt and .json.

OpenSfM divides image coordinates by the larger side of the image; their origin is the middle of
the image, y points down. With (x, y) of a ray, r² = x² + y²:

    u = f (x d + 2 p1 x y + p2 (r² + 2x²)) + cx,   v likewise with p1 and p2 exchanged

OpenSfM counts pixels from the centre of the first one, so that its middle of the image is at
((w − 1)/2, (h − 1)/2): w/2, h/2 from the upper left corner of the image.

Ground control is in gcp_list.txt or ground_control_points.json.
The first line of
gcp_list.txt names a reference system; each further line is a measurement:

    X Y Z column row image [name [more]]

Pixels count from the centre of the first one. Lines of one place, or of one name, are one point.
A name that begins with CHK- is that of a check point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path

from ...errors import InputError, Problem
from ...models.lens import Lens, NormalisedLens
from ...models.normalised_lens import AffineNormalisedLens
from ...models.ray_lens import FisheyeLens
from ..json_files import JsonNode, parse_json
from ..source import LeftOutReason, Problems, is_unread
from ..text_files import read_text
from .block_source import filled_lines
from .coordinate_lists import ORDER_OF_LINES

MARKS_NOT_MEASURED = LeftOutReason("marks", "they have no image coordinates")
ORDER_OF_KEYS = "latitude and longitude are degrees of WGS84 under their own keys"
"""What tells the coordinates of ground_control_points.json apart."""
CHECK_PREFIX = "CHK-"
"""Beginning of the names of check points."""
PROJECTION_PARAMETERS = {
    "perspective": ("focal", "k1", "k2"),
    "simple_radial": ("focal_x", "focal_y", "c_x", "c_y", "k1"),
    "radial": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2"),
    "fisheye": ("focal", "k1", "k2"),
    "fisheye_opencv": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2", "k3", "k4"),
    "brown": ("focal_x", "focal_y", "c_x", "c_y", "k1", "k2", "p1", "p2", "k3"),
}
"""Parameters of the projections that can be read."""
FISHEYE_PROJECTIONS = ("fisheye", "fisheye_opencv")
"""Projections by the angle θ = atan(ρ/z) in place of the tangent: u = f θ (1 + k1 θ² + …) x/ρ."""
UNREAD_CAMERA_MEMBERS = (
    "projection_type",
    "width",
    "height",
    "focal_prior",
    "k1_prior",
    "k2_prior",
)
"""Members of a camera besides its parameters."""


@dataclass
class GroundControlPoint:
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
class GroundControlList:
    """A list of ground control points."""

    system: str
    """Reference system as the list names it."""
    points: list[GroundControlPoint]
    """The points."""
    where: str
    """File and line of the reference system."""
    order: str = ORDER_OF_LINES
    """What tells the coordinates of a point apart."""


def read_gcp_list(path: Path, problems: Problems) -> GroundControlList:
    """Read gcp_list.txt, or ground_control_points.json by its suffix.

    Raises:
        InputError: the file cannot be read.
    """
    if path.suffix.lower() == ".json":
        return _read_gcp_json(path, problems)
    lines = [(n, s) for n, s in filled_lines(read_text(path)) if not s.lstrip().startswith("#")]
    if not lines:
        what = "is empty: the first line must name the reference system, such as WGS84"
        raise InputError(Problem(what, f"{path.name}:1"))
    points: dict[tuple[object, ...], GroundControlPoint] = {}
    names: dict[str, GroundControlPoint] = {}
    for number, line in lines[1:]:
        where = f"{path.name}:{number}"
        fields = line.split()
        if len(fields) < 6:
            what = f"a row has X Y Z column row image [name], not {len(fields)} fields"
            problems.wrong(what, where)
            continue
        height = math.nan if fields[2].lower() == "nan" else None
        found = problems.field(
            [*fields[:2], "0" if height is not None else fields[2], *fields[3:5]], "row", where
        ).numbers(5)
        if is_unread(found):
            continue
        xyz = (found[0], found[1], found[2] if height is None else height)
        name = fields[6] if len(fields) > 6 else ""
        key = (name,) if name else tuple(fields[:3])
        point = points.get(key)
        if point is None:
            point = GroundControlPoint(
                name or f"gcp {len(points) + 1}", xyz, where, name.startswith(CHECK_PREFIX)
            )
            points[key] = point
            if point.name in names:
                problems.wrong(f"name {point.name!r} belongs to two places", where)
            names[point.name] = point
        elif point.xyz is not None and _differ(point.xyz, xyz):
            problems.wrong(f"point {name!r} has another place in {point.where}", where)
        point.marks.append((fields[5], found[3], found[4], False, where))
    return GroundControlList(
        lines[0][1].strip(), list(points.values()), f"{path.name}:{lines[0][0]}"
    )


def _differ(a: tuple[float, ...], b: tuple[float, ...]) -> bool:
    return any(not (x == y or (math.isnan(x) and math.isnan(y))) for x, y in zip(a, b, strict=True))


def _read_gcp_json(path: Path, problems: Problems) -> GroundControlList:
    root = parse_json(read_text(path), path.name)
    points = []
    for node in root.need("points").list():
        with problems.collect(node.where):
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
            point = GroundControlPoint(name, xyz, node.where, name.startswith(CHECK_PREFIX))
            for mark in node.need("observations").list():
                at = mark.get("projection")
                if at is None:
                    problems.leave_out(MARKS_NOT_MEASURED, name, mark.where)
                    continue
                x, y = at.numbers(2)
                point.marks.append((mark.need("shot_id").text(), x, y, True, mark.where))
            points.append(point)
    return GroundControlList("WGS84", points, path.name, ORDER_OF_KEYS)


@dataclass(frozen=True)
class SfmCamera:
    """A camera in pixels from the upper left corner, y up."""

    lens: Lens
    """The lens model."""
    values: dict[str, float]
    """Calibration by name, pixels."""
    size: tuple[float, float]
    """Width and height, pixels."""
    estimated: tuple[str, ...]
    """Parameters that OpenSfM estimates."""

    @property
    def side(self) -> float:
        """The larger side, pixels."""
        return max(self.size)

    def pixel(self, x: float, y: float) -> tuple[float, float]:
        """Return image coordinates, y up, of normalised ones, y down."""
        return self.size[0] / 2 + self.side * x, -self.size[1] / 2 - self.side * y


def read_opensfm_camera(node: JsonNode) -> SfmCamera:
    """Read a camera of a reconstruction.

    Raises:
        InputError: the projection is none that can be read, or a parameter is missing or unknown.
    """
    kind = node.get("projection_type")
    projection = "perspective" if kind is None else kind.text()
    names = PROJECTION_PARAMETERS.get(projection)
    if names is None:
        valid = ", ".join(PROJECTION_PARAMETERS)
        raise (kind or node).fail(f"projection {projection!r} cannot be read; valid: {valid}")
    unknown = [k for k in node.members() if k not in (*names, *UNREAD_CAMERA_MEMBERS)]
    if unknown:
        raise node.fail(f"unknown parameter {unknown[0]!r} of {projection}; valid: {names}")
    size = (node.need("width").number(above=0.0), node.need("height").number(above=0.0))
    side = max(size)
    said: dict[str, float] = {}
    for name in names:
        member = node.need(name) if name.startswith("focal") else node.get(name)
        if member is not None:
            said[name] = member.number(above=0.0 if name.startswith("focal") else -math.inf)
    fx = side * said.get("focal_x", said.get("focal", 0.0))
    fy = side * said.get("focal_y", said.get("focal", 0.0))
    values = {"c": fy, "x0": size[0] / 2 + side * said.get("c_x", 0.0)}
    values["y0"] = -size[1] / 2 - side * said.get("c_y", 0.0)
    values |= {k: said.get(k, 0.0) for k in ("k1", "k2", "k3")}
    values |= {"p1": said.get("p2", 0.0), "p2": -said.get("p1", 0.0)}
    estimated = ["c", *(k for k in ("k1", "k2", "k3") if k in names)]
    if "c_x" in names:
        estimated += ["x0", "y0", "b1"]
    if "p1" in names:
        estimated += ["p1", "p2"]
    lens: Lens = NormalisedLens()
    if projection in FISHEYE_PROJECTIONS:
        lens = FisheyeLens()
        values |= {"b1": fx / fy - 1.0, "k4": said.get("k4", 0.0)}
        estimated += ["k4"] if "k4" in names else []
    elif "focal_x" in names:
        lens = AffineNormalisedLens()
        values |= {"b1": fx - fy}
    return SfmCamera(lens, values, size, tuple(n for n in lens.names if n in estimated))
