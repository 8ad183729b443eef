"""What is measured: one frozen dataclass for each kind of observation.

Inside, lengths are metres, angles radians, image coordinates the units of the camera.
``sigma`` is a standard deviation in the same unit, or a `StandardDeviation` of several parts.
``id`` names the observation in every report; where none is given the network numbers it.
``source`` says where it came from (file and line) and appears in error messages.
"""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any, ClassVar, TypeAlias

import numpy as np

from .errors import InputError, Problem
from .stochastic import StandardDeviation, whitening
from .types import Array

Sigma: TypeAlias = "float | StandardDeviation"


def _finite(value: Any) -> bool:
    """Return whether all are finite numbers; quick for the scalars of most observations."""
    if isinstance(value, float | int):
        return math.isfinite(value)
    try:
        array = np.asarray(value)
    except ValueError:  # rows of different lengths
        return False
    return array.dtype.kind in "iuf" and bool(np.all(np.isfinite(array)))


def _positive(value: Any) -> bool:
    """Return whether no number is ≤ 0."""
    if isinstance(value, float | int):
        return not value <= 0
    return not np.any(np.asarray(value, dtype=float) <= 0)


def _name(observation: Observation) -> str:
    parts = [observation.kind, *(str(n) for n in observation.names())]
    return " ".join(parts)


@dataclass(frozen=True)
class Observation:
    """Base of every kind of observation."""

    kind: ClassVar[str] = ""
    """Name of the kind, as in the ``kind`` column of tables."""
    components: ClassVar[tuple[str, ...]] = ("",)
    """Names of the scalar components."""

    def names(self) -> tuple[str, ...]:
        """Return the names of points and photos that the observation joins."""
        return tuple(
            getattr(self, f.name)
            for f in fields(self)
            if f.name in ("station", "target", "target2", "point", "photo")
        )

    def label(self) -> str:
        """Return a readable name for messages: where, id, kind and points."""
        ident, source = getattr(self, "id", None), getattr(self, "source", None)
        text = _name(self) if ident is None else f"{_name(self)} (id {ident})"
        return f"{source}: {text}" if source else text

    def _fail(self, what: str) -> None:
        raise InputError(Problem(what, self.label()))

    def _check(self) -> None:
        """Check values, standard deviations and names."""
        for f in fields(self):
            value = getattr(self, f.name)
            if f.type in ("str", "str | None"):  # types are text here: annotations are postponed
                if not isinstance(value, str) and (value is not None or f.type == "str"):
                    self._fail(f"{f.name} must be text, not {value!r}")
                continue
            if isinstance(value, StandardDeviation) or (value is None and "None" in str(f.type)):
                continue
            if not _finite(value):
                shown = repr(value) if isinstance(value, str) else value
                self._fail(f"{f.name} must be a finite number, not {shown}")
            if f.name == "sigma" and not _positive(value):
                self._fail(f"sigma must be greater than zero, not {value}")
        if self.kind.endswith("_distance") and getattr(self, "value", 0.0) < 0:
            self._fail(f"a distance cannot be negative: {getattr(self, 'value', None)}")
        names = self.names()
        if "" in names:
            self._fail("names must be non-empty text, not ''")
        if len(set(names)) < len(names) and "photo" not in {f.name for f in fields(self)}:
            self._fail("an observation cannot join a point to itself")

    def __post_init__(self) -> None:
        """Check the observation; InputError names it."""
        self._check()


