"""Records of JAG3D (points, groups, reductions), and their points, deflections and σ in a network.

JAG3D's x points north, its y east, its z up. Files have y first, so that y, x, z are the x, y, z
of a frame with axes east, north. A group of observations has one standard deviation of three
parts and its own additional parameters; an observation may have a standard deviation of its own.

Source: JAG3D 2026 (GitHub: applied-geodesy/jag3d), adjustment/network/ObservationType.java,
PointType.java, ParameterType.java, DefaultUncertainty.java, observation/group/*.java.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

import numpy as np

from ...errors import InputError, Problem
from ...frames import LocalFrame
from ...network.network import Network
from ...stochastic_model import StandardDeviation
from ...units import GON
from ..source import Problems

PointStatus: TypeAlias = Literal["reference", "stochastic", "datum", "new"]
POINT_STATUS_BY_NUMBER: dict[int, PointStatus] = {
    1: "reference",
    2: "stochastic",
    3: "datum",
    4: "new",
}
"""Type of a group of points by its number (PointType.java)."""
PARAMETER_BY_NUMBER = {
    1: "orientation",
    2: "scale",
    3: "zero point offset",
    4: "refraction",
    8: "rotation x",
    9: "rotation y",
    10: "rotation z",
}
"""Additional parameter by its number (ParameterType.java)."""
NEUTRAL_VALUES = {"scale": 1.0}
"""Value of a parameter that has no effect, where it is not 0."""
JAG3D_EARTH_RADIUS_M = 6_371_007.0
"""Radius of the Earth in JAG3D, metres (Constant.java)."""
DEFAULT_POINT_SIGMA_M = 0.002
"""σ of a coordinate of a stochastic point that states none, metres (DefaultUncertainty.java)."""
MIN_SIGMA_LENGTH_M = 1e-6
"""Shortest length for which σ is computed, metres; JAG3D takes shorter ones for unstated."""
_ANGLE = (0.0003 * GON, 0.0, 0.0005)
_DISTANCE = (0.002, 0.0, 2e-6)
_GNSS = (0.025, 0.0, 50e-6)


@dataclass(frozen=True)
class ObservationType:
    """Type of the observations of a group."""

    name: str
    """Its name here and in names of files: ``zenith_angles``."""
    number: int
    """Its number in JAG3D (ObservationType.java)."""
    default: tuple[float, float, float]
    """Parts of σ that JAG3D takes where a group states none, see ``DefaultUncertainty``."""
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


JAG3D_KINDS = {
    k.name: k
    for k in (
        ObservationType("levelling", 1, (0.0001, 0.001, 0.0), plan=False),
        ObservationType("directions", 2, _ANGLE, angle=True, height=False),
        ObservationType("horizontal_distances", 3, _DISTANCE, height=False),
        ObservationType("slope_distances", 4, _DISTANCE),
        ObservationType("zenith_angles", 5, _ANGLE, angle=True),
        ObservationType("gnss_1d", 6, _GNSS, "z", plan=False),
        ObservationType("gnss_2d", 7, _GNSS, "yx", height=False),
        ObservationType("gnss_3d", 8, _GNSS, "yxz"),
    )
}
"""Types of observations by name."""
JAG3D_KIND_BY_NUMBER = {k.number: k for k in JAG3D_KINDS.values()}
"""Types of observations by number."""


@dataclass(frozen=True)
class PointRow:
    """A point."""

    name: str
    """Its name."""
    status: PointStatus
    """Type of its group."""
    dimension: int
    """1: z is unknown, 2: y and x, 3: all."""
    yxz: tuple[float, float, float]
    """Coordinates east, north, up, metres; NaN: not stated."""
    sigma: tuple[float, float, float]
    """Standard deviations of a stochastic point, metres; NaN: not stated."""
    source: str
    """Its place in the file."""


@dataclass(frozen=True)
class ObservationRow:
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
    """Its place in the file."""
    ih: float = 0.0
    """Height of the instrument, metres."""
    th: float = 0.0
    """Height of the target, metres."""
    distance: float = math.nan
    """Length for the parts of σ that depend on it, metres; NaN: that of the coordinates."""


@dataclass(frozen=True)
class GroupParameter:
    """An additional parameter of a group."""

    value: float
    """Its value: radians, metres, or a number."""
    free: bool
    """Whether it is estimated."""


@dataclass(frozen=True)
class ObservationGroup:
    """A group of observations of one kind."""

    name: str
    """Its name."""
    kind: ObservationType
    """The kind."""
    rows: tuple[ObservationRow, ...]
    """Its observations."""
    uncertainty: tuple[float, float, float]
    """Parts a, b, c of σ (ObservationGroup.java, getStd): σ² = a² + p² + q², with the distance d

    | kind | p | q |
    | --- | --- | --- |
    | lengths, height differences, GNSS | b √(d / 1 km) | c d |
    | angles | b / √d | c / d |
    """
    extras: Mapping[str, GroupParameter] = field(default_factory=dict)
    """Additional parameters by name."""
    source: str = ""
    """Place of the group."""

    def extra(self, name: str) -> GroupParameter:
        """Return a parameter; one that is not stated is held where it has no effect."""
        return self.extras.get(name, GroupParameter(NEUTRAL_VALUES.get(name, 0.0), free=False))


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
    """Its place in the file."""


@dataclass(frozen=True)
class Reduction:
    """Reductions of observations that JAG3D applies itself (Reduction.java)."""

    radius: float = JAG3D_EARTH_RADIUS_M
    """Radius of the Earth, metres."""
    curvature: bool = False
    """Whether zenith angles and horizontal distances are corrected for the Earth's curvature."""
    height: float | None = None
    """Height from which horizontal distances are reduced to the ellipsoid, metres; None: not."""

    def distance(self, row: ObservationRow) -> ObservationRow:
        """Return a horizontal distance that is reduced (HorizontalDistance.java)."""
        (value,) = row.value
        if self.height is not None:
            value *= self.radius / (self.radius + self.height)
        if self.curvature:
            value = 2.0 * self.radius * math.asin(min(1.0, 0.5 * value / self.radius))
        return replace(row, value=(value,))


