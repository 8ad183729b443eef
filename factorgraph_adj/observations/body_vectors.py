"""Vectors in the axes of a moving body, and turns of it: landmarks, and odometry in plan."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

from ..models import body_vectors, datum_motions
from ..models.unknown_registry import Component, UnknownKind, UnknownTable
from .base import Observation, VectorObservation
from .registry import ObservationKind
from .relative_poses import RELATIVE_POSE


@dataclass(frozen=True)
class BodyVector(VectorObservation):
    """Vector from the projection centre, or the origin of a body, to a point, R' (X − X₀); metres.

    It is in photogrammetric axes: x right, y up, z backwards. Use it for a landmark seen by a lidar
    or stereo sensor, or in a pose graph. For a robot, its axes are taken as x, y, z.
    """

    kind: ClassVar[str] = "body_vector"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    photo: str
    """Photo that is the body."""
    point: str
    """The point."""
    value: tuple[float, float, float]
    """Observed vector, metres."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, metres; None if ``covariance`` is given."""


@dataclass(frozen=True)
class PlanarVector(VectorObservation):
    """Horizontal vector to a point in the axes of a vehicle at a station: ahead, left; metres.

    Left is positive. The vehicle stands level; the azimuth of its forward axis, clockwise from
    north, is the heading of the station: state it first, ``set_unknown("heading", station)``.
    """

    kind: ClassVar[str] = "planar_vector"
    components: ClassVar[tuple[str, ...]] = ("ahead", "left")
    station: str
    """Point at which the vehicle stands."""
    target: str
    """Point that is seen, or reached."""
    value: tuple[float, float]
    """Observed vector, metres."""
    _: KW_ONLY
    sigma: tuple[float, float] | None = None
    """Standard deviations, metres; None if ``covariance`` is given."""


@dataclass(frozen=True)
class HeadingDifference(Observation):
    """Turn of a vehicle between two stations: heading(target) − heading(station); radians.

    Clockwise is positive, the opposite sign to the angle θ of robotics. The headings are stated
    first, ``set_unknown("heading", station)``.
    """

    kind: ClassVar[str] = "heading_difference"
    station: str
    """First station."""
    target: str
    """Second station."""
    value: float
    """Observed turn, radians, clockwise."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, radians."""

    def _check(self) -> None:
        super()._check()
        if self.station == self.target:
            self._fail("station and target are the same: a turn is between two stations")


UNKNOWNS_IN_MODULE = (
    UnknownKind(
        "heading",
        "heading of vehicle",
        "H",
        (Component("azimuth", "angle", column="value", circular=True, planned=0.0),),
        short="heading",
        motions=datum_motions.of_orientations,
        connects=True,
        at_point=True,
        table=UnknownTable("headings", ("station",)),
        titles={"de": "Kurs"},
    ),
)
"""Azimuth of the forward axis of a vehicle that stands level at a point, clockwise from north."""
KINDS_IN_MODULE = (
    ObservationKind(
        BodyVector,
        (("pose", "photo"), ("point", "point")),
        body_vectors.body_vector,
        titles={"de": "Punkt im Körpersystem"},
    ),
    ObservationKind(
        PlanarVector,
        (
            ("point", "station"),
            ("vertical", "station"),
            ("point", "target"),
            ("vertical", "target"),
            ("heading", "station"),
        ),
        body_vectors.planar_vector,
        linear=True,
        part_of=RELATIVE_POSE,
        titles={"de": "ebener Vektor im Fahrzeugsystem"},
    ),
    ObservationKind(
        HeadingDifference,
        (
            ("point", "station"),
            ("point", "target"),
            ("heading", "station"),
            ("heading", "target"),
        ),
        body_vectors.heading_difference,
        unit="rad",
        linear=True,
        part_of=RELATIVE_POSE,
        titles={"de": "Kursdifferenz"},
    ),
)
"""The records."""
