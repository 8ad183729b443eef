"""Reader of JAG3D: projects, and flat files of groups of points and observations."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import get_args

from ...errors import InputError, Problem, known
from ...network.network import Network
from ...units import ANGLE, LENGTH
from .accuracies import names_of
from .jag3d_flat import ESTIMATED, FILE_KINDS, FlatFiles, files_of, kind_of_file, units_of
from .jag3d_network import as_network, with_set_names
from .jag3d_project import Epoch, is_project, read_project_of_jag3d


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
    epoch: Epoch = "both",
) -> Network:
    """Read a project of JAG3D, or flat files of its groups.

    A project is the script of a database, ``name.script``, with ``name.data`` beside it, or what
    the statement ``SCRIPT 'name.script'`` of HSQLDB writes. Everything that takes part in its
    adjustment is read: points, observations, σ, additional parameters, deflections of the vertical,
    reductions for the curvature of the Earth and for height. Groups, points and observations that
    are switched off are left out, as are results, point pairs of the congruence analysis (see
    `factorgraph_adj.io.survey.jag3d_project.point_pairs`), settings of tests and of display; the
    options on σ and units have no effect.

    Flat files have one group each. Names tell what they hold: the kinds are
    ``reference_points_3d`` (also ``stochastic_``, ``datum_``, ``new_``; ``_1d``, ``_2d``),
    ``levelling``, ``directions``, ``horizontal_distances``, ``slope_distances``,
    ``zenith_angles``, ``gnss_1d``, ``gnss_2d``, ``gnss_3d``, and ``reference_deflections`` (also
    ``stochastic_``, ``unknown_``); the words may stand anywhere in a name, German ones too
    (Festpunkte, Neupunkte, Richtungen, Schrägstrecken …). Rows without σ get σ² = a² + (part that
    depends on the length)². Default parts are those of JAG3D.

    Coordinates become x = y of JAG3D (east), y = x of JAG3D (north), z up. Datum points make the
    network a free one. 1-D points are held in plan, 2-D points in height.

    Args:
        path: the script of a project, a folder with flat files, a flat file, or a list of them.
        kinds: what a file holds by its name, for names that do not tell it: one of the kinds, or
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
            wrong dimension, points that stand twice, reference beside datum points, unknown scales
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
        if not _good(value, zero)
    ]
    if epoch not in (valid := get_args(Epoch)):
        problems.append(Problem(f"must be one of {known(valid)}, not {epoch!r}", "epoch"))
    estimated = names_of(estimate)
    for word in estimated:
        if word not in ESTIMATED:
            what = f"unknown parameter {word!r}; valid: {known(ESTIMATED, meant=word)}"
            problems.append(Problem(what, "estimate"))
    if problems:
        raise InputError(problems)
    if isinstance(path, str | Path) and Path(path).suffix in (".script", ".data"):
        return read_project_of_jag3d(Path(path).with_suffix(".script"), epoch=epoch)
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
    read = FlatFiles(units_of(length, angle), parts, separate, estimated)
    files = files_of(path)
    told = _kinds(files, dict(kinds or {}), read.problems)
    untold = bool(read.problems)
    for file, kind in told:
        read.read(file, kind)
    if untold:  # which points are unknown is not known without all files
        raise InputError(read.problems)
    name = Path(path).stem if isinstance(path, str | Path) else files[0].parent.name
    return as_network(
        name,
        read.points,
        with_set_names(read.groups),
        deflections=read.deflections,
        point_sigma=point_mm * mm,
        problems=read.problems,
        where=read.end or files[0].name,
    )


def is_jag3d(path: Path) -> bool:
    """Return whether a file is a project of JAG3D or a flat file, or a folder has flat files.

    Flat files are told by their names. In a folder most names tell what the file holds, of two
    kinds at least; a name that does not is a problem of the reader.
    """
    if not path.is_dir():
        named = path.suffix.casefold() == ".txt" and kind_of_file(path) is not None
        return named or is_project(path)
    try:
        kinds = [kind_of_file(file) for file in files_of(path)]
    except (InputError, OSError):
        return False
    if (path / "project.toml").exists():
        return False
    found = [k for k in kinds if k is not None]
    has_points = any("points" in k for k in found)
    return (has_points and None not in kinds) or len(set(found)) >= 2 > len(kinds) / len(found)


def _good(value: object, zero: bool) -> bool:
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    return (value >= 0 if zero else value > 0) and value < 1e9


def _kinds(
    files: Sequence[Path], stated: Mapping[str, str], problems: list[Problem]
) -> list[tuple[Path, str]]:
    """Return the files with their kinds; problems are noted."""
    valid = ", ".join(FILE_KINDS)
    out = []
    for name in stated:
        if name not in [f.name for f in files]:
            problems.append(Problem(f"kinds names {name!r}, which is none of the files", name))
    for file in files:
        kind = stated.get(file.name, kind_of_file(file))
        if isinstance(kind, str) and kind not in FILE_KINDS:
            kind = kind_of_file(Path(kind)) or kind  # other words, such as Festpunkte 3D
        if kind is None:
            what = (
                "its name does not tell what it holds: rename it, or state "
                f"kinds = {{'{file.name}': KIND}}; valid: {valid}"
            )
            problems.append(Problem(what, file.name))
        elif kind not in FILE_KINDS:
            problems.append(Problem(f"unknown kind {kind!r}; valid: {valid}", file.name))
        else:
            out.append((file, kind))
    return out
