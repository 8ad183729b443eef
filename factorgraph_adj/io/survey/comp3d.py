"""Reader of Comp3D projects (IGN), local or in a grid: points, observations, sets, deflections.

Format: IGN France, Comp3D 5, user documentation (OBS file, COR file, project configuration).
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem
from ...frames import TopocentricFrame
from ...network.network import Network
from ...observations import (
    Azimuth,
    CoordinateDifference,
    Direction,
    HeightDifference,
    SlopeDistance,
    ZenithAngle,
)
from ...stochastic_model import StandardDeviation
from ...units import GON
from ..format_reader import NetworkReader, Reader
from .comp3d_files import (
    IGNORED_POINT_CODE,
    Comp3dFiles,
    Comp3dLine,
    Comp3dPoint,
    Comp3dProject,
    add_joint_covariance,
    add_point,
    jointly_observed_points,
    read_comp3d_project,
    read_points,
)
from .comp3d_grid import (
    Comp3dOrigin,
    comp3d_grid,
    comp3d_grid_system,
    network_in_grid,
    projected_points,
)
from .comp3d_sets import add_axis, add_baselines, add_equalities, add_subframe

SINGLE_LINE_CODES = ("1", "3", "4", "5", "6", "7", "8", "9", "14", "15")
"""Codes of observations in one line."""
SET_FUNCTIONS = {
    "11": add_subframe,
    "12": add_subframe,
    "18": add_axis,
    "19": add_baselines,
    "21": add_equalities,
    "22": add_equalities,
}
"""Codes of observations in a file of their own."""
SET_FILE_PLACES = {"11": (2, 1), "12": (2, 1), "19": (2, 1), "21": (1, 2), "22": (1, 2)}
"""Place of the name of the file in lines of sets, and number of points at the begin of its rows."""
COMP3D_REFRACTION = 0.12
"""Refraction coefficient of Comp3D where a project states none."""
ProjectStart = tuple[Network, dict[str, Comp3dPoint], Comp3dOrigin, dict[str, Comp3dPoint]]
"""Network of the points, all points, centre, points that take part."""


def read_comp3d(
    path: str | Path,
    *,
    points: str | Path | None = None,
    latitude: float | None = None,
    longitude: float | None = None,
    refraction: float | None = None,
    earth: Literal["sphere", "ellipsoid"] | None = None,
    deflections: Literal["as stated", "ignore"] = "as stated",
    crs: ReferenceSystem | str | None = None,
    geoid: str | float | None = None,
) -> Network:
    """Read a project of Comp3D, a local one or one in a map projection.

    The axes are east, north and up at the centre of the project; coordinates of the files are
    converted to them: those of a local project are a stereographic projection and heights, those of
    a project in a map projection lead through its reference system (which needs pyproj) to the
    ellipsoid, and results come back in it (`grid_coordinates`). Points without coordinates, which
    the observations name, are found as in Comp3D. What is read:

    | code | observation |
    | --- | --- |
    | 1, 3 | `SlopeDistance` |
    | 4 | `HeightDifference` |
    | 5, 7 | `Direction`; 7 begins a set, and so does the first direction of a station |
    | 6 | `ZenithAngle`, with the refraction coefficient of the project, held |
    | 8 | `Azimuth` |
    | 9, 14, 15 | `CoordinateDifference`: east and north; east; north |
    | 11 | `FrameCoordinate` in a frame at a point |
    | 12 | `FrameDirection`, `FrameZenith`, `FrameDistance` in a frame at a point |
    | 18 | a circle for each target: `OnCircle` |
    | 19 | `GnssVector`, with ``earth="ellipsoid"`` and a longitude, or in a grid |
    | 21, 22 | `EqualHeightDifference`, `EqualDistance` |

    σ = σ_abs + σ_rel D of lengths and σ_abs + σ_rel / D of angles, σ_rel of angles in metres; D is
    horizontal for directions and azimuths. Lines with a negative code or σ take no part; the id of
    a simple observation is its line, with the name of the file before it in files that the main
    one names. Words behind the file of codes 21 and 22 have no effect. Code 2 (a distance along the
    ellipsoid) is refused. σ of coordinates in a grid are those of the stereographic plane at the
    centre, as in Comp3D.

    Args:
        path: project (.comp), or observations (.obs) with the points beside them.
        points: file of points (.cor) for observations; None: the file with the name of the
            observations, or the only one in the folder.
        latitude: latitude of the centre, degrees; a must for observations without a project.
        longitude: longitude of the centre, degrees; a must for GNSS baselines only.
        refraction: refraction coefficient; None: that of the project, or 0.12.
        earth: "sphere": the sphere of Comp3D's own simple observations. "ellipsoid": as its
            sub-frames are computed since version 5.22; coordinates differ by 2 µm at 100 m. None:
            the sphere for local projects, the ellipsoid for those in a grid, which take nothing
            else.
        deflections: whether deflections of the vertical in the file of points are used.
        crs: reference system of the grid instead of the project's; observations (.obs) of points in
            a grid need it, and no latitude: their centre is the mean of the points. With an EPSG
            code and no geoid, heights are ellipsoidal, as in Comp3D.
        geoid: geoid of the heights of a project whose heights are altitudes: the path of a grid, or
            a constant undulation in metres.

    Raises:
        InputError: every problem of all files, each with file and line.
    """
    first = Path(path)
    files = Comp3dFiles()
    project = _project(files, first, points, latitude, refraction, in_grid=crs is not None)
    if crs is not None or project.projection is not None:
        started = _in_grid(files, first, project, crs, geoid, earth)
    else:
        if geoid is not None:
            what = "a local project has no geoid: geoid= belongs to a project in a grid"
            raise InputError(Problem(what, first.name))
        started = _local(files, first, project, longitude, earth or "sphere")
    network, given, origin, used = started
    lines = list(files.lines(project.observations))
    network.set_refraction(value=project.refraction, fixed=True)
    sphere = not isinstance(network.frame, TopocentricFrame)
    observations = _Observations(files, network, given, origin, sphere=sphere)
    if longitude is None and network.crs is None:
        for line in lines:
            if line.words[0] == "19":
                line.wrong("GNSS baselines are geocentric: longitude= of the centre is missing")
    observations.read(lines, project.observations)
    if deflections == "as stated":
        _deflections(network, used)
    files.problems.finish(network)
    return network


def _local(
    files: Comp3dFiles, path: Path, project: Comp3dProject, longitude: float | None, earth: str
) -> ProjectStart:
    """Return the points of a local project in its frame."""
    origin = Comp3dOrigin(project.latitude, longitude or 0.0)
    if not -89.0 <= project.latitude <= 89.0 or not -360.0 <= origin.longitude <= 360.0:
        where = f"latitude {project.latitude}, longitude {origin.longitude}"
        raise InputError(f"{where}: must be from -89 to 89 and from -360 to 360 degrees")
    sphere = earth == "sphere"
    network = Network(path.stem, frame=origin.sphere if sphere else origin.frame)
    given = read_points(
        files,
        project.points,
        cartesian=origin.to_cartesian if sphere else origin.on_ellipsoid,
        radius=origin.radius,
        centre=project.centre or (0.0, 0.0),
    )
    used = {n: p for n, p in given.items() if p.code != IGNORED_POINT_CODE}
    joint = set() if project.covariance is None else jointly_observed_points(used)
    for point in used.values():
        add_point(network, point, weighted=point.name not in joint)
    if joint and project.covariance is not None:
        add_joint_covariance(files, network, used, project.covariance)
    return network, given, origin, used


def _in_grid(
    files: Comp3dFiles,
    path: Path,
    project: Comp3dProject,
    crs: ReferenceSystem | str | None,
    geoid: str | float | None,
    earth: str | None,
) -> ProjectStart:
    """Return the points of a project in a grid in the topocentric frame at its centre."""
    if earth == "sphere":
        what = "a project in a grid is computed on the ellipsoid: leave earth='sphere' out"
        raise InputError(Problem(what, path.name))
    place = path.name if crs is not None else project.place or path.name
    system = comp3d_grid_system(project, crs, geoid, place)
    given = read_points(files, project.points, cartesian=np.copy, radius=math.inf)
    grid = comp3d_grid(system, project.centre, given, place)
    given = projected_points(grid, given)
    used = {n: p for n, p in given.items() if p.code != IGNORED_POINT_CODE}
    files.problems.raise_all()
    network = network_in_grid(files, grid, used, project.covariance, path.stem)
    return network, given, grid.origin, used


def _project(
    files: Comp3dFiles,
    path: Path,
    points: str | Path | None,
    latitude: float | None,
    refraction: float | None,
    *,
    in_grid: bool,
) -> Comp3dProject:
    """Return the project of a file, with what the caller states."""
    if path.suffix.lower() == ".comp":
        found = read_comp3d_project(path, files.problems)
        return Comp3dProject(
            found.points if points is None else Path(points),
            found.observations,
            found.latitude if latitude is None else latitude,
            found.centre,
            found.refraction if refraction is None else refraction,
            found.covariance,
            found.projection,
            found.ellipsoidal,
            found.place,
        )
    if latitude is None and not in_grid:
        what = (
            "needs latitude=, that of the centre in degrees, which a project (.comp) states, or "
            "crs=, the reference system of a grid"
        )
        raise InputError(Problem(what, path.name))
    if points is None:
        beside = sorted(path.parent.glob("*.cor"))
        same = [p for p in beside if p.stem == path.stem]
        if len(same or beside) != 1:
            what = f"has {len(beside)} files .cor beside it: name the one with points="
            raise InputError(Problem(what, path.name))
        points = (same or beside)[0]
    k = COMP3D_REFRACTION if refraction is None else refraction
    return Comp3dProject(Path(points), path, latitude or 0.0, None, k, None)


def _deflections(network: Network, given: dict[str, Comp3dPoint]) -> None:
    """State deflections of the vertical, as Comp3D does if every station has one."""
    stations = {o.station for o in network.observations.values()
                if isinstance(o, Direction | ZenithAngle | Azimuth)}  # fmt: skip
    stations |= {f.origin for f in network.frames.values() if f.origin and f.constants[-1]}
    stated = {n for n, p in given.items() if p.eta_xi is not None and any(p.eta_xi)}
    lacking = sorted(n for n in stations if n not in given or given[n].eta_xi is None)
    if not stated:
        return
    if lacking:
        line = given[sorted(stated)[0]].line
        what = "has a deflection of the vertical, but station"
        line.wrong(f"{what} {lacking[0]!r} has none; deflections='ignore' uses none")
        return
    for name, p in given.items():
        if p.eta_xi is not None:
            network.set_vertical(name, eta=p.eta_xi[0], xi=p.eta_xi[1], fixed=True)


class _Observations:
    """Adds the observations of lines to a network."""

    def __init__(
        self,
        files: Comp3dFiles,
        network: Network,
        given: dict[str, Comp3dPoint],
        origin: Comp3dOrigin,
        *,
        sphere: bool,
    ) -> None:
        self.files = files
        self.network = network
        self.given = given
        self.origin = origin
        self.radius = origin.radius
        self.sphere = sphere
        """Whether the north of every station is the Y axis, to which azimuths are then reduced."""
        self.sets: dict[str, int] = {}
        self.main = Path()

    def read(self, lines: list[Comp3dLine], main: Path) -> None:
        """Add points that only observations name, then the observations.

        Args:
            lines: lines of all files of observations.
            main: the file that names the others; its simple observations have their line as id.
        """
        self.main = main
        ignored = {n for n, p in self.given.items() if p.code == IGNORED_POINT_CODE}
        active = []
        for line in lines:
            code = line.words[0]
            if code.lstrip("-") not in (*SINGLE_LINE_CODES, *SET_FUNCTIONS) or len(line.words) < 2:
                valid = ", ".join((*SINGLE_LINE_CODES, *SET_FUNCTIONS))
                more = " (code 2 runs along the ellipsoid: give 1)" if code == "2" else ""
                line.wrong(f"begins with an unknown code {code[:20]!r}; valid: {valid}{more}")
                continue
            simple = code.lstrip("-") in SINGLE_LINE_CODES
            if ignored & set(line.words[1 : 3 if simple else 2]):
                line.switched_off()
                continue
            active.append(line)
        for line in active:
            self._state(line)
        for line in active:
            if line.words[0].lstrip("-") in SINGLE_LINE_CODES:
                self._simple(line)
        for line in active:
            if line.words[0] in SET_FUNCTIONS:
                SET_FUNCTIONS[line.words[0]](self.files, self.network, line)

    def _state(self, line: Comp3dLine) -> None:
        """State the points of a line that the file of points does not have."""
        code = line.words[0].lstrip("-")
        if code in SINGLE_LINE_CODES:
            names = line.words[1:3]
        elif code in SET_FILE_PLACES and len(line.words) > SET_FILE_PLACES[code][0]:
            at, count = SET_FILE_PLACES[code]
            names = line.words[1:at]
            path = self.files.beside(line, line.words[at])
            if path is not None:
                names += [n for r in Comp3dFiles().lines(path) for n in r.words[:count]]
        else:
            return
        for name in names:
            if name not in self.network.points and name not in self.given:
                line.attempt(self.network.add_point, name)

    def _simple(self, line: Comp3dLine) -> None:
        words, before = line.words, line.file.problems.count
        if not 5 <= len(words) <= 8 or len(words) == 7:
            what = "code, station, target, value, σ_abs, σ_rel or none, and two heights or none"
            line.wrong(f"an observation has {what}, not {len(words)} words")
            return
        code, station, target = words[:3]
        value, absolute = line.number_at(3, "the value"), line.number_at(4, "σ_abs")
        relative = line.number_at(5, "σ_rel") if len(words) > 5 else 0.0
        heights = [line.number_at(i, "a height") for i in (6, 7)] if len(words) > 7 else [0.0, 0.0]
        if line.file.problems.count > before:
            return
        opens = code == "7" or (code == "5" and station not in self.sets)
        if opens or (code == "-7"):
            self.sets[station] = self.sets.get(station, 0) + 1
        if code.startswith("-") or (absolute < 0 and code != "9"):
            line.switched_off()
            return
        if absolute == 0 and relative == 0 and code != "9":
            line.wrong("σ must be > 0, or negative for an observation that takes no part")
            return
        more: dict[str, Any] = {"source": line.source, "id": self._id(line)}
        ends = {"instrument_height": heights[0], "target_height": heights[1]}
        if code in ("9", "14", "15"):
            self._differences(line, value, absolute, relative, any(heights))
            return
        kinds = {"4": HeightDifference, "6": ZenithAngle, "8": Azimuth}
        make: Any = Direction if code in "57" else kinds.get(code, SlopeDistance)
        if code in ("1", "3", "4"):
            sigma = _of_length(line, self.network, absolute, relative)
        else:
            sigma = _of_angle(line, absolute * GON, relative)
            value *= GON
        if code in ("5", "7"):
            more["set"] = str(self.sets[station])
        if code == "8" and self.sphere:
            value -= self._convergence(line, station)
        if sigma is None:
            return
        made = line.attempt(make, station, target, value, sigma=sigma, **more, **ends)
        if made is not None:
            line.attempt(self.network.add, made)

    def _id(self, line: Comp3dLine) -> str:
        inner = "" if line.file.path == self.main else f"{line.file.path.name}:"
        return f"{inner}{line.number}"

    def _convergence(self, line: Comp3dLine, station: str) -> float:
        point = self.given.get(station)
        if point is None:
            line.wrong(f"an azimuth needs coordinates of its station {station[:40]!r}")
            return 0.0
        return self.origin.convergence(float(point.projected[0]))

    def _differences(
        self, line: Comp3dLine, value: float, absolute: float, relative: float, heights: bool
    ) -> None:
        """Add differences of coordinates: both of code 9 with σ of east and north, or one.

        Without a second σ that of code 9 is the same in both.
        """
        code, station, target = line.words[:3]
        if heights:
            line.wrong("differences of coordinates have no heights of instruments")
            return
        if code != "9" and relative != 0.0:
            line.wrong("σ_rel of a difference of coordinates is not read: add it to σ_abs")
            return
        # Of projected coordinates, which are 1 + h/R times as large on the ground.
        point = self.given.get(station, self.given.get(target))
        scale = 1.0 if point is None else 1.0 + float(point.projected[2]) / self.radius
        north = relative if relative != 0.0 else absolute
        parts = {"9": (("x", 0.0, absolute), ("y", 0.0, north)), "14": (("x", value, absolute),)}
        for axis, difference, sigma in parts.get(code, (("y", value, absolute),)):
            if sigma > 0:
                made = line.attempt(
                    CoordinateDifference,
                    station,
                    target,
                    (scale * difference,),
                    axes=axis,
                    # On the ellipsoid the axes of the horizon turn by the convergence of meridians,
                    # and those of the frame tilt the height difference.
                    horizon=self.sphere or code == "9",
                    sigma=scale * sigma,
                    id=self._id(line) + (f" {axis}" if code == "9" else ""),
                    source=line.source,
                )
                if made is not None:
                    line.attempt(self.network.add, made)
            else:
                line.switched_off()


def _of_length(
    line: Comp3dLine, network: Network, absolute: float, relative: float
) -> StandardDeviation | float | None:
    """Return σ_abs + σ_rel D; that of a height difference from given coordinates."""
    if relative == 0.0:
        return absolute
    if line.words[0] != "4":
        return _observation_of(line, constant=absolute, ppm=1e6 * relative)
    a, b = (np.array(network.points[n].coordinates, dtype=float) for n in line.words[1:3])
    distance = float(np.linalg.norm(b - a))
    if not np.isfinite(distance):
        line.wrong("σ_rel of a height difference needs coordinates of its points")
        return None
    return absolute + relative * distance


def _of_angle(
    line: Comp3dLine, absolute: float, relative: float
) -> StandardDeviation | float | None:
    """Return σ_abs + σ_rel / D, radians; σ_rel, metres, has the effect of centring."""
    if relative == 0.0:
        return absolute
    return _observation_of(line, constant=absolute, centring_instrument=relative)


def _observation_of(line: Comp3dLine, **parts: float) -> StandardDeviation | None:
    found: StandardDeviation | None = line.attempt(StandardDeviation, **parts, combine="linear")
    return found


READER = Reader("comp3d", (".comp", ".obs"), "Comp3D", NetworkReader(read_comp3d), own_grid=True)
