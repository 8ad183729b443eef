"""Comp3D: points (.cor), observations (.obs), and its adjusted points and observations (.csv).

What was found about the frame of Comp3D, from its printed values:

- X, Y, Z are a stereographic projection at sea level, and the height. The observation
  equations work in cartesian coordinates east, north, up of a sphere at the origin of the project,
  with the mean radius √(MN): 0.2 mm off in plan (X h/R) and 0.8 mm in height (d²/2R) at 100 m from
  the origin and 10 m above it. `LocalFrame` with curvature and that radius is the same: residuals
  agree to 2·10⁻⁵ σ, coordinates to 0.02 µm.
- The printed ``x_cart`` … are east, north, up on the ellipsoid GRS80 instead, 2 µm away in
  height: for show, not what the equations use.
- Azimuths (code 8) count from true north, which lies X tanφ/N west of the Y axis at X east of
  the origin (convergence of meridians, 1.5 mm over the network). They are reduced to the Y axis
  here, the north of `LocalFrame`; a `TopocentricFrame` needs no reduction.
- Directions and zenith angles of a station with deflections are corrected to first order in
  the deflection (column ``deflection_correction``, added to the observed value).
- Its heights come in steps of 2⁻³⁰ m = 0.93 nm, the resolution of doubles at the radius of the
  Earth, through which its coordinates pass.
- The sub-frames (code 11) of later versions (5.22) work on the ellipsoid: coordinates are those of
  the inverse double stereographic projection and the normals those of GRS80 (`Origin.on_ellipsoid`,
  to 5 nm of its printed ``coord_compensated_cartesian``), where σ of plane coordinates grow with
  1 + h/R. The horizon of a levelled sub-frame is tilted wrongly: at a station of longitude Δλ east
  of the origin by Δλ towards the east instead of Δλ cosφ, as if meridians did not converge. Its
  ``R_global2instr`` at stations 4 and 6 of ``bascule``, x = 1000 m, prints 2.3757e-4 where
  x/N = 1.5649e-4 = 2.3757e-4 cos 48.8°. Deflections η = Δλ (1 − cosφ) that are held at the stations
  do the same (`tilted_as_comp3d`).
- Differences of coordinates (codes 9, 14, 15) are those of the projected coordinates.
- Code 4 is a difference of heights. Code 5 of a point: x and y are held, z is weighted.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import LocalFrame, TopocentricFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import (
    Azimuth,
    Direction,
    FrameCoordinate,
    FrameDirection,
    FrameDistance,
    FrameZenith,
    HeightDifference,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from factorgraph_adj.solve.solution import Solution
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC, GON

FREE, WEIGHTED, HEIGHT = 0, 1, 5
"""Codes of points: approximate, weighted, with a weighted height and held X and Y."""


@dataclass(frozen=True)
class Origin:
    """The centre of a project on GRS80."""

    latitude: float
    """Geodetic latitude, degrees."""

    @property
    def radii(self) -> tuple[float, float]:
        """Radii of curvature M and N, metres."""
        m, n = ellipsoid("GRS80").radii(np.radians(np.array([self.latitude])))
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
        sphere to the ellipsoid, both conformal (``sterea`` of PROJ).
        """
        globe, phi0, r = ellipsoid("GRS80"), np.radians(self.latitude), self.radius
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
    def frame(self) -> TopocentricFrame:
        """East, north, up at the origin, on the ellipsoid."""
        return TopocentricFrame(np.radians(self.latitude), 0.0, 0.0, "GRS80", radius=self.radius)

    def on_ellipsoid(self, projected: Array) -> Array:
        """Return east, north, up (3,) on the ellipsoid of stereographic X, Y and height."""
        phi, longitude = (np.array([a]) for a in self.geodetic(projected))
        there = ellipsoid("GRS80").to_cartesian(phi, longitude, np.array([projected[2]]))
        return self.frame.from_geocentric(there)[0]

    def convergence(self, east: float) -> float:
        """Return by how much true north lies west of the Y axis, radians."""
        return float(east * np.tan(np.radians(self.latitude)) / self.radii[1])


@dataclass(frozen=True)
class Given:
    """A line of the .cor file."""

    name: str
    code: int
    xyz: Array
    """Cartesian, metres."""
    sigma: Array
    """Metres."""
    eta_xi: tuple[float, float]
    """Deflection, radians."""


