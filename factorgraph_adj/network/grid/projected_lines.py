"""Lines in a projection and on the ellipsoid: bearing against azimuth, grid distance against arc.

    α = t + γ − (t − T)          s = S / k

t and S are bearing and length of the straight line between two places of the grid, α and s azimuth
and arc between them on the ellipsoid. Both are computed at the places themselves, so that the
curvature of the projected line (t − T) and the mean scale along it are those of the projection,
whatever it is. 1 m in the places changes α − t by 0.03″ tan φ.
"""

from __future__ import annotations

import math

import numpy as np

from ...frames import Frame
from ...observations.ellipsoidal_observations import ellipsoid_distance, geodetic_azimuth
from ...types import Array


def turn_of_line(frame: Frame, xyz: Array, grid: Array) -> float:
    """Return α − t, convergence and t − T together, radians.

    Args:
        frame: the frame on the Earth.
        xyz: coordinates of both ends in the frame, (2, 3) metres.
        grid: their easting, northing, height, (2, 3) metres.
    """
    none, flat = np.zeros(1), np.zeros((1, 2))
    found = geodetic_azimuth(
        *(frame, xyz[:1], flat, xyz[1:], flat),
        observed=np.zeros((1, 1)),
        instrument_height=none,
        target_height=none,
    )
    east, north, _ = (grid[1] - grid[0]).tolist()
    return float(found.residual[0, 0]) - math.atan2(east, north)


def scale_of_line(frame: Frame, xyz: Array, grid: Array) -> float:
    """Return S/s, the mean scale of the projection along a line.

    Args:
        frame: as in `turn_of_line`.
        xyz: as there.
        grid: as there.
    """
    east, north, _ = (grid[1] - grid[0]).tolist()
    return math.hypot(east, north) / arc(frame, xyz)


def arc(frame: Frame, xyz: Array, surfaces: tuple[float, float] = (0.0, 0.0)) -> float:
    """Return the arc between places, metres: on the ellipsoid, or at surfaces above it.

    Args:
        frame: as in `turn_of_line`.
        xyz: as there.
        surfaces: height of the surface above the ellipsoid at both ends, metres.
    """
    found = ellipsoid_distance(
        *(frame, xyz[:1], xyz[1:], np.zeros((1, 2))),
        observed=np.zeros((1, 1)),
        along_chord=np.zeros(1),
        station_surface=np.array(surfaces[:1]),
        target_surface=np.array(surfaces[1:]),
    )
    return float(found.residual[0, 0])
