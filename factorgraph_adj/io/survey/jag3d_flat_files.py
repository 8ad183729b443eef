"""Flat files of JAG3D as read: kinds, forms of lines, units; one group in each file.

A line that begins with # is a comment. Coordinates are y (east), x (north), z; [ ] may be absent:

| file | line |
| --- | --- |
| points, 3-D | name y x z [σ] · name y x z σ_yx σ_z · name y x z σ_y σ_x σ_z |
| points, 2-D | name y x [σ] · name y x σ_y σ_x |
| points, 1-D | name z [σ] · name y x z [σ] |
| levelling, directions, distances, zenith angles | station target value [σ or length] |
| the same with heights | station target ih th value [σ or length] |
| GNSS 3-D | station target Δy Δx Δz [σ] · … σ_yx σ_z · … σ_y σ_x σ_z |
| GNSS 2-D | station target Δy Δx [σ] · … σ_y σ_x |
| GNSS 1-D | station target Δz [σ] · station target Δy Δx Δz [σ] |
| deflections | name r_y r_x [σ] · name r_y r_x σ_y σ_x |

A last number of 1 and more is a length in metres, for which σ is computed, and not a σ. Points may
have commas for decimal points and semicolons between words; observations may not.

Source: JAG3D 2026, jag3d/ui/table/row/{PointRow,TerrestrialObservationRow,GNSSObservationRow,
VerticalDeflectionRow}.java (scan), util/io/LockFileReader.java. JAG3D leaves lines that it does not
understand out, and reads 12,345 in an observation as 12345; here they are problems.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias, get_args

from ...errors import InputError, Problem, known
from ...units import ANGLE, LENGTH
from ..source import Problems, TextSource, is_unread
from .jag3d_model import (
    JAG3D_KINDS,
    NEUTRAL_VALUES,
    Deflection,
    GroupParameter,
    ObservationGroup,
    ObservationRow,
    ObservationType,
    PointRow,
    PointStatus,
)

POINT_KINDS = tuple(f"{s}_points_{d}d" for s in get_args(PointStatus) for d in (1, 2, 3))
DEFLECTION_KINDS = tuple(f"{s}_deflections" for s in ("reference", "stochastic", "unknown"))
FILE_KINDS = (*POINT_KINDS, *JAG3D_KINDS, *DEFLECTION_KINDS)
"""What a file may hold."""
STATUS_WORDS: dict[str, tuple[str, ...]] = {
    "reference": ("reference", "festpunkt", "anschluss", "anschluß"),
    "stochastic": ("stochast",),
    "datum": ("datum",),
    "new": ("new", "neupunkt"),
    "levelling": ("levelling", "leveling", "nivellement"),
    "directions": ("direction", "richtung"),
    "horizontal_distances": ("horizontaldistance", "horizontalstrecke"),
    "slope_distances": ("slopedistance", "schrägstrecke", "schraegstrecke", "raumstrecke"),
    "zenith_angles": ("zenith", "zenit"),
    "gnss_1d": ("gnss1d",),
    "gnss_2d": ("gnss2d",),
    "gnss_3d": ("gnss3d",),
}
"""Words in names of files, in English and German, without spaces, hyphens and underscores."""
DEFLECTION_WORDS = ("deflection", "lotabweichung")
SigmaTriple: TypeAlias = tuple[float, float, float]
POINT_FORMS = {
    1: {1: ("--0", "---"), 2: ("--0", "--1"), 3: ("012", "---"), 4: ("012", "--3")},
    2: {2: ("01-", "---"), 3: ("01-", "22-"), 4: ("01-", "23-")},
    3: {3: ("012", "---"), 4: ("012", "333"), 5: ("012", "334"), 6: ("012", "345")},
}
"""Which of the numbers of a line are y, x, z and their σ, by dimension and count of numbers."""
_DISTANCES = ("horizontal_distances", "slope_distances")
ESTIMATED_OPTIONS: dict[str, tuple[str, tuple[str, ...]]] = {
    "orientation": ("orientation", ("directions",)),
    "scale": ("scale", _DISTANCES),
    "zero": ("zero point offset", _DISTANCES),
    "refraction": ("refraction", ("zenith_angles",)),
}
"""Additional parameter and the kinds that have it, by the word of the option."""
MAX_NAME_CHARACTERS = 256
"""Largest number of characters of a name of JAG3D's tables."""
_SPLIT_POINTS = re.compile(r"[\s;]+")
FLAT_FILE_SUFFIXES = (".txt", ".dat", ".pts", ".obs", ".csv")
"""Suffixes of the files of a folder that are read."""


def flat_file_kind(path: Path) -> str | None:
    """Return what a file holds by its name; None if the name does not state it."""
    stem = re.sub(r"[\s_\-]+", "", path.stem.casefold())
    found = [k for k, words in STATUS_WORDS.items() if any(w in stem for w in words)]
    if any(w in stem for w in DEFLECTION_WORDS):
        status = [s for s in ("reference", "stochastic") if s in found]
        return f"{status[0] if status else 'unknown'}_deflections"
    if len(found) != 1:
        return None
    if found[0] in JAG3D_KINDS:
        return found[0]
    dimension = re.search(r"([123])d", stem)
    return f"{found[0]}_points_{dimension[1]}d" if dimension else None


