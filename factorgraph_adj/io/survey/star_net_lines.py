"""Lines of STAR*NET data: values and standard errors in force, and the inline options."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ...errors import known
from ...observations.variances import CENTRING, VERTICAL
from ...stochastic_model import StandardDeviation
from ...units import ARCSEC, GON
from ..numbers import PACKED_DEGREES, PACKED_PATTERN
from ..source import LeftOutReason, Source
from .star_net_options import (
    KILOMETRE_METRES,
    MILE_FEET,
    SETTING_CHOICES,
    STAR_NET_LINEAR_UNITS,
    StarNetOptions,
)

HELD_ANGLE_SIGMA_RAD, HELD_LENGTH_SIGMA_M = 0.01 * ARCSEC, 1e-5
"""σ of an observation that is fixed by ``!``: 0.01″ and 0.01 mm."""
FREE_SIGMA_FACTOR = 1e4
"""Factor of the default σ of an observation that is free by ``*``: it has no influence."""
SIMPLE_DATA_TYPES = {
    "A": ("angle",),
    "D": ("distance",),
    "V": ("vertical",),
    "DV": ("distance", "vertical"),
    "B": ("bearing",),
    "M": ("angle", "distance", "vertical"),
    "SS": ("angle", "distance", "vertical"),
    "BM": ("bearing", "distance", "vertical"),
    "DN": ("direction",),
    "DM": ("direction", "distance", "vertical"),
    "T": ("angle", "distance", "vertical"),
}
"""Observations of the data types, in their order on a line."""
REFUSED_DATA_TYPES = {
    "G": "give G1 to G3",
    "GT": "geoid heights and deflections: use geoid=",
    "GH": "geoid heights and deflections: use geoid=",
}
"""Data types of STAR*NET that the reader refuses, and why."""
GRID_DATA_TYPES = ("CH", "EH", "P", "PH", "G0", "G1", "G2", "G3")
"""Data types that need the reference system of a project in a grid."""
ANGLE_DATA_TYPES = ("A", "M", "SS")
"""Data types whose stations are at, from and to."""
DMS_PATTERN = re.compile(r"([+-]?)(\d+)-(\d+)(?:-(\d+(?:\.\d*)?))?", re.ASCII)
BEARING_PATTERN = re.compile(r"([NSns])(.+)([EWew])", re.ASCII)
Sigma = float | StandardDeviation
LINES_BEHIND_DATA_OFF = LeftOutReason("lines", "they stand behind .DATA OFF")
HEIGHTS_IN_2D = LeftOutReason("observations", "a 2D project has no heights")
VALUES_MISSING = LeftOutReason("values", "the file has ? in their place")
PRINTING_OPTIONS = ("LOSTSTATIONS", "PTOLERANCE", "ELLIPSE", "RELATIVE")
"""Inline options that change only what STAR*NET prints."""
REFUSED_OPTIONS = {
    "INCLUDE": "put the lines of the other file here",
    "GRID": "what bearings and distances are holds for the whole file: azimuths= and "
    "horizontal_distances=",
    "SCALE": "distances are not scaled; divide them by the factor",
    "MEASURE": "what bearings and distances are holds for the whole file: azimuths= and "
    "horizontal_distances=",
    "ELEVATION": "elevation_of_project in options",
    "ELLIPSOID": "positions on the ellipsoid are not read",
    "MAPMODE": "bearings in traverse lines are not read; use B and D lines",
    "ALIAS": "aliases of names are not read; rename the points",
    "COPY": "copies of points are not read; rename the points",
}
"""Inline options that are not built, and why."""


@dataclass
class Conventions:
    """Units and orders that are in force at a line; inline options change them."""

    linear: str | None
    angular: str | None
    order: str | None
    stations: str | None
    distances: str | None
    dimension: str | None
    """2D or 3D: format of the lines."""
    separator: str = "-"
    multiplier: float = 1.0
    refraction: float | None = None
    add_centring: bool = False
    longitude: str | None = None
    """Sign of longitudes."""


class StarNetValues:
    """Values of lines in the conventions in force, SI units."""

    def __init__(self, source: Source, options: StarNetOptions) -> None:
        """Start with the conventions of the project."""
        self.source = source
        self.stated = options
        """Settings of the project, to which .INSTRUMENT without a name returns."""
        self.options = options
        """Settings in force."""
        self.now = self.project()
        self.missing: dict[str, int] = {}

    def project(self) -> Conventions:
        """Return the conventions of the project."""
        o = self.options
        dimension = None if o.adjustment is None else "2D" if o.adjustment == "2D" else "3D"
        return Conventions(
            o.linear,
            o.angular,
            o.order,
            o.stations,
            o.distances,
            dimension,
            refraction=o.refraction,
            longitude=o.longitude,
        )

    def demand(self, line: int, name: str) -> float:
        """Return a number of the options; note the first line that needs one not stated."""
        value = getattr(self.options, name)
        if value is None:
            self.missing.setdefault(name, line)
            return math.nan
        return float(value)

    def word(self, line: int, name: str, value: str | None) -> str:
        """Return a convention; note the first line that needs one that is not stated."""
        if value is None:
            self.missing.setdefault(name, line)
            return ""
        return value

    def note_missing(self) -> None:
        """Note the settings that lines need and nothing states."""
        for name, line in self.missing.items():
            what = f"needs the setting {name!r} of the project, which data files do not have"
            words = " or ".join(repr(word) for word in SETTING_CHOICES.get(name, ()))
            self.source.wrong(line, f"{what}: state it in options{words and f', {words}'}")

    # -- values ---------------------------------------------------------------------------------

    @property
    def metres(self) -> float:
        """Metres of the linear unit in force; 1 while it is not stated."""
        return STAR_NET_LINEAR_UNITS[(self.now.linear or "Meters").lower()] * self.now.multiplier

    def length(self, line: int, text: str, what: str, *, least: float = -math.inf) -> float:
        """Return a length, metres, of ``least`` at least."""
        self.word(line, "linear", self.now.linear)
        return self.source.field(line, text, what).number(scale=self.metres, least=least)

    def angle(self, line: int, text: str, what: str) -> float:
        """Return an angle, radians: degrees-minutes-seconds, packed D.MMSSsss, or gons."""
        unit = self.word(line, "angular", self.now.angular)
        if unit == "GONS":
            return self.source.field(line, text, what).number(scale=GON)
        return self.degrees(line, text, what)

    def degrees(self, line: int, text: str, what: str) -> float:
        """Return an angle, radians: degrees-minutes-seconds or packed D.MMSSsss in every unit."""
        match = DMS_PATTERN.fullmatch(text)
        if match is None and not PACKED_PATTERN.fullmatch(text):
            shown = f"{what} must be an angle, such as 102-34-12.5, not {text[:40]!r}"
            self.source.wrong(line, shown)
            return math.nan
        minutes = seconds = 0.0
        if match is None:
            value = self.source.field(line, text, what).number(PACKED_DEGREES)
        else:
            degrees, minutes, seconds = (float(g or 0) for g in match.groups()[1:])
            value = math.radians(degrees + minutes / 60 + seconds / 3600)
        if minutes >= 60 or seconds >= 60.5 or abs(value) > 4 * math.pi:
            self.source.wrong(
                line,
                f"{what}: {text[:40]!r} has 60 or more minutes or seconds, or is "
                "no angle of a circle",
            )
            return math.nan
        return -value if match is not None and match[1] == "-" else value

    def bearing(self, line: int, text: str, what: str) -> float:
        """Return an azimuth, radians, of a bearing such as N34-23-45E or an azimuth."""
        match = BEARING_PATTERN.fullmatch(text)
        if match is None:
            return self.angle(line, text, what) % (2 * math.pi)
        inner = self.angle(line, match[2], what)
        value = inner if match[1] in "Nn" else math.pi - inner
        return (value if match[3] in "Ee" else -value) % (2 * math.pi)

    # -- standard errors --------------------------------------------------------------------------

    def sigma(self, line: int, text: str | None, kind: str, distance: float | None = None) -> Sigma:
        """Return σ of an observation of a kind: entered, ``!``, ``*``, ``&`` or default.

        Args:
            line: its line.
            text: its standard error as written; None: the default.
            kind: setting of the options with the default, or ``slope distance``.
            distance: distance of an elevation difference, metres, where the line has it.
        """
        entered = text not in (None, "&", "*", "!")
        angular = kind in ("angle", "direction", "azimuth", "zenith")
        setting = kind.removeprefix("slope ")
        if text == "!":
            return HELD_ANGLE_SIGMA_RAD if angular else HELD_LENGTH_SIGMA_M
        if entered:
            scale = self._angular_error(line) if angular else self.metres
            field = self.source.field(line, text, f"standard error of the {setting}")
            value = field.number(scale=scale, least=0.0)
            if value == 0:
                return HELD_ANGLE_SIGMA_RAD if angular else HELD_LENGTH_SIGMA_M
            return self._centred(line, kind, value, 0.0) if self.now.add_centring else value
        out = self._default(line, kind, angular, distance)
        if text != "*":
            return out
        return (
            out.scaled(FREE_SIGMA_FACTOR)
            if isinstance(out, StandardDeviation)
            else out * FREE_SIGMA_FACTOR
        )

    def level_sigma(self, line: int, text: str | None, size: float | None) -> tuple[Sigma, float]:
        """Return σ of a levelled difference, and the length of its line, km; NaN: unknown."""
        metres = self.options.metres
        by = self.options.weight_levels_by
        if text not in (None, "&", "*"):
            length = math.nan if size is None or by == "turns" else size * self.metres / 1000.0
            return self.sigma(line, text, "level"), length
        one = self.demand(line, "level") * metres
        factor = FREE_SIGMA_FACTOR if text == "*" else 1.0
        if size is None:
            self.source.wrong(
                line, "L needs the length of the line or its number of turns, or a standard error"
            )
            return math.nan, math.nan
        if self.word(line, "weight_levels_by", by) == "turns":
            return factor * one * math.sqrt(size), math.nan
        length = size * self.metres
        unit = (KILOMETRE_METRES if metres == 1.0 else MILE_FEET) * metres
        return factor * one * math.sqrt(length / unit), length / 1000.0

    def _angular_error(self, line: int) -> float:
        unit = self.word(line, "angular", self.now.angular)
        return 1e-3 * GON if unit == "GONS" else ARCSEC

    def _default(self, line: int, kind: str, angular: bool, distance: float | None) -> Sigma:
        o = self.options
        setting = kind.removeprefix("slope ")
        constant = self.demand(line, setting)
        if angular:
            unit = self.word(line, "angular", o.angular)
            return self._centred(
                line, kind, constant * (1e-3 * GON if unit == "GONS" else ARCSEC), 0
            )
        self.word(line, "linear", o.linear)
        ppm = self.demand(line, f"{setting}_ppm")
        constant *= o.metres
        if kind == "elevation":
            if ppm > 0 and distance is None:
                self.source.wrong(
                    line,
                    "the default standard error grows with the distance, which "
                    "the line does not have: enter a standard error",
                )
            constant, ppm = constant + 1e-6 * ppm * (distance or 0.0), 0.0
        return self._centred(line, kind, constant, ppm)

    def _centred(self, line: int, kind: str, constant: float, ppm: float) -> Sigma:
        """Return σ with centring: that of heights counts for what is not horizontal.

        Args:
            line: line of the observation.
            kind: setting of the options with its default.
            constant: constant part, SI.
            ppm: part that grows with the distance.
        """
        names = {
            **dict.fromkeys(("azimuth", "level"), ()),
            "elevation": ("centring_vertical",),
            **dict.fromkeys(("zenith", "slope distance"), (*CENTRING, "centring_vertical")),
        }.get(kind, CENTRING)
        if not names:
            return constant
        parts = [self.demand(line, n) * self.options.metres for n in names]
        if any(math.isnan(v) for v in (constant, ppm, *parts)):
            return math.nan
        if not max(constant, ppm, *parts) > 0:
            self.source.wrong(line, f"the standard error of the {kind} is 0: state it in options")
            return math.nan
        if kind == "elevation":
            return math.hypot(constant, *parts, *parts)
        heights = dict.fromkeys(VERTICAL, parts[2]) if len(parts) > 2 else {}
        return StandardDeviation(constant, ppm, 0.0, parts[0], parts[1], **heights)


def apply_inline_option(values: StarNetValues, line: int, words: list[str]) -> str | None:
    """Apply an inline option; return its full name, or None if it is refused.

    Options may be abbreviated as far as they differ from others.
    """
    name, every = words[0][1:].upper(), (*APPLIED_OPTIONS, *PRINTING_OPTIONS, *REFUSED_OPTIONS)
    found = [o for o in every if o == name] or [o for o in every if name and o.startswith(name)]
    if len(found) != 1:
        valid = known((*APPLIED_OPTIONS, *PRINTING_OPTIONS), meant=name, most=40)
        values.source.wrong(line, f"inline option {words[0]!r} is unknown; valid: {valid}")
        return None
    option = found[0]
    if option in REFUSED_OPTIONS:
        values.source.wrong(
            line, f"inline option .{option} is not built: {REFUSED_OPTIONS[option]}"
        )
        return None
    if option in APPLIED_OPTIONS:
        APPLIED_OPTIONS[option](values, line, words[1:])
    return option


def _apply_nothing(values: StarNetValues, line: int, given: list[str]) -> None:
    """Change no convention: what reads the lines applies the option."""


def _apply_2d(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.dimension = "2D"


def _apply_3d(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.dimension = "3D"


def _apply_units(values: StarNetValues, line: int, given: list[str]) -> None:
    now, project = values.now, values.project()
    if not given:
        now.linear, now.angular = project.linear, project.angular
    for said in given:
        word = said.lower()
        fitting = [n for n in STAR_NET_LINEAR_UNITS if n.startswith(word)]
        linear = word if word in STAR_NET_LINEAR_UNITS else fitting[0] if fitting else ""
        sizes = {STAR_NET_LINEAR_UNITS[n] for n in fitting}
        if word.upper() in ("DMS", "GONS"):
            now.angular = word.upper()
        elif linear and (linear == word or len(sizes) == 1):
            now.linear = linear
        else:
            valid = "Meters, FeetUS, FeetInt, DMS, GONS"
            values.source.wrong(line, f".UNITS {said[:40]}: valid: {valid}")


def _apply_order(values: StarNetValues, line: int, given: list[str]) -> None:
    now, project = values.now, values.project()
    if not given:
        now.order, now.stations = project.order, project.stations
    for said in given:
        stations = {"ATFROMTO": "AtFromTo", "FROMATTO": "FromAtTo"}.get(said.upper())
        if said.upper() in ("NE", "EN"):
            now.order = said.upper()
        elif stations is not None:
            now.stations = stations
        else:
            values.source.wrong(line, f".ORDER {said}: valid: NE, EN, AtFromTo, FromAtTo")


def _is_on(values: StarNetValues, line: int, option: str, given: list[str]) -> bool | None:
    """Return whether an option is ON or OFF; None without a word, and after a problem."""
    word = " ".join(given).upper()
    field = values.source.field(line, word, option)
    return field.choice({"ON": True, "OFF": False}, default=None)


def _apply_delta(values: StarNetValues, line: int, given: list[str]) -> None:
    on = _is_on(values, line, ".DELTA", given)
    stated = values.project().distances
    values.now.distances = stated if on is None else "horizontal" if on else "slope"


def _apply_centring(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.add_centring = bool(_is_on(values, line, ".ADDCENTERING", given))


def _apply_separator(values: StarNetValues, line: int, given: list[str]) -> None:
    values.now.separator = given[0] if given and len(given[0]) == 1 else "-"


def _apply_multiplier(values: StarNetValues, line: int, given: list[str]) -> None:
    field = values.source.field(line, given[0] if given else None, ".MULTIPLIER")
    number = field.number(above=0.0, default=1.0)
    values.now.multiplier = 1.0 if math.isnan(number) else number


def _apply_refraction(values: StarNetValues, line: int, given: list[str]) -> None:
    field = values.source.field(line, given[0] if given else None, ".REFRACTION")
    number = field.number_or_none()
    values.now.refraction = values.project().refraction if number is None else number


def _apply_longitude(values: StarNetValues, line: int, given: list[str]) -> None:
    stated = values.project().longitude
    signs = {"": stated, "POS": "west positive", "NEG": "east positive"}
    said = "".join(given).upper()[:3]
    if said not in signs:
        values.source.wrong(line, f".LONGITUDE {' '.join(given)}: valid: POS (west), NEG (west)")
    values.now.longitude = signs.get(said, stated)


def _apply_level_weight(values: StarNetValues, line: int, given: list[str]) -> None:
    level = values.source.field(line, given[0] if given else None, ".LWEIGHT")
    number = level.number(above=0.0, default=math.nan)
    if number > 0:
        values.options = replace(values.options, level=number)


def _apply_instrument(values: StarNetValues, line: int, given: list[str]) -> None:
    """Apply the standard errors of an instrument; without a name those of the project."""
    level = values.options.level  # .LWEIGHT holds on
    library = {str(n).upper(): errors for n, errors in values.stated.instruments.items()}
    errors = library.get(given[0].upper()) if given else {}
    if errors is None:
        what = f".INSTRUMENT {given[0][:30]}: its standard errors are in the project of STAR*NET"
        valid = known(list(values.stated.instruments), meant=given[0]) or "none"
        values.source.wrong(line, f"{what}: state them in options, instruments; stated: {valid}")
        return
    changed: dict[str, Any] = {"level": level, **errors}
    values.options = replace(values.stated, **changed)


APPLIED_OPTIONS: dict[str, Callable[[StarNetValues, int, list[str]], None]] = {
    "UNITS": _apply_units,
    "ORDER": _apply_order,
    "DELTA": _apply_delta,
    "REFRACTION": _apply_refraction,
    "SEPARATOR": _apply_separator,
    "MULTIPLIER": _apply_multiplier,
    "ADDCENTERING": _apply_centring,
    "2D": _apply_2d,
    "3D": _apply_3d,
    "DATA": _apply_nothing,
    "LWEIGHT": _apply_level_weight,
    "INSTRUMENT": _apply_instrument,
    "LONGITUDE": _apply_longitude,
    "GPS": _apply_nothing,
}
"""Inline options that change what is read, and the functions that apply them."""
