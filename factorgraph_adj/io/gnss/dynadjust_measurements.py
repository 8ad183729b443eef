"""Measurements of DynAdjust as observations: sights, sets of directions, clusters, heights."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from datetime import date
from functools import partial
from typing import Any

import numpy as np

from ...crs.geoid import geoid as open_geoid
from ...crs.terrestrial_frames import TERRESTRIAL_FRAMES, frame_transformation
from ...errors import known
from ...frames import GeocentricFrame
from ...network.network import Network
from ...observations import (
    AnyObservation,
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    ControlPoint,
    Correlated,
    Direction,
    GnssPosition,
    GnssVector,
    HorizontalAngle,
    Observation,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from ...observations.ellipsoidal_observations import (
    ARC,
    CHORD,
    EllipsoidDistance,
    EllipsoidHeight,
    EllipsoidHeightDifference,
    GeodeticAzimuth,
)
from ...types import Array
from ...units import ARCSEC
from ..numbers import PACKED_DEGREES
from ..source import ROWS_SWITCHED_OFF, Field, Problems, Source, is_unread
from ..xml_source import XmlSource
from .dynadjust_records import MeasurementRecord, RecordFile
from .dynadjust_stations import NO_GEOID, DynadjustStations, Heights, geocentric, read_geodetic

SIGHT_KINDS = {
    "S": SlopeDistance,
    "V": ZenithAngle,
    "Z": VerticalAngle,
    "B": GeodeticAzimuth,
    "K": Azimuth,
}
"""Types of sights with one value and perhaps heights of instrument and target."""
DISTANCE_LINES = {"C": CHORD, "E": ARC, "M": ARC}
"""Types of distances on the ellipsoid (C, E) and at sea level (M)."""
STATION_TYPES = "HRIJPQ"
"""Types of measurements of one station."""
LENGTH_TYPES = "SCEMLHR"
"""Types whose values are lengths."""
ORTHOMETRIC_TYPES = "LHM"
"""Types that need the undulation."""
GNSS_TYPES = "GXY"
TYPES = "ABCDEGHIJKLMPQRSVXYZ"
"""All types."""
DEFAULT_FRAME = "GDA2020"
"""Reference frame of a file that states none: DynAdjust's own default."""
SIMULATED_ARCSEC = {**dict.fromkeys("ABDKVZ", 0.01), **dict.fromkeys("IJPQ", 0.021)}
"""Standard deviations of the simulator of DynAdjust: angles, seconds of arc."""
SIMULATED_HEIGHT_M = 0.024
"""That of heights."""
SIMULATED_PER_SQRT_KM_M = 0.03
"""That of a distance or a height difference of 1 km; it grows with the root of the length."""
SIMULATED_VECTOR_M2 = (4.022e-5, -1.369e-5, 3.975e-5, 1.487e-5, -2.035e-5, 6.803e-5)
"""That of a vector: covariance xx, xy, xz, yy, yz, zz; ten times as much of a position."""