def flat_files(path: str | Path | Sequence[str | Path]) -> list[Path]:
    """Return the files of a folder in the order of their names, or those of a list.

    Raises:
        InputError: the folder has none.
    """
    if not isinstance(path, str | Path):
        return [Path(p) for p in path]
    given = Path(path)
    if not given.is_dir():
        return [given]
    found = [
        p
        for p in sorted(given.iterdir())
        if p.is_file() and p.suffix.lower() in FLAT_FILE_SUFFIXES and not p.name.startswith(".")
    ]
    if not found:
        what = f"has no flat files of JAG3D ({', '.join(FLAT_FILE_SUFFIXES)})"
        raise InputError(Problem(what, str(given)))
    return found


@dataclass(frozen=True)
class FlatUnits:
    """Units of flat files, which JAG3D takes from its preferences."""

    length: float
    """Unit of lengths, metres."""
    angle: float
    """Unit of angles and their σ, radians."""


def flat_units(length: str, angle: str) -> FlatUnits:
    """Return the units by their names; InputError lists what is unknown."""
    problems = [
        Problem(f"unknown unit {given!r}; valid: {known(sorted(valid), meant=str(given))}", name)
        for name, given, valid in (("length", length, LENGTH), ("angle", angle, ANGLE))
        if given not in valid
    ]
    if problems:
        raise InputError(problems)
    return FlatUnits(LENGTH[length], ANGLE[angle])


@dataclass
class FlatFiles:
    """What the flat files of a network hold."""

    units: FlatUnits
    """Their units."""
    uncertainties: Mapping[str, tuple[float, float, float]]
    """Parts of σ by kind, for rows without a σ of their own."""
    separate: bool
    """Whether directions of each station are a group of their own."""
    estimate: Collection[str] = ()
    """Additional parameters to be estimated, see `ESTIMATED_OPTIONS`."""
    points: list[PointRow] = field(default_factory=list)
    """Points."""
    groups: list[ObservationGroup] = field(default_factory=list)
    """Groups of observations."""
    deflections: list[Deflection] = field(default_factory=list)
    """Deflections of the vertical."""
    problems: Problems = field(default_factory=Problems)
    """Problems of all files."""
    end: str = ""
    """End of the last file, for what all files lack."""

    def read(self, path: Path, kind: str) -> None:
        """Read a file; its problems are noted."""
        lines = self.problems.attempt(path.name, TextSource, path, self.problems)
        if lines is None:
            return
        self.end = lines.place(0)
        if kind in POINT_KINDS:
            word, _, dimension = kind.split("_")
            status = next(s for s in get_args(PointStatus) if s == word)
            for number, words in _words(lines, _SPLIT_POINTS):
                point = self._point(lines, number, words, status, int(dimension[0]))
                if point is not None:
                    self.points.append(point)
        elif kind in DEFLECTION_KINDS:
            for number, words in _words(lines, _SPLIT_POINTS):
                deflection = self._deflection(lines, number, words, kind.split("_")[0])
                if deflection is not None:
                    self.deflections.append(deflection)
        else:
            self._observations(lines, JAG3D_KINDS[kind])

    # -- points -----------------------------------------------------------------------------------

    def _point(
        self, lines: TextSource, number: int, words: list[str], status: PointStatus, dimension: int
    ) -> PointRow | None:
        v = _numbers(lines, number, words, 1, self.units.length, comma=True)
        if v is None:
            return None
        found = _coordinates_and_sigmas(lines, number, v, dimension, "a point")
        if found is None:
            return None
        yxz, sigma = found
        return PointRow(words[0], status, dimension, yxz, sigma, lines.place(number))

    def _deflection(
        self, lines: TextSource, number: int, words: list[str], status: str
    ) -> Deflection | None:
        v = _numbers(lines, number, words, 1, self.units.angle, comma=True)
        if v is None:
            return None
        if not 2 <= len(v) <= 4:
            lines.wrong(number, f"a deflection has 2 to 4 numbers, not {len(v)}")
            return None
        given = v[2:] if len(v) == 4 else v[2:] * 2
        if any(s <= 0 for s in given):
            lines.wrong(number, "a standard deviation must be > 0")
            return None
        default = self.units.angle * 0.001 if not given else 0.0
        sigma = (given[0], given[1]) if given else (default, default)
        weighted = sigma if status == "stochastic" else None
        source = lines.place(number)
        return Deflection(words[0], (v[0], v[1]), weighted, status == "unknown", source)

    # -- observations -----------------------------------------------------------------------------

    def _observations(self, lines: TextSource, kind: ObservationType) -> None:
        read = self._vector if kind.axes else self._scalar
        rows: list[ObservationRow] = []
        for number, words in _words(lines, None):
            if len(words) < 3:
                lines.wrong(number, f"a line of {kind.name} has a station, a target and numbers")
            elif words[0] == words[1]:
                lines.wrong(number, f"the observation joins {words[0]!r} to itself")
            elif (row := read(lines, number, words, kind)) is not None:
                rows.append(row)
        runs: list[list[ObservationRow]] = []
        for row in rows:
            apart = kind.name == "directions" and self.separate
            if not runs or (apart and runs[-1][0].start != row.start):
                runs.append([])
            runs[-1].append(row)
        stem = lines.path.stem
        for run in runs:
            extras = {
                parameter: GroupParameter(NEUTRAL_VALUES.get(parameter, 0.0), free=True)
                for word, (parameter, kinds) in ESTIMATED_OPTIONS.items()
                if kind.name in kinds and (word in self.estimate or word == "orientation")
            }
            self.groups.append(
                ObservationGroup(
                    stem,
                    kind,
                    tuple(run),
                    self.uncertainties[kind.name],
                    extras,
                    run[0].source,
                )
            )

    def _scalar(
        self, lines: TextSource, number: int, words: list[str], kind: ObservationType
    ) -> ObservationRow | None:
        unit = self.units.angle if kind.angle else self.units.length
        v = _numbers(lines, number, words, 2, 1.0)
        if v is None:
            return None
        ih = th = 0.0
        if len(v) in (3, 4):
            ih, th = v[0] * self.units.length, v[1] * self.units.length
            v = v[2:]
        if len(v) > 2:
            what = (
                f"a line of {kind.name} has at most 6 words: station, target, heights, value, σ; "
                f"not {len(words)}"
            )
            lines.wrong(number, what)
            return None
        sigma = distance = math.nan
        if len(v) == 2:
            last = v[1] * self.units.length
            if last < 0:
                lines.wrong(number, "a standard deviation or length must not be negative")
                return None
            if last >= 1:
                distance = last
            elif last > 0:
                sigma = v[1] * unit
        place = lines.place(number)
        if kind.angle and not -1e3 <= v[0] * unit <= 1e3:
            lines.wrong(number, f"{words[-len(v)]} is no angle in the unit of the file")
            return None
        return ObservationRow(words[0], words[1], (v[0] * unit,), (sigma,), place, ih, th, distance)

    def _vector(
        self, lines: TextSource, number: int, words: list[str], kind: ObservationType
    ) -> ObservationRow | None:
        v = _numbers(lines, number, words, 2, self.units.length)
        if v is None:
            return None
        found = _coordinates_and_sigmas(lines, number, v, len(kind.axes), "a GNSS vector")
        if found is None:
            return None
        of = ["yxz".index(axis) for axis in kind.axes]
        value, sigma = (tuple(part[k] for k in of) for part in found)
        return ObservationRow(words[0], words[1], value, sigma, lines.place(number))


