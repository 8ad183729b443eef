"""The command ``factorgraph-adj check``: every problem of the input, without an adjustment."""

from __future__ import annotations

import argparse
import sys

from ..errors import InputError
from ..io.project import Project
from ..io.readers import READERS
from ..validate.check import check
from .exit_codes import BAD_INPUT, FINE
from .messages import complain
from .options import add_project


def add_check(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = commands.add_parser("check", help="find every problem of the input")
    add_project(parser)
    parser.set_defaults(run=_check)


def _check(options: argparse.Namespace) -> int:
    try:
        project = READERS.load(options.project)
    except InputError as error:
        complain(error.problems)
        _hint_at_plan(options.project, len(error.problems))
        return BAD_INPUT
    refuse_problems(project)
    network = project.network
    print(
        f"{network.name}: no problems found in {len(network.points)} points, "
        f"{len(network.photos)} photos, {network.n_image_points} image points and "
        f"{len(network.observations)} other observations"
    )
    return FINE


def refuse_problems(project: Project) -> None:
    """Raise every problem of a network that shows before it is adjusted.

    Raises:
        InputError: the problems, points and photos with their file and line.
    """
    problems = check(project.network, sources=project.sources)
    if problems:
        raise InputError(problems)


def _hint_at_plan(name: str, n_problems: int) -> None:
    """Say that a design needs no readings, where readings are what the input lacks."""
    try:
        READERS.load(name, readings=False)
    except InputError as error:
        if len(error.problems) >= n_problems:
            return
    print(
        "If nothing is measured yet: a design needs no readings for `factorgraph-adj plan`.",
        file=sys.stderr,
    )
