"""Settings of a STAR*NET project that its data files lack: units, orders, standard errors.

STAR*NET keeps units, orders and default standard errors in the project file (.prj, .snproj), and
data files in the conventions that it states. The reader demands each setting that a line uses.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ...errors import InputError, Problem, known
from ...units import FOOT, KILOMETRE, US_SURVEY_FOOT
from ..text_files import read_toml

STAR_NET_LINEAR_UNITS = {
    "meters": 1.0,
    "feetus": US_SURVEY_FOOT,
    "feetint": FOOT,
    "feetinternational": FOOT,
    "feet": FOOT,
}
"""Metres of the linear units; ``Feet`` is the international foot."""
MILE_FEET, KILOMETRE_METRES = 5280.0, KILOMETRE
"""Linear units in the unit of level lines: miles of feet, kilometres of metres."""
SETTING_CHOICES: dict[str, tuple[str, ...]] = {
    "adjustment": ("2D", "3D", "LEV"),
    "linear": ("Meters", "FeetUS", "FeetInt"),
    "angular": ("DMS", "GONS"),
    "order": ("NE", "EN"),
    "stations": ("AtFromTo", "FromAtTo"),
    "distances": ("slope", "horizontal"),
    "weight_levels_by": ("length", "turns"),
    "longitude": ("west positive", "east positive"),
}
INSTRUMENT_SETTINGS = (
    *("angle", "direction", "azimuth", "zenith", "distance", "distance_ppm", "elevation"),
    *("elevation_ppm", "centring_instrument", "centring_target", "centring_vertical"),
)
"""Settings that an instrument has of its own."""
POSITIVE_SETTINGS = (
    *("earth_radius", "scale", "fixed_length", "fixed_angle", "gps_factor", "gps_factor_vertical"),
)
"""Settings that have a default and cannot be 0."""


@dataclass(frozen=True)
class StarNetOptions:
    """Settings of a project; None: not stated, and demanded where a line uses it.

    Standard errors are in the units in which the dialogue of STAR*NET shows them: linear ones in
    the linear unit, angular ones in seconds (milligons for GONS).
    """

    adjustment: str | None = None
    """Type of adjustment: 2D, 3D or LEV."""
    linear: str | None = None
    """Linear unit: Meters, FeetUS (1200/3937 m) or FeetInt (0.3048 m)."""
    angular: str | None = None
    """Angular unit: DMS (degrees-minutes-seconds) or GONS."""
    order: str | None = None
    """Order of coordinates: NE or EN."""
    stations: str | None = None
    """Order of the stations of an angle: AtFromTo or FromAtTo."""
    distances: str | None = None
    """Data of 3D lines: slope (slope distance, zenith angle) or horizontal (horizontal distance,
    elevation difference)."""
    angle: float | None = None
    """Standard error of a horizontal angle."""
    direction: float | None = None
    """Standard error of a direction of a set."""
    azimuth: float | None = None
    """Standard error of a bearing or an azimuth."""
    zenith: float | None = None
    """Standard error of a zenith angle."""
    distance: float | None = None
    """Constant part of the standard error of a distance, linear unit."""
    distance_ppm: float | None = None
    """Part that grows with the distance, ppm; added to the constant one."""
    elevation: float | None = None
    """Constant part of the standard error of an elevation difference (V, M), linear unit."""
    elevation_ppm: float | None = None
    """Part that grows with the distance, ppm."""
    level: float | None = None
    """Standard error of a levelled difference (L): linear unit per √mile for feet, per √kilometre
    for metres, or for one turn."""
    weight_levels_by: str | None = None
    """Whether the last number of L lines is a length or a number of turns."""
    centring_instrument: float | None = None
    """Centring of the instrument, horizontally, linear unit."""
    centring_target: float | None = None
    """Centring of the target, horizontally, linear unit."""
    centring_vertical: float | None = None
    """Standard error of heights of instrument and of target, linear unit."""
    refraction: float | None = None
    """Coefficient of refraction in STAR*NET's sense, 0.07: half of Gauss's k."""
    earth_radius: float = 6_372_000.0
    """Radius of the Earth, metres."""
    longitude: str | None = None
    """Sign of longitudes: west positive or east positive."""
    elevation_of_project: float | None = None
    """Elevation of a 2D project in a grid, linear unit."""
    scale: float = 1.0
    """Factor of horizontal lengths of a local project."""
    fixed_length: float = 1e-5
    """Standard error of lengths that are fixed by ``!``, metres."""
    fixed_angle: float = 0.01
    """Standard error of angles that are fixed by ``!``, seconds."""
    gps_factor: float = 1.0
    """Factor of the horizontal standard errors of GPS vectors, before .GPS FACTOR."""
    gps_factor_vertical: float = 1.0
    """Factor of their vertical standard errors."""
    instruments: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Standard errors of the instruments of the project by name (``.INSTRUMENT``); what one does
    not state is that of the project."""

    def __post_init__(self) -> None:
        """Check words and numbers; InputError lists all that are wrong."""
        problems = []
        for f in fields(self):
            value = getattr(self, f.name)
            if value is None:
                continue
            if f.name == "instruments":
                problems += _instruments(value)
                continue
            if f.name in SETTING_CHOICES:
                match = [c for c in SETTING_CHOICES[f.name] if c.lower() == str(value).lower()]
                if match:
                    object.__setattr__(self, f.name, match[0])
                else:
                    valid = known(SETTING_CHOICES[f.name], meant=str(value))
                    problems.append(Problem(f"{f.name} must be one of {valid}, not {value!r}"))
                continue
            least = -1e5 if f.name == "elevation_of_project" else 0
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not (number and math.isfinite(value) and least <= value <= 1e9):
                problems.append(Problem(f"{f.name} must be a number ≥ 0, not {value!r}"))
        for name in POSITIVE_SETTINGS:
            value = getattr(self, name)
            if not (isinstance(value, int | float) and value > 0):
                problems.append(Problem(f"{name} must be > 0, not {value!r}"))
        if problems:
            raise InputError(problems)

    @property
    def metres(self) -> float:
        """Metres of the linear unit; 1 while it is not stated."""
        return STAR_NET_LINEAR_UNITS[(self.linear or "Meters").lower()]


