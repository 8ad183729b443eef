"""Network of a STAR*NET project in a grid: grid coordinates, heights, topocentric frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError
from ...network.grid.conversion import from_grid
from ...network.network import Network
from ...types import Array
from ..file_problems import SurveyProblems
from .star_net_points import StarNetPoint, StarNetPoints


def star_net_grid_system(crs: ReferenceSystem | str, geoid: str | float | None) -> ReferenceSystem:
    """Return the reference system of a project.

    Raises:
        InputError: PROJ does not know it, it has no grid, or its heights are not told.
    """
    if isinstance(crs, ReferenceSystem):
        system = crs.checked()
    else:
        system = ReferenceSystem(crs, geoid).checked()
    if not system.projected:
        raise InputError(
            f"reference system {system.name} has no grid coordinates; valid: a projected one, such "
            "as EPSG:2953"
        )
    return system


def set_grid_coordinates(
    points: StarNetPoints, system: ReferenceSystem, notes: SurveyProblems
) -> None:
    """Give points with latitude and longitude their grid coordinates, and all heights a geoid.

    Args:
        points: the points; they are changed.
        system: the reference system.
        notes: gets the problems.
    """
    geodetic = {n: p for n, p in points.points.items() if p.geodetic is not None}
    if geodetic:
        at = np.array([p.geodetic for p in geodetic.values()])
        try:
            grid = _plan_of(system, at, list(geodetic))
        except InputError as error:
            _note_point_problems(error, geodetic, notes)
            return
        for p, (east, north) in zip(geodetic.values(), grid.tolist(), strict=True):
            p.values[:2] = [east, north]
    high = {n: p for n, p in points.points.items() if p.ellipsoidal}
    if high:
        placed = {n: p for n, p in high.items() if np.isfinite(p.values).all()}
        for p in high.values():
            if not np.isfinite(p.values).all():
                what = "an ellipsoidal height needs the plan coordinates of its point"
                notes.add(p.line, f"{what}: C or P")
        if not placed:
            return
        try:
            grid = np.array([[*p.values[:2], 0.0] for p in placed.values()])
            latitude, longitude, _ = system.chain.plan_geodetic(grid, list(placed))
            n = system.geoid_at(latitude, longitude, list(placed)).undulation
        except InputError as error:
            _note_point_problems(error, placed, notes)
            return
        for p, undulation in zip(placed.values(), n.tolist(), strict=True):
            p.values[2] -= undulation


def _plan_of(system: ReferenceSystem, geodetic: Array, names: list[str]) -> Array:
    """Return easting and northing, (n, 2), of φ, λ (n, 2): the height has no part in them."""
    plain = ReferenceSystem(
        system.plan.to_wkt(),
        heights="ellipsoidal",
        datum=system.datum,
        parameters=system.parameters,
    )
    level = np.zeros(len(geodetic))
    return plain.from_geodetic(geodetic[:, 0], geodetic[:, 1], level, names)[:, :2]


def station_horizons(network: Network, system: ReferenceSystem, names: list[str]) -> Array:
    """Return east, north and up of stations as rows, geocentric, (n, 3, 3).

    Stations without coordinates have the horizon of the middle of the others, which is wrong by the
    distance over the radius of the Earth.
    """
    if not names:
        return np.zeros((0, 3, 3))
    xyz = np.array([p.coordinates for p in network.points.values()]).reshape(-1, 3)
    there = np.isfinite(xyz[:, :2]).all(axis=1)
    if not there.any():
        raise InputError("no point of the vectors has coordinates (C or P)")
    rows = np.array([network.point_number[n] for n in names])
    middle = xyz[there].mean(axis=0)
    at = np.where(there[rows, None], xyz[rows], middle)
    at[:, 2] = 0.0
    latitude, longitude, _ = system.chain.plan_geodetic(at, names)
    cp, sp, cl, sl = np.cos(latitude), np.sin(latitude), np.cos(longitude), np.sin(longitude)
    zero = np.zeros_like(cp)
    east = np.stack([-sl, cl, zero], axis=1)
    north = np.stack([-sp * cl, -sp * sl, cp], axis=1)
    up = np.stack([cp * cl, cp * sl, sp], axis=1)
    return np.stack([east, north, up], axis=1)


def topocentric_network(
    network: Network,
    system: ReferenceSystem,
    points: StarNetPoints,
    notes: SurveyProblems,
    **options: Any,
) -> Network:
    """Return the network of grid coordinates in a topocentric frame.

    Raises:
        InputError: as `from_grid`, with file and line of points and observations.
    """
    sources = {("point", n): notes.place(p.line) for n, p in points.points.items()}
    with problems_with_point_lines(points, notes):
        return from_grid(network, system, vectors="geocentric", sources=sources, **options)


@contextmanager
def problems_with_point_lines(points: StarNetPoints, notes: SurveyProblems) -> Iterator[None]:
    """Put file and line before problems of points."""
    try:
        yield
    except InputError as error:
        places = {f"point {n!r}": notes.place(p.line) for n, p in points.points.items()}
        raise InputError(
            p.at(places.get(p.where, notes.path.name)) if ":" not in p.where else p
            for p in error.problems
        ) from None


def _note_point_problems(
    error: InputError, points: Mapping[str, StarNetPoint], notes: SurveyProblems
) -> None:
    """Note problems of points with the lines of these."""
    lines = {f"point {name!r}": p.line for name, p in points.items()}
    first = next(iter(points.values())).line
    for problem in error.problems:
        notes.add(lines.get(problem.where, first), problem.what)
