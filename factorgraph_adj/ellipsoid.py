"""Ellipsoids of revolution by name; geodetic and geocentric coordinates, radii of curvature."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import InputError, unknown_name
from .types import Array


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """An ellipsoid of revolution."""

    name: str
    """Name."""
    a: float
    """Semi-major axis, metres."""
    inverse_flattening: float
    """1/f, dimensionless."""

    @property
    def flattening(self) -> float:
        """Flattening f."""
        return 1.0 / self.inverse_flattening

    @property
    def e2(self) -> float:
        """First eccentricity squared, e² = f(2 − f)."""
        return self.flattening * (2.0 - self.flattening)

    def radii(self, latitude: Array) -> tuple[Array, Array]:
        """Return the radii of curvature M (meridian) and N (prime vertical), metres."""
        w2 = 1.0 - self.e2 * np.sin(latitude) ** 2
        n = self.a / np.sqrt(w2)
        return n * (1.0 - self.e2) / w2, n

    def to_cartesian(self, latitude: Array, longitude: Array, height: Array) -> Array:
        """Return geocentric (..., 3) metres from geodetic φ, λ (rad) and ellipsoidal height (m)."""
        _, n = self.radii(latitude)
        p = (n + height) * np.cos(latitude)
        z = (n * (1.0 - self.e2) + height) * np.sin(latitude)
        return np.stack([p * np.cos(longitude), p * np.sin(longitude), z], axis=-1)

    def to_geodetic(self, xyz: Array) -> tuple[Array, Array, Array]:
        """Return φ, λ (rad) and ellipsoidal height (m) of geocentric (..., 3) metres.

        Bowring's start and two Newton-like refinements: below 1e-11 rad and 1e-9 m up to
        satellite heights, away from the centre of the Earth.
        """
        x, y, z = xyz[..., 0], xyz[..., 1], xyz[..., 2]
        p = np.hypot(x, y)
        b = self.a * (1.0 - self.flattening)
        second = self.e2 / (1.0 - self.e2)
        theta = np.arctan2(z * self.a, p * b)
        for _ in range(3):
            latitude = np.arctan2(
                z + second * b * np.sin(theta) ** 3, p - self.e2 * self.a * np.cos(theta) ** 3
            )
            theta = np.arctan2(b * np.sin(latitude), self.a * np.cos(latitude))
        _, n = self.radii(latitude)
        height = p * np.cos(latitude) + z * np.sin(latitude) - self.a**2 / n
        return latitude, np.arctan2(y, x), height


ELLIPSOIDS: dict[str, Ellipsoid] = {
    e.name: e
    for e in (
        Ellipsoid("GRS80", 6378137.0, 298.257222101),
        Ellipsoid("WGS84", 6378137.0, 298.257223563),
        Ellipsoid("International1924", 6378388.0, 297.0),
        Ellipsoid("Bessel1841", 6377397.155, 299.1528128),
        Ellipsoid("Clarke1866", 6378206.4, 294.978698214),
        Ellipsoid("Clarke1880IGN", 6378249.2, 293.4660212936269),
        Ellipsoid("Krassovsky1940", 6378245.0, 298.3),
        Ellipsoid("Airy1830", 6377563.396, 299.3249646),
        Ellipsoid("ANS", 6378160.0, 298.25),
        Ellipsoid("AiryModified1849", 6377340.189, 299.3249646),
        Ellipsoid("Clarke1880RGS", 6378249.145, 293.465),
        Ellipsoid("GRS67", 6378160.0, 298.247167427),
        Ellipsoid("Helmert1906", 6378200.0, 298.3),
        Ellipsoid("WGS72", 6378135.0, 298.26),
        Ellipsoid("Moon", 1737400.0, float("inf")),
    )
}
"""Ellipsoids by name."""


def ellipsoid(name: str) -> Ellipsoid:
    """Return the ellipsoid called ``name``; InputError lists the known ones."""
    if name not in ELLIPSOIDS:
        raise InputError(unknown_name("ellipsoid", name, ELLIPSOIDS, most=40))
    return ELLIPSOIDS[name]
