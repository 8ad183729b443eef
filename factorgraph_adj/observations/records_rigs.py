"""Records of relative poses."""

from __future__ import annotations

from ..models import relative
from .registry import Follower, ObservationKind
from .relative import RelativePosition, RelativeRotation

_PAIR = (("pose", "photo"), ("pose", "photo2"), ("mount", "mount"))

RECORDS = (
    ObservationKind(
        RelativeRotation,
        _PAIR,
        relative.relative_rotation,
        unit="rad",
        moved=relative.turned,
        follower=Follower(1, 0, relative.turned_with),
    ),
    ObservationKind(
        RelativePosition,
        (*_PAIR, ("edm", "instrument")),
        relative.relative_position,
        follower=Follower(1, 0, relative.moved_with),
    ),
)
"""The kinds of this topic."""
