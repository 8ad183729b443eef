"""Offsets read on a scale: from planes, plumb lines, lines, sights and water (FRAMES F13).

Each function takes the variables it touches as arrays (n, …), the observed values (n, 1) and
constants, and returns v = computed − observed, metres, with partials in the order of the variables.
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, NoDirectionError, require
from .directions import of_those_there, split_mount
from .heights import MOUNT_COMPONENTS, heights
from .line_of_sight import Sights, sight
from .sub_frame import InFrame, in_frame

NO_OFFSET = "the point lies on the line: its offset has no direction"
NO_LINE = "the two points of the line coincide"
_SHORTEST = 1e-9
"""Smallest offset from a line, and smallest length of a line, metres."""


def _of_q(
    there: InFrame, v: Array, gradient: Array, origin: Array | None, vertical: Array | None
) -> Linearised:
    """Return v (n,) with its partials, from those by q (n, 3)."""
    g = gradient[:, None, :]
    at_origin = of_those_there(((origin, g @ there.by_origin), (vertical, g @ there.by_vertical)))
    return Linearised(v[:, None], (g @ there.by_frame, g @ there.by_place, *at_origin))


def plane_offset(
    frame: Frame,
    stored: Array,
    point: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute q_x − observed: the distance from the plane x = 0 of a frame. LGC2 ECHO."""
    there = in_frame(frame, stored, point, origin, vertical)
    along = np.broadcast_to([1.0, 0.0, 0.0], (len(point), 3))
    return _of_q(there, there.q[:, 0] - observed[:, 0], along, origin, vertical)


def plumb_offset(
    frame: Frame,
    stored: Array,
    point: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute ρ − observed, ρ = hypot(q_x, q_y): the distance from the z axis of a frame.

    ∂ρ/∂q = (q_x, q_y, 0)/ρ. LGC2 ECVE.
    """
    there = in_frame(frame, stored, point, origin, vertical)
    rho = np.hypot(there.q[:, 0], there.q[:, 1])
    require(rho > _SHORTEST, NO_OFFSET, NoDirectionError)
    away = there.q * np.array([1.0, 1.0, 0.0]) / rho[:, None]
    return _of_q(there, rho - observed[:, 0], away, origin, vertical)


def line_offset(
    frame: Frame, point: Array, start: Array, end: Array, *, observed: Array
) -> Linearised:
    """Compute |P − F| − observed: the distance from the straight line through A and B.

    F = A + t (B − A), t = (P − A)·(B − A)/|B − A|². With e = (P − F)/|P − F| the partials are
    e by P, −(1 − t) e by A and −t e by B. LGC2 ECSP.
    """
    line, away = end - start, point - start
    square = np.sum(line * line, axis=1)
    require(square > _SHORTEST**2, NO_LINE)
    t = (np.sum(away * line, axis=1) / square)[:, None]
    normal = away - t * line
    offset = np.linalg.norm(normal, axis=1)
    require(offset > _SHORTEST, NO_OFFSET, NoDirectionError)
    e = normal / offset[:, None]
    partials = tuple(j[:, None, :] for j in (e, -(1.0 - t) * e, -t * e))
    return Linearised(offset[:, None] - observed, partials)


def _sighted(s: Sights, v: Array, gradient: Array, by_orientation: Array) -> Linearised:
    return Linearised(v[:, None], (*s.chain(gradient), by_orientation[:, None, None]))


def sight_plane_offset(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    orientation: Array,
    *,
    observed: Array,
    horizontal: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute −cos α q_e + sin α q_n − observed, α = orientation + horizontal reading.

    The offset from the vertical plane of a theodolite is positive to the left of its sight.
    LGC2 ECTH.
    """
    s = sight(
        frame, station, station_vertical, target, target_vertical, instrument_height, target_height
    )
    alpha = orientation[:, 0] + horizontal
    left = np.stack([-np.cos(alpha), np.sin(alpha), np.zeros_like(alpha)], 1)
    forward = np.sin(alpha) * s.q[:, 0] + np.cos(alpha) * s.q[:, 1]
    v = np.sum(left * s.q, axis=1) - observed[:, 0]
    return _sighted(s, v, left, forward)


def sight_offset(
    frame: Frame,
    station: Array,
    station_vertical: Array,
    target: Array,
    target_vertical: Array,
    orientation: Array,
    *,
    observed: Array,
    horizontal: Array,
    zenith: Array,
    instrument_height: Array,
    target_height: Array,
) -> Linearised:
    """Compute |q − (l·q) l| − observed, l the unit vector of the theodolite's sight.

    l = (sin α sin ζ, cos α sin ζ, cos ζ), α = orientation + horizontal reading, ζ the zenith
    reading. With n = q − (l·q) l the partials are n/|n| by q and −(l·q) n·∂l/∂α / |n| by the
    orientation. LGC2 ECDIR.
    """
    s = sight(
        frame, station, station_vertical, target, target_vertical, instrument_height, target_height
    )
    alpha = orientation[:, 0] + horizontal
    line = np.stack(
        [np.sin(alpha) * np.sin(zenith), np.cos(alpha) * np.sin(zenith), np.cos(zenith)], 1
    )
    turned = np.stack(
        [np.cos(alpha) * np.sin(zenith), -np.sin(alpha) * np.sin(zenith), np.zeros_like(alpha)], 1
    )
    along = np.sum(line * s.q, axis=1)
    normal = s.q - along[:, None] * line
    offset = np.linalg.norm(normal, axis=1)
    require(offset > _SHORTEST, NO_OFFSET, NoDirectionError)
    away = normal / offset[:, None]
    return _sighted(s, offset - observed[:, 0], away, -along * np.sum(away * turned, axis=1))


def radial_offset(
    frame: Frame,
    point: Array,
    *,
    observed: Array,
    bearing: Array,
    reference_x: Array,
    reference_y: Array,
    reference_z: Array,
) -> Linearised:
    """Compute −cos β e·(X − X₀) + sin β n·(X − X₀) − observed, metres.

    e and n point east and north at the reference X₀: the offset of a point from the line through
    X₀ with the bearing β, positive to the left. LGC2 RADI.
    """
    reference = np.stack([reference_x, reference_y, reference_z], 1)
    enu = frame.basis(reference, np.zeros((len(reference), 2))).enu
    left = -np.cos(bearing)[:, None] * enu[:, 0] + np.sin(bearing)[:, None] * enu[:, 1]
    v = np.sum(left * (point - reference), axis=1)
    return Linearised(v[:, None] - observed, (left[:, None, :],))


def hydrostatic_reading(
    frame: Frame,
    point: Array,
    level: Array,
    mount: Array,
    *,
    observed: Array,
    undulation: Array,
    expansion: Array,
    side: Array,
) -> Linearised:
    """Compute side (w + N − h(P) − b_z)/(1 + α ΔT) − observed, metres.

    w is the height of the water, N the undulation of its surface at the sensor (geoid, tide), h(P)
    the height of the sensor's point, b_z the zero of the sensor above this point, α ΔT the relative
    expansion, side +1 for a sensor that reads upwards to the water and −1 for one that reads
    downwards. LGC2 ECWS.
    """
    height, up = heights(frame, point)
    factor = side / (1.0 + expansion)
    above = level[:, 0] + undulation - height - split_mount(mount)[1][:, 2]
    n = len(point)
    by_mount = np.zeros((n, 1, MOUNT_COMPONENTS))
    by_mount[:, 0, 5] = -factor
    return Linearised(
        (factor * above)[:, None] - observed,
        (-(factor[:, None] * up)[:, None, :], factor[:, None, None], by_mount),
    )
