"""Local, geocentric, topocentric frames: conversions; east, north, up at stations, with partials.

Every station has an astronomic frame (e, n, u), the rows of a rotation that depends on
the position X of the station and on its deflections (ξ, η) from the normal of the frame:

    Φ = Φ₀(X) + ξ        Λ = Λ₀(X) + η / cos Φ₀(X)
    e = (−sinΛ, cosΛ, 0)
    n = (−sinΦ cosΛ, −sinΦ sinΛ, cosΦ)
    u = ( cosΦ cosΛ,  cosΦ sinΛ, sinΦ)

Geocentric and topocentric: Φ₀, Λ₀ are geodetic latitude and longitude. Local: the frame is placed
at Φ₀ = Λ₀ = 0, so that e, n, u are its axes, tilted by 1/R per metre if the curvature of the Earth
is switched on. This place avoids a singularity and the convergence of meridians.
A rotation of (e, n, u) with the station is part of the model, so that results do not
depend on approximate coordinates.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, Literal, TypeAlias

import numpy as np

from .constructors import ChecksArguments
from .ellipsoid import Ellipsoid, ellipsoid
from .errors import InputError
from .types import Array

MEAN_EARTH_RADIUS = 6_371_000.0
"""Mean radius of the Earth, metres."""
EARTH_SCALE_M = 2.0**23
"""Metres, a power of two near the radius of the Earth: differences of this size keep all digits."""

AXES: dict[str, Array] = {
    "e": np.array([1.0, 0.0]),
    "w": np.array([-1.0, 0.0]),
    "n": np.array([0.0, 1.0]),
    "s": np.array([0.0, -1.0]),
}
Axes: TypeAlias = Literal["en", "nw", "ws", "se", "ne", "wn", "sw", "es"]
LEFT_HANDED_AXES = ("ne", "wn", "sw", "es")


@dataclass(frozen=True, slots=True)
class Basis:
    """Astronomic frames of n stations and their partials."""

    enu: Array
    """Rows e, n, u of each station, (n, 3, 3)."""
    sin_latitude: Array
    """sin Φ, (n,)."""
    cos_latitude: Array
    """cos Φ, (n,)."""
    angles_by_position: Array
    """∂(Φ, Λ)/∂X, radians per metre, (n, 2, 3)."""
    angles_by_vertical: Array
    """∂(Φ, Λ)/∂(ξ, η), (n, 2, 2)."""
    angles: Array
    """Φ, Λ, radians, (n, 2)."""


def _enu(latitude: Array, longitude: Array) -> Array:
    """Return rows e, n, u (n, 3, 3) of astronomic latitude and longitude (n,)."""
    sp, cp, sl, cl = np.sin(latitude), np.cos(latitude), np.sin(longitude), np.cos(longitude)
    out = np.zeros((len(sp), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = -sl, cl
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = -sp * cl, -sp * sl, cp
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = cp * cl, cp * sl, sp
    return out


@dataclass(frozen=True)
class LocalFrame:
    """A local frame with Z up: flat, or with the curvature of the Earth."""

    curvature: bool = False
    """Whether the vertical tilts by 1/R per metre of distance from ``origin``."""
    radius: float = MEAN_EARTH_RADIUS
    """R in curvature and refraction, metres."""
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Point at which the vertical is exactly Z, metres."""
    axes: Axes = "en"
    """Directions of X and Y: letters e, n, w, s. Left-handed frames (``ne`` …) accept no photos."""

    def __post_init__(self) -> None:
        """Check the options."""
        if self.axes not in ("en", "nw", "ws", "se", *LEFT_HANDED_AXES):
            raise InputError(
                f"unknown axes {self.axes!r}; valid: en, nw, ws, se and, left-handed, "
                + ", ".join(LEFT_HANDED_AXES)
            )
        if not self.radius > 0:
            raise InputError(f"the radius of the Earth must be positive, not {self.radius}")

    @property
    def left_handed(self) -> bool:
        """Whether X, Y, Z form a left-handed system (for example X north, Y east)."""
        return self.axes in LEFT_HANDED_AXES

    @property
    def east_north(self) -> Array:
        """Unit vectors east and north in frame coordinates, (2, 3)."""
        a, b = AXES[self.axes[0]], AXES[self.axes[1]]
        return np.array([[a[0], b[0], 0.0], [a[1], b[1], 0.0]])

    def geodetic(self, position: Array) -> tuple[Array, Array, Array] | None:
        """Return None: a local frame has no ellipsoid."""
        return None

    def basis(self, position: Array, vertical: Array) -> Basis:
        """Return the astronomic frames at ``position`` (n, 3), deflections ``vertical`` (n, 2)."""
        n = len(position)
        east, north = self.east_north
        angles = vertical.copy()
        by_position = np.zeros((n, 2, 3))
        if self.curvature:
            offset = position - np.asarray(self.origin)
            angles[:, 0] += offset @ north / self.radius
            angles[:, 1] += offset @ east / self.radius
            by_position[:, 0] = north / self.radius
            by_position[:, 1] = east / self.radius
        enu = _enu(angles[:, 0], angles[:, 1])
        # Axes of the auxiliary globe: x up, y east, z north of the local frame.
        to_frame = np.array([[0.0, 0.0, 1.0], east, north])
        return Basis(
            enu @ to_frame,
            np.sin(angles[:, 0]),
            np.cos(angles[:, 0]),
            by_position,
            np.broadcast_to(np.eye(2), (n, 2, 2)),
            angles,
        )


