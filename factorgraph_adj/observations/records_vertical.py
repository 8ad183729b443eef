"""Records of heights above surfaces of pressure and water, of far directions and of gyros."""

from __future__ import annotations

from collections.abc import Sequence

from ..models import far_directions, level_surface, terrestrial
from .far_directions import GyroAzimuth, PhotoSight, PhotoTilt
from .registry import ObservationKind
from .vertical import LevelHeight, ProfileHeight
from .weights import DIRECTIONS

_ENDS = ("station", "target")
_CARRIED = (("pose", "photo"), ("mount", "mount"))

RECORDS: Sequence[ObservationKind] = (
    ObservationKind(
        ProfileHeight,
        (("point", "point"), *_CARRIED, ("profile", "profile")),
        level_surface.profile_height,
        ("time", "lever_arm"),
    ),
    ObservationKind(
        LevelHeight,
        (("point", "point"), ("level", "level")),
        level_surface.level_height,
        ("slope", "along", "geoid"),
    ),
    ObservationKind(PhotoTilt, _CARRIED, far_directions.photo_tilt, unit="rad"),
    ObservationKind(PhotoSight, _CARRIED, far_directions.photo_sight, ("body", "seen"), unit="rad"),
    ObservationKind(
        GyroAzimuth,
        (*((kind, end) for end in _ENDS for kind in ("point", "vertical")), ("gyro", "gyro")),
        terrestrial.gyro_azimuth,
        ("instrument_height", "target_height"),
        "rad",
        weight=DIRECTIONS,
        circular=True,
        fixes="direction",
        instrument="station",
    ),
)
"""The records, in order."""
