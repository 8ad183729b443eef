"""Points of STAR*NET data, side shots, traverses, and GPS vectors with their weights.

A side shot bears on no other point. Every SS line therefore makes a point of its own, with as many
observations as coordinates: it has no redundancy, so that an adjustment gives it exactly the place
and the covariance that follow from the adjusted station, backsight and readings, and gives all
others what it would without it.

Traverses are TB, T and TE lines: angles, azimuths and measurements.

GPS vectors are G0 to G3 lines, weighted by .GPS options. A vector is G1 with the names and
ΔX, ΔY, ΔZ, geocentric metres whatever the unit of the project, G2 with the variances (or standard
errors) of X, Y, Z and G3 with the covariances (or correlations) XY, XZ, YZ. G0 is a comment.

Source: STAR*NET-PRO V6, Professional Edition Supplement; order of G3:
the converter of MicroSurvey from GeoLab; meaning of the factors: listing of STAR*NET-PRO 13.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from ...network.network import Network
from ...observations import Azimuth, GnssVector, HorizontalAngle, Observation
from ...observations.base import joined_points
from ...types import Array
from ..source import Source, is_unread
from .star_net_lines import BEARING_PATTERN, DMS_PATTERN, HELD_LENGTH_SIGMA_M, StarNetValues
from .star_net_options import StarNetOptions

WEIGHT_FORMS = ("COVARIANCE", "STDERRCORRELATION", "STDERRORS")
"""What G2 and G3 hold: variances and covariances, standard errors and correlations, or standard
errors alone."""
REFUSED_GPS_OPTIONS = {
    "CENTERING": "add the centring to the standard errors",
    "ADDHIHT": "reduce the vectors to the marks",
    "NETWORK": "every vector takes part in the adjustment",
    "SIDESHOT": "every vector takes part in the adjustment",
    "USE": "every vector takes part in the adjustment",
    "FREE": "set vectors aside by snoop",
    "TRANSFORM": "rotations and scales of vectors are unknowns of frames, see add_frame",
    "DEFAULT": "enter G2 and G3 for every vector",
}
"""Words of .GPS that are not built, and what to do."""
AXIS_BY_LETTER = {"E": 0, "N": 1, "Z": 2}


@dataclass
class StarNetVector:
    """A vector as its lines state it."""

    line: int
    """Line of G1."""
    names: list[str]
    """From and to."""
    value: list[float]
    """ΔX, ΔY, ΔZ, metres."""
    weight: str
    """What G2 and G3 hold."""
    factors: tuple[float, float]
    """Factors of the horizontal and the vertical standard errors."""
    diagonal: list[float] = field(default_factory=list)
    """Numbers of G2."""
    corners: list[float] = field(default_factory=list)
    """Numbers of G3: XY, XZ, YZ."""

    def covariance(self) -> Array:
        """Return the covariance, (3, 3) metres², without the factors."""
        xx, yy, zz = self.diagonal
        xy, xz, yz = self.corners or (0.0, 0.0, 0.0)
        matrix = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        if self.weight == "COVARIANCE":
            return matrix
        sigma = np.array(self.diagonal)
        correlation = matrix.copy()
        np.fill_diagonal(correlation, 1.0)
        return np.asarray(correlation * np.outer(sigma, sigma))


class StarNetVectors:
    """The vectors of the files, and the options in force."""

    def __init__(self, source: Source, options: StarNetOptions) -> None:
        """Start without vectors."""
        self.source = source
        self.vectors: list[StarNetVector] = []
        self.weight = "COVARIANCE"
        self.factors = (options.gps_factor, options.gps_factor_vertical)

    def state(self) -> tuple[str, tuple[float, float]]:
        """Return what .GPS changes, to be restored behind an included file."""
        return self.weight, self.factors

    def restore(self, state: tuple[str, tuple[float, float]]) -> None:
        """Restore what `state` returned."""
        self.weight, self.factors = state

    def option(self, line: int, words: list[str]) -> None:
        """Apply the words behind .GPS."""
        word = words[0].upper() if words else ""
        if word == "WEIGHT" and len(words) == 2:
            found = [w for w in WEIGHT_FORMS if w.startswith(words[1].upper())]
            if len(found) == 1:
                self.weight = found[0]
                return
            self.source.wrong(
                line, f".GPS WEIGHT {words[1][:30]}: valid: {', '.join(WEIGHT_FORMS)}"
            )
        elif word == "FACTOR" and (len(words) <= 2 or (len(words) == 4 and _vertical(words[2]))):
            fields = [self.source.field(line, w, "factor of .GPS") for w in words[1::2] or ("1",)]
            given = [f.number(above=0.0) for f in fields]
            if not is_unread(*given):
                self.factors = given[0], given[-1]
        elif word in REFUSED_GPS_OPTIONS:
            self.source.wrong(line, f".GPS {word} is not built: {REFUSED_GPS_OPTIONS[word]}")
        else:
            shown = " ".join(words)[:40]
            valid = "WEIGHT with one word, FACTOR f, FACTOR f VERT v"
            self.source.wrong(line, f".GPS {shown} is unknown; valid: {valid}")

    def vector(self, line: int, names: list[str], words: list[str]) -> None:
        """Begin a vector: the words of a G1 line behind its names."""
        if len(words) != 3:
            self.source.wrong(line, f"G1 takes From-To, ΔX, ΔY and ΔZ, not {len(words)} numbers")
        value = [self.source.field(line, w, "component of G1").number() for w in words[:3]]
        self.vectors.append(
            StarNetVector(line, names, (value + [0.0] * 3)[:3], self.weight, self.factors)
        )

    def weights(self, line: int, code: str, words: list[str]) -> None:
        """Add a G2 or G3 line to the vector before it."""
        if not self.vectors or (self.vectors[-1].diagonal and code == "G2"):
            self.source.wrong(line, f"{code} without G1: it belongs to the vector before it")
            return
        last = self.vectors[-1]
        if len(words) != 3:
            self.source.wrong(line, f"{code} takes three numbers, not {len(words)}")
            return
        what = "covariance" if last.weight == "COVARIANCE" else "correlation"
        if code == "G2":
            what = "variance" if last.weight == "COVARIANCE" else "standard error"
        fields = [self.source.field(line, w, f"{what} of {code}") for w in words]
        numbers = [f.number(above=0.0 if code == "G2" else -math.inf) for f in fields]
        if code == "G2":
            last.diagonal = numbers
        elif last.corners or not last.diagonal:
            self.source.wrong(line, "G3 follows G2 of its vector")
        else:
            last.corners = numbers

    def check(self) -> None:
        """Note the vectors that lack a line, or whose covariance is none."""
        for v in self.vectors:
            if not v.diagonal:
                self.source.wrong(v.line, "the vector has no G2 line, its variances")
            elif not v.corners and v.weight != "STDERRORS":
                what = f"the vector has no G3 line, which {v.weight} needs"
                self.source.wrong(v.line, f"{what}; valid without: .GPS WEIGHT STDERRORS")
            elif all(math.isfinite(n) for n in (*v.diagonal, *v.corners)):
                values = np.linalg.eigvalsh(v.covariance())
                if not values.min() > 0.0:
                    what = "G2 and G3 are no covariance: a combination has no positive variance"
                    self.source.wrong(v.line, what)

    def observations(self, horizon: Callable[[list[str]], Array]) -> list[GnssVector]:
        """Return the vectors with their covariances, geocentric.

        Factors f and v multiply standard errors along the horizon and up:
        C' = (Eᵀ F E) C (Eᵀ F E), F = diag(f, f, v) and rows E of east, north, up.

        Args:
            horizon: returns the rows E (n, 3, 3) at stations, geocentric.
        """
        out = []
        turns = horizon([v.names[0] for v in self.vectors])
        for v, e in zip(self.vectors, turns, strict=True):
            f, up = v.factors
            scale = e.T @ np.diag([f, f, up]) @ e
            covariance = scale @ v.covariance() @ scale
            made = self.source.attempt(
                v.line,
                GnssVector,
                *v.names,
                tuple(v.value),
                covariance=(covariance + covariance.T) / 2.0,
                source=self.source.place(v.line),
            )
            if isinstance(made, GnssVector):
                out.append(made)
        return out


def _vertical(word: str) -> bool:
    return "VERTICAL".startswith(word.upper()) and word.upper().startswith("V")


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

    def __init__(self, values: StarNetValues) -> None:
        """Start without points."""
        self.given = values
        self.points: dict[str, StarNetPoint] = {}

    def use(self, line: int, *names: str) -> None:
        """Note points that a line observes."""
        for name in names:
            if self.given.source.field(line, name, "point").name():
                self.points.setdefault(name, StarNetPoint(line))

    def coordinates(self, line: int, code: str, words: list[str]) -> None:
        """Read the words of a C or CH line: name, coordinates, standard errors."""
        flat = self.given.now.dimension == "2D"
        order = self.given.word(line, "order", self.given.now.order) or "NE"
        axes = [*order] if flat or self.given.options.adjustment == "LEV" else [*order, "Z"]
        if self.given.options.adjustment == "LEV" and not flat and len(words) >= 4:
            axes = [*order, "Z"]
        self._state(line, words, axes, code)

    def elevation(self, line: int, code: str, words: list[str]) -> None:
        """Read the words of an E or EH line: name, elevation, standard error."""
        self._state(line, words, ["Z"], code)

    def position(self, line: int, code: str, words: list[str]) -> None:
        """Read the words of a P or PH line: name, latitude, longitude, height, standard errors.

        Standard errors are those of north, east and up in the linear unit.
        """
        flat = self.given.now.dimension == "2D"
        self._state(line, words, ["N", "E"] if flat else ["N", "E", "Z"], code)

    def _state(self, line: int, words: list[str], axes: list[str], code: str) -> None:
        source, n = self.given.source, len(axes)
        if not n + 1 <= len(words) <= 2 * n + 1:
            what = f"{code} takes a name, {n} coordinates and up to {n} standard errors"
            source.wrong(line, f"{what}, not {len(words)} words")
            return
        words = [self.given.canonical(words[0]), *words[1:]]
        self.use(line, words[0])
        point = self.points.get(words[0], StarNetPoint(line))
        if code in ("P", "PH"):
            self._geodetic(line, point, words)
        if "Z" in axes:
            point.ellipsoidal = code.endswith("H")
        for i, axis in enumerate(axes):
            k = AXIS_BY_LETTER[axis]
            text = words[1 + n + i] if len(words) > 1 + n + i else "*"
            if code in ("P", "PH") and axis != "Z":
                point.sigmas[k] = self._sigma(line, text, f"{code} {axis}")
                continue
            value = self.given.length(line, words[1 + i], f"{code} {axis}")
            if abs(point.values[k] - value) > HELD_LENGTH_SIGMA_M:
                what = f"{axis} of {words[0]!r} differs from that of line {point.line}"
                source.wrong(line, what)
            point.values[k] = value
            point.sigmas[k] = self._sigma(line, text, f"{code} {axis}")

    def _geodetic(self, line: int, point: StarNetPoint, words: list[str]) -> None:
        latitude = self.given.degrees(line, words[1], "latitude")
        longitude = self.given.degrees(line, words[2], "longitude")
        if not abs(latitude) <= math.pi / 2 or not abs(longitude) <= 2 * math.pi:
            if math.isfinite(latitude) and math.isfinite(longitude):
                self.given.source.wrong(
                    line, "latitudes are within 90, longitudes within 360 degrees"
                )
            return
        sign = self.given.word(line, "longitude", self.given.now.longitude)
        at = latitude, -longitude if sign == "west positive" else longitude
        if point.geodetic is not None and at != point.geodetic:
            self.given.source.wrong(line, f"{words[0]!r} has another position in line {point.line}")
        point.geodetic = at

    def _sigma(self, line: int, text: str, what: str) -> float:
        if text == "!":
            return 0.0
        if text in ("*", "&"):
            return math.inf
        return self.given.length(line, text, f"standard error of {what}", least=0.0)

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


@dataclass(frozen=True)
class SideShot:
    """An SS line."""

    line: int
    """Its line."""
    target: str
    """Name of the point in the line."""
    observations: tuple[Observation, ...]
    """What it observes."""

    def named(self, name: str) -> list[Observation]:
        """Return its observations to a point of another name."""
        if name == self.target:
            return list(self.observations)
        ends = ("target", "target2")
        return [
            replace(o, **{e: name for e in ends if getattr(o, e, None) == self.target})
            for o in self.observations
        ]


def placed_side_shots(
    shots: Iterable[SideShot], points: StarNetPoints, others: Iterable[Observation]
) -> list[Observation]:
    """Add a point for each side shot; return the observations of them all.

    The point has its name in the line. Where other lines observe, hold or weight that point, or
    another side shot gave it, a number is added (``X.2``): a side shot checks nothing.
    """
    taken = joined_points(others)
    taken |= {n for n, p in points.points.items() if any(s < float("inf") for s in p.sigmas)}
    shots = list(shots)
    named = {s.target for s in shots}
    out: list[Observation] = []
    for shot in shots:
        name, number = shot.target, 1
        while name in taken or (number > 1 and (name in points.points or name in named)):
            number += 1
            name = f"{shot.target}.{number}"
        taken.add(name)
        point = points.points.setdefault(name, StarNetPoint(shot.line))
        point.side_shot = True
        out += shot.named(name)
    return out


class StarNetTraverse:
    """The traverse that is being read, if there is one."""

    def __init__(
        self,
        values: StarNetValues,
        points: StarNetPoints,
        observe: Callable[..., None],
        add: Callable[..., None],
    ) -> None:
        """Start outside of a traverse.

        Args:
            values: reads the words of lines.
            points: points of the file.
            observe: observes a T line: its number, data type, names and words.
            add: adds an observation: line, kind, names, value, standard deviation.
        """
        self.values = values
        self.points = points
        self.observe = observe
        self.add = add
        self.stations: list[str] | None = None
        """Stations so far, the backsight first; None: outside of a traverse."""
        self.begun = 1
        """Line of its TB."""
        self.backsight: float | None = None
        """Bearing of TB, radians; None: its backsight is a station."""
        self.pending: tuple[int, str, list[str]] | None = None
        """Last T line, whose target is not known yet: its number, station and words."""

    def read(self, line: int, code: str, words: list[str]) -> None:
        """Read a TB, T or TE line."""
        if code == "TB":
            if self.stations is not None:
                self.values.source.wrong(line, "TB within a traverse: TE is missing")
            self.stations, self.backsight, self.pending, self.begun = [], None, None, line
            if len(words) != 1:
                self.values.source.wrong(line, "TB takes the backsight, a station or a bearing")
            elif BEARING_PATTERN.fullmatch(words[0]) or DMS_PATTERN.fullmatch(words[0]):
                self.backsight = self.values.bearing(line, words[0], "bearing of TB")
            else:
                self.stations.append(self.values.canonical(words[0]))
            return
        if self.stations is None:
            self.values.source.wrong(line, f"{code} without TB: a traverse begins with TB")
            return
        if not words:
            self.values.source.wrong(line, f"{code} takes the name of the station")
            return
        words = [self.values.canonical(words[0]), *words[1:]]
        self._leg(words[0])
        self.stations.append(words[0])
        if code == "T":
            self.pending = (line, words[0], words[1:])
            return
        if len(words) > 1:
            self._closing(line, words)
        self.stations = self.pending = None

    def _leg(self, to: str) -> None:
        """Observe the last T line, whose target is known now."""
        if self.pending is None or self.stations is None:
            return
        line, at, words = self.pending
        if to == at:
            self.values.source.wrong(line, f"T joins {at!r} to itself")
        elif len(self.stations) > 1:
            self.observe(line, "T", [at, self.stations[-2], to], words)
        elif words:
            # The backsight is a bearing: the angle from it is an azimuth.
            self.observe(line, "T", [at, to], words, azimuth=self.backsight)

    def _closing(self, line: int, words: list[str]) -> None:
        """Observe the closing angle of a TE line."""
        at, back = words[0], (self.stations or ["", ""])[-2:][0]
        if len(words) not in (3, 4) or len(self.stations or []) < 2:
            self.values.source.wrong(
                line, "TE takes the station, and a closing angle with the foresight"
            )
            return
        angle = self.values.angle(line, words[1], "closing angle")
        sigma = self.values.sigma(line, words[3] if len(words) > 3 else None, "angle")
        self.points.use(line, at, back)
        if BEARING_PATTERN.fullmatch(words[2]):
            value = self.values.bearing(line, words[2], "closing bearing") - angle
            self.add(line, Azimuth, [at, back], value % (2 * math.pi), sigma)
            return
        words = [*words[:2], self.values.canonical(words[2]), *words[3:]]
        self.points.use(line, words[2])
        self.add(line, HorizontalAngle, [at, back, words[2]], angle % (2 * math.pi), sigma)
