"""Writer of STAR*NET data, local or in a grid: points, observations, vectors, each with its σ."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ...entities import Point
from ...errors import InputError, Problem, taking
from ...frames import LocalFrame, TopocentricFrame
from ...models.unknown_registry import UNKNOWNS
from ...network.grid.projected_lines import arc, turn_of_line
from ...network.network import Network
from ...observations import (
    Azimuth,
    ControlPoint,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ...observations.ellipsoidal_observations import CHORD, EllipsoidDistance, GeodeticAzimuth
from ..file_transaction import write_files
from ..format_limits import grid_points, scalar_sigmas
from ..numbers import write_quantity

NAME_SEPARATORS = "-:|~+"
"""Characters that may join names, in the order of preference."""
INSTRUMENT_ATTRIBUTES = ("instrument", "index_error", "collimation_error")
"""Attributes of observations that name unknowns of instruments."""
SPECIAL_CHARACTERS = "#'‘\"&!*?"
"""Characters that mean something else in a line."""
MAX_WRITTEN_CORRELATION = 1e-3
"""Correlation of control up to which it is written as none: that of turning axes."""
MAX_CONTROL_OFFSET_M = 1e-4
"""Distance (m) up to which a position of control is that of its point."""
LinesByPoint: TypeAlias = "dict[str, list[str]]"


@taking(Network)
def write_star_net(network: Network, path: str | Path) -> None:
    """Write a data file of STAR*NET (``.dat``), with a standard error in every line.

    Coordinates are metres in the order EN, angles gons, standard errors metres and milligons; the
    file says so (.UNITS, .ORDER, .DELTA, .REFRACTION). Read it in a project of 3D adjustment.
    Points without coordinates have no C line. Standard deviations with ppm or centring are written
    as they are at the coordinates of the network, given or approximate ones that its observations
    determine; an adjusted one is `Solution.as_network`.

    A network on the Earth with the reference system of a grid is written as a grid project:
    easting, northing and elevation, bearings from grid north, distances on the
    ellipsoid behind .MEASURE, GNSS vectors as G1 to G3, control
    with its standard errors. State the coordinate system and the geoid in STAR*NET.

    Args:
        network: the network.
        path: the file.

    Raises:
        InputError: everything that the format cannot express, all at once: another frame than a
            local one with axes en or ne and no curvature, or one on the Earth without a grid; a
            free datum, cameras and photos, correlations, chords, kinds of observations other than
            directions, angles, azimuths, distances, zenith angles and height differences, unknowns
            of instruments, refraction that is not held, names with characters of the format.
            Nothing is written then.
    """
    target = Path(path)
    writer = _Writer(network)
    text = writer.text()
    if writer.problems:
        raise InputError(writer.problems)
    write_files(target.parent, {target.name: text})


class _Writer:
    def __init__(self, network: Network) -> None:
        self.network = network
        self.grid = grid_points(network)
        self.control: dict[str, ControlPoint] = {}
        self.problems: list[Problem] = []
        self.separator = "-"

    def refuse(self, what: str, where: str = "") -> None:
        self.problems.append(Problem(f"STAR*NET cannot hold {what}", where))

    def text(self) -> str:
        """Return the file; what it cannot hold is noted."""
        network = self.network
        frame = network.frame
        local = isinstance(frame, LocalFrame) and not frame.curvature and frame.axes in ("en", "ne")
        if not local and self.grid is None:
            what = "this frame: it takes a flat local one with axes en or ne, or one with the "
            self.refuse(f"{what}reference system of a grid", network.name)
            return ""
        if network.datum == "free":
            self.refuse("a free network: hold or weight coordinates", network.name)
        for many, noun in ((network.cameras, "cameras"), (network.photos, "photos")):
            if many:
                self.refuse(f"{noun} ({len(many)})", network.name)
        if network.clusters:
            self.refuse(f"correlated observations ({len(network.clusters)} clusters)", network.name)
        self._unknowns()
        self._names()
        self._control()
        head = [
            f"# {' '.join(network.name.split())}",
            "# 3D adjustment; metres, gons; standard errors in metres and milligons",
            ".3D",
            ".UNITS Meters GONS",
            ".ORDER EN AtFromTo",
        ]
        if self.separator != "-":
            head.append(f".SEPARATOR {self.separator}")
        if self.grid is not None:
            system = self.grid.system
            head.insert(2, f"# grid: {system.name}; elevations above: {system.vertical}")
            head.append(".GPS WEIGHT COVARIANCE")
        body = [line for p in network.points.values() for line in self._point(p)]
        return "\n".join([*head, *body, *self._observations()]) + "\n"

    def _unknowns(self) -> None:
        for kind, table in self.network.parameters.items():
            for key, unknown in table.items():
                where = f"{UNKNOWNS[kind].noun} {key!r}"
                if kind == "refraction":
                    if not unknown.fixed[0]:
                        self.refuse("an unknown coefficient of refraction: hold it", where)
                elif kind != "orientation" or unknown.fixed[0] or math.isfinite(unknown.sigma[0]):
                    self.refuse("a stated unknown of this kind", where)

    def _names(self) -> None:
        names = list(self.network.points)
        for name in names:
            odd = [c for c in name if c in SPECIAL_CHARACTERS or c.isspace() or not c.isprintable()]
            if odd or name.startswith("."):
                self.refuse(f"a name with {odd[0] if odd else '.'!r}", f"point {name!r}")
        free = [s for s in NAME_SEPARATORS if not any(s in n for n in names)]
        if free:
            self.separator = free[0]
        elif names:
            self.refuse(f"names of which some have each of {NAME_SEPARATORS}", self.network.name)

    def _control(self) -> None:
        """Find the control points of a grid, whose standard errors are in C lines."""
        if self.grid is None:
            return
        for o in self.network.observations.values():
            if isinstance(o, ControlPoint):
                if o.point in self.control or set(o.axes) != set("enu"):
                    self.refuse("control other than one position along east, north, up", o.label())
                self.control[o.point] = o

    def _grid_sigma(self, p: Point) -> tuple[float, float, float]:
        """Return σ of E, N, H of a point; what is no diagonal covariance is refused."""
        grid, o = self.grid, self.control.get(p.name)
        if p.sigma is not None or any(p.fixed) != all(p.fixed):
            self.refuse("coordinates that are weighted or held in part", f"point {p.name!r}")
        if grid is None or o is None or grid.places is None or p.name not in grid.rows:
            return (math.inf,) * 3
        given = o.covariance if o.sigma is None else np.diag(np.square(o.sigma))
        assert given is not None
        order = ["enu".index(a) for a in o.axes]
        of_enu = np.zeros((3, 3))
        of_enu[np.ix_(order, order)] = given
        xyz = np.array([p.coordinates])
        enu = self.network.frame.basis(xyz, np.zeros((1, 2))).enu[0]
        j = grid.places.jacobians[grid.rows[p.name]] @ enu.T
        covariance = j @ of_enu @ j.T
        sigma = np.sqrt(np.diag(covariance))
        off = covariance / np.outer(sigma, sigma) - np.eye(3)
        if np.abs(off).max() > MAX_WRITTEN_CORRELATION:
            self.refuse("correlated control", o.label())
        if np.linalg.norm(np.array(o.value) - xyz[0]) > MAX_CONTROL_OFFSET_M:
            self.refuse("control whose position differs from that of its point", o.label())
        east, north, up = (float(v) for v in sigma)
        return east, north, up

    def _point(self, p: Point) -> list[str]:
        if p.datum or p.check is not None:
            self.refuse("datum and check points", f"point {p.name!r}")
        east, north = (0, 1) if getattr(self.network.frame, "axes", "en") == "en" else (1, 0)
        order = (east, north, 2)
        sigma = p.sigma or (math.inf,) * 3
        coordinates = p.coordinates
        if self.grid is not None:
            sigma = self._grid_sigma(p)
            east, north, up = self.grid.coordinates[p.name].tolist()
            order, coordinates = (0, 1, 2), (east, north, up)
        known = [not math.isnan(v) for v in coordinates]

        def error(k: int) -> str:
            if p.fixed[k]:
                return "!"
            return write_quantity(sigma[k]) if math.isfinite(sigma[k]) else "*"

        if all(known):
            values = [write_quantity(coordinates[k]) for k in order]
            return [" ".join(["C", p.name, *values, *(error(k) for k in order)])]
        if known == [True, True, False]:
            values = [write_quantity(coordinates[k]) for k in order[:2]]
            return [".2D", " ".join(["C", p.name, *values, *(error(k) for k in order[:2])]), ".3D"]
        if known == [False, False, True]:
            return [f"E {p.name} {write_quantity(coordinates[2])} {error(2)}"]
        if any(known):
            self.refuse("a single horizontal coordinate", f"point {p.name!r}")
        return []

    # -- observations -----------------------------------------------------------------------------

    def _observations(self) -> list[str]:
        sets: LinesByPoint = {}
        lines: list[str] = []
        mode, refraction = "", math.nan
        observed = self.network.observations.items()
        written = {i: o for i, o in observed if not (self.grid and isinstance(o, ControlPoint))}
        vectors = GnssVector if self.grid is not None else ()
        for o in written.values():
            if isinstance(o, vectors):
                continue
            if type(o) not in _FORMS:
                self.refuse(f"a {o.kind.replace('_', ' ')}", o.label())
            elif any(getattr(o, a, None) for a in INSTRUMENT_ATTRIBUTES):
                self.refuse("unknowns of instruments", o.label())
            elif getattr(o, "face", 1) != 1 and isinstance(o, Direction):
                self.refuse("directions of the second face", o.label())
            elif isinstance(o, EllipsoidDistance) and o.line == CHORD:
                self.refuse("a chord between the feet of points", o.label())
        if self.problems or not written:
            return []
        sigmas = scalar_sigmas(self.network)
        for ident, of_network in written.items():
            if isinstance(of_network, GnssVector):
                lines += self._vector(of_network)
                continue
            o = self._in_grid(of_network)
            sigma = sigmas[ident]
            if math.isnan(sigma):
                what = "a σ that depends on unknown coordinates: write the adjusted network"
                self.refuse(what, o.label())
                continue
            wanted, words = _FORMS[type(o)](o, self.separator, sigma)
            if isinstance(o, Direction):
                sets.setdefault(f"{o.station}\n{o.set}", []).append(words)
                continue
            if wanted and wanted != mode:
                mode = wanted
                lines.append(f".DELTA {wanted}")
            if isinstance(o, EllipsoidDistance) and self.grid is not None:
                words = f".MEASURE DIST=ELLIP\n{words}\n.MEASURE DIST=GROUND"
            if isinstance(o, ZenithAngle):
                coefficient = self._coefficient(o)
                if coefficient != refraction:
                    refraction = coefficient
                    lines.append(f".REFRACTION {write_quantity(coefficient)}")
            lines.append(words)
        for key, of_set in sets.items():
            lines += [f"DB {key.partition(chr(10))[0]}", *of_set, "DE"]
        return lines

    def _coefficient(self, o: ZenithAngle) -> float:
        """Return STAR*NET's coefficient c of the group: κ = 2 c − 1, and k = 2 c on the Earth."""
        group = self.network.refractions.get(o.refraction or "")
        kappa = 0.0 if group is None else group.values[0]
        return (kappa + (1.0 if self.grid is None else 0.0)) / 2.0

    def _in_grid(self, o: Observation) -> Observation:
        """Return an azimuth from grid north, a height difference without the geoid's, or an arc.

        An arc at sea level becomes one on the ellipsoid.
        """
        kinds = Azimuth | GeodeticAzimuth | EllipsoidDistance | HeightDifference
        if self.grid is None or not isinstance(o, kinds):
            return o
        rows, places = self.grid.rows, self.grid.places
        if places is None or not {o.station, o.target} <= set(rows):
            noun = o.kind.replace("_", " ")
            self.refuse(f"a {noun} of a point without coordinates", o.label())
            return o
        i, j = rows[o.station], rows[o.target]
        frame, ends = self.network.frame, [i, j]
        names = (o.station, o.target)
        xyz = np.array([self.network.points[n].coordinates for n in names])
        if isinstance(o, Azimuth | GeodeticAzimuth):
            turn = turn_of_line(frame, xyz, places.coordinates[ends])
            return replace(o, value=(o.value - turn) % (2 * math.pi))
        if isinstance(o, EllipsoidDistance):
            there = arc(frame, xyz, (o.station_surface, o.target_surface))
            return replace(o, value=o.value * arc(frame, xyz) / there)
        return replace(o, value=o.value - float(places.undulation[j] - places.undulation[i]))

    def _vector(self, o: GnssVector) -> list[str]:
        """Return the lines of a GNSS vector, geocentric."""
        frame = self.network.frame
        turn = frame.axes_in_geocentric.T if isinstance(frame, TopocentricFrame) else np.eye(3)
        if o.instrument_height or o.target_height:
            self.refuse("heights of antennas", o.label())
        given = o.covariance if o.sigma is None else np.diag(np.square(o.sigma))
        assert given is not None
        c = turn @ given @ turn.T
        value = " ".join(write_quantity(float(v)) for v in turn @ np.array(o.value))
        return [
            f"G1 {_ends(o, self.separator)} {value}",
            "G2 " + " ".join(repr(float(v)) for v in np.diag(c)),
            "G3 " + " ".join(repr(float(v)) for v in (c[0, 1], c[0, 2], c[1, 2])),
        ]


