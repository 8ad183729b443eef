"""Terrestrial models: distances, directions, angles, azimuths, levelling, astronomic Φ, Λ; faces.

The page docs/reference/observation_equations.md has the formulas.

Each function takes the variables it touches as arrays (n, …), the observed values (n, 1) and
constants, and returns v = computed − observed with partials in the order of the variables.
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, require, wrap
from .line_of_sight import Sights, sight

NO_LENGTH = "station and target coincide: the sight has no length"
NO_AZIMUTH = "the sight is vertical: it has no azimuth"
SECOND = 2
"""Number of the face in which the telescope has been plunged."""
_SHORTEST = 1e-9
"""Smallest length of a sight, metres; shorter sights are degenerate."""
_STEEPEST = 1e-9
"""Smallest ratio of horizontal part to length at which a sight has an azimuth."""


def _length(q: Array) -> Array:
    s: Array = np.sqrt(np.sum(q * q, axis=1))
    require(s > _SHORTEST, NO_LENGTH)
    return s


def _horizontal(q: Array) -> Array:
    s = _length(q)
    h = np.hypot(q[:, 0], q[:, 1])
    require(h > _STEEPEST * s, NO_AZIMUTH)
    return h


def _azimuth(q: Array) -> tuple[Array, Array]:
    """Return α = atan2(q_e, q_n) (n,) and ∂α/∂q (n, 3)."""
    h2 = _horizontal(q) ** 2
    gradient = np.stack([q[:, 1] / h2, -q[:, 0] / h2, np.zeros_like(h2)], 1)
    return np.arctan2(q[:, 0], q[:, 1]), gradient


def direction_in_face_one(reading: Array, face: Array) -> Array:
    """Return horizontal readings (n,) as in face 1: those of face 2 less π, radians."""
    return np.where(face == SECOND, reading - np.pi, reading)


def zenith_in_face_one(reading: Array, face: Array) -> Array:
    """Return zenith readings (n,) as in face 1: those of face 2 taken from 2π, radians."""
    return np.where(face == SECOND, 2.0 * np.pi - reading, reading)


def _meter(length: Array, edm: Array) -> Array:
    """Return the reading of a distance meter, (1 + m) S + zero."""
    return (1.0 + edm[:, 0]) * length + edm[:, 1]


def _with_meter(
    sights: Sights, length: Array, gradient: Array, edm: Array, observed: Array
) -> Linearised:
    v = _meter(length, edm)[:, None] - observed
    scaled = (1.0 + edm[:, :1]) * gradient
    by_edm = np.stack([length, np.ones_like(length)], 1)[:, None, :]
    return Linearised(v, (*sights.chain(scaled), by_edm))


def slope_distance(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    edm: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute (1 + m) S + zero − observed, metres; ∂S/∂q = q/S. Eq. 4."""
    s = sight(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        instrument_height,
        target_height,
    )
    length = _length(s.q)
    return _with_meter(s, length, s.q / length[:, None], edm, observed)


