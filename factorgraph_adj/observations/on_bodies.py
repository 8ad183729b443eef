"""Readings of instruments that sit on a body: wires, inclinometers, directions as unit vectors."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from ..types import Array
from .base import Observation, checked_covariance


@dataclass(frozen=True)
class WireReading(Observation):
    """Where a stretched wire passes a sensor, metres: x across the wire, z upwards.

    The sensor is set up level and across the wire, unless its mount states or leaves free a roll.
    The frame of the wire has its y axis along the chord; free are rx (slope), ry, rz (bearing), x
    and z. A roll of the frame about the wire, ry, has no effect: a `FrameRoll` of 0 takes it away.
    See `factorgraph_adj.models.wires`.
    """

    kind: ClassVar[str] = "wire_reading"
    components: ClassVar[tuple[str, ...]] = ("x", "z")
    frame: str
    """Frame of the wire."""
    point: str
    """Point of the sensor."""
    value: tuple[float, ...]
    """Readings of ``axes``, metres: the wire as seen from the sensor."""
    _: KW_ONLY
    sag: str
    """Sag of the wire in its middle, a `size`, positive downwards."""
    length: float
    """Distance between the fixings of the wire, metres; they are at y = 0 and y = length."""
    mount: str | None = None
    """Mount of the sensor: its rotation and its zero from the point; None: none."""
    axes: str = "xz"
    """Read axes of the sensor: x, z, or both."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the axes, metres; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance of the axes, metres²; None if ``sigma`` is given."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if not self.frame or not self.sag:
            self._fail("frame must name the frame of the wire, and sag its sag")
        if not self.length > 0:
            self._fail(f"the length of the wire must be greater than zero, not {self.length}")
        if not self.axes or not set(self.axes) <= set("xz") or len(set(self.axes)) < len(self.axes):
            self._fail(f"axes must be some of x, z, not {self.axes!r}")
        if np.shape(self.value) != (len(self.axes),):
            self._fail(f"value has {np.size(self.value)} components, axes {self.axes!r}")
        checked_covariance(self, len(self.axes))

    def component_names(self) -> tuple[str, ...]:
        """Return the read axes."""
        return tuple(self.axes)


@dataclass(frozen=True)
class WireReadingOnBody(WireReading):
    """Where a stretched wire passes a sensor that is fixed to a body, metres, in its axes x, z."""

    kind: ClassVar[str] = "wire_reading_on_body"
    _: KW_ONLY
    body: str
    """Frame of the body that carries the sensor; the mount turns from the sensor to its axes."""


@dataclass(frozen=True)
class FrameInclination(Observation):
    """Inclination of the x axis of an instrument on a body, radians: asin g_x.

    g = Bᵀ Rᵀ E u is the vertical in the axes of the instrument; the reading is positive where the
    x axis rises above the horizon.
    """

    kind: ClassVar[str] = "frame_inclination"
    frame: str
    """Frame of the body."""
    point: str
    """Point at whose vertical the instrument levels."""
    value: float
    """Reading, radians."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, radians."""
    mount: str | None = None
    """Mount of the instrument on the body; None: its axes are those of the frame."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def _check(self) -> None:
        super()._check()
        if not self.frame:
            self._fail("frame must name a frame")


@dataclass(frozen=True)
class FrameRoll(FrameInclination):
    """Roll of an instrument on a body about its y axis, radians: atan2(g_x, g_z)."""

    kind: ClassVar[str] = "frame_roll"


LENGTH_LIMIT = 10.0
"""Number of standard deviations by which the errors of readings may make a unit vector longer."""


@dataclass(frozen=True)
class UnitVector(Observation):
    """Direction from a station to a target as components x, y of a unit vector in a frame.

    A camera or an alignment sensor on a body that looks along the z axis gives them; their
    unit, as that of their σ, is the radian.
    """

    kind: ClassVar[str] = "unit_vector"
    components: ClassVar[tuple[str, ...]] = ("x", "y")
    frame: str
    """Frame of the body that carries the instrument."""
    station: str
    """Point of the instrument."""
    target: str
    """The target."""
    value: tuple[float, float]
    """Components x and y of the unit vector in the axes of the instrument."""
    _: KW_ONLY
    mount: str | None = None
    """Mount of the instrument on the body; None: its axes are those of the frame."""
    sigma: tuple[float, float] | None = None
    """Standard deviations, radians; None if ``covariance`` is given."""
    covariance: Array | None = None
    """Covariance, radians²; None if ``sigma`` is given."""
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""

    def __post_init__(self) -> None:
        """Check the observation."""
        self._check()
        if not self.frame:
            self._fail("frame must name a frame")
        if np.shape(self.value) != (2,):
            self._fail(f"value must have 2 components, not {self.value}")
        covariance = checked_covariance(self, 2)
        if covariance is None:
            largest = float(np.max(np.asarray(self.sigma)))
        else:
            largest = float(np.sqrt(np.max(np.diag(covariance))))
        if not np.hypot(*self.value) <= 1.0 + LENGTH_LIMIT * largest:
            self._fail(
                f"a unit vector has no components {self.value[0]}, {self.value[1]}: their length "
                f"exceeds 1 by more than {LENGTH_LIMIT:g} σ"
            )
