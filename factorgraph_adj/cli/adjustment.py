"""Commands ``adjust``, with data snooping or in parts, and ``plot``: options, run, exit codes."""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

from ..control_characters import escaped
from ..errors import InputError, Problem
from ..files import refuse_replacing
from ..io.file_transaction import one_transaction
from ..io.project import Project
from ..network.network import Network
from ..parts.adjustment import adjust_parts
from ..parts.solution import PartsSolution
from ..parts.whole_network import adjust, adjust_cut
from ..parts.workers import cluster_client
from ..quality.rejections import Snooping
from ..quality.snooping import snoop
from ..quality.variance_components import VarianceComponents, estimate_variance_components
from ..report.adjustment_report import Report
from ..report.catalogue import Language
from ..report.doubtful_results import notes_of_network, notes_of_solution, unknowns_left_out
from ..report.misfit_causes import all_doubts, most_probable_cause
from ..report.options import Provenance, ReportOptions
from ..report.result_files import RESULT_FILES, parts_report, write_parts, write_tables
from ..report.summary import (
    doubts_of_parts,
    parts_summary,
    parts_verdict_line,
    render_summary,
    verdict_line,
)
from ..report.text import render_text
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_OBSERVATION, POWER_OF_TEST
from ..units import significant
from .input import PROJECT_HELP, add_project, add_reading, read_input
from .messages import (
    EXIT_CODES,
    EXIT_DOUBTFUL,
    EXIT_FINE,
    ShowProgress,
    iteration_line,
    print_warnings,
    progress_display,
)
from .network_files import refuse_problems
from .options import (
    add_adjustment,
    add_exports,
    adjust_determined,
    check_sigma,
    positive_count,
    probability,
    problems_of_outputs,
    problems_of_report_options,
    refuse_exports,
    requested_lines,
    run_description,
    write_exports,
)

OPTIONS_OF_WHOLE_NETWORK = (
    *("snoop", "robust", "variance_components", "ellipses", "relative", "between", "rows"),
    *("test", "sidak", "report", "language", "export", "check_sigma"),
    "protection_levels",
)
"""Options of a network that is adjusted as a whole."""
MAX_ITERATIONS_OF_PARTS = 100
"""Largest number of iterations, where no option says another."""


def add_parts(parser: argparse.ArgumentParser) -> None:
    """Add the options of an adjustment in parts."""
    parts = parser.add_argument_group("in parts (several projects are parts of one network)")
    parts.add_argument(
        "--parts", type=positive_count, metavar="N", help="cut one project into N parts"
    )
    parts.add_argument(
        "--cluster", metavar="ADDRESS", help="of the scheduler of a Dask cluster, tcp://host:8786"
    )
    parts.add_argument(
        "--folder",
        metavar="DIR",
        help="folder of the run, which all workers reach; a killed run resumes from it",
    )


def is_in_parts(options: argparse.Namespace) -> bool:
    """Return whether the network is adjusted in parts."""
    given = (options.parts, options.cluster, options.folder)
    return len(options.project) > 1 or any(value is not None for value in given)


def adjust_in_parts(options: argparse.Namespace) -> int:
    """Adjust a network in parts, print its report, and return the exit code.

    Raises:
        InputError: options contradict each other, or a part has problems.
    """
    refused = [name for name in OPTIONS_OF_WHOLE_NETWORK if getattr(options, name)]
    if (options.alpha, options.power) != (ALPHA_OF_OBSERVATION, POWER_OF_TEST):
        refused.append("alpha" if options.alpha != ALPHA_OF_OBSERVATION else "power")
    problems = [
        Problem(f"--{name.replace('_', '-')} is for a network that is adjusted as a whole")
        for name in refused
    ]
    problems += problems_of_outputs(options) if not refused else []
    if options.parts is not None and len(options.project) > 1:
        problems.append(Problem("--parts cuts one project; several projects are parts already"))
    if options.leave_out_undetermined and len(options.project) > 1:
        what = "--leave-out-undetermined takes one project, also with --parts: join the parts"
        problems.append(Problem(what))
    if options.datum == "free":
        problems.append(Problem("--datum free: a network in parts needs a given datum"))
    if problems:
        raise InputError(problems)
    solution, run = _solution_of_parts(options), run_description(options)
    if options.out is not None:
        write_parts(solution, options.out, run)
    if options.full:
        text = parts_report(solution, run)
    else:
        text = parts_verdict_line(solution) if options.quiet else parts_summary(solution)
    print(text, end="", flush=True)
    return _verdict_of_parts(solution)


