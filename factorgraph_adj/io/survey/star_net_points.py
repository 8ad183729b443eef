"""Points of STAR*NET data: coordinates, fixed and weighted components."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from ...network.network import Network
from .star_net_lines import HELD_LENGTH, Values

AXES = {"E": 0, "N": 1, "Z": 2}


@dataclass
class StarNetPoint:
    """A point as all its lines state it."""

    line: int
    values: list[float] = field(default_factory=lambda: [math.nan] * 3)
    """East, north, elevation, metres."""
    sigmas: list[float] = field(default_factory=lambda: [math.inf] * 3)
    """0: fixed, infinite: free."""
    ellipsoidal: bool = False
    """Whether the height is above the ellipsoid."""
    geodetic: tuple[float, float] | None = None
    """Latitude and longitude, radians; None: not stated."""
    side_shot: bool = False
    """Whether an SS line gives the point."""


class StarNetPoints:
    """The points of a file."""

    def __init__(self, values: Values) -> None:
        """Start without points."""
        self.given = values
        self.points: dict[str, StarNetPoint] = {}

    def use(self, line: int, *names: str) -> None:
        """Note points that a line observes."""
        for name in names:
            if self.given.notes.name(line, name, "a point"):
                self.points.setdefault(name, StarNetPoint(line))

    def coordinates(self, line: int, words: list[str], code: str = "C") -> None:
        """Read the words of a C or CH line: name, coordinates, standard errors."""
        flat = self.given.now.dimension == "2D"
        order = self.given.word(line, "order", self.given.now.order) or "NE"
        axes = [*order] if flat or self.given.options.adjustment == "LEV" else [*order, "Z"]
        if self.given.options.adjustment == "LEV" and not flat and len(words) >= 4:
            axes = [*order, "Z"]
        self._state(line, words, axes, code)

    def elevation(self, line: int, words: list[str], code: str = "E") -> None:
        """Read the words of an E or EH line: name, elevation, standard error."""
        self._state(line, words, ["Z"], code)

    def position(self, line: int, words: list[str], code: str) -> None:
        """Read the words of a P or PH line: name, latitude, longitude, height, standard errors.

        Standard errors are those of north, east and up in the linear unit.
        """
        flat = self.given.now.dimension == "2D"
        self._state(line, words, ["N", "E"] if flat else ["N", "E", "Z"], code)

    def _state(self, line: int, words: list[str], axes: list[str], code: str) -> None:
        notes, n = self.given.notes, len(axes)
        if not n + 1 <= len(words) <= 2 * n + 1:
            what = f"{code} takes a name, {n} coordinates and up to {n} standard errors"
            notes.add(line, f"{what}, not {len(words)} words")
            return
        self.use(line, words[0])
        point = self.points.get(words[0], StarNetPoint(line))
        if code in ("P", "PH"):
            self._geodetic(line, point, words)
        if "Z" in axes:
            point.ellipsoidal = code.endswith("H")
        for i, axis in enumerate(axes):
            k = AXES[axis]
            text = words[1 + n + i] if len(words) > 1 + n + i else "*"
            if code in ("P", "PH") and axis != "Z":
                point.sigmas[k] = self._sigma(line, text, f"{code} {axis}")
                continue
            value = self.given.length(line, words[1 + i], f"{code} {axis}")
            if abs(point.values[k] - value) > HELD_LENGTH:
                what = f"{axis} of {words[0]!r} differs from that of line {point.line}"
                notes.add(line, what)
            point.values[k] = value
            point.sigmas[k] = self._sigma(line, text, f"{code} {axis}")

    def _geodetic(self, line: int, point: StarNetPoint, words: list[str]) -> None:
        latitude = self.given.degrees(line, words[1], "latitude")
        longitude = self.given.degrees(line, words[2], "longitude")
        if not abs(latitude) <= math.pi / 2 or not abs(longitude) <= 2 * math.pi:
            if math.isfinite(latitude) and math.isfinite(longitude):
                self.given.notes.add(line, "latitudes are within 90, longitudes within 360 degrees")
            return
        sign = self.given.word(line, "longitude", self.given.now.longitude)
        at = latitude, -longitude if sign == "west positive" else longitude
        if point.geodetic is not None and at != point.geodetic:
            self.given.notes.add(line, f"{words[0]!r} has another position in line {point.line}")
        point.geodetic = at

    def _sigma(self, line: int, text: str, what: str) -> float:
        if text == "!":
            return 0.0
        if text in ("*", "&"):
            return math.inf
        value = self.given.length(line, text, f"standard error of {what}")
        if value < 0:
            self.given.notes.add(line, f"standard error of {what} must be ≥ 0, not {text}")
        return value

    def add_to(self, network: Network, adjustment: str, elevation: float = 0.0) -> None:
        """Add the points: of a 2D project with z held at its elevation, of LEV with x, y held."""
        for name, p in self.points.items():
            values, sigmas = list(p.values), list(p.sigmas)
            held = {"2D": "z", "LEV": "xy"}.get(adjustment, "")
            for axis in held:
                k = "xyz".index(axis)
                sigmas[k] = 0.0
                if adjustment == "2D" or math.isnan(values[k]):
                    values[k] = elevation if axis == "z" else 0.0
            fixed = "".join(a for a, s in zip("xyz", sigmas, strict=True) if s == 0.0)
            weights = [s if s > 0 else math.inf for s in sigmas]
            weighted = any(math.isfinite(s) for s in weights)
            network.add_point(
                name,
                values,
                fixed=fixed,
                sigma=weights if weighted else None,
                side_shot=p.side_shot,
            )

    def anything_held(self, adjustment: str) -> bool:
        """Return whether a component is fixed or weighted beside those that a project holds."""
        count = {"2D": (0, 1), "LEV": (2,)}.get(adjustment, (0, 1, 2))
        return any(math.isfinite(p.sigmas[k]) for p in self.points.values() for k in count)
