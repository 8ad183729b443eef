"""Outlines of shapes and wires in their frames, as lines in space that a plan or a view shows.

The lines depend on the direction of the view where the outline of a surface does: the sides of a
cylinder, the circle of a sphere. They reach as far as the points that were measured on the shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from ..types import Array

STEPS = 72
"""Number of straight pieces of a full circle, and of a sagging wire."""
EDGE = 0.02
"""Largest sine of the angle between view and plane of a torus that is seen from its edge."""
ALONG = 1e-6
"""Largest sine of the angle between view and axis at which the sides of a shape are not seen."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What an outline depends on beside its sizes."""

    q: Array
    """Places of the points on the shape in its frame, (n, 3), n ≥ 1."""
    towards: Array
    """Unit vector along which the shape is looked at, in its frame, (3,)."""
    up: Array
    """Unit vector of the vertical at its origin, in its frame, (3,)."""

    @property
    def ends(self) -> tuple[float, float]:
        """Least and largest coordinate of the points along the axis of the shape."""
        return float(self.q[:, 2].min()), float(self.q[:, 2].max())


Lines: TypeAlias = Callable[..., list[Array]]
"""(`Seen`, values …) → lines, each (k, 3) in the frame."""


def no_places(*_: float) -> Array:
    """Return no places, (0, 3)."""
    return np.zeros((0, 3))


def zero_place(*_: float) -> Array:
    """Return the zero of the frame: the centre or the apex of a shape, (1, 3)."""
    return np.zeros((1, 3))


@dataclass(frozen=True)
class Outline:
    """How something that has a frame is drawn."""

    name: str
    """What it is, for legends."""
    lines: Lines
    """Its lines."""
    takes: tuple[str, ...] = ()
    """Attributes of observations with the values of the lines: unknowns of one component, or
    constants."""
    places: Callable[..., Array] = no_places
    """(values …) → places in the frame (k, 3) whose precision is shown."""
    place: str = ""
    """What each of these places is, with its article, for legends."""


def _ring(radius: float, height: float, steps: int = STEPS) -> Array:
    """Return a circle about the axis."""
    turn = np.linspace(0.0, 2.0 * np.pi, steps + 1)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn), np.full(len(turn), height)], 1)


def _axis(low: float, high: float) -> Array:
    return np.array([[0.0, 0.0, low], [0.0, 0.0, high]])


def plane_lines(seen: Seen) -> list[Array]:
    """Return the convex hull of the points in the plane, which from its side is its trace."""
    order = np.lexsort((seen.q[:, 1], seen.q[:, 0]))
    plan = seen.q[order, :2]
    half: list[list[Array]] = []
    for points in (plan, plan[::-1]):  # the lower and the upper chain (Andrew)
        chain: list[Array] = []
        for p in points:
            while len(chain) > 1 and _turn(chain[-2], chain[-1], p) <= 0:
                chain.pop()
            chain.append(p)
        half.append(chain)
    corners = np.array([*half[0], *half[1][1:]])
    return [np.column_stack([corners, np.zeros(len(corners))])]


def _turn(a: Array, b: Array, c: Array) -> float:
    """Return twice the area of a triangle, positive counter-clockwise."""
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def line_lines(seen: Seen) -> list[Array]:
    """Return the line from the first to the last point."""
    return [_axis(*seen.ends)]


def circle_lines(seen: Seen, radius: float, height: float) -> list[Array]:
    """Return the circle."""
    return [_ring(radius, height)]


def cylinder_lines(seen: Seen, radius: float) -> list[Array]:
    """Return the axis, the circles at both ends and the sides."""
    low, high = seen.ends
    return [
        _axis(low, high),
        _ring(radius, low),
        _ring(radius, high),
        *_sides(seen, (low, high), (radius, radius), 0.0),
    ]


def cone_lines(seen: Seen, angle: float) -> list[Array]:
    """Return the axis, the circles at both ends and the sides."""
    low, high = seen.ends
    slope = float(np.tan(angle))
    radii = (slope * low, slope * high)
    rings = [_ring(r, z) for r, z in zip(radii, (low, high), strict=True)]
    return [_axis(low, high), *rings, *_sides(seen, (low, high), radii, slope)]


