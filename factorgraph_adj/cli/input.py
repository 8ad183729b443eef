"""Options of reading a project, and its reading: format, settings KEY=VALUE, reference system."""

from __future__ import annotations

import argparse
import json
import tomllib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..crs.reference_system import ReferenceSystem
from ..errors import InputError, Problem
from ..frames import GeocentricFrame, LocalFrame, TopocentricFrame
from ..io.format_options import options_of, refuse_unknown_options
from ..io.format_reader import Reader
from ..io.project import Project
from ..io.readers import READERS
from ..network.grid.conversion import from_grid
from ..network.network import Network

GRID_OPTIONS_OF_COMMAND = ("crs", "frame", "sources")
"""Options of `from_grid` that are options of the command, or its own affair."""
PROJECT_HELP = (
    "project.toml or its folder, or a file or folder of another format, which the command formats "
    "lists"
)
"""Help of the argument for a project."""


def add_grid(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    grid = parser.add_argument_group(
        "coordinates of a grid",
        "of files that do not state their reference system; projects do in [crs]",
    )
    grid.add_argument(
        "--crs",
        metavar="SYSTEM",
        help="reference system of easting, northing, height, such as EPSG:25832+7837: the network "
        "is moved into a frame on the Earth, results come back in the grid. Of a network that is "
        "on the Earth already, the system of its results",
    )
    grid.add_argument(
        "--geoid",
        metavar="PATH|N",
        help="what heights are above: a grid (.gtx, .tif, .gsb), a table of points (.csv), or a "
        "constant undulation in metres",
    )
    grid.add_argument(
        "--heights", choices=("ellipsoidal",), help="heights are above the ellipsoid of the system"
    )
    grid.add_argument(
        "--frame",
        choices=("topocentric", "geocentric"),
        help="frame of the adjustment (topocentric)",
    )
    grid.add_argument(
        "--grid",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="azimuths=true|grid, vectors=geocentric|grid, horizontal_distances=measured|"
        "ellipsoid|sea_level|grid, deflections=none|held|σ in radians, geoid_offset=σ in metres; "
        "may be repeated",
    )


def stated_reference_system(options: argparse.Namespace) -> ReferenceSystem | None:
    """Return the reference system of a command; None: none is stated.

    Raises:
        InputError: options of a grid stand without --crs.
    """
    geoid = options.geoid
    if options.crs is None:
        alone = [
            name
            for name, given in (
                ("--geoid", geoid),
                ("--heights", options.heights),
                ("--frame", options.frame),
                ("--grid", options.grid or None),
            )
            if given is not None
        ]
        if alone:
            raise InputError(f"{', '.join(alone)}: state the reference system too, --crs")
        return None
    if geoid is not None:
        try:
            geoid = float(geoid)
        except ValueError:
            geoid = str(geoid)
    return ReferenceSystem(options.crs, geoid, options.heights).checked()


def options_of_reader(
    reader: Reader, system: ReferenceSystem, grid: dict[str, Any], frame: str | None
) -> dict[str, Any]:
    """Return options of a reader that converts coordinates of a grid itself.

    Raises:
        InputError: the reader has no such option, or takes no other frame.
    """
    if frame == "geocentric":
        raise InputError(f"--frame geocentric: {reader.description} is read in a topocentric frame")
    refuse_unknown_options(
        grid, reader.options, doing=f"reading {reader.description} in a grid", where="--grid"
    )
    return {"crs": system, **grid}


def project_on_earth(
    project: Project,
    system: ReferenceSystem,
    grid: dict[str, Any],
    frame: str | None,
) -> Project:
    """Return a project whose network is on the Earth, with the reference system of its results.

    Args:
        project: the project as read.
        system: the reference system.
        grid: options of `from_grid`.
        frame: kind of the new frame; None: topocentric.

    Raises:
        InputError: the network states a reference system itself, is in another frame than is
            wanted, or as `from_grid`.
    """
    network: Network = project.network
    valid = [o for o in options_of(from_grid) if o not in GRID_OPTIONS_OF_COMMAND]
    refuse_unknown_options(grid, valid, doing="moving a grid to the Earth", where="--grid")
    if network.crs is not None and not isinstance(network.frame, LocalFrame):
        what = f"states its reference system itself ({network.crs.name}): leave --crs out"
        raise InputError(Problem(what, str(project.path)))
    if isinstance(network.frame, LocalFrame):
        made = from_grid(
            network,
            system,
            frame="geocentric" if frame == "geocentric" else "topocentric",
            sources=project.sources,
            **grid,
        )
        return replace(project, network=made)
    kind = {"topocentric": TopocentricFrame, "geocentric": GeocentricFrame}.get(frame or "")
    if grid or (kind is not None and not isinstance(network.frame, kind)):
        what = "is in a frame on the Earth already: --frame and --grid belong to grid coordinates"
        raise InputError(Problem(what, str(project.path)))
    system.refuse_other(network.frame)
    network.crs = system
    return project


def add_project(parser: argparse.ArgumentParser) -> None:
    """Add the argument for the project, and the options of reading it."""
    parser.add_argument("project", metavar="PROJECT", help=PROJECT_HELP)
    add_reading(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the options of reading a project."""
    reading = parser.add_argument_group("how to read")
    reading.add_argument(
        "--from",
        dest="read_as",
        choices=[r.name for r in READERS.entries],
        metavar="FORMAT",
        help="the format, where suffix and content do not tell it: "
        + ", ".join(r.name for r in READERS.entries),
    )
    reading.add_argument(
        "--set",
        dest="reading",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="an option of the reader of the format, such as sigma=0.5, calibration=held, "
        "'accuracy={markers = 0.2}'; may be repeated",
    )
    reading.add_argument(
        "--allow-outside",
        action="store_true",
        help="let project.toml name tables and a geoid outside its folder",
    )
    add_grid(parser)


def reading_options(options: argparse.Namespace) -> list[str]:
    """Return the options of `add_reading` that were typed, as words for another command."""
    single = (
        *(("--from", options.read_as), ("--crs", options.crs), ("--geoid", options.geoid)),
        *(("--heights", options.heights), ("--frame", options.frame)),
    )
    out = [word for name, value in single if value is not None for word in (name, str(value))]
    for name, values in (("--set", options.reading), ("--grid", options.grid)):
        out += [word for value in values for word in (name, value)]
    return out + ["--allow-outside"] * options.allow_outside


def read_input(
    options: argparse.Namespace, path: str | None = None, *, readings: bool = True
) -> Project:
    """Read the project that the options of a command name.

    Args:
        options: options of the command, with those of `add_reading`.
        path: the file or folder; None: the only project of the command.
        readings: whether observations need observed values.

    Raises:
        InputError: an option is malformed, or the file has problems.
    """
    source = options.project if path is None else path
    given = parsed_settings(options.reading, "--set")
    system = stated_reference_system(options)
    grid = parsed_settings(options.grid, "--grid")
    if system is not None and not Path(source).exists():
        raise InputError(Problem("no such file or folder", str(source)))
    reader = None if system is None else READERS.reader(Path(source), options.read_as)
    if system is not None and reader is not None and reader.own_grid:
        given |= options_of_reader(reader, system, grid, options.frame)
    project = READERS.load(
        source,
        readings=readings,
        allow_outside=options.allow_outside,
        format=options.read_as,
        options=given,
    )
    if system is None or reader is None or reader.own_grid:
        return project
    return project_on_earth(project, system, grid, options.frame)


def parsed_settings(given: Sequence[str], option: str) -> dict[str, Any]:
    """Return settings KEY=VALUE by key.

    Values are those of TOML, such as ``0.5``, ``["c", "k1"]`` or ``{markers = 0.2}``; tables may
    also be written as in JSON and Python, ``{"markers": 0.2}``. Everything else is a text.

    Args:
        given: the settings as typed.
        option: name of the option, for messages.

    Raises:
        InputError: a setting has no key or no =, or a key is given twice.
    """
    out: dict[str, Any] = {}
    problems = []
    for text in given:
        key, equals, value = text.partition("=")
        if not key or not equals:
            problems.append(Problem(f"{text!r} is not KEY=VALUE", option))
        elif key in out:
            problems.append(Problem(f"{key} is given twice", option))
        else:
            out[key] = _value(value)
    if problems:
        raise InputError(problems)
    return out


def _value(text: str) -> Any:
    if "\n" in text:
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):
        pass
    try:
        found = json.loads(text)
    except (ValueError, RecursionError):
        return text
    return found if isinstance(found, dict) else text
