"""The command: ``factorgraph-adj check | adjust | plot | stream | plan | propose PROJECT``.

Exit codes: 0 fine; 1 adjusted, but not converged, the global test failed or gross errors are
left; 2 bad input; 3 a fault of the program; 130 interrupted. Errors go to stderr as a list, one
problem a line.
"""

from __future__ import annotations

import argparse
import io
import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

from ..errors import AdjustmentError, ApproximationError, InputError, Problem
from ..io.project import Project
from ..quality.global_test import global_test
from ..quality.rejections import Snooping
from ..quality.snooping import snoop
from ..quality.variance_components import VarianceComponents, variance_components
from ..report.context import Report
from ..report.tables import write_tables
from ..report.text import render
from ..solve.batch import adjust
from ..solve.solution import Solution
from ..validate.check import check
from ..version import __version__
from .options import add_adjustment, add_project, count, probability, read
from .plan import add_plan
from .stream import add_stream

FINE, DOUBTFUL, BAD_INPUT, FAULT, INTERRUPTED = 0, 1, 2, 3, 130
SUSPECTS = 15
"""Suspects that are listed, unless --rows says otherwise."""
Show = Callable[[str], None]
"""Shows how far it is."""
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
        epilog="exit codes: 0 fine; 1 not converged, global test failed, or gross errors left; "
        "2 bad input",
    )
    version = f"factorgraph-adj {__version__}".strip()
    parser.add_argument("--version", action="version", version=version)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    run = commands.add_parser("adjust", help="adjust a project and print the protocol")
    add_project(run)
    run.add_argument("--out", metavar="DIR", help="write protocol, solution.json and CSV tables")
    run.add_argument(
        "--rows",
        type=count,
        metavar="N",
        help=f"rows of a list in the protocol (60, and {SUSPECTS} suspects)",
    )
    run.add_argument("--quiet", action="store_true", help="print no protocol")
    run.add_argument(
        "--ellipses",
        type=probability,
        metavar="CONF",
        help="error ellipses of points and ellipsoids of projection centres, such as 0.95",
    )
    add_adjustment(run)
    run.set_defaults(run=_adjust)
    plot = commands.add_parser("plot", help="adjust a project and draw it")
    add_project(plot)
    plot.add_argument("--out", metavar="DIR", required=True, help="where the figures go")
    plot.add_argument("--format", choices=("png", "svg", "pdf"), default="png", help="(png)")
    plot.add_argument(
        "--ellipses", type=probability, default=0.95, metavar="CONF", help="of the plan (0.95)"
    )
    add_adjustment(plot)
    plot.set_defaults(run=_plot)
    add_stream(commands)
    add_plan(commands)
    look = commands.add_parser("check", help="find every problem of the input")
    add_project(look)
    look.set_defaults(run=_check)
    return parser


def _checked(project: Project, datum: str | None = None) -> None:
    """Raise every problem that is found before adjusting."""
    if datum is not None:
        project.network.datum = datum  # type: ignore[assignment]
    problems = check(project.network, sources=project.sources)
    if problems:
        raise InputError(problems)


@dataclass(frozen=True)
class Found:
    """What an adjustment came to."""

    project: Project
    """What was read."""
    solution: Solution
    """The last adjustment."""
    snooping: Snooping | None
    """What was set aside before it."""
    components: VarianceComponents | None
    """Where its weights come from."""


def _solve(options: argparse.Namespace) -> Found:
    """Read, check and adjust as the options say."""
    problems = []
    if options.out is not None and Path(options.out).exists() and not Path(options.out).is_dir():
        problems.append(Problem("--out must be a folder", options.out))
    if options.alpha >= options.power:
        problems.append(
            Problem(f"--alpha {options.alpha:g} must be less than --power {options.power:g}")
        )
    snooping = options.snoop or options.robust is not None
    if options.sidak and not snooping:
        problems.append(Problem("--sidak belongs to --snoop"))
    if problems:
        raise InputError(problems)
    project = read(options.project)
    _checked(project, options.datum)
    network = project.network
    variance = options.variance or project.options.variance
    found = weights = None
    with _progress(network.name) as show:
        solution = adjust(
            network,
            variance=variance,
            max_iterations=options.max_iterations or project.options.max_iterations,
            progress=show and (lambda *figures: show(_iteration(*figures))),
        )
        if snooping:
            found = snoop(
                network,
                alpha=options.alpha,
                power=options.power,
                test=options.test or ("pope" if variance == "a-posteriori" else "baarda"),
                sidak=options.sidak,
                robust=options.robust,
                variance=variance,
                start=solution,
                progress=show
                and (lambda r: show(f"round {r.number}: {r.suspects} suspects, σ̂0 {r.sigma0:.4g}")),
            )
            solution = found.solution
        if options.variance_components is not None:
            weights = variance_components(solution.network, groups=options.variance_components)
            solution = replace(weights.solution, variance=variance)
    return Found(project, solution, found, weights)