def _sides(
    seen: Seen, heights: tuple[float, float], radii: tuple[float, float], slope: float
) -> list[Array]:
    """Return the two lines at which a cylinder or a cone turns away from the view.

    Its normal is across the view there: vx cos φ + vy sin φ = vz tan α.
    """
    across = float(np.hypot(seen.towards[0], seen.towards[1]))
    if across < ALONG or abs(cosine := seen.towards[2] * slope / across) > 1.0:
        return []
    middle = np.arctan2(seen.towards[1], seen.towards[0])
    out = []
    for turn in (middle + np.arccos(cosine), middle - np.arccos(cosine)):
        ends = zip(radii, heights, strict=True)
        out.append(np.array([(r * np.cos(turn), r * np.sin(turn), z) for r, z in ends]))
    return out


def sphere_lines(seen: Seen, radius: float) -> list[Array]:
    """Return the circle across the view."""
    _, _, basis = np.linalg.svd(seen.towards[None])
    return [_ring(radius, 0.0)[:, :2] @ basis[1:]]


def torus_lines(seen: Seen, radius: float, ring: float) -> list[Array]:
    """Return where the tube turns away from the view: m ± r t × v / |t × v|.

    m is on the circle of its middle and t the tangent there. Seen from its edge, the outline turns
    about the tube where t is along the view: there the tube is drawn.
    """
    middle = _ring(ring, 0.0, 10 * STEPS)
    tangent = _ring(1.0, 0.0, 10 * STEPS)[:, [1, 0, 2]] * [-1.0, 1.0, 0.0]
    normal = np.cross(tangent, seen.towards)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    seen_at = size[:, 0] > ALONG
    unit = normal[seen_at] / size[seen_at]
    out = [middle[seen_at] + radius * unit, middle[seen_at] - radius * unit]
    if abs(seen.towards[2]) < EDGE:
        tube = _ring(radius, 0.0)
        for side in _across(seen):
            out.append((ring + tube[:, :1]) * side + tube[:, 1:2] * [0.0, 0.0, 1.0])
    return out


def _across(seen: Seen) -> list[Array]:
    """Return both unit vectors across the axis and the view, (3,); none along the axis."""
    across = float(np.hypot(seen.towards[0], seen.towards[1]))
    if across < ALONG:
        return []
    one = np.array([-seen.towards[1], seen.towards[0], 0.0]) / across
    return [one, -one]


def paraboloid_lines(seen: Seen, focal: float) -> list[Array]:
    """Return its rim at the outermost point, and where it turns away from the view.

    Its normal (−x/2F, −y/2F, 1) is across the view there: on the parabola of the plane at
    2F vz/|vxy| from the axis, along the view.
    """
    rho = float(np.hypot(seen.q[:, 0], seen.q[:, 1]).max())
    out = [_ring(rho, rho**2 / (4.0 * focal))]
    for side in _across(seen)[:1]:
        along = np.array([side[1], -side[0], 0.0])
        away = 2.0 * focal * seen.towards[2] / float(seen.towards @ along)
        if abs(away) < rho:
            half = float(np.sqrt(rho**2 - away**2))
            line = away * along + np.linspace(-half, half, STEPS + 1)[:, None] * side
            line[:, 2] = np.sum(line**2, axis=1) / (4.0 * focal)
            out.append(line)
    return out


def wire_lines(seen: Seen, sag: float, length: float) -> list[Array]:
    """Return the wire (0, t, 0) + 4 s (τ² − τ) g, see `wires`."""
    tau = np.linspace(0.0, 1.0, STEPS + 1)[:, None]
    return [tau * [0.0, length, 0.0] + 4.0 * sag * (tau**2 - tau) * seen.up]


def wire_ends(sag: float, length: float) -> Array:
    """Return both fixings of a wire, (2, 3)."""
    return np.array([[0.0, 0.0, 0.0], [0.0, length, 0.0]])


PLANE = Outline("plane", plane_lines)
LINE = Outline("line", line_lines)
CIRCLE = Outline("circle", circle_lines, ("radius", "height"), zero_place, "the centre of a circle")
CYLINDER = Outline("cylinder", cylinder_lines, ("radius",))
SPHERE = Outline("sphere", sphere_lines, ("radius",), zero_place, "the centre of a sphere")
CONE = Outline("cone", cone_lines, ("angle",), zero_place, "the apex of a cone")
TORUS = Outline("torus", torus_lines, ("radius", "ring"), zero_place, "the centre of a torus")
PARABOLOID = Outline(
    "paraboloid", paraboloid_lines, ("focal",), zero_place, "the apex of a paraboloid"
)
WIRE = Outline("stretched wire", wire_lines, ("sag", "length"), wire_ends, "the end of a wire")
