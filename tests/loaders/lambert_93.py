"""Lambert-93: ellipsoidal conformal conic projection with two standard parallels.

Formulas of IGN, Notes techniques NT/G 71, "Projection cartographique conique conforme de Lambert"
(algorithms ALG0001, ALG0002, ALG0004, ALG0019): with the isometric latitude L(φ),

    R = C exp(−n L),   γ = n (λ − λ₀),   E = E_s + R sin γ,   N = N_s − R cos γ

γ is the convergence of the meridian: grid north is at the azimuth γ, see `to_grid_axes`. The scale
is m = n R / (ν cos φ), with the radius ν of the prime vertical.
"""

from __future__ import annotations

import numpy as np

from factorgraph_adj.ellipsoid import ellipsoid
from factorgraph_adj.types import Array

_GRS80 = ellipsoid("GRS80")
_E = np.sqrt(_GRS80.e2)
CENTRAL_MERIDIAN = np.radians(3.0)
"""λ₀."""
FALSE_ORIGIN = np.radians(46.5), 700_000.0, 6_600_000.0
"""Latitude, E and N of the origin of the grid."""
STANDARD_PARALLELS = np.radians(44.0), np.radians(49.0)


def _isometric(latitude: Array) -> Array:
    """Return the isometric latitude L, ALG0001."""
    es = _E * np.sin(latitude)
    return np.asarray(np.arctanh(np.sin(latitude)) - _E * np.arctanh(es))


def _constants() -> tuple[float, float, float]:
    """Return the exponent n, the constant C (metres) and N_s of the pole (metres), ALG0019."""
    phi = np.array(STANDARD_PARALLELS)
    radius = _GRS80.radii(phi)[1] * np.cos(phi)
    iso = _isometric(phi)
    n = np.log(radius[1] / radius[0]) / (iso[0] - iso[1])
    c = radius[0] / n * np.exp(n * iso[0])
    origin = c * np.exp(-n * _isometric(np.array(FALSE_ORIGIN[0])))
    return float(n), float(c), float(FALSE_ORIGIN[2] + origin)


EXPONENT, CONSTANT, POLE_NORTHING = _constants()


def to_grid(latitude: Array, longitude: Array) -> tuple[Array, Array]:
    """Return E and N, metres, of φ and λ, radians; ALG0003."""
    r = CONSTANT * np.exp(-EXPONENT * _isometric(latitude))
    gamma = EXPONENT * (longitude - CENTRAL_MERIDIAN)
    return FALSE_ORIGIN[1] + r * np.sin(gamma), POLE_NORTHING - r * np.cos(gamma)


def from_grid(easting: Array, northing: Array) -> tuple[Array, Array]:
    """Return φ and λ, radians, of E and N, metres; ALG0004."""
    x, y = easting - FALSE_ORIGIN[1], POLE_NORTHING - northing
    iso = np.log(CONSTANT / np.hypot(x, y)) / EXPONENT
    latitude = np.arcsin(np.tanh(iso))
    for _ in range(8):  # a step shrinks the error by e², 150 times
        latitude = np.arcsin(np.tanh(iso + _E * np.arctanh(_E * np.sin(latitude))))
    return np.asarray(latitude), CENTRAL_MERIDIAN + np.arctan2(x, y) / EXPONENT


def scale(latitude: Array) -> Array:
    """Return the scale m of the projection, metres of the grid per metre of the ellipsoid."""
    r = CONSTANT * np.exp(-EXPONENT * _isometric(latitude))
    return np.asarray(EXPONENT * r / (_GRS80.radii(latitude)[1] * np.cos(latitude)))


def enu_from_grid(longitude: Array) -> Array:
    """Return the rotations (n, 3, 3) from grid east, grid north and up to east, north and up.

    East of the central meridian γ > 0: meridians lean to the west on the map.
    """
    gamma = EXPONENT * (longitude - CENTRAL_MERIDIAN)
    out = np.zeros((len(gamma), 3, 3))
    out[:, 0, 0], out[:, 0, 1] = np.cos(gamma), np.sin(gamma)
    out[:, 1, 0], out[:, 1, 1] = -np.sin(gamma), np.cos(gamma)
    out[:, 2, 2] = 1.0
    return out
