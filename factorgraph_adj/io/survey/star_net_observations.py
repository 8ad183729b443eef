"""Observations of STAR*NET lines: values, standard errors, heights, sets, side shots, plans.

Where a line has its names alone, and no values, it is a reading to come: STAR*NET plans with it
(pre-analysis), and so does `factorgraph_adj.plan`. Its observed value is 0 until the plan computes
it from the coordinates.
"""

from __future__ import annotations

import math
from typing import Any

from ...observations import (
    Azimuth,
    Direction,
    HeightDifference,
    HorizontalAngle,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ..source import Source
from .star_net_lines import (
    ANGLE_DATA_TYPES,
    HEIGHTS_IN_2D,
    SIMPLE_DATA_TYPES,
    VALUES_MISSING,
    Sigma,
    StarNetValues,
)
from .star_net_points import SideShot, StarNetPoints, StarNetTraverse

ERROR_CODES = frozenset("!&*")
"""Codes of standard errors."""
TO_COME = ""
"""Text of the value of a reading to come."""


class StarNetObservations:
    """The observations of the lines so far."""

    def __init__(self, source: Source, values: StarNetValues, points: StarNetPoints) -> None:
        """Start without observations.

        Args:
            source: the files.
            values: values of lines in the conventions in force.
            points: points of the files.
        """
        self.source = source
        self.values = values
        self.points = points
        self.observations: list[Observation] = []
        self.side_shots: list[SideShot] = []
        self.refractions: dict[str, float] = {}
        """Coefficient of refraction of STAR*NET by refraction group."""
        self.meant: dict[str, str] = {}
        """What an azimuth counts from, or where a horizontal distance is, by file and line."""
        self.to_come: list[int] = []
        """Lines without values."""
        self.set_at: tuple[str, str] | None = None
        """Station and number of the set of directions that is being read."""
        self.set_begun = 1
        self.sets: dict[str, int] = {}
        self.traverse = StarNetTraverse(values, points, self._observe, self._add)

    def finish(self) -> None:
        """Note the set and the traverse that have no end."""
        if self.set_at is not None:
            what = f"the set of directions at {self.set_at[0]!r} has no end (DE)"
            self.source.wrong(self.set_begun, what)
        if self.traverse.stations is not None:
            self.source.wrong(self.traverse.begun, "the last traverse has no end (TE)")

    def simple(self, line: int, code: str, words: list[str]) -> None:
        """Read a line of observations between the points that its first word names."""
        names = self.names(line, code, words, 3 if code in ANGLE_DATA_TYPES else 2)
        if names:
            observe = self._side_shot if code == "SS" else self._observe
            observe(line, code, names, words[1:])

    def names(self, line: int, code: str, words: list[str], count: int) -> list[str]:
        """Return the names that the first word joins, at, from and to; none after a problem."""
        names = words[0].split(self.values.now.separator) if words else []
        if len(names) != count or not all(n.isprintable() and n for n in names):
            order = self.values.now.stations if count == 3 else "From-To"
            what = f"{code} begins with {count} names, {order or 'At-From-To'}, joined by "
            what += f"{self.values.now.separator!r}, not {words[0][:40] if words else ''!r}"
            self.source.wrong(line, what)
            return []
        if count == 3:
            order = self.values.word(line, "stations", self.values.now.stations)
            if order == "FromAtTo":
                names = [names[1], names[0], names[2]]
        names = [self.values.canonical(n) for n in names]
        if len(set(names)) < len(names):
            self.source.wrong(line, f"{code} joins a point to itself: {words[0][:40]}")
            return []
        return names

    def level(self, line: int, code: str, words: list[str]) -> None:
        """Read an L line."""
        names = self.names(line, code, words, 2)
        rest = words[1:]
        if not names or not 1 <= len(rest) <= 3:
            if names:
                self.source.wrong(
                    line,
                    "L takes From-To, the difference, its length or turns, and a standard error",
                )
            return
        if self.values.options.adjustment == "2D":
            self.source.leave_out(line, HEIGHTS_IN_2D, "-".join(names))
            return
        value = self.values.length(line, rest[0], "L difference")
        size = None
        if len(rest) > 1:
            size = self.source.field(line, rest[1], "length or turns of L").number(above=0.0)
            if math.isnan(size):
                return
        sigma, km = self.values.level_sigma(line, rest[2] if len(rest) > 2 else None, size)
        self.points.use(line, *names)
        self._add(
            line, HeightDifference, names, value, sigma, length_km=None if math.isnan(km) else km
        )

    def of_set(self, line: int, code: str, words: list[str]) -> None:
        """Read a DB, DN, DM or DE line."""
        if code == "DB":
            if self.set_at is not None:
                self.source.wrong(line, f"DB within the set of {self.set_at[0]!r}: DE is missing")
            if len(words) != 1:
                self.source.wrong(line, "DB takes the name of the station")
                return
            station = self.values.canonical(words[0])
            self.sets[station] = self.sets.get(station, 0) + 1
            self.set_at, self.set_begun = (station, str(self.sets[station])), line
        elif self.set_at is None:
            self.source.wrong(line, f"{code} without DB: a set of directions begins with DB")
        elif code == "DE":
            if words:
                self.source.wrong(line, f"DE takes no words, not {' '.join(words)[:40]!r}")
            self.set_at = None
        elif not words or self.values.canonical(words[0]) == self.set_at[0]:
            self.source.wrong(
                line, f"{code} takes the name of another station than that of the set"
            )
        else:
            self._observe(line, code, [self.set_at[0], self.values.canonical(words[0])], words[1:])

    def _observe(
        self,
        line: int,
        code: str,
        names: list[str],
        words: list[str],
        azimuth: float | None = None,
    ) -> None:
        """Observe what a line has: its values, standard errors and heights."""
        kinds = list(SIMPLE_DATA_TYPES[code])
        project = self.values.options.adjustment
        flat = self.values.now.dimension == "2D"
        if flat and "vertical" in kinds:
            kinds.remove("vertical")
            if not kinds:
                self.source.wrong(line, f"{code} has no place among 2D data")
                return
        heights = [0.0, 0.0]
        if words and "/" in words[-1]:
            hi, _, ht = words[-1].partition("/")
            heights = [self.values.length(line, t, "HI/HT") for t in (hi, ht)]
            words = words[:-1]
        n = len(kinds)
        if not words or (len(words) == n and ERROR_CODES.issuperset(words)):
            words = [""] * n + words
            self.to_come.append(line)
        if len(words) not in (n, 2 * n):
            what = f"{code} takes {', '.join(kinds)}, then no or {n} standard errors and HI/HT"
            self.source.wrong(line, f"{what}, not {len(words)} values")
            return
        errors: list[str | None] = [*words[n:]] or [None] * n
        given = {k: (v, s) for k, v, s in zip(kinds, words[:n], errors, strict=True)}
        ends = [names[0], names[-1]]
        self.points.use(line, *names)
        reverse = self._in_reverse(line, given)
        for kind, (text, error) in given.items():
            if text == "?":
                self.source.leave_out(line, VALUES_MISSING, f"{kind} {'-'.join(names)}")
                continue
            if kind in ("angle", "direction", "bearing"):
                self._horizontal(line, kind, names, text, error, azimuth, reverse)
            elif kind == "distance":
                self._distance(line, ends, given, flat or project == "2D", heights)
            elif project != "2D":
                self._vertical(line, ends, given, heights)
            elif "distance" not in given:
                self.source.leave_out(line, HEIGHTS_IN_2D, "-".join(names))

    def _side_shot(self, line: int, code: str, names: list[str], words: list[str]) -> None:
        """Keep the observations of an SS line, and its target, apart from those of the network."""
        stated, before = names[-1] in self.points.points, len(self.observations)
        self._observe(line, code, names, words)
        made = tuple(self.observations[before:])
        del self.observations[before:]
        if not stated:
            self.points.points.pop(names[-1], None)
        if made:
            self.side_shots.append(SideShot(line, names[-1], made))

    def _in_reverse(self, line: int, given: dict[str, tuple[str, str | None]]) -> bool:
        """Return whether the zenith angle of a line shows that its circles were read in face 2."""
        text = given.get("vertical", ("?", None))[0]
        if text in ("?", TO_COME) or self._mode(line) == "horizontal":
            return False
        return self.values.angle(line, text, "zenith angle") > math.pi

    def _horizontal(
        self,
        line: int,
        kind: str,
        names: list[str],
        text: str,
        error: str | None,
        azimuth: float | None,
        reverse: bool,
    ) -> None:
        """Observe an angle, direction or bearing; in reverse a direction is turned by 180°.

        An angle is the difference of two readings in one face, and the same in both.
        """
        turn = 2 * math.pi
        if kind == "bearing":
            value = 0.0 if text == TO_COME else self.values.bearing(line, text, kind)
            self._add(line, Azimuth, names, value, self.values.sigma(line, error, "azimuth"))
            return
        value = 0.0 if text == TO_COME else self.values.angle(line, text, kind)
        sigma = self.values.sigma(line, error, kind)
        if kind == "direction":
            number = self.set_at[1] if self.set_at else "1"
            value += math.pi if reverse else 0.0
            self._add(line, Direction, names, value % turn, sigma, set=number)
        elif len(names) == 2:
            self._add(line, Azimuth, names, (value + (azimuth or 0.0)) % turn, sigma)
        else:
            self._add(line, HorizontalAngle, names, value % turn, sigma)

    def _distance(
        self,
        line: int,
        ends: list[str],
        given: dict[str, tuple[str, str | None]],
        flat: bool,
        heights: list[float],
    ) -> None:
        text, error = given["distance"]
        value = self._length(line, text, "distance")
        in_space = self.values.now.dimension != "2D"
        sloping = in_space and self._mode(line) != "horizontal"
        reduced = flat or not sloping
        sigma = self.values.sigma(line, error, "distance" if reduced else "slope distance")
        scale = self.values.now.scale
        zenith = given.get("vertical", ("?", None))[0]
        if not sloping:
            self._add(line, HorizontalDistance, ends, value * scale, sigma)
        elif zenith == "?" and (flat or scale != 1.0):
            where = "in a 2D project" if flat else f"with the scale factor {scale:g}"
            self.source.wrong(line, f"a slope distance needs its zenith angle {where}")
        elif flat:
            value *= scale * math.sin(self._zenith(line, zenith))
            self._add(line, HorizontalDistance, ends, abs(value), sigma)
        else:
            if scale != 1.0:
                z = self._zenith(line, zenith)
                value *= math.hypot(scale * math.sin(z), math.cos(z))
            self._add(line, SlopeDistance, ends, value, sigma, heights)

    def _vertical(
        self,
        line: int,
        ends: list[str],
        given: dict[str, tuple[str, str | None]],
        heights: list[float],
    ) -> None:
        text, error = given["vertical"]
        if self._mode(line) == "horizontal":
            value = self._length(line, text, "elevation difference")
            far = given.get("distance", ("?", None))[0]
            distance = None if far == "?" else self._length(line, far, "distance")
            sigma = self.values.sigma(line, error, "elevation", distance)
            self._add(line, HeightDifference, ends, value, sigma, heights)
            return
        value = self._zenith(line, text)
        value = 2 * math.pi - value if value > math.pi else value
        scale = self.values.now.scale
        if scale != 1.0:
            # The scale acts on horizontal lengths: tan z becomes k tan z.
            value = math.atan2(scale * math.sin(value), math.cos(value))
        sigma = self.values.sigma(line, error, "zenith")
        coefficient = self.values.now.refraction
        if coefficient is None:
            coefficient = self.values.demand(line, "refraction")
        group = "" if coefficient == self.values.options.refraction else f"{coefficient:g}"
        self.refractions[group] = coefficient
        self._add(line, ZenithAngle, ends, value, sigma, heights, refraction=group or None)

    def _length(self, line: int, text: str, what: str) -> float:
        """Return a length, metres; 0 of a reading to come."""
        return 0.0 if text == TO_COME else self.values.length(line, text, what)

    def _zenith(self, line: int, text: str) -> float:
        """Return a zenith angle, radians; a right angle of a reading to come."""
        return math.pi / 2 if text == TO_COME else self.values.angle(line, text, "zenith angle")

    def _mode(self, line: int) -> str:
        return self.values.word(line, "distances", self.values.now.distances)

    def _add(
        self,
        line: int,
        kind: Any,
        names: list[str],
        value: float,
        sigma: Sigma,
        heights: list[float] | None = None,
        **further: Any,
    ) -> None:
        """Add an observation, unless a number of it is missing and noted."""
        if kind in (Azimuth, HorizontalDistance):
            now = self.values.now
            self.meant[self.source.place(line)] = now.bearings if kind is Azimuth else now.lengths
        numbers = (value, sigma if isinstance(sigma, float) else 0.0, *(heights or ()))
        if any(math.isnan(v) for v in numbers):
            return
        if heights:
            further |= {"instrument_height": heights[0], "target_height": heights[1]}
        made = self.source.attempt(
            line,
            lambda: kind(*names, value, sigma=sigma, source=self.source.place(line), **further),
        )
        self.observations += [made] if made is not None else []