def horizontal_distance(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    edm: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute (1 + m) hypot(q_e, q_n) + zero − observed, metres."""
    s = sight(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        instrument_height,
        target_height,
    )
    length = _horizontal(s.q)
    gradient = s.q * np.array([1.0, 1.0, 0.0]) / length[:, None]
    return _with_meter(s, length, gradient, edm, observed)


def vertical_angle(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    refraction: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute β + κ S cosβ / 2R − observed, radians, with S cosβ = hypot(q_e, q_n). Eq. 5.

    A refracted ray makes the observed vertical angle too large, hence the plus sign.
    """
    s = sight(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        instrument_height,
        target_height,
    )
    q = s.q
    h = _horizontal(q)
    length2 = h * h + q[:, 2] ** 2
    bend = h / (2.0 * frame.radius)
    kappa = refraction[:, 0]
    v = np.arctan2(q[:, 2], h) + kappa * bend - observed[:, 0]
    along = -q[:, 2] / length2 + kappa / (2.0 * frame.radius)
    gradient = np.stack([along * q[:, 0] / h, along * q[:, 1] / h, h / length2], 1)
    return Linearised(wrap(v)[:, None], (*s.chain(gradient), bend[:, None, None]))


def zenith_angle(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    refraction: Array,
    index_error: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
    face: Array,
) -> Linearised:
    """Compute the reading of the vertical circle − observed, radians.

    With z = π/2 − (β + κ S cosβ / 2R) the reading is z + i in face 1 and 2π − z + i in face 2.
    """
    second = face == SECOND
    side = np.where(second, -1.0, 1.0)  # of z in the reading
    up = vertical_angle(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        refraction,
        # π/2 − z of the reading without its index error
        observed=np.pi / 2 - zenith_in_face_one(observed - index_error, face[:, None]),
        instrument_height=instrument_height,
        target_height=target_height,
    )
    sign = -side[:, None]
    by_index = np.ones((len(observed), 1, 1))
    return Linearised(sign * up.residual, (*(sign[:, :, None] * j for j in up.jacobians), by_index))


def azimuth(
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
    """Compute α − observed, radians. Eq. 9."""
    s = sight(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        instrument_height,
        target_height,
    )
    alpha, gradient = _azimuth(s.q)
    return Linearised(wrap(alpha - observed[:, 0])[:, None], s.chain(gradient))


def gyro_azimuth(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    gyro: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute α − E − observed, radians; E is the constant of the instrument. FRAMES F8.7."""
    found = azimuth(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        observed=observed + gyro,
        instrument_height=instrument_height,
        target_height=target_height,
    )
    by_gyro = np.full((len(observed), 1, 1), -1.0)
    return Linearised(found.residual, (*found.jacobians, by_gyro))


def direction(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    orientation: Array,
    collimation_error: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
    face: Array,
) -> Linearised:
    """Compute the reading of the horizontal circle − observed, radians. Eq. 8.

    The reading is α − orientation − c/sin z in face 1 and α − orientation + c/sin z + π in face 2,
    with 1/sin z = S/hypot(q_e, q_n) of the straight sight.
    """
    s = sight(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        instrument_height,
        target_height,
    )
    alpha, gradient = _azimuth(s.q)
    length, level = _length(s.q), _horizontal(s.q)
    steep = length / level
    side = np.where(face == SECOND, 1.0, -1.0)
    c = collimation_error[:, 0]
    if np.any(c):
        # ∂(S/h)/∂q = q/(S h) − S (q_e, q_n, 0)/h³
        bent = s.q / (length * level)[:, None]
        bent[:, :2] -= s.q[:, :2] * (steep / level**2)[:, None]
        gradient = gradient + (side * c)[:, None] * bent
    turned = direction_in_face_one(observed[:, 0], face)
    v = wrap(alpha + side * c * steep - orientation[:, 0] - turned)
    n = len(observed)
    by_orientation, by_collimation = np.full((n, 1, 1), -1.0), (side * steep)[:, None, None]
    return Linearised(v[:, None], (*s.chain(gradient), by_orientation, by_collimation))


def horizontal_angle(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    target2: Array,
    target2_vertical: Array,
    *,
    observed: Array,
    instrument_height: Array,
    target_height: Array,
    target2_height: Array,
) -> Linearised:
    """Compute α_ik − α_ij − observed, radians, clockwise from target j to target2 k."""
    back = azimuth(
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        observed=np.zeros_like(observed),
        instrument_height=instrument_height,
        target_height=target_height,
    )
    fore = azimuth(
        frame,
        station,
        station_vertical,
        target2,
        target2_vertical,
        observed=observed,
        instrument_height=instrument_height,
        target_height=target2_height,
    )
    bi, bv, bj, bw = back.jacobians
    fi, fv, fk, fw = fore.jacobians
    return Linearised(wrap(fore.residual - back.residual), (fi - bi, fv - bv, -bj, -bw, fk, fw))


def height_difference(
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
    """Compute ½ (u_i + u_j)·d − observed, metres: the exact counterpart of eq. 10.

    Eq. 10's ½ S (β_ij − β_ji) is the approximation for small angles.
    """
    arguments = (
        frame,
        station,
        station_vertical,
        target,
        target_vertical,
        instrument_height,
        target_height,
    )
    here, there = sight(*arguments), sight(*arguments, reverse=True)
    v = 0.5 * (here.q[:, 2:] + there.q[:, 2:]) - observed
    up = np.tile([0.0, 0.0, 0.5], (len(v), 1))
    return Linearised(v, tuple(a + b for a, b in zip(here.chain(up), there.chain(up), strict=True)))


def astronomic_latitude(
    frame: Frame, station: Array, vertical: Array, *, observed: Array
) -> Linearised:
    """Compute Φ − observed, radians. Eq. 12."""
    return _astronomic(frame, station, vertical, observed, 0)


def astronomic_longitude(
    frame: Frame, station: Array, vertical: Array, *, observed: Array
) -> Linearised:
    """Compute Λ − observed, radians. Eq. 11."""
    return _astronomic(frame, station, vertical, observed, 1)


def _astronomic(
    frame: Frame, station: Array, vertical: Array, observed: Array, which: int
) -> Linearised:
    basis = frame.basis(station, vertical)
    v = wrap(basis.angles[:, which] - observed[:, 0])[:, None]
    row = slice(which, which + 1)
    return Linearised(v, (basis.angles_by_position[:, row], basis.angles_by_vertical[:, row]))
