"""Reader of JAG3D, its projects or flat files; writer of flat files of points and observations."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import get_args

import numpy as np

from ...entities import Parameter, Point
from ...errors import InputError, Problem, known, taking
from ...frames import LocalFrame
from ...models.unknown_registry import UNKNOWNS
from ...network.network import Network
from ...observations import (
    CoordinateDifference,
    Direction,
    GnssVector,
    HeightDifference,
    HorizontalDistance,
    Observation,
    SlopeDistance,
    ZenithAngle,
)
from ...units import ANGLE, LENGTH
from ..field_books.field_book import name_list
from ..file_transaction import write_files
from ..format_limits import scalar_sigmas
from ..format_reader import NetworkReader, Reader
from ..numbers import write_quantity
from ..source import Problems
from .jag3d_flat_files import (
    ESTIMATED_OPTIONS,
    FILE_KINDS,
    MAX_NAME_CHARACTERS,
    FlatFiles,
    flat_file_kind,
    flat_files,
    flat_units,
)
from .jag3d_model import JAG3D_KINDS
from .jag3d_network import as_network, groups_with_set_names
from .jag3d_project import EpochChoice, is_jag3d_project, read_jag3d_project

UNSUPPORTED_INSTRUMENT_ERRORS = ("index_error", "collimation_error")
"""Attributes of observations that name errors of the instrument which JAG3D does not have."""
FLAT_FILE_HEADS = {
    "points_1d": "name y x z [σ]",
    "points_2d": "name y x [σ_y σ_x]",
    "points_3d": "name y x z [σ_y σ_x σ_z]",
    "deflections": "name r_y r_x [σ_y σ_x]",
}
_DIRECTIONS = re.compile(r"directions_\d+\.txt")
_FORMS: dict[type, Callable[..., tuple[str, list[str]]]] = {
    Direction: lambda w, o, s: ("directions", w.scalar(o, o.value, s, "gon")),
    ZenithAngle: lambda w, o, s: ("zenith_angles", w.scalar(o, o.in_face_one, s, "gon")),
    SlopeDistance: lambda w, o, s: ("slope_distances", w.scalar(o, o.value, s)),
    HorizontalDistance: lambda w, o, s: ("horizontal_distances", w.scalar(o, o.value, s)),
    HeightDifference: lambda w, o, s: ("levelling", w.scalar(o, o.value, s)),
    GnssVector: lambda w, o, _: w.vector(o, "xyz"),
    CoordinateDifference: lambda w, o, _: w.vector(o, o.axes),
}
"""Kind of file and numbers of each kind of observation."""


def read_jag3d(
    path: str | Path | Sequence[str | Path],
    *,
    kinds: Mapping[str, str] | None = None,
    length: str = "m",
    angle: str = "gon",
    angle_mgon: float = 0.3,
    angle_mm: float = 0.5,
    distance_mm: float = 2.0,
    distance_ppm: float = 2.0,
    levelling_mm: float = 0.1,
    levelling_mm_per_sqrt_km: float = 1.0,
    gnss_mm: float = 25.0,
    gnss_ppm: float = 50.0,
    point_mm: float = 2.0,
    separate: bool = True,
    estimate: str | Iterable[str] = (),
    epoch: EpochChoice = "both",
) -> Network:
    """Read a project of JAG3D, or flat files of its groups.

    A project is the script of a database, ``name.script``, with ``name.data`` beside it, or what
    the statement ``SCRIPT 'name.script'`` of HSQLDB writes. Everything that takes part in its
    adjustment is read: points, observations, σ, additional parameters, deflections of the vertical,
    reductions for the curvature of the Earth and for height. Groups, points and observations that
    are switched off are left out, as are results, point pairs of the congruence analysis (see
    `factorgraph_adj.io.survey.jag3d_project.point_pairs`), settings of tests and of display; the
    options on σ and units have no effect.

    Flat files have one group each. Names state what they hold: the kinds are
    ``reference_points_3d`` (also ``stochastic_``, ``datum_``, ``new_``; ``_1d``, ``_2d``),
    ``levelling``, ``directions``, ``horizontal_distances``, ``slope_distances``,
    ``zenith_angles``, ``gnss_1d``, ``gnss_2d``, ``gnss_3d``, and ``reference_deflections`` (also
    ``stochastic_``, ``unknown_``); the words may be anywhere in a name, German ones too
    (Festpunkte, Neupunkte, Richtungen, Schrägstrecken …). Rows without σ get σ² = a² + (part that
    depends on the length)². Default parts are those of JAG3D.

    Coordinates become x = y of JAG3D (east), y = x of JAG3D (north), z up. Datum points make the
    network a free one. 1-D points are held in plan, 2-D points in height.

    Args:
        path: the script of a project, a folder with flat files, a flat file, or a list of them.
        kinds: what a file holds by its name, for names that do not state it: one of the kinds, or
            other words that names of files may have, such as ``Festpunkte 3D``.
        length: unit of lengths in flat files.
        angle: unit of angles and of their σ in flat files.
        angle_mgon: constant part of σ of directions and zenith angles, mgon.
        angle_mm: part of their σ that falls with the length, mm: centring of the target.
        distance_mm: constant part of σ of distances, mm.
        distance_ppm: part of their σ that grows with the length, mm/km.
        levelling_mm: constant part of σ of height differences, mm.
        levelling_mm_per_sqrt_km: part of their σ that grows with the root of the length, mm/√km.
        gnss_mm: constant part of σ of a component of a GNSS vector, mm.
        gnss_ppm: part of its σ that grows with the component, mm/km.
        point_mm: σ of the coordinates of stochastic points without one, mm.
        separate: whether directions of each station in a file have an orientation of their own.
        estimate: additional parameters of each flat file that are unknown: some of ``scale``,
            ``zero`` (of distances), ``refraction`` (of zenith angles); in a text with commas.
        epoch: observations of a project: of both epochs, or of the reference or control epoch.

    Returns:
        The network, in a flat local frame.

    Raises:
        InputError: all problems with file and line: malformed rows, unknown points and those of a
            wrong dimension, points that occur twice, reference beside datum points, unknown scales
            and rotations of levelling, GNSS 1-D and 2-D, orientations that stations share,
            reductions to Gauß-Krüger, UTM and ellipsoidal systems, damaged databases.
    """
    problems = [
        Problem(f"must be a number {'≥' if zero else '>'} 0, not {value!r}", name)
        for name, value, zero in (
            ("angle_mgon", angle_mgon, False),
            ("angle_mm", angle_mm, True),
            ("distance_mm", distance_mm, False),
            ("distance_ppm", distance_ppm, True),
            ("levelling_mm", levelling_mm, False),
            ("levelling_mm_per_sqrt_km", levelling_mm_per_sqrt_km, True),
            ("gnss_mm", gnss_mm, False),
            ("gnss_ppm", gnss_ppm, True),
            ("point_mm", point_mm, False),
        )
        if not _is_valid_sigma(value, zero)
    ]
    if epoch not in (valid := get_args(EpochChoice)):
        problems.append(Problem(f"must be one of {known(valid)}, not {epoch!r}", "epoch"))
    estimated = name_list(estimate)
    for word in estimated:
        if word not in ESTIMATED_OPTIONS:
            what = f"unknown parameter {word!r}; valid: {known(ESTIMATED_OPTIONS, meant=word)}"
            problems.append(Problem(what, "estimate"))
    if problems:
        raise InputError(problems)
    if isinstance(path, str | Path) and Path(path).suffix in (".script", ".data"):
        return read_jag3d_project(Path(path).with_suffix(".script"), epoch=epoch)
    mm = LENGTH["mm"]
    angles = (angle_mgon * ANGLE["mgon"], 0.0, angle_mm * mm)
    distances = (distance_mm * mm, 0.0, distance_ppm * 1e-6)
    gnss = (gnss_mm * mm, 0.0, gnss_ppm * 1e-6)
    parts = {
        "levelling": (levelling_mm * mm, levelling_mm_per_sqrt_km * mm, 0.0),
        "directions": angles,
        "zenith_angles": angles,
        "horizontal_distances": distances,
        "slope_distances": distances,
        "gnss_1d": gnss,
        "gnss_2d": gnss,
        "gnss_3d": gnss,
    }
    read = FlatFiles(flat_units(length, angle), parts, separate, estimated)
    files = flat_files(path)
    told = _kinds(files, dict(kinds or {}), read.problems)
    untold = read.problems.count > 0
    for file, kind in told:
        read.read(file, kind)
    if untold:  # which points are unknown is not known without all files
        read.problems.raise_all()
    name = Path(path).stem if isinstance(path, str | Path) else files[0].parent.name
    return as_network(
        name,
        read.points,
        groups_with_set_names(read.groups),
        deflections=read.deflections,
        point_sigma=point_mm * mm,
        problems=read.problems,
        where=read.end or files[0].name,
    )


def is_jag3d(path: Path) -> bool:
    """Return whether a file is a project of JAG3D or a flat file, or a folder has flat files.

    Flat files are recognised by their names. In a folder most names state what the file holds,
    of two kinds at least; a name that does not is a problem of the reader.
    """
    if not path.is_dir():
        named = path.suffix.casefold() == ".txt" and flat_file_kind(path) is not None
        return named or is_jag3d_project(path)
    try:
        kinds = [flat_file_kind(file) for file in flat_files(path)]
    except (InputError, OSError):
        return False
    if (path / "project.toml").exists():
        return False
    found = [k for k in kinds if k is not None]
    has_points = any("points" in k for k in found)
    return (has_points and None not in kinds) or len(set(found)) >= 2 > len(kinds) / len(found)


def _is_valid_sigma(value: object, zero: bool) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return (value >= 0 if zero else value > 0) and value < 1e9


def _kinds(
    files: Sequence[Path], stated: Mapping[str, str], problems: Problems
) -> list[tuple[Path, str]]:
    """Return the files with their kinds; problems are noted."""
    valid = ", ".join(FILE_KINDS)
    out = []
    problems.files += [f.name for f in files]
    for name in stated:
        if name not in [f.name for f in files]:
            problems.wrong(f"kinds names {name!r}, which is none of the files", name)
    for file in files:
        kind = stated.get(file.name, flat_file_kind(file))
        if isinstance(kind, str) and kind not in FILE_KINDS:
            kind = flat_file_kind(Path(kind)) or kind  # other words, such as Festpunkte 3D
        if kind is None:
            what = (
                "its name does not tell what it holds: rename it, or state "
                f"kinds = {{'{file.name}': KIND}}; valid: {valid}"
            )
            problems.wrong(what, file.name)
        elif kind not in FILE_KINDS:
            problems.wrong(f"unknown kind {kind!r}; valid: {valid}", file.name)
        else:
            out.append((file, kind))
    return out


@taking(Network)
def write_jag3d(network: Network, path: str | Path) -> None:
    """Write flat files of JAG3D into a folder, one for each kind of points and observations.

    Lengths are metres, angles and their σ gons, each row has its σ. Import each file in the menu
    of its kind: ``reference_points_3d.txt``, ``new_points_3d.txt``, ``slope_distances.txt`` …;
    ``directions.txt`` with "separate by station", ``directions_2.txt`` for second sets of a
    station. Files of these names from an earlier run are replaced or removed. Points that are held
    in plan become 1-D points, in height 2-D points. Standard deviations with parts that depend on
    lengths are written as they are at the coordinates of the network; an adjusted one is
    `Solution.as_network`.

    Args:
        network: the network.
        path: the folder.

    Raises:
        InputError: everything that flat files cannot hold, all at once: another frame than a flat
            local one with axes en or ne, cameras and photos, correlations, other kinds than
            directions, distances, zenith angles, height differences, GNSS vectors and differences
            of coordinates, parameters that have an effect (refraction, distance meters, held
            orientations), points without coordinates, check points, held points in a free network,
            names with spaces or semicolons, σ of 1 and more, which JAG3D takes for lengths.
            Nothing is written then.
    """
    writer = _Writer(network)
    files = writer.files()
    if writer.problems:
        raise InputError(writer.problems)
    target = Path(path)
    old = [f"{kind}.txt" for kind in FILE_KINDS]
    if target.is_dir():
        old += [f.name for f in target.iterdir() if _DIRECTIONS.fullmatch(f.name)]
    write_files(target, {**dict.fromkeys(old), **files})


class _Writer:
    def __init__(self, network: Network) -> None:
        self.network = network
        self.problems: list[Problem] = []
        self.lines: dict[str, list[str]] = {}

    def refuse(self, what: str, where: str = "") -> None:
        self.problems.append(Problem(f"flat files of JAG3D cannot hold {what}", where))

    def files(self) -> dict[str, str | bytes | None]:
        """Return the files; what they cannot hold is noted."""
        network, frame = self.network, self.network.frame
        if not isinstance(frame, LocalFrame) or frame.curvature or frame.axes not in ("en", "ne"):
            self.refuse("this frame: it takes a flat local one with axes en or ne", network.name)
            self.order: tuple[int, ...] = (0, 1, 2)
        else:
            self.order = (0, 1, 2) if frame.axes == "en" else (1, 0, 2)
        for many, noun in ((network.cameras, "cameras"), (network.photos, "photos")):
            if many:
                self.refuse(f"{noun} ({len(many)})", network.name)
        if network.clusters:
            self.refuse(f"correlated observations ({len(network.clusters)} clusters)", network.name)
        if not network.points:
            self.refuse("a network without points", network.name)
        for p in network.points.values():
            self._point(p)
        self._unknowns()
        self._observations()
        return {
            f"{kind}.txt": "\n".join([f"# {self._head(kind)}", *rows]) + "\n"
            for kind, rows in self.lines.items()
        }

    @staticmethod
    def _head(kind: str) -> str:
        for end, head in FLAT_FILE_HEADS.items():
            if kind.endswith(end):
                return head
        known = JAG3D_KINDS["directions" if kind.startswith("directions") else kind]
        if known.axes:
            return f"station target {' '.join('Δ' + a for a in known.axes)} [σ …]"
        return f"station target [ih th] value [{'gon' if known.angle else 'm'}] σ"

    def _add(self, kind: str, *words: str) -> None:
        self.lines.setdefault(kind, []).append(" ".join(words))

    # -- points and unknowns ----------------------------------------------------------------------

    def _point(self, p: Point) -> None:
        where = f"point {p.name!r}"
        odd = [c for c in p.name if c.isspace() or c == ";" or not c.isprintable()]
        if odd or p.name.startswith("#") or len(p.name) > MAX_NAME_CHARACTERS:
            self.refuse(f"a name with {odd[0]!r}" if odd else "such a name", where)
        if p.check is not None:
            self.refuse("check points", where)
        if np.isnan(p.coordinates).any():
            self.refuse("a point without coordinates: write the adjusted network", where)
            return
        free = self.network.datum == "free"
        dimension = {"": 3, "xyz": 3, "xy": 1, "z": 2}.get(p.held)
        if dimension is None:
            self.refuse(f"a point that is held in {p.held} alone", where)
            return
        axes = {1: "z", 2: "xy", 3: "xyz"}[dimension]
        sigma = [math.inf if p.sigma is None else p.sigma["xyz".index(a)] for a in axes]
        weighted = [math.isfinite(s) for s in sigma]
        everyone = not any(q.datum for q in self.network.points.values())
        if p.held == "xyz":
            status = "reference"
        elif any(weighted):
            status = "stochastic"
            if not all(weighted):
                self.refuse("a point of which some coordinates are weighted", where)
        else:
            status = "datum" if free and (p.datum or everyone) else "new"
        if free and status in ("reference", "stochastic"):
            self.refuse(f"a {status} point in a free network: JAG3D would leave it out", where)
        shown = [p.coordinates[k] for k in self.order][: 2 if dimension == 2 else 3]
        words = [write_quantity(v) for v in shown]
        if status == "stochastic":
            of = self.order if dimension == 3 else self.order[:2] if dimension == 2 else (2,)
            assert p.sigma is not None
            words += [write_quantity(p.sigma[k]) for k in of]
        self._add(f"{status}_points_{dimension}d", p.name, *words)

    def _unknowns(self) -> None:
        for kind, table in self.network.parameters.items():
            for key, unknown in table.items():
                where = f"{UNKNOWNS[kind].noun} {key!r}"
                if kind == "vertical":
                    self._vertical(str(key), unknown, where)
                elif kind == "orientation":
                    if unknown.fixed[0] or math.isfinite(unknown.sigma[0]):
                        self.refuse("an orientation that is held or weighted", where)
                elif any(unknown.values) or not all(unknown.fixed):
                    self.refuse("a stated unknown of this kind", where)

    def _vertical(self, name: str, unknown: Parameter, where: str) -> None:
        xi, eta = unknown.values
        weighted = [math.isfinite(s) for s in unknown.sigma]
        if len(set(unknown.fixed)) > 1 or len(set(weighted)) > 1:
            self.refuse("a deflection of which one component is held or weighted", where)
            return
        status = "reference" if unknown.fixed[0] else "stochastic" if weighted[0] else "unknown"
        words = [write_quantity(-xi, "gon"), write_quantity(eta, "gon")]
        if status == "stochastic":
            words += [write_quantity(s, "gon") for s in unknown.sigma]
        self._add(f"{status}_deflections", name, *words)

    # -- observations -----------------------------------------------------------------------------

    def _observations(self) -> None:
        before = len(self.problems)
        for o in self.network.observations.values():
            if type(o) not in _FORMS:
                self.refuse(f"a {o.kind.replace('_', ' ')}", o.label())
            elif any(getattr(o, a, None) for a in UNSUPPORTED_INSTRUMENT_ERRORS):
                self.refuse("unknowns of instruments", o.label())
            elif isinstance(o, Direction) and o.face != 1:
                self.refuse("directions of the second face", o.label())
        if len(self.problems) > before or not self.network.observations:
            return
        sigmas = scalar_sigmas(self.network)
        sets: dict[str, list[str]] = {}
        ordered = sorted(
            self.network.observations.items(),
            key=lambda item: (
                (item[1].station, item[1].set) if isinstance(item[1], Direction) else ("", "")
            ),
        )
        for ident, o in ordered:
            sigma = sigmas[ident]
            if math.isnan(sigma):
                what = "a σ that depends on unknown coordinates: write the adjusted network"
                self.refuse(what, o.label())
                continue
            kind, words = _FORMS[type(o)](self, o, sigma)
            if isinstance(o, Direction):
                of_station = sets.setdefault(o.station, [])
                if o.set not in of_station:
                    of_station.append(o.set)
                n = of_station.index(o.set) + 1
                kind = "directions" if n == 1 else f"directions_{n}"
            self._add(kind, o.station, o.target, *words)  # type: ignore[attr-defined]

    def scalar(self, o: Observation, value: float, sigma: float, unit: str = "") -> list[str]:
        """Return heights, value and σ of an observation."""
        ih, th = o.instrument_height, o.target_height  # type: ignore[attr-defined]
        error = write_quantity(sigma, unit)
        if float(error) >= 1.0:
            self.refuse(f"a σ of {error} {unit or 'm'}: JAG3D takes it for a length", o.label())
        heights = [write_quantity(ih), write_quantity(th)] if ih or th else []
        return [*heights, write_quantity(value, unit), error]

    def vector(self, o: Observation, axes: str) -> tuple[str, list[str]]:
        """Return kind and numbers of a difference of coordinates."""
        covariance = getattr(o, "covariance", None)
        if covariance is not None and np.any(covariance - np.diag(np.diag(covariance))):
            self.refuse("correlated components", o.label())
        sigma = o.sigma if covariance is None else np.sqrt(np.diag(covariance))  # type: ignore[attr-defined]
        if getattr(o, "instrument_height", 0.0) or getattr(o, "target_height", 0.0):
            self.refuse("heights of antennas", o.label())
        if getattr(o, "horizon", False) or getattr(o, "condition", False):
            self.refuse("a difference in a horizon, or a condition", o.label())
        kind = {"z": "gnss_1d", "xy": "gnss_2d", "xyz": "gnss_3d"}.get("".join(sorted(axes)))
        if kind is None:
            self.refuse(f"differences of {axes} alone", o.label())
            return "gnss_3d", []
        of = [axes.index("xyz"[k]) for k in self.order if "xyz"[k] in axes]
        value = o.value  # type: ignore[attr-defined]
        return kind, [write_quantity(float(part[k])) for part in (value, sigma) for k in of]


READER = Reader(
    "jag3d",
    (".script", ".txt"),
    "JAG3D",
    NetworkReader(read_jag3d),
    folders=True,
    recognises=is_jag3d,
)
