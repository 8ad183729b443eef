"""Records of the kinds of observations of independent models and strips."""

from __future__ import annotations

from ..models.strip import strip_coordinate
from .registry import ObservationKind
from .strips import StripCoordinate

RECORDS = (
    ObservationKind(
        StripCoordinate,
        (("point", "point"), ("polynomial", "strip")),
        strip_coordinate,
        ("along", "across"),
        linear=True,
        fixes="coordinates",
    ),
)
"""The records."""
