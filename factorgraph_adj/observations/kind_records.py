"""Records of kinds: flight, instruments, metrology, strips, relations, rigs, shapes, heights."""

from __future__ import annotations

from collections.abc import Sequence
from math import pi

from ..models import (
    attitude,
    directions,
    frame_axes,
    image,
    offsets,
    positions,
    relative_poses,
    shapes,
    sub_frame,
    terrestrial_observations,
)
from ..models import offsets as wires
from ..models.deformation import strip_coordinate
from ..models.shape_outlines import WIRE
from ..models.shapes import SHAPES
from . import relations, shape_points
from .airborne_observations import (
    AntennaVector,
    NavigationAttitude,
    PhotoAngle,
    PhotoAttitude,
    PhotoBase,
    PhotoRange,
    PhotoSight,
    PhotoTilt,
)
from .frame_observations import (
    FrameDirection,
    FrameDistance,
    FrameInclination,
    FrameRoll,
    FrameZenith,
    StripCoordinate,
    UnitVector,
    WireReading,
    WireReadingOnBody,
)
from .offsets import (
    HydrostaticReading,
    LineOffset,
    PlaneOffset,
    PlumbOffset,
    RadialOffset,
    SightOffset,
    SightPlaneOffset,
)
from .positions import PhotoPosition
from .registry import Follower, ObservationKind
from .relative_poses import RELATIVE_POSE, RelativePosition, RelativeRotation
from .shape_points import _OnShape
from .surface_heights import LevelHeight, ProfileHeight
from .terrestrial_observations import GyroAzimuth
from .variances import DIRECTIONS, PLAIN_INCLINATIONS, PLAIN_LENGTHS

_PHOTO = (("pose", "photo"), ("mount", "mount"))
_METER = ("edm", "instrument")
_TURNING = (*_PHOTO, ("attitude_drift", "drift"))

POSITION = ObservationKind(
    PhotoPosition,
    (*_PHOTO, ("drift", "drift"), ("shutter", "shutter")),
    positions.photo_position,
    ("lever_arm", "time", "velocity"),
    fixes="coordinates",
    quantity="coordinates of a photo",
)
"""Record of observed positions, which is among the oldest kinds."""

FLIGHT_KINDS: Sequence[ObservationKind] = (
    ObservationKind(
        PhotoAttitude,
        _TURNING,
        attitude.photo_attitude,
        ("time", "by_angles"),
        "rad",
        fixes="attitude",
        choices=("about",),
        moved=attitude.turn_readings(attitude.PHOTOGRAMMETRIC),
        quantity="attitude of a photo",
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
        quantity="attitude of a photo",
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
        PhotoRange, (("point", "point"), *_PHOTO, _METER), positions.photo_range, ("lever_arm",)
    ),
    ObservationKind(
        PhotoBase,
        (("pose", "photo"), ("pose", "photo2"), ("mount", "mount"), _METER),
        positions.photo_base,
        ("lever_arm",),
        quantity="distance of photos",
    ),
    ObservationKind(
        AntennaVector, _PHOTO, positions.antenna_vector, ("lever_arm",), fixes="attitude"
    ),
)
"""Records of the further kinds."""


_SIGHT = (
    ("frame", "frame"),
    ("point", "point"),
    ("point", "frame.origin"),
    ("vertical", "frame.origin"),
)

INSTRUMENT_KINDS = (
    ObservationKind(
        FrameDirection,
        (*_SIGHT, ("collimation_error", "collimation_error")),
        sub_frame.frame_direction,
        ("face",),
        "rad",
        weight=DIRECTIONS,
        circular=True,
        in_frame="direction",
        instrument="frame",
    ),
    ObservationKind(
        FrameZenith,
        (*_SIGHT, ("index_error", "index_error")),
        sub_frame.frame_zenith,
        ("face",),
        "rad",
        weight=PLAIN_INCLINATIONS,
        in_frame="zenith",
        instrument="frame",
        level_reading=pi / 2,
    ),
    ObservationKind(
        FrameDistance,
        (*_SIGHT, ("edm", "instrument")),
        sub_frame.frame_distance,
        weight=PLAIN_LENGTHS,
        in_frame="distance",
        instrument="frame",
    ),
)
"""Records in the order of registration."""


