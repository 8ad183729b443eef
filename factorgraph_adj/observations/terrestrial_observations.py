"""Observations with total stations, tapes, levels and gyrotheodolites, and astronomic ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import ClassVar

from ..frames import Frame
from .base import Observation, Sight, Sigma


def check_face(observation: Observation, face: float) -> None:
    """Refuse faces that an instrument does not have."""
    if face not in (1, 2):
        observation._fail(f"the face must be 1 or 2, not {face}")


def check_zenith(observation: Observation, value: float, face: float) -> None:
    """Refuse readings of a vertical circle, radians, that the face does not have."""
    gon = value * 200.0 / math.pi
    if face == 2:
        # 0 gon is 400 gon, and the value in plans without readings.
        if value != 0.0 and not math.pi <= value <= 2.0 * math.pi:
            observation._fail(
                f"a zenith reading in face 2 lies between 200 and 400 gon, not at {gon:.4f} "
                f"gon (in degrees: 180 and 360, {0.9 * gon:.4f}): is it of face 1?"
            )
    elif not 0.0 <= value <= math.pi:
        lies = (
            f"a zenith angle lies between 0 and 200 gon, not at {gon:.4f} gon (in degrees: 0 and "
            f"180, {0.9 * gon:.4f}): "
        )
        if value < 0.0:
            observation._fail(
                f"{lies}a negative reading is an angle from the horizon, below it; is it a "
                "vertical_angle, and so are the others of its set-up?"
            )
        observation._fail(
            f"{lies}a reading in the second face is 400 gon minus the zenith angle; give both "
            "faces to fga.reduce_faces or in readings.csv, or state face 2; an angle from the "
            "horizon is a vertical_angle"
        )


@dataclass(frozen=True)
class SlopeDistance(Sight):
    """Slope distance, metres: (1 + m) S + zero of the instrument. Eq. 4."""

    kind: ClassVar[str] = "slope_distance"
    nonnegative: ClassVar[bool] = True
    _: KW_ONLY
    instrument: str | None = None
    """Name of the distance meter, which has m and the zero constant; None: both are 0."""


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
    """Name of the refraction group; None: the group of the whole network."""


@dataclass(frozen=True)
class ZenithAngle(VerticalAngle):
    """Zenith angle, radians: z + i with z = π/2 − (β + κ S cosβ / 2R); in face 2 2π − z + i.

    The value is from 0 to π, in face 2 from π to 2π.
    """

    kind: ClassVar[str] = "zenith_angle"
    _: KW_ONLY
    face: int = field(default=1, metadata={"quantity": "number"})
    """Face of the reading, 1 or 2."""
    index_error: str | None = None
    """Name of the index error i of the vertical circle; None: it is 0."""

    @property
    def in_face_one(self) -> float:
        """Zenith angle that the reading gives without its index error, radians, from 0 to π."""
        return 2.0 * math.pi - self.value if self.face == 2 else self.value

    def with_reading(self, values: Sequence[float], frame: Frame) -> ZenithAngle:
        """Return the observation with another reading; in face 2 taken modulo 2π."""
        (value,) = values
        return replace(self, value=value % (2.0 * math.pi) if self.face == 2 else value)

    def _check(self) -> None:
        """Refuse readings of the other face, besides what all observations refuse."""
        super()._check()
        check_face(self, self.face)
        check_zenith(self, self.value, self.face)


@dataclass(frozen=True)
class Direction(Sight):
    """Horizontal direction, clockwise, radians: α − orientation of its set − c/sin z. Eq. 8.

    In face 2 α − orientation + c/sin z + π.
    """

    kind: ClassVar[str] = "direction"
    _: KW_ONLY
    set: str = "1"
    """Set of directions at the station; each set has one orientation unknown."""
    face: int = field(default=1, metadata={"quantity": "number"})
    """Face of the reading, 1 or 2."""
    collimation_error: str | None = None
    """Name of the collimation error c of the telescope; None: it is 0."""

    def _check(self) -> None:
        """Refuse other faces, besides what all observations refuse."""
        super()._check()
        check_face(self, self.face)


@dataclass(frozen=True)
class Azimuth(Sight):
    """Azimuth from north, clockwise, radians. Eq. 9."""

    kind: ClassVar[str] = "azimuth"


@dataclass(frozen=True)
class GyroAzimuth(Sight):
    """Azimuth read with a gyrotheodolite, radians: α − E, with the constant E of the instrument."""

    kind: ClassVar[str] = "gyro_azimuth"
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation, radians, or its parts."""
    gyro: str | None = None
    """Gyrotheodolite, see `Network.set_gyro`; None: E is 0."""


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


@dataclass(frozen=True)
class HeightDifference(Sight):
    """Levelled height difference from station to target, metres: ½(u_i + u_j)·d. Eq. 10.

    Its σ has a constant part and one for √1 km of line. It takes no centring: a level is
    anywhere. Of a trigonometric height difference the constant part states the whole.
    """

    kind: ClassVar[str] = "height_difference"
    _: KW_ONLY
    length_km: float | None = None
    """Length of the levelled line, km, for `StandardDeviation.per_sqrt_km`; None: the
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


@dataclass(frozen=True)
class AstronomicLongitude(AstronomicLatitude):
    """Astronomic longitude Λ of a station, east positive, radians. Eq. 11."""

    kind: ClassVar[str] = "astronomic_longitude"