def _solution_of_parts(options: argparse.Namespace) -> PartsSolution:
    """Read, cut and adjust."""
    if len(options.project) > 1:
        with (
            cluster_client(options.cluster) as client,
            progress_display("network in parts") as show,
        ):
            return adjust_parts(
                options.project,
                client=client,
                folder=options.folder,
                variance=options.variance or "a-priori",
                max_iterations=options.max_iterations or MAX_ITERATIONS_OF_PARTS,
                progress=show and (lambda *figures: show(iteration_line(*figures))),
            )
    project = read_input(options, options.project[0])
    leave_out = options.leave_out_undetermined
    if not leave_out:
        refuse_problems(project)
    print_warnings(project.warnings)
    with cluster_client(options.cluster) as client, progress_display(project.network.name) as show:
        return adjust_cut(
            project.network,
            options.parts,
            client=client,
            folder=options.folder,
            variance=options.variance or project.options.variance,
            max_iterations=options.max_iterations or project.options.max_iterations,
            leave_out_undetermined=leave_out,
            progress=show and (lambda *figures: show(iteration_line(*figures))),
        )


def _verdict_of_parts(solution: PartsSolution) -> int:
    """Print doubts about the result on stderr, and return the exit code."""
    for note in (*unknowns_left_out(solution), *notes_of_solution(solution)):
        print(note, file=sys.stderr)
    doubts = doubts_of_parts(solution)
    for doubt in doubts:
        print(doubt, file=sys.stderr)
    return EXIT_DOUBTFUL if doubts else EXIT_FINE


def add_adjust(run: argparse.ArgumentParser) -> None:
    """Add the arguments of ``adjust``."""
    run.epilog = EXIT_CODES
    run.add_argument("project", metavar="PROJECT", nargs="+", help=PROJECT_HELP)
    add_reading(run)
    run.add_argument("--out", metavar="DIR", help="write report, results.json and CSV tables")
    add_exports(run)
    run.add_argument(
        "--report",
        metavar="FILE.html",
        help="write a report as one HTML file that opens in a browser (extra report)",
    )
    run.add_argument(
        "--language",
        choices=get_args(Language),
        help="language of the report (en)",
    )
    run.add_argument(
        "--rows",
        type=positive_count,
        metavar="N",
        help=f"rows of a list in the report ({ReportOptions.most}, and "
        f"{ReportOptions.n_suspects} suspects)",
    )
    printed = run.add_mutually_exclusive_group()
    printed.add_argument(
        "--full", action="store_true", help="print the whole report, not one screen of it"
    )
    printed.add_argument("--quiet", action="store_true", help="print one line: the verdict and σ̂0")
    run.add_argument(
        "--ellipses",
        type=probability,
        metavar="CONF",
        help="error ellipses of points and ellipsoids of projection centres, such as 0.95",
    )
    run.add_argument(
        "--protection-levels",
        type=probability,
        metavar="RISK",
        help="bounds of the errors of points that undetected gross errors exceed with this "
        "probability at most, such as 0.001",
    )
    run.add_argument(
        "--faults",
        type=int,
        choices=(1, 2),
        default=2,
        help="number of gross errors up to which protection levels hold (2)",
    )
    run.add_argument(
        "--check-sigma",
        type=check_sigma,
        metavar="S|H,V",
        help="standard deviation of the survey of the check points, metres: of each axis, or "
        "horizontal and vertical; it counts in RMSE_H and RMSE_V of ASPRS",
    )
    run.add_argument(
        "--relative",
        action="store_true",
        help="adjusted distances, azimuths and rises with relative ellipses between all points "
        "that observations join",
    )
    run.add_argument(
        "--between",
        metavar="A,B",
        action="append",
        help="the same between two points or photos; may be repeated",
    )
    run.add_argument(
        "--date", metavar="TEXT", help="in the report instead of the present time; none: no date"
    )
    add_adjustment(run)
    add_parts(run)
    run.set_defaults(run=_adjust, files=RESULT_FILES)


