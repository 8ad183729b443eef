"""Adjusted shapes as engineers state them: a place, a normal or an axis, sizes, residuals.

A shape is a frame, and its unknowns are those of the frame. With the place q₀ in the frame that
stands for the shape,

    X₀: q(X₀) = q₀              dX₀ = −(∂q/∂X)⁻¹ ∂q/∂(frame, origin, vertical)
    a = X(q₀ + e₃) − X(q₀)      da = dX(q₀ + e₃) − dX(q₀)

all from the one definition of q (`factorgraph_adj.models.sub_frame`). q₀ is the centre or the apex
of a shape that has one. A plane, a line and a cylinder have places that symmetry leaves open: q₀ is
then the place of the shape that is nearest to the middle of its points, which is no unknown, and
only what moves the shape counts: the part of dX₀ along the normal of a plane, or across an axis.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import sqrt

import numpy as np

from ..graph.blocks import Block
from ..models.base import within
from ..models.shapes import SHAPES, Shape
from ..models.variables import VariableKind
from ..observations import observation_kind
from ..solve.solution import Solution
from ..types import Array
from .posed import POSED, Posed

UPRIGHT = 1e-12
"""Sine of a tilt below which an axis has no azimuth."""


@dataclass(frozen=True)
class AdjustedSize:
    """An adjusted size of a shape."""

    attribute: str
    """What it is: radius, ring, angle, focal, height."""
    kind: VariableKind
    """Kind of the unknown."""
    name: str
    """Name of the unknown."""
    value: float
    """Value, metres; radians for an angle."""
    sigma: float
    """Standard deviation, unit of the value; zero: it was held."""


@dataclass(frozen=True, eq=False)
class AdjustedShape:
    """A shape after the adjustment, in the frame of the network."""

    name: str
    """Name of the shape, which is that of its frame."""
    shape: str
    """plane, line, circle, cylinder, sphere, cone, torus or paraboloid."""
    points: int
    """Number of points on it; of a line in images that of its image points."""
    place: Array
    """Centre or apex; otherwise the place of the shape nearest to the middle of its points, (3,)
    metres."""
    covariance: Array
    """Covariance of ``place``, (3, 3) metres²; of a plane along the normal, of a line and a
    cylinder across the axis."""
    axis: Array
    """Unit vector of the normal or the axis, the z axis of its frame, (3,); NaN: a sphere."""
    axis_covariance: Array
    """Covariance of ``axis``, (3, 3), of rank two."""
    tilt: float
    """Angle between the axis and the vertical at ``place``, radians in [0, π]; NaN: a sphere."""
    sigma_tilt: float
    """Its standard deviation, radians; of an upright axis the largest one of its direction."""
    azimuth: float
    """Azimuth of the axis, clockwise from north, radians in [0, 2π); NaN: it is upright."""
    sigma_azimuth: float
    """Its standard deviation, radians."""
    sizes: tuple[AdjustedSize, ...]
    """Radius, angle and other sizes."""
    rms: float
    """Root mean square of the residuals, metres; NaN: residuals are no lengths."""
    largest: float
    """Largest residual of a point, metres: with two components their resultant."""


@dataclass
class _Seen:
    """What was measured on a shape."""

    variables: tuple[tuple[VariableKind, int], ...]
    """Kinds and numbers of the variables beside points and photos on it: the frame comes first."""
    attributes: tuple[str, ...]
    """Attributes that name them."""
    on: set[tuple[str, int]]
    """Points on it, or observations in images."""
    residuals: list[Array]
    """Residuals (n, d) that are lengths."""


def adjusted_shapes(solution: Solution) -> tuple[AdjustedShape, ...]:
    """Return the shapes of a network as engineers state them.

    A frame with two shapes, or with two radii, is listed for each of them. In curved frames the
    turn of the vertical with the place is left out of the standard deviation of the tilt.

    Args:
        solution: an adjusted network.
    """
    return tuple(_adjusted(solution, SHAPES[key[0]], seen) for key, seen in _seen(solution).items())


def _seen(solution: Solution) -> dict[tuple[str, tuple[int, ...]], _Seen]:
    """Return what was measured on each shape, by its kind, frame and sizes."""
    found: dict[tuple[str, tuple[int, ...]], _Seen] = {}
    for block in solution.equations.blocks:
        shape = "" if block.prior or not block.named else observation_kind(block.kind).shape
        if not shape:
            continue
        own, on = _columns(block)
        numbers = np.stack([block.arguments[i][1] for i in own], axis=1)
        v = solution.observations.residuals[block.rows].reshape(block.observed.shape)
        for key in np.unique(numbers, axis=0).tolist():
            rows = np.flatnonzero((numbers == key).all(axis=1))
            variables = tuple((block.arguments[i][0], n) for i, n in zip(own, key, strict=True))
            names = tuple(block.named[i] for i in own)
            # Without its origin, which follows from the frame.
            told = tuple(n for n, a in zip(key, names, strict=True) if "." not in a)
            seen = found.setdefault((shape, told), _Seen(variables, names, set(), []))
            if on is None:
                seen.on |= {(block.kind, int(i)) for i in rows}
            else:
                seen.on |= {("point", int(i)) for i in block.arguments[on][1][rows]}
            if block.unit == "m":
                seen.residuals.append(v[rows])
    return found


def _columns(block: Block) -> tuple[list[int], int | None]:
    """Return the places of frame, origin, vertical and sizes among variables, and of the point."""
    own, on = [], None
    for i, ((kind, _), attribute) in enumerate(zip(block.arguments, block.named, strict=True)):
        if kind == "point" and "." not in attribute:
            on = i
        elif kind not in ("pose", "calibration"):
            own.append(i)
    return own, on


def _adjusted(solution: Solution, shape: Shape, seen: _Seen) -> AdjustedShape:
    """Return one shape."""
    names = [(kind, solution.equations.unknowns[kind].names[n]) for kind, n in seen.variables]
    sizes = _adjusted_sizes(solution, shape, dict(zip(seen.attributes, names, strict=True)))
    lift = sum(z.value for z in sizes if _lifts(shape, z.attribute))
    state = {kind: solution.state[kind][[n]] for kind, n in seen.variables if kind in POSED}
    posed = Posed(solution.network.frame, state)
    points = [n for what, n in seen.on if what == "point"]
    near = solution.state["point"][points].mean(axis=0) if points else posed.origin
    there = posed.there(near)
    out_of = np.linalg.inv(there.by_place[0])
    wanted, slides = np.array([0.0, 0.0, lift]), list(shape.slides)
    wanted[slides] = there.q[0, slides]
    place = near + out_of @ (wanted - there.q[0])
    length = float(np.linalg.norm(out_of[:, 2]))
    axis = out_of[:, 2] / length

    def moves(x: Array) -> Array:
        """Return ∂X/∂(all variables) (3, k) of a place that keeps its place in the shape."""
        parts = [
            posed.moves(x, kind) if kind in state else out_of[:, 2:] * _lifts(shape, attribute)
            for (kind, _), attribute in zip(names, seen.attributes, strict=True)
        ]
        return np.concatenate(parts, axis=1)

    joint = np.block([[solution.variable_covariance(a, b) for b in names] for a in names])
    along = np.outer(axis, axis)
    across = np.eye(3) - along
    by_place = moves(place)
    by_axis = across @ (moves(place + out_of[:, 2]) - by_place) / length
    if slides:
        by_place = (across if len(slides) == 1 else along) @ by_place
    of_axis = by_axis @ joint @ by_axis.T
    if not shape.has_axis:
        axis, of_axis = np.full(3, np.nan), np.full((3, 3), np.nan)
    enu = solution.network.frame.basis(place[None], np.zeros((1, 2))).enu[0]
    return AdjustedShape(
        names[0][1],
        shape.name,
        len(points) or len(seen.on),
        place,
        by_place @ joint @ by_place.T,
        axis,
        of_axis,
        *_directions(enu, axis, of_axis),
        tuple(z for z in sizes if z.value != 0 or z.sigma != 0 or not _lifts(shape, z.attribute)),
        *_sizes_of(seen.residuals),
    )


def _adjusted_sizes(
    solution: Solution, shape: Shape, names: dict[str, tuple[VariableKind, str]]
) -> list[AdjustedSize]:
    """Return the sizes of a shape, with kinds and names of its variables by attribute."""
    out = []
    for attribute in (z.attribute for z in shape.sizes if z.attribute in names):
        kind, name = names[attribute]
        e = solution.unknown(kind, name)
        value, sigma = float(e.values[0]), float(e.sigmas[0])
        out.append(AdjustedSize(attribute, kind, name, value, sigma))
    return out


def _lifts(shape: Shape, attribute: str) -> float:
    """Return 1 for a size that is the place of the centre along the axis, otherwise 0."""
    return float(any(s.lifts for s in shape.sizes if s.attribute == attribute))


def _sizes_of(residuals: Iterable[Array]) -> tuple[float, float]:
    """Return the root mean square of residuals and the largest resultant; NaN without any."""
    found = list(residuals)
    if not found:
        return np.nan, np.nan
    v = np.concatenate(found)
    return float(np.sqrt(np.mean(v**2))), float(np.linalg.norm(v, axis=1).max())


def _directions(enu: Array, axis: Array, covariance: Array) -> tuple[float, float, float, float]:
    """Return tilt, its σ, azimuth and its σ of an axis; NaN where there is none."""
    if np.isnan(axis).any():
        return np.nan, np.nan, np.nan, np.nan
    east, north, up = (enu @ axis).tolist()
    level = float(np.hypot(east, north))
    tilt = float(np.arctan2(level, up))
    if level < UPRIGHT:
        return tilt, _root(float(np.linalg.eigvalsh(covariance)[-1])), np.nan, np.nan
    azimuth = float(within(np.arctan2(east, north)))
    away = (enu[0] * east + enu[1] * north) / level
    downwards = away * up - enu[2] * level
    across = (enu[0] * north - enu[1] * east) / level
    sigma_tilt = _root(float(downwards @ covariance @ downwards))
    return tilt, sigma_tilt, azimuth, _root(float(across @ covariance @ across)) / level


def _root(variance: float) -> float:
    return sqrt(max(variance, 0.0))
