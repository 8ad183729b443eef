"""The command: ``factorgraph-adj adjust PROJECT`` and ``factorgraph-adj check PROJECT``.

Exit codes: 0 fine; 1 adjusted, but not converged or the global test failed; 2 bad input;
3 a fault of the program; 130 interrupted. Errors go to stderr as a list, one problem a line.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from .check import check
from .errors import AdjustmentError, ApproximationError, InputError, Problem
from .io.bal import read_bal
from .io.gama import read_gama
from .io.project import Project, load_project
from .quality.global_test import global_test
from .report.context import Report
from .report.tables import write_tables
from .report.text import render
from .solve.batch import Progress, adjust

FINE, DOUBTFUL, BAD_INPUT, FAULT, INTERRUPTED = 0, 1, 2, 3, 130
READERS = (
    ".toml (project), .gkf (GNU Gama), .txt, .txt.bz2, .txt.gz (Bundle Adjustment in the Large)"
)
MOST_PROBLEMS = 200
"""Problems that are listed; a shifted column has as many as the file has lines."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # σ on a terminal that has no σ
    options = _parser().parse_args(arguments)
    try:
        return int(options.run(options))
    except (InputError, ApproximationError) as error:
        _complain(error.problems)
        return BAD_INPUT
    except AdjustmentError as error:
        _complain([Problem(str(error))])
        return BAD_INPUT
    except KeyboardInterrupt:
        print("interrupted: nothing was written", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of the protocol has seen enough (… | head).
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FINE
    except Exception as error:
        if os.environ.get("FACTORGRAPH_ADJ_DEBUG"):
            raise
        print(
            f"factorgraph-adj failed: {type(error).__name__}: {error}\n"
            "This is a fault of the program, not of the input; nothing was written. "
            "FACTORGRAPH_ADJ_DEBUG=1 shows where.",
            file=sys.stderr,
        )
        return FAULT


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="factorgraph-adj",
        description="Combined adjustment of terrestrial and photogrammetric observations.",
        epilog="exit codes: 0 fine; 1 not converged, or global test failed; 2 bad input",
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    run = commands.add_parser("adjust", help="adjust a project and print the protocol")
    run.add_argument("project", metavar="PROJECT", help=f"a file: {READERS}; or a folder")
    run.add_argument("--out", metavar="DIR", help="write protocol, solution.json and CSV tables")
    run.add_argument("--datum", choices=("given", "free"), help="instead of the project's")
    run.add_argument(
        "--variance",
        choices=("a-priori", "a-posteriori"),
        help="scale of standard deviations, instead of the project's",
    )
    run.add_argument("--max-iterations", type=_count, metavar="N", help="instead of the project's")
    run.add_argument(
        "--rows", type=_count, default=60, metavar="N", help="rows of a list in the protocol (60)"
    )
    run.add_argument("--quiet", action="store_true", help="print no protocol")
    run.set_defaults(run=_adjust)
    look = commands.add_parser("check", help="find every problem of the input")
    look.add_argument("project", metavar="PROJECT", help=f"a file: {READERS}; or a folder")
    look.set_defaults(run=_check)
    return parser


def _count(text: str) -> int:
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1")
    return int(text)


def _read(name: str) -> Project:
    """Read whatever kind of project it is."""
    path = Path(name)
    if not path.exists():
        raise InputError(Problem("no such file or folder", name))
    if path.is_dir() or path.suffix == ".toml":
        return load_project(path)
    if path.suffix == ".gkf":
        return Project(read_gama(path), path)
    if ".txt" in path.suffixes:
        return Project(read_bal(path), path)
    raise InputError(Problem(f"unknown kind of file; valid: {READERS}", name))


def _checked(project: Project, datum: str | None = None) -> None:
    """Raise every problem that is found before adjusting."""
    if datum is not None:
        project.network.datum = datum  # type: ignore[assignment]
    problems = check(project.network, sources=project.sources)
    if problems:
        raise InputError(problems)


def _adjust(options: argparse.Namespace) -> int:
    if options.out is not None and Path(options.out).exists() and not Path(options.out).is_dir():
        raise InputError(Problem("--out must be a folder", options.out))
    project = _read(options.project)
    _checked(project, options.datum)
    with _progress(project.network.name) as progress:
        solution = adjust(
            project.network,
            variance=options.variance or project.options.variance,
            max_iterations=options.max_iterations or project.options.max_iterations,
            progress=progress,
        )
    report = Report(solution, project.units, options.rows, options.out or "")
    if options.out is not None:
        write_tables(report, options.out)
    if not options.quiet:
        print(render(report), end="", flush=True)
    test = global_test(solution)
    if not solution.converged:
        print(f"not converged: {solution.reason}", file=sys.stderr)
        return DOUBTFUL
    if not test.accepted:
        print(
            f"global test failed: σ̂0 = {test.sigma0:.4f}, accepted from {test.lower:.4f} "
            f"to {test.upper:.4f}",
            file=sys.stderr,
        )
        return DOUBTFUL
    return FINE


def _check(options: argparse.Namespace) -> int:
    project = _read(options.project)
    _checked(project)
    network = project.network
    print(
        f"{network.name}: no problems found in {len(network.points)} points, "
        f"{len(network.photos)} photos, {network.n_image_points} image points and "
        f"{len(network.observations)} other observations"
    )
    return FINE


def _complain(problems: Sequence[Problem]) -> None:
    """List problems on stderr."""
    n = len(problems)
    print(f"{n} problem{'s' * (n != 1)}:", file=sys.stderr)
    for problem in problems[:MOST_PROBLEMS]:
        print(f"  {problem}".replace("\n", "\n    "), file=sys.stderr)
    if n > MOST_PROBLEMS:
        print(f"  … and {n - MOST_PROBLEMS} more", file=sys.stderr)


@contextmanager
def _progress(name: str) -> Iterator[Progress | None]:
    """Show iterations on a terminal, with rich if it is installed; else nothing."""
    if not sys.stderr.isatty():
        yield None
        return
    try:
        from rich.console import Console
    except ImportError:

        def plain(iteration: int, vtpv: float, step: float) -> None:
            print(f"\r{_iteration(iteration, vtpv, step)}", end="", file=sys.stderr, flush=True)

        yield plain
        print(file=sys.stderr)
        return
    with Console(stderr=True).status(f"{name}: reading and approximate values") as status:

        def rich(iteration: int, vtpv: float, step: float) -> None:
            status.update(f"{name}: {_iteration(iteration, vtpv, step)}")

        yield rich


def _iteration(iteration: int, vtpv: float, step: float) -> str:
    return f"iteration {iteration:3d}   vᵀPv {vtpv:12.6g}   largest step {step:9.2g} σ"


if __name__ == "__main__":
    sys.exit(main())
