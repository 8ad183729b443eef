"""Observations in own frames: models, strips, scanners, trackers, wires, inclinometers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import ClassVar

import numpy as np

from ..frames import Frame
from .base import AxesObservation, Observation, Sigma, VectorObservation
from .terrestrial_observations import check_face, check_zenith

MAX_LENGTH_EXCESS_SIGMAS = 10.0
"""Number of standard deviations by which the errors of readings may make a unit vector longer."""


@dataclass(frozen=True)
class FrameSight(Observation):
    """Base of the sights from the origin of a frame to a point, see `Network.add_frame`."""

    frame: str
    """The frame of the instrument."""
    point: str
    """The target."""
    value: float
    """Observed value, radians or unit of the frame."""
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation, unit of the value; centring in the unit of the frame."""


@dataclass(frozen=True)
class FrameDirection(FrameSight):
    """Direction in a frame, clockwise from its y axis, radians: atan2(q_x, q_y) − c/sin z.

    In face 2 atan2(q_x, q_y) + c/sin z + π. An instrument that counts counter-clockwise from its x
    axis reads π/2 less this direction.
    """

    kind: ClassVar[str] = "frame_direction"
    _: KW_ONLY
    face: int = field(default=1, metadata={"quantity": "number"})
    """Face of the reading, 1 or 2."""
    collimation_error: str | None = None
    """Name of the collimation error c of the telescope; None: it is 0."""

    def _check(self) -> None:
        """Refuse other faces, besides what all observations refuse."""
        super()._check()
        check_face(self, self.face)


@dataclass(frozen=True)
class FrameZenith(FrameSight):
    """Zenith angle in a frame, from its z axis, radians: z + i; in face 2 2π − z + i.

    The value is from 0 to π, in face 2 from π to 2π. There is no refraction.
    """

    kind: ClassVar[str] = "frame_zenith"
    _: KW_ONLY
    face: int = field(default=1, metadata={"quantity": "number"})
    """Face of the reading, 1 or 2."""
    index_error: str | None = None
    """Name of the index error i of the vertical circle; None: it is 0."""

    def with_reading(self, values: Sequence[float], frame: Frame) -> FrameZenith:
        """Return the observation with another reading; in face 2 taken modulo 2π."""
        (value,) = values
        return replace(self, value=value % (2.0 * math.pi) if self.face == 2 else value)

    def _check(self) -> None:
        """Refuse readings of the other face, besides what all observations refuse."""
        super()._check()
        check_face(self, self.face)
        check_zenith(self, self.value, self.face)


@dataclass(frozen=True)
class FrameDistance(FrameSight):
    """Distance in a frame from its origin, unit of the frame: (1 + m) |q| + zero.

    The offset of the frame counts: q = 0 is the place of the instrument.
    """

    kind: ClassVar[str] = "frame_distance"
    nonnegative: ClassVar[bool] = True
    _: KW_ONLY
    instrument: str | None = None
    """Name of the distance meter, which has m and the zero constant; None: both are 0."""


@dataclass(frozen=True)
class FrameCoordinate(AxesObservation):
    """Coordinates of a point or of a projection centre in a frame: q = e^{−ℓ} Rᵀ E (X − O) − c.

    They are model coordinates of independent models, coordinates of scanners, trackers and
    coordinate measuring machines, or of another network. All numbers have the unit of the frame,
    e^ℓ metres: metres where the scale is held at ln_scale = 0. See `Network.add_frame`.
    """

    kind: ClassVar[str] = "frame_coordinate"
    frame: str
    """The frame."""
    point: str | None
    """The point; None if ``photo`` is given."""
    value: tuple[float, ...]
    """Measured coordinates of ``axes``, unit of the frame."""
    _: KW_ONLY
    photo: str | None = None
    """The photo whose projection centre was measured; None if ``point`` is given."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the axes, unit of the frame; None if ``covariance`` is given."""
    deformation: str | None = None
    """Deformation of the model, which a group of models shares; None: there is none."""
    base: float = 1.0
    """Length to which the deformation refers, such as the base of the model, unit of the frame."""

    def _check(self) -> None:
        super()._check()
        if (self.point is None) == (self.photo is None):
            self._fail("give either a point or a photo")
        if not self.frame:
            self._fail("frame must name a frame")
        if not self.base > 0:
            self._fail(f"base must be greater than zero, not {self.base}")


