"""Command ``new``: a project folder made from the files of a survey, with what was assumed."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from ..errors import InputError, Problem, known
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
from ..network.network import Network
from .input import add_reading
from .messages import ALL_HELP, print_warnings
from .network_files import (
    GivenPoints,
    add_points,
    add_sets,
    check_project,
    given_points,
    joined_project,
    print_notes,
    read_files,
)

OR_OF_FILE = "or what the file states"
SIGHT_KINDS = ("direction", "zenith_angle", "slope_distance", "horizontal_distance")
USUAL_ACCURACIES: dict[str, tuple[object, str, tuple[str, ...]]] = {
    "sigma_direction_mgon": (
        DEFAULT_DIRECTION_MGON,
        f"σ of a direction in one face, {OR_OF_FILE}",
        ("direction",),
    ),
    "sigma_zenith_mgon": (
        DEFAULT_ZENITH_MGON,
        f"σ of a zenith angle in one face, {OR_OF_FILE}",
        ("zenith_angle",),
    ),
    "sigma_distance_mm": (
        DEFAULT_DISTANCE_MM,
        f"constant part of σ of a distance, {OR_OF_FILE}",
        ("slope_distance", "horizontal_distance"),
    ),
    "ppm": (
        DEFAULT_DISTANCE_PPM,
        "part of σ of a distance that grows, mm/km",
        ("slope_distance", "horizontal_distance"),
    ),
    "centring_mm": (
        DEFAULT_CENTRING_MM,
        "σ of centring of instrument and target, mm",
        SIGHT_KINDS,
    ),
    "sigma_levelling_mm": (
        DEFAULT_LEVELLING_MM,
        "σ of 1 km of levelled line, mm",
        ("height_difference",),
    ),
    "faces": ("means", "readings in two faces: means or both", ("direction", "zenith_angle")),
    "refraction": (
        DEFAULT_REFRACTION,
        "coefficient of refraction; none: heights above a plane",
        ("zenith_angle",),
    ),
}
"""Usual values of the options of field books, what they are, and kinds that they concern."""
FACES_APART = re.compile(r"(^|:)faces\s*=\s*\W?both")
"""Option of readings in both faces, of which the centring is one error: it is not assumed then."""
Assumed = Sequence[tuple[str, object, str]]
"""Options that nobody stated: names, usual values, words."""
MAX_NAMES = 20
"""Largest number of points that are named."""
FREE_DATUM = "nothing is held: the network is free"


def add_new(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.description = (
        "Read the files of a survey, write a project folder (project.toml with comments, tables), "
        "and check it. In a terminal, the command asks for what the files do not state: points "
        "that are held, standard deviations; Enter takes the value in brackets."
    )
    parser.add_argument(
        "folder",
        metavar="FOLDER",
        help="folder of the project; it is created, and must not contain project.toml",
    )
    parser.add_argument(
        "files",
        metavar="FILE",
        nargs="+",
        help="files of a survey (field books, GNSS, photos); `factorgraph-adj formats` lists the "
        "formats",
    )
    add_reading(parser)
    add_sets(parser)
    add_points(parser)
    parser.add_argument(
        "--yes", action="store_true", help="ask nothing: take the defaults, and print them"
    )
    parser.add_argument("--all", action="store_true", help=ALL_HELP)
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
    projects = read_files(options)
    for project in projects:
        print_warnings(project.warnings)
    given = given_points(projects, options)
    project = joined_project(projects, options, given)
    assumed = list(_assumed(readers, options.reading, project.network))
    write_project(project.network, main, heading=_heading(options, project, readers, assumed))
    _print_made(main, project, assumed, given)
    code = check_project(READERS.load(folder), every=options.all)
    print(f"next: factorgraph-adj adjust {folder}")
    return code


def _assumed(
    readers: Sequence[Reader], given: Sequence[str], network: Network | None = None
) -> Iterator[tuple[str, object, str]]:
    """Yield options of accuracy that nobody stated and the network needs: name, value, words."""
    stated = {text.partition("=")[0].rpartition(":")[2] for text in given}
    for name, (usual, words, kinds) in USUAL_ACCURACIES.items():
        of_readers = any(name in reader.options for reader in readers)
        concerned = network is None or any(o.kind in kinds for o in network.observations.values())
        if name not in stated and of_readers and concerned:
            both = name == "centring_mm" and any(FACES_APART.search(text) for text in given)
            yield name, 0.0 if both else usual, words


def _answers(options: argparse.Namespace, readers: Sequence[Reader], assumed: Assumed) -> list[str]:
    """Ask for points that are held and for accuracies; return them as options --set."""
    out = []
    stated = {text.partition("=")[0].rpartition(":")[2] for text in options.reading}
    for name, usual, words in assumed:
        if answer := input(f"{words} [{usual}]: ").strip():
            out.append(f"{name}={answer}")
    told = "fixed" in stated or options.points_from is not None
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
    if options.points_from is not None:
        yield f"Coordinates and datum of points are those of {options.points_from}."
    if options.reading:
        yield f"Options of reading: {', '.join(options.reading)}."
    if assumed:
        yield "Assumed, because nothing stated it (change it below, or make the project again"
        yield "with --set NAME=VALUE):"
        yield from (f"  {name} = {usual}  {words}" for name, usual, words in assumed)
    network = project.network
    yield from network.remarks
    if network.datum == "free":
        yield f'{FREE_DATUM.capitalize()}. To hold points, write datum = "given"'
        yield "and xyz in the column fixed of points.csv, behind their coordinates."
    yield "A row of observations.csv that states no standard deviation has that of [sigma.KIND];"
    yield "that of the mean of two faces is 1/√2 of that of one reading."
    yield "Then: factorgraph-adj check, adjust, plan or compare with this folder."
    yield ""


def _held_points(network: Network) -> Iterator[tuple[str, list[str]]]:
    """Yield which points are held, beside what the network holds of all of them.

    A network of heights holds all points in plan, and a plane one in height.
    """
    every = ["".join(a for a in "xyz" if a in p.held) for p in network.points.values()]
    of_all = {a for a in "xyz" if every and all(a in held for held in every)}
    of_all = set() if of_all == set("xyz") else of_all
    of_kind: dict[str, list[str]] = {}
    for point, held in zip(network.points.values(), every, strict=True):
        if own := "".join(a for a in held if a not in of_all):
            of_kind.setdefault(own, []).append(point.name)
    whole = "".join(a for a in "xyz" if a not in of_all)
    for axes, names in of_kind.items():
        yield "held" if axes == whole else f"held in {', '.join(axes)}", names


def _print_made(main: Path, project: Project, assumed: Assumed, given: GivenPoints | None) -> None:
    """Print what was written, where its points are from, and what was assumed."""
    network = project.network
    print(f"{main}: {len(network.points)} points, {len(network.observations)} observations")
    for said in () if given is None else given.compared():
        print(f"  {said}")
    if network.datum == "free":
        print(
            f"  {FREE_DATUM}; --set fixed=A,B holds points at the coordinates of the files, "
            "--points-from PROJECT takes coordinates and datum of another epoch"
        )
    for words, names in _held_points(network):
        print(f"  {words}: {known(names, most=MAX_NAMES)}")
    print_notes([*(str(left) for left in network.left_out), *network.remarks])
    for name, usual, words in assumed:
        print(f"  assumed: {name} = {usual} ({words})")
