"""Observations reduced to the ellipsoid or to the geoid: distances, azimuths, heights.

Programs of geodetic networks (DynAdjust, SNAP and others) state distances along the ellipsoid or
at sea level, azimuths of the ellipsoid and heights above the geoid. With the normal u of the
ellipsoid, the ellipsoidal height h and the height N of the surface above the ellipsoid, which the
observation has for each of its ends, the foot of a point on the surface is F = X − (h − N) u.

| kind | computed value |
| --- | --- |
| chord | length of F_j − F_i, c |
| arc | 2 r asin(c/2r), r = M ν/(ν cos²α + M sin²α) + ½ (N_i + N_j) |
| chord at the mean height | c with N_i = N_j = ½ (h_i + t_i + h_j + t_j), see below |
| geodetic azimuth | α of the sight in the horizon of the ellipsoid |
| height | h − N |
| height difference | (h_j − N_j) − (h_i − N_i) |

t are the heights of instrument and target. The radius r (Euler) belongs to the mean latitude and
the azimuth of the chord: the arc is that of the geodesic within 0.1 mm in 100 km. Deflections of
the vertical have no effect on any of them. In a local frame h is its height, and the arc that on a
sphere of its radius where it has curvature.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import ClassVar

import numpy as np

from ..frames import Frame, LocalFrame, TopocentricFrame
from ..models.base import Linearised, require
from ..models.line_of_sight import up_by_angles
from ..models.positions import heights
from ..models.terrestrial_observations import NO_LENGTH, azimuth
from ..types import Array
from .base import Observation, Sight, Sigma
from .registry import ObservationKind
from .variances import DIRECTIONS, LEVELLING, PLAIN_LENGTHS

ARC, CHORD = "arc", "chord"
_SHORTEST = 1e-9
"""Smallest length of a distance, metres; shorter ones are degenerate."""


@dataclass(frozen=True)
class EllipsoidDistance(Observation):
    """Distance between the footpoints of two points on the ellipsoid, or on a surface above it.

    The surface is at the given height above the ellipsoid at each end (geoid). Metres. Computed as
    (1 + m) s + z; s is the arc (``line="arc"``) or the chord, m and z the scale and zero constant
    of the distance meter.
    """

    kind: ClassVar[str] = "ellipsoid_distance"
    nonnegative: ClassVar[bool] = True
    station: str
    """First point, i."""
    target: str
    """Second point, j."""
    value: float
    """Observed distance, metres."""
    _: KW_ONLY
    sigma: Sigma
    """Standard deviation, metres, or its parts."""
    line: str = ARC
    """``arc`` along the surface, or ``chord`` through it."""
    station_surface: float = 0.0
    """Height N_i of the surface above the ellipsoid at the station, metres: 0 of the ellipsoid
    itself, the geoid undulation of sea level."""
    target_surface: float = 0.0
    """N_j at the target, metres."""
    instrument: str | None = None
    """Name of the distance meter, which has m and the zero constant; None: both are 0."""

    @property
    def along_chord(self) -> float:
        """1 for a chord, 0 for an arc."""
        return float(self.line == CHORD)

    def _check(self) -> None:
        super()._check()
        if self.line not in (ARC, CHORD):
            self._fail(f"line must be arc or chord, not {self.line!r}")


@dataclass(frozen=True)
class MeanHeightDistance(Sight):
    """Chord between the two verticals at the mean ellipsoidal height of instrument and target.

    Metres. Computed as (1 + m) c + z; c is the chord, m and z the scale and zero constant of the
    distance meter. For a rise Δh a `HorizontalDistance`, which is at the height of the target, is
    Δh·c/(2R) longer.
    """

    kind: ClassVar[str] = "mean_height_distance"
    nonnegative: ClassVar[bool] = True
    _: KW_ONLY
    instrument: str | None = None
    """Name of the distance meter, which has m and the zero constant; None: both are 0."""


@dataclass(frozen=True)
class GeodeticAzimuth(Sight):
    """Azimuth from north, clockwise, in the horizon of the ellipsoid, radians.

    Deflections of the vertical have no effect, as they have on an `Azimuth`, which is astronomic.
    """

    kind: ClassVar[str] = "geodetic_azimuth"


@dataclass(frozen=True)
class EllipsoidHeight(Observation):
    """Height of a point above the ellipsoid, or above the geoid, metres: h − N."""

    kind: ClassVar[str] = "ellipsoid_height"
    point: str
    """The point."""
    value: float
    """Observed height, metres."""
    _: KW_ONLY
    sigma: float
    """Standard deviation, metres."""
    surface: float = 0.0
    """Height N of the surface above the ellipsoid, metres: 0 of the ellipsoid itself, the geoid
    undulation of a height above the geoid."""


@dataclass(frozen=True)
class EllipsoidHeightDifference(Sight):
    """Difference of heights above the ellipsoid, or above the geoid, metres.

    (h_j + h_t − N_j) − (h_i + h_s − N_i). A `HeightDifference` is one along plumb lines.
    """

    kind: ClassVar[str] = "ellipsoid_height_difference"
    _: KW_ONLY
    station_surface: float = 0.0
    """Height N_i of the surface above the ellipsoid at the station, metres: 0 of the ellipsoid
    itself, the geoid undulation of heights above the geoid."""
    target_surface: float = 0.0
    """N_j at the target, metres."""
    length_km: float | None = None
    """Length of the levelled line, km, for `StandardDeviation.per_sqrt_km`; None: the
    horizontal distance."""


def foot(frame: Frame, position: Array, surface: Array) -> tuple[Array, Array, Array]:
    """Return the feet F = X − (h − N) u of points (n, 3), ∂F/∂X (n, 3, 3), and u = ∂F/∂N (n, 3).

    Args:
        frame: the frame.
        position: X, (n, 3) metres.
        surface: N, height of the surface above the ellipsoid, (n,) metres.
    """
    h, gradient = heights(frame, position)
    basis = frame.basis(position, np.zeros((len(position), 2)))
    up, above = basis.enu[:, 2], h - surface
    by_position = np.eye(3) - up[:, :, None] * gradient[:, None, :]
    turned = up_by_angles(basis) @ basis.angles_by_position
    by_position -= above[:, None, None] * turned
    return position - above[:, None] * up, by_position, up


def arc_radius(
    frame: Frame, start: Array, end: Array, surface: Array
) -> tuple[Array, Array, Array]:
    """Return the radius of curvature of the surface along chords, and its gradients.

    Euler's formula with the radii M and N of the middle, and n, e of the chord d:

        R = M N (n² + e²) / (N n² + M e²) + surface

    It is infinite in a flat local frame. The turn of north and east with the middle is neglected.

    Args:
        frame: the frame.
        start: first feet, (n, 3) metres.
        end: second feet, metres.
        surface: mean height of the surface above the ellipsoid, (n,) metres.

    Returns:
        R (n,) metres, ∂R/∂d and ∂R/∂middle (n, 3).
    """
    none = np.zeros_like(start)
    if isinstance(frame, LocalFrame):
        radius = np.full(len(start), frame.radius if frame.curvature else np.inf)
        return radius + surface, none, none
    middle = 0.5 * (start + end)
    basis = frame.basis(middle, np.zeros((len(middle), 2)))
    e_axis, n_axis = basis.enu[:, 0], basis.enu[:, 1]
    east, north = (np.sum(axis * (end - start), axis=1) for axis in (e_axis, n_axis))
    ellipsoid = (frame.geocentric if isinstance(frame, TopocentricFrame) else frame).ellipsoid
    m, v = ellipsoid.radii(basis.angles[:, 0])
    level, mixed = north**2 + east**2, v * north**2 + m * east**2
    own = m * v * level / mixed
    # ∂R/∂n and ∂R/∂e; M and N change with the latitude by 3 M k and N k.
    by_north = 2.0 * m * v * north * (mixed - v * level) / mixed**2
    by_east = 2.0 * m * v * east * (mixed - m * level) / mixed**2
    sine, cosine = basis.sin_latitude, basis.cos_latitude
    k = ellipsoid.e2 * sine * cosine / (1.0 - ellipsoid.e2 * sine**2)
    by_latitude = own * k * (4.0 - (v * north**2 + 3.0 * m * east**2) / mixed)
    by_chord = by_north[:, None] * n_axis + by_east[:, None] * e_axis
    return own + surface, by_chord, by_latitude[:, None] * basis.angles_by_position[:, 0]


def ellipsoid_distance(
    frame: Frame,
    station: Array,
    target: Array,
    edm: Array,
    *,
    observed: Array,
    along_chord: Array,
    station_surface: Array,
    target_surface: Array,
) -> Linearised:
    """Compute (1 + m) s + zero − observed, metres, with the arc or chord s.

    With b = c/2R the arc is s = 2 R arcsin b, ∂s/∂c = 1/√(1 − b²) and
    ∂s/∂R = 2 (arcsin b − b/√(1 − b²)).
    """
    start, by_station, _ = foot(frame, station, station_surface)
    end, by_target, _ = foot(frame, target, target_surface)
    d = end - start
    chord = np.sqrt(np.sum(d * d, axis=1))
    require(chord > _SHORTEST, NO_LENGTH)
    radius, by_chord, by_middle = arc_radius(
        frame, start, end, 0.5 * (station_surface + target_surface)
    )
    # 0 for a chord and for an infinite radius: then s = c
    bent = np.where(along_chord == 1.0, 0.0, 0.5 * chord / radius)
    require(bent < 1.0, "the chord is longer than the diameter of the Earth")
    root, angle = np.sqrt(1.0 - bent * bent), np.arcsin(bent)
    length = chord * np.where(bent > 0.0, angle / np.where(bent > 0.0, bent, 1.0), 1.0)
    scale = 1.0 + edm[:, :1]
    by_end = d / (chord * root)[:, None]
    by_radius = 2.0 * (angle - bent / root)[:, None]
    by_start = -by_end + by_radius * (0.5 * by_middle - by_chord)
    by_end = by_end + by_radius * (0.5 * by_middle + by_chord)
    v = scale * length[:, None] + edm[:, 1:2] - observed
    by_edm = np.stack([length, np.ones_like(length)], 1)[:, None, :]
    by_station = (scale * by_start)[:, None, :] @ by_station
    by_target = (scale * by_end)[:, None, :] @ by_target
    return Linearised(v, (by_station, by_target, by_edm))


def mean_height_distance(
    frame: Frame,
    station: Array,
    target: Array,
    edm: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute (1 + m) c + zero − observed, metres, at the height ½ (h_i + t_i + h_j + t_j)."""
    (h_i, by_place_i), (h_j, by_place_j) = heights(frame, station), heights(frame, target)
    level = 0.5 * (h_i + instrument_height + h_j + target_height)
    start, by_station, up_i = foot(frame, station, level)
    end, by_target, up_j = foot(frame, target, level)
    d = end - start
    chord = np.sqrt(np.sum(d * d, axis=1))
    require(chord > _SHORTEST, NO_LENGTH)
    e = d / chord[:, None]
    # ∂F/∂N = u, and N moves with half of the height of either end.
    raised = 0.5 * np.sum(e * (up_j - up_i), axis=1)[:, None]
    by_i = raised * by_place_i - np.einsum("nk,nkl->nl", e, by_station)
    by_j = raised * by_place_j + np.einsum("nk,nkl->nl", e, by_target)
    scale = 1.0 + edm[:, :1]
    v = scale * chord[:, None] + edm[:, 1:2] - observed
    by_edm = np.stack([chord, np.ones_like(chord)], 1)[:, None, :]
    return Linearised(v, ((scale * by_i)[:, None, :], (scale * by_j)[:, None, :], by_edm))