class DynadjustMeasurements:
    """Adds measurements to a network that has the stations."""

    def __init__(
        self, stations: DynadjustStations, frame: str, *, by_gda94: bool, driver: bool
    ) -> None:
        """Take the stations.

        Args:
            stations: the stations of the network.
            frame: reference frame into which vectors are brought; empty: none.
            by_gda94: whether ITRF2008 is connected by GDA94.
            driver: whether records have stations alone, as those for the simulator.
        """
        self.stations = stations
        self.network: Network = stations.network
        self.problems = stations.problems
        self.frame = frame
        self.by_gda94 = by_gda94
        self.driver = driver
        self.sets: dict[str, int] = {}

    def read(self, m: MeasurementRecord) -> None:
        """Add one measurement; problems are noted in its file."""
        if m.ignored:
            m.source.leave_out(m.line, ROWS_SWITCHED_OFF, m.label)
            return
        if m.kind not in TYPES or len(m.kind) != 1:
            valid = ", ".join(TYPES)
            m.source.wrong(m.line, f"unknown type {m.kind[:20]!r}; valid: {valid}")
        elif m.kind in ORTHOMETRIC_TYPES and not self.stations.takes_orthometric:
            m.source.wrong(m.line, f"type {m.kind} refers to the geoid, {NO_GEOID}")
        elif m.kind in GNSS_TYPES:
            self._gnss(m)
        elif m.kind == "D":
            self._directions(m)
        elif m.kind in STATION_TYPES:
            self._of_a_station(m)
        else:
            self._sight(m)

    def state_deflections(self) -> None:
        """State the deflections of the geoid at the stations of observations that take them."""
        used = dict.fromkeys(
            str(getattr(o, attribute))
            for o in self.network.observations.values()
            for kind, attribute in o.record.parameters
            if kind == "vertical"
        )
        for name in used:
            xi, eta = self.stations.deflections.get(name, (0.0, 0.0))
            if xi or eta:
                self.network.set_vertical(name, xi=xi, eta=eta, fixed=True)

    def _add(
        self,
        file: Source,
        row: int,
        make: Callable[[], AnyObservation],
    ) -> None:
        made = file.attempt(row, make)
        if made is not None:
            file.attempt(row, self.network.add, made)

    # -- GNSS -------------------------------------------------------------------------------------

    def _gnss(self, m: MeasurementRecord) -> None:
        before, kind, members = self.problems.count, m.kind, m.members
        if kind == "G" and len(members) != 1:
            m.source.wrong(m.line, f"type G has one vector, not {len(members)}: give type X")
            return
        if not m.total.is_absent and kind != "G" and m.total.integer() != len(members):
            m.total.wrong(f"is {str(m.total.value)[:20]!r}, but there are {len(members)} members")
        ends = [[f.name() for f in (r.first, r.second)[: 1 if kind == "Y" else 2]] for r in members]
        at = [self._at(m.source, r.line, e[0]) for r, e in zip(members, ends, strict=True)]
        if self.problems.count > before:
            return
        places = np.array(at, dtype=float)
        if self.driver:
            values = places if kind == "Y" else np.zeros((len(members), 3))
            own = _symmetric(SIMULATED_VECTOR_M2) * (10.0 if kind == "Y" else 1.0)
            covariance: Array = np.asarray(np.kron(np.eye(len(members)), own), dtype=np.float64)
        else:
            values, to_xyz = self._values(m, [e[0] for e in ends])
            covariance = to_xyz @ self._covariance(m) @ to_xyz.T
        if self.problems.count > before:
            return
        covariance = self._scaled(m, places, covariance)
        if not self.driver:
            values, covariance = self._brought(m, values, covariance)
        if self.problems.count > before:
            return
        found: list[Observation] = []
        for i, (r, names) in enumerate(zip(members, ends, strict=True)):
            rows = slice(3 * i, 3 * i + 3)
            made = m.source.attempt(
                r.line,
                GnssPosition if kind == "Y" else GnssVector,
                *names,
                tuple(values[i].tolist()),
                covariance=covariance[rows, rows],
                source=m.source.place(r.line),
            )
            if made is not None:
                found.append(made)
        if self.problems.count > before:
            return
        if len(found) > 1:
            self._add(m.source, m.line, partial(Correlated, tuple(found), covariance))
        elif found:
            m.source.attempt(m.line, self.network.add, *found)

    def _values(self, m: MeasurementRecord, names: Sequence[str]) -> tuple[Array, Array]:
        """Return values (n, 3) in X, Y, Z, and their partials by the values of the file."""
        kind = m.coordinates.name("XYZ") if m.kind == "Y" else "XYZ"
        size = 3 * len(m.members)
        if kind == "XYZ":
            return np.array([[f.number() for f in r.value] for r in m.members]), np.eye(size)
        if kind not in ("LLH", "LLh"):
            m.coordinates.wrong(f"{kind[:20]!r} is unknown; valid: XYZ, LLH, LLh")
            return np.zeros((len(m.members), 3)), np.eye(size)
        if kind == "LLH" and not self.stations.takes_orthometric:
            m.coordinates.wrong(f"LLH has orthometric heights, {NO_GEOID}")
        e, out, partials = self.stations.ellipsoid, [], np.zeros((size, size))
        for i, (r, name) in enumerate(zip(m.members, names, strict=True)):
            latitude, longitude, height = (float(v) for v in read_geodetic(r.value))
            if kind == "LLH":
                height += self.stations.undulations.get(name, 0.0)
            xyz = geocentric(e, latitude, longitude, height)
            out.append(xyz)
            if not np.isfinite(xyz).all():
                continue
            enu = self.network.frame.basis(xyz[None], np.zeros((1, 2))).enu[0]
            meridian, normal = (float(v) for v in e.radii(np.array(latitude)))
            across = (normal + height) * math.cos(latitude)
            own = slice(3 * i, 3 * i + 3)
            partials[own, own] = np.stack(
                [(meridian + height) * enu[1], across * enu[0], enu[2]], 1
            )
        return np.array(out), partials

    @staticmethod
    def _covariance(m: MeasurementRecord) -> Array:
        """Return the covariance over all members; cross blocks follow each member."""
        n = len(m.members)
        out = np.zeros((3 * n, 3 * n))
        for i, r in enumerate(m.members):
            own = slice(3 * i, 3 * i + 3)
            out[own, own] = _symmetric([f.number() for f in r.own])
            if len(r.crosses) not in (0, n - 1 - i):
                what = f"has {len(r.crosses)} covariances with the following {n - 1 - i}"
                m.source.wrong(r.line, f"member {i + 1} of {n} {what}")
                continue
            for j, cross in enumerate(r.crosses, start=i + 1):
                other = slice(3 * j, 3 * j + 3)
                block = np.array([f.number() for f in cross]).reshape(3, 3)
                out[own, other], out[other, own] = block, block.T
        return out

    def _scaled(self, m: MeasurementRecord, places: Array, covariance: Array) -> Array:
        """Return the covariance with its scales: V of all, P, L, H of north, east, up."""
        whole, north, east, up = (f.number(default=1.0, above=0.0) for f in m.scales)
        if is_unread(whole, north, east, up):
            return covariance
        if (north, east, up) == (1.0, 1.0, 1.0):
            return whole * covariance
        enu = self.network.frame.basis(places, np.zeros((len(places), 2))).enu
        by = np.zeros_like(covariance)
        for i, rows in enumerate(enu):
            own = slice(3 * i, 3 * i + 3)
            by[own, own] = rows.T @ np.diag(np.sqrt([east, north, up])) @ rows
        return whole * by @ covariance @ by.T

    def _brought(
        self, m: MeasurementRecord, values: Array, covariance: Array
    ) -> tuple[Array, Array]:
        """Return values and covariance in the reference frame of the stations."""
        name = m.frame.name("").upper()
        epoch = math.nan if m.epoch.is_absent else _year(m.epoch)
        if not self.frame or not name or name == self.frame:
            return values, covariance
        if name not in TERRESTRIAL_FRAMES:
            what = f"reference frame {name[:20]!r} is not known; known: {known(TERRESTRIAL_FRAMES)}"
            m.source.wrong(
                m.line, f"{what}; reference_frames='as is' takes the numbers as they are"
            )
            return values, covariance
        if m.epoch.is_absent:
            m.epoch.name()  # the problem that it is missing
        if math.isnan(epoch) or self.frame not in TERRESTRIAL_FRAMES:
            return values, covariance
        matrix, shift = frame_transformation(name, self.frame, epoch, by_gda94=self.by_gda94)
        every = np.kron(np.eye(len(values)), matrix)
        moved = values @ matrix.T + (shift if m.kind == "Y" else 0.0)
        return moved, every @ covariance @ every.T

    # -- terrestrial ------------------------------------------------------------------------------

    def _at(self, source: Source, line: int, name: str) -> Array | None:
        """Return the coordinates of a station, (3,); None after a problem."""
        point = self.network.points.get(name)
        if point is None:
            if name:
                what = known(self.network.points, meant=name)
                source.wrong(line, f"unknown station {name[:40]!r}; known: {what}")
            return None
        return np.array(point.coordinates)

    def _value(self, m: MeasurementRecord, value: Field, sigma: Field) -> tuple[float, float]:
        """Return value and standard deviation, SI; those of a record without any if it is one."""
        if self.driver:
            return 0.0, self._simulated_sigma(m)
        metric = m.kind in LENGTH_TYPES
        found = value.number() if metric else value.number(PACKED_DEGREES)
        return found, sigma.sigma() * (1.0 if metric else ARCSEC)

    def _simulated_sigma(self, m: MeasurementRecord) -> float:
        if m.kind in SIMULATED_ARCSEC:
            return SIMULATED_ARCSEC[m.kind] * ARCSEC
        if m.kind in STATION_TYPES:
            return SIMULATED_HEIGHT_M
        ends = [self._at(m.source, m.line, f.name()) for f in m.stations[:2]]
        if ends[0] is None or ends[1] is None:
            return math.nan
        return SIMULATED_PER_SQRT_KM_M * math.sqrt(float(np.linalg.norm(ends[1] - ends[0])) / 1000)

    def _sight(self, m: MeasurementRecord) -> None:
        before = self.problems.count
        names = [f.name() for f in m.stations[: 3 if m.kind == "A" else 2]]
        heights = {
            f"{end}_height": f.number(default=0.0)
            for end, f in zip(("instrument", "target"), m.heights, strict=True)
        }
        value, sigma = self._value(m, m.value, m.sigma)
        if self.problems.count > before:
            return
        more: dict[str, Any] = {"sigma": sigma, "source": m.source.place(m.line)}
        surfaces = {}
        if m.kind in ORTHOMETRIC_TYPES:
            ends = zip(("station_surface", "target_surface"), names, strict=True)
            surfaces = {end: self.stations.undulations.get(name, 0.0) for end, name in ends}
        make: Callable[..., AnyObservation]
        if m.kind == "A":
            make = HorizontalAngle
        elif m.kind == "L":
            make, more = EllipsoidHeightDifference, {**more, **heights, **surfaces}
        elif m.kind in DISTANCE_LINES:
            make, more = EllipsoidDistance, {**more, "line": DISTANCE_LINES[m.kind], **surfaces}
        else:
            make, more = SIGHT_KINDS[m.kind], {**more, **heights}
        self._add(m.source, m.line, partial(make, *names, value, **more))

    def _directions(self, m: MeasurementRecord) -> None:
        before = self.problems.count
        station = m.stations[0].name()
        self.sets[station] = self.sets.get(station, 0) + 1
        further = len(m.directions) - 1
        if not m.total.is_absent and m.total.integer() != further:
            text = str(m.total.value)[:20]
            m.total.wrong(f"is {text!r}, but there are {further} directions after the first")
        made: list[tuple[int, Direction]] = []
        for row in m.directions:
            if row.ignored:
                name = f"D {station} {row.target.name('')}"
                m.source.leave_out(row.line, ROWS_SWITCHED_OFF, name)
                continue
            target = row.target.name()
            value, sigma = self._value(m, row.value, row.sigma)
            if self.problems.count > before:
                continue
            one = m.source.attempt(
                row.line,
                Direction,
                station,
                target,
                value,
                sigma=sigma,
                set=str(self.sets[station]),
                source=m.source.place(row.line),
            )
            if one is not None:
                made.append((row.line, one))
        if self.problems.count == before:
            for line, one in made:
                m.source.attempt(line, self.network.add, one)

    def _of_a_station(self, m: MeasurementRecord) -> None:
        before, kind = self.problems.count, m.kind
        name = m.stations[0].name()
        at = self._at(m.source, m.line, name)
        value, sigma = self._value(m, m.value, m.sigma)
        if at is None or self.problems.count > before:
            return
        more: dict[str, Any] = {"sigma": sigma, "source": m.source.place(m.line)}
        if kind in "HR":
            surface = self.stations.undulations.get(name, 0.0) if kind == "H" else 0.0
            self._add(
                m.source, m.line, partial(EllipsoidHeight, name, value, surface=surface, **more)
            )
            return
        if kind in "IJ":
            astronomic = AstronomicLatitude if kind == "I" else AstronomicLongitude
            self._add(m.source, m.line, partial(astronomic, name, value, **more))
            return
        e = self.stations.ellipsoid
        geodetic = [float(v) for v in e.to_geodetic(at)]
        number = "PQ".index(kind)
        meridian, normal = (float(v) for v in e.radii(np.array(geodetic[0])))
        height = geodetic[2]
        radius = (meridian + height, (normal + height) * math.cos(geodetic[0]))[number]
        if not self.driver:
            geodetic[number] = value
        more["sigma"] = (sigma * radius,)
        xyz = tuple(geocentric(e, *geodetic).tolist())
        self._add(m.source, m.line, partial(ControlPoint, name, xyz, axes="ne"[number], **more))


