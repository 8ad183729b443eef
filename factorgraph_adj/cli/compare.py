"""The command ``factorgraph-adj compare``: adjust two epochs, and tell what moved."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import get_args

from ..epochs.congruence import congruence
from ..epochs.localise import Method
from ..errors import InputError, Problem
from ..io.atomic import write_files
from ..quality.levels import ALPHA_OF_MODEL, POWER
from ..report.epochs import displacement_table, render_congruence
from ..solve.batch import adjust
from ..solve.solution import Solution
from .check import refuse_problems
from .exit_codes import DOUBTFUL, FINE
from .input import PROJECT_HELP, add_reading, read_input
from .messages import warn
from .options import probability


def add_compare(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Add the command."""
    parser = commands.add_parser("compare", help="adjust two epochs and tell what moved")
    parser.add_argument("first", metavar="FIRST", help=f"first epoch; {PROJECT_HELP}")
    parser.add_argument("second", metavar="SECOND", help="second epoch")
    parser.add_argument(
        "--reference",
        metavar="NAMES",
        help="points thought to be stable, with commas between them (all common ones)",
    )
    parser.add_argument(
        "--objects", metavar="NAMES", help="points that may have moved (all other common ones)"
    )
    parser.add_argument(
        "--method",
        choices=get_args(Method),
        default="combinations",
        help="how reference points that moved are found (combinations)",
    )
    parser.add_argument(
        "--known-variance",
        action="store_true",
        help="take σ0 = 1 as known instead of σ̂0 of both epochs",
    )
    parser.add_argument("--datum", choices=("given", "free"), help="instead of the projects'")
    parser.add_argument(
        "--alpha", type=probability, default=ALPHA_OF_MODEL, metavar="P", help="of one test (0.05)"
    )
    parser.add_argument(
        "--power",
        type=probability,
        default=POWER,
        metavar="P",
        help="with which the smallest detectable displacement is found (0.80)",
    )
    parser.add_argument("--out", metavar="DIR", help="write epochs.txt and displacements.csv")
    add_reading(parser)
    parser.set_defaults(run=_compare)


def _compare(options: argparse.Namespace) -> int:
    if options.out is not None and Path(options.out).exists() and not Path(options.out).is_dir():
        raise InputError(Problem("--out must be a folder", options.out))
    first = _adjusted(options, options.first, None)
    second = _adjusted(options, options.second, first)
    found = congruence(
        first,
        second,
        reference=_names(options.reference),
        objects=_names(options.objects),
        method=options.method,
        variance="a-priori" if options.known_variance else "pooled",
        alpha=options.alpha,
        power=options.power,
    )
    text = render_congruence(found)
    if options.out is not None:
        write_files(
            Path(options.out),
            {"epochs.txt": text, "displacements.csv": displacement_table(found)},
        )
    print(text, end="", flush=True)
    fine = first.converged and second.converged
    fine &= found.ratio is None or found.ratio.accepted
    fine &= not found.steps or found.steps[-1].test.accepted
    return FINE if fine else DOUBTFUL


def _adjusted(options: argparse.Namespace, path: str, first: Solution | None) -> Solution:
    """Read and adjust an epoch; a second free network takes the datum of the first."""
    project = read_input(options, path)
    if options.datum is not None:
        project.network.datum = options.datum
    refuse_problems(project)
    warn(project.warnings)
    start = first if project.network.datum == "free" else None
    return adjust(project.network, start=start)


def _names(given: str | None) -> list[str] | None:
    return None if given is None else [n.strip() for n in given.split(",") if n.strip()]
