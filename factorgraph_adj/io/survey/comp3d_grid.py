"""Comp3D grids: origin, its stereographic plane and frame; points of map projections moved there.

X and Y of a local project are a double stereographic projection of GRS80 at its centre (``sterea``
of PROJ), the third coordinate is the height. What the values that Comp3D prints show:

- Observation equations of simple observations work in east, north, up of a sphere with the mean
  radius √(MN) at the centre. `LocalFrame` with curvature and that radius is the same: residuals
  agree to 2·10⁻⁵ σ, coordinates to 0.02 µm.
- Sub-frames of versions from 5.22 on work on the ellipsoid; printed cartesian coordinates are those
  on the ellipsoid too (to 5 nm).
- Azimuths count from true north, which lies X tan φ / N west of the Y axis.
- σ of plane coordinates grow with 1 + h/R on the ground.

A project in a map projection is computed in a frame at its centre, a stereographic projection of
the ellipsoid (``sterea`` of PROJ), whose plane coordinates and heights have the standard deviations
of the file of points. Here that plane is a reference system of its own, which leads to a
topocentric frame at the centre; held and weighted components go with it as those of every grid do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...crs.reference_system import ReferenceSystem, ellipsoidal
from ...ellipsoid import ellipsoid
from ...errors import InputError, Problem
from ...frames import LocalFrame, TopocentricFrame
from ...network.grid.conversion import from_grid
from ...network.network import Network
from ...types import Array
from .comp3d_files import (
    IGNORED_POINT_CODE,
    Comp3dFiles,
    Comp3dPoint,
    Comp3dProject,
    add_joint_covariance,
    add_point,
    jointly_observed_points,
)


@dataclass(frozen=True)
class Comp3dOrigin:
    """The centre of a project, on GRS80 if it is a local one."""

    latitude: float
    """Geodetic latitude, degrees."""
    longitude: float = 0.0
    """Longitude, degrees: it matters for GNSS baselines and grids only."""
    ellipsoid_name: str = "GRS80"
    """Ellipsoid, see `factorgraph_adj.ellipsoid.ELLIPSOIDS`."""

    @property
    def radii(self) -> tuple[float, float]:
        """Radii of curvature M and N, metres."""
        m, n = ellipsoid(self.ellipsoid_name).radii(np.radians(np.array([self.latitude])))
        return float(m[0]), float(n[0])

    @property
    def radius(self) -> float:
        """Radius √(MN) of the sphere of the observation equations, metres."""
        return float(np.sqrt(np.prod(self.radii)))

    def to_cartesian(self, projected: Array) -> Array:
        """Return east, north, up (3,) on the sphere of stereographic X, Y and height.

        To 1 nm within 1 km: X (1 + h/R), Y (1 + h/R), h − (X² + Y²)/2R.
        """
        x, y, h = projected
        r = self.radius
        return np.array([x * (1 + h / r), y * (1 + h / r), h - (x * x + y * y) / (2 * r)])

    def geodetic(self, projected: Array) -> tuple[float, float]:
        """Return latitude and longitude from the origin, radians, of stereographic X, Y.

        The inverse of the double projection: from the plane to the sphere of radius √(MN), from the
        sphere to the ellipsoid, both conformal.
        """
        globe, phi0, r = ellipsoid(self.ellipsoid_name), np.radians(self.latitude), self.radius
        e = np.sqrt(globe.e2)

        def isometric(phi: float) -> float:
            return float(np.arctanh(np.sin(phi)) - e * np.arctanh(e * np.sin(phi)))

        n = np.sqrt(1 + globe.e2 * np.cos(phi0) ** 4 / (1 - globe.e2))
        chi0 = np.arcsin(np.sin(phi0) / n)
        shift = np.arctanh(np.sin(chi0)) - n * isometric(phi0)
        x, y = projected[:2]
        distance, azimuth = 2 * np.arctan(np.hypot(x, y) / (2 * r)), np.arctan2(x, y)
        north, east = np.sin(distance) * np.cos(azimuth), np.sin(distance) * np.sin(azimuth)
        chi = np.arcsin(np.cos(distance) * np.sin(chi0) + north * np.cos(chi0))
        longitude = np.arctan2(east, np.cos(distance) * np.cos(chi0) - north * np.sin(chi0)) / n
        phi = phi0
        for _ in range(12):  # each gains the square of the eccentricity: 12 · log10(e⁻²) digits
            q = (np.arctanh(np.sin(chi)) - shift) / n + e * np.arctanh(e * np.sin(phi))
            phi = np.arcsin(np.tanh(q))
        return float(phi), float(longitude)

    @property
    def sphere(self) -> LocalFrame:
        """East, north, up at the origin, over the sphere."""
        return LocalFrame(curvature=True, radius=self.radius)

    @property
    def frame(self) -> TopocentricFrame:
        """East, north, up at the origin, on the ellipsoid."""
        latitude, longitude = np.radians(self.latitude), np.radians(self.longitude)
        return TopocentricFrame(latitude, longitude, 0.0, self.ellipsoid_name, radius=self.radius)

    def on_ellipsoid(self, projected: Array) -> Array:
        """Return east, north, up (3,) on the ellipsoid of stereographic X, Y and height."""
        phi, longitude = (np.array([a]) for a in self.geodetic(projected))
        longitude = longitude + np.radians(self.longitude)
        there = ellipsoid(self.ellipsoid_name).to_cartesian(
            phi, longitude, np.array([projected[2]])
        )
        return np.asarray(self.frame.from_geocentric(there)[0])

    def convergence(self, east: float) -> float:
        """Return by how much true north lies west of the Y axis, radians."""
        return float(east * np.tan(np.radians(self.latitude)) / self.radii[1])


@dataclass(frozen=True)
class Comp3dGrid:
    """The grid of a project."""

    system: ReferenceSystem
    """Its reference system, with heights."""
    origin: Comp3dOrigin
    """The centre of the project."""

    @property
    def plane(self) -> ReferenceSystem:
        """The stereographic projection at the centre, with ellipsoidal heights."""
        e, o = self.system.ellipsoid, self.origin
        return ReferenceSystem(
            f"+proj=sterea +lat_0={o.latitude!r} +lon_0={o.longitude!r} +k_0=1 +x_0=0 +y_0=0 "
            f"+a={e.a!r} +rf={e.inverse_flattening!r} +units=m +type=crs",
            heights="ellipsoidal",
        )


def comp3d_grid_system(
    project: Comp3dProject, crs: ReferenceSystem | str | None, geoid: str | float | None, name: str
) -> ReferenceSystem:
    """Return the reference system of a project, or the one that the caller states for it.

    Raises:
        InputError: PROJ does not know it, or the kind of its heights is not stated.
    """
    if isinstance(crs, ReferenceSystem):
        return crs.checked()
    definition = project.projection if crs is None else crs
    assert definition is not None
    if geoid is None and not project.ellipsoidal:
        what = "its heights are altitudes: give geoid=, the path of a grid or a constant undulation"
        raise InputError(Problem(what, name))
    try:
        if geoid is None:
            return ReferenceSystem(definition, heights="ellipsoidal").checked()
        return ReferenceSystem(definition, geoid).checked()
    except InputError as error:
        hint = "" if crs is not None else "; crs= states another one"
        raise InputError(
            [Problem(p.what + hint, p.where or name) for p in error.problems]
        ) from None


def comp3d_grid(
    system: ReferenceSystem,
    centre: tuple[float, float] | None,
    given: Mapping[str, Comp3dPoint],
    name: str,
) -> Comp3dGrid:
    """Return the grid with its centre; without a stated one that of the points.

    Raises:
        InputError: there is neither a centre nor a point, or it is outside of the grid.
    """
    if centre is None:
        at = [p.projected[:2] for p in given.values() if p.code != IGNORED_POINT_CODE]
        if not at:
            raise InputError(Problem("has no points, in whose middle the centre would be", name))
        middle = np.mean(at, axis=0)
        centre = float(middle[0]), float(middle[1])
    place = np.array([[*centre, 0.0]])
    try:
        latitude, longitude, _ = ellipsoidal(system).to_geodetic(place, ["centre"])
    except InputError as error:
        problems = [Problem(f"its centre (local_center) {p.what}", name) for p in error.problems]
        raise InputError(problems) from None
    phi, lam = (float(np.degrees(v[0])) for v in (latitude, longitude))
    return Comp3dGrid(system, Comp3dOrigin(phi, lam, system.ellipsoid.name))


def projected_points(grid: Comp3dGrid, given: Mapping[str, Comp3dPoint]) -> dict[str, Comp3dPoint]:
    """Return points of the grid with stereographic coordinates and heights above the ellipsoid.

    Problems of places go to the lines of their points.
    """
    used = [p for p in given.values() if p.code != IGNORED_POINT_CODE]
    at = np.array([p.projected for p in used]).reshape(-1, 3)
    try:
        geodetic = grid.system.to_geodetic(at, [p.name for p in used])
        plane = grid.plane.from_geodetic(*geodetic, [p.name for p in used])
    except InputError as error:
        by_name = {f"point {p.name!r}": p.line for p in used}
        for problem in error.problems:
            line = by_name.get(problem.where, used[0].line)
            line.wrong(problem.what)
        return dict(given)
    moved = {p.name: replace(p, projected=xyh, xyz=xyh) for p, xyh in zip(used, plane, strict=True)}
    return {name: moved.get(name, p) for name, p in given.items()}


def network_in_grid(
    files: Comp3dFiles,
    grid: Comp3dGrid,
    used: Mapping[str, Comp3dPoint],
    covariance: Path | None,
    name: str,
) -> Network:
    """Return a network of the points alone, in the topocentric frame at the centre.

    Args:
        files: gets the problems.
        grid: the grid.
        used: the points with stereographic coordinates.
        covariance: file of the covariance of weighted coordinates.
        name: name of the network.
    """
    plain = Network(name)
    joint = jointly_observed_points(used) if covariance is not None else set()
    for point in used.values():
        add_point(plain, point, weighted=point.name not in joint)
    if joint and covariance is not None:
        add_joint_covariance(files, plain, dict(used), covariance)
    sources = {("point", p.name): p.line.source for p in used.values()}
    try:
        network = from_grid(plain, grid.plane, frame=grid.origin.frame, sources=sources)
    except InputError as error:
        by_name = {f"point {p.name!r}": p.line for p in used.values()}
        first = files.files[0]
        for problem in error.problems:
            line = by_name.get(problem.where)
            if line is None:
                first.wrong(0, f"{problem.where}: {problem.what}".removeprefix(": "))
            else:
                line.wrong(problem.what)
        network = Network(name, frame=grid.origin.frame)
        for point in used.values():
            point.line.attempt(network.add_point, point.name)
    network.crs = grid.system
    return network
