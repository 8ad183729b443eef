"""The command ``factorgraph-adj check``: list all problems of the input without an adjustment."""

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
    """Raise all problems of a network that can be found before the adjustment.

    Raises:
        InputError: the network has problems; those of points and photos state file and line.
    """
    problems = check(project.network, sources=project.sources)
    if problems:
        raise InputError(problems)


def _hint_at_plan(name: str, n_problems: int) -> None:
    """Print that a design needs no readings, if the input lacks readings."""
    try:
        READERS.load(name, readings=False)
    except InputError as error:
        if len(error.problems) >= n_problems:
            return
    print(
        "If nothing is measured yet: a design needs no readings for `factorgraph-adj plan`.",
        file=sys.stderr,
    )
