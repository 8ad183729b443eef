"""Standard atmosphere: heights from pressure and back; slope of surfaces of equal pressure by wind.

International Standard Atmosphere (ICAO Doc 7488; ISO 2533:1975) below 11 km. Pressures are in Pa,
heights in metres, angles in radians, speeds in metres per second.
"""

from __future__ import annotations

import numpy as np

from .errors import InputError
from .types import Array

SEA_LEVEL_TEMPERATURE = 288.15
"""Temperature of the standard atmosphere at sea level, kelvin."""
SEA_LEVEL_PRESSURE = 101_325.0
"""Pressure of the standard atmosphere at sea level, Pa."""
LAPSE_RATE = 0.0065
"""Decrease of temperature with height in the standard atmosphere, kelvin per metre."""
GRAVITY = 9.80665
"""Standard acceleration of gravity, metres per second²."""
GAS_CONSTANT = 287.05287
"""Specific gas constant of dry air, joule per kilogram and kelvin."""
ROTATION_OF_THE_EARTH = 7.292115e-5
"""Angular velocity of the Earth, radians per second."""
EXPONENT = GAS_CONSTANT * LAPSE_RATE / GRAVITY
"""Exponent of the pressure ratio, 0.190263."""
CEILING = 11_000.0
"""Height to which the lapse rate is constant, metres."""


def pressure_height(
    pressure: float | Array, *, temperature: float | None = None, height: float = 0.0
) -> Array:
    """Return pressure heights z = (T₀/L) (1 − (p/p₀)^{R L/g}), metres; FRAMES F9.1.

    They are geopotential heights of the standard atmosphere. Air that is warmer stands higher: with
    a temperature all heights grow by (T + L h)/T₀, the true over the standard temperature.

    >>> pressure_height(np.array([101_325.0, 89_874.6, 70_108.5])).round(1).tolist()
    [0.0, 1000.0, 3000.0]

    Args:
        pressure: p, Pa.
        temperature: T of the air, kelvin; None: that of the standard atmosphere.
        height: h at which the temperature was read, metres.

    Raises:
        InputError: a pressure outside the first layer of the atmosphere, or a temperature that is
            not positive.
    """
    p = np.asarray(pressure, dtype=float)
    lowest = float(standard_pressure(CEILING))
    if not np.all((p >= lowest) & (p < 1.2 * SEA_LEVEL_PRESSURE)):
        raise InputError(
            f"pressures must be between {lowest:.0f} and {1.2 * SEA_LEVEL_PRESSURE:.0f} Pa, up to "
            f"11 km of height, not {pressure}; 1 hPa = 100 Pa"
        )
    z = SEA_LEVEL_TEMPERATURE / LAPSE_RATE * (1.0 - (p / SEA_LEVEL_PRESSURE) ** EXPONENT)
    return np.asarray(z * warmth(temperature, height=height))


def standard_pressure(height: float | Array) -> Array:
    """Return the pressure of the standard atmosphere at heights below 11 km, Pa.

    It is the inverse of `pressure_height` without a temperature.
    """
    h = np.asarray(height, dtype=float)
    ratio = 1.0 - LAPSE_RATE * h / SEA_LEVEL_TEMPERATURE
    return np.asarray(SEA_LEVEL_PRESSURE * ratio ** (1.0 / EXPONENT))


def warmth(temperature: float | None, *, height: float = 0.0) -> float:
    """Return the ratio by which differences of height exceed those of the standard atmosphere.

    It is (T + L h)/T₀ for a temperature T (kelvin) that was read at the height h (metres): 3 % for
    9 K. Nothing measured: 1.
    """
    if temperature is None:
        return 1.0
    if not temperature > 0:
        raise InputError(f"a temperature is in kelvin and positive, not {temperature}")
    return (temperature + LAPSE_RATE * height) / SEA_LEVEL_TEMPERATURE


def pressure_slope(latitude: float, wind_from_left: float) -> float:
    """Return the rise of a surface of equal pressure along a flight, metres per metre.

    Geostrophic balance (Henry's correction; FRAMES F9.1): ∂h/∂s = −2 Ω sin φ w / g, where w is
    the component of the wind that blows from left to right of the track. On the northern hemisphere
    low pressure is to the left of someone whom the wind pushes: wind from the right of the track
    means that the surface rises.

    >>> round(1000 * pressure_slope(np.radians(50.0), -20.0), 2)  # metres per kilometre
    0.23

    Args:
        latitude: φ, radians, north positive.
        wind_from_left: w, metres per second: airspeed × sin of the crab angle, positive where the
            nose points to the left of the track.
    """
    return float(-2.0 * ROTATION_OF_THE_EARTH * np.sin(latitude) * wind_from_left / GRAVITY)