def _coordinates_and_sigmas(
    lines: TextSource, number: int, v: list[float], dimension: int, what: str
) -> tuple[SigmaTriple, SigmaTriple] | None:
    """Return y, x, z and their σ of the numbers of a line; None with a problem."""
    forms = POINT_FORMS[dimension]
    if len(v) not in forms:
        counts = " or ".join(map(str, forms))
        lines.wrong(number, f"{what} of {dimension} dimensions has {counts} numbers, not {len(v)}")
        return None
    yxz, sigma = (
        tuple(math.nan if c == "-" else v[int(c)] for c in places) for places in forms[len(v)]
    )
    if any(s <= 0 for s in sigma):
        lines.wrong(number, "a standard deviation must be > 0")
        return None
    return (yxz[0], yxz[1], yxz[2]), (sigma[0], sigma[1], sigma[2])


def _words(lines: TextSource, split: re.Pattern[str] | None) -> Iterable[tuple[int, list[str]]]:
    """Yield number and words of the lines that are neither empty nor comments."""
    for number, line in lines.numbered():
        text = line.strip()
        if not text or text.startswith("#"):
            continue
        words = text.split() if split is None else [w for w in split.split(text) if w]
        if any(len(w) > MAX_NAME_CHARACTERS for w in words[:2]):
            lines.wrong(number, f"a name has more than {MAX_NAME_CHARACTERS} characters")
        elif words:
            yield number, words


def _numbers(
    lines: TextSource,
    number: int,
    words: list[str],
    first: int,
    unit: float,
    *,
    comma: bool = False,
) -> list[float] | None:
    """Return the numbers of a line in SI units; None with a problem if a word is none."""
    out = []
    for k, word in enumerate(words[first:], first + 1):
        if "," in word and not comma:
            what = f"{word!r} has a comma: write a decimal point (JAG3D leaves commas out)"
            lines.wrong(number, what)
            return None
        text = word.replace(",", ".") if comma else word
        value = lines.field(number, text, f"word {k}").number()
        if is_unread(value):
            return None
        out.append(value * unit)
    return out
