"""Moving points: targets on a trajectory, and images of radar along the track of their sensor.

A moving point has the place X at the time zero, and a motion, an unknown with the velocity V and
the coefficient Q of t², half an acceleration, in the axes of the network. At the time t it is at

    X(t) = X + V t + Q t² − ½ g t² u

with the upward direction u at X, and the gravity g of free fall: 0 for what flies evenly (FRAMES
F19.3). Every place in which it was observed is a point of its own, which a `MovedPoint` ties to it,
so that all kinds of observations observe a target in flight.

A radar image measures for each point the time at which the sensor saw it, its slant range and its
Doppler frequency (F19.1; F. Leberl, Radargrammetric image processing, Norwood 1990). With
d = X − S(t), and the velocity V(t) = V + 2 Q t of the sensor:

| kind | computed value |
| --- | --- |
| radar range | |d| |
| radar squint | arcsin(d·V(t)/(|d| |V(t)|)), 0 for zero Doppler |

The Doppler frequency f of a wavelength λ is 2 |V| sin(squint)/λ.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, field
from typing import ClassVar

import numpy as np

from ..frames import Frame
from ..models.base import Linearised, require
from ..models.datum_motions import Motions
from ..models.line_of_sight import up_by_angles
from ..models.unknown_registry import Component, UnknownKind, UnknownTable
from ..rotation import skew
from ..types import Array, Index
from .base import Observation, VectorObservation
from .registry import ObservationKind


@dataclass(frozen=True)
class MovedPoint(VectorObservation):
    """Place of a moving point at a time less that of its motion, metres; 0 on the trajectory.

    X_moved − (X + V t + Q t² − ½ g t² u); metres, axes of the network. Its standard deviations
    say by how much the target may leave the trajectory.
    """

    kind: ClassVar[str] = "moved_point"
    components: ClassVar[tuple[str, ...]] = ("x", "y", "z")
    point: str
    """The moving point, whose coordinates are those at the time zero."""
    moved: str
    """Point that is its place at the time t."""
    value: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Observed difference, metres."""
    _: KW_ONLY
    sigma: tuple[float, float, float] | None = None
    """Standard deviations, metres; None if ``covariance`` is given."""
    motion: str
    """Its motion, an unknown of kind ``point_motion``."""
    time: float = field(metadata={"quantity": "number"})
    """Time t, seconds."""
    gravity: float = field(default=0.0, metadata={"quantity": "number"})
    """Gravity g of free fall, m/s²; 0 for a point that does not fall."""


@dataclass(frozen=True)
class _RadarImage(Observation):
    """Base of what an image of radar measures of a point."""

    sensor: str
    """Moving point that is the sensor at the time zero."""
    target: str
    """Point that is seen."""
    value: float
    """The reading."""
    _: KW_ONLY
    sigma: float
    """Standard deviation."""
    motion: str
    """Motion of the sensor, an unknown of kind ``point_motion``."""
    time: float = field(metadata={"quantity": "number"})
    """Time t at which the sensor saw the point, seconds."""


@dataclass(frozen=True)
class RadarRange(_RadarImage):
    """Slant range from a moving sensor to a point, at the time at which it was seen; metres."""

    kind: ClassVar[str] = "radar_range"
    nonnegative: ClassVar[bool] = True


@dataclass(frozen=True)
class RadarSquint(_RadarImage):
    """Angle of a point ahead of the plane across the velocity of a sensor; radians.

    It is 0 in images of zero Doppler. A Doppler frequency f is the angle arcsin(λ f/(2 |V|)).
    """

    kind: ClassVar[str] = "radar_squint"


def moved_point(
    frame: Frame,
    point: Array,
    moved: Array,
    motion: Array,
    *,
    observed: Array,
    time: Array,
    gravity: Array,
) -> Linearised:
    """Compute X_moved − (X + V t + Q t² − ½ g t² u) − observed, metres, (n, 3).

    Args:
        frame: frame of the network.
        point: X, (n, 3).
        moved: X_moved, (n, 3).
        motion: V and Q, (n, 6).
        observed: differences, (n, 3).
        time: t, (n,) seconds.
        gravity: g, (n,) metres per second².
    """
    t, square = time[:, None], time[:, None] ** 2
    basis = frame.basis(point, np.zeros((len(point), 2)))
    fallen = 0.5 * square * gravity[:, None]
    v = moved - point - t * motion[:, :3] - square * motion[:, 3:] + fallen * basis.enu[:, 2]
    eye = np.broadcast_to(np.eye(3), (len(v), 3, 3))
    turned = up_by_angles(basis) @ basis.angles_by_position
    by_point = fallen[:, :, None] * turned - eye
    by_motion = -np.concatenate([t[:, :, None] * eye, square[:, :, None] * eye], axis=2)
    return Linearised(v - observed, (by_point, eye, by_motion))


