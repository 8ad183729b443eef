"""Sights from an instrument in a frame of its own: scanners, laser trackers, tilted theodolites."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import ClassVar

from ..frames import Frame
from .base import Observation, Sigma
from .terrestrial import check_face, check_zenith


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
    id: str | None = None
    """Name of the observation."""
    source: str | None = None
    """File and line from which the observation was read."""


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

    The offset of the frame counts: q = 0 is where the instrument stands.
    """

    kind: ClassVar[str] = "frame_distance"
    nonnegative: ClassVar[bool] = True
    _: KW_ONLY
    instrument: str | None = None
    """Name of the distance meter, which has m and the zero constant; None: both are 0."""
