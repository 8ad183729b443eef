"""What a record of an observation need not say itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .numbers import Units


@dataclass(frozen=True)
class ImageAxes:
    """How image coordinates of one camera stand in files."""

    unit: str = "mm"
    """Unit: px or a length."""
    y_down: bool = False
    """Whether y points down (pixels from the upper left corner); inside it points up."""
    sigma: Mapping[str, object] = field(default_factory=dict)
    """Fields of the standard deviation where a record has none."""


@dataclass(frozen=True)
class RecordContext:
    """What a record need not say itself."""

    units: Units = field(default_factory=Units)
    """Units of values."""
    sigma: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Fields of the standard deviation by kind, where a record has none."""
    images: Mapping[str, ImageAxes] = field(default_factory=dict)
    """Axes of image coordinates by photo."""
    cameras: Mapping[str, ImageAxes] = field(default_factory=dict)
    """The same by camera, for photos that are still to come."""