def add_plot(plot: argparse.ArgumentParser) -> None:
    """Add the arguments of ``plot``."""
    plot.epilog = EXIT_CODES
    add_project(plot)
    plot.add_argument("--out", metavar="DIR", required=True, help="where the figures go")
    plot.add_argument("--format", choices=("png", "svg", "pdf"), default="png", help="(png)")
    plot.add_argument(
        "--ellipses", type=probability, default=0.95, metavar="CONF", help="of the plan (0.95)"
    )
    add_adjustment(plot)
    plot.set_defaults(run=_plot, report=None, language=None, export=[], writing=[], files=())


@dataclass(frozen=True)
class AdjustedProject:
    """A project and the result of its adjustment."""

    project: Project
    """The project as read, without what was left out as undetermined."""
    solution: Solution
    """The last adjustment."""
    snooping: Snooping | None
    """Data snooping before the last adjustment; None without the option."""
    components: VarianceComponents | None
    """Variance components that determined the weights; None without the option."""


def _solve(options: argparse.Namespace) -> AdjustedProject:
    """Read, check and adjust a project according to the options.

    Raises:
        InputError: options contradict each other, or the input has problems.
    """
    _refuse_options(options)
    project = read_input(options)
    network = project.network
    refuse_exports(network, options)
    outputs = [] if options.report is None else [Path(options.report)]
    if options.out is not None:
        outputs += [Path(options.out, name) for name in options.files]
    refuse_replacing(outputs)
    if options.datum is not None:
        network.datum = options.datum
    variance = options.variance or project.options.variance
    weights = None
    with progress_display(network.name) as show:

        def attempt(some: Network) -> tuple[Solution, Snooping | None]:
            return _fitted(some, project, options, show)

        project, (solution, found) = adjust_determined(
            project, attempt, leave_out=options.leave_out_undetermined
        )
        if options.variance_components is not None:
            weights = estimate_variance_components(
                solution.network, groups=options.variance_components, start=solution
            )
            solution = replace(weights.solution, variance=variance)
    return AdjustedProject(project, solution, found, weights)


def _fitted(
    network: Network, project: Project, options: argparse.Namespace, show: ShowProgress | None
) -> tuple[Solution, Snooping | None]:
    """Adjust a network of a project, with data snooping if that is requested."""
    variance = options.variance or project.options.variance
    most = options.max_iterations or project.options.max_iterations
    if not _snoops(options):
        solution = adjust(
            network,
            variance=variance,
            max_iterations=most,
            solver=options.solver,
            progress=show and (lambda *figures: show(iteration_line(*figures))),
        )
        return solution, None
    found = snoop(
        network,
        alpha=options.alpha,
        power=options.power,
        test=options.test or ("pope" if variance == "a-posteriori" else "baarda"),
        sidak=options.sidak,
        robust=options.robust,
        variance=variance,
        max_iterations=most,
        progress=show
        and (
            lambda r: show(
                f"round {r.number}: {r.suspects} suspects, σ̂0 {significant(r.sigma0, 4)}"
            )
        ),
    )
    return found.solution, found


