"""Reader of data files of STAR*NET: data lines, sets and side shots as observations.

Format: STAR*NET V6, Reference Manual, chapter 5, "Preparing Input Data"; MicroSurvey, help desk,
article 1120, "STAR*NET data types".
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem, known
from ...network.grid.transformation import Azimuths, Distances
from ...network.network import Network
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
from ..format_reader import NetworkReader, Reader
from ..source import Source, TextSource
from .star_net_lines import (
    ANGLE_DATA_TYPES,
    GRID_DATA_TYPES,
    HEIGHTS_IN_2D,
    LINES_BEHIND_DATA_OFF,
    REFUSED_DATA_TYPES,
    SIMPLE_DATA_TYPES,
    VALUES_MISSING,
    Sigma,
    StarNetValues,
    apply_inline_option,
)
from .star_net_network import (
    StarNetContent,
    grid_network,
    local_network,
    set_grid_coordinates,
    star_net_grid_system,
)
from .star_net_options import SETTING_CHOICES, StarNetOptions, star_net_options
from .star_net_points import (
    SideShot,
    StarNetPoints,
    StarNetTraverse,
    StarNetVectors,
    placed_side_shots,
)


def read_star_net(
    path: str | Path,
    *,
    options: StarNetOptions | Mapping[str, Any] | str | Path | None = None,
    crs: ReferenceSystem | str | None = None,
    geoid: str | float | None = None,
    azimuths: Literal["grid", "true"] = "grid",
    horizontal_distances: Distances = "measured",
    files: Sequence[str | Path] = (),
) -> Network:
    """Read data files of STAR*NET (``.dat``, ``.gps``).

    Read are C, E, A, D, V, DV, B, M, SS, BM, DB, DN, DM, DE, TB, T, TE and L with entered, default,
    fixed (``!``: 0.01″ or 0.01 mm) and free (``*``: 10⁴ times the default) standard errors, ``?``
    for what was not measured, heights of instrument and target, and the inline options .2D, .3D,
    .UNITS, .ORDER, .DELTA, .REFRACTION, .SEPARATOR, .MULTIPLIER, .ADDCENTERING, .LWEIGHT,
    .INSTRUMENT, .LONGITUDE, .GPS WEIGHT, .GPS FACTOR and .DATA;
    .LOSTSTATIONS, .PTOLERANCE, .ELLIPSE and .RELATIVE concern what STAR*NET prints and change
    nothing; other options and data types are refused by name. Lines
    between .DATA OFF and .DATA ON, comments (#) and descriptors (') are not read.

    Units, orders and default standard errors are in the project file of STAR*NET, not here: the
    reader demands each one that a line uses, and names the first line. Standard errors combine as
    in STAR*NET: distance = constant + ppm, with the centring of both ends along or across the sight
    (`StandardDeviation`). Curvature and refraction of STAR*NET, (1 − 2·0.07) D²/2R, are a held
    group of refraction κ = 2·0.07 − 1. Every side shot (SS) is a point of its own, which bears on
    no other (`Point.side_shot`). A direction with a zenith angle beyond 180° was read in reverse,
    180° from face 1. A 2D project holds z = 0, LEV holds x and y. Data of a 3D line in a 2D project
    is reduced to the horizontal.

    With the reference system of a project in a grid, CH, EH, P, PH and GPS vectors (G0 to G3) are
    read too, and the network is in a topocentric frame (`from_grid`): neither the scale of the grid
    nor curvature is neglected, distances stay as they were measured, and results come back in the
    grid (`grid_coordinates`).

    Args:
        path: the file.
        options: settings of the project, see `StarNetOptions`, or a TOML file with them.
        crs: reference system of the grid in metres, such as EPSG:2953; None: a local project.
        geoid: what elevations are above: the path of a geoid, or the geoid height of the project in
            metres, 0 where it has none.
        azimuths: whether bearings and azimuths count from ``grid`` north, as in grid projects
            without .GRID, or from ``true`` north.
        horizontal_distances: where horizontal distances are, see `from_grid`.
        files: further data files of the project, read in this order after the first, with the
            options that are in force there.

    Raises:
        InputError: every problem of the file, each with its line, and every setting that it needs
            and nothing states.
    """
    settings = star_net_options(options)
    if settings.adjustment is None:
        missing = known([n for n in SETTING_CHOICES if getattr(settings, n) is None], most=10)
        what = (
            f"needs the settings of its project, which data files do not have: {missing}, and the "
            "default standard errors that its lines use; state them in options"
        )
        raise InputError(Problem(what, Path(path).name))
    system = None if crs is None else star_net_grid_system(crs, geoid)
    if system is None and geoid is not None:
        raise InputError(
            Problem("geoid= belongs to the reference system of a grid: crs=", str(path))
        )
    if system is not None and settings.adjustment == "LEV":
        raise InputError(Problem("a LEV project has no coordinates of a grid", Path(path).name))
    source = TextSource(path, code_page="cp1252")
    reader = _Reader(source, settings, system)
    before = 0
    for file in (source, *(TextSource(f, source.problems, code_page="cp1252") for f in files)):
        if before:
            source.continue_with(file.path, before)
        for number, text in file.numbered():
            reader.read(before + number, text)
        before += len(file.lines)
    return reader.network(azimuths, horizontal_distances)


def _separate_codes(word: str) -> Sequence[str]:
    """Return the codes of standard errors that are written without blanks; or the word alone."""
    return word if set(word) <= {"!", "&", "*"} else (word,)


def _comment(line: int, code: str, words: list[str]) -> None:
    """Pass over a comment on a vector (G0)."""


class _Reader:
    def __init__(
        self, source: Source, options: StarNetOptions, system: ReferenceSystem | None
    ) -> None:
        self.system = system
        self.source = source
        self.values = StarNetValues(self.source, options)
        self.points = StarNetPoints(self.values)
        self.vectors = StarNetVectors(self.source)
        self.observations: list[Observation] = []
        self.side_shots: list[SideShot] = []
        self.refractions: dict[str, float] = {}
        self.reading = True
        self.set_at: tuple[str, str] | None = None
        self.set_begun = 1
        self.sets: dict[str, int] = {}
        self.traverse = StarNetTraverse(self.values, self.points, self._observe, self._add)
        self.data_types: dict[str, Callable[[int, str, list[str]], None]] = {
            **{"C": self.points.coordinates, "E": self.points.elevation},
            **dict.fromkeys(SIMPLE_DATA_TYPES, self._simple),
            "L": self._level,
            **dict.fromkeys(("DB", "DN", "DM", "DE"), self._of_set),
            **dict.fromkeys(("TB", "T", "TE"), self.traverse.read),
            **{"CH": self.points.coordinates, "EH": self.points.elevation},
            **dict.fromkeys(("P", "PH"), self.points.position),
            "G0": _comment,
            **dict.fromkeys(("G1", "G2", "G3"), self._vector),
        }

    # -- lines ------------------------------------------------------------------------------------

    def read(self, line: int, text: str) -> None:
        """Read a line."""
        for mark in ("#", "'", "‘", '"'):
            text = text.partition(mark)[0]
        words = [code for word in text.split() for code in _separate_codes(word)]
        if not words:
            return
        if words[0].startswith("."):
            option = apply_inline_option(self.values, line, words)
            if option == "GPS" and self.reading:
                self.vectors.option(line, words[1:])
            if option == "DATA":
                self.reading = [w.upper() for w in words[1:]] != ["OFF"]
            return
        if not self.reading:
            self.source.leave_out(line, LINES_BEHIND_DATA_OFF, " ".join(words[:2]))
            return
        code, rest = words[0].upper(), words[1:]
        if code in REFUSED_DATA_TYPES:
            self.source.wrong(line, f"data type {code} is not built: {REFUSED_DATA_TYPES[code]}")
        elif code in GRID_DATA_TYPES and self.system is None:
            what = f"data type {code} needs the reference system of the grid: crs= and geoid="
            self.source.wrong(line, what)
        elif (
            read := self.source.field(line, code, "data type").choice(self.data_types)
        ) is not None:
            read(line, code, rest)

    def _simple(self, line: int, code: str, words: list[str]) -> None:
        """Read a line of observations between the points that its first word names."""
        names = self._names(line, code, words, 3 if code in ANGLE_DATA_TYPES else 2)
        if names:
            observe = self._side_shot if code == "SS" else self._observe
            observe(line, code, names, words[1:])

    def _names(self, line: int, code: str, words: list[str], count: int) -> list[str]:
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
        if len(set(names)) < len(names):
            self.source.wrong(line, f"{code} joins a point to itself: {words[0][:40]}")
            return []
        return names

    def _vector(self, line: int, code: str, words: list[str]) -> None:
        """Read a line of a GPS vector."""
        if self.values.options.adjustment != "3D":
            self.source.wrong(line, "GPS vectors need a 3D project")
        elif code != "G1":
            self.vectors.weights(line, code, words)
        elif names := self._names(line, code, words, 2):
            self.points.use(line, *names)
            self.vectors.vector(line, names, words[1:])

    def _level(self, line: int, code: str, words: list[str]) -> None:
        names = self._names(line, code, words, 2)
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

    def _of_set(self, line: int, code: str, words: list[str]) -> None:
        if code == "DB":
            if self.set_at is not None:
                self.source.wrong(line, f"DB within the set of {self.set_at[0]!r}: DE is missing")
            if len(words) != 1:
                self.source.wrong(line, "DB takes the name of the station")
                return
            self.sets[words[0]] = self.sets.get(words[0], 0) + 1
            self.set_at, self.set_begun = (words[0], str(self.sets[words[0]])), line
        elif self.set_at is None:
            self.source.wrong(line, f"{code} without DB: a set of directions begins with DB")
        elif code == "DE":
            if words:
                self.source.wrong(line, f"DE takes no words, not {' '.join(words)[:40]!r}")
            self.set_at = None
        elif not words or words[0] == self.set_at[0]:
            self.source.wrong(
                line, f"{code} takes the name of another station than that of the set"
            )
        else:
            self._observe(line, code, [self.set_at[0], words[0]], words[1:])

    # -- observations -----------------------------------------------------------------------------

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
        if text == "?" or self._mode(line) == "horizontal":
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
            value = self.values.bearing(line, text, kind)
            self._add(line, Azimuth, names, value, self.values.sigma(line, error, "azimuth"))
            return
        value, sigma = self.values.angle(line, text, kind), self.values.sigma(line, error, kind)
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
        value = self.values.length(line, text, "distance")
        in_space = self.values.now.dimension != "2D"
        sloping = in_space and self._mode(line) != "horizontal"
        reduced = flat or not sloping
        sigma = self.values.sigma(line, error, "distance" if reduced else "slope distance")
        if not sloping:
            self._add(line, HorizontalDistance, ends, value, sigma)
        elif flat:
            zenith = given.get("vertical", ("?", None))[0]
            if zenith == "?":
                self.source.wrong(line, "a slope distance needs its zenith angle in a 2D project")
                return
            value *= math.sin(self.values.angle(line, zenith, "zenith angle"))
            self._add(line, HorizontalDistance, ends, abs(value), sigma)
        else:
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
            value = self.values.length(line, text, "elevation difference")
            far = given.get("distance", ("?", None))[0]
            distance = None if far == "?" else self.values.length(line, far, "distance")
            sigma = self.values.sigma(line, error, "elevation", distance)
            self._add(line, HeightDifference, ends, value, sigma, heights)
            return
        value = self.values.angle(line, text, "zenith angle")
        value = 2 * math.pi - value if value > math.pi else value
        sigma = self.values.sigma(line, error, "zenith")
        coefficient = self.values.now.refraction
        if coefficient is None:
            coefficient = self.values.demand(line, "refraction")
        group = "" if coefficient == self.values.options.refraction else f"{coefficient:g}"
        self.refractions[group] = coefficient
        self._add(line, ZenithAngle, ends, value, sigma, heights, refraction=group or None)

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

    # -- the network ------------------------------------------------------------------------------

    def network(self, azimuths: Azimuths, distances: Distances) -> Network:
        """Return the network; raise all problems."""
        if self.set_at is not None:
            what = f"the set of directions at {self.set_at[0]!r} has no end (DE)"
            self.source.wrong(self.set_begun, what)
        if self.traverse.stations is not None:
            self.source.wrong(self.traverse.begun, "the last traverse has no end (TE)")
        if not self.points.points and not self.source.problems.count:
            self.source.wrong(1, "holds neither points nor observations")
        adjustment = self.values.options.adjustment or "3D"
        others = self.observations
        self.observations = others + placed_side_shots(self.side_shots, self.points, others)
        self.vectors.check()
        if self.system is not None and not self.source.problems.count:
            set_grid_coordinates(self.points, self.system, self.source)
            if adjustment == "2D":
                self.values.demand(1, "elevation_of_project")
        self.values.note_missing()
        self.source.raise_all()
        read = StarNetContent(
            self.values.options,
            self.points,
            self.vectors,
            tuple(self.observations),
            self.refractions,
            self.source,
        )
        if self.system is None:
            return local_network(read, adjustment)
        return grid_network(
            read, self.system, adjustment, azimuths=azimuths, horizontal_distances=distances
        )


READER = Reader(
    "star-net",
    (".dat", ".gps"),
    "STAR*NET",
    NetworkReader(read_star_net),
    own_grid=True,
)