@dataclass(frozen=True)
class FrameVector(VectorObservation):
    """Vector between two points along the axes of a frame: e^{−ℓ} Rᵀ E (X_j − X_i).

    It is a GNSS vector whose reference frame differs from that of the network by an unknown, held
    or weighted rotation and scale (`Network.add_frame` with free = ("rotation", "scale")); the
    offset of the frame has no part in it. E is the identity; in a frame that is ``level`` it is the
    horizon (east, north, up) at the first point. GNSS frames are turned by seconds of arc: state
    values 0 for free rotations, which vectors alone do not place. The axes of the frame are then
    nearly those of the network: geocentric vectors of a topocentric network are turned into its
    axes first, which `factorgraph_adj.vectors_in_own_datum` does with those of a network.
    """

    kind: ClassVar[str] = "frame_vector"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    frame: str
    """The frame."""
    station: str
    """First point, i."""
    target: str
    """Second point, j."""
    value: tuple[float, float, float]
    """Measured components along the axes of the frame, unit of the frame."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, unit of the frame; None if ``covariance`` is given."""

    def _check(self) -> None:
        super()._check()
        if not self.frame:
            self._fail("frame must name a frame")


@dataclass(frozen=True)
class WireReading(AxesObservation):
    """Where a stretched wire passes a sensor, metres: x across the wire, z upwards.

    The sensor is set up level and across the wire, unless its mount states or leaves free a roll.
    The frame of the wire has its y axis along the chord; free are rx (slope), ry, rz (bearing), x
    and z. A roll of the frame about the wire, ry, has no effect: a `FrameRoll` of 0 takes it away.
    See `factorgraph_adj.models.offsets`.
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

    def _check(self) -> None:
        super()._check()
        if not self.frame or not self.sag:
            self._fail("frame must name the frame of the wire, and sag its sag")
        if not self.length > 0:
            self._fail(f"the length of the wire must be greater than zero, not {self.length}")


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

    def _check(self) -> None:
        super()._check()
        if not self.frame:
            self._fail("frame must name a frame")


@dataclass(frozen=True)
class FrameRoll(FrameInclination):
    """Roll of an instrument on a body about its y axis, radians: atan2(g_x, g_z)."""

    kind: ClassVar[str] = "frame_roll"


@dataclass(frozen=True)
class UnitVector(VectorObservation):
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

    def _check(self) -> None:
        super()._check()
        if not self.frame:
            self._fail("frame must name a frame")
        if self.covariance is None:
            largest = float(np.max(np.asarray(self.sigma)))
        else:
            largest = float(np.sqrt(np.max(np.diag(self.covariance))))
        if not np.hypot(*self.value) <= 1.0 + MAX_LENGTH_EXCESS_SIGMAS * largest:
            self._fail(
                f"a unit vector has no components {self.value[0]}, {self.value[1]}: their length "
                f"exceeds 1 by more than {MAX_LENGTH_EXCESS_SIGMAS:g} σ"
            )


@dataclass(frozen=True)
class StripCoordinate(AxesObservation):
    """Coordinates of a point in a strip that bends: X = value + polynomial(along, across).

    The value is on the ground: coordinates of the strip after its absolute orientation, in the
    axes of the network. See `Network.set_polynomial` and `factorgraph_adj.models.deformation`.
    """

    kind: ClassVar[str] = "strip_coordinate"
    strip: str
    """The strip, which names its polynomial."""
    point: str
    """The point."""
    value: tuple[float, ...]
    """Coordinates of ``axes``, metres."""
    _: KW_ONLY
    along: float
    """Place along the strip from its middle, in the unit of its polynomial, such as kilometres."""
    across: float
    """Place across the strip, the same unit, to the left if axes of the network are right-handed
    and along points forward."""
    sigma: tuple[float, ...] | None = None
    """Standard deviations of the axes, metres; None if ``covariance`` is given."""

    def _check(self) -> None:
        super()._check()
        if not self.strip:
            self._fail("strip must name a strip polynomial")
