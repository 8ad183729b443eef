"""Records of the kinds of metrology: offsets, wires, water levels, inclinometers."""

from __future__ import annotations

from ..models import inclinations, offsets, wires
from ..models.outlines import WIRE
from .offsets import (
    HydrostaticReading,
    LineOffset,
    PlaneOffset,
    PlumbOffset,
    RadialOffset,
    SightOffset,
    SightPlaneOffset,
)
from .on_bodies import FrameInclination, FrameRoll, UnitVector, WireReading, WireReadingOnBody
from .registry import ObservationKind

_ORIGIN = (("point", "frame.origin"), ("vertical", "frame.origin"))
_IN_FRAME = (("frame", "frame"), ("point", "point"), *_ORIGIN)
_SIGHT = (
    ("point", "station"),
    ("vertical", "station"),
    ("point", "target"),
    ("vertical", "target"),
    ("orientation", "set"),
)
_HEIGHTS = ("instrument_height", "target_height")
_MOUNT = ("mount", "mount")
_WIRE = (("point", "point"), ("size", "sag"), _MOUNT, *_ORIGIN)
_INCLINED = (("frame", "frame"), ("point", "point"), ("vertical", "point"), _MOUNT, *_ORIGIN)

RECORDS = (
    ObservationKind(PlaneOffset, _IN_FRAME, offsets.plane_offset),
    ObservationKind(PlumbOffset, _IN_FRAME, offsets.plumb_offset, one_sided=True),
    ObservationKind(
        LineOffset,
        (("point", "point"), ("point", "start"), ("point", "end")),
        offsets.line_offset,
        one_sided=True,
    ),
    ObservationKind(
        SightPlaneOffset,
        _SIGHT,
        offsets.sight_plane_offset,
        ("horizontal", *_HEIGHTS),
        instrument="station",
    ),
    ObservationKind(
        SightOffset,
        _SIGHT,
        offsets.sight_offset,
        ("horizontal", "zenith", *_HEIGHTS),
        one_sided=True,
        instrument="station",
    ),
    ObservationKind(
        RadialOffset,
        (("point", "point"),),
        offsets.radial_offset,
        ("bearing", "reference_x", "reference_y", "reference_z"),
        linear=True,
        fixes="coordinates",
    ),
    ObservationKind(
        HydrostaticReading,
        (("point", "point"), ("level", "level"), _MOUNT),
        offsets.hydrostatic_reading,
        ("undulation", "expansion", "side"),
    ),
    ObservationKind(
        WireReading, (("frame", "frame"), *_WIRE), wires.wire_reading, ("length",), outline=WIRE
    ),
    ObservationKind(
        WireReadingOnBody,
        (
            ("frame", "frame"),
            ("frame", "body"),
            *_WIRE,
            ("point", "body.origin"),
            ("vertical", "body.origin"),
        ),
        wires.wire_reading_on_body,
        ("length",),
        outline=WIRE,
    ),
    ObservationKind(FrameInclination, _INCLINED, inclinations.frame_inclination, unit="rad"),
    ObservationKind(FrameRoll, _INCLINED, inclinations.frame_roll, unit="rad"),
    ObservationKind(
        UnitVector,
        (("frame", "frame"), ("point", "station"), ("point", "target"), _MOUNT, *_ORIGIN),
        inclinations.unit_vector,
        unit="rad",
    ),
)
"""Records in order."""
