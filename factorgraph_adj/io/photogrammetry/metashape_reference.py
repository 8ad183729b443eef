"""Reference systems of a Metashape chunk: from its coordinates to those of a network."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ...crs.system import Heights, ReferenceSystem
from ...ellipsoid import ELLIPSOIDS
from ...errors import InputError, Problem
from ...frames import Frame, LocalFrame, TopocentricFrame
from ...types import Array
from .reading import unit_length

STEP = 10.0
"""Distance over which directions of a grid are taken, metres."""
SAME_ELLIPSOID = 1e-6
"""Largest difference of 1/f of ellipsoids that are the same, printed with few digits."""


class Reference(Protocol):
    """Coordinates of a chunk as those of a network."""

    @property
    def frame(self) -> Frame:
        """Frame of the network."""

    @property
    def unit(self) -> float:
        """Length of the unit of lengths, metres."""

    def points(self, given: Array) -> Array:
        """Return coordinates (n, 3) in the frame of given ones (n, 3)."""

    def from_chunk(self, world: Array) -> Array:
        """Return coordinates (n, 3) in the frame of what the chunk's transformation gives."""

    def axes(self, given: Array) -> Array:
        """Return the axes of the given standard deviations at a place, rows in the frame (3, 3)."""

    @property
    def turn(self) -> Array:
        """Rotation (3, 3) from what the chunk's transformation gives to the frame."""


@dataclass(frozen=True)
class Local:
    """A local system in metres or another unit; the transformation leads to the same system."""

    unit: float = 1.0
    """Length of the unit, metres."""
    frame: Frame = field(default_factory=LocalFrame)
    """The frame."""

    def points(self, given: Array) -> Array:
        """Return given coordinates in metres."""
        return self.unit * given

    def from_chunk(self, world: Array) -> Array:
        """Return coordinates of the chunk's world in metres."""
        return self.unit * world

    def axes(self, given: Array) -> Array:
        """Return the axes of the system."""
        return np.eye(3)

    @property
    def turn(self) -> Array:
        """The axes are the same."""
        return np.eye(3)


@dataclass(frozen=True)
class Geographic:
    """Longitude, latitude (degrees), ellipsoidal height (m) or geocentric coordinates.

    The transformation of the chunk leads to geocentric coordinates. The network has a topocentric
    frame whose origin is the middle of what is given.
    """

    frame: TopocentricFrame
    """The frame."""
    geocentric: bool = False
    """Whether given coordinates are geocentric."""
    unit: float = 1.0
    """Length of the unit of heights and geocentric coordinates, metres."""

    def _geocentric(self, given: Array) -> Array:
        if self.geocentric:
            return given
        ellipsoid = self.frame.geocentric.ellipsoid
        longitude, latitude = np.deg2rad(given[:, 0]), np.deg2rad(given[:, 1])
        return ellipsoid.to_cartesian(latitude, longitude, given[:, 2])

    def points(self, given: Array) -> Array:
        """Return topocentric coordinates."""
        return self.frame.from_geocentric(self._geocentric(given))

    def from_chunk(self, world: Array) -> Array:
        """Return topocentric coordinates of geocentric ones."""
        return self.frame.from_geocentric(world)

    def axes(self, given: Array) -> Array:
        """Return east, north, up at a place, or the geocentric axes."""
        if self.geocentric:
            return self.turn.T
        at = self.points(given[None])
        return np.asarray(self.frame.basis(at, np.zeros((1, 2))).enu[0])

    @property
    def turn(self) -> Array:
        """Rotation from geocentric axes to east, north, up of the origin."""
        return _turn(self.frame)


