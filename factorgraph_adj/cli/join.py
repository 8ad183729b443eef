"""The command ``factorgraph-adj join``: read several files of one object, write one network."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import get_args

from ..errors import InputError, Problem, known
from ..frames import LocalFrame
from ..io.project import Project
from ..io.readers import READERS, Reader
from ..io.writers import WRITERS
from ..network.join import Sets, join
from .convert import add_writing
from .exit_codes import FINE
from .grid import moved, system_of
from .input import PROJECT_HELP, add_reading, read_input, settings
from .messages import warn


def add_join(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.epilog = (
        "--set FILE:KEY=VALUE is an option of the reader of one file, --set KEY=VALUE of "
        "every reader that has it; --frame is geocentric unless stated"
    )
    parser.add_argument("files", metavar="FILE", nargs="+", help=PROJECT_HELP)
    add_writing(parser)
    add_reading(parser)
    parser.add_argument(
        "--sets",
        choices=get_args(Sets),
        default="apart",
        help="whether sets of directions of one name at one station, in several files, are set-ups "
        "of their own (apart)",
    )
    parser.set_defaults(run=_join)


def _join(options: argparse.Namespace) -> int:
    writing = settings(options.writing, "--with")
    WRITERS.of(Path(options.out), options.to)  # before a long reading
    projects = _read(options)
    for project in projects:
        warn(project.warnings)
    network = _joined(projects, options).network
    WRITERS.write(network, options.out, format=options.to, options=writing)
    print(
        f"{options.out}: {len(network.points)} points, {len(network.photos)} photos, "
        f"{network.n_image_points} image points and {len(network.observations)} other "
        f"observations of {len(projects)} files"
    )
    return FINE


def _read(options: argparse.Namespace) -> list[Project]:
    """Read the files, each with the options that concern it; all problems are raised at once."""
    system_of(options)
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


def _joined(projects: Sequence[Project], options: argparse.Namespace) -> Project:
    """Return the project of all: files in a grid together, then with those on the Earth.

    A book of a level has no plan, so that it leaves the grid with the points of the others.
    """
    system = system_of(options)
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
    if system is not None:
        grid = settings(options.grid, "--grid")
        first = moved(first, system, grid, options.frame or "geocentric")
    if not rest:
        return first
    networks = [first.network, *(p.network for p in rest)]
    return replace(first, network=join(networks, sets=options.sets))