def geodetic_azimuth(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute α − observed, radians, in the horizon of the ellipsoid."""
    none = np.zeros_like(station_vertical)
    found = azimuth(
        frame,
        station,
        none,
        target,
        none,
        observed=observed,
        instrument_height=instrument_height,
        target_height=target_height,
    )
    by_station, unused, by_target, _ = found.jacobians
    return Linearised(found.residual, (by_station, 0.0 * unused, by_target, 0.0 * unused))


def ellipsoid_height(frame: Frame, point: Array, *, observed: Array, surface: Array) -> Linearised:
    """Compute h − N − observed, metres."""
    h, up = heights(frame, point)
    return Linearised((h - surface)[:, None] - observed, (up[:, None, :],))


def ellipsoid_height_difference(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
    station_surface: Array,
    target_surface: Array,
) -> Linearised:
    """Compute (h_j + h_t − N_j) − (h_i + h_s − N_i) − observed, metres."""
    (here, by_station), (there, by_target) = heights(frame, station), heights(frame, target)
    end, start = target_height - target_surface, instrument_height - station_surface
    v = (there - here + (end - start))[:, None] - observed
    none = np.zeros((len(v), 1, 2))
    return Linearised(v, (-by_station[:, None, :], none, by_target[:, None, :], none))


_ENDS = tuple((kind, end) for end in ("station", "target") for kind in ("point", "vertical"))
_HEIGHTS = ("instrument_height", "target_height")
_SURFACES = ("station_surface", "target_surface")
KINDS_IN_MODULE = (
    ObservationKind(
        EllipsoidDistance,
        (("point", "station"), ("point", "target"), ("edm", "instrument")),
        ellipsoid_distance,
        ("along_chord", *_SURFACES),
        weight=PLAIN_LENGTHS,
        choices=("line",),
        titles={"de": "Strecke am Ellipsoid"},
    ),
    ObservationKind(
        MeanHeightDistance,
        (("point", "station"), ("point", "target"), ("edm", "instrument")),
        mean_height_distance,
        _HEIGHTS,
        weight=PLAIN_LENGTHS,
        titles={"de": "Strecke in mittlerer Höhe"},
    ),
    ObservationKind(
        GeodeticAzimuth,
        _ENDS,
        geodetic_azimuth,
        _HEIGHTS,
        "rad",
        weight=DIRECTIONS,
        circular=True,
        fixes="direction",
        instrument="station",
        quantity="azimuth",
        titles={"de": "Geodätisches Azimut"},
    ),
    ObservationKind(
        EllipsoidHeight,
        (("point", "point"),),
        ellipsoid_height,
        ("surface",),
        linear=True,
        fixes="coordinates",
        titles={"de": "Höhe über dem Ellipsoid"},
    ),
    ObservationKind(
        EllipsoidHeightDifference,
        _ENDS,
        ellipsoid_height_difference,
        (*_HEIGHTS, *_SURFACES),
        weight=LEVELLING,
        linear=True,
        quantity="height difference",
        titles={"de": "Höhenunterschied über dem Ellipsoid"},
    ),
)
"""Records of the kinds."""
