"""Standard atmosphere: heights from pressure and back; slope by wind; index of air and water.

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
ZERO_CELSIUS = 273.15
"""Kelvin of 0 °C."""
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


def water_index(
    *, temperature: float = 15.0, salinity: float = 0.0, wavelength: float = 550.0
) -> float:
    """Return the refractive index of water relative to air, at the pressure of the surface.

    Quan & Fry 1995, Empirical equation for the index of refraction of seawater, Applied Optics 34,
    3477, whose data are those of Austin & Halikas 1976. It changes by −1·10⁻⁴ per kelvin,
    2·10⁻⁴ per gram of salt, and from 1.343 for blue to 1.331 for red light.

    >>> round(water_index(temperature=20.0, wavelength=589.3), 5)
    1.33301

    Args:
        temperature: of the water, °C, 0 to 30.
        salinity: grams of salt per kilogram, 0 to 35 (ocean).
        wavelength: of the light, nanometres, 400 to 700: 550 is green, in the middle of a camera's.

    Raises:
        InputError: a value outside of these ranges.
    """
    ranges = {
        "temperature": (temperature, 0.0, 30.0, "°C"),
        "salinity": (salinity, 0.0, 35.0, "g/kg"),
        "wavelength": (wavelength, 400.0, 700.0, "nm"),
    }
    for name, (value, low, high, unit) in ranges.items():
        if not low <= value <= high:
            raise InputError(f"{name} must be from {low:g} to {high:g} {unit}, not {value:g}")
    t, s, w = temperature, salinity, 1.0 / wavelength
    by_salt = (1.779e-4 - 1.05e-6 * t + 1.6e-8 * t**2) * s
    by_colour = (15.868 + 0.01155 * s - 0.00423 * t) * w - 4382.0 * w**2 + 1.1455e6 * w**3
    return 1.31405 + by_salt - 2.02e-6 * t**2 + by_colour


def group_index(
    *, temperature: float, pressure: float, humidity: float, wavelength: float
) -> float:
    """Return the group refractive index of air for distance meters.

    Closed formulae of the International Association of Geodesy (resolution 3 of 1999), which agree
    with those of Ciddor & Hill to 0.25 ppm in the ordinary conditions of surveying:
    N = (273.15/1013.25) N_gr p/T − 11.27 e/T with N_gr = 287.6155 + 4.88660/λ² + 0.06800/λ⁴,
    p and e (partial pressure of water vapour) in hPa, T in kelvin, λ in µm; n = 1 + 10⁻⁶ N. The
    saturation pressure is Magnus' over water, 6.1078·10^{7.5 t/(237.3 + t)} hPa.

    >>> air = {"temperature": 293.15, "pressure": 101325.0, "humidity": 0.5}
    >>> round(1e6 * (group_index(**air, wavelength=850e-9) - 1), 2)
    273.97

    Args:
        temperature: of the air, kelvin.
        pressure: p, Pa.
        humidity: relative humidity, a ratio from 0 to 1.
        wavelength: λ of the carrier in vacuum, metres, 400 to 1600 nm.

    Raises:
        InputError: a value outside of its range: −40 to 60 °C, 400 to 1200 hPa.
    """
    ranges = {
        "temperature": (temperature - ZERO_CELSIUS, -40.0, 60.0, "°C"),
        "pressure": (1e-2 * pressure, 400.0, 1200.0, "hPa"),
        "humidity": (1e2 * humidity, 0.0, 100.0, "%"),
        "wavelength": (1e9 * wavelength, 400.0, 1600.0, "nm"),
    }
    for name, (value, low, high, unit) in ranges.items():
        if not low <= value <= high:
            raise InputError(f"{name} must be from {low:g} to {high:g} {unit}, not {value:g}")
    t, w = temperature - ZERO_CELSIUS, (1e6 * wavelength) ** -2
    vapour = humidity * 6.1078 * 10.0 ** (7.5 * t / (237.3 + t))
    group = 287.6155 + 4.88660 * w + 0.06800 * w**2
    n = (273.15 / 1013.25) * group * 1e-2 * pressure / temperature - 11.27 * vapour / temperature
    return float(1.0 + 1e-6 * n)
