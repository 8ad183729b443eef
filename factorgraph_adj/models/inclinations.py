"""Inclinometers and directions measured in the axes of an instrument (FRAMES F8.5, F13).

    g = Bᵀ Rᵀ E u(P)          r = Bᵀ Rᵀ E (X_j − X_i)

g is the vertical at the instrument, r the line from its station to a target, in the axes of an
instrument that is mounted (B) on a body whose frame has R and E, see `directions`.
"""

from __future__ import annotations

import numpy as np

from ..frames import Frame
from ..types import Array
from .base import Linearised, require, wrap
from .directions import (
    Verticals,
    direction_in_frame,
    in_instrument,
    of_those_there,
    vertical_in_frame,
)

ON_ITS_SIDE = "the axis of the inclinometer is vertical: its reading has no direction"
NO_LENGTH = "station and target coincide: the sight has no length"
_LEAST = 1e-9
"""Smallest part of the vertical in the plane of an inclinometer, and smallest length, metres."""


def _inclined(
    there: Verticals,
    by_mount: Array,
    to_instrument: Array,
    v: Array,
    gradient: Array,
    origin: Array | None,
    vertical: Array | None,
) -> Linearised:
    """Return wrapped residuals (n,) with their partials, from those by g (n, 3)."""
    g = gradient[:, None, :]
    in_carrier = g @ to_instrument
    every = [
        in_carrier @ there.by_frame,
        in_carrier @ there.by_place,
        in_carrier @ there.by_deflection,
        g @ by_mount,
    ]
    every += of_those_there(
        ((origin, in_carrier @ there.by_origin), (vertical, in_carrier @ there.by_vertical))
    )
    return Linearised(wrap(v)[:, None], tuple(every))


def frame_inclination(
    frame: Frame,
    stored: Array,
    point: Array,
    deflection: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute asin g_x − observed, radians: how much the x axis rises above the horizon.

    ∂/∂g = (√(1 − g_x²), −g_x g_y/√…, −g_x g_z/√…), along the unit sphere. LGC2 INCLY.
    """
    there = vertical_in_frame(frame, stored, point, deflection, origin, vertical)
    g, by_mount, to_instrument = in_instrument(mount, there.g)
    level = np.hypot(g[:, 1], g[:, 2])
    require(level > _LEAST, ON_ITS_SIDE)
    gradient = -g[:, :1] * g / level[:, None]
    gradient[:, 0] = level
    v = np.arctan2(g[:, 0], level) - observed[:, 0]
    return _inclined(there, by_mount, to_instrument, v, gradient, origin, vertical)


def frame_roll(
    frame: Frame,
    stored: Array,
    point: Array,
    deflection: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute atan2(g_x, g_z) − observed, radians: the turn about the y axis.

    ∂/∂g = (g_z, 0, −g_x)/(g_x² + g_z²). LGC2 ROLLY.
    """
    there = vertical_in_frame(frame, stored, point, deflection, origin, vertical)
    g, by_mount, to_instrument = in_instrument(mount, there.g)
    square = g[:, 0] ** 2 + g[:, 2] ** 2
    require(square > _LEAST**2, ON_ITS_SIDE)
    gradient = np.stack([g[:, 2], np.zeros(len(g)), -g[:, 0]], 1) / square[:, None]
    v = np.arctan2(g[:, 0], g[:, 2]) - observed[:, 0]
    return _inclined(there, by_mount, to_instrument, v, gradient, origin, vertical)


def unit_vector(
    frame: Frame,
    stored: Array,
    station: Array,
    target: Array,
    mount: Array,
    origin: Array | None,
    vertical: Array | None,
    *,
    observed: Array,
) -> Linearised:
    """Compute the x and y components of r/|r| less the observed ones, radians, (n, 2).

    ∂(r/|r|)/∂r = (I − r̂ r̂ᵀ)/|r|. LGC2 UVEC.
    """
    there = direction_in_frame(frame, stored, target - station, station, origin, vertical)
    r, by_mount, to_instrument = in_instrument(mount, there.g)
    length = np.linalg.norm(r, axis=1)
    require(length > _LEAST, NO_LENGTH)
    unit = r / length[:, None]
    across = np.eye(3) - unit[:, :, None] * unit[:, None, :]
    g = (across / length[:, None, None])[:, :2]
    in_carrier = g @ to_instrument
    by_target = in_carrier @ there.by_vector
    every = [in_carrier @ there.by_frame, -by_target, by_target, g @ by_mount]
    every += of_those_there(
        ((origin, in_carrier @ there.by_origin), (vertical, in_carrier @ there.by_vertical))
    )
    return Linearised(unit[:, :2] - observed, tuple(every))