_ORIGIN = (("point", "frame.origin"), ("vertical", "frame.origin"))
_IN_FRAME = (("frame", "frame"), ("point", "point"), *_ORIGIN)
_OFFSET_SIGHT = (
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

METROLOGY_KINDS = (
    ObservationKind(PlaneOffset, _IN_FRAME, offsets.plane_offset, linear=True),
    ObservationKind(PlumbOffset, _IN_FRAME, offsets.plumb_offset, one_sided=True),
    ObservationKind(
        LineOffset,
        (("point", "point"), ("point", "start"), ("point", "end")),
        offsets.line_offset,
        one_sided=True,
    ),
    ObservationKind(
        SightPlaneOffset,
        _OFFSET_SIGHT,
        offsets.sight_plane_offset,
        ("horizontal", *_HEIGHTS),
        linear=True,
        instrument="station",
    ),
    ObservationKind(
        SightOffset,
        _OFFSET_SIGHT,
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
        linear=True,
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
    ObservationKind(
        FrameInclination, _INCLINED, attitude.frame_inclination, unit="rad", linear=True
    ),
    ObservationKind(FrameRoll, _INCLINED, attitude.frame_roll, unit="rad", linear=True),
    ObservationKind(
        UnitVector,
        (("frame", "frame"), ("point", "station"), ("point", "target"), _MOUNT, *_ORIGIN),
        attitude.unit_vector,
        unit="rad",
    ),
)
"""Records in order."""


MODEL_KINDS = (
    ObservationKind(
        StripCoordinate,
        (("point", "point"), ("polynomial", "strip")),
        strip_coordinate,
        ("along", "across"),
        linear=True,
        fixes="coordinates",
        quantity="coordinates in a strip",
    ),
)
"""The records."""


_SHAPES = (
    ("frame", "shape"),
    ("frame", "shape2"),
    ("point", "shape.origin"),
    ("vertical", "shape.origin"),
    ("point", "shape2.origin"),
    ("vertical", "shape2.origin"),
)
_PAIRS = (("point", "station"), ("point", "target"), ("point", "station2"), ("point", "target2"))
_LINE = (
    ("pose", "photo"),
    ("calibration", "photo"),
    ("frame", "line"),
    ("point", "line.origin"),
    ("vertical", "line.origin"),
    ("photo_motion", "photo"),
)

RELATION_KINDS: Sequence[ObservationKind] = (
    ObservationKind(relations.EqualDistance, _PAIRS, shapes.equal_distance, ("ratio",)),
    ObservationKind(
        relations.EqualHeightDifference,
        _PAIRS,
        shapes.equal_height_difference,
        ("ratio",),
        linear=True,
    ),
    ObservationKind(
        relations.RightAngle,
        (("point", "station"), ("point", "target"), ("point", "target2")),
        shapes.right_angle,
        unit="rad",
    ),
    ObservationKind(
        relations.PointDirection,
        (("point", "station"), ("point", "target")),
        shapes.point_direction,
        ("ux", "uy", "uz"),
        "rad",
        fixes="direction",
    ),
    ObservationKind(
        relations.CoordinateDifference,
        (("point", "station"), ("vertical", "station"), ("point", "target")),
        shapes.coordinate_difference,
        ("horizon",),
        linear=True,
        quantity="coordinate difference",
    ),
    ObservationKind(
        relations.ParallelAxes,
        _SHAPES,
        frame_axes.parallel_axes,
        unit="rad",
        linear=True,
        turns=True,
    ),
    ObservationKind(relations.AxisAngle, _SHAPES, frame_axes.axis_angle, unit="rad", linear=True),
    ObservationKind(relations.PlaneDistance, _SHAPES, frame_axes.plane_distance, linear=True),
    ObservationKind(
        relations.ImageLine,
        _LINE,
        image.image_line,
        ("x", "y"),
        unit="image",
        shape="line",
        quantity="point of a line in a photo",
    ),
)
"""The records."""


_PAIR = (("pose", "photo"), ("pose", "photo2"), ("mount", "mount"))

RIG_KINDS = (
    ObservationKind(
        RelativeRotation,
        _PAIR,
        relative_poses.relative_rotation,
        unit="rad",
        moved=relative_poses.turned,
        follower=Follower(1, 0, relative_poses.turned_with),
        quantity="relative rotation",
        part_of=RELATIVE_POSE,
    ),
    ObservationKind(
        RelativePosition,
        (*_PAIR, ("edm", "instrument")),
        relative_poses.relative_position,
        follower=Follower(1, 0, relative_poses.moved_with),
        quantity="relative position",
        part_of=RELATIVE_POSE,
    ),
)
"""The kinds of this topic."""
_ENDS = ("station", "target")
_CARRIED = (("pose", "photo"), ("mount", "mount"))
SURFACE_HEIGHT_KINDS: Sequence[ObservationKind] = (
    ObservationKind(
        ProfileHeight,
        (("point", "point"), *_CARRIED, ("profile", "profile")),
        positions.profile_height,
        ("time", "lever_arm"),
        linear=True,
        quantity="height in a profile",
    ),
    ObservationKind(
        LevelHeight,
        (("point", "point"), ("level", "level")),
        positions.level_height,
        ("slope", "along", "geoid"),
        linear=True,
        quantity="height above a level",
    ),
    ObservationKind(PhotoTilt, _CARRIED, directions.photo_tilt, unit="rad"),
    ObservationKind(PhotoSight, _CARRIED, directions.photo_sight, ("body", "seen"), unit="rad"),
    ObservationKind(
        GyroAzimuth,
        (*((kind, end) for end in _ENDS for kind in ("point", "vertical")), ("gyro", "gyro")),
        terrestrial_observations.gyro_azimuth,
        ("instrument_height", "target_height"),
        "rad",
        weight=DIRECTIONS,
        circular=True,
        fixes="direction",
        instrument="station",
        quantity="gyro azimuth",
    ),
)
"""The records, in order."""


def on_shape(cls: type[_OnShape]) -> ObservationKind:
    """Return the record of points on a shape."""
    shape = SHAPES[cls.shape_name]
    variables = (
        ("frame", "shape"),
        ("point", "point"),
        ("point", "shape.origin"),
        ("vertical", "shape.origin"),
        *((s.kind, s.attribute) for s in shape.sizes),
    )
    return ObservationKind(
        cls,
        variables,
        shape,
        linear=shape.linear,
        shape=shape.name,
        turns=shape.turns,
        outline=shape.outline,
    )


SHAPE_KINDS: Sequence[ObservationKind] = tuple(
    on_shape(cls)
    for cls in (
        shape_points.OnPlane,
        shape_points.OnLine,
        shape_points.OnCircle,
        shape_points.OnCylinder,
        shape_points.OnSphere,
        shape_points.OnCone,
        shape_points.OnTorus,
        shape_points.OnParaboloid,
    )
)
"""The records."""
