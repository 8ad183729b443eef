"""Command ``compare``: two epochs read, adjusted and compared, common motions, result files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import get_args

from ..adjustment import adjust
from ..epochs.block_motion import BlockMotion, MotionModel, block_motion
from ..epochs.comparison_result import Congruence
from ..epochs.congruence import congruence
from ..epochs.congruence_tests import LocalisationMethod
from ..errors import InputError, Problem, known
from ..io.file_transaction import one_transaction, write_files
from ..io.numbers import Units
from ..report.catalogue import Language
from ..report.epochs_report import EpochsReport, displacements_table, render_congruence
from ..report.options import Provenance
from ..report.results_json import epochs_results_text
from ..report.tables import as_csv
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_MODEL, CONFIDENCE_OF_REGION, POWER_OF_TEST
from .input import PROJECT_HELP, add_reading, read_input
from .messages import EXIT_DOUBTFUL, EXIT_FINE
from .options import (
    add_exports,
    add_leave_out,
    adjust_determined,
    probability,
    problems_of_outputs,
    problems_of_report_options,
    refuse_exports,
    run_description,
    write_exports,
)


def add_compare(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.add_argument("first", metavar="FIRST", help=f"first epoch; {PROJECT_HELP}")
    parser.add_argument("second", metavar="SECOND", help="second epoch")
    parser.add_argument(
        "--reference",
        metavar="NAMES",
        help="points thought to be stable, with commas between them (all common ones but the "
        "objects; '': the datum alone)",
    )
    parser.add_argument(
        "--objects",
        metavar="NAMES",
        help="points that may have moved (none; with --reference all others)",
    )
    parser.add_argument(
        "--method",
        choices=get_args(LocalisationMethod),
        default="combinations",
        help="how reference points that moved are found (combinations)",
    )
    parser.add_argument(
        "--known-variance",
        action="store_true",
        help="take σ0 = 1 as known instead of σ̂0 of both epochs",
    )
    parser.add_argument("--datum", choices=("given", "free"), help="instead of the projects'")
    add_leave_out(parser)
    parser.add_argument(
        "--alpha", type=probability, default=ALPHA_OF_MODEL, metavar="P", help="of one test (0.05)"
    )
    parser.add_argument(
        "--power",
        type=probability,
        default=POWER_OF_TEST,
        metavar="P",
        help="with which the smallest detectable displacement is found (0.80)",
    )
    parser.add_argument(
        "--block",
        metavar="[MODEL:]NAMES",
        action="append",
        default=[],
        help="common motion of points, with commas between them: "
        f"{', '.join(get_args(MotionModel))} (rigid); may be repeated",
    )
    parser.add_argument(
        "--out", metavar="DIR", help="write epochs.txt, results.json and displacements.csv"
    )
    parser.add_argument(
        "--plot", metavar="FILE", help="draw the displacements: .png, .svg or .pdf (extra plot)"
    )
    parser.add_argument(
        "--report",
        metavar="FILE.html",
        help="write a report as one HTML file that opens in a browser (extra report)",
    )
    parser.add_argument("--language", choices=get_args(Language), help="of the report (en)")
    parser.add_argument(
        "--ellipses", type=probability, default=CONFIDENCE_OF_REGION, metavar="CONF", help="(0.95)"
    )
    parser.add_argument(
        "--date", metavar="TEXT", help="in the report instead of the present time; none: no date"
    )
    add_exports(parser)
    add_reading(parser)
    parser.set_defaults(run=_compare)


def _compare(options: argparse.Namespace) -> int:
    options.project = [options.first, options.second]
    _refuse_options(options)
    blocks = [_block_of(text) for text in options.block]
    units, first = _adjusted(options, options.first, None)
    _, second = _adjusted(options, options.second, first)
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
    report = EpochsReport(
        found,
        _motions(found, blocks),
        Provenance(run=run_description(options)),
        options.ellipses,
        units,
    )
    with one_transaction():
        _write(options, report)
    print(render_congruence(found, blocks=report.blocks), end="", flush=True)
    for said in report.unknowns_left_out:
        print(said, file=sys.stderr)
    return EXIT_FINE if found.fine else EXIT_DOUBTFUL


def _write(options: argparse.Namespace, report: EpochsReport) -> None:
    """Write the files that the options ask for."""
    write_exports(report, options)
    if options.out is not None:
        write_files(
            Path(options.out),
            {
                "epochs.txt": render_congruence(report.found, blocks=report.blocks),
                "displacements.csv": as_csv(displacements_table(report)),
                "results.json": epochs_results_text(report),
            },
        )
    if options.plot is not None:
        from ..report.plots.displacements import plot_displacements
        from ..report.plots.figure_files import save_figure

        figure = plot_displacements(
            report.found, blocks=report.blocks, confidence=report.confidence
        )
        save_figure(figure, options.plot)
    if options.report is not None:
        from ..report.html.page import write_html

        write_html(report, options.report, language=options.language or "en", files=options.project)


def _refuse_options(options: argparse.Namespace) -> None:
    """Raise the problems of the options before any file is read."""
    problems = list(problems_of_outputs(options))
    if options.plot is not None and Path(options.plot).is_dir():
        problems.append(Problem("--plot must be a file, not a folder", options.plot))
    elif options.plot is not None:
        from ..report.plots.figure_files import FIGURE_FORMATS
        from ..report.plots.style import MATPLOTLIB_MISSING

        if find_spec("matplotlib") is None:
            problems.append(Problem(MATPLOTLIB_MISSING))
        if Path(options.plot).suffix.lower().removeprefix(".") not in FIGURE_FORMATS:
            valid = ", ".join(f".{f}" for f in FIGURE_FORMATS)
            problems.append(Problem(f"--plot has no valid suffix; valid: {valid}", options.plot))
    problems += problems_of_report_options(options)
    if options.alpha >= options.power:
        problems.append(
            Problem(f"--alpha {options.alpha:g} must be less than --power {options.power:g}")
        )
    if problems:
        raise InputError(problems)


def _adjusted(
    options: argparse.Namespace, path: str, first: Solution | None
) -> tuple[Units, Solution]:
    """Read and adjust an epoch; a second free network takes the datum of the first."""
    project = read_input(options, path)
    if options.datum is not None:
        project.network.datum = options.datum
    if first is None:
        refuse_exports(project.network, options, epochs=True)
    start = first if project.network.datum == "free" else None
    _, solution = adjust_determined(
        project, partial(adjust, start=start), leave_out=options.leave_out_undetermined
    )
    return project.units, solution


def _names(given: str | None) -> list[str] | None:
    return None if given is None else [n.strip() for n in given.split(",") if n.strip()]


def _block_of(text: str) -> tuple[MotionModel, list[str]]:
    """Return model and names of MODEL:NAMES or NAMES."""
    word, colon, rest = text.partition(":")
    for model in get_args(MotionModel):
        if colon and word == model:
            return model, _names(rest) or []
    return "rigid", _names(text) or []


def _motions(
    found: Congruence, blocks: Sequence[tuple[MotionModel, list[str]]]
) -> tuple[BlockMotion, ...]:
    """Return the common motions.

    Raises:
        InputError: a word before a colon is neither a model nor part of a name of a point.
    """
    problems = []
    for _, names in blocks:
        word, colon, rest = names[0].partition(":") if names else ("", "", "")
        if colon and names[0] not in found.displacements and rest in found.displacements:
            valid = known(get_args(MotionModel), meant=word)
            problems.append(Problem(f"unknown model {word!r}; valid: {valid}", "--block"))
    if problems:
        raise InputError(problems)
    return tuple(block_motion(found, names, model=model) for model, names in blocks)
