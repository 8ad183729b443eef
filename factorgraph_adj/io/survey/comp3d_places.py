"""The coordinates of Comp3D: a stereographic plane and heights, over a sphere or the ellipsoid.

X and Y of a local project are a double stereographic projection of GRS80 at its centre (``sterea``
of PROJ), the third coordinate is the height. What the values that Comp3D prints show:

- Observation equations of simple observations work in east, north, up of a sphere with the mean
  radius √(MN) at the centre. `LocalFrame` with curvature and that radius is the same: residuals
  agree to 2·10⁻⁵ σ, coordinates to 0.02 µm.
- Sub-frames of versions from 5.22 on work on the ellipsoid; printed cartesian coordinates are those
  on the ellipsoid too (to 5 nm).
- Azimuths count from true north, which lies X tan φ / N west of the Y axis.
- σ of plane coordinates grow with 1 + h/R on the ground.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...ellipsoid import ellipsoid
from ...frames import LocalFrame, TopocentricFrame
from ...types import Array


@dataclass(frozen=True)
class Comp3dOrigin:
    """The centre of a project, on GRS80 if it is a local one."""

    latitude: float
    """Geodetic latitude, degrees."""
    longitude: float = 0.0
    """Longitude, degrees: it matters for GNSS baselines and grids only."""
    ellipsoid_name: str = "GRS80"
    """Ellipsoid, see `factorgraph_adj.ellipsoid.ELLIPSOIDS`."""

    @property
    def radii(self) -> tuple[float, float]:
        """Radii of curvature M and N, metres."""
        m, n = ellipsoid(self.ellipsoid_name).radii(np.radians(np.array([self.latitude])))
        return float(m[0]), float(n[0])

    @property
    def radius(self) -> float:
        """Radius √(MN) of the sphere of the observation equations, metres."""
        return float(np.sqrt(np.prod(self.radii)))

    def to_cartesian(self, projected: Array) -> Array:
        """Return east, north, up (3,) on the sphere of stereographic X, Y and height.

        To 1 nm within 1 km: X (1 + h/R), Y (1 + h/R), h − (X² + Y²)/2R.
        """
        x, y, h = projected
        r = self.radius
        return np.array([x * (1 + h / r), y * (1 + h / r), h - (x * x + y * y) / (2 * r)])

    def geodetic(self, projected: Array) -> tuple[float, float]:
        """Return latitude and longitude from the origin, radians, of stereographic X, Y.

        The inverse of the double projection: from the plane to the sphere of radius √(MN), from the
        sphere to the ellipsoid, both conformal.
        """
        globe, phi0, r = ellipsoid(self.ellipsoid_name), np.radians(self.latitude), self.radius
        e = np.sqrt(globe.e2)

        def isometric(phi: float) -> float:
            return float(np.arctanh(np.sin(phi)) - e * np.arctanh(e * np.sin(phi)))

        n = np.sqrt(1 + globe.e2 * np.cos(phi0) ** 4 / (1 - globe.e2))
        chi0 = np.arcsin(np.sin(phi0) / n)
        shift = np.arctanh(np.sin(chi0)) - n * isometric(phi0)
        x, y = projected[:2]
        distance, azimuth = 2 * np.arctan(np.hypot(x, y) / (2 * r)), np.arctan2(x, y)
        north, east = np.sin(distance) * np.cos(azimuth), np.sin(distance) * np.sin(azimuth)
        chi = np.arcsin(np.cos(distance) * np.sin(chi0) + north * np.cos(chi0))
        longitude = np.arctan2(east, np.cos(distance) * np.cos(chi0) - north * np.sin(chi0)) / n
        phi = phi0
        for _ in range(12):  # each gains the square of the eccentricity: 12 · log10(e⁻²) digits
            q = (np.arctanh(np.sin(chi)) - shift) / n + e * np.arctanh(e * np.sin(phi))
            phi = np.arcsin(np.tanh(q))
        return float(phi), float(longitude)

    @property
    def sphere(self) -> LocalFrame:
        """East, north, up at the origin, over the sphere."""
        return LocalFrame(curvature=True, radius=self.radius)

    @property
    def frame(self) -> TopocentricFrame:
        """East, north, up at the origin, on the ellipsoid."""
        latitude, longitude = np.radians(self.latitude), np.radians(self.longitude)
        return TopocentricFrame(latitude, longitude, 0.0, self.ellipsoid_name, radius=self.radius)

    def on_ellipsoid(self, projected: Array) -> Array:
        """Return east, north, up (3,) on the ellipsoid of stereographic X, Y and height."""
        phi, longitude = (np.array([a]) for a in self.geodetic(projected))
        longitude = longitude + np.radians(self.longitude)
        there = ellipsoid(self.ellipsoid_name).to_cartesian(
            phi, longitude, np.array([projected[2]])
        )
        return np.asarray(self.frame.from_geocentric(there)[0])

    def convergence(self, east: float) -> float:
        """Return by how much true north lies west of the Y axis, radians."""
        return float(east * np.tan(np.radians(self.latitude)) / self.radii[1])
