"""Offsets read on a scale from planes, plumb lines, lines and sights; readings of water levels."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

from .base import Observation

_ANGLE = {"quantity": "angle"}


@dataclass(frozen=True)
class PlaneOffset(Observation):
    """Offset of a point from the plane x = 0 of a frame, metres: q_x, positive along its x axis.

    A vertical plane of unknown place and bearing is a level frame of which rz and x are free.
    """

    kind: ClassVar[str] = "plane_offset"
    frame: str
    """Frame of the plane."""
    point: str
    """The point."""
    value: float
    """Offset, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""

    def _check(self) -> None:
        super()._check()
        if not self.frame:
            self._fail("frame must name a frame")


@dataclass(frozen=True)
class PlumbOffset(PlaneOffset):
    """Distance of a point from the z axis of a frame, metres: ρ = hypot(q_x, q_y).

    A plumb line of unknown place is a level frame of which x and y are free; one through a point
    is a level frame with its origin at this point and nothing free.
    """

    kind: ClassVar[str] = "plumb_offset"
    nonnegative: ClassVar[bool] = True


@dataclass(frozen=True)
class LineOffset(Observation):
    """Distance of a point from the straight line through two others, metres."""

    kind: ClassVar[str] = "line_offset"
    nonnegative: ClassVar[bool] = True
    point: str
    """The point."""
    start: str
    """First point of the line."""
    end: str
    """Second point of the line."""
    value: float
    """Distance from the line, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""


@dataclass(frozen=True)
class SightPlaneOffset(Observation):
    """Offset of a point from the vertical plane of a theodolite, metres, positive to its left.

    −cos α q_e + sin α q_n with the azimuth α = orientation of the set + horizontal reading.
    """

    kind: ClassVar[str] = "sight_plane_offset"
    station: str
    """Point of the theodolite."""
    target: str
    """Point at which the scale was read."""
    value: float
    """Offset, metres."""
    _: KW_ONLY
    horizontal: float = field(metadata=_ANGLE)
    """Reading of the horizontal circle, radians."""
    sigma: float
    """Standard deviation, metres."""
    set: str = "1"
    """Set of directions at the station, which has the orientation unknown."""
    instrument_height: float = 0.0
    """Height of the theodolite above its point, metres."""
    target_height: float = 0.0
    """Height of the scale above its point, metres."""


@dataclass(frozen=True)
class SightOffset(SightPlaneOffset):
    """Distance of a point from the line of sight of a theodolite, metres."""

    kind: ClassVar[str] = "sight_offset"
    nonnegative: ClassVar[bool] = True
    _: KW_ONLY
    zenith: float = field(metadata=_ANGLE)
    """Reading of the vertical circle from the zenith, radians."""

    def _check(self) -> None:
        super()._check()
        if not 0.0 <= self.zenith <= math.pi:
            gon = self.zenith * 200.0 / math.pi
            self._fail(f"a zenith angle lies between 0 and 200 gon, not at {gon:.4f} gon")


@dataclass(frozen=True)
class RadialOffset(Observation):
    """Offset of a point from a horizontal line with a given bearing through a place, metres.

    −cos β (E − E₀) + sin β (N − N₀), positive to the left. With a small σ a point moves along this
    line only.
    """

    kind: ClassVar[str] = "radial_offset"
    point: str
    """The point."""
    value: float
    """Offset, metres; 0 for a point on the line."""
    _: KW_ONLY
    bearing: float = field(metadata=_ANGLE)
    """Azimuth of the line from north, clockwise, radians."""
    reference_x: float
    """X of a place on the line, metres."""
    reference_y: float
    """Y of the place, metres."""
    reference_z: float = 0.0
    """Z of the place, metres."""
    sigma: float
    """Standard deviation, metres."""


@dataclass(frozen=True)
class HydrostaticReading(Observation):
    """Reading of a hydrostatic level, metres: from the zero of a sensor to the water.

    side (w + N − h(P) − b_z)/(1 + α ΔT): the height of the water w is an unknown ``level``.
    """

    kind: ClassVar[str] = "hydrostatic_reading"
    point: str
    """Point of the sensor."""
    level: str
    """Water whose level is an unknown: all vessels that one tube joins."""
    value: float
    """Reading, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""
    mount: str | None = None
    """Mount of the sensor, whose z is the height of its zero above the point; None: it is 0."""
    undulation: float = 0.0
    """Known height of the water at the sensor over its level surface in the network, metres: geoid
    and tide."""
    expansion: float = field(default=0.0, metadata={"quantity": "number"})
    """Relative expansion α ΔT by which the scale of the sensor is too long."""
    side: int = field(default=1, metadata={"quantity": "number"})
    """1: the sensor reads upwards to the water; −1: it reads downwards to it."""

    def _check(self) -> None:
        super()._check()
        if self.side not in (1, -1):
            self._fail(f"side must be 1 (reads upwards) or -1 (reads downwards), not {self.side}")
        if not self.level:
            self._fail("level must name a level surface")
        if self.expansion <= -1.0:
            self._fail(f"expansion must be greater than -1, not {self.expansion}")
