"""Blocks in plan: An-blocks; plan and height in turn against all at once; radial triangulation.

An An-block (FRAMES F3, F4) has four unknowns for each model: rz, x, y and ln_scale, and the x and y
of model points. A plan-height adjustment (PAT-M43) repeats it, and between two of them adjusts the
three others, rx, ry and z, by the z of model points and by all coordinates of projection centres,
whose plan the tilts answer for.

Each half leaves out what the unknowns of the other half do to its residuals: heights of points turn
x and y with a tilt, and z with the scale. The fixed point is that of the simultaneous solution
where points lie in one plane across the z axes of the models and no projection centres are
observed; in relief it is not. `plan_height` says by how much.

Numerical radial triangulation (FRAMES F14; Ayeni's method 16) uses image points as directions in
plan:

    v = atan2(E_j − E_i, N_j − N_i) − o_i − r_ij

Each photo i is a station in plan with unknown coordinates and orientation; its directions r_ij,
clockwise, are those from its radial centre to the images. Two control points in plan give scale and
rotation; no heights take part. The standard deviation of a direction is that of the image
coordinate across it over the radius, σ / r: rays near the radial centre weigh little, and those
nearer than ``least_radius`` are left out.

| radial centre | its directions are those on the ground |
| --- | --- |
| ``horizon`` | exactly, if the tilt is known: rays are turned to the horizon, from the nadir |
| ``nadir`` | of points in one vertical plane, whatever the relief; angles change by t²/4 at most |
| ``isocentre`` | on flat ground exactly |
| ``principal`` | up to t²/4 on flat ground; relief Δh adds (Δh / H) (c t / r) sin α |

The station in plan is the place on the ground that the radial centre shows. t is the tilt, α the
angle from the principal line. For all but the last the tilts of the photos must be known: those of
the poses are taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, TypeVar, cast, get_args

import numpy as np

from ..adjustment import adjust
from ..errors import InputError, Problem, known
from ..graph.equations import compile_network
from ..models.unknown_registry import UNKNOWNS
from ..network.network import Network
from ..observations import ControlPoint, Direction, FrameCoordinate
from ..observations.base import joined_points, of_quantities
from ..observations.registry import CONTROL_QUANTITIES
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..start.approximate_values import approximate
from ..start.image_rays import read_rays
from ..types import Array
from .independent_models import start_values

PLAN_COMPONENTS = ("rz", "x", "y", "ln_scale")
"""Components of a frame that the adjustment in plan estimates."""
HEIGHT_COMPONENTS = ("rx", "ry", "z")
"""Components of a frame that the adjustment in height estimates."""
MAX_DIFFERENCE_OF_EQUAL_SOLUTIONS = 1e-3
"""Share of a standard deviation below which two solutions are equal."""
PLAN_HEIGHT_STEP_TOLERANCE = 1e-8
"""Bound on the last step of each adjustment, relative to σ."""
MIN_RADIUS_RATIO = 0.05
"""Smallest radius of a ray, in principal distances."""
CAMERA_TO_PHOTO_SIGNS = np.array([1.0, -1.0, -1.0])
"""Signs from the axes of a camera (y down, z forward) to photogrammetric ones."""


@dataclass(frozen=True, repr=False, eq=False)
class PlanHeight(Shown):
    """Adjustments in plan and in height in turn, beside the simultaneous solution."""

    network: Network
    """The network after the last round, all components free again."""
    simultaneous: Solution
    """Solution with all components free."""
    differences: Array
    """Largest difference from the simultaneous solution after each round, of x or y and of z, in
    its standard deviations, (rounds, 2)."""
    steps: Array
    """Largest change of x or y and of z in each round, in the same, (rounds, 2)."""

    @property
    def equal(self) -> bool:
        """Whether it ends at the simultaneous solution, within a thousandth of σ."""
        return bool(self.differences[-1].max() < MAX_DIFFERENCE_OF_EQUAL_SOLUTIONS)

    def headline(self) -> str:
        """Return the number of rounds and where they end."""
        x, z = self.differences[-1]
        said = "equals" if self.equal else "differs from"
        return (
            f"PlanHeight: {len(self.steps)} rounds; {said} the simultaneous solution "
            f"({x:.2g} σ in plan, {z:.2g} σ in height)"
        )

    def first_rows(self) -> Rows:
        """Return the differences and steps of the rounds."""
        rows = (
            (i + 1, *d, *s)
            for i, (d, s) in enumerate(zip(self.differences, self.steps, strict=True))
        )
        header = ("round", "plan [σ]", "height [σ]", "step plan [σ]", "step height [σ]")
        return Rows(header, rows, len(self.steps))


def an_block(network: Network) -> Network:
    """Return models in plan: four free components each, x and y of points, heights held.

    Args:
        network: models whose frames have seven free components, see `as_models`. Tilts and heights
            are held at their given or approximate values; projection centres leave the network.

    Raises:
        InputError: the network has observations other than coordinates in frames.
    """
    return _half(
        _started(network), PLAN_COMPONENTS, held="z", axes=lambda o: "" if o.photo else "xy"
    )


def height_block(network: Network) -> Network:
    """Return models in height: three free components each, z of points, plan held."""
    return _half(
        _started(network), HEIGHT_COMPONENTS, held="xy", axes=lambda o: "xyz" if o.photo else "z"
    )


def plan_height(network: Network, *, rounds: int = 8) -> PlanHeight:
    """Adjust models in plan and height in turn, and compare with the simultaneous solution.

    Args:
        network: models whose frames have seven free components, and held or weighted points.
        rounds: number of rounds; each has one adjustment in plan and one in height.

    Raises:
        InputError: as `an_block`.
    """
    simultaneous = adjust(network, tolerance=PLAN_HEIGHT_STEP_TOLERANCE)
    free = [n for n in network.points if simultaneous.covariance(n).any()]
    sigma = np.array([simultaneous.standard_deviations(n) for n in free])
    sigma[sigma == 0] = np.inf
    end = np.array([simultaneous.point(n) for n in free])
    now = _started(network)
    before = np.array([now.points[n].coordinates for n in free])
    differences, steps = [], []
    for _ in range(rounds):
        for half in (an_block, height_block):
            now = _taken_over(now, adjust(half(now), tolerance=PLAN_HEIGHT_STEP_TOLERANCE))
        x = np.array([now.points[n].coordinates for n in free])
        differences.append(_by_part((x - end) / sigma))
        steps.append(_by_part((x - before) / sigma))
        before = x
    return PlanHeight(now, simultaneous, np.array(differences), np.array(steps))


def _by_part(moved: Array) -> tuple[float, float]:
    return float(np.abs(moved[:, :2]).max()), float(np.abs(moved[:, 2]).max())


def _started(network: Network) -> Network:
    """Return the network with values of all frames, points and photos."""
    equations = compile_network(network)
    state = approximate(equations)
    out = network.copy()
    unknowns = equations.unknowns
    for i, name in enumerate(network.points):
        out.points[name] = replace(
            out.points[name], coordinates=tuple(unknowns.given(state, "point", i).tolist())
        )
    for i, name in enumerate(unknowns["frame"].names):
        values = tuple(unknowns.given(state, "frame", i).tolist())
        out.frames[name] = replace(out.frames[name], values=values)
    for i, name in enumerate(network.photos):
        stored = state["pose"][i]
        out.photos[name] = replace(
            out.photos[name],
            position=tuple(stored[9:].tolist()),
            rotation=stored[:9].reshape(3, 3),
        )
    return out


def _half(
    network: Network,
    free: tuple[str, ...],
    *,
    held: str,
    axes: Callable[[FrameCoordinate], str],
) -> Network:
    """Return the network with some components of its frames free and some coordinates held."""
    out = network.copy()
    for name, p in network.points.items():
        on = tuple(f or a in held for f, a in zip(p.fixed, "xyz", strict=True))
        sigma = None
        if p.sigma is not None:
            kept = [np.inf if a in held else s for s, a in zip(p.sigma, "xyz", strict=True)]
            sigma = (kept[0], kept[1], kept[2])
        out.points[name] = replace(p, fixed=(on[0], on[1], on[2]), sigma=sigma)
    names = UNKNOWNS["frame"].names()
    for name, f in network.frames.items():
        flags = tuple(h or n not in free for n, h in zip(names, f.fixed, strict=True))
        sigma_f = tuple(s if n in free else np.inf for n, s in zip(names, f.sigma, strict=True))
        out.frames[name] = replace(f, fixed=flags, sigma=sigma_f)
    rows = _cut(network, out, axes)
    out.clusters = [
        (tuple(i for i in ids if i in out.observations), c[np.ix_(keep, keep)])
        for ids, c in network.clusters
        if len(keep := _kept(network, ids, rows))
    ]
    if not any(o.photos() for o in out.observations.values()):
        out.photos, out.photo_number = {}, {}
    return out


def _cut(
    network: Network, out: Network, axes: Callable[[FrameCoordinate], str]
) -> dict[str, list[int]]:
    """Keep only some axes of the coordinates; return the rows that are kept, by id."""
    rows: dict[str, list[int]] = {}
    out.observations = {}
    for ident, o in network.observations.items():
        if o.record.in_frame != "coordinates":
            what = "a block in plan and height has coordinates in frames and held points alone"
            raise InputError(Problem(what, o.label()))
        measured = cast(FrameCoordinate, o)
        wanted = axes(measured)
        keep = [i for i, a in enumerate(measured.axes) if a in wanted]
        rows[ident] = keep
        if not keep:
            continue
        out.observations[ident] = _at_axes(measured, keep)
    return rows


def _kept(network: Network, ids: tuple[str, ...], rows: dict[str, list[int]]) -> list[int]:
    """Return the rows of a correlated group that are kept."""
    found, first = [], 0
    for ident in ids:
        found += [first + i for i in rows[ident]]
        first += len(network.observations[ident].component_names())
    return found


def _taken_over(network: Network, solution: Solution) -> Network:
    """Return the network with adjusted values as given ones."""
    out, adjusted = network.copy(), solution.as_network()
    for name, p in adjusted.points.items():
        out.points[name] = replace(out.points[name], coordinates=p.coordinates)
    for name, f in adjusted.frames.items():
        out.frames[name] = replace(out.frames[name], values=f.values)
    for name, photo in adjusted.photos.items():
        out.photos[name] = replace(out.photos[name], position=photo.position)
    return out


RadialCentre: TypeAlias = Literal["horizon", "nadir", "isocentre", "principal"]
"""Point of a photo from which its directions are taken."""
RADIAL_CENTRES: tuple[RadialCentre, ...] = get_args(RadialCentre)


def plan_station(photo: str) -> str:
    """Return the name of the station in plan of a photo."""
    return f"centre {photo}"


def radial_observations(
    network: Network,
    *,
    centre: RadialCentre = "horizon",
    least_radius: float = MIN_RADIUS_RATIO,
) -> Network:
    """Turn the image points of a block into directions in plan.

    Args:
        network: a block of near-vertical photos in a frame whose x, y are the plan. Poses give
            approximate stations and tilts. Of the points, given coordinates, held and weighted
            components in plan, and control points in plan take part.
        centre: radial centre of the photos.
        least_radius: rays nearer to the radial centre are left out, principal distances.

    Returns:
        A network in plan: a point ``centre …`` for each photo, all heights held. Image points of a
        point ``centre NAME`` of the network are directions to the station of the photo NAME. Points
        with one direction that are not control are left out.

    Raises:
        InputError: an unknown radial centre, or a photo without an approximate pose or with a
            motion during its readout.
    """
    if centre not in RADIAL_CENTRES:
        there = known(RADIAL_CENTRES, meant=str(centre))
        raise InputError(Problem(f"unknown radial centre {centre!r}; valid: {there}"))
    network.refuse_motions(network.photos, "a direction in plan")
    state = start_values(network)
    name = f"{network.name}, directions in plan"
    out = Network(name, frame=network.frame, datum=network.datum, crs=network.crs)
    for name, p in network.points.items():
        x, y = state["point"][network.point_number[name], :2].tolist()
        on = tuple(f or a == "z" for f, a in zip(p.fixed, "xyz", strict=True))
        sigma = None if p.sigma is None else (*p.sigma[:2], np.inf)
        out.points[name] = replace(
            p, coordinates=(x, y, 0.0), fixed=(on[0], on[1], on[2]), sigma=sigma
        )
        out.point_number[name] = len(out.point_number)
    for name in network.photos:
        pose = state["pose"][network.photo_number[name]]
        if np.isnan(pose).any():
            raise InputError(Problem("it has no approximate pose", f"photo {name!r}"))
        station = plan_station(name)
        if station in out.points:  # the place below the photo, which other photos show
            stated = out.points[station]
            at = (float(pose[9]), float(pose[10]), 0.0)
            out.points[station] = (
                stated if all(stated.fixed[:2]) else replace(stated, coordinates=at)
            )
        else:
            out.add_point(station, (float(pose[9]), float(pose[10]), 0.0), fixed="z")
    _add_directions(network, out, state["pose"], centre, least_radius)
    for o in of_quantities(network.observations.values(), *CONTROL_QUANTITIES):
        if axes := "".join(a for a in o.axes if a in "xy"):
            out.add(_in_plan(o, axes))
    seen = joined_points(out.observations.values())
    for name in [n for n in out.points if n not in seen]:
        del out.points[name]
    out.point_number = {n: i for i, n in enumerate(out.points)}
    return out


def _add_directions(
    network: Network, out: Network, poses: Array, centre: RadialCentre, least_radius: float
) -> None:
    """Add the directions of all image points."""
    rays = read_rays(compile_network(network))
    photo, point, _, sigmas = network.images.columns()
    each = np.column_stack([sigmas, network.images.correlation])
    sigma_of = {(i, j): s for i, j, s in zip(photo.tolist(), point.tolist(), each, strict=True)}
    photos, points = list(network.photos), list(network.points)
    p = rays.direction / rays.direction[:, 2:] * CAMERA_TO_PHOTO_SIGNS  # (x, y, −c) / c
    rotation = poses[:, :9].reshape(-1, 3, 3)[rays.photo] * CAMERA_TO_PHOTO_SIGNS
    distance = np.array([network.cameras[f.camera].values[0] for f in network.photos.values()])
    angle, radius, across = radial_directions(p, rotation, centre)
    far = radius >= least_radius
    control = of_quantities(network.observations.values(), *CONTROL_QUANTITIES)
    observed = {o.point for o in control}
    stations = {plan_station(f) for f in photos}
    held = np.array(
        [
            all(p.fixed[:2]) or p.sigma is not None or n in observed or n in stations
            for n, p in network.points.items()
        ]
    )
    # A photo has no direction to its own centre.
    own = {f: points.index(plan_station(f)) for f in photos if plan_station(f) in points}
    below = np.array([own.get(f, -1) for f in photos], dtype=np.intp)
    far &= rays.point != below[rays.photo]
    enough = held | (np.bincount(rays.point[far], minlength=len(points)) >= 2)
    for k in np.flatnonzero(far & enough[rays.point]).tolist():
        i, j = int(rays.photo[k]), int(rays.point[k])
        a, b = across[k]
        sx, sy, rho = sigma_of[i, j]
        across_ray = (a * sx) ** 2 + (b * sy) ** 2 + 2.0 * rho * (a * sx) * (b * sy)
        sigma = float(np.sqrt(across_ray)) / float(distance[i])
        out.add(Direction(plan_station(photos[i]), points[j], float(angle[k]), sigma=sigma))


def radial_directions(
    p: Array, rotation: Array, centre: RadialCentre
) -> tuple[Array, Array, Array]:
    """Return directions from a radial centre.

    Args:
        p: rays (x, y, −c) / c in photogrammetric axes, (n, 3).
        rotation: rotations from these axes to the object of their photos, (n, 3, 3).
        centre: the radial centre.

    Returns:
        Directions clockwise from +y in [0, 2π), (n,); radii in principal distances, (n,); partials
        of a direction by x / c and y / c, (n, 2).
    """
    down = -rotation[:, 2]  # the vertical in the axes of the photo
    if centre == "horizon":
        # Turn about a horizontal axis that makes the photo level and keeps its +y in its azimuth.
        x_axis, y_axis = _level_axes(rotation)
        level = np.stack([x_axis, y_axis, -down], axis=1)
        q = np.einsum("nij,nj->ni", level, p)
        planar = q[:, :2] / -q[:, 2:]
        slopes = (level[:, :2, :2] * -q[:, 2:, None] + q[:, :2, None] * level[:, 2:, :2]) / (
            q[:, 2:, None] ** 2
        )
    else:
        planar = p[:, :2] - _centre(down, centre)
        slopes = np.broadcast_to(np.eye(2), (len(p), 2, 2))
    squared = np.sum(planar**2, axis=1)
    radius = np.sqrt(squared)
    # r = atan2(x, y): ∂r/∂(x, y) = (y, −x) / r².
    safe = np.where(squared > 0, squared, 1.0)
    by_planar = np.stack([planar[:, 1], -planar[:, 0]], axis=1) / safe[:, None]
    across = np.einsum("ni,nij->nj", by_planar, slopes)
    return np.arctan2(planar[:, 0], planar[:, 1]) % (2 * np.pi), radius, across


def _level_axes(rotation: Array) -> tuple[Array, Array]:
    """Return horizontal axes, in those of the photo: y next to its +y, x to the right of it."""
    up = rotation[:, 2]
    y = np.array([0.0, 1.0, 0.0]) - up * up[:, 1:2]
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    return np.cross(y, up), y


def _centre(down: Array, centre: RadialCentre) -> Array:
    """Return a radial centre in the photo, principal distances, (n, 2)."""
    nadir = down[:, :2] / -down[:, 2:]
    if centre == "principal":
        return np.zeros_like(nadir)
    if centre == "nadir":
        return np.asarray(nadir)
    tangent = np.linalg.norm(nadir, axis=1, keepdims=True)
    # The isocentre is tan(t/2) from the principal point, the nadir tan t.
    half = np.tan(0.5 * np.arctan(tangent))
    return np.asarray(nadir * np.divide(half, tangent, out=np.ones_like(half), where=tangent > 0))


def _in_plan(o: ControlPoint, axes: str) -> ControlPoint:
    """Return the coordinates in plan of a control point."""
    return replace(_at_axes(o, [o.axes.index(a) for a in axes]), id=None)


_Coordinates = TypeVar("_Coordinates", ControlPoint, FrameCoordinate)


def _at_axes(o: _Coordinates, keep: Sequence[int]) -> _Coordinates:
    """Return an observation of coordinates with some of its axes, by their numbers."""
    return replace(
        o,
        axes="".join(o.axes[i] for i in keep),
        value=tuple(o.value[i] for i in keep),
        sigma=None if o.sigma is None else tuple(o.sigma[i] for i in keep),
        covariance=None if o.covariance is None else o.covariance[np.ix_(keep, keep)],
    )
