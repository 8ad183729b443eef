"""The option ``--leave-out-undetermined``: adjust what the observations determine."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

from ..errors import AdjustmentError
from ..io.project import Project
from ..network.network import Network
from ..solve.determined_part import largest_determined
from .check import refuse_problems
from .messages import warn

Adjusted = TypeVar("Adjusted")


def add_leave_out(parser: argparse._ActionsContainer) -> None:
    """Add the option."""
    parser.add_argument(
        "--leave-out-undetermined",
        action="store_true",
        help="leave out what the observations do not determine, with all that hangs on it, and "
        "name it",
    )


def adjust_determined(
    project: Project, attempt: Callable[[Network], Adjusted], *, leave_out: bool
) -> tuple[Project, Adjusted]:
    """Check and adjust a project, or what its observations determine of it; print its warnings.

    Args:
        project: the project as read.
        attempt: adjusts a network, or raises the errors of `adjust`.
        leave_out: whether what is not determined is left out.

    Returns:
        The project that was adjusted, and the result.

    Raises:
        InputError: the project, or what is left of it, has problems.
        ApproximationError, DatumError: as `adjust`.
    """
    if not leave_out:
        refuse_problems(project)
        warn(project.warnings)
        return project, attempt(project.network)
    try:
        network, found = largest_determined(project.network, attempt)
    except AdjustmentError:
        refuse_problems(project)
        warn(project.warnings)
        raise
    project = replace(project, network=network)
    refuse_problems(project)
    warn(project.warnings)
    return project, found
