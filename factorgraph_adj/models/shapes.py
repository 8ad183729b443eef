"""Shapes by equations, sizes; relations of points: ratios, right angles, directions, differences.

A shape is a frame, and its equation is a function f(q) = 0 in this frame: q is the place of a point
in it, see `sub_frame`, ρ = √(q₁² + q₂²). The frame has the scale one, so that residuals are metres;
they are distances from the shape along its normal (of a line and a circle: two distances across
each other).

| shape | f(q) | free components of the frame | sizes |
| --- | --- | --- | --- |
| plane | q₃ | rx ry z | |
| line | q₁, q₂ | rx ry x y | |
| circle | q₃ − h, ρ − r | rx ry x y z | r, h = 0 |
| cylinder | ρ − r | rx ry x y | r |
| sphere | |q| − r | x y z | r |
| cone | ρ cos α − q₃ sin α | rx ry x y z | α |
| torus | √((ρ − A)² + q₃²) − r | rx ry x y z | r, A |
| paraboloid | (q₃ − ρ²/4F) / √(1 + ρ²/4F²) | rx ry x y z | F |

Components that are not free are held by the symmetry of the shape: its place along an axis or in a
plane, its rotation about an axis. The distance from a paraboloid is that of first order,
f/|∇f|. (FRAMES F10; Kager, GESTALT.)

Without a shape: equal distances and heights, right angles, directions (FRAMES F10.3, F10.4; Comp3D
codes 9, 14, 15, 21, 22).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from ..frames import Frame
from ..types import Array
from . import shape_outlines
from .base import Linearised, require
from .line_of_sight import turned_by_angles
from .positions import heights
from .shape_outlines import Outline
from .sub_frame import horizons, in_frame

NO_LENGTH = "two of its points are the same place: the direction between them is open"
ON_THE_AXIS = "the point lies on the axis of the shape: the direction of its distance is open"
AT_THE_CENTRE = "the point lies in the centre of the shape: the direction of its distance is open"
_TILTS, _ALL = ("rx", "ry"), ("rx", "ry", "x", "y", "z")


def _pair(
    a: tuple[Array, Array, Array],
    b: tuple[Array, Array, Array],
    ratio: Array,
    observed: Array,
    shared: bool,
) -> Linearised:
    """Return a − ratio · b − observed with partials by the points A, B, C, D; C may be A."""
    k = ratio[:, None]
    v = (a[0] - ratio * b[0])[:, None] - observed
    by = [a[1], a[2], -k * b[1], -k * b[2]]
    if shared:
        by = [by[0] + by[2], by[1], by[3]]
    return Linearised(v, tuple(j[:, None] for j in by))


def _length(a: Array, b: Array) -> tuple[Array, Array, Array]:
    """Return |AB| and its partials by A and B."""
    d = b - a
    length = np.linalg.norm(d, axis=1)
    require(length > 0, NO_LENGTH)
    e = d / length[:, None]
    return length, -e, e


def equal_distance(
    frame: Frame,
    station: Array,
    target: Array,
    station2: Array | None,
    target2: Array,
    *,
    observed: Array,
    ratio: Array,
) -> Linearised:
    """Compute |AB| − ratio · |CD| − observed, metres, (n, 1).

    Args:
        frame: not used.
        station: A, (n, 3).
        target: B, (n, 3).
        station2: C, (n, 3); None: A.
        target2: D, (n, 3).
        observed: (n, 1).
        ratio: (n,).
    """
    c = station if station2 is None else station2
    first, second = _length(station, target), _length(c, target2)
    return _pair(first, second, ratio, observed, station2 is None)


def equal_height_difference(
    frame: Frame,
    station: Array,
    target: Array,
    station2: Array | None,
    target2: Array,
    *,
    observed: Array,
    ratio: Array,
) -> Linearised:
    """Compute (h_B − h_A) − ratio · (h_D − h_C) − observed, metres, (n, 1); see `heights`.

    Args:
        frame: frame of the network.
        station: A, (n, 3).
        target: B, (n, 3).
        station2: C, (n, 3); None: A.
        target2: D, (n, 3).
        observed: (n, 1).
        ratio: (n,).
    """
    c = station if station2 is None else station2
    (ha, ga), (hb, gb), (hc, gc), (hd, gd) = (
        heights(frame, x) for x in (station, target, c, target2)
    )
    first, second = (hb - ha, -ga, gb), (hd - hc, -gc, gd)
    return _pair(first, second, ratio, observed, station2 is None)


def right_angle(
    frame: Frame, station: Array, target: Array, target2: Array, *, observed: Array
) -> Linearised:
    """Compute eᵀf − observed, radians, (n, 1): the cosine of the angle at B in space.

    e = (A − B)/|AB| and f = (C − B)/|CB|; near a right angle it is π/2 less the angle.

    Args:
        frame: not used.
        station: B, (n, 3).
        target: A, (n, 3).
        target2: C, (n, 3).
        observed: (n, 1).
    """
    (s, _, e), (t, _, f) = _length(station, target), _length(station, target2)
    cosine = np.einsum("ni,ni->n", e, f)[:, None]
    by_a, by_c = (f - cosine * e) / s[:, None], (e - cosine * f) / t[:, None]
    return Linearised(cosine - observed, tuple(j[:, None] for j in (-by_a - by_c, by_a, by_c)))


def across(u: Array) -> Array:
    """Return two unit vectors T (n, 2, 3) across each other and across unit vectors (n, 3)."""
    least = np.eye(3)[np.argmin(np.abs(u), axis=1)]
    first = np.cross(u, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(u, first)], axis=1)


def point_direction(
    frame: Frame,
    station: Array,
    target: Array,
    *,
    observed: Array,
    ux: Array,
    uy: Array,
    uz: Array,
) -> Linearised:
    """Compute T e − observed, radians, (n, 2): the direction between two points across a given one.

    e = (X_j − X_i)/|X_j − X_i|, and T are two unit vectors across the given direction u.

    Args:
        frame: not used.
        station: X_i, (n, 3).
        target: X_j, (n, 3).
        observed: (n, 2).
        ux: component of u along x, (n,).
        uy: along y, (n,).
        uz: along z, (n,).
    """
    u = np.stack([ux, uy, uz], axis=1)
    t = across(u / np.linalg.norm(u, axis=1, keepdims=True))
    length, _, e = _length(station, target)
    along = np.einsum("nij,nj->ni", t, e)
    by = (t - along[:, :, None] * e[:, None]) / length[:, None, None]
    return Linearised(along - observed, (-by, by))


def coordinate_difference(
    frame: Frame,
    station: Array,
    vertical: Array,
    target: Array,
    *,
    observed: Array,
    horizon: Array,
    axes: tuple[int, ...] = (0, 1, 2),
) -> Linearised:
    """Compute the observed axes of E (X_j − X_i) − observed, metres, (n, d).

    E is the horizon (east, north, up) at the station, or the identity: axes of the network.

    Args:
        frame: frame of the network.
        station: X_i, (n, 3).
        vertical: deflections (ξ, η) at the station, (n, 2).
        target: X_j, (n, 3).
        observed: (n, d).
        horizon: 1 for east, north, up at the station, 0 for the axes of the network, (n,).
        axes: numbers of the observed axes.
    """
    rows = list(axes)
    basis = frame.basis(station, vertical)
    e = horizons(basis, horizon)
    d = np.einsum("nij,nj->ni", e, target - station)
    by_angles = (horizon != 0)[:, None, None] * turned_by_angles(d, basis)
    by = (
        by_angles @ basis.angles_by_position - e,
        by_angles @ basis.angles_by_vertical,
        e,
    )
    return Linearised(d[:, rows] - observed, tuple(j[:, rows] for j in by))


class Distances(NamedTuple):
    """Distances of n places from shapes, and their partials."""

    f: Array
    """Distances, (n, d)."""
    by_q: Array
    """∂f/∂q, (n, d, 3)."""
    by_sizes: tuple[Array, ...]
    """∂f/∂(each size), (n, d)."""


FromSizes: TypeAlias = Callable[..., Distances]
"""(q (n, 3), sizes (n,) …) → distances."""


@dataclass(frozen=True)
class Size:
    """A size of a shape, an unknown that observations may share."""

    attribute: str
    """Attribute of observations that names it."""
    kind: str = "size"
    """Kind of the unknown."""
    suffix: str | None = ""
    """What its name has behind that of the shape, if an observation names none; None: it is then
    held at zero."""
    lifts: bool = False
    """Whether it is the place of the centre along the axis."""


@dataclass(frozen=True)
class Shape:
    """A shape: its equation, and what is unknown of it. It is the model of its observations."""

    name: str
    """Name of the shape."""
    distances: FromSizes
    """The equation."""
    free: tuple[str, ...]
    """Components of the frame that are free; those that symmetry leaves open are held."""
    sizes: tuple[Size, ...] = ()
    """Its sizes."""
    turns: bool = False
    """Whether its distances are those of two directions across its axis, which turn about it with
    the object: so does the residual, while the frame is held about its axis."""
    linear: bool = False
    """Whether its distances are linear in the coordinates in its frame."""
    axis: Literal["least", "most", "any"] = "any"
    """Where its z axis lies: along the least or the largest extent of its points, or anywhere."""
    outline: Outline = field(kw_only=True)
    """How it is drawn."""

    @property
    def slides(self) -> tuple[int, ...]:
        """Axes of the frame along which symmetry leaves the place open.

        They are those in a plane, and the axis of a line or a cylinder; a shape with a centre or
        an apex has none.
        """
        return tuple(i for i, a in enumerate("xyz") if a not in self.free)

    @property
    def has_axis(self) -> bool:
        """Whether the shape has a normal or an axis, its z axis; a sphere has none."""
        return "rx" in self.free

    def __call__(
        self,
        frame: Frame,
        stored: Array,
        point: Array,
        origin: Array | None,
        vertical: Array | None,
        *sizes: Array,
        observed: Array,
        **_: Array,
    ) -> Linearised:
        """Compute f(q) − observed, metres, (n, d).

        Args:
            frame: frame of the network.
            stored: frames of the shapes, (n, 17).
            point: X, (n, 3).
            origin: O where it is a point, (n, 3).
            vertical: deflections at O, (n, 2).
            sizes: each size, (n, 1).
            observed: distances from the shapes, (n, d).
        """
        there = in_frame(frame, stored, point, origin, vertical)
        found = self.distances(there.q, *(s[:, 0] for s in sizes))
        parts = (there.by_frame, there.by_place, there.by_origin, there.by_vertical)
        given = (stored, point, origin, vertical)
        chained = (found.by_q @ j for j, g in zip(parts, given, strict=True) if g is not None)
        by_sizes = (s[:, :, None] for s in found.by_sizes)
        return Linearised(found.f - observed, (*chained, *by_sizes))


def _rho(q: Array) -> tuple[Array, Array]:
    """Return ρ (n,) and ∂ρ/∂q (n, 3)."""
    rho = np.hypot(q[:, 0], q[:, 1])
    require(rho > 0, ON_THE_AXIS)
    by_q = q / rho[:, None]
    by_q[:, 2] = 0.0
    return rho, by_q


def _rows(q: Array, *axes: int) -> Array:
    """Return the unit vectors of axes for every place, (n, d, 3)."""
    return np.broadcast_to(np.eye(3)[list(axes)], (len(q), len(axes), 3))


def plane(q: Array) -> Distances:
    """Return q₃."""
    return Distances(q[:, 2:], _rows(q, 2), ())


def line(q: Array) -> Distances:
    """Return q₁ and q₂."""
    return Distances(q[:, :2], _rows(q, 0, 1), ())


def circle(q: Array, radius: Array, height: Array) -> Distances:
    """Return q₃ − h and ρ − r."""
    rho, by_q = _rho(q)
    f = np.stack([q[:, 2] - height, rho - radius], axis=1)
    one, zero = np.ones(len(q)), np.zeros(len(q))
    by_sizes = (np.stack([zero, -one], 1), np.stack([-one, zero], 1))
    return Distances(f, np.stack([_rows(q, 2)[:, 0], by_q], axis=1), by_sizes)


def cylinder(q: Array, radius: Array) -> Distances:
    """Return ρ − r."""
    rho, by_q = _rho(q)
    return Distances((rho - radius)[:, None], by_q[:, None], (-np.ones((len(q), 1)),))


def sphere(q: Array, radius: Array) -> Distances:
    """Return |q| − r."""
    away = np.linalg.norm(q, axis=1)
    require(away > 0, AT_THE_CENTRE)
    by_q = (q / away[:, None])[:, None]
    return Distances((away - radius)[:, None], by_q, (-np.ones((len(q), 1)),))


def cone(q: Array, angle: Array) -> Distances:
    """Return ρ cos α − q₃ sin α; α between the axis and the lines of the cone, apex at q = 0."""
    rho, by_q = _rho(q)
    c, s = np.cos(angle), np.sin(angle)
    by_q = by_q * c[:, None]
    by_q[:, 2] = -s
    f = rho * c - q[:, 2] * s
    return Distances(f[:, None], by_q[:, None], ((-rho * s - q[:, 2] * c)[:, None],))


def torus(q: Array, radius: Array, ring: Array) -> Distances:
    """Return √((ρ − A)² + q₃²) − r, with the radius A of the ring of the centres."""
    rho, outwards = _rho(q)
    off = rho - ring
    away = np.hypot(off, q[:, 2])
    require(away > 0, AT_THE_CENTRE)
    by_q = outwards * (off / away)[:, None]
    by_q[:, 2] = q[:, 2] / away
    by_sizes = (-np.ones((len(q), 1)), (-off / away)[:, None])
    return Distances((away - radius)[:, None], by_q[:, None], by_sizes)


def paraboloid(q: Array, focal: Array) -> Distances:
    """Return (q₃ − ρ²/4F) / √(1 + ρ²/4F²), apex at q = 0; F < 0: it opens against z."""
    square = q[:, 0] ** 2 + q[:, 1] ** 2
    k = 0.25 / focal
    algebraic = q[:, 2] - k * square
    steep = np.sqrt(1.0 + 4.0 * k**2 * square)
    f = algebraic / steep
    by_q = -2.0 * (k / steep + 2.0 * k**2 * f / steep**2)[:, None] * q
    by_q[:, 2] = 1.0 / steep
    by_k = -square / steep - 4.0 * k * square * f / steep**2
    return Distances(f[:, None], by_q[:, None], ((-by_k * k / focal)[:, None],))


_RADIUS = Size("radius")
SHAPES = {
    s.name: s
    for s in (
        Shape(
            "plane",
            plane,
            (*_TILTS, "z"),
            linear=True,
            axis="least",
            outline=shape_outlines.PLANE,
        ),
        Shape(
            "line",
            line,
            (*_TILTS, "x", "y"),
            turns=True,
            linear=True,
            axis="most",
            outline=shape_outlines.LINE,
        ),
        Shape(
            "circle",
            circle,
            _ALL,
            (_RADIUS, Size("height", suffix=None, lifts=True)),
            axis="least",
            outline=shape_outlines.CIRCLE,
        ),
        Shape(
            "cylinder", cylinder, (*_TILTS, "x", "y"), (_RADIUS,), outline=shape_outlines.CYLINDER
        ),
        Shape("sphere", sphere, ("x", "y", "z"), (_RADIUS,), outline=shape_outlines.SPHERE),
        Shape("cone", cone, _ALL, (Size("angle", "angle"),), outline=shape_outlines.CONE),
        Shape(
            "torus",
            torus,
            _ALL,
            (_RADIUS, Size("ring", suffix=" ring")),
            outline=shape_outlines.TORUS,
        ),
        Shape("paraboloid", paraboloid, _ALL, (Size("focal"),), outline=shape_outlines.PARABOLOID),
    )
}
"""Shapes by name."""