@dataclass(frozen=True)
class GeocentricFrame:
    """Geocentric X, Y, Z, with a named ellipsoid for the normals."""

    ellipsoid_name: str = "GRS80"
    """Name of the ellipsoid, see `factorgraph_adj.ellipsoid.ELLIPSOIDS`."""
    radius: float = MEAN_EARTH_RADIUS
    """R in refraction, metres."""
    ellipsoid: Ellipsoid = field(init=False, repr=False, compare=False)
    """The ellipsoid."""

    def __post_init__(self) -> None:
        """Find the ellipsoid by its name."""
        object.__setattr__(self, "ellipsoid", ellipsoid(self.ellipsoid_name))

    @property
    def left_handed(self) -> bool:
        """Geocentric axes are right-handed."""
        return False

    def geodetic(self, position: Array) -> tuple[Array, Array, Array] | None:
        """Return φ, λ (n,) radians and ellipsoidal height (n,) metres of positions (n, 3)."""
        return self.ellipsoid.to_geodetic(position)

    def basis(self, position: Array, vertical: Array) -> Basis:
        """Return the astronomic frames at ``position`` (n, 3), deflections ``vertical`` (n, 2)."""
        latitude, longitude, height = self.ellipsoid.to_geodetic(position)
        m, n = self.ellipsoid.radii(latitude)
        cos0, sin0 = np.cos(latitude), np.sin(latitude)
        normal = _enu(latitude, longitude)
        eta = vertical[:, 1]
        latitude_by_x = normal[:, 1] / (m + height)[:, None]
        longitude_by_x = normal[:, 0] / ((n + height) * cos0)[:, None]
        by_position = np.stack(
            [latitude_by_x, longitude_by_x + (eta * sin0 / cos0**2)[:, None] * latitude_by_x], 1
        )
        by_vertical = np.zeros((len(position), 2, 2))
        by_vertical[:, 0, 0] = 1.0
        by_vertical[:, 1, 1] = 1.0 / cos0
        angles = np.stack([latitude + vertical[:, 0], longitude + eta / cos0], 1)
        return Basis(
            _enu(angles[:, 0], angles[:, 1]),
            np.sin(angles[:, 0]),
            np.cos(angles[:, 0]),
            by_position,
            by_vertical,
            angles,
        )


