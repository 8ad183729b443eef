"""Observations: one frozen dataclass for each kind.

Lengths are in metres, angles in radians, image coordinates in the units of the camera.
``sigma`` is a standard deviation in the unit of the value, or a `StandardDeviation` of several
parts. `Observation` has the fields of all of them, ``id`` and ``source``; `VectorObservation` and
`AxesObservation` have those of observations of several components.

`register_observation` adds a user's own kind. This package also exports the classes of points,
photos, cameras and other unknowns, to which observations refer by name.
"""

from ..entities import Camera, Parameter, Photo, Point
from ..stochastic_model import StandardDeviation
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
from .base import AxesObservation, Observation, Sight, VectorObservation
from .built_in_kinds import BUILT_IN, FOUND_IN_MODULES
from .correlated_observations import AnyObservation, Correlated, gauss_markov
from .frame_observations import (
    FrameCoordinate,
    FrameDirection,
    FrameDistance,
    FrameInclination,
    FrameRoll,
    FrameVector,
    FrameZenith,
    StripCoordinate,
    UnitVector,
    WireReading,
    WireReadingOnBody,
)
from .image import ImagePoint
from .offsets import (
    HydrostaticReading,
    LineOffset,
    PlaneOffset,
    PlumbOffset,
    RadialOffset,
    SightOffset,
    SightPlaneOffset,
)
from .positions import ControlPoint, GnssPosition, GnssVector, PhotoPosition
from .registry import KINDS, ObservationKind, Unit, observation_kind, register_observation
from .relations import (
    AxisAngle,
    CoordinateDifference,
    EqualDistance,
    EqualHeightDifference,
    ImageLine,
    ParallelAxes,
    PlaneDistance,
    PointDirection,
    RightAngle,
)
from .relative_poses import RelativePosition, RelativeRotation
from .shape_points import (
    OnCircle,
    OnCone,
    OnCylinder,
    OnLine,
    OnParaboloid,
    OnPlane,
    OnSphere,
    OnTorus,
)
from .surface_heights import LevelHeight, ProfileHeight
from .terrestrial_observations import (
    AstronomicLatitude,
    AstronomicLongitude,
    Azimuth,
    Direction,
    GyroAzimuth,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    SlopeDistance,
    VerticalAngle,
    ZenithAngle,
)
from .variances import Weight

__all__ = [
    "BUILT_IN",
    "KINDS",
    "AntennaVector",
    "AnyObservation",
    "AstronomicLatitude",
    "AstronomicLongitude",
    "AxesObservation",
    "AxisAngle",
    "Azimuth",
    "Camera",
    "ControlPoint",
    "CoordinateDifference",
    "Correlated",
    "Direction",
    "EqualDistance",
    "EqualHeightDifference",
    "FrameCoordinate",
    "FrameDirection",
    "FrameDistance",
    "FrameInclination",
    "FrameRoll",
    "FrameVector",
    "FrameZenith",
    "GnssPosition",
    "GnssVector",
    "GyroAzimuth",
    "HeightDifference",
    "HorizontalAngle",
    "HorizontalDistance",
    "HydrostaticReading",
    "ImageLine",
    "ImagePoint",
    "LevelHeight",
    "LineOffset",
    "NavigationAttitude",
    "Observation",
    "ObservationKind",
    "OnCircle",
    "OnCone",
    "OnCylinder",
    "OnLine",
    "OnParaboloid",
    "OnPlane",
    "OnSphere",
    "OnTorus",
    "ParallelAxes",
    "Parameter",
    "Photo",
    "PhotoAngle",
    "PhotoAttitude",
    "PhotoBase",
    "PhotoPosition",
    "PhotoRange",
    "PhotoSight",
    "PhotoTilt",
    "PlaneDistance",
    "PlaneOffset",
    "PlumbOffset",
    "Point",
    "PointDirection",
    "ProfileHeight",
    "RadialOffset",
    "RelativePosition",
    "RelativeRotation",
    "RightAngle",
    "Sight",
    "SightOffset",
    "SightPlaneOffset",
    "SlopeDistance",
    "StandardDeviation",
    "StripCoordinate",
    "Unit",
    "UnitVector",
    "VectorObservation",
    "VerticalAngle",
    "Weight",
    "WireReading",
    "WireReadingOnBody",
    "ZenithAngle",
    "gauss_markov",
    "observation_kind",
    "register_observation",
]

# Classes whose modules state their records themselves; type checkers find them in these modules.
_found = {kind.observation.__name__: kind.observation for kind in FOUND_IN_MODULES}
globals().update(_found)
__all__ += sorted(_found)