def read_cor(path: Path, cartesian: Callable[[Array], Array], radius: float) -> list[Given]:
    """Read points; ``cartesian`` turns the projected coordinates into those of the frame.

    The σ of X and Y are those of projected coordinates: on the ground they are 1 + h/R times as
    large.
    """
    points = []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split("*")[0].split()
        if not words:
            continue
        numbers = [float(w) for w in words[2:]]
        eta, xi = numbers[6:8] if len(numbers) >= 8 else (0.0, 0.0)
        on_ground = 1.0 + numbers[2] / radius
        points.append(
            Given(
                words[1],
                int(words[0]),
                cartesian(np.array(numbers[:3])),
                np.array(numbers[3:6]) * [on_ground, on_ground, 1.0][: len(numbers[3:6])],
                (eta * ARCSEC, xi * ARCSEC),
            )
        )
    return points


def read_obs(path: Path) -> tuple[list[Observation], list[str]]:
    """Return the active observations and the names of points in the order of their appearance.

    Code 7, or the first direction of a station, opens a set and is observed like the others.
    A negative standard deviation switches an observation off. The observation's id is its line.
    """
    observations: list[Observation] = []
    names: dict[str, None] = {}
    sets: dict[str, int] = {}
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        words = line.split("*")[0].split()
        if not words:
            continue
        code, station = int(words[0]), words[1]
        if code not in (3, 4, 5, 6, 7, 8):
            continue
        target, value, sigma = words[2], float(words[3]), float(words[4])
        heights = [float(w) for w in words[6:8]] if len(words) > 7 else [0.0, 0.0]
        names.update({station: None, target: None})
        if code == 7 or (code == 5 and station not in sets):
            sets[station] = sets.get(station, 0) + 1
        if sigma < 0:
            continue
        common = {
            "instrument_height": heights[0],
            "target_height": heights[1],
            "id": str(number),
            "source": f"{path.name} line {number}",
        }
        angle = {"value": value * GON, "sigma": sigma * GON, **common}
        if code == 3:
            observations.append(SlopeDistance(station, target, value, sigma=sigma, **common))
        elif code == 4:
            observations.append(HeightDifference(station, target, value, sigma=sigma, **common))
        elif code == 6:
            observations.append(ZenithAngle(station, target, **angle))
        elif code == 8:
            observations.append(Azimuth(station, target, **angle))
        else:
            observations.append(Direction(station, target, set=str(sets[station]), **angle))
    return observations, list(names)


@dataclass(frozen=True)
class Subframe:
    """A sub-frame (code 11): coordinates of points in axes of their own, origin at a point."""

    name: str
    """Name of the sub-frame: its file without ending."""
    origin: str
    """The point at its origin."""
    level: bool
    """Whether its third axis is the vertical of the origin: ``1`` at the end of the line."""
    coordinates: tuple[tuple[str, tuple[float, ...], tuple[float, ...]], ...]
    """Points with their coordinates and standard deviations, metres."""


def read_subframes(path: Path) -> list[Subframe]:
    """Return the sub-frames of observations; their files lie beside them or in ``origin``."""
    found = []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split("*")[0].split()
        if words[:1] != ["11"]:
            continue
        name = words[2].removeprefix("@")
        # Beside the observations lies what Comp3D writes back, with its results as comments.
        file = next(f for f in (path.parent / "origin" / name, path.parent / name) if f.exists())
        found.append(
            Subframe(file.stem, words[1], words[3:4] == ["1"], tuple(_read_coordinates(file)))
        )
    return found


def _read_coordinates(
    file: Path,
) -> Iterator[tuple[str, tuple[float, ...], tuple[float, ...]]]:
    """Yield the points of a file .xyz; a single σ is that of all three axes."""
    for line in file.read_text(encoding="utf-8", errors="replace").splitlines():
        words = line.split("*")[0].split()
        if words:
            x, y, z, *sigma = (float(w) for w in words[1:7])
            yield words[0], (x, y, z), tuple(sigma if len(sigma) == 3 else sigma[:1] * 3)


def add_subframe(network: Network, subframe: Subframe) -> None:
    """Add a sub-frame: a frame with its origin at a point, its unit the metre."""
    for name in (subframe.origin, *(c[0] for c in subframe.coordinates)):
        if name not in network.points:
            network.add_point(name)
    network.add_frame(
        subframe.name,
        free=("rz",) if subframe.level else ("rx", "ry", "rz"),
        origin=subframe.origin,
        level=subframe.level,
    )
    network.add(
        *(FrameCoordinate(subframe.name, n, x, sigma=s) for n, x, s in subframe.coordinates)
    )