def _symmetric(own: Sequence[float]) -> Array:
    """Return the covariance (3, 3) of xx, xy, xz, yy, yz, zz."""
    xx, xy, xz, yy, yz, zz = own
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def _year(field: Field) -> float:
    """Return the epoch dd.mm.yyyy of a measurement, years; NaN after a problem."""
    text = field.name()
    try:
        day, month, year = (int(p) for p in text.split("."))
        at = date(year, month, day)
        begin, end = date(year, 1, 1), date(year + 1, 1, 1)
    except ValueError:
        if text:
            field.wrong(f"must be dd.mm.yyyy, not {text[:20]!r}")
        return math.nan
    return year + (at - begin) / (end - begin)


def network_of(
    files: Sequence[RecordFile],
    name: str,
    problems: Problems,
    *,
    reference_frames: str,
    heights: Heights,
    geoid: str | float | None,
    driver: bool,
    ellipsoid: str,
    no_stations: str,
) -> Network:
    """Return the network of files, which have the stations and the measurements.

    Args:
        files: the files; the first one states the reference frame of the network.
        name: name of the network.
        problems: those of all files.
        reference_frames: see `read_dynaml`.
        heights: see `read_dynaml`.
        geoid: see `read_dynaml`.
        driver: whether records have stations alone.
        ellipsoid: name of the ellipsoid.
        no_stations: what is wrong if no file has a station.

    Raises:
        InputError: every problem of the files.
    """
    network = Network(name, frame=GeocentricFrame(ellipsoid))
    records = [r for f in files for r in f.stations]
    measurements = [m for f in files for m in f.measurements]
    if not records:
        files[0].source.wrong(0, no_stations)
        problems.finish(network)
    first = next(f for f in files if f.stations)
    frame = first.frame.upper() or DEFAULT_FRAME
    transform = reference_frames != "as is"
    if transform and frame not in TERRESTRIAL_FRAMES:
        other = f"reference frame {frame!r} is not known; known: {known(TERRESTRIAL_FRAMES)}"
        used = {str(m.frame.value or "").upper() for m in measurements if m.kind in GNSS_TYPES}
        if used - {frame, ""}:
            line = first.source.root.line if isinstance(first.source, XmlSource) else 1
            first.source.wrong(line, f"{other}; reference_frames='as is' takes numbers as is")
    surface = None if geoid is None else open_geoid(geoid)
    stations = DynadjustStations(network, problems, surface, heights)
    stations.read(records)
    reader = DynadjustMeasurements(
        stations, frame if transform else "", by_gda94=reference_frames == "by GDA94", driver=driver
    )
    for m in measurements:
        reader.read(m)
    reader.state_deflections()
    problems.finish(network)
    return network