@dataclass(frozen=True)
class TopocentricFrame(metaclass=ChecksArguments):
    """East, north, up at an origin on an ellipsoid; verticals as rigorous as geocentric ones.

    The model is that of `GeocentricFrame` in turned and shifted coordinates:
    X_geocentric = X_origin + [e₀ n₀ u₀] (E, N, U)ᵀ.
    """

    latitude: float
    """Geodetic latitude of the origin, radians."""
    longitude: float
    """Geodetic longitude of the origin, radians."""
    height: float = 0.0
    """Ellipsoidal height of the origin, metres."""
    ellipsoid_name: str = "GRS80"
    """Name of the ellipsoid."""
    radius: float = MEAN_EARTH_RADIUS
    """R in refraction, metres."""

    @property
    def left_handed(self) -> bool:
        """East, north, up are right-handed."""
        return False

    @property
    def geocentric(self) -> GeocentricFrame:
        """The geocentric frame behind this one."""
        return GeocentricFrame(self.ellipsoid_name, self.radius)

    @cached_property
    def _origin(self) -> tuple[Array, Array]:
        """Return X_origin (3,) and the rows e₀, n₀, u₀ (3, 3)."""
        at = np.array([self.latitude]), np.array([self.longitude]), np.array([self.height])
        return self.geocentric.ellipsoid.to_cartesian(*at)[0], _enu(at[0], at[1])[0]

    @property
    def axes_in_geocentric(self) -> Array:
        """Rows e₀, n₀, u₀: unit vectors along east, north, up of the origin, (3, 3)."""
        return self._origin[1]

    def to_geocentric(self, enu: Array) -> Array:
        """Return geocentric coordinates (n, 3) of topocentric ones (n, 3), metres."""
        origin, rows = self._origin
        return origin + enu @ rows

    def from_geocentric(self, xyz: Array) -> Array:
        """Return topocentric coordinates (n, 3) of geocentric ones (n, 3), metres."""
        origin, rows = self._origin
        return (xyz - origin) @ rows.T

    def geodetic(self, position: Array) -> tuple[Array, Array, Array] | None:
        """Return φ, λ (n,) radians and ellipsoidal height (n,) metres of positions (n, 3)."""
        return self.geocentric.geodetic(self.to_geocentric(position))

    def basis(self, position: Array, vertical: Array) -> Basis:
        """Return the astronomic frames at ``position`` (n, 3), deflections ``vertical`` (n, 2)."""
        _, rows = self._origin
        there = self.geocentric.basis(self.to_geocentric(position), vertical)
        return replace(
            there,
            enu=there.enu @ rows.T,
            angles_by_position=there.angles_by_position @ rows.T,
        )


Frame: TypeAlias = LocalFrame | GeocentricFrame | TopocentricFrame
"""Any frame."""
FRAME_KINDS: dict[str, type[Frame]] = {
    "local": LocalFrame,
    "geocentric": GeocentricFrame,
    "topocentric": TopocentricFrame,
}
"""Frames by the words for them in files."""


def frame_record(frame: Frame) -> dict[str, Any]:
    """Return the kind of a frame and its parameters, metres and radians."""
    kind = next(word for word, of in FRAME_KINDS.items() if isinstance(frame, of))
    stated = {f.name: getattr(frame, f.name) for f in fields(frame) if f.init}
    of_frame = {n: list(v) if isinstance(v, tuple) else v for n, v in stated.items()}
    return {"frame": kind, "frame_parameters": of_frame}


def frame_of_record(record: Mapping[str, Any]) -> Frame:
    """Return the frame of a record of `frame_record`."""
    of_frame = record["frame_parameters"]
    stated: dict[str, Any] = {
        n: tuple(v) if isinstance(v, list) else v for n, v in of_frame.items()
    }
    return FRAME_KINDS[record["frame"]](**stated)


def direction_of(frame: Frame, place: Array, azimuth: float, altitude: float) -> Array:
    """Return the unit vector (3,), in a frame, towards a body of known azimuth and altitude.

    s = e sin α cos h + n cos α cos h + u sin h, with the horizon e, n, u at the place.

    >>> direction_of(LocalFrame(), np.zeros(3), np.pi / 2, np.pi / 6).round(3).tolist()
    [0.866, 0.0, 0.5]

    Args:
        frame: the frame.
        place: where the azimuth and the altitude hold, (3,) metres.
        azimuth: α, clockwise from north, radians.
        altitude: h above the horizon, radians, as the ray that is measured arrives: the altitude
            of an ephemeris plus refraction.
    """
    at = np.asarray(place, dtype=float)[None]
    enu = frame.basis(at, np.zeros((1, 2))).enu[0]
    level = np.cos(altitude)
    return np.asarray(
        np.array([np.sin(azimuth) * level, np.cos(azimuth) * level, np.sin(altitude)]) @ enu
    )
