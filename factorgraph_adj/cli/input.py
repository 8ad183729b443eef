"""The input of a command: a file of any format, and how to read it."""

from __future__ import annotations

import argparse
import json
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem
from ..io.project import Project
from ..io.readers import READERS
from .grid import add_grid, moved, options_of_reader, system_of

PROJECT_HELP = f"a file: {READERS}; or a folder"
"""Help of the argument for a project."""


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
    given = settings(options.reading, "--set")
    system = system_of(options)
    grid = settings(options.grid, "--grid")
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
    return moved(project, system, grid, options.frame)


def settings(given: Sequence[str], option: str) -> dict[str, Any]:
    """Return settings KEY=VALUE by key.

    Values are those of TOML, such as ``0.5``, ``["c", "k1"]`` or ``{markers = 0.2}``; tables may
    also be written as in JSON and Python, ``{"markers": 0.2}``. Everything else is a text.

    Args:
        given: the settings as typed.
        option: name of the option, for messages.

    Raises:
        InputError: a setting has no key or no =, or a key stands twice.
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
