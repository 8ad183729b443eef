"""Adjusted lines between places, places of frames, shapes with axes and sizes; precision of all.

An adjusted line between two places has a distance, an azimuth, a rise and a relative error ellipse.

A place that keeps its coordinates q in a frame of its own moves with the frame, its origin and the
vertical there, from the one definition of q (`factorgraph_adj.models.sub_frame`):

    q(X) = q₀              dX = −(∂q/∂X)⁻¹ ∂q/∂(frame, origin, vertical)

The place q₀ = 0 is that of the instrument of a frame, X = O + Eᵀ e^ℓ R c.

A shape is a frame, and its unknowns are those of the frame. With the place q₀ in the frame that
represents the shape,

    X₀: q(X₀) = q₀              dX₀ = −(∂q/∂X)⁻¹ ∂q/∂(frame, origin, vertical)
    a = X(q₀ + e₃) − X(q₀)      da = dX(q₀ + e₃) − dX(q₀)

q₀ is the centre or the apex of a shape that has one. A plane, a line and a cylinder have places
that symmetry leaves open: q₀ is then the place of the shape that is nearest to the middle of its
points, which is no unknown, and only what moves the shape counts: the part of dX₀ along the normal
of a plane, or across an axis.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from math import sqrt

import numpy as np

from ..blas_threads import with_one_thread
from ..errors import taking
from ..frames import Frame
from ..graph.blocks import Block
from ..models.base import within
from ..models.shapes import SHAPES, Shape
from ..models.sub_frame import InFrame, from_frame, horizons, in_frame, split_frame
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..network.network import Network
from ..observations import observation_kind
from ..solve.estimates import Estimate
from ..solve.solution import Solution
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..types import Array
from .error_ellipses import ErrorEllipse, solution_ellipses
from .point_precision import Place, length_and_sigma, place_covariance, place_position

UPRIGHT_SINE = 1e-12
"""Sine of a tilt below which an axis has no azimuth."""
FRAME_VARIABLE_KINDS = ("frame", "point", "vertical")
"""Kinds of the variables that give a frame its place."""
PLACE_COMPONENTS = ("X", "Y", "Z")
"""Names of the coordinates of a place in the frame of the network."""


@dataclass(frozen=True)
class AdjustedLine:
    """The line from one place to another after the adjustment, from mark to mark."""

    a: Place
    """First place."""
    b: Place
    """Second place."""
    distance: float
    """Slope distance, metres."""
    sigma_distance: float
    """Its standard deviation, metres; zero between held places, NaN for places that coincide."""
    azimuth: float
    """Azimuth at ``a``, clockwise from north, radians in [0, 2π); NaN for a plumb line."""
    sigma_azimuth: float
    """Its standard deviation, radians; NaN for a plumb line."""
    rise: float
    """Height difference b − a along the vertical of the midpoint, metres."""
    sigma_rise: float
    """Its standard deviation, metres."""
    ellipse: ErrorEllipse
    """Relative error ellipse."""

    @property
    def ppm(self) -> float:
        """σ of the distance in parts per million of it."""
        return 1e6 * self.sigma_distance / self.distance if self.distance > 0 else np.nan


def observed_pairs(network: Network) -> list[tuple[Place, Place]]:
    """Return the pairs of points that observations join, in their order, each once.

    An angle joins its station with both of its targets. Pairs of held points are left out.
    """
    found: dict[frozenset[str], tuple[Place, Place]] = {}
    for o in network.observations.values():
        station, *others = o.points() or ("",)
        for target in others:
            held = all(all(network.points[n].fixed) for n in (station, target))
            if station != target and not held:
                found.setdefault(frozenset((station, target)), (station, target))
    return list(found.values())


@taking(Solution)
@with_one_thread
def adjusted_lines(
    solution: Solution,
    pairs: Sequence[tuple[Place, Place]] | None = None,
    *,
    confidence: float | None = CONFIDENCE_OF_REGION,
) -> tuple[AdjustedLine, ...]:
    """Return adjusted distances, azimuths and rises between places with relative error ellipses.

    With d = X_b − X_a, Σ_Δ its covariance with all cross-covariances, e, n, u the horizon at a and
    u' the vertical of the midpoint:

        distance |d|             σ² = dᵀ Σ_Δ d / |d|²
        azimuth atan2(e·d, n·d)  σ² = tᵀ Σ_Δ t / s², t = e cos α − n sin α, s² = (e·d)² + (n·d)²
        rise u'·d                σ² = u'ᵀ Σ_Δ u'

    Shifts of the datum cancel in all of them on a plane. In curved frames the turn of the
    verticals with the datum, of the order of s/R, is left out of σ of azimuth and rise.

    Args:
        solution: an adjusted network.
        pairs: pairs of places: names of points, or ``("pose", name)`` for projection centres;
            None: the pairs that observations join.
        confidence: probability of the ellipses; None: standard ellipses.

    Raises:
        InputError: unknown names, two identical places, confidence outside (0, 1).
    """
    every = observed_pairs(solution.network) if pairs is None else list(pairs)
    sigma = np.array([place_covariance(solution, a, b) for a, b in every]).reshape(-1, 3, 3)
    start = np.array([place_position(solution, a) for a, _ in every]).reshape(-1, 3)
    end = np.array([place_position(solution, b) for _, b in every]).reshape(-1, 3)
    centre, d = (start + end) / 2.0, end - start
    ellipses = solution_ellipses(solution, list(every), centre, sigma, confidence)
    azimuths, sigma_azimuths = _azimuths(_horizon(solution, start), d, sigma)
    up = _horizon(solution, centre)[:, 2]
    rises = np.einsum("ni,ni->n", up, d)
    sigma_rises = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", up, sigma, up), 0.0))
    out = []
    for i, (a, b) in enumerate(every):
        distance, sigma_distance = length_and_sigma(d[i], sigma[i])
        azimuth, sigma_azimuth = float(azimuths[i]), float(sigma_azimuths[i])
        rise, sigma_rise = float(rises[i]), float(sigma_rises[i])
        figures = (distance, sigma_distance, azimuth, sigma_azimuth, rise, sigma_rise)
        out.append(AdjustedLine(a, b, *figures, ellipses[i]))
    return tuple(out)


def _horizon(solution: Solution, at: Array) -> Array:
    """Return east, north, up of positions (n, 3) as rows (n, 3, 3)."""
    return solution.network.frame.basis(at, np.zeros((len(at), 2))).enu


def _azimuths(enu: Array, d: Array, sigma: Array) -> tuple[Array, Array]:
    """Return azimuths (n,) and their standard deviations; NaN for plumb lines."""
    east, north = (np.einsum("ni,ni->n", enu[:, i], d) for i in (0, 1))
    level = np.hypot(east, north)
    there = level > 0
    azimuth = np.where(there, within(np.arctan2(east, north)), np.nan)
    across = enu[:, 0] * np.cos(azimuth)[:, None] - enu[:, 1] * np.sin(azimuth)[:, None]
    variance = np.einsum("ni,nij,nj->n", across, sigma, across)
    safe = np.where(there, level, 1.0)
    return azimuth, np.sqrt(np.maximum(variance, 0.0)) / safe


@dataclass(frozen=True, eq=False)
class AdjustedFrame:
    """A frame of its own after the adjustment."""

    frame: Frame
    """Frame of the network."""
    state: dict[VariableKind, Array]
    """Stored values (1, s) of frame, origin and vertical, as far as the frame has them."""

    def there(self, place: Array) -> InFrame:
        """Return a place (3,) in the frame, with partials."""
        get = self.state.get
        return in_frame(self.frame, self.state["frame"], place[None], get("point"), get("vertical"))

    @property
    def origin(self) -> Array:
        """O, (3,) metres."""
        constant = split_frame(self.state["frame"]).origin
        return np.asarray(self.state.get("point", constant)[0])

    @property
    def place(self) -> Array:
        """The place of q = 0 in the frame of the network, (3,) metres."""
        at, stored = self.origin[None], self.state["frame"]
        vertical = self.state.get("vertical", np.zeros((1, 2)))
        level = split_frame(stored).level
        horizon = np.eye(3)[None]
        if level.any():
            horizon = horizons(self.frame.basis(at, vertical), level)
        return np.asarray(from_frame(stored, np.zeros((1, 3)), at, horizon)[0])

    def moves(self, place: Array, kind: VariableKind) -> Array:
        """Return ∂X/∂(variable) (3, k) of a place that keeps its coordinates q in the frame."""
        found = self.there(place)
        by = {"frame": found.by_frame, "point": found.by_origin, "vertical": found.by_vertical}
        return np.asarray(-np.linalg.solve(found.by_place[0], by[kind][0]))


def place_of_frame(solution: Solution, name: str) -> Estimate:
    """Return where a frame of its own has its zero: the place of a scanner, tracker or station.

    Args:
        solution: an adjusted network.
        name: name of the frame.

    Returns:
        X, Y, Z in the frame of the network, metres, with standard deviations and correlations.

    Raises:
        InputError: no frame has this name; the error lists those that are there.
    """
    number = solution.number("frame", name)
    stated, unknowns = solution.network.frames[name], solution.equations.unknowns
    variables = [("frame", number)]
    if stated.origin:
        variables.append(("point", unknowns["point"].number[stated.origin]))
        vertical = unknowns["vertical"].number.get(stated.origin)
        if vertical is not None:
            variables.append(("vertical", vertical))
    posed = AdjustedFrame(
        solution.network.frame, {kind: solution.state[kind][[n]] for kind, n in variables}
    )
    place = posed.place
    names = [(kind, unknowns[kind].names[n]) for kind, n in variables]
    joint = np.block([[solution.variable_covariance(a, b) for b in names] for a in names])
    by = np.concatenate([posed.moves(place, kind) for kind, _ in variables], axis=1)
    covariance = by @ joint @ by.T
    sigmas = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    safe = np.where(sigmas > 0, sigmas, 1.0)
    return Estimate(PLACE_COMPONENTS, place, sigmas, covariance / np.outer(safe, safe))


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
class _ShapeMeasurements:
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


def _seen(solution: Solution) -> dict[tuple[str, tuple[int, ...]], _ShapeMeasurements]:
    """Return what was measured on each shape, by its kind, frame and sizes."""
    found: dict[tuple[str, tuple[int, ...]], _ShapeMeasurements] = {}
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
            seen = found.setdefault((shape, told), _ShapeMeasurements(variables, names, set(), []))
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
        elif kind not in ("pose", "calibration") and not UNKNOWNS[kind].in_photo:
            own.append(i)
    return own, on


def _adjusted(solution: Solution, shape: Shape, seen: _ShapeMeasurements) -> AdjustedShape:
    """Return one shape."""
    names = [(kind, solution.equations.unknowns[kind].names[n]) for kind, n in seen.variables]
    sizes = _adjusted_sizes(solution, shape, dict(zip(seen.attributes, names, strict=True)))
    lift = sum(z.value for z in sizes if _lifts(shape, z.attribute))
    state = {
        kind: solution.state[kind][[n]]
        for kind, n in seen.variables
        if kind in FRAME_VARIABLE_KINDS
    }
    posed = AdjustedFrame(solution.network.frame, state)
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
    if level < UPRIGHT_SINE:
        return tilt, _root(float(np.linalg.eigvalsh(covariance)[-1])), np.nan, np.nan
    azimuth = float(within(np.arctan2(east, north)))
    away = (enu[0] * east + enu[1] * north) / level
    downwards = away * up - enu[2] * level
    across = (enu[0] * north - enu[1] * east) / level
    sigma_tilt = _root(float(downwards @ covariance @ downwards))
    return tilt, sigma_tilt, azimuth, _root(float(across @ covariance @ across)) / level


def _root(variance: float) -> float:
    return sqrt(max(variance, 0.0))
