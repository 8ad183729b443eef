"""A network in the terms of JAG3D: groups of points, groups of observations, their parameters.

JAG3D's x points north, its y east, its z up. Files have y first, so that y, x, z are the x, y, z
of a frame with axes east, north. A group of observations has one standard deviation of three
parts and its own additional parameters; an observation may have a standard deviation of its own.

Source: JAG3D 2026 (GitHub: applied-geodesy/jag3d), adjustment/network/ObservationType.java,
PointType.java, ParameterType.java, DefaultUncertainty.java, observation/group/*.java.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

from ...units import GON

Status: TypeAlias = Literal["reference", "stochastic", "datum", "new"]
STATUS: dict[int, Status] = {1: "reference", 2: "stochastic", 3: "datum", 4: "new"}
"""Type of a group of points by its number (PointType.java)."""
PARAMETERS = {
    1: "orientation",
    2: "scale",
    3: "zero point offset",
    4: "refraction",
    8: "rotation x",
    9: "rotation y",
    10: "rotation z",
}
"""Additional parameter by its number (ParameterType.java)."""
NEUTRAL = {"scale": 1.0}
"""Value of a parameter that has no effect, where it is not 0."""
EARTH_RADIUS = 6_371_007.0
"""Radius of the Earth in JAG3D, metres (Constant.java)."""
POINT_SIGMA = 0.002
"""σ of a coordinate of a stochastic point that states none, metres (DefaultUncertainty.java)."""


@dataclass(frozen=True)
class Kind:
    """Type of the observations of a group."""

    name: str
    """Its name here and in names of files: ``zenith_angles``."""
    number: int
    """Its number in JAG3D (ObservationType.java)."""
    default: tuple[float, float, float]
    """Parts of σ that JAG3D takes where a group states none, see `Uncertainty`."""
    axes: str = ""
    """Observed differences of coordinates, of y, x, z; empty for a scalar observation."""
    angle: bool = False
    """Whether values are angles."""
    plan: bool = True
    """Whether its points need y and x among their unknowns."""
    height: bool = True
    """Whether its points need z among their unknowns."""

    @property
    def dimensions(self) -> tuple[int, ...]:
        """Dimensions of the points that it may join; JAG3D leaves others out without a word."""
        return tuple(
            d for d in (1, 2, 3) if not ((self.plan and d == 1) or (self.height and d == 2))
        )


_ANGLE = (0.0003 * GON, 0.0, 0.0005)
_DISTANCE = (0.002, 0.0, 2e-6)
_GNSS = (0.025, 0.0, 50e-6)
KINDS = {
    k.name: k
    for k in (
        Kind("levelling", 1, (0.0001, 0.001, 0.0), plan=False),
        Kind("directions", 2, _ANGLE, angle=True, height=False),
        Kind("horizontal_distances", 3, _DISTANCE, height=False),
        Kind("slope_distances", 4, _DISTANCE),
        Kind("zenith_angles", 5, _ANGLE, angle=True),
        Kind("gnss_1d", 6, _GNSS, "z", plan=False),
        Kind("gnss_2d", 7, _GNSS, "yx", height=False),
        Kind("gnss_3d", 8, _GNSS, "yxz"),
    )
}
"""Types of observations by name."""
BY_NUMBER = {k.number: k for k in KINDS.values()}
"""Types of observations by number."""


@dataclass(frozen=True)
class PointRow:
    """A point."""

    name: str
    """Its name."""
    status: Status
    """Type of its group."""
    dimension: int
    """1: z is unknown, 2: y and x, 3: all."""
    yxz: tuple[float, float, float]
    """Coordinates east, north, up, metres; NaN: not stated."""
    sigma: tuple[float, float, float]
    """Standard deviations of a stochastic point, metres; NaN: not stated."""
    source: str
    """Where it stands."""


@dataclass(frozen=True)
class Row:
    """An observation."""

    start: str
    """Station."""
    end: str
    """Target."""
    value: tuple[float, ...]
    """Observed values, metres or radians: one, or the differences of the axes of its kind."""
    sigma: tuple[float, ...]
    """Standard deviations; NaN: those of the group."""
    source: str
    """Where it stands."""
    ih: float = 0.0
    """Height of the instrument, metres."""
    th: float = 0.0
    """Height of the target, metres."""
    distance: float = math.nan
    """Length for the parts of σ that depend on it, metres; NaN: that of the coordinates."""


@dataclass(frozen=True)
class Extra:
    """An additional parameter of a group."""

    value: float
    """Its value: radians, metres, or a number."""
    free: bool
    """Whether it is estimated."""


@dataclass(frozen=True)
class Group:
    """A group of observations of one kind."""

    name: str
    """Its name."""
    kind: Kind
    """The kind."""
    rows: tuple[Row, ...]
    """Its observations."""
    uncertainty: tuple[float, float, float]
    """Parts a, b, c of σ (ObservationGroup.java, getStd): σ² = a² + p² + q², with the distance d

    | kind | p | q |
    | --- | --- | --- |
    | lengths, height differences, GNSS | b √(d / 1 km) | c d |
    | angles | b / √d | c / d |
    """
    extras: Mapping[str, Extra] = field(default_factory=dict)
    """Additional parameters by name."""
    source: str = ""
    """Where the group stands."""

    def extra(self, name: str) -> Extra:
        """Return a parameter; one that is not stated is held where it has no effect."""
        return self.extras.get(name, Extra(NEUTRAL.get(name, 0.0), free=False))


@dataclass(frozen=True)
class Deflection:
    """Deflection of the vertical of a point: rotations of its horizon about x and y."""

    name: str
    """The point."""
    yx: tuple[float, float]
    """Rotations about the axes y and x, radians."""
    sigma: tuple[float, float] | None
    """Standard deviations of weighted rotations, radians; None: held, or free."""
    free: bool
    """Whether they are estimated."""
    source: str
    """Where it stands."""


@dataclass(frozen=True)
class Reduction:
    """Reductions of observations that JAG3D applies itself (Reduction.java)."""

    radius: float = EARTH_RADIUS
    """Radius of the Earth, metres."""
    curvature: bool = False
    """Whether zenith angles and horizontal distances are corrected for the Earth's curvature."""
    height: float | None = None
    """Height from which horizontal distances are reduced to the ellipsoid, metres; None: not."""

    def distance(self, row: Row) -> Row:
        """Return a horizontal distance that is reduced (HorizontalDistance.java)."""
        (value,) = row.value
        if self.height is not None:
            value *= self.radius / (self.radius + self.height)
        if self.curvature:
            value = 2.0 * self.radius * math.asin(min(1.0, 0.5 * value / self.radius))
        return replace(row, value=(value,))


def radius_of(major: float, minor: float, latitude: float) -> float:
    """Return the radius of the sphere that touches an ellipsoid best, √(M N), metres.

    Args:
        major: major semi-axis, metres.
        minor: minor semi-axis, metres.
        latitude: geodetic latitude, radians.
    """
    first = 1.0 - (minor / major) ** 2
    root = 1.0 - first * math.sin(latitude) ** 2
    return major * math.sqrt(1.0 - first) / root
