"""Lines of STAR*NET data: values and standard errors in force, and the inline options."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace

from ...network.grid.transformation import Azimuths, Distances
from ...observations.variances import CENTRING
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

HELD_LENGTH_SIGMA_M = 1e-5
"""Distance up to which coordinates of a point in two lines are the same."""
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
    bearings: Azimuths = "grid"
    """What azimuths count from, in a grid."""
    lengths: Distances = "measured"
    """Where horizontal distances are, in a grid."""
    scale: float = 1.0
    """Factor of horizontal lengths, in a local project."""


class StarNetValues:
    """Values of lines in the conventions in force, SI units."""

    def __init__(
        self,
        source: Source,
        options: StarNetOptions,
        *,
        bearings: Azimuths = "grid",
        lengths: Distances = "measured",
    ) -> None:
        """Start with the conventions of the project."""
        self.bearings = bearings
        self.lengths = lengths
        self.aliases: dict[str, str] = {}
        """Names of points by their other names."""
        self.changed_ends: list[tuple[str, str, str]] = []
        """PREFIX or SUFFIX, the end of a name and what stands in its place."""
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
            bearings=self.bearings,
            lengths=self.lengths,
            scale=o.scale,
        )

    def state(self) -> tuple[Conventions, StarNetOptions]:
        """Return what inline options change, to be restored behind an included file."""
        return replace(self.now), self.options

    def restore(self, state: tuple[Conventions, StarNetOptions]) -> None:
        """Restore what `state` returned."""
        self.now, self.options = replace(state[0]), state[1]

    def canonical(self, name: str) -> str:
        """Return the name of a point that has other names (.ALIAS)."""
        name = self.aliases.get(name, name)
        for where, end, other in self.changed_ends:
            if where == "PREFIX" and name.startswith(end):
                name = other + name.removeprefix(end)
            elif where == "SUFFIX" and name.endswith(end):
                name = name.removesuffix(end) + other
        return name

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
        fixed = self.stated.fixed_angle * ARCSEC if angular else self.stated.fixed_length
        if text == "!":
            return fixed
        if entered:
            scale = self._angular_error(line) if angular else self.metres
            field = self.source.field(line, text, f"standard error of the {setting}")
            value = field.number(scale=scale, least=0.0)
            if value == 0:
                return fixed
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
        height = parts[2] if len(parts) > 2 else None
        return StandardDeviation(
            constant,
            ppm,
            0.0,
            parts[0],
            parts[1],
            vertical_instrument=height,
            vertical_target=height,
        )