@dataclass(frozen=True)
class Sight(Observation):
    """Base of what is observed from a station to a target."""

    station: str
    """Point of the instrument, i."""
    target: str
    """Point of the target, j."""
    value: float
    """Observed value, metres or radians."""
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation."""
    instrument_height: float = 0.0
    """Height of the instrument above its point along the vertical, metres."""
    target_height: float = 0.0
    """Height of the target above its point along the vertical, metres."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """Where it was read from."""


@dataclass(frozen=True)
class SlopeDistance(Sight):
    """Slope distance, metres: (1 + m) S + zero of the instrument. Eq. 4."""

    kind: ClassVar[str] = "slope_distance"
    _: KW_ONLY
    instrument: str | None = None
    """Distance meter with its scale and zero constant; none: 1 and 0."""


@dataclass(frozen=True)
class HorizontalDistance(SlopeDistance):
    """Distance in the horizon of the station, metres: (1 + m) hypot(e·d, n·d) + zero."""

    kind: ClassVar[str] = "horizontal_distance"


@dataclass(frozen=True)
class VerticalAngle(Sight):
    """Vertical angle, radians: β + κ S cosβ / 2R. Eq. 5."""

    kind: ClassVar[str] = "vertical_angle"
    _: KW_ONLY
    refraction: str | None = None
    """Refraction group; none: the coefficient of the whole network."""


@dataclass(frozen=True)
class ZenithAngle(VerticalAngle):
    """Zenith angle, radians: π/2 − (β + κ S cosβ / 2R)."""

    kind: ClassVar[str] = "zenith_angle"


@dataclass(frozen=True)
class Direction(Sight):
    """Horizontal direction, clockwise, radians: α − orientation of its set. Eq. 8."""

    kind: ClassVar[str] = "direction"
    _: KW_ONLY
    set: str = "1"
    """Set of directions of the station: one orientation unknown each."""


@dataclass(frozen=True)
class Azimuth(Sight):
    """Azimuth from north, clockwise, radians. Eq. 9."""

    kind: ClassVar[str] = "azimuth"


@dataclass(frozen=True)
class HorizontalAngle(Observation):
    """Horizontal angle at ``station`` from ``target`` clockwise to ``target2``, radians."""

    kind: ClassVar[str] = "horizontal_angle"
    station: str
    """Vertex, i."""
    target: str
    """Backsight, j."""
    target2: str
    """Foresight, k."""
    value: float
    """α_ik − α_ij, radians."""
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation, radians."""
    instrument_height: float = 0.0
    """Height of the instrument, metres."""
    target_height: float = 0.0
    """Height of the backsight target, metres."""
    target2_height: float = 0.0
    """Height of the foresight target, metres."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """Where it was read from."""


@dataclass(frozen=True)
class HeightDifference(Sight):
    """Levelled height difference from station to target, metres: ½(u_i + u_j)·d. Eq. 10."""

    kind: ClassVar[str] = "height_difference"
    _: KW_ONLY
    length_km: float | None = None
    """Length of the levelled line, km, for `StandardDeviation.per_sqrt_km`; none: the
    horizontal distance."""


@dataclass(frozen=True)
class AstronomicLatitude(Observation):
    """Astronomic latitude Φ of a station, radians. Eq. 12."""

    kind: ClassVar[str] = "astronomic_latitude"
    station: str
    """The station."""
    value: float
    """Observed Φ or Λ, radians."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, radians."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """Where it was read from."""


@dataclass(frozen=True)
class AstronomicLongitude(AstronomicLatitude):
    """Astronomic longitude Λ of a station, east positive, radians. Eq. 11."""

    kind: ClassVar[str] = "astronomic_longitude"


def _covariance(observation: Observation, size: int) -> Array | None:
    """Check ``covariance`` and ``sigma`` of a vector observation; return the covariance."""
    sigma = getattr(observation, "sigma", None)
    covariance = getattr(observation, "covariance", None)
    if (sigma is None) == (covariance is None):
        observation._fail("give either sigma or covariance")
    if covariance is None:
        if np.shape(np.asarray(sigma)) != (size,):
            observation._fail(f"sigma must be {size} standard deviations, not {sigma!r}")
        return None
    matrix = np.asarray(covariance, dtype=float)
    if matrix.shape != (size, size):
        observation._fail(f"covariance must be {size} × {size}, not {matrix.shape}")
    try:
        whitening(matrix)
    except InputError as error:
        observation._fail(str(error))
    return matrix


@dataclass(frozen=True)
class GnssVector(Observation):
    """GNSS vector X_j − X_i, metres, with a full covariance."""

    kind: ClassVar[str] = "gnss_vector"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    station: str
    """From, i."""
    target: str
    """To, j."""
    value: tuple[float, float, float]
    """X_j − X_i between the antennas, metres."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, metres, or"""
    covariance: Array | None = None
    """covariance (3, 3), metres²."""
    instrument_height: float = 0.0
    """Height of the antenna at i, metres."""
    target_height: float = 0.0
    """Height of the antenna at j, metres."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """Where it was read from."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if np.shape(self.value) != (3,):
            self._fail(f"value must have 3 components, not {self.value}")
        _covariance(self, 3)


