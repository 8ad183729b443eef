"""Readings of SNAP as observations of a network; what of its definitions is not the project's.

Source of the definitions: LINZ, SNAP help, "Observation types", and ``netcalcs.c``, ``obsdata.c``,
``coefs.c`` of the program (BSD-3).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from ...frames import MEAN_EARTH_RADIUS
from ...network.grid.projected_lines import turn_of_line
from ...network.network import Network
from ...observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Correlated,
    Direction,
    FrameCoordinate,
    FrameVector,
    GnssPosition,
    GnssVector,
    GyroAzimuth,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ...observations.correlated_observations import AnyObservation
from ...observations.ellipsoidal_observations import (
    EllipsoidDistance,
    EllipsoidHeight,
    EllipsoidHeightDifference,
    GeodeticAzimuth,
    MeanHeightDistance,
)
from ...types import Array
from ...units import ARCSEC
from ..source import is_unread
from .snap_coordinates import SnapStation, SnapStations
from .snap_coordinates import horizon as horizon_of
from .snap_data_commands import POINT_KINDS, VECTOR_KINDS
from .snap_displacements import Displacements, at_epoch
from .snap_errors import scalar_sigma, vector_covariance
from .snap_frames import GnssFrame, add_reference_frame, add_translation, why_not
from .snap_lines import decimal_year
from .snap_parameters import (
    DEFAULT_CODE,
    GNSS_CODE,
    PPM,
    JobParameters,
    ParameterValue,
    ReferenceFrame,
    frame_matrix,
    frame_shift,
)
from .snap_readings import SnapReading, SnapSet
from .snap_systems import SystemCode, read_system

BOMFORD = 2.0
"""κ of Gauss over k of Bomford: the ray is bent by k S/R = κ S/2R."""


def azimuth_of(place: Array, other: Array, enu: Array) -> tuple[float, float]:
    """Return azimuth and zenith angle (rad) of a place (3,) from another one with a horizon."""
    east, north, up = enu @ (np.asarray(other) - np.asarray(place))
    return math.atan2(east, north), math.atan2(math.hypot(east, north), up)


def bent_arc(stations: SnapStations, station: str, target: str) -> tuple[float, float]:
    """Return the level length of a sight, metres, and the angle between the normals of its ends."""
    a, b = stations.find(station), stations.find(target)
    assert a is not None and b is not None  # the reader looked for them
    enu = stations.enu(station)
    level = float(np.hypot(*(enu[:2] @ (np.array(b.xyz) - np.array(a.xyz)))))
    return level, float(np.linalg.norm(np.cross(stations.up(target), enu[2])))


def refraction_radius(
    readings: Sequence[SnapReading], stations: SnapStations, parameters: JobParameters
) -> float:
    """Return one radius of the Earth for unknown coefficients of refraction, metres.

    SNAP bends a ray by k times the angle between the normals of its ends; the frame of a network
    has one radius for all. It is the mean of length over angle, weighted by the length squared.
    """
    total = weights = 0.0
    for r in readings:
        if r.kind == "ZD" and refraction_of(r, parameters)[1].calculated:
            level, angle = bent_arc(stations, r.station, r.target)
            total, weights = total + level * level, weights + level * angle
    return total / weights if weights > 0 else MEAN_EARTH_RADIUS


def refraction_of(r: SnapReading, parameters: JobParameters) -> tuple[str, ParameterValue]:
    """Return name and value of the coefficient of refraction of a reading."""
    sort = parameters.refraction
    name = sort.code(r.classes.get(sort.class_name, DEFAULT_CODE))
    return name, sort.of(name)


class SnapObservations:
    """Makes observations of readings."""

    def __init__(
        self, network: Network, stations: SnapStations, parameters: JobParameters, ratios: bool
    ) -> None:
        """Take a network that has the points and its verticals."""
        self.network = network
        self.stations = stations
        self.parameters = parameters
        self.ratios = ratios
        self.sets: dict[str, int] = {}
        self.ratio_sets = 0
        self.projections: dict[str, SystemCode | None] = {}
        self.use_datum = True
        self.displacements = Displacements()
        self.middle: tuple[Array, Array] | None = None
        self.frames: dict[str, GnssFrame] = {}
        self.positioned: set[str] = set()
        self.translations = 0
        self.made: dict[str, Callable[..., Observation | None]] = {
            "SD": self._slope,
            "DR": self._slope,
            "HD": self._mean_height,
            "ED": self._on_surface,
            "MD": self._on_surface,
            "AZ": self._bearing,
            "PB": self._bearing,
            "ZD": self._zenith,
            "LV": self._levelled,
            "LT": self._latitude,
            "LN": self._longitude,
            "OH": self._height,
            "EH": self._height,
        }

    def take_frames(self, readings: Sequence[SnapReading]) -> None:
        """Find the reference frames of positions: a translation has no part in vectors."""
        self.positioned = {self._frame_code(r) for r in readings if r.kind == "GX"}

    def add(self, found: SnapSet, kept: Sequence[int]) -> None:
        """Add the readings of a set that take part, by their places in it."""
        if not kept:
            return
        if found.kind in VECTOR_KINDS:
            self._add_vectors(found, list(kept))
            return
        more: dict[str, str] = {}
        if found.kind == "HA":
            station = found.readings[0].station.upper()
            self.sets[station] = self.sets.get(station, 0) + 1
            more["set"] = str(self.sets[station])
        elif found.kind == "DR" and self.ratios and all(found.readings[i].ratio for i in kept):
            self.ratio_sets += 1
            more["instrument"] = f"ratios {self.ratio_sets}"
            self.network.set_distance_meter(more["instrument"], free=["scale"])
        for i in kept:
            reading = found.readings[i]
            sigma = scalar_sigma(reading, found, self.stations)
            if is_unread(sigma):
                continue
            options = {"sigma": sigma, "source": found.source.place(reading.line), **more}
            make = self._direction if found.kind == "HA" else self.made[found.kind]
            made = found.source.attempt(reading.line, make, reading, found, **options)
            if made is not None:
                made = found.source.attempt(reading.line, self._at_epoch, reading, found, made)
            if made is not None:
                found.source.attempt(reading.line, self.network.add, made)

    # -- parts ------------------------------------------------------------------------------------

    def _displaced(self, r: SnapReading, found: SnapSet, code: str) -> Array:
        """Return the displacement of a station at the date of a reading, (3,) metres."""
        if not self.displacements.concerns(code):
            return np.zeros(3)
        if r.date is None:
            found.source.wrong(
                r.line, f"station {code!r} moves, and the reading has no date; valid: #date before"
            )
            return np.zeros(3)
        return self.displacements.of(code, r.date, self.stations)

    def _at_epoch(self, r: SnapReading, found: SnapSet, made: Observation) -> Observation:
        """Return an observation as if its stations had their coordinates at its date."""
        moved = {code.upper(): self._displaced(r, found, code) for code in made.points()}
        if not any(d.any() for d in moved.values()):
            return made

        def place(name: str) -> Array:
            station = self._station(name)
            return np.array([*station.xyz, *moved[name.upper()], station.xi, station.eta])

        return at_epoch(made, self.network.frame, place)

    def _station(self, code: str) -> SnapStation:
        station = self.stations.find(code)
        assert station is not None  # the reader looked for it
        return station

    def _ends(self, reading: SnapReading) -> tuple[SnapStation, SnapStation]:
        return self._station(reading.station), self._station(reading.target)

    @staticmethod
    def _heights(reading: SnapReading) -> dict[str, Any]:
        return {
            "instrument_height": reading.instrument_height,
            "target_height": reading.target_height,
        }

    def _meter(self, reading: SnapReading) -> dict[str, Any]:
        """Return the distance meter of a reading, if it has a scale."""
        scales = self.parameters.distance_scale
        code = reading.classes.get(scales.class_name)
        if code is None:
            return {}
        name = scales.code(code)
        value = scales.of(name)
        if not value.calculated and value.value == 0.0:
            return {}
        if name not in self.network.of_kind("edm"):
            free = ["scale"] if value.calculated else []
            self.network.set_distance_meter(name, scale=PPM * value.value, free=free)  # type: ignore[arg-type]
        return {"instrument": name}

    # -- kinds ------------------------------------------------------------------------------------

    def _direction(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        a, b = self._ends(r)
        return Direction(a.code, b.code, r.values[0], **self._heights(r), **more)

    def _slope(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        a, b = self._ends(r)
        meter = {} if "instrument" in more else self._meter(r)
        return SlopeDistance(a.code, b.code, r.values[0], **self._heights(r), **meter, **more)

    def _mean_height(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        a, b = self._ends(r)
        given = {**self._heights(r), **self._meter(r), **more}
        return MeanHeightDistance(a.code, b.code, r.values[0], **given)

    def _on_surface(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        a, b = self._ends(r)
        # Sea level is for SNAP the mean of both undulations.
        level = 0.5 * (a.undulation + b.undulation) if r.kind == "MD" else 0.0
        surfaces: dict[str, Any] = {"station_surface": level, "target_surface": level}
        return EllipsoidDistance(a.code, b.code, r.values[0], **surfaces, **self._meter(r), **more)

    def _bearing(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation | None:
        """Return an azimuth of the ellipsoid: of a bearing with the convergence at its stations."""
        a, b = self._ends(r)
        geodetic, zenith = azimuth_of(np.array(a.xyz), np.array(b.xyz), self.stations.enu(a.code))
        value = r.values[0]
        if r.kind == "PB":
            system = self._projection(r, found)
            if system is None:
                return None
            latitude, longitude, _ = self.stations.geodetic([a.code, b.code])
            grid = system.system.grid(latitude, longitude)
            value += turn_of_line(self.network.frame, np.array([a.xyz, b.xyz]), grid)
        errors = self.parameters.bearing_error
        stated = r.classes.get(errors.class_name)
        name = "" if stated is None else errors.code(stated)
        error = errors.of(name) if name else None
        if error is None or not error.calculated:
            value -= 0.0 if error is None else ARCSEC * error.value
            return GeodeticAzimuth(a.code, b.code, _turned(value), **self._heights(r), **more)
        if name not in self.network.of_kind("gyro"):
            self.network.set_gyro(name)
        # The azimuth of a gyrotheodolite is astronomic: Laplace's correction leads there.
        tilted = math.cos(zenith) / math.sin(zenith)
        value += a.eta * math.tan(a.latitude)
        value += (a.xi * math.sin(geodetic) - a.eta * math.cos(geodetic)) * tilted
        return GyroAzimuth(a.code, b.code, _turned(value), gyro=name, **self._heights(r), **more)

    def _projection(self, r: SnapReading, found: SnapSet) -> SystemCode | None:
        """Return the projection of a bearing; None after a problem."""
        code = r.projection
        if code.upper() in self.projections:
            return self.projections[code.upper()]
        if not code:
            found.source.wrong(r.line, "PB needs a projection; valid: #projection before")
            return None
        stated = read_system(found.source.field(r.line, code, "projection"))
        if stated is not None and stated.system.form != "projection":
            found.source.wrong(r.line, f"{code} is no projection; valid: such as NZTM, WELLTM2000")
            stated = None
        datum = self.stations.system.datum
        if stated is not None and self.use_datum and stated.system.datum != datum:
            found.source.wrong(
                r.line,
                f"the projection {code} is of {stated.system.datum}, and the stations are of "
                f"{datum}; valid: one of {datum}, or the command proj_bearing_use_datum no",
            )
            stated = None
        self.projections[code.upper()] = stated
        return stated

    def _zenith(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        a, b = self._ends(r)
        name, k = refraction_of(r, self.parameters)
        if name not in self.network.of_kind("refraction"):
            kappa = BOMFORD * k.value
            self.network.set_refraction(name, value=kappa, fixed=not k.calculated)
        value = r.values[0]
        if not k.calculated:
            # The frame has one radius: what the angle between the normals differs from it.
            level, angle = bent_arc(self.stations, a.code, b.code)
            value += k.value * (angle - level / self.network.frame.radius)
        given = {**self._heights(r), "refraction": name, **more}
        return ZenithAngle(a.code, b.code, value, **given)

    def _levelled(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        a, b = self._ends(r)
        surfaces: dict[str, Any] = {"station_surface": a.undulation, "target_surface": b.undulation}
        return EllipsoidHeightDifference(
            a.code, b.code, r.values[0], **self._heights(r), **surfaces, **more
        )

    def _latitude(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        """Return an astronomic latitude: that of SNAP is geodetic, less by ξ."""
        a = self._station(r.station)
        return AstronomicLatitude(a.code, r.values[0] + a.xi, **more)

    def _longitude(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        """Return an astronomic longitude: that of SNAP is geodetic, less by η/cos φ."""
        a = self._station(r.station)
        return AstronomicLongitude(a.code, r.values[0] + a.eta / math.cos(a.latitude), **more)

    def _height(self, r: SnapReading, found: SnapSet, **more: Any) -> Observation:
        a = self._station(r.station)
        surface = a.undulation if r.kind == "OH" else 0.0
        return EllipsoidHeight(a.code, r.values[0] - r.instrument_height, surface=surface, **more)

    # -- GNSS -------------------------------------------------------------------------------------

    def _add_vectors(self, found: SnapSet, kept: list[int]) -> None:
        covariance = vector_covariance(found, kept, self.stations)
        if covariance is None:
            return
        readings = [found.readings[i] for i in kept]
        line = readings[0].line
        own = None
        if found.kind == "GX" and any(r.translated for r in readings):
            self.translations += 1
            name = f"translation {self.translations}"
            own = add_translation(self.network, name, self._middle()[0])
        turn = np.zeros_like(covariance)
        made: list[tuple[SnapReading, Array, GnssFrame | None]] = []
        for i, r in enumerate(readings):
            frame, value, matrix = self._in_network(r, found)
            if own is not None and frame is not None:
                found.source.wrong(r.line, "a translation of a set in an unknown frame is not read")
                return
            turn[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = matrix
            made.append((r, value, own or frame))
        covariance = turn @ covariance @ turn.T
        members: list[Observation] = []
        for i, (r, value, frame) in enumerate(made):
            error = covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            more = {"covariance": error, "source": found.source.place(r.line)}
            one = found.source.attempt(r.line, self._vector, r, found, value, frame, **more)
            if one is None:
                return
            members.append(one)
        joint: AnyObservation | None = members[0]
        if len(members) > 1:
            joint = found.source.attempt(line, Correlated, tuple(members), covariance)
        if joint is not None:
            found.source.attempt(line, self.network.add, joint)

    def _vector(
        self, r: SnapReading, found: SnapSet, value: Array, frame: GnssFrame | None, **more: Any
    ) -> Observation:
        if r.kind == "GB":
            a, b = self._ends(r)
            moved = self._displaced(r, found, b.code) - self._displaced(r, found, a.code)
            value = value - (moved if frame is None else frame.matrix @ moved)
            if frame is None:
                return GnssVector(a.code, b.code, tuple(value.tolist()), **self._heights(r), **more)
            raised = r.target_height * self.stations.up(b.code)
            raised = raised - r.instrument_height * self.stations.up(a.code)
            at = value - frame.matrix @ raised
            return FrameVector(frame.name, a.code, b.code, tuple(at.tolist()), **more)
        a = self._station(r.station)
        raised = r.instrument_height * self.stations.up(a.code) + self._displaced(r, found, a.code)
        if frame is None:
            return GnssPosition(a.code, tuple((value - raised).tolist()), **more)
        at = value - frame.matrix @ raised - frame.subtracted
        return FrameCoordinate(frame.name, a.code, tuple(at.tolist()), **more)

    def _in_network(self, r: SnapReading, found: SnapSet) -> tuple[GnssFrame | None, Array, Array]:
        """Return the frame of a vector or position, its value, and the matrix that led there.

        observed = T (X + t) of a position, T ΔX of a vector. With known parameters the value is
        brought into the frame of the network, which is no frame of its own (None).
        """
        value = np.array(r.values)
        frame = self.parameters.frames.get(self._frame_code(r))
        if frame is None:
            return None, value, np.eye(3)
        horizon = self._middle()[1] if frame.topocentric else None
        if any(frame.calculated):
            return self._unknown_frame(r, found, frame, horizon), value, np.eye(3)
        parameters = frame.at(self._years(r, found, frame))
        if is_unread(*parameters.tolist()):
            return None, value, np.eye(3)
        inverse = np.linalg.inv(frame_matrix(parameters, horizon))
        moved = inverse @ value
        if r.kind in POINT_KINDS:
            moved = moved - frame_shift(parameters, horizon)
        return None, np.asarray(moved), np.asarray(inverse)

    def _frame_code(self, r: SnapReading) -> str:
        """Return the code of the reference frame of a reading, in capital letters."""
        return r.classes.get(self.parameters.frame_class, GNSS_CODE).upper()

    def _unknown_frame(
        self, r: SnapReading, found: SnapSet, frame: ReferenceFrame, horizon: Array | None
    ) -> GnssFrame | None:
        """Return the frame of a reference frame with unknown parameters; None after a problem."""
        reason = why_not(frame)
        if reason:
            found.source.wrong(
                r.line, f"the reference frame {frame.code} ({frame.place}) has {reason}: not read"
            )
            return None
        if frame.code not in self.frames:
            middle = self._middle()[0] if self._frame_code(r) in self.positioned else None
            self.frames[frame.code] = add_reference_frame(self.network, frame, horizon, middle)
        return self.frames[frame.code]

    def _years(self, r: SnapReading, found: SnapSet, frame: ReferenceFrame) -> float:
        """Return the years since the epoch of a frame; NaN after a problem."""
        if not frame.has_rates:
            return 0.0
        if frame.epoch is None or r.date is None:
            what = "epoch" if frame.epoch is None else "date of its observations"
            found.source.wrong(
                r.line,
                f"the reference frame {frame.code} changes with time, and the {what} is unknown",
            )
            return math.nan
        return decimal_year(r.date) - frame.epoch

    def _middle(self) -> tuple[Array, Array]:
        """Return the middle of the stations (3,), and its east, north, up as rows (3, 3)."""
        if self.middle is None:
            latitude, longitude, _ = self.stations.geodetic(list(self.stations.by_code))
            phi, lam = (0.5 * float(v.min() + v.max()) for v in (latitude, longitude))
            ell = self.stations.system.ellipsoid
            at = ell.to_cartesian(*(np.array([v]) for v in (phi, lam, 0.0)))[0]
            self.middle = np.asarray(at), horizon_of(phi, lam)
        return self.middle


def _turned(angle: float) -> float:
    """Return an angle from −π to π."""
    return math.remainder(angle, 2.0 * math.pi)
