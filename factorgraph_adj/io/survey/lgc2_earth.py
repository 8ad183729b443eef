"""The earth of LGC2: a plane, a sphere, or an ellipsoid with the paraboloid of 1985 as geoid.

X and Y are those of the cartesian system of CERN; the third coordinate of points outside of frames
is a height H over the model. The sphere has R = 6371 km and passes through Z = 2000.00079 m below
the point P0, where the ellipsoid has its top too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ...frames import LocalFrame
from ...types import Array
from ...units import GON

P0 = np.array([2000.0, 2097.79265, 2433.66])
"""Origin of the cartesian system at CERN, metres."""
_GRS80 = (6378137.0, 0.0066943800229)
"""Semi-major axis, metres, and first eccentricity squared."""
_LATITUDE, _HEIGHT, _AZIMUTH_OF_Y = 51.3692 * GON, 433.65921, 37.77864 * GON
"""Latitude (radians) and height (metres) of P0, azimuth of the Y axis there (radians)."""
SPHERE = 6_371_000.0
"""Radius of the sphere, metres."""
TOP = float(P0[2]) - _HEIGHT
"""Z of sphere and ellipsoid below P0, metres: 2000.00079."""
_PARABOLOID = (0.614, -0.106, 48.219 * GON - 38.90742 * GON)
"""Second derivatives, 10⁻⁵/km, and bearing of the axes of the geoid of 1985."""


@dataclass(frozen=True)
class Earth:
    """An earth model: heights over it, and the frame of the network that comes near."""

    kind: str
    """Word of the file: OLOC (plane), SPHE (sphere) or LEP (ellipsoid with geoid)."""

    def surface(self, x: Array) -> tuple[float, float, float]:
        """Return radius, Z of the top, and undulation at a place (3,)."""
        if self.kind == "SPHE":
            return SPHERE, TOP, 0.0
        dx, dy = (x - P0)[:2]
        a, e2 = _GRS80
        azimuth = math.atan2(dx, dy) + _AZIMUTH_OF_Y
        n = a / math.sqrt(1.0 - e2 * math.sin(_LATITUDE) ** 2)
        rho = n / (1.0 + e2 / (1.0 - e2) * (math.cos(_LATITUDE) * math.cos(azimuth)) ** 2)
        p, q, bearing = _PARABOLOID
        c, s = math.cos(bearing), math.sin(bearing)
        xp, yp = 1e-3 * (dx * c - dy * s), 1e-3 * (dx * s + dy * c)
        return rho, TOP, 0.01 * (p / 2 * xp * xp + q / 2 * yp * yp)

    def height(self, x: Array) -> float:
        """Return the height H of a place (3,)."""
        if self.kind == "OLOC":
            return float(x[2])
        radius, top, undulation = self.surface(x)
        d = math.hypot(*(x - P0)[:2])
        return math.hypot(d, radius + x[2] - top) - radius - undulation

    def place(self, x: float, y: float, height: float) -> Array:
        """Return the cartesian coordinates (3,) of X, Y and H; NaN beyond the horizon."""
        out = np.array([x, y, height])
        if self.kind != "OLOC":
            radius, top, undulation = self.surface(out)
            d = math.hypot(*(out - P0)[:2])
            square = (radius + height + undulation) ** 2 - d * d
            out[2] = top - radius + math.sqrt(square) if square > 0 else math.nan
        return out

    def deflections(self, x: Array) -> tuple[float, float]:
        """Return ξ, η at a place (3,): how the geoid falls towards Y and X, radians."""
        step = 10.0
        rise = [
            (self.surface(x + d)[2] - self.surface(x - d)[2]) / (2 * step)
            for d in step * np.eye(3)[:2]
        ]
        return -rise[1], -rise[0]

    def frame(self, near: Array) -> LocalFrame:
        """Return the frame of the network for places near ``near``."""
        if self.kind == "OLOC":
            return LocalFrame()
        radius, top, _ = self.surface(near)
        return LocalFrame(
            curvature=True, radius=radius + float(near[2]) - top, origin=(*P0[:2].tolist(), top)
        )