def _instruments(given: Any) -> list[Problem]:
    """Return what is wrong with the instruments of a project."""
    if not isinstance(given, Mapping):
        return [Problem(f"instruments must be tables of standard errors by name, not {given!r}")]
    problems = []
    for name, errors in given.items():
        if not isinstance(errors, Mapping):
            problems.append(Problem(f"instrument {name!r} must be a table of standard errors"))
            continue
        for key, value in errors.items():
            if key not in INSTRUMENT_SETTINGS:
                valid = known(INSTRUMENT_SETTINGS, meant=str(key), most=20)
                what = f"instrument {name!r} has an unknown setting {key!r}; valid: {valid}"
                problems.append(Problem(what))
            elif not (isinstance(value, int | float) and not isinstance(value, bool)) or not (
                0 <= value <= 1e9
            ):
                problems.append(Problem(f"{key} of instrument {name!r} must be a number ≥ 0"))
    return problems


def star_net_options(
    given: StarNetOptions | Mapping[str, Any] | str | Path | None,
) -> StarNetOptions:
    """Return settings of a project from a mapping or a TOML file.

    Args:
        given: settings, their names and values, or a TOML file with them; None: nothing is stated.

    Raises:
        InputError: the file cannot be read, or a setting is unknown or wrong.
    """
    if given is None:
        return StarNetOptions()
    if isinstance(given, StarNetOptions):
        return given
    if isinstance(given, str | Path):
        stated, places = read_toml(Path(given))
        with places.placing():
            return _checked_settings(stated, places.name)
    return _checked_settings(given, "options")


def _checked_settings(given: Mapping[str, Any], where: str) -> StarNetOptions:
    """Return settings; ``where`` is named in messages."""
    valid = [f.name for f in fields(StarNetOptions)]
    problems = [
        Problem(f"unknown setting {k!r}; valid: {known(valid, meant=k, most=30)}", where)
        for k in given
        if k not in valid
    ]
    try:
        options = StarNetOptions(**{k: v for k, v in given.items() if k in valid})
    except InputError as error:
        problems += [Problem(p.what, where) for p in error.problems]
    if problems:
        raise InputError(problems)
    return options