def _refuse_options(options: argparse.Namespace) -> None:
    """Raise the problems of the options before any file is read."""
    problems = list(problems_of_outputs(options))
    problems += problems_of_report_options(options)
    if options.alpha >= options.power:
        problems.append(
            Problem(f"--alpha {options.alpha:g} must be less than --power {options.power:g}")
        )
    if options.sidak and not _snoops(options):
        problems.append(Problem("--sidak belongs to --snoop"))
    if options.solver != "direct":
        given = {
            "--snoop": options.snoop,
            "--robust": options.robust,
            "--variance-components": options.variance_components,
            "--ellipses": options.ellipses,
            "--protection-levels": options.protection_levels,
            "--relative": options.relative,
            "--between": options.between,
        }
        problems += [
            Problem(f"{name} needs covariances, which --solver {options.solver} does not have")
            for name, value in given.items()
            if value
        ]
    if problems:
        raise InputError(problems)


def _snoops(options: argparse.Namespace) -> bool:
    """Return whether data snooping is requested; a robust start implies data snooping."""
    return bool(options.snoop) or options.robust is not None


def _adjust(options: argparse.Namespace) -> int:
    if is_in_parts(options):
        return adjust_in_parts(options)
    (options.project,) = options.project
    found = _solve(options)
    report = Report(
        found.solution,
        ReportOptions(
            units=found.project.units,
            most=options.rows or ReportOptions.most,
            n_suspects=options.rows or ReportOptions.n_suspects,
            tables=options.out or "",
            alpha=options.alpha,
            power=options.power,
            test=found.snooping.test if found.snooping is not None else options.test,
            confidence=options.ellipses,
            relative=requested_lines(options, found.project.network),
            survey=options.check_sigma,
            protection_risk=options.protection_levels,
            faults=options.faults,
        ),
        Provenance(
            found.snooping,
            found.project.network,
            found.components,
            run_description(options, found.project),
        ),
    )
    _ = report.protection_levels  # refused before anything is written
    with one_transaction():
        write_exports(report, options)
        if options.out is not None:
            write_tables(report, options.out)
        if options.report is not None:
            from ..report.html.page import write_html

            language: Language = options.language or "en"
            write_html(report, options.report, language=language, files=[options.project])
    if options.full:
        text = render_text(report)
    else:
        text = verdict_line(report) if options.quiet else render_summary(report)
    print(text, end="", flush=True)
    return _verdict(found, report)


def _plot(options: argparse.Namespace) -> int:
    from ..report.plots import save_plots
    from ..report.plots.style import MATPLOTLIB_MISSING

    if find_spec("matplotlib") is None:
        raise InputError(MATPLOTLIB_MISSING)
    found = _solve(options)
    report = Report(
        found.solution,
        ReportOptions(alpha=options.alpha, power=options.power),
        Provenance(found.snooping, found.project.network),
    )
    files = save_plots(
        found.solution,
        options.out,
        reliability=report.reliability,
        aside=report.set_aside,
        format=options.format,
        confidence=options.ellipses,
        cause=most_probable_cause(report),
    )
    for file in files:
        print(file)
    return _verdict(found, report)


def _verdict(found: AdjustedProject, report: Report) -> int:
    """Print doubts about the result on stderr, and return the exit code."""
    network = found.solution.network
    for said in (
        *unknowns_left_out(network),
        *notes_of_solution(found.solution),
        *notes_of_network(network),
    ):
        print(said, file=sys.stderr)
    if found.snooping is not None and (aside := len(found.snooping.rejected_ids)):
        first = f"{', the first' * (aside > 1)}: {escaped(found.snooping.first_name)}"
        print(f"{aside} observation{'s' * (aside != 1)} rejected{first}", file=sys.stderr)
    doubts = all_doubts(report)
    for doubt in doubts:
        print(doubt, file=sys.stderr)
    return EXIT_DOUBTFUL if doubts else EXIT_FINE