def _adjust(options: argparse.Namespace) -> int:
    found = _solve(options)
    report = Report(
        found.solution,
        found.project.units,
        options.rows or 60,
        options.out or "",
        n_suspects=options.rows or SUSPECTS,
        alpha=options.alpha,
        power=options.power,
        test=found.snooping.test if found.snooping is not None else options.test,
        confidence=options.ellipses,
        snooping=found.snooping,
        original=found.project.network,
        components=found.components,
    )
    if options.out is not None:
        write_tables(report, options.out)
    if not options.quiet:
        print(render(report), end="", flush=True)
    return _verdict(found)


def _plot(options: argparse.Namespace) -> int:
    from ..report.plots import save_plots
    from ..report.plots.style import MISSING

    if find_spec("matplotlib") is None:
        raise InputError(MISSING)
    found = _solve(options)
    report = Report(
        found.solution, alpha=options.alpha, power=options.power, snooping=found.snooping
    )
    files = save_plots(
        found.solution,
        options.out,
        reliability=report.reliability,
        format=options.format,
        confidence=options.ellipses,
    )
    for file in files:
        print(file)
    return _verdict(found)


def _verdict(found: Found) -> int:
    """Say on stderr what is doubtful, and return the exit code."""
    solution, doubts = found.solution, []
    test = global_test(solution)
    if not solution.converged:
        doubts.append(f"not converged: {solution.reason}")
    elif not test.accepted:
        doubts.append(
            f"global test failed: σ̂0 = {test.sigma0:.4f}, accepted from {test.lower:.4f} "
            f"to {test.upper:.4f}"
        )
    if found.components is not None and not found.components.converged:
        doubts.append(f"variance components not converged: {found.components.reason}")
    if found.snooping is not None:
        aside = len(found.snooping.rejected)
        aside += sum(len(p.rays) for p in found.snooping.points_set_aside)
        if aside:
            print(f"{aside} observation{'s' * (aside != 1)} set aside", file=sys.stderr)
        left = len(found.snooping.unresolved)
        if left:
            doubts.append(
                f"{left} observation{'s' * (left != 1)} above the critical value could not be set "
                "aside"
            )
    for doubt in doubts:
        print(doubt, file=sys.stderr)
    return DOUBTFUL if doubts else FINE


def _check(options: argparse.Namespace) -> int:
    try:
        project = read(options.project)
    except InputError as error:
        _complain(error.problems)
        _hint_at_plan(options.project, len(error.problems))
        return BAD_INPUT
    _checked(project)
    network = project.network
    print(
        f"{network.name}: no problems found in {len(network.points)} points, "
        f"{len(network.photos)} photos, {network.n_image_points} image points and "
        f"{len(network.observations)} other observations"
    )
    return FINE


def _hint_at_plan(name: str, n_problems: int) -> None:
    """Say that a design needs no readings, where it is them that are missing."""
    try:
        read(name, readings=False)
    except InputError as error:
        if len(error.problems) >= n_problems:
            return
    print(
        "If nothing is measured yet: a design needs no readings for `factorgraph-adj plan`.",
        file=sys.stderr,
    )


def _complain(problems: Sequence[Problem]) -> None:
    """List problems on stderr."""
    n = len(problems)
    print(f"{n} problem{'s' * (n != 1)}:", file=sys.stderr)
    for problem in problems[:MOST_PROBLEMS]:
        print(f"  {problem}".replace("\n", "\n    "), file=sys.stderr)
    if n > MOST_PROBLEMS:
        print(f"  … and {n - MOST_PROBLEMS} more", file=sys.stderr)


@contextmanager
def _progress(name: str) -> Iterator[Show | None]:
    """Show how far it is on a terminal, with rich if it is installed; else nothing."""
    if not sys.stderr.isatty():
        yield None
        return
    try:
        from rich.console import Console
    except ImportError:

        def plain(text: str) -> None:
            print(f"\r{text}", end="", file=sys.stderr, flush=True)

        yield plain
        print(file=sys.stderr)
        return
    with Console(stderr=True).status(f"{name}: reading and approximate values") as status:
        yield lambda text: status.update(f"{name}: {text}")


def _iteration(iteration: int, vtpv: float, step: float) -> str:
    return f"iteration {iteration:3d}   vᵀPv {vtpv:12.6g}   largest step {step:9.2g} σ"


if __name__ == "__main__":
    sys.exit(main())
