"""Units of photos in plan: stereo-radial pairs, triplets and larger units of radial directions.

The directions in plan of a few photos, see `factorgraph_adj.triangulation.plan_blocks`, determine
the shape of what they see: the photos of a unit share one frame in plan (Ayeni's stereo-radial
method and its triplets). A block of units has four unknowns for each, scale, rotation and shifts:

    v = e^{−ℓ} R(κ)ᵀ (X − O) − c − q        in x and y

q are the coordinates of the n points in the unit. Its four motions in plan are arbitrary; as in
`factorgraph_adj.triangulation.independent_models` they are taken out of the covariance and come
back with the mean variance of a coordinate:

    Σ = T Σ' T + s² Q Qᵀ        T = I − Q Qᵀ        s² = tr(T Σ' T) / (2 n − 4)

Two photos have 2 n directions to n common points for 2 n + 2 unknowns. Two more come from the
radial centres: each photo shows the place below the other, the point ``centre …`` of
`plan_station`, which a point transfer or a signal makes. Three photos without these need five
points; in a strip, where three stations are nearly in line, they determine the shape weakly.

Where units share no photo and all directions are in units, the block of units is the adjustment of
all directions at once, to what linearisation leaves: little for most points, much for those below
the line of flight, which directions hardly determine.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..adjustment import adjust
from ..errors import DatumError, InputError, Problem, taking, unknown_name
from ..network.network import Network
from ..observations import Correlated, Direction, FrameCoordinate
from ..observations.base import of_quantities
from ..observations.registry import CONTROL_QUANTITIES
from ..solve.solution import Solution
from ..types import Array
from .independent_models import MODEL_STEP_TOLERANCE
from .plan_blocks import PLAN_COMPONENTS, RadialCentre, plan_station, radial_observations

MIN_INTERSECTION = 1e-3
"""Smallest sine of the angle at which directions intersect in a point of a unit: flatter ones do
not determine its place along the line of the stations."""


@taking(Network)
def radial_units(
    network: Network,
    units: Sequence[Sequence[str]],
    *,
    centre: RadialCentre = "horizon",
) -> Network:
    """Return a block as stereo-radial units in plan, each with a frame of four unknowns.

    Args:
        network: a block, as for `radial_observations`. Image points of points ``centre NAME`` are
            those of the radial centres of other photos.
        units: photos of each unit, two or more.
        centre: radial centre of the photos.

    Returns:
        A network in plan, to be adjusted, with the frame ``A-B`` for each unit; stations are not in
        it, nor points in units where the directions to them have one line (`MIN_INTERSECTION`).

    Raises:
        InputError: as `radial_observations`; an unknown photo, a photo twice in a unit, or a unit
            whose directions do not determine its shape, all of them.
    """
    directions = radial_observations(network, centre=centre)
    problems = [
        Problem(unknown_name("photo", f, network.photos), f"unit {'-'.join(u)!r}")
        for u in units
        for f in u
        if f not in network.photos
    ]
    problems += [
        Problem("a unit needs different photos, two or more", f"unit {'-'.join(u)!r}")
        for u in units
        if len(set(u)) < max(2, len(u))
    ]
    if problems:
        raise InputError(problems)
    out = Network(f"{network.name}, units in plan", frame=network.frame, crs=network.crs)
    for name, p in directions.points.items():
        out.points[name], out.point_number[name] = p, len(out.point_number)
    seen: set[str] = set()
    for unit in units:
        try:
            seen |= _add_unit(out, directions, tuple(unit))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    control = of_quantities(directions.observations.values(), *CONTROL_QUANTITIES)
    out.add(*(o for o in control if o.point in seen))
    out.points = {n: p for n, p in out.points.items() if n in seen}
    out.point_number = {n: i for i, n in enumerate(out.points)}
    return out


def _add_unit(out: Network, directions: Network, photos: tuple[str, ...]) -> set[str]:
    """Add the frame of a unit and the coordinates in it; return its points."""
    name = "-".join(photos)
    solution, points = _oriented(directions, photos, name)
    xy = np.array([solution.point(p)[:2] for p in points])
    origin = xy.mean(axis=0)
    out.add_frame(name, free=PLAN_COMPONENTS, origin=(*origin.tolist(), 0.0))
    plan = np.array([3 * i + a for i in range(len(points)) for a in range(2)])
    covariance = _without_motions(solution.covariance(points)[np.ix_(plan, plan)], xy - origin)
    coordinates = tuple(
        FrameCoordinate(name, p, tuple((x - origin).tolist()), axes="xy", sigma=(1.0, 1.0))
        for p, x in zip(points, xy, strict=True)
    )
    out.add(Correlated(coordinates, covariance))
    return set(points)


def _angle(directions: Network, own: list[Direction]) -> float:
    """Return the largest sine of the angle between the lines of directions to one point."""
    ends = [[directions.points[n].coordinates[:2] for n in (o.station, o.target)] for o in own]
    d = np.array([np.subtract(b, a) for a, b in ends]).reshape(-1, 2)
    d = d / np.linalg.norm(d, axis=1, keepdims=True)
    return float(np.abs(np.outer(d[:, 0], d[:, 1]) - np.outer(d[:, 1], d[:, 0])).max(initial=0.0))


def _without_motions(covariance: Array, d: Array) -> Array:
    """Return T Σ' T + s² Q Qᵀ (2 n, 2 n) of places d (n, 2) about their middle."""
    one, zero = np.ones(len(d)), np.zeros(len(d))
    size = float(np.sqrt(np.mean(d**2))) or 1.0
    x, y = d.T / size
    columns = ((one, zero), (zero, one), (-y, x), (x, y))
    motions = np.stack([np.column_stack(c).ravel() for c in columns], axis=1)
    q = np.linalg.qr(motions)[0]
    t = np.eye(len(q)) - q @ q.T
    own = t @ covariance @ t
    variance = float(np.trace(own)) / max(len(q) - 4, 1)
    return np.asarray(0.5 * (own + own.T) + variance * (q @ q.T))


def _oriented(
    directions: Network, photos: tuple[str, ...], name: str
) -> tuple[Solution, list[str]]:
    """Return the adjustment of the directions of a unit by themselves, and its free points.

    Raises:
        InputError: they do not determine the shape of the unit.
    """
    stations = {plan_station(f): i for i, f in enumerate(photos)}
    every = of_quantities(directions.observations.values(), "direction")
    own = [o for o in every if o.station in stations]
    open_by = {n: _angle(directions, [o for o in own if o.target == n]) for n in directions.points}
    points = [n for n, a in open_by.items() if a >= MIN_INTERSECTION and n not in stations]
    wanted = {*points, *stations}
    unit = Network(name)
    for n in [*stations, *points]:
        given = directions.points[n].coordinates
        unit.add_point(n, given, fixed="xyz" if stations.get(n, 2) < 2 else "z")
    unit.add(*(o for o in own if o.target in wanted))
    rows, unknown = len(unit.observations), 2 * len(points) + 3 * len(photos) - 4
    try:
        if rows >= unknown and points:
            return adjust(unit, tolerance=MODEL_STEP_TOLERANCE), points
        what = f"it has {rows} directions for {unknown} unknowns"
    except DatumError as error:
        what = str(error).splitlines()[0]
    raise InputError(
        Problem(
            f"its directions do not determine its shape ({what}); valid: more points that three of "
            f"its photos see, or images of radial centres, such as of {plan_station(photos[1])!r} "
            f"in photo {photos[0]!r}",
            f"unit {name!r}",
        )
    )
