"""Corrections of distances as an instrument sends them: prism constants, first velocity.

The first velocity correction takes a distance D', which the instrument computed with its reference
index n_ref, to that in the air of the measurement: D = D' n_ref/n; n is the group index of
`factorgraph_adj.atmosphere.group_index`. Temperature, pressure and humidity are stated, or those
of a sensor, whose values count for a stated age.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from threading import RLock
from typing import TYPE_CHECKING, Any

from ..atmosphere import ZERO_CELSIUS, group_index
from ..errors import InputError

if TYPE_CHECKING:
    from ..io.csv_tables import FieldRow

QUANTITIES = ("temperature", "pressure", "humidity")
"""Values of the air: kelvin, pascal, ratio."""
DEFAULT_HUMIDITY = 0.6
"""Relative humidity where nothing states it: 0.6, which is wrong by at most 0.54 ppm at 20 °C
(0.95 ppm at 30 °C)."""
MAX_INDEX_DIFFERENCE = 1e-3
"""Largest difference of a reference index to 1: that of air is 3·10⁻⁴."""


@dataclass(frozen=True)
class AtmosphereSettings:
    """Table [instrument.atmosphere]."""

    wavelength: float
    """Wavelength of the carrier, metres."""
    reference_index: float
    """Index for which the instrument computes distances at 0 ppm."""
    stated: Mapping[str, float] = field(default_factory=dict)
    """Temperature (K), pressure (Pa) and humidity (ratio) where no sensor has them."""
    sensor: str | None = None
    """Instrument whose lines have them."""
    max_age: float = 1800.0
    """Seconds for which values of a sensor count."""

    @classmethod
    def read(cls, row: FieldRow, duration: Callable[[object], float]) -> AtmosphereSettings | None:
        """Return the settings of a table; None after problems, which are noted in the row."""
        wavelength = row.number("wavelength_nm", required=True)
        index = row.number("reference_index", required=True)
        t, p, h = (row.number(n) for n in ("temperature_c", "pressure_hpa", "humidity_percent"))
        sensor, age = row.text("sensor"), 1800.0
        if (text := row.take("max_age")) is not None:
            try:
                age = duration(text)
            except ValueError as error:
                row.wrong(f"max_age {error}")
        if index is not None and not 0.0 <= index - 1.0 < MAX_INDEX_DIFFERENCE:
            row.wrong(f"reference_index must be such as 1.0002863, not {index:g}")
        if sensor is None and not ("temperature_c" in row and "pressure_hpa" in row):
            row.wrong("give temperature_c and pressure_hpa, or a sensor that has them")
        given = {
            "temperature": None if t is None else t + ZERO_CELSIUS,
            "pressure": None if p is None else 100.0 * p,
            "humidity": None if h is None else 0.01 * h,
        }
        stated = {name: v for name, v in given.items() if v is not None}
        row.refuse_left()
        if wavelength is not None:
            try:
                group_index(**{**_USUAL, **stated}, wavelength=1e-9 * wavelength)
            except InputError as error:
                for problem in error.problems:
                    name, _, why = problem.what.partition(" ")
                    row.wrong(f"{_KEYS[name]} {why}")
        if row.failed or wavelength is None or index is None:
            return None
        return cls(1e-9 * wavelength, index, stated, sensor, age)


_KEYS = {
    "temperature": "temperature_c",
    "pressure": "pressure_hpa",
    "humidity": "humidity_percent",
    "wavelength": "wavelength_nm",
}
_USUAL = {"temperature": 288.15, "pressure": 101325.0, "humidity": DEFAULT_HUMIDITY}


class SensorBoard:
    """Latest values of all sensors of a site, which its instruments share."""

    def __init__(self) -> None:
        """Start without values."""
        self._lock = RLock()
        self._latest: dict[tuple[str, str], tuple[float, float]] = {}

    def note(self, sensor: str, values: Mapping[str, float], time: float) -> None:
        """Note values of a sensor, and when they were measured; older ones change nothing."""
        with self._lock:
            for name, value in values.items():
                if self._latest.get((sensor, name), (0.0, -1e300))[1] <= time:
                    self._latest[sensor, name] = (value, time)

    def value(self, sensor: str, name: str, time: float, max_age: float) -> float | None:
        """Return a value that was measured at most ``max_age`` seconds before or after a time."""
        with self._lock:
            found = self._latest.get((sensor, name))
        return None if found is None or abs(time - found[1]) > max_age else found[0]


def velocity_factor(
    settings: AtmosphereSettings, sensors: SensorBoard, time: float
) -> float | None:
    """Return D/D' at a time; None: temperature or pressure is not known then.

    Raises:
        InputError: a value of a sensor is no value of air.
    """
    air: dict[str, Any] = {"humidity": DEFAULT_HUMIDITY, **settings.stated}
    if settings.sensor is not None:
        for name in QUANTITIES:
            value = sensors.value(settings.sensor, name, time, settings.max_age)
            if value is not None:
                air[name] = value
    if "temperature" not in air or "pressure" not in air:
        return None
    return settings.reference_index / float(group_index(**air, wavelength=settings.wavelength))
