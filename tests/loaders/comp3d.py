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
"""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.frames import LocalFrame, TopocentricFrame
from factorgraph_adj.network.network import Network
from factorgraph_adj.observations import Azimuth, Direction, Observation, SlopeDistance, ZenithAngle
from factorgraph_adj.types import Array
from factorgraph_adj.units import ARCSEC, GON

FREE = 0
WEIGHTED = 1


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

    def on_ellipsoid(self, projected: Array) -> Array:
        """Return the same on the ellipsoid, M along north, N along east; to 0.03 µm at 150 m."""
        m, n = self.radii
        x, y, h = projected
        return np.array([x * (1 + h / n), y * (1 + h / m), h - x * x / (2 * n) - y * y / (2 * m)])

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


def read_cor(path: Path, cartesian: Callable[[Array], Array]) -> list[Given]:
    """Read points; ``cartesian`` turns the projected coordinates into those of the frame."""
    points = []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split("*")[0].split()
        if not words:
            continue
        numbers = [float(w) for w in words[2:]]
        eta, xi = numbers[6:8] if len(numbers) >= 8 else (0.0, 0.0)
        points.append(
            Given(
                words[1],
                int(words[0]),
                cartesian(np.array(numbers[:3])),
                np.array(numbers[3:6]),
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
        if code not in (3, 5, 6, 7, 8):
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

    origin: str
    """The point at its origin, whose vertical is its third axis."""
    file: str
    """Name of the file with its coordinates."""


def read_subframes(path: Path) -> list[Subframe]:
    """Return the verticalised sub-frames (code 11 and ``1`` at the end of the line)."""
    found = []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split("*")[0].split()
        if words[:1] == ["11"]:
            found.append(Subframe(words[1], words[2].removeprefix("@")))
    return found


def subframe_sights(origin: str, path: Path) -> list[Observation]:
    """Return the coordinates of a verticalised sub-frame as polar observations.

    Its unknowns are the turn about the vertical of its origin, and the origin: those of a total
    station. Three coordinates with the same standard deviation σ turn into slope distance (σ),
    direction (σ/D) and zenith angle (σ/S), which is a rotation: same information, same vᵀPv.
    The zenith angles name a refraction group ``none``.
    """
    observations: list[Observation] = []
    for line in path.read_text(encoding="utf-8").splitlines():
        words = line.split("*")[0].split()
        if not words:
            continue
        x, y, z, *sigmas = (float(w) for w in words[1:7])
        if len(set(sigmas)) != 1:
            raise ValueError(f"{path.name}: the standard deviations of {words[0]} differ")
        level, length = float(np.hypot(x, y)), float(np.hypot(np.hypot(x, y), z))
        target, sigma = words[0], sigmas[0]
        observations += [
            SlopeDistance(origin, target, length, sigma=sigma),
            Direction(origin, target, float(np.arctan2(x, y)), sigma=sigma / level),
            ZenithAngle(
                origin,
                target,
                float(np.arctan2(level, z)),
                sigma=sigma / length,
                refraction="none",
            ),
        ]
    return observations


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
    given = {g.name: g for g in read_cor(cor, cartesian)}
    observations, names = read_obs(obs)
    for name in [*given, *(n for n in names if n not in given)]:
        g = given.get(name)
        network.add_point(
            name,
            None if g is None else g.xyz,
            sigma=g.sigma if g is not None and g.code == WEIGHTED else None,
        )
        if g is not None and deflections:
            network.set_vertical(name, eta=g.eta_xi[0], xi=g.eta_xi[1], fixed=True)
    network.set_refraction(value=refraction, fixed=True)
    for o in observations:
        if isinstance(o, Azimuth) and frame is None:
            turn = origin.convergence(float(given[o.station].xyz[0]))
            network.add(replace(o, value=o.value - turn))
        else:
            network.add(o)
    subframes = read_subframes(obs)
    if subframes:
        network.set_refraction("none", value=0.0, fixed=True)
    for s in subframes:
        network.add(*subframe_sights(s.origin, obs.parent / "origin" / s.file))
    return network


def read_table(path: Path) -> list[dict[str, str]]:
    """Read a table of results."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


@dataclass(frozen=True)
class Ellipsoid:
    """A standard error ellipsoid as Comp3D prints it, scaled by its σ0."""

    axes: Array
    """Semi-axis (m), azimuth and inclination (gon, both from 0 to 200) of each axis, (3, 3)."""


def read_ellipsoids(path: Path) -> dict[str, Ellipsoid]:
    """Read the ellipsoids of the points of a result (.comp): JSON behind ``data=``."""
    text = path.read_text(encoding="utf-8")
    points = json.loads(text[text.index("{") :])["points"]
    return {n: Ellipsoid(np.array(p["ellips"]["axes"])) for n, p in points.items()}