def gaussian_radius(major: float, minor: float, latitude: float) -> float:
    """Return the radius of the sphere that touches an ellipsoid best, √(M N), metres.

    Args:
        major: major semi-axis, metres.
        minor: minor semi-axis, metres.
        latitude: geodetic latitude, radians.
    """
    first = 1.0 - (minor / major) ** 2
    root = 1.0 - first * math.sin(latitude) ** 2
    return major * math.sqrt(1.0 - first) / root


class Conversion:
    """A network that is made of rows of JAG3D, and the problems found so far."""

    def __init__(
        self, name: str, reduction: Reduction, point_sigma: float, problems: Problems
    ) -> None:
        """Start with an empty network.

        Args:
            name: its name.
            reduction: reductions that JAG3D applies.
            point_sigma: σ of stochastic points that state none, metres.
            problems: problems found so far, to which others are added.
        """
        self.network = Network(name, frame=LocalFrame(radius=reduction.radius))
        self.reduction = reduction
        self.point_sigma = point_sigma
        self.problems = problems
        self.rows: dict[str, PointRow] = {}
        """Rows of points by name."""
        self.deflected: set[str] = set()
        """Names of the points with a deflection of the vertical."""

    def refuse(self, what: str, source: str) -> None:
        """Note a problem."""
        self.problems.wrong(what, source)

    def attempt(self, source: str, make: Callable[[], object]) -> None:
        """Call a function, and note the problems of its InputError."""
        self.problems.attempt(source, make)

    # -- points -----------------------------------------------------------------------------------

    def add_points(self, points: Sequence[PointRow]) -> None:
        """Add the points; datum points make the network a free one."""
        free = any(p.status == "datum" for p in points)
        if free:
            self.network.datum = "free"
        for row in points:
            if row.name in self.rows:
                first = self.rows[row.name].source
                self.refuse(f"point {row.name!r} stands in {first} already", row.source)
                continue
            self.rows[row.name] = row
            if free and row.status in ("reference", "stochastic"):
                what = (
                    f"{row.status} point {row.name!r} beside datum points, next to which JAG3D "
                    "leaves such points and their observations out: give the points of one of "
                    "the two kinds"
                )
                self.refuse(what, row.source)
                continue
            self.attempt(row.source, lambda row=row: self._add_point(row))  # type: ignore[misc]

    def _add_point(self, row: PointRow) -> None:
        y, x, z = row.yxz
        held = {1: "xy", 2: "z", 3: ""}[row.dimension]
        unknown = [axis not in held for axis in "xyz"]
        if row.dimension == 1 and (math.isnan(x) or math.isnan(y)):
            y = x = 0.0
        if row.dimension == 2 and math.isnan(z):
            z = 0.0
        sigma: tuple[float, ...] | None = None
        if row.status == "stochastic":
            stated = [self.point_sigma if not s > 0 else s for s in row.sigma]
            sigma = tuple(s if u else math.inf for s, u in zip(stated, unknown, strict=True))
        self.network.add_point(
            row.name,
            (y, x, z),
            fixed="xyz" if row.status == "reference" else held,
            sigma=sigma,
            datum=row.status == "datum",
        )

    def add_deflections(self, deflections: Sequence[Deflection]) -> None:
        """State deflections of the vertical."""
        for d in deflections:
            if d.name not in self.network.points:
                continue  # JAG3D ignores deflections of points that do not take part
            self.deflected.add(d.name)
            ry, rx = d.yx
            sigma = None if d.sigma is None else (d.sigma[0], d.sigma[1])
            self.attempt(
                d.source,
                lambda d=d, rx=rx, ry=ry, sigma=sigma: self.network.set_vertical(  # type: ignore[misc]
                    d.name, xi=-ry, eta=rx, sigma=sigma, fixed=sigma is None and not d.free
                ),
            )

    # -- standard deviations ----------------------------------------------------------------------

    def length(self, row: ObservationRow, *, plan: bool) -> float:
        """Return the length for σ, metres: the stated one, or that of the coordinates."""
        if row.distance > MIN_SIGMA_LENGTH_M:
            return row.distance
        ends = [self.rows[name] for name in (row.start, row.end)]
        start, end = (np.array(p.yxz) for p in ends)
        if any(p.dimension == 1 and not np.any(np.nan_to_num(p.yxz[:2])) for p in ends):
            start, end = start * math.nan, end
        d = end - start + (0.0, 0.0, row.th - row.ih)
        size = math.hypot(d[0], d[1]) if plan else float(np.linalg.norm(d))
        if not size > MIN_SIGMA_LENGTH_M:
            what = (
                "its σ depends on its length, which neither the row nor coordinates of its points "
                "state: write a σ or the length at the end of the row"
            )
            raise InputError(Problem(what, row.source))
        return size

    def of_length(self, group: ObservationGroup, row: ObservationRow) -> float | StandardDeviation:
        """Return σ of a distance."""
        if row.sigma[0] > 0:
            return row.sigma[0]
        a, b, c = group.uncertainty
        if b == 0.0 and not row.distance > MIN_SIGMA_LENGTH_M:
            return StandardDeviation(a, ppm=1e6 * c, combine="quadratic") if c > 0 else a
        d = row.distance if row.distance > MIN_SIGMA_LENGTH_M else row.value[0]
        return sigma_along(group, d)

    def of_angle(
        self, group: ObservationGroup, row: ObservationRow, *, plan: bool
    ) -> float | StandardDeviation:
        """Return σ of a direction or zenith angle."""
        if row.sigma[0] > 0:
            return row.sigma[0]
        a, b, c = group.uncertainty
        if b == c == 0.0:
            return a
        if b == 0.0 and not row.distance > MIN_SIGMA_LENGTH_M:
            return StandardDeviation(a, centring_target=c, combine="quadratic")
        d = self.length(row, plan=plan)
        return math.sqrt(a * a + b * b / d + c * c / (d * d))


def sigma_along(group: ObservationGroup, d: float) -> float:
    """Return σ of a length d, metres."""
    a, b, c = group.uncertainty
    return math.sqrt(a * a + b * b * d / 1000.0 + (c * d) ** 2)