@dataclass(frozen=True)
class ControlPoint(Observation):
    """Known coordinates of a point with their precision: 3-D, plan or height.

    In a geocentric frame x, y, z are the axes, and e, n, u the horizon of the given position.
    """

    kind: ClassVar[str] = "control"
    point: str
    """The point."""
    value: tuple[float, ...]
    """Coordinates; for e, n, u all three of X, Y, Z; otherwise those of ``axes``, metres."""
    _: KW_ONLY
    axes: str = "xyz"
    """Which components are known: any of x, y, z, or any of e, n, u."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the components, metres, or"""
    covariance: Array | None = None
    """their covariance, metres²."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """Where it was read from."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        local = set(self.axes) <= set("enu")
        if (
            not self.axes
            or len(set(self.axes)) != len(self.axes)
            or not (local or set(self.axes) <= set("xyz"))
        ):
            self._fail(f"axes must be some of x, y, z or some of e, n, u, not {self.axes!r}")
        if np.shape(self.value) != (3 if local else len(self.axes),):
            self._fail(f"value has {np.size(self.value)} components, axes {self.axes!r}")
        _covariance(self, len(self.axes))


@dataclass(frozen=True)
class GnssPosition(ControlPoint):
    """Position of a point by GNSS, metres, with a full covariance."""

    kind: ClassVar[str] = "gnss_position"


@dataclass(frozen=True)
class PhotoPosition(Observation):
    """Position of the projection centre of a photo (GNSS), metres.

    Computed: X₀ + R a with the lever arm a from the projection centre to the antenna, in the
    photogrammetric axes of the camera (x right, y up, z backwards).
    """

    kind: ClassVar[str] = "photo_position"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    photo: str
    """The photo."""
    value: tuple[float, float, float]
    """Observed position, metres."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, metres, or"""
    covariance: Array | None = None
    """covariance (3, 3), metres²."""
    lever_arm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """From the projection centre to the antenna, metres."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """Where it was read from."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if np.shape(self.value) != (3,):
            self._fail(f"value must have 3 components, not {self.value}")
        _covariance(self, 3)


@dataclass(frozen=True)
class ImagePoint(Observation):
    """Image coordinates of a point in a photo, units of the camera, x right, y up. Eq. 1."""

    kind: ClassVar[str] = "image"
    components: ClassVar[tuple[str, ...]] = ("x", "y")
    photo: str
    """The photo."""
    point: str
    """The point."""
    x: float
    """Measured x."""
    y: float
    """Measured y."""
    _: KW_ONLY
    sigma: tuple[float, float] | float
    """Standard deviations of x and y, or one for both."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """Where it was read from."""


@dataclass(frozen=True)
class Correlated:
    """Observations with one joint covariance (GNSS clusters, control with covariance)."""

    observations: tuple[Observation, ...]
    """The observations; image coordinates are not among them."""
    covariance: Array
    """Covariance over all their scalar components in order, units of the observations."""

    def __post_init__(self) -> None:
        """Check sizes and that the covariance is positive definite."""
        size = sum(n_scalars(o) for o in self.observations)
        where = " + ".join(o.label() for o in self.observations[:3])
        if any(isinstance(o, ImagePoint) for o in self.observations):
            raise InputError(Problem("image coordinates cannot be in a correlated group", where))
        if np.shape(self.covariance) != (size, size):
            raise InputError(
                Problem(
                    f"covariance must be {size} × {size}, not {np.shape(self.covariance)}", where
                )
            )
        try:
            whitening(self.covariance)
        except InputError as error:
            raise InputError(Problem(str(error), where)) from None


def n_scalars(observation: Observation) -> int:
    """Return the number of scalar components."""
    if isinstance(observation, ControlPoint):
        return len(observation.axes)
    return len(observation.components)


AnyObservation: TypeAlias = "Observation | Correlated"
OBSERVATIONS: dict[str, type[Observation]] = {
    cls.kind: cls
    for cls in (
        SlopeDistance,
        HorizontalDistance,
        VerticalAngle,
        ZenithAngle,
        Direction,
        HorizontalAngle,
        Azimuth,
        HeightDifference,
        AstronomicLatitude,
        AstronomicLongitude,
        GnssVector,
        GnssPosition,
        ControlPoint,
        PhotoPosition,
        ImagePoint,
    )
}
"""Observation classes by kind."""
