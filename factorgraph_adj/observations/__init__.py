"""What is measured: one frozen dataclass for each kind of observation.

Inside, lengths are metres, angles radians, image coordinates the units of the camera.
``sigma`` is a standard deviation in the same unit, or a `StandardDeviation` of several parts.
``id`` names the observation in every report; where none is given the network numbers it.
``source`` says where it came from (file and line) and appears in error messages.

`register_observation` adds a kind of one's own. Points, photos, cameras and other unknowns, which
observations refer to by name, stand here too.
"""

from ..network.entities import Camera, Parameter, Photo, Point
from ..stochastic import StandardDeviation
from .base import Observation, Sight
from .built_in import BUILT_IN
from .correlated import AnyObservation, Correlated
from .image import ImagePoint
from .positions import ControlPoint, GnssPosition, GnssVector, PhotoPosition
from .registry import KINDS, ObservationKind, Unit, observation_kind, register_observation
from .terrestrial import (
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
from .weights import Weight

__all__ = [
    "BUILT_IN",
    "KINDS",
    "AnyObservation",
    "AstronomicLatitude",
    "AstronomicLongitude",
    "Azimuth",
    "Camera",
    "ControlPoint",
    "Correlated",
    "Direction",
    "GnssPosition",
    "GnssVector",
    "HeightDifference",
    "HorizontalAngle",
    "HorizontalDistance",
    "ImagePoint",
    "Observation",
    "ObservationKind",
    "Parameter",
    "Photo",
    "PhotoPosition",
    "Point",
    "Sight",
    "SlopeDistance",
    "StandardDeviation",
    "Unit",
    "VerticalAngle",
    "Weight",
    "ZenithAngle",
    "observation_kind",
    "register_observation",
]