@dataclass(frozen=True)
class Grid:
    """Easting, northing and height of a projected system.

    The transformation of the chunk leads to geocentric coordinates of the datum of the system.
    The network has a topocentric frame in the middle of what is given.
    """

    system: ReferenceSystem
    """The system."""
    frame: TopocentricFrame
    """The frame."""
    unit: float = 1.0
    """Length of the unit of coordinates, metres."""

    def points(self, given: Array) -> Array:
        """Return topocentric coordinates."""
        return self.system.to_frame(self.frame, given)

    def from_chunk(self, world: Array) -> Array:
        """Return topocentric coordinates of geocentric ones."""
        return self.frame.from_geocentric(world)

    def axes(self, given: Array) -> Array:
        """Return the directions of grid east, grid north and up at a place."""
        steps = np.vstack([np.zeros((1, 3)), STEP * np.eye(3)])
        at = self.points(given + steps)
        along = at[1:] - at[0]
        along[0] -= along[0] @ along[2] * along[2] / (along[2] @ along[2])
        u, _, vt = np.linalg.svd(along / np.linalg.norm(along, axis=1, keepdims=True))
        return np.asarray(u @ vt)

    @property
    def turn(self) -> Array:
        """Rotation from geocentric axes to east, north, up of the origin."""
        return _turn(self.frame)


def _turn(frame: TopocentricFrame) -> Array:
    zero = frame.from_geocentric(np.zeros((1, 3)))
    return np.asarray((frame.from_geocentric(np.eye(3)) - zero).T)


def reference_of(
    wkt: str,
    given: Array,
    where: str,
    *,
    geoid: str | float | None = None,
    heights: Heights | None = None,
) -> Reference:
    """Return the reference system that a chunk states in WKT.

    Args:
        wkt: the text; empty: a local system in metres.
        given: coordinates in the system, (n, 3), whose middle becomes the origin of a frame.
        where: file and line.
        geoid: geoid of a system with heights, see `ReferenceSystem`.
        heights: "ellipsoidal" where the heights of a system with heights are that.

    Raises:
        InputError: the system is none of those that can be read.
    """
    text = wkt.strip()
    kind = text.split("[", 1)[0].strip().upper()
    if kind in ("", "LOCAL_CS", "ENGCRS"):
        return Local(unit_length(text))
    if kind in ("GEOGCS", "GEOGCRS", "GEOCCS", "GEODCRS"):
        name = _ellipsoid(text)
        if name is None:
            known = ", ".join(ELLIPSOIDS)
            raise InputError(Problem(f"its ellipsoid is unknown; known: {known}", where))
        first = TopocentricFrame(0.0, 0.0, 0.0, name)
        middle = given.mean(axis=0) if len(given) else np.zeros(3)
        if kind == "GEOCCS":
            lat, lon, h = first.geocentric.ellipsoid.to_geodetic(middle[None])
            origin = float(lat[0]), float(lon[0]), float(h[0])
        else:
            longitude = _mean_longitude(given[:, 0])
            origin = float(np.deg2rad(middle[1])), math.radians(longitude), float(middle[2])
        if not abs(origin[0]) <= np.pi / 2:
            raise InputError(Problem(f"latitude {middle[1]:g}° is none", where))
        return Geographic(TopocentricFrame(*origin, name), kind == "GEOCCS")
    try:
        if heights is None and geoid is None and kind in ("PROJCS", "PROJCRS"):
            heights = "ellipsoidal"
        system = ReferenceSystem(text, geoid, heights).checked()
        if not system.projected:
            what = (
                f"its system {system.name!r} ({kind}) cannot be converted; valid: a projected one"
            )
            raise InputError(what)
        return Grid(system, system.frame_at(given))
    except InputError as error:
        hint = "crs='local' takes the coordinates as they are"
        raise InputError([Problem(f"{p.what}; {hint}", where) for p in error.problems]) from None


def _mean_longitude(longitude: Array) -> float:
    """Return the mean of longitudes, degrees, also of those on both sides of the antimeridian."""
    if not len(longitude):
        return 0.0
    from_first = np.remainder(longitude - longitude[0] + 180.0, 360.0) - 180.0
    mean = float(longitude[0] + from_first.mean())
    return (mean + 180.0) % 360.0 - 180.0


def _ellipsoid(text: str) -> str | None:
    """Return the name of an ellipsoid by its numbers in WKT."""
    upper = text.upper()
    at = max(upper.find("SPHEROID["), upper.find("ELLIPSOID["))
    fields = text[at:].split("]", 1)[0].split(",")
    try:
        a, inverse = float(fields[1]), float(fields[2])
    except (IndexError, ValueError):
        return None
    for name, e in ELLIPSOIDS.items():
        if abs(e.a - a) < 1e-3 and abs(e.inverse_flattening - inverse) < SAME_ELLIPSOID:
            return name
    return None
