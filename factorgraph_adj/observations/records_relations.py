"""Records of relations of points and shapes, and of lines in images."""

from __future__ import annotations

from collections.abc import Sequence

from ..models import axes, image_lines, pairs
from . import relations
from .registry import ObservationKind

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
)

RECORDS: Sequence[ObservationKind] = (
    ObservationKind(relations.EqualDistance, _PAIRS, pairs.equal_distance, ("ratio",)),
    ObservationKind(
        relations.EqualHeightDifference, _PAIRS, pairs.equal_height_difference, ("ratio",)
    ),
    ObservationKind(
        relations.RightAngle,
        (("point", "station"), ("point", "target"), ("point", "target2")),
        pairs.right_angle,
        unit="rad",
    ),
    ObservationKind(
        relations.PointDirection,
        (("point", "station"), ("point", "target")),
        pairs.point_direction,
        ("ux", "uy", "uz"),
        "rad",
        fixes="direction",
    ),
    ObservationKind(
        relations.CoordinateDifference,
        (("point", "station"), ("vertical", "station"), ("point", "target")),
        pairs.coordinate_difference,
        ("horizon",),
        linear=True,
    ),
    ObservationKind(relations.ParallelAxes, _SHAPES, axes.parallel_axes, unit="rad", turns=True),
    ObservationKind(relations.AxisAngle, _SHAPES, axes.axis_angle, unit="rad"),
    ObservationKind(relations.PlaneDistance, _SHAPES, axes.plane_distance),
    ObservationKind(
        relations.ImageLine,
        _LINE,
        image_lines.image_line,
        ("x", "y"),
        unit="image",
        shape="line",
    ),
)
"""The records."""
