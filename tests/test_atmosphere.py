"""Heights from pressure against printed tables, and the slope of surfaces from the wind."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.atmosphere import (
    GRAVITY,
    pressure_height,
    pressure_slope,
    standard_pressure,
    warmth,
)
from factorgraph_adj.errors import InputError

TABLE = {
    -1000.0: 113_929.0,
    0.0: 101_325.0,
    500.0: 95_460.8,
    1000.0: 89_874.6,
    2000.0: 79_495.2,
    3000.0: 70_108.5,
    5000.0: 54_019.9,
    8000.0: 35_599.8,
    11_000.0: 22_632.0,
}
"""Pressures of the standard atmosphere, Pa, by geopotential height (ICAO Doc 7488; ISO 2533)."""


@pytest.mark.parametrize(("height", "pressure"), TABLE.items())
def test_pressures_of_the_standard_atmosphere_are_the_printed_ones(height, pressure) -> None:
    half = 0.5 if pressure % 1 == 0 else 0.05
    assert standard_pressure(height) == pytest.approx(pressure, abs=1.01 * half)


@pytest.mark.parametrize("height", [-500.0, 0.0, 1234.5, 10_900.0])
def test_heights_and_pressures_are_inverse(height: float) -> None:
    assert pressure_height(standard_pressure(height)) == pytest.approx(height, abs=1e-7)


def test_warm_air_stands_higher() -> None:
    """The barometric formula dh = −R T/(g p) dp: heights grow as the temperature."""
    ground, warm = 288.15, 300.0
    thin = pressure_height(np.array([100_000.0, 99_990.0]), temperature=warm)
    standard = pressure_height(np.array([100_000.0, 99_990.0]))
    assert np.diff(thin)[0] / np.diff(standard)[0] == pytest.approx(warm / ground, rel=1e-9)
    assert warmth(288.15 - 0.0065 * 2000, height=2000.0) == pytest.approx(1.0, abs=1e-15)
    # Nine kelvin are three per cent.
    assert warmth(288.15 + 9.0) == pytest.approx(1.031, abs=5e-4)


@pytest.mark.parametrize("pressure", [950.0, 20_000.0, np.nan, -1.0])
def test_pressures_in_hectopascal_are_refused(pressure: float) -> None:
    with pytest.raises(InputError, match="1 hPa = 100 Pa"):
        pressure_height(pressure)


def test_temperatures_below_zero_are_refused() -> None:
    with pytest.raises(InputError, match="in kelvin and positive, not -5"):
        pressure_height(95_000.0, temperature=-5.0)


def test_the_slope_of_a_surface_of_pressure_is_in_geostrophic_balance() -> None:
    """The pull along the surface, g times its slope, is the Coriolis force of the wind."""
    latitude, wind = np.radians(50.0), 20.0
    coriolis = 2.0 * 7.292115e-5 * np.sin(latitude) * wind
    assert pressure_slope(latitude, -wind) == pytest.approx(coriolis / GRAVITY)
    # 0.23 m per km at 20 m/s and 50°, rising towards the high pressure: wind from the right.
    assert 1000.0 * pressure_slope(latitude, -wind) == pytest.approx(0.23, abs=5e-3)
    assert pressure_slope(-latitude, wind) == pytest.approx(pressure_slope(latitude, -wind))
    assert pressure_slope(0.0, wind) == 0.0