def as_polar(network: Network) -> Network:
    """Return the network with coordinates of sub-frames as direction, zenith angle, distance.

    Their standard deviations are those of the coordinates, which must be equal in all axes: σ/h of
    the direction, σ/S of the zenith angle and σ of the distance.
    """
    polar = network.copy()
    polar.observations = {}
    for o in network.observations.values():
        if not isinstance(o, FrameCoordinate):
            polar.add(o)
            continue
        assert o.sigma is not None and o.point is not None and len(set(o.sigma)) == 1
        x, y, z = o.value
        sigma, across, length = o.sigma[0], np.hypot(x, y), float(np.linalg.norm(o.value))
        polar.add(
            FrameDirection(o.frame, o.point, np.arctan2(x, y) % (2 * np.pi), sigma=sigma / across),
            FrameZenith(o.frame, o.point, float(np.arctan2(across, z)), sigma=sigma / length),
            FrameDistance(o.frame, o.point, length, sigma=sigma),
        )
    return polar


def tilted_as_comp3d(solution: Solution) -> Network:
    """Return the network with the horizons that Comp3D gives levelled sub-frames.

    Δλ (1 − cosφ) is what its tilt to the east has too much; a micrometre in the place of a station
    is nothing in it.
    """
    network = solution.network.copy()
    for frame in network.frames.values():
        if frame.constants[-1]:
            at = network.frame.geodetic(solution.point(frame.origin)[None])
            assert at is not None
            latitude, longitude, _ = (float(v[0]) for v in at)
            eta = longitude * (1.0 - np.cos(latitude))
            network.set_vertical(frame.origin, eta=eta, fixed=True)
    return network


def read_network(
    cor: Path,
    obs: Path,
    *,
    latitude: float,
    refraction: float,
    deflections: bool = False,
    frame: TopocentricFrame | None = None,
) -> Network:
    """Read a Comp3D project.

    Args:
        cor: the points. Code 1: weighted; code 0: approximate.
        obs: the observations.
        latitude: of the centre, degrees.
        refraction: coefficient, held.
        deflections: whether the deflections of the stations count.
        frame: none: the sphere of Comp3D.
    """
    origin = Origin(latitude)
    network = Network(obs.stem, frame=frame or LocalFrame(curvature=True, radius=origin.radius))
    cartesian = origin.to_cartesian if frame is None else origin.on_ellipsoid
    given = {g.name: g for g in read_cor(cor, cartesian, origin.radius)}
    observations, names = read_obs(obs)
    for name in [*given, *(n for n in names if n not in given)]:
        g = given.get(name)
        if g is None:
            network.add_point(name)
        elif g.code == HEIGHT:
            network.add_point(name, g.xyz, fixed="xy", sigma=(np.inf, np.inf, g.sigma[2]))
        else:
            network.add_point(name, g.xyz, sigma=g.sigma if g.code == WEIGHTED else None)
        if g is not None and deflections:
            network.set_vertical(name, eta=g.eta_xi[0], xi=g.eta_xi[1], fixed=True)
    network.set_refraction(value=refraction, fixed=True)
    for o in observations:
        if isinstance(o, Azimuth) and frame is None:
            turn = origin.convergence(float(given[o.station].xyz[0]))
            network.add(replace(o, value=o.value - turn))
        else:
            network.add(o)
    for subframe in read_subframes(obs):
        add_subframe(network, subframe)
    return network


def read_table(path: Path) -> list[dict[str, str]]:
    """Read a table of results."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def read_result(path: Path) -> dict[str, Any]:
    """Read a result (.comp): JSON behind ``data=``."""
    text = path.read_text(encoding="utf-8", errors="replace")
    return dict(json.loads(text[text.index("{") :]))


@dataclass(frozen=True)
class Ellipsoid:
    """A standard error ellipsoid as Comp3D prints it, scaled by its σ0."""

    axes: Array
    """Semi-axis (m), azimuth and inclination (gon, both from 0 to 200) of each axis, (3, 3)."""


def read_ellipsoids(path: Path) -> dict[str, Ellipsoid]:
    """Read the ellipsoids of the points of a result (.comp)."""
    points = read_result(path)["points"]
    return {n: Ellipsoid(np.array(p["ellips"]["axes"])) for n, p in points.items()}
