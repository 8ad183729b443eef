"""Records of the observations of a photo flight: positions, attitudes, angles, ranges, bases."""

from __future__ import annotations

from collections.abc import Sequence

from ..models import antenna, attitude
from .airborne import (
    AntennaVector,
    NavigationAttitude,
    PhotoAngle,
    PhotoAttitude,
    PhotoBase,
    PhotoRange,
)
from .positions import PhotoPosition
from .registry import ObservationKind

_PHOTO = (("pose", "photo"), ("mount", "mount"))
_METER = ("edm", "instrument")
_TURNING = (*_PHOTO, ("attitude_drift", "drift"))

POSITION = ObservationKind(
    PhotoPosition,
    (*_PHOTO, ("drift", "drift"), ("shutter", "shutter")),
    antenna.photo_position,
    ("lever_arm", "time", "velocity"),
    fixes="coordinates",
)
"""Record of observed positions, which stands among the oldest kinds."""

RECORDS: Sequence[ObservationKind] = (
    ObservationKind(
        PhotoAttitude,
        _TURNING,
        attitude.photo_attitude,
        ("time", "by_angles"),
        "rad",
        fixes="attitude",
        choices=("about",),
        moved=attitude.turn_readings(attitude.PHOTOGRAMMETRIC),
    ),
    ObservationKind(
        NavigationAttitude,
        _TURNING,
        attitude.navigation_attitude,
        ("time", "by_angles"),
        "rad",
        fixes="attitude",
        choices=("about",),
        moved=attitude.turn_readings(attitude.NAVIGATION),
    ),
    ObservationKind(
        PhotoAngle,
        _PHOTO,
        attitude.photo_angle,
        ("which",),
        "rad",
        fixes="attitude",
        choices=("angle",),
    ),
    ObservationKind(
        PhotoRange, (("point", "point"), *_PHOTO, _METER), antenna.photo_range, ("lever_arm",)
    ),
    ObservationKind(
        PhotoBase,
        (("pose", "photo"), ("pose", "photo2"), ("mount", "mount"), _METER),
        antenna.photo_base,
        ("lever_arm",),
    ),
    ObservationKind(
        AntennaVector, _PHOTO, antenna.antenna_vector, ("lever_arm",), fixes="attitude"
    ),
)
"""Records of the further kinds."""
