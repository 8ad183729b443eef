"""Records of the sights from instruments in frames of their own."""

from __future__ import annotations

from math import pi

from ..models import frame_sights
from .frame_sights import FrameDirection, FrameDistance, FrameZenith
from .registry import ObservationKind
from .weights import DIRECTIONS, INCLINATIONS, LENGTHS

_SIGHT = (
    ("frame", "frame"),
    ("point", "point"),
    ("point", "frame.origin"),
    ("vertical", "frame.origin"),
)

RECORDS = (
    ObservationKind(
        FrameDirection,
        (*_SIGHT, ("collimation_error", "collimation_error")),
        frame_sights.frame_direction,
        ("face",),
        "rad",
        weight=DIRECTIONS,
        circular=True,
        tells="direction",
        instrument="frame",
    ),
    ObservationKind(
        FrameZenith,
        (*_SIGHT, ("index_error", "index_error")),
        frame_sights.frame_zenith,
        ("face",),
        "rad",
        weight=INCLINATIONS,
        tells="zenith",
        instrument="frame",
        level_reading=pi / 2,
    ),
    ObservationKind(
        FrameDistance,
        (*_SIGHT, ("edm", "instrument")),
        frame_sights.frame_distance,
        weight=LENGTHS,
        tells="distance",
        instrument="frame",
    ),
)
"""Records in the order of registration."""
