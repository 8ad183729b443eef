"""Formulas of grids that are not those of PROJ, for comparisons."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.types import Array


@dataclass(frozen=True)
class TransverseMercator:
    """A transverse Mercator grid."""

    code: str
    """Its EPSG code."""
    central_deg: float
    """Central meridian, degrees."""
    ellipsoid: str
    """Name of the ellipsoid."""
    scale: float
    """Scale on the central meridian."""
    false: tuple[float, float]
    """E and N of the origin at the equator, metres."""
    place: tuple[float, float]
    """Latitude and longitude of a place in it, degrees."""

    def to_grid(self, latitude: Array, longitude: Array) -> Array:
        """Return E, N, (n, 2) metres: series of Redfearn (1948), in ω = Δλ cos φ.

        Source: Geocentric Datum of Australia, Technical Manual, chapter 5. Below 0.01 mm up to 4°
        from the central meridian.
        """
        e = ellipsoid(self.ellipsoid)
        e2 = e.e2
        e4, e6, e8 = e2**2, e2**3, e2**4
        a = (
            1 - e2 / 4 - 3 * e4 / 64 - 5 * e6 / 256 - 175 * e8 / 16384,
            3 / 8 * (e2 + e4 / 4 + 15 * e6 / 128 + 35 * e8 / 512),
            15 / 256 * (e4 + 3 * e6 / 4 + 35 * e8 / 64),
            35 / 3072 * (e6 + 5 * e8 / 4),
            315 * e8 / 131072,
        )
        arc = a[0] * latitude - sum(
            (-1) ** k * -a[k] * np.sin(2 * k * latitude) for k in range(1, 5)
        )
        m, n = e.radii(latitude)
        p, t, c, s = n / m, np.tan(latitude), np.cos(latitude), np.sin(latitude)
        d = longitude - np.radians(self.central_deg)
        w = d * c
        east = (
            w
            + w**3 / 6 * (p - t**2)
            + w**5 / 120 * (4 * p**3 * (1 - 6 * t**2) + p**2 * (1 + 8 * t**2) - 2 * p * t**2 + t**4)
            + w**7 / 5040 * (61 - 479 * t**2 + 179 * t**4 - t**6)
        )
        sixth = (
            8 * p**4 * (11 - 24 * t**2)
            - 28 * p**3 * (1 - 6 * t**2)
            + p**2 * (1 - 32 * t**2)
            - 2 * p * t**2
            + t**4
        )
        north = (
            d**2 / 2 * c
            + d**4 / 24 * c**3 * (4 * p**2 + p - t**2)
            + d**6 / 720 * c**5 * sixth
            + d**8 / 40320 * c**7 * (1385 - 3111 * t**2 + 543 * t**4 - t**6)
        )
        grid = np.stack([n * east, e.a * arc + n * s * north], axis=1)
        return np.asarray(self.scale * grid + self.false)


GRIDS = {
    "UTM 32": TransverseMercator("EPSG:25832", 9.0, "GRS80", 0.9996, (500000.0, 0.0), (48.1, 11.6)),
    "near the edge of UTM 33": TransverseMercator(
        "EPSG:25833", 15.0, "GRS80", 0.9996, (500000.0, 0.0), (54.2, 12.0)
    ),
    "beyond the edge of UTM 32": TransverseMercator(
        "EPSG:25832", 9.0, "GRS80", 0.9996, (500000.0, 0.0), (47.7, 12.9)
    ),
    "UTM 33 south": TransverseMercator(
        "EPSG:32733", 15.0, "WGS84", 0.9996, (500000.0, 1e7), (-34.3, 12.8)
    ),
    "MGA 55": TransverseMercator(
        "EPSG:7855", 147.0, "GRS80", 0.9996, (500000.0, 1e7), (-36.6, 146.0)
    ),
    "Gauss-Krüger 3": TransverseMercator(
        "EPSG:31467", 9.0, "Bessel1841", 1.0, (3.5e6, 0.0), (50.3, 8.1)
    ),
}
"""Grids in both hemispheres and near the edges of zones."""