def _ends(o: Observation, separator: str) -> str:
    return f"{o.station}{separator}{o.target}"  # type: ignore[attr-defined]


def _heights(o: Observation) -> str:
    hi, ht = o.instrument_height, o.target_height  # type: ignore[attr-defined]
    return f" {write_quantity(hi)}/{write_quantity(ht)}" if hi or ht else ""


def _slope(o: SlopeDistance, s: str, sigma: float) -> tuple[str, str]:
    return "OFF", f"D {_ends(o, s)} {write_quantity(o.value)} {write_quantity(sigma)}{_heights(o)}"


def _horizontal(o: HorizontalDistance | EllipsoidDistance, s: str, sigma: float) -> tuple[str, str]:
    return "ON", f"D {_ends(o, s)} {write_quantity(o.value)} {write_quantity(sigma)}"


def _zenith(o: ZenithAngle, s: str, sigma: float) -> tuple[str, str]:
    value, error = write_quantity(o.in_face_one, "gon"), write_quantity(sigma, "mgon")
    return "OFF", f"V {_ends(o, s)} {value} {error}{_heights(o)}"


def _difference(o: HeightDifference, s: str, sigma: float) -> tuple[str, str]:
    if o.length_km is not None and not _heights(o):
        length = write_quantity(1000.0 * o.length_km)
        return "", f"L {_ends(o, s)} {write_quantity(o.value)} {length} {write_quantity(sigma)}"
    return "ON", f"V {_ends(o, s)} {write_quantity(o.value)} {write_quantity(sigma)}{_heights(o)}"


def _azimuth(o: Azimuth | GeodeticAzimuth, s: str, sigma: float) -> tuple[str, str]:
    return "", f"B {_ends(o, s)} {write_quantity(o.value, 'gon')} {write_quantity(sigma, 'mgon')}"


def _angle(o: HorizontalAngle, s: str, sigma: float) -> tuple[str, str]:
    names = s.join((o.station, o.target, o.target2))
    return "", f"A {names} {write_quantity(o.value, 'gon')} {write_quantity(sigma, 'mgon')}"


def _direction(o: Direction, s: str, sigma: float) -> tuple[str, str]:
    return "", f"DN {o.target} {write_quantity(o.value, 'gon')} {write_quantity(sigma, 'mgon')}"


_FORMS: dict[type, Callable[..., tuple[str, str]]] = {
    SlopeDistance: _slope,
    HorizontalDistance: _horizontal,
    EllipsoidDistance: _horizontal,
    ZenithAngle: _zenith,
    HeightDifference: _difference,
    Azimuth: _azimuth,
    GeodeticAzimuth: _azimuth,
    HorizontalAngle: _angle,
    Direction: _direction,
}
"""Mode of .DELTA, where a line has one, and the line of each kind of observation."""
