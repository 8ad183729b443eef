"""Reader of data files of STAR*NET: lines, inline options and included files of a project.

Format: STAR*NET V6, Reference Manual, chapter 5, "Preparing Input Data"; MicroSurvey, help desk,
article 1120, "STAR*NET data types".
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ...crs.reference_system import ReferenceSystem
from ...errors import InputError, Problem, known
from ...files import inside
from ...network.grid.transformation import Azimuths, Distances
from ...network.network import Network
from ...observations.base import joined_points
from ..format_reader import NetworkReader, Reader
from ..source import LeftOutReason, Problems, Source, TextSource
from ..text_files import file_beginning
from .star_net_inline_options import GRID_OPTIONS, LOCAL_OPTIONS, apply_inline_option
from .star_net_lines import (
    GRID_DATA_TYPES,
    LINES_BEHIND_DATA_OFF,
    REFUSED_DATA_TYPES,
    SIMPLE_DATA_TYPES,
    StarNetValues,
)
from .star_net_network import (
    StarNetContent,
    grid_network,
    local_network,
    set_grid_coordinates,
    star_net_grid_system,
)
from .star_net_observations import StarNetObservations
from .star_net_options import SETTING_CHOICES, StarNetOptions, star_net_options
from .star_net_points import StarNetPoints, StarNetVectors, placed_side_shots

UNUSED_POINTS = LeftOutReason("points", "no line observes them")
MAX_INCLUDED_DEPTH = 20
"""Largest number of files that include one another."""
INCLUDE = re.compile(
    r'\s*\.INC(?:L(?:U(?:DE?)?)?)?\s+(?:"([^"]+)"|([^\s#"][^#"]*?))\s*(?:#.*)?', re.IGNORECASE
)
"""Line of an included file: its name in quotation marks, or without."""
READINGS_TO_COME = (
    "no values: they are readings to come (pre-analysis), which plan takes, not adjust: "
    "`plan FILE`, or fga.plan of the network that the reader returns with readings=False"
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
    readings: bool = True,
) -> Network:
    """Read data files of STAR*NET (``.dat``, ``.gps``).

    Read are C, E, A, D, V, DV, B, M, SS, BM, DB, DN, DM, DE, TB, T, TE and L with entered, default,
    fixed (``!``: 0.01″ or 0.01 mm) and free (``*``: 10⁴ times the default) standard errors, ``?``
    for what was not measured, heights of instrument and target, and the inline options .2D, .3D,
    .UNITS, .ORDER, .DELTA, .REFRACTION, .SEPARATOR, .MULTIPLIER, .SCALE, .ADDCENTERING, .LWEIGHT,
    .INSTRUMENT, .LONGITUDE, .GRID, .MEASURE, .ALIAS, .INCLUDE, .GPS WEIGHT, .GPS FACTOR and .DATA;
    .LOSTSTATIONS, .PTOLERANCE, .ELLIPSE and .RELATIVE concern what STAR*NET prints and change
    nothing; other options and data types are refused by name. Lines
    between .DATA OFF and .DATA ON, comments (#) and descriptors (') are not read.

    Units, orders and default standard errors are in the project file of STAR*NET, not here (see
    `read_star_net_project`): the reader demands each one that a line uses, and names the first
    line. Standard errors combine as
    in STAR*NET: distance = constant + ppm, with the centring of both ends along or across the sight
    (`StandardDeviation`). Curvature and refraction of STAR*NET, (1 − 2·0.07) D²/2R, are a held
    group of refraction κ = 2·0.07 − 1. Every side shot (SS) is a point of its own, which bears on
    no other (`Point.side_shot`). A direction with a zenith angle beyond 180° was read in reverse,
    180° from face 1. A 2D project holds z = 0, LEV holds x and y. Data of a 3D line in a 2D project
    is reduced to the horizontal.

    A line that has names alone is a reading to come, with its default standard errors: with
    ``readings=False`` it is in the network, which `factorgraph_adj.plan` takes (pre-analysis).
    .SCALE multiplies horizontal lengths, of slope distances the horizontal part. Lines of a file
    that .INCLUDE names are read in its place, and the options that it changes end with it.

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
        readings: whether every line needs its values; those of a design do not.

    Raises:
        InputError: every problem of the file, each with its line, and every setting that it needs
            and nothing states.
    """
    settings = star_net_options(options)
    if settings.adjustment is None:
        missing = known([n for n in SETTING_CHOICES if getattr(settings, n) is None], most=10)
        what = (
            f"needs the settings of its project, which data files do not have: {missing}, and the "
            "default standard errors that its lines use; state them in options, or read the "
            "project (.snproj)"
        )
        raise InputError(Problem(what, Path(path).name))
    system = None if crs is None else star_net_grid_system(crs, geoid)
    if system is None and geoid is not None:
        raise InputError(
            Problem("geoid= belongs to the reference system of a grid: crs=", str(path))
        )
    return read_data_files(
        DataFiles((Path(path), *(Path(f) for f in files))),
        settings,
        system,
        azimuths=azimuths,
        horizontal_distances=horizontal_distances,
        readings=readings,
    )


@dataclass(frozen=True)
class DataFiles:
    """Data files of a project, in their order."""

    paths: Sequence[Path]
    """The files."""
    name: str = ""
    """Name of the project; empty: that of the first file."""
    problems: Problems = field(default_factory=Problems)
    """Problems of the project so far, and rows that it leaves out."""


def read_data_files(
    files: DataFiles,
    options: StarNetOptions,
    system: ReferenceSystem | None,
    *,
    azimuths: Azimuths = "grid",
    horizontal_distances: Distances = "measured",
    readings: bool = True,
) -> Network:
    """Return the network of data files with the settings of their project.

    Args:
        files: the data files.
        options: the settings.
        system: reference system of a project in a grid; None: a local one.
        azimuths: as in `read_star_net`.
        horizontal_distances: as in `read_star_net`.
        readings: as in `read_star_net`.

    Raises:
        InputError: as `read_star_net`.
    """
    first = files.paths[0]
    if system is not None and options.adjustment == "LEV":
        raise InputError(Problem("a LEV project has no coordinates of a grid", first.name))
    source = TextSource(first, files.problems, code_page="cp1252")
    others = [TextSource(f, files.problems, code_page="cp1252") for f in files.paths[1:]]
    reader = _Reader(source, options, system, azimuths, horizontal_distances)
    for file in (source, *others):
        reader.read_file(file)
    return reader.network(files.name or first.stem, readings=readings)


def _separate_codes(word: str) -> Sequence[str]:
    """Return the codes of standard errors that are written without blanks; or the word alone."""
    return word if set(word) <= {"!", "&", "*"} else (word,)


def _comment(line: int, code: str, words: list[str]) -> None:
    """Pass over a comment on a vector (G0)."""


class _Reader:
    def __init__(
        self,
        source: Source,
        options: StarNetOptions,
        system: ReferenceSystem | None,
        azimuths: Azimuths,
        distances: Distances,
    ) -> None:
        self.system = system
        self.source = source
        self.values = StarNetValues(source, options, bearings=azimuths, lengths=distances)
        self.points = StarNetPoints(self.values)
        self.vectors = StarNetVectors(source, options)
        self.read_lines = StarNetObservations(source, self.values, self.points)
        self.reading = True
        self.count = 0
        """Number of lines of all files so far."""
        self.open: list[Path] = []
        """Files that are being read: each one is included by the one before it."""
        observed = self.read_lines
        self.data_types: dict[str, Callable[[int, str, list[str]], None]] = {
            **{"C": self.points.coordinates, "E": self.points.elevation},
            **dict.fromkeys(SIMPLE_DATA_TYPES, observed.simple),
            "L": observed.level,
            **dict.fromkeys(("DB", "DN", "DM", "DE"), observed.of_set),
            **dict.fromkeys(("TB", "T", "TE"), observed.traverse.read),
            **{"CH": self.points.coordinates, "EH": self.points.elevation},
            **dict.fromkeys(("P", "PH"), self.points.position),
            "G0": _comment,
            **dict.fromkeys(("G1", "G2", "G3"), self._vector),
        }

    # -- lines ------------------------------------------------------------------------------------

    def read_file(self, file: TextSource) -> None:
        """Read a file, and those that it includes in the places where it does."""
        self.open.append(file.path)
        begin = self.count
        if begin:
            self.source.continue_with(file.path, begin)
        for number, text in file.numbered():
            self.count += 1
            included = INCLUDE.fullmatch(text)
            if included is None or not self.reading:
                self.read(self.count, text)
            elif (child := self._child(self.count, included[1] or included[2])) is not None:
                before = self.values.state(), self.vectors.state()
                self.read_file(child)
                self.values.restore(before[0])
                self.vectors.restore(before[1])
                self.source.continue_with(file.path, self.count, number)
        self.open.pop()

    def _child(self, line: int, name: str) -> TextSource | None:
        """Return the file that .INCLUDE names; None after a problem."""
        folder = self.open[0].parent
        # A file in a folder may name one beside that folder, but none outside of the first file's.
        here = posixpath.join(_within(folder, self.open[-1].parent), name.replace("\\", "/"))
        stated = posixpath.normpath(here)
        path = self.source.attempt(line, inside, folder, stated, self.source.place(line))
        if path is None:
            return None
        if path in self.open or len(self.open) >= MAX_INCLUDED_DEPTH:
            what = f".INCLUDE {name[:60]}: a file includes itself, or too many include one another"
            self.source.wrong(line, what)
            return None
        if not path.is_file():
            self.source.wrong(line, f".INCLUDE {name[:60]}: there is no such file")
            return None
        return self.source.attempt(line, TextSource, path, self.source.problems, code_page="cp1252")

    def read(self, line: int, text: str) -> None:
        """Read a line."""
        for mark in ("#", "'", "‘", '"'):
            text = text.partition(mark)[0]
        words = [code for word in text.split() for code in _separate_codes(word)]
        if not words:
            return
        if words[0].startswith("."):
            option = apply_inline_option(self.values, line, words)
            if option in (LOCAL_OPTIONS if self.system is not None else GRID_OPTIONS):
                kind = "local projects" if self.system is not None else "projects in a grid (crs=)"
                self.source.wrong(line, f"inline option .{option} belongs to {kind}")
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

    def _vector(self, line: int, code: str, words: list[str]) -> None:
        """Read a line of a GPS vector."""
        if self.values.options.adjustment != "3D":
            self.source.wrong(line, "GPS vectors need a 3D project")
        elif code != "G1":
            self.vectors.weights(line, code, words)
        elif names := self.read_lines.names(line, code, words, 2):
            self.points.use(line, *names)
            self.vectors.vector(line, names, words[1:])

    # -- the network ------------------------------------------------------------------------------

    def network(self, name: str, *, readings: bool) -> Network:
        """Return the network; raise all problems."""
        lines = self.read_lines
        lines.finish()
        if lines.to_come and readings:
            n = len(lines.to_come)
            what = "this line has" if n == 1 else f"{n} lines from here have"
            self.source.wrong(lines.to_come[0], f"{what} {READINGS_TO_COME}")
        if not self.points.points and not self.source.problems.count:
            self.source.wrong(1, "holds neither points nor observations")
        adjustment = self.values.options.adjustment or "3D"
        others = lines.observations
        observations = others + placed_side_shots(lines.side_shots, self.points, others)
        self.vectors.check()
        self._leave_out_unused(joined_points(observations))
        if self.system is not None and not self.source.problems.count:
            set_grid_coordinates(self.points, self.system, self.source)
            if adjustment == "2D":
                self.values.demand(1, "elevation_of_project")
        self.values.note_missing()
        self.source.raise_all()
        read = StarNetContent(
            name,
            self.values.stated,
            self.points,
            self.vectors,
            tuple(observations),
            lines.refractions,
            lines.meant,
            self.source,
        )
        if self.system is None:
            return local_network(read, adjustment)
        return grid_network(read, self.system, adjustment)

    def _leave_out_unused(self, observed: set[str]) -> None:
        """Leave out the points that no line observes, as STAR*NET does; not where there is none."""
        observed |= {name for v in self.vectors.vectors for name in v.names}
        for name in [n for n in self.points.points if observed and n not in observed]:
            point = self.points.points.pop(name)
            self.source.leave_out(point.line, UNUSED_POINTS, name)


def _within(folder: Path, inner: Path) -> str:
    """Return the path of a folder from one around it."""
    return inner.relative_to(folder).as_posix()


DATA_LINE = re.compile(
    rb"(?:C|CH|E|EH|P|PH)[ \t]+\S+(?:[ \t]+[-+]?\d[-\d.:]*)+(?:[ \t]+[!*.\d]+)*"
    rb"|(?:A|M|SS|D|V|DV|B|BM|L)[ \t]+\S+[^\w\s.]\S+(?:[ \t].*)?"
    rb"|(?:DB|DN|DM|TB|T|TE)[ \t]+\S.*|DE|G0.*|G[1-3][ \t]+\S.*"
    rb"|\.[A-Z0-9]+(?:[ \t]+\S.*)?",
    re.IGNORECASE,
)
"""A line of a data file, without comment and descriptor."""
MAX_OTHER_LINES = 9
"""Number of data lines for each other one in the beginning of a file that is recognised."""
DESCRIPTOR = re.compile(rb"[#'\"].*")


def is_star_net(path: Path) -> bool:
    """Return whether a file is data of STAR*NET: its first line is, and nearly all others are.

    A line begins with a data type and names or coordinates, or is an inline option; rows of tables,
    with commas or without, are neither. A wrong line is reported by the reader.
    """
    beginning = file_beginning(path)
    lines = beginning.replace(b"\r", b"\n").split(b"\n")
    found = other = 0
    # The last line may be cut.
    for line in lines[:-1] if len(lines) > 1 else lines:
        text = DESCRIPTOR.sub(b"", line).strip()
        if not text:
            continue
        if DATA_LINE.fullmatch(text) is not None:
            found += 1
        elif found:
            other += 1
        else:
            return False
    return found > MAX_OTHER_LINES * other


READER = Reader(
    "star-net",
    (".dat", ".gps"),
    "STAR*NET",
    NetworkReader(read_star_net),
    recognises=is_star_net,
    own_grid=True,
)
