"""Defaults for records of observations: units, standard deviations, image axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from .numbers import Units


@dataclass(frozen=True)
class ImageAxes:
    """Unit, direction of y and default σ of one camera's image coordinates in files."""

    unit: str = "mm"
    """Unit: px or a length."""
    y_down: bool = False
    """Whether y points down in files (pixels from the upper left corner); networks have y up."""
    sigma: Mapping[str, object] = field(default_factory=dict)
    """Fields of the default standard deviation, for records that state none."""


@dataclass(frozen=True)
class RecordContext:
    """Defaults of a project for records that do not state these things themselves."""

    units: Units = field(default_factory=Units)
    """Units of values."""
    sigma: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    """Fields of the default standard deviation by kind, for records that state none."""
    images: Mapping[str, ImageAxes] = field(default_factory=dict)
    """Axes of image coordinates by photo."""
    cameras: Mapping[str, ImageAxes] = field(default_factory=dict)
    """Axes of image coordinates by camera, for photos that are added later."""
