"""Registration of all built-in kinds; records of terrestrial, GNSS, image and frame kinds.

A module of this package that states `KINDS_IN_MODULE`, and `UNKNOWNS_IN_MODULE` if its kinds have
an unknown of their own, needs no line here: its records are found and registered.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from math import pi
from pkgutil import iter_modules

from ..models import positions, sub_frame, terrestrial_observations
from ..models.unknown_registry import register_unknown
from . import kind_records
from .frame_observations import FrameCoordinate, FrameVector
from .image import ImagePoint
from .kind_records import INSTRUMENT_KINDS as _INSTRUMENTS
from .kind_records import METROLOGY_KINDS as _METROLOGY
from .kind_records import RELATION_KINDS as _RELATIONS
from .kind_records import SHAPE_KINDS as _SHAPES
from .positions import ControlPoint, GnssPosition, GnssVector
from .registry import KINDS, ObservationKind, register_observation
from .terrestrial_observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    Direction,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from .variances import ANGLES, DIRECTIONS, INCLINATIONS, LENGTHS, LEVELLING, PLAIN_LENGTHS

_STATION = (("point", "station"), ("vertical", "station"))
_SIGHT = (*_STATION, ("point", "target"), ("vertical", "target"))
_SIGHT2 = (*_SIGHT, ("point", "target2"), ("vertical", "target2"))
_HEIGHTS = ("instrument_height", "target_height")
_METER = ("edm", "instrument")
_KAPPA = ("refraction", "refraction")
_INDEX = ("index_error", "index_error")
_COLLIMATION = ("collimation_error", "collimation_error")
_RAY = (
    ("pose", "photo"),
    ("calibration", "photo"),
    ("point", "point"),
    ("photo_motion", "photo"),
)
_POINT = (("point", "point"),)
_IN_FRAME = (
    ("frame", "frame"),
    *_POINT,
    ("pose", "photo"),
    ("point", "frame.origin"),
    ("vertical", "frame.origin"),
)

_BUILT_IN: Sequence[ObservationKind] = (
    ObservationKind(
        SlopeDistance,
        (*_SIGHT, _METER),
        terrestrial_observations.slope_distance,
        _HEIGHTS,
        weight=LENGTHS,
        quantity="slope distance",
    ),
    ObservationKind(
        HorizontalDistance,
        (*_SIGHT, _METER),
        terrestrial_observations.horizontal_distance,
        _HEIGHTS,
        weight=PLAIN_LENGTHS,
        quantity="horizontal distance",
    ),
    ObservationKind(
        VerticalAngle,
        (*_SIGHT, _KAPPA),
        terrestrial_observations.vertical_angle,
        _HEIGHTS,
        "rad",
        weight=INCLINATIONS,
        instrument="station",
        quantity="vertical angle",
    ),
    ObservationKind(
        ZenithAngle,
        (*_SIGHT, _KAPPA, _INDEX),
        terrestrial_observations.zenith_angle,
        (*_HEIGHTS, "face"),
        "rad",
        weight=INCLINATIONS,
        instrument="station",
        level_reading=pi / 2,
        quantity="zenith angle",
    ),
    ObservationKind(
        Direction,
        (*_SIGHT, ("orientation", "set"), _COLLIMATION),
        terrestrial_observations.direction,
        (*_HEIGHTS, "face"),
        "rad",
        weight=DIRECTIONS,
        circular=True,
        instrument="station",
        quantity="direction",
    ),
    ObservationKind(
        HorizontalAngle,
        _SIGHT2,
        terrestrial_observations.horizontal_angle,
        (*_HEIGHTS, "target2_height"),
        "rad",
        weight=ANGLES,
        circular=True,
        instrument="station",
        quantity="horizontal angle",
    ),
    ObservationKind(
        Azimuth,
        _SIGHT,
        terrestrial_observations.azimuth,
        _HEIGHTS,
        "rad",
        weight=DIRECTIONS,
        circular=True,
        fixes="direction",
        instrument="station",
        quantity="azimuth",
    ),
    ObservationKind(
        HeightDifference,
        _SIGHT,
        terrestrial_observations.height_difference,
        _HEIGHTS,
        weight=LEVELLING,
        linear=True,
        quantity="height difference",
    ),
    ObservationKind(
        AstronomicLatitude,
        _STATION,
        terrestrial_observations.astronomic_latitude,
        unit="rad",
        fixes="place",
    ),
    ObservationKind(
        AstronomicLongitude,
        _STATION,
        terrestrial_observations.astronomic_longitude,
        unit="rad",
        fixes="place",
    ),
    ObservationKind(
        GnssVector,
        _SIGHT,
        positions.gnss_vector,
        _HEIGHTS,
        linear=True,
        quantity="vector",
    ),
    ObservationKind(
        GnssPosition,
        _POINT,
        None,
        linear=True,
        fixes="coordinates",
        by_axis=True,
        quantity="GNSS coordinates",
    ),
    ObservationKind(
        ControlPoint,
        _POINT,
        None,
        linear=True,
        fixes="coordinates",
        by_axis=True,
        quantity="coordinates",
    ),
    kind_records.POSITION,
    ObservationKind(ImagePoint, _RAY, None, unit="image", in_image_table=True),
    ObservationKind(
        FrameCoordinate,
        (*_IN_FRAME, ("model_deformation", "deformation")),
        sub_frame.frame_coordinate,
        ("base",),
        linear=True,
        in_frame="coordinates",
    ),
    ObservationKind(
        FrameVector,
        (("frame", "frame"), ("point", "station"), ("point", "target")),
        sub_frame.frame_vector,
        linear=True,
        quantity="vector in a frame",
    ),
    *_INSTRUMENTS,
    *kind_records.FLIGHT_KINDS,
    *kind_records.MODEL_KINDS,
    *kind_records.SURFACE_HEIGHT_KINDS,
    *_SHAPES,
    *_RELATIONS,
    *_METROLOGY,
    *kind_records.RIG_KINDS,
)
for _kind in _BUILT_IN:
    register_observation(_kind)


def register_modules(names: Sequence[str]) -> Iterator[ObservationKind]:
    """Register the records that modules state, those of unknowns first; yield observations."""
    for name in names:
        module = import_module(name)
        for unknown in getattr(module, "UNKNOWNS_IN_MODULE", ()):
            register_unknown(unknown)
        for kind in getattr(module, "KINDS_IN_MODULE", ()):
            yield register_observation(kind)


FOUND_IN_MODULES = tuple(
    register_modules(
        [
            found.name
            for found in iter_modules(import_module(__package__).__path__, f"{__package__}.")
            if found.name != __name__
        ]
    )
)
"""Records that modules state themselves."""

BUILT_IN = tuple(KINDS)
"""Names of the built-in kinds, in order."""
