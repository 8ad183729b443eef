"""Projects of Comp3D in a map projection: their points in a frame on the ellipsoid.

Comp3D computes in a frame at the centre of the project: a stereographic projection of the
ellipsoid at it (``sterea`` of PROJ), whose plane coordinates and heights have the standard
deviations of the file of points. Here that plane is a reference system of its own, which leads
to a topocentric frame at the centre; held and weighted components go with it as those of every
grid do.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...crs.system import ReferenceSystem, ellipsoidal
from ...errors import InputError, Problem
from ...network.from_grid import from_grid
from ...network.network import Network
from .comp3d_files import Comp3dFiles, Comp3dProject
from .comp3d_places import Comp3dOrigin
from .comp3d_points import IGNORED, Comp3dPoint, add_joint_covariance, add_point, observed_together


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


def grid_system(
    project: Comp3dProject, crs: ReferenceSystem | str | None, geoid: str | float | None, name: str
) -> ReferenceSystem:
    """Return the reference system of a project, or the one that the caller states for it.

    Raises:
        InputError: PROJ does not know it, or what its heights are is not told.
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


def grid_of(
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
        at = [p.projected[:2] for p in given.values() if p.code != IGNORED]
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


def projected(grid: Comp3dGrid, given: Mapping[str, Comp3dPoint]) -> dict[str, Comp3dPoint]:
    """Return points of the grid with stereographic coordinates and heights above the ellipsoid.

    Problems of places go to the lines of their points.
    """
    used = [p for p in given.values() if p.code != IGNORED]
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
    joint = observed_together(used) if covariance is not None else set()
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
                first.add(0, f"{problem.where}: {problem.what}".removeprefix(": "))
            else:
                line.wrong(problem.what)
        network = Network(name, frame=grid.origin.frame)
        for point in used.values():
            point.line.attempt(network.add_point, point.name)
    network.crs = grid.system
    return network
