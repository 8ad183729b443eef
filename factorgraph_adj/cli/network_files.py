"""Commands ``check`` (problems and doubts), ``convert`` and ``join``, without an adjustment."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from copy import copy
from dataclasses import dataclass, replace
from pathlib import Path
from typing import get_args

from ..errors import InputError, Problem, known
from ..frames import LocalFrame
from ..graph.equations import compile_rows
from ..graph.listed_points import with_listed_points_apart
from ..io.format_reader import Reader
from ..io.project import Project
from ..io.readers import READERS
from ..io.writers import WRITERS
from ..network.joined_networks import Sets, join
from ..network.network import Network
from ..orientation.choice_of_start import start_or_problems
from ..report.doubtful_results import notes_of_network
from ..validate.mistyped_names import mistyped_at_start
from ..validate.network_structure import LEAVE_OUT_ADVICE, check
from ..validate.preliminary_checks import named_mistakes, preliminary
from ..validate.stated_values import wrong_line_lengths
from .input import (
    PROJECT_HELP,
    add_project,
    add_reading,
    parsed_settings,
    project_on_earth,
    read_input,
    stated_reference_system,
)
from .messages import (
    ALL_HELP,
    EXIT_BAD_INPUT,
    EXIT_DOUBTFUL,
    EXIT_FINE,
    print_problems,
    print_warnings,
    problem_lines,
)

WITHOUT_READINGS = (
    "If nothing is measured yet: a design needs no readings for `factorgraph-adj plan`, and "
    "`factorgraph-adj serve` and `factorgraph-adj stream` take readings as they arrive."
)
"""Note to a project without readings."""


def add_check(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_project(parser)
    parser.add_argument("--all", action="store_true", help=ALL_HELP)
    parser.set_defaults(run=_check)


def _check(options: argparse.Namespace) -> int:
    from ..site.site_file import is_site

    try:
        if options.read_as is None and is_site(options.project):
            return _check_site(options)
        project = read_input(options)
    except InputError as error:
        print_problems(error.problems, every=options.all)
        _hint_at_plan(options, len(error.problems))
        return EXIT_BAD_INPUT
    return check_project(project, every=options.all)


def _check_site(options: argparse.Namespace) -> int:
    """Print the doubts of a site file and of its projects; return an exit code."""
    from .site_service import checked_site

    outside = options.allow_outside
    projects, warnings, problems = checked_site(options.project, allow_outside=outside)
    for line in problem_lines(warnings, every=options.all):
        print(line)
    if problems:
        raise InputError(problems)
    codes = [EXIT_DOUBTFUL if warnings else EXIT_FINE]
    for project in projects:
        network = project.network
        if network.observations or network.n_image_points:
            codes.append(check_project(project, every=options.all))
        else:
            print(f"{network.name}: {len(network.points)} points, and no readings yet")
    return max(codes)


def check_project(project: Project, *, every: bool = False) -> int:
    """Print the problems and doubts of a project before its adjustment; return an exit code.

    Args:
        project: the project.
        every: whether problems that repeat are listed one by one.
    """
    try:
        refuse_problems(project)
    except InputError as error:
        print_problems(error.problems, every=every)
        if not project.network.observations and not project.network.n_image_points:
            print(WITHOUT_READINGS, file=sys.stderr)
        return EXIT_BAD_INPUT
    network = with_listed_points_apart(project.network)
    content = (
        f"{len(network.points)} points, {len(network.photos)} photos, {network.n_image_points} "
        f"image points and {len(network.observations)} other observations"
    )
    length, angle = project.units.length, project.units.angle
    start, without = start_or_problems(network)
    found = [
        *project.warnings,
        *preliminary(network, length=length, angle=angle),
        *([] if start is None else mistyped_at_start(network, start.state)),
        *([] if start is None else wrong_line_lengths(compile_rows(network), start.state)),
    ]
    noted = [str(left) for left in network.left_out if not left.doubtful]
    noted += network.remarks
    noted += notes_of_network(network)
    name = network.name or "a network without a name"
    if not found and not without:
        print(f"{name}: no problems found in {content}; approximate values are there")
        print_notes(noted)
        return EXIT_FINE
    print(f"{name}: {content}")
    if found:
        n = len(found)
        print(
            f"{n} doubt{'s' * (n != 1)} about files, readings or given values; nothing was changed:"
        )
        for line in problem_lines(found, every=every):
            print(line)
    if without:
        print("adjust will find no approximate values for:")
        for line in problem_lines(without, every=every):
            print(line)
    print_notes(noted)
    return EXIT_DOUBTFUL


def print_notes(noted: Sequence[str]) -> None:
    """Print what is no doubt: what the reader left out, as it always does, and copied returns."""
    for one in noted:
        print(f"note: {one}")


def refuse_problems(project: Project, *, leaving_out: bool = False) -> None:
    """Raise all problems of a network that can be found before the adjustment.

    Args:
        project: the project.
        leaving_out: whether problems that leaving out solves are none: what is undetermined was
            left out in vain, and the error of the adjustment says why.

    Raises:
        InputError: the network has problems; those of points and photos state file and line.
    """
    problems = check(project.network, sources=project.sources)
    if leaving_out:
        problems = tuple(p for p in problems if LEAVE_OUT_ADVICE not in p.what)
    if problems:
        # Points behind cameras are a symptom; images with y the wrong way are the cause. So is a
        # table that is not read because of its name.
        length, angle = project.units.length, project.units.angle
        causes = [
            Problem(str(f)) for f in named_mistakes(project.network, length=length, angle=angle)
        ]
        raise InputError([*project.warnings, *causes, *problems])


def _hint_at_plan(options: argparse.Namespace, n_problems: int) -> None:
    """Print that a design needs no readings, if the input lacks readings."""
    try:
        read_input(options, readings=False)
    except InputError as error:
        if len(error.problems) >= n_problems:
            return
    print(WITHOUT_READINGS, file=sys.stderr)


def add_convert(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_project(parser)
    add_writing(parser)
    parser.set_defaults(run=_convert)


def add_writing(parser: argparse.ArgumentParser) -> None:
    """Add the file to write, its format and options."""
    parser.add_argument("out", metavar="OUT", help=f"a file: {WRITERS}")
    parser.add_argument(
        "--to",
        choices=[w.name for w in WRITERS.entries],
        metavar="FORMAT",
        help="the format to write, where the suffix does not tell it: "
        + ", ".join(w.name for w in WRITERS.entries),
    )
    parser.add_argument(
        "--with",
        dest="writing",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="an option of the writer of the format; may be repeated",
    )


def _convert(options: argparse.Namespace) -> int:
    writing = parsed_settings(options.writing, "--with")
    writer = WRITERS.of(Path(options.out), options.to)  # before a long reading
    project = read_input(options)
    print_warnings(project.warnings)
    WRITERS.write(project.network, options.out, format=options.to, options=writing)
    network = project.network
    if writer.alone:
        print(f"{options.out}: {writer.alone} of {options.project}, and nothing else of it")
        return EXIT_FINE
    print(
        f"{options.out}: {len(network.points)} points, {len(network.photos)} photos, "
        f"{network.n_image_points} image points and {len(network.observations)} other "
        f"observations of {options.project}"
    )
    return EXIT_FINE


def add_join(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.epilog = (
        "--set FILE:KEY=VALUE is an option of the reader of one file, --set KEY=VALUE of "
        "every reader that has it; --frame is geocentric unless stated"
    )
    parser.add_argument("files", metavar="FILE", nargs="+", help=PROJECT_HELP)
    add_writing(parser)
    add_reading(parser)
    add_sets(parser)
    add_points(parser)
    parser.set_defaults(run=_join)


def add_points(parser: argparse.ArgumentParser) -> None:
    """Add the option of another project that gives the points."""
    parser.add_argument(
        "--points-from",
        metavar="PROJECT",
        help="take coordinates and datum (held, weighted, or carrying a free datum) of points with "
        "the same names from another project, such as the adjusted project of the previous epoch; "
        "readings and other unknowns are not taken",
    )


def add_sets(parser: argparse.ArgumentParser) -> None:
    """Add the option of sets of directions in several files."""
    parser.add_argument(
        "--sets",
        choices=get_args(Sets),
        default="apart",
        help="whether sets of directions of one name at one station, in several files, are set-ups "
        "of their own (apart)",
    )


def _join(options: argparse.Namespace) -> int:
    writing = parsed_settings(options.writing, "--with")
    WRITERS.of(Path(options.out), options.to)  # before a long reading
    projects = read_files(options)
    for project in projects:
        print_warnings(project.warnings)
    given = given_points(projects, options)
    network = joined_project(projects, options, given).network
    WRITERS.write(network, options.out, format=options.to, options=writing)
    print(
        f"{options.out}: {len(network.points)} points, {len(network.photos)} photos, "
        f"{network.n_image_points} image points and {len(network.observations)} other "
        f"observations of {len(projects)} files"
    )
    if given is not None:
        for said in given.compared():
            print(f"  {said}")
    return EXIT_FINE


def read_files(options: argparse.Namespace) -> list[Project]:
    """Read the files, each with the options that concern it; all problems are raised at once."""
    stated_reference_system(options)
    problems: list[Problem] = []
    out: list[Project] = []
    readers: dict[str, Reader] = {}
    for file in options.files:
        if file in readers:
            problems.append(Problem("is named twice: a file is joined once", file))
        elif not Path(file).exists():
            problems.append(Problem("no such file or folder", file))
        else:
            readers[file] = READERS.reader(Path(file), options.read_as)
    if problems:
        raise InputError(problems)
    of_file = _settings_of(options.reading, readers)
    for file, reader in readers.items():
        own = copy(options)
        own.reading = of_file[file]
        if not reader.own_grid:  # the grid is left when all its files are joined
            own.crs, own.geoid, own.heights, own.frame, own.grid = None, None, None, None, []
        try:
            out.append(read_input(own, file))
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    return out


def _settings_of(given: Sequence[str], readers: dict[str, Reader]) -> dict[str, list[str]]:
    """Return the settings KEY=VALUE of each file.

    Raises:
        InputError: a setting names a file that is not joined, or an option that no reader has.
    """
    out: dict[str, list[str]] = {file: [] for file in readers}
    problems = []
    for text in given:
        key, equals, value = text.partition("=")
        file, _, option = key.rpartition(":")
        if file and file not in readers:
            what = f"{text!r} is of no file that is joined; known: {known(readers, meant=file)}"
            problems.append(Problem(what, "--set"))
            continue
        own = [file] if file else [f for f, r in readers.items() if option in r.options]
        if not own:
            valid = dict.fromkeys(o for r in readers.values() for o in r.options)
            what = f"no reader of these files has the option {option!r}; they have: "
            problems.append(Problem(what + known(valid, meant=option), "--set"))
        for f in own:
            out[f].append(f"{option}{equals}{value}")
    if problems:
        raise InputError(problems)
    return out


@dataclass(frozen=True)
class GivenPoints:
    """Points of another project, for the files of a survey."""

    name: str
    """File or folder of the project, as typed."""
    network: Network
    """The points that the files have too, with their datum, and nothing else."""
    absent: tuple[str, ...]
    """Points of the project that no file has."""
    new: tuple[str, ...]
    """Points of the files that the project does not have."""

    def compared(self) -> Iterator[str]:
        """Yield which points are given, which of the project were not measured, which are new."""
        points = self.network.points.values()
        kinds = {
            "held": sum(bool(p.held) for p in points),
            "weighted": sum(p.sigma is not None for p in points),
            "datum points": sum(p.datum for p in points) if self.network.datum == "free" else 0,
        }
        of_datum = ", ".join(f"{n} {kind}" for kind, n in kinds.items() if n)
        yield (
            f"{len(points)} points have the coordinates of {self.name}; "
            f"its datum: {of_datum or 'none of these'}"
        )
        if self.absent:
            yield f"not in these files, and left out: {known(self.absent)}"
        if self.new:
            yield f"not in {self.name}: {known(self.new)}"


def given_points(projects: Sequence[Project], options: argparse.Namespace) -> GivenPoints | None:
    """Return the points of the project that --points-from names; None: it names none.

    Raises:
        InputError: the project has problems, or none of the points of the files.
    """
    if options.points_from is None:
        return None
    other = READERS.load(options.points_from, readings=False, allow_outside=options.allow_outside)
    source = other.network
    measured = dict.fromkeys(n for p in projects for n in p.network.points)
    both = {name: point for name, point in source.points.items() if name in measured}
    if not both:
        what = (
            f"has none of the points of the files; it has {known(source.points)}, "
            f"they have {known(measured)}"
        )
        raise InputError(Problem(what, f"--points-from {options.points_from}"))
    network = Network(
        source.name or str(options.points_from),
        frame=source.frame,
        datum=source.datum,
        crs=source.crs,
    )
    network.points = both
    network.point_number = {name: i for i, name in enumerate(both)}
    return GivenPoints(
        str(options.points_from),
        network,
        tuple(n for n in source.points if n not in both),
        tuple(n for n in measured if n not in both),
    )


def joined_project(
    projects: Sequence[Project], options: argparse.Namespace, given: GivenPoints | None = None
) -> Project:
    """Return one project of all: files in a grid together, then with those on the Earth.

    A book of a level has no plan, so that it leaves the grid with the points of the others. Given
    points come first: their coordinates are those of the joined network unless a file holds others.
    """
    system = stated_reference_system(options)
    local = [p for p in projects if isinstance(p.network.frame, LocalFrame)]
    if system is None or not local:
        local = list(projects)
    rest = [p for p in projects if not any(p is q for q in local)]
    sources = {k: v for p in reversed(projects) for k, v in p.sources.items()}
    first = replace(
        local[0],
        network=join((p.network for p in local), sets=options.sets),
        sources=sources,
    )
    if given is not None:
        # The name is that of the survey, not of the project that gives the points.
        joined = join((given.network, first.network), name=first.network.name)
        first = replace(first, network=joined)
    if system is not None:
        grid = parsed_settings(options.grid, "--grid")
        first = project_on_earth(first, system, grid, options.frame or "geocentric")
    if not rest:
        return first
    networks = [first.network, *(p.network for p in rest)]
    return replace(first, network=join(networks, sets=options.sets))
