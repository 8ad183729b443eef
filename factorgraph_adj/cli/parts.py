"""The command ``factorgraph-adj adjust`` for a network in parts."""

from __future__ import annotations

import argparse
import sys

from ..errors import InputError, Problem
from ..parts.adjust import adjust_parts
from ..parts.network import adjust_cut
from ..parts.result import PartsSolution
from ..parts.workers import connected
from ..quality.levels import ALPHA, POWER
from ..report.doubts import doubts_about, notes_about, unknowns_left_out
from ..report.parts import parts_protocol, write_parts
from .check import refuse_problems
from .exit_codes import DOUBTFUL, FINE
from .input import read_input
from .messages import iteration, progress, warn
from .options import count
from .run import run_of

WHOLE_ONLY = (
    *("snoop", "robust", "variance_components", "ellipses", "relative", "between", "rows"),
    *("test", "sidak", "report", "language", "export"),
)
"""Options of a network that is adjusted as a whole."""
MOST_ITERATIONS = 100
"""Largest number of iterations, where no option says another."""


def add_parts(parser: argparse.ArgumentParser) -> None:
    """Add the options of an adjustment in parts."""
    parts = parser.add_argument_group("in parts (several projects are parts of one network)")
    parts.add_argument("--parts", type=count, metavar="N", help="cut one project into N parts")
    parts.add_argument(
        "--cluster", metavar="ADDRESS", help="of the scheduler of a Dask cluster, tcp://host:8786"
    )
    parts.add_argument(
        "--folder",
        metavar="DIR",
        help="folder of the run, which all workers reach; a killed run resumes from it",
    )


def in_parts(options: argparse.Namespace) -> bool:
    """Return whether the network is adjusted in parts."""
    given = (options.parts, options.cluster, options.folder)
    return len(options.project) > 1 or any(value is not None for value in given)


def adjust_in_parts(options: argparse.Namespace) -> int:
    """Adjust a network in parts, print its protocol, and return the exit code.

    Raises:
        InputError: options contradict each other, or a part has problems.
    """
    refused = [name for name in WHOLE_ONLY if getattr(options, name)]
    if (options.alpha, options.power) != (ALPHA, POWER):
        refused.append("alpha" if options.alpha != ALPHA else "power")
    problems = [
        Problem(f"--{name.replace('_', '-')} is for a network that is adjusted as a whole")
        for name in refused
    ]
    if options.parts is not None and len(options.project) > 1:
        problems.append(Problem("--parts cuts one project; several projects are parts already"))
    if options.leave_out_undetermined and len(options.project) > 1:
        what = "--leave-out-undetermined takes one project, also with --parts: join the parts"
        problems.append(Problem(what))
    if options.datum == "free":
        problems.append(Problem("--datum free: a network in parts needs a given datum"))
    if problems:
        raise InputError(problems)
    solution, run = _solution(options), run_of(options)
    if options.out is not None:
        write_parts(solution, options.out, run)
    if not options.quiet:
        print(parts_protocol(solution, run), end="", flush=True)
    return _verdict(solution)


def _solution(options: argparse.Namespace) -> PartsSolution:
    """Read, cut and adjust."""
    if len(options.project) > 1:
        with connected(options.cluster) as client, progress("network in parts") as show:
            return adjust_parts(
                options.project,
                client=client,
                folder=options.folder,
                variance=options.variance or "a-priori",
                max_iterations=options.max_iterations or MOST_ITERATIONS,
                progress=show and (lambda *figures: show(iteration(*figures))),
            )
    project = read_input(options, options.project[0])
    leave_out = options.leave_out_undetermined
    if not leave_out:
        refuse_problems(project)
    warn(project.warnings)
    with connected(options.cluster) as client, progress(project.network.name) as show:
        return adjust_cut(
            project.network,
            options.parts,
            client=client,
            folder=options.folder,
            variance=options.variance or project.options.variance,
            max_iterations=options.max_iterations or project.options.max_iterations,
            leave_out_undetermined=leave_out,
            progress=show and (lambda *figures: show(iteration(*figures))),
        )


def _verdict(solution: PartsSolution) -> int:
    """Print doubts about the result on stderr, and return the exit code."""
    for note in (*unknowns_left_out(solution), *notes_about(solution)):
        print(note, file=sys.stderr)
    doubts = doubts_about(solution)
    if n := len(solution.repeated):
        doubts.append(f"{n} observations agree with one of another part: is it the same one?")
    for doubt in doubts:
        print(doubt, file=sys.stderr)
    return DOUBTFUL if doubts else FINE
