"""Plan or side view: coordinates, covariances, ellipses, instruments in frames, shape outlines.

Outlines of shapes follow from their estimates and their points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal, TypeAlias

import numpy as np

from ...errors import SingularError
from ...frames import Frame, GeocentricFrame, LocalFrame
from ...graph.blocks import Block
from ...models.frame_axes import Axis, axis_of
from ...models.shape_outlines import Outline, Seen
from ...models.sub_frame import split_frame
from ...models.unknown_registry import VariableKind
from ...observations.registry import KINDS, ObservationKind
from ...solve.solution import Solution
from ...types import Array, Index
from .style import SKY, wrapped

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

ORIGIN_SUFFIX = ".origin"
"""End of the names of variables that stand at the origin of a frame."""
MAX_OUTLINE_EXTENT = 2.0
"""Largest outline that the window is enlarged for, as a multiple of the extent of the points."""
OUTLINE_MARGIN = 0.03
"""Room between such an outline and the edge of the window, as a fraction of the extent."""
View: TypeAlias = Literal["above", "south", "east"]
"""Direction from which a network is seen."""
PLAN_VIEWS = ("above", "south", "east")
OUTLINE_DASHES = ("-", (0, (6, 2)), (0, (4, 1.5, 1, 1.5)), (0, (1.5, 1.5)))
"""Line styles of outlines, in the order of the legend."""


def kind_of_block(block: Block) -> ObservationKind | None:
    """Return the record of the observations of a block; None for given values."""
    return None if block.prior or not block.named else KINDS.get(block.kind)


def variables_by_attribute(block: Block) -> dict[tuple[VariableKind, str], Index]:
    """Return the numbers of the variables of a block, by kind and attribute."""
    pairs = zip(block.arguments, block.named, strict=True)
    return {(kind, attribute): numbers for (kind, numbers), attribute in pairs}


def points_of(block: Block) -> Index:
    """Return the first point of each observation that is not the origin of its frame, (n,)."""
    return next(
        i
        for (k, a), i in variables_by_attribute(block).items()
        if k == "point" and not a.endswith(ORIGIN_SUFFIX)
    )


@dataclass(frozen=True, eq=False)
class FramePlaces:
    """Frames of a solution."""

    solution: Solution
    """The solution."""

    def axes(self, frame: int, q: Array, *, axis: int = 2) -> Axis:
        """Return the places X of coordinates q (k, 3) in a frame as `Axis.zero`, and its axis.

        X = O + Eᵀ e^ℓ R (q + c): q is the zero place of the frame with the offset q + c.
        """
        state, k = self.solution.state, len(q)
        stored = np.repeat(state["frame"][frame][None], k, axis=0)
        stored[:, 9:12] += q
        point, vertical = self._at(frame)
        return axis_of(
            self.solution.network.frame,
            stored,
            None if point is None else np.repeat(state["point"][point][None], k, axis=0),
            None if vertical is None else np.repeat(state["vertical"][vertical][None], k, axis=0),
            axis=axis,
        )

    def places(self, frame: int, q: Array) -> Array:
        """Return the places (k, 3) of coordinates q (k, 3) in a frame, metres."""
        return self.axes(frame, q).zero

    def coordinates(self, frame: int, places: Array) -> Array:
        """Return the coordinates q (k, 3) of places (k, 3) in a frame."""
        ln_scale = split_frame(self.solution.state["frame"][frame][None]).ln_scale
        away = places - self.places(frame, np.zeros((1, 3)))
        return np.asarray(np.exp(-ln_scale[0]) * away @ self.rotation(frame))

    def rotation(self, frame: int) -> Array:
        """Return the unit vectors of the axes of a frame in those of the network, as columns."""
        zero = np.zeros((1, 3))
        return np.stack([self.axes(frame, zero, axis=i).d[0] for i in range(3)], axis=1)

    def up(self, frame: int, near: Array) -> Array:
        """Return the vertical of a frame in its axes, (3,): that at its origin if it is level.

        Other frames take that of a place ``near`` (3,), as their origin may be anywhere.
        """
        stored = self.solution.state["frame"][frame]
        point, vertical = self._at(frame)
        at = stored[13:16] if point is None else self.solution.state["point"][point]
        angles = np.zeros(2) if vertical is None else self.solution.state["vertical"][vertical]
        at = at if stored[16] else near
        up = self.solution.network.frame.basis(at[None], angles[None]).enu[0, 2]
        return np.asarray(up @ self.rotation(frame))

    def covariances(self, frame: int, q: Array) -> Array:
        """Return the covariances (k, 3, 3) of places q of a frame, metres²."""
        names = self.solution.equations.unknowns
        point, vertical = self._at(frame)
        found = self.axes(frame, q)
        parts = [(("frame", names["frame"].names[frame]), found.zero_by[0])]
        if point is not None:
            parts.append((("point", names["point"].names[point]), found.zero_by[1]))
        if vertical is not None:
            parts.append((("vertical", names["vertical"].names[vertical]), found.zero_by[2]))
        out = np.zeros((len(q), 3, 3))
        for a, by_a in parts:
            for b, by_b in parts:
                block = self.solution.variable_covariance(a, None if a == b else b)
                out += by_a @ block @ by_b.transpose(0, 2, 1)
        return out

    def _at(self, frame: int) -> tuple[int | None, int | None]:
        """Return the numbers of the point and of the vertical at the origin of a frame."""
        point, vertical = (self._origins[kind][frame] for kind in ("point", "vertical"))
        return (None if point < 0 else int(point)), (None if vertical < 0 else int(vertical))

    @cached_property
    def _origins(self) -> dict[VariableKind, Index]:
        """Numbers of the points and verticals at the origins of the frames; −1: none."""
        n = len(self.solution.state["frame"])
        out = {kind: np.full(n, -1, dtype=np.intp) for kind in ("point", "vertical")}
        for block in self.solution.equations.blocks:
            if kind_of_block(block) is None:
                continue
            variables = variables_by_attribute(block)
            for (kind, attribute), numbers in variables.items():
                own = attribute.removesuffix(ORIGIN_SUFFIX)
                if own != attribute and ("frame", own) in variables:
                    out[kind][variables["frame", own]] = numbers
        return out

    @cached_property
    def instruments(self) -> Index:
        """Numbers of the frames in whose zero an instrument is set up, not over a point."""
        found: list[Index] = []
        for block in self.solution.equations.blocks:
            sighting = instrument_place(block)
            if sighting is not None and sighting[0] == "frame":
                found.append(sighting[1])
        return np.unique(np.concatenate([np.zeros(0, dtype=np.intp), *found]))

    @cached_property
    def instrument_covariances(self) -> Array | None:
        """Covariances of the instruments, (f, 3, 3); None without regular normal equations."""
        zero = np.zeros((1, 3))
        try:
            found = [self.covariances(f, zero)[0] for f in self.instruments.tolist()]
        except SingularError:
            return None
        return np.array(found).reshape(-1, 3, 3)


def instrument_place(block: Block) -> tuple[VariableKind, Index] | None:
    """Return where the instruments of a block stand: over points, or in frames of their own.

    A frame whose origin is a point has its instrument over that point (forced centring).
    """
    record = kind_of_block(block)
    if record is None or not record.instrument:
        return None
    variables = variables_by_attribute(block)
    for kind, attribute in (
        ("point", record.instrument),
        ("point", record.instrument + ORIGIN_SUFFIX),
        ("frame", record.instrument),
    ):
        if (kind, attribute) in variables:
            return kind, variables[kind, attribute]
    return None


@dataclass(frozen=True)
class DrawingPlane:
    """A horizontal or (seen from a side) vertical plane: (e, n, u) = axes · (X − origin)."""

    origin: Array
    """Point with e = n = u = 0, (3,) metres."""
    axes: Array
    """Unit vectors to the right, upwards and across the figure; from above e, n, u; (3, 3)."""
    names: tuple[str, str, str]
    """Names of the three axes, for labels."""
    note: str
    """Description of the plane, if the names of the axes are not sufficient."""

    def coordinates(self, xyz: Array) -> Array:
        """Return e, n, u (n, 3) of points (n, 3), metres."""
        return np.asarray((xyz - self.origin) @ self.axes.T)

    def covariance(self, sigma: Array) -> Array:
        """Return covariances (n, 3, 3) of e, n, u from those of X, Y, Z."""
        return np.asarray(self.axes @ sigma @ self.axes.T)

    def seen_from(self, view: View) -> DrawingPlane:
        """Return the plane for a view from above, from the south or from the east."""
        rows = {"above": [0, 1, 2], "south": [0, 2, 1], "east": [1, 2, 0]}[view]
        a, b, c = (self.names[i] for i in rows)
        return replace(self, axes=self.axes[rows], names=(a, b, c))


def drawing_plane_of(frame: Frame, xyz: Array) -> DrawingPlane:
    """Return the plan of points (n, 3).

    Local frames: the X, Y plane with north up, for axes in any direction and of either hand.
    Topocentric: east and north of the frame. Geocentric: the horizon (perpendicular to the normal
    of the ellipsoid) at the centre of the points.
    """
    if isinstance(frame, LocalFrame):
        east, north = frame.east_north
        where = {letter: axis for axis, letter in zip("XY", frame.axes, strict=True)}
        names = (
            f"{where['e']} (east)" if "e" in where else f"−{where['w']} (east)",
            f"{where['n']} (north)" if "n" in where else f"−{where['s']} (north)",
            "Z (up)",
        )
        return DrawingPlane(np.zeros(3), np.stack([east, north, [0.0, 0.0, 1.0]]), names, "")
    if not isinstance(frame, GeocentricFrame):
        return DrawingPlane(np.zeros(3), np.eye(3), ("east", "north", "up"), "")
    centre = (xyz.min(axis=0) + xyz.max(axis=0)) / 2
    latitude, longitude, _ = (float(v[0]) for v in frame.ellipsoid.to_geodetic(centre[None]))
    axes = frame.basis(centre[None], np.zeros((1, 2))).enu[0]
    note = f"horizon at {_degrees(latitude, 'NS')} {_degrees(longitude, 'EW')}"
    return DrawingPlane(centre, axes, ("east of the centre", "north of the centre", "up"), note)


def _degrees(angle: float, letters: str) -> str:
    return f"{abs(np.degrees(angle)):.4f}° {letters[angle < 0]}"


def place_covariances(solution: Solution) -> tuple[Array, Array] | None:
    """Return covariances of points (n, 3, 3) and projection centres (m, 3, 3), metres².

    Return None if the iteration stopped early at singular normal equations.
    """
    photos = solution.equations.unknowns["pose"].names
    try:
        centres = [solution.pose_covariance(n)[3:, 3:] for n in photos]
        return solution.point_covariances, np.array(centres).reshape(-1, 3, 3)
    except SingularError:
        return None


def plane_ellipses(sigma: Array) -> tuple[Array, Array]:
    """Return semi-axes (n, 2), largest first, and directions (n,) of the first axes.

    ``sigma`` are covariances (n, 2, 2) in one plane for the whole network; the ellipses of
    `quality.error_ellipses` lie in the horizon of each point. Directions count from the first
    coordinate to the second, radians.
    """
    values, vectors = np.linalg.eigh(sigma)
    semi = np.sqrt(np.maximum(values[:, ::-1], 0.0))
    return semi, np.arctan2(vectors[:, 1, 1], vectors[:, 0, 1])


@dataclass(frozen=True, eq=False)
class ShapeOutline:
    """A shape in a plan."""

    name: str
    """What it is."""
    lines: list[Array]
    """Its lines, each (k, 2) metres."""
    frame: int
    """Number of its frame."""
    places: Array
    """Places in its frame whose precision is shown, (k, 3)."""
    place: str
    """What each of them is."""


def shape_outlines(
    solution: Solution, frames: FramePlaces, plan: DrawingPlane
) -> list[ShapeOutline]:
    """Return the shapes of a solution; those that are not known in full are left out."""
    points: dict[tuple[Outline, int, tuple[float, ...]], list[Index]] = {}
    for block in solution.equations.blocks:
        record = kind_of_block(block)
        if record is None or record.outline is None:
            continue
        frame = variables_by_attribute(block)["frame", record.frames[0]]
        values = np.column_stack([frame, _values(solution, block, record.outline)])
        found, group = np.unique(values, axis=0, return_inverse=True)
        for i, row in enumerate(found.tolist()):
            key = (record.outline, int(row[0]), tuple(row[1:]))
            points.setdefault(key, []).append(points_of(block)[group.ravel() == i])
    out: list[ShapeOutline] = []
    for (outline, f, values_), numbers in points.items():
        xyz = solution.state["point"][np.unique(np.concatenate(numbers))]
        if not (np.isfinite(xyz).all() and np.isfinite([*values_]).all()):
            continue
        turn = frames.rotation(f)
        seen = Seen(
            frames.coordinates(f, xyz),
            np.asarray(plan.axes[2] @ turn),
            frames.up(f, xyz.mean(axis=0)),
        )
        lines = [
            plan.coordinates(frames.places(f, q))[:, :2] for q in outline.lines(seen, *values_)
        ]
        if all(np.isfinite(line).all() for line in lines):
            out.append(
                ShapeOutline(outline.name, lines, f, outline.places(*values_), outline.place)
            )
    return out


def _values(solution: Solution, block: Block, outline: Outline) -> Array:
    """Return the values that the lines of an outline take, (n, k)."""
    by_name = {a: (kind, i) for (kind, a), i in variables_by_attribute(block).items()}
    columns = []
    for name in outline.takes:
        if name in block.constants:
            columns.append(block.constants[name])
        else:
            kind, numbers = by_name[name]
            columns.append(solution.state[kind][numbers, 0])
    return np.array(columns).reshape(len(outline.takes), block.n).T


def draw_outlines(axes: Axes, drawn: list[ShapeOutline]) -> list[Artist]:
    """Draw shapes; return the entries of the legend, one for each sort of shape."""
    from matplotlib.collections import LineCollection

    found: list[Artist] = []
    for i, name in enumerate(dict.fromkeys(each.name for each in drawn)):
        own = [each for each in drawn if each.name == name]
        lines = LineCollection(
            [line for each in own for line in each.lines],
            colors=SKY,
            linestyles=[OUTLINE_DASHES[i % len(OUTLINE_DASHES)]],
            linewidths=1.8,
            zorder=0.8,
            label=wrapped(f"{name} ({len(own)})"),
            gid=f"outline: {name}",
        )
        axes.add_collection(lines, autolim=False)
        found.append(lines)
    return found


def places_with_precision(
    frames: FramePlaces, plan: DrawingPlane, drawn: list[ShapeOutline]
) -> list[tuple[str, Array, Array]]:
    """Return the centres, apexes and ends of shapes in a plan.

    Returns:
        What they are, their places (k, 2) and covariances (k, 3, 3); none without regular normal
        equations. Places of one frame that coincide, such as centres of circles, stand once.
    """
    at: dict[str, list[Array]] = {}
    sigma: dict[str, list[Array]] = {}
    every = {(each.frame, each.places.tobytes()): each for each in drawn if len(each.places)}
    for each in every.values():
        try:
            covariances = frames.covariances(each.frame, each.places)
        except SingularError:
            return []
        places = plan.coordinates(frames.places(each.frame, each.places))[:, :2]
        at.setdefault(each.place, []).append(places)
        sigma.setdefault(each.place, []).append(plan.covariance(covariances))
    return [(place, np.concatenate(at[place]), np.concatenate(sigma[place])) for place in at]


def places_of_window(at: Array, drawn: list[ShapeOutline]) -> Array:
    """Return places (n, 2) that a window must hold: points, and outlines that are not too large.

    A short arc of a large circle does not shrink its points to a dot.
    """
    extent = max(float(np.max(np.ptp(at, axis=0))), 1e-9)
    lines = [line for each in drawn for line in each.lines]
    fits = [
        each for each in lines if float(np.max(np.ptp(each, axis=0))) <= MAX_OUTLINE_EXTENT * extent
    ]
    edge = OUTLINE_MARGIN * extent * np.array([[-1.0, -1.0], [1.0, 1.0]])
    return np.concatenate([at, *((each[:, None] + edge).reshape(-1, 2) for each in fits)])