def _seen(sensor: Array, target: Array, motion: Array, time: Array) -> tuple[Array, Array]:
    """Return d = X − S(t) (n, 3) and |d| (n, 1), metres.

    Raises:
        DegenerateError: the sensor is at the point.
    """
    t = time[:, None]
    d = target - sensor - t * motion[:, :3] - t * t * motion[:, 3:]
    length = np.linalg.norm(d, axis=1, keepdims=True)
    require(length[:, 0] > 0.0, "the sensor is at the point: its range has no direction")
    return d, length


def _by_variables(by_d: Array, by_velocity: Array, time: Array) -> tuple[Array, ...]:
    """Return the partials by S, X and the motion from those by d and V(t), (n, 3) each."""
    t = time[:, None]
    by_motion = [by_velocity - t * by_d, 2.0 * t * by_velocity - t * t * by_d]
    return -by_d[:, None], by_d[:, None], np.concatenate(by_motion, axis=1)[:, None]


def radar_range(
    frame: Frame, sensor: Array, target: Array, motion: Array, *, observed: Array, time: Array
) -> Linearised:
    """Compute |X − S(t)| − observed, metres, (n, 1).

    Args:
        frame: not used.
        sensor: S at the time zero, (n, 3).
        target: X, (n, 3).
        motion: V and Q of the sensor, (n, 6).
        observed: slant ranges, (n, 1).
        time: t, (n,) seconds.
    """
    d, length = _seen(sensor, target, motion, time)
    return Linearised(length - observed, _by_variables(d / length, np.zeros_like(d), time))


def radar_squint(
    frame: Frame, sensor: Array, target: Array, motion: Array, *, observed: Array, time: Array
) -> Linearised:
    """Compute arcsin(d·V(t)/(|d| |V(t)|)) − observed, radians, (n, 1); arguments as `radar_range`.

    With e = d/|d|, n = V/|V| and s = e·n the partials of s are (n − s e)/|d| by d and (e − s n)/|V|
    by V; those of the angle are larger by 1/√(1 − s²).
    """
    d, length = _seen(sensor, target, motion, time)
    velocity = motion[:, :3] + 2.0 * time[:, None] * motion[:, 3:]
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    require(speed[:, 0] > 0.0, "the sensor stands still: its motion has no direction")
    e, n = d / length, velocity / speed
    s = np.einsum("ni,ni->n", e, n)[:, None]
    root = np.sqrt(np.maximum(1.0 - s * s, 0.0))
    require(root[:, 0] > 1e-9, "the point lies on the track of the sensor: its squint is 90°")
    by_d, by_velocity = (n - s * e) / (length * root), (e - s * n) / (speed * root)
    return Linearised(np.arcsin(s) - observed, _by_variables(by_d, by_velocity, time))


def of_point_motions(motions: Motions, values: Array, at: Index) -> Array:
    """Return the motions of velocities and terms of t²: they turn and scale with the object."""
    out = np.zeros((len(values), 6, 7))
    for first in (0, 3):
        part = values[:, first : first + 3]
        out[:, first : first + 3, 3:6] = -skew(part) / motions.size
        out[:, first : first + 3, 6] = part / motions.size
    return out


UNKNOWNS_IN_MODULE = (
    UnknownKind(
        "point_motion",
        "motion of moving point",
        "V",
        tuple(
            Component(a + "_" + "t" * power, "length", whole=True, power=power, time="s")
            for power in (1, 2)
            for a in "xyz"
        ),
        short="motion of point",
        motions=of_point_motions,
        connects=True,
        late=2,
        table=UnknownTable("point_motions", held_unless_free=True),
        remedy=(
            "a velocity needs observations at two times, a term of t² at three: hold it where "
            "it is 0 or known"
        ),
        titles={"de": "Bewegung eines Punkts"},
    ),
)
"""The record of the unknown."""
_RADAR = (("point", "sensor"), ("point", "target"), ("point_motion", "motion"))
KINDS_IN_MODULE = (
    ObservationKind(
        MovedPoint,
        (("point", "point"), ("point", "moved"), ("point_motion", "motion")),
        moved_point,
        ("time", "gravity"),
        linear=True,
        titles={"de": "Ort eines bewegten Punkts"},
    ),
    ObservationKind(
        RadarRange,
        _RADAR,
        radar_range,
        ("time",),
        titles={"de": "Schrägentfernung (Radar)"},
    ),
    ObservationKind(
        RadarSquint,
        _RADAR,
        radar_squint,
        ("time",),
        unit="rad",
        titles={"de": "Schielwinkel (Radar)"},
    ),
)
"""The records."""
