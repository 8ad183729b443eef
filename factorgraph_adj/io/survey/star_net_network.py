"""Network of a STAR*NET project, local or in a grid; grid coordinates of points given by φ, λ."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError
from ...frames import LocalFrame
from ...graph.equations import compile_network
from ...network.grid.conversion import from_grid
from ...network.network import Network
from ...observations import Azimuth, HeightDifference, HorizontalDistance, Observation
from ...start.approximate_values import partial_approximation
from ...types import Array
from ..source import Source
from .star_net_options import StarNetOptions
from .star_net_points import StarNetPoint, StarNetPoints, StarNetVectors

CONVERTED_KINDS = (Azimuth, HorizontalDistance, HeightDifference)
"""Kinds that may need the places of their points when they leave the grid."""


@dataclass(frozen=True)
class StarNetContent:
    """What the data files of a project hold."""

    name: str
    """Name of the project."""
    options: StarNetOptions
    """Settings of the project."""
    points: StarNetPoints
    """Points, with grid coordinates where the project has a reference system."""
    vectors: StarNetVectors
    """GPS vectors."""
    observations: tuple[Observation, ...]
    """All observations besides the vectors."""
    refractions: Mapping[str, float]
    """Coefficient of refraction of STAR*NET by refraction group."""
    meant: Mapping[str, str]
    """What an azimuth counts from, or where a horizontal distance is, by file and line."""
    source: Source
    """Problems of the files, and rows that are left out."""


def local_network(read: StarNetContent, adjustment: str) -> Network:
    """Return the network of a local project: curvature and refraction are one coefficient.

    Raises:
        InputError: observations are no network.
    """
    network = _points_network(read, adjustment, LocalFrame(radius=read.options.earth_radius), 0.0)
    for group, coefficient in read.refractions.items():
        network.set_refraction(group, value=2.0 * coefficient - 1.0, fixed=True)
    _add_observations(network, read.observations, read.source)
    read.source.problems.finish(network)
    return network


def grid_network(read: StarNetContent, system: ReferenceSystem, adjustment: str) -> Network:
    """Return the network of a project in a grid, in a topocentric frame.

    Azimuths, reduced distances and height differences are converted at their points. Where these
    have no coordinates, approximate ones follow from the observations: 1 m there changes an azimuth
    by 0.03″ tan φ.

    Raises:
        InputError: as `from_grid`, with file and line of points and observations.
    """
    height = (read.options.elevation_of_project or 0.0) * read.options.metres
    network = _points_network(read, adjustment, LocalFrame(), height)
    for group, coefficient in read.refractions.items():
        network.set_refraction(group, value=2.0 * coefficient, fixed=True)
    with _problems_with_point_lines(read.points, read.source):
        vectors = read.vectors.observations(lambda names: _station_horizons(network, system, names))
    read.source.raise_all()
    _add_observations(network, read.observations, read.source)
    _approximate_places(network)
    _add_observations(network, vectors, read.source)
    read.source.problems.finish(network)
    sources = {("point", n): read.source.place(p.line) for n, p in read.points.points.items()}
    with _problems_with_point_lines(read.points, read.source):
        return from_grid(
            network,
            system,
            vectors="geocentric",
            sources=sources,
            azimuths=_meant(network, read, Azimuth),
            horizontal_distances=_meant(network, read, HorizontalDistance),
        )


def _meant(network: Network, read: StarNetContent, kind: type[Observation]) -> dict[str, Any]:
    """Return what the observations of a kind count from, or where they are, by id."""
    return {
        ident: read.meant[o.source]
        for ident, o in network.observations.items()
        if isinstance(o, kind) and o.source is not None
    }


def _approximate_places(network: Network) -> None:
    """Give points their approximate coordinates where conversion needs a place and has none."""
    unknown = {n for n, p in network.points.items() if not np.isfinite(p.coordinates).all()}
    converted = (o for o in network.observations.values() if isinstance(o, CONVERTED_KINDS))
    if not any(unknown.intersection(o.points()) for o in converted):
        return
    state, _ = partial_approximation(compile_network(network))
    for name, found in zip(network.points, state["point"].tolist(), strict=True):
        if name in unknown and np.isfinite(found).all():
            network.points[name] = replace(network.points[name], coordinates=tuple(found))


def _points_network(
    read: StarNetContent, adjustment: str, frame: LocalFrame, height: float
) -> Network:
    """Return the network of the points; those of a 2D project have the height, in metres."""
    held = read.points.anything_held(adjustment)
    network = Network(read.name, frame=frame, datum="given" if held else "free")
    read.points.add_to(network, adjustment, height)
    return network


def _add_observations(
    network: Network, observations: Sequence[Observation], source: Source
) -> None:
    try:
        network.add(*observations)
    except InputError as error:
        raise InputError([p.at(source.path.name) for p in error.problems]) from None


def star_net_grid_system(crs: ReferenceSystem | str, geoid: str | float | None) -> ReferenceSystem:
    """Return the reference system of a project.

    Raises:
        InputError: PROJ does not know it, it has no grid, or the kind of its heights is not stated.
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


def set_grid_coordinates(points: StarNetPoints, system: ReferenceSystem, source: Source) -> None:
    """Give points with latitude and longitude their grid coordinates, and all heights a geoid.

    Args:
        points: the points; they are changed.
        system: the reference system.
        source: gets the problems.
    """
    geodetic = {n: p for n, p in points.points.items() if p.geodetic is not None}
    if geodetic:
        at = np.array([p.geodetic for p in geodetic.values()])
        try:
            grid = _plan_of(system, at, list(geodetic))
        except InputError as error:
            _note_point_problems(error, geodetic, source)
            return
        for p, (east, north) in zip(geodetic.values(), grid.tolist(), strict=True):
            p.values[:2] = [east, north]
    high = {n: p for n, p in points.points.items() if p.ellipsoidal}
    if high:
        placed = {n: p for n, p in high.items() if np.isfinite(p.values).all()}
        for p in high.values():
            if not np.isfinite(p.values).all():
                what = "an ellipsoidal height needs the plan coordinates of its point"
                source.wrong(p.line, f"{what}: C or P")
        if not placed:
            return
        try:
            grid = np.array([[*p.values[:2], 0.0] for p in placed.values()])
            latitude, longitude, _ = system.chain.plan_geodetic(grid, list(placed))
            n = system.geoid_at(latitude, longitude, list(placed)).undulation
        except InputError as error:
            _note_point_problems(error, placed, source)
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


def _station_horizons(network: Network, system: ReferenceSystem, names: list[str]) -> Array:
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


@contextmanager
def _problems_with_point_lines(points: StarNetPoints, source: Source) -> Iterator[None]:
    """Put file and line before problems of points."""
    try:
        yield
    except InputError as error:
        places = {f"point {n!r}": source.place(p.line) for n, p in points.points.items()}
        raise InputError(
            p.at(places.get(p.where, source.path.name)) if ":" not in p.where else p
            for p in error.problems
        ) from None


def _note_point_problems(
    error: InputError, points: Mapping[str, StarNetPoint], source: Source
) -> None:
    """Note problems of points with the lines of these."""
    lines = {f"point {name!r}": p.line for name, p in points.items()}
    first = next(iter(points.values())).line
    for problem in error.problems:
        source.wrong(lines.get(problem.where, first), problem.what)
