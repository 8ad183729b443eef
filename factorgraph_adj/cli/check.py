"""The command ``factorgraph-adj check``: list all problems of the input without an adjustment."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from ..block_orientation.begin import tried_start
from ..errors import InputError, Problem
from ..graph.equations import compile_rows
from ..io.project import Project
from ..report.doubts import notes_on
from ..validate.check import check
from ..validate.line_lengths import wrong_line_lengths
from ..validate.mistyped_names import mistyped_at_start
from ..validate.preliminary.search import mistaken, preliminary
from .exit_codes import BAD_INPUT, DOUBTFUL, FINE
from .input import add_project, read_input
from .messages import complain, listed


def add_check(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_project(parser)
    parser.add_argument(
        "--all", action="store_true", help="list problems that repeat one by one, without limit"
    )
    parser.set_defaults(run=_check)


def _check(options: argparse.Namespace) -> int:
    try:
        project = read_input(options)
    except InputError as error:
        complain(error.problems, every=options.all)
        _hint_at_plan(options, len(error.problems))
        return BAD_INPUT
    try:
        refuse_problems(project)
    except InputError as error:
        complain(error.problems, every=options.all)
        return BAD_INPUT
    network = project.network
    content = (
        f"{len(network.points)} points, {len(network.photos)} photos, {network.n_image_points} "
        f"image points and {len(network.observations)} other observations"
    )
    length, angle = project.units.length, project.units.angle
    start, without = tried_start(network)
    found = [
        *project.warnings,
        *preliminary(network, length=length, angle=angle),
        *([] if start is None else mistyped_at_start(network, start.state)),
        *([] if start is None else wrong_line_lengths(compile_rows(network), start.state)),
    ]
    noted = [str(left) for left in network.left_out if not left.doubtful]
    noted += notes_on(network)
    name = network.name or "a network without a name"
    if not found and not without:
        print(f"{name}: no problems found in {content}; approximate values are there")
        _print_notes(noted)
        return FINE
    print(f"{name}: {content}")
    if found:
        n = len(found)
        print(
            f"{n} doubt{'s' * (n != 1)} about files, readings or given values; nothing was changed:"
        )
        for line in listed(found, every=options.all):
            print(line)
    if without:
        print("adjust will find no approximate values for:")
        for line in listed(without, every=options.all):
            print(line)
    _print_notes(noted)
    return DOUBTFUL


def _print_notes(noted: Sequence[str]) -> None:
    """Print what is no doubt: what the reader left out, as it always does, and copied returns."""
    for one in noted:
        print(f"note: {one}")


def refuse_problems(project: Project) -> None:
    """Raise all problems of a network that can be found before the adjustment.

    Raises:
        InputError: the network has problems; those of points and photos state file and line.
    """
    problems = check(project.network, sources=project.sources)
    if problems:
        # Points behind cameras are a symptom; images with y the wrong way are the cause. So is a
        # table that is not read because of its name.
        length, angle = project.units.length, project.units.angle
        causes = [Problem(str(f)) for f in mistaken(project.network, length=length, angle=angle)]
        raise InputError([*project.warnings, *causes, *problems])


def _hint_at_plan(options: argparse.Namespace, n_problems: int) -> None:
    """Print that a design needs no readings, if the input lacks readings."""
    try:
        read_input(options, readings=False)
    except InputError as error:
        if len(error.problems) >= n_problems:
            return
    print(
        "If nothing is measured yet: a design needs no readings for `factorgraph-adj plan`.",
        file=sys.stderr,
    )
