"""Command ``new``: a project folder made from the files of a survey, with what was assumed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..errors import InputError, Problem
from ..io.field_books.accuracies import (
    DEFAULT_CENTRING_MM,
    DEFAULT_DIRECTION_MGON,
    DEFAULT_DISTANCE_MM,
    DEFAULT_DISTANCE_PPM,
    DEFAULT_LEVELLING_MM,
    DEFAULT_REFRACTION,
    DEFAULT_ZENITH_MGON,
)
from ..io.format_reader import Reader
from ..io.project import Project
from ..io.project_writer import write_project
from ..io.readers import READERS
from .input import PROJECT_HELP, add_reading
from .messages import print_warnings
from .network_files import (
    GivenPoints,
    add_points,
    add_sets,
    check_project,
    given_points,
    joined_project,
    read_files,
)

OR_OF_FILE = "or what the file states"
USUAL_ACCURACIES = {
    "sigma_direction_mgon": (DEFAULT_DIRECTION_MGON, f"σ of a direction in one face, {OR_OF_FILE}"),
    "sigma_zenith_mgon": (DEFAULT_ZENITH_MGON, f"σ of a zenith angle in one face, {OR_OF_FILE}"),
    "sigma_distance_mm": (DEFAULT_DISTANCE_MM, f"constant part of σ of a distance, {OR_OF_FILE}"),
    "ppm": (DEFAULT_DISTANCE_PPM, "part of σ of a distance that grows, mm/km"),
    "centring_mm": (DEFAULT_CENTRING_MM, "σ of centring of instrument and target, mm"),
    "sigma_levelling_mm": (DEFAULT_LEVELLING_MM, "σ of 1 km of levelled line, mm"),
    "faces": ("means", "readings in two faces: means or both"),
    "refraction": (DEFAULT_REFRACTION, "coefficient of refraction; none: heights above a plane"),
}
"""Usual values of the options of field books, and what they are."""
Assumed = Sequence[tuple[str, object, str]]
"""Options that nobody stated: names, usual values, words."""
FREE_DATUM = "nothing is held: the network is free"


def add_new(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Read the files of a survey, write a project folder (project.toml with comments, tables), "
        "and check it. In a terminal, the command asks for what the files do not state: points "
        "that are held, standard deviations; Enter takes the value in brackets."
    )
    parser.add_argument("folder", metavar="FOLDER", help="folder of the project; it is created")
    parser.add_argument("files", metavar="FILE", nargs="+", help=PROJECT_HELP)
    add_reading(parser)
    add_sets(parser)
    add_points(parser)
    parser.add_argument(
        "--yes", action="store_true", help="ask nothing: take the usual values, and say which"
    )
    parser.add_argument("--all", action="store_true", help="list problems one by one")
    parser.set_defaults(run=_new)


def _new(options: argparse.Namespace) -> int:
    folder = Path(options.folder)
    main = folder / "project.toml"
    if main.exists():
        raise InputError(Problem("is there already: name another folder", str(main)))
    if folder.exists() and not folder.is_dir():
        raise InputError(Problem("is a file; valid: a folder that is made", str(folder)))
    readers = [READERS.reader(Path(f), options.read_as) for f in options.files if Path(f).exists()]
    assumed = list(_assumed(readers, options.reading))
    if not options.yes and sys.stdin.isatty():
        options.reading += _answers(options, readers, assumed)
        assumed = list(_assumed(readers, options.reading))
    projects = read_files(options)
    for project in projects:
        print_warnings(project.warnings)
    given = given_points(projects, options)
    project = joined_project(projects, options, given)
    write_project(project.network, main, heading=_heading(options, project, readers, assumed))
    _print_made(main, project, assumed, given)
    code = check_project(READERS.load(folder), every=options.all)
    print(f"next: factorgraph-adj adjust {folder}")
    return code


def _assumed(readers: Sequence[Reader], given: Sequence[str]) -> Iterator[tuple[str, object, str]]:
    """Yield the options of accuracy that nobody stated: name, usual value, words."""
    stated = {text.partition("=")[0].rpartition(":")[2] for text in given}
    for name, (usual, words) in USUAL_ACCURACIES.items():
        if name not in stated and any(name in reader.options for reader in readers):
            yield name, usual, words


def _answers(options: argparse.Namespace, readers: Sequence[Reader], assumed: Assumed) -> list[str]:
    """Ask for points that are held and for accuracies; return them as options --set."""
    out = []
    stated = {text.partition("=")[0].rpartition(":")[2] for text in options.reading}
    for name, usual, words in assumed:
        if answer := input(f"{words} [{usual}]: ").strip():
            out.append(f"{name}={answer}")
    told = "fixed" in stated or options.points is not None
    if not told and any("fixed" in reader.options for reader in readers):
        names = input("points held at the coordinates of the files, such as A,B [none]: ").strip()
        if names:
            out.append(f"fixed={names}")
    return out


def _heading(
    options: argparse.Namespace,
    project: Project,
    readers: Sequence[Reader],
    assumed: Assumed,
) -> Iterator[str]:
    """Yield the comment at the beginning of project.toml."""
    sources = ", ".join(
        f"{Path(file).name} ({reader.description})"
        for file, reader in zip(options.files, readers, strict=True)
    )
    yield f"Project of factorgraph-adj, made from {sources}."
    if options.points is not None:
        yield f"Coordinates and datum of points are those of {options.points}."
    if options.reading:
        yield f"Options of reading: {', '.join(options.reading)}."
    if assumed:
        yield "Assumed, because nothing stated it (change it below, or make the project again"
        yield "with --set NAME=VALUE):"
        yield from (f"  {name} = {usual}  {words}" for name, usual, words in assumed)
    network = project.network
    if network.datum == "free":
        yield f'{FREE_DATUM.capitalize()}. To hold points, write datum = "given"'
        yield "and xyz in the column fixed of points.csv, behind their coordinates."
    yield "A row of observations.csv that states no standard deviation has that of [sigma.KIND];"
    yield "that of the mean of two faces is 1/√2 of that of one reading."
    yield "Then: factorgraph-adj check, adjust, plan or compare with this folder."
    yield ""


def _print_made(main: Path, project: Project, assumed: Assumed, given: GivenPoints | None) -> None:
    """Print what was written, where its points are from, and what was assumed."""
    network = project.network
    held = [p.name for p in network.points.values() if p.held]
    print(f"{main}: {len(network.points)} points, {len(network.observations)} observations")
    for said in () if given is None else given.compared():
        print(f"  {said}")
    if network.datum == "free":
        print(
            f"  {FREE_DATUM}; --set fixed=A,B holds points at the coordinates of the files, "
            "--points PROJECT has coordinates and datum of another epoch"
        )
    else:
        print(f"  held: {', '.join(held)}")
    for name, usual, words in assumed:
        print(f"  assumed: {name} = {usual} ({words})")
