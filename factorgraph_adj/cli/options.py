"""Options that commands share, and their use: adjustment, tests, pairs of places, exports."""

from __future__ import annotations

import argparse
import re
import shlex
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args

from ..adjustment import largest_determined_part
from ..errors import AdjustmentError, InputError, Problem, known, similar
from ..export.formats import ExportTarget, export_target, format_list
from ..files import folder_objection, refuse_replacing
from ..io.adjustment_options import AdjustOptions
from ..io.project import Project
from ..network.network import Network
from ..quality.observation_groups import GroupRule
from ..quality.point_precision import Place
from ..quality.robust_estimation import ESTIMATORS
from ..report.adjustment_report import Report
from ..report.epochs_report import EpochsReport
from ..report.html.rendering import require_report_packages
from ..report.options import Run
from .input import parsed_settings
from .messages import print_warnings
from .network_files import refuse_problems

FORMAT_BEFORE_FILE = re.compile(r"(?P<format>[a-z][a-z0-9_-]+):(?P<file>.+)", re.IGNORECASE)
"""A format and a file; a single letter is a drive, and ``./a:b.json`` has a colon in its name."""
AdjustmentResult = TypeVar("AdjustmentResult")
REPORT_SUFFIXES = (".html", ".htm")
"""Suffixes of a report."""


def add_exports(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--export",
        metavar="[FORMAT:]FILE",
        action="append",
        default=[],
        help=f"write the result for other programs, by suffix: {format_list()}; may be repeated",
    )
    parser.add_argument(
        "--with",
        dest="writing",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="an option of every exported format that has it; may be repeated",
    )


def refuse_exports(network: Network, options: argparse.Namespace, *, epochs: bool = False) -> None:
    """Raise what forbids the exports before the adjustment.

    Raises:
        InputError: a format or an option is unknown, an export is a folder, or the format needs a
            reference system and the network has none; with ``epochs``, the format cannot express
            a comparison of two epochs; a file was read and would be written over.
    """
    problems: list[Problem] = []
    for text in options.export:
        try:
            found = _target(text)
            if found.path.is_dir() and not found.of_network:
                raise InputError(Problem("--export must be a file, not a folder", text))
            if epochs:
                found.refuse_epochs()
            if found.check is not None:
                found.check(network)
            refuse_replacing([found.path])
        except InputError as error:
            problems += error.problems
    if problems:
        raise InputError(problems)
    _options(options)


def write_exports(report: Report | EpochsReport, options: argparse.Namespace) -> None:
    """Write the exports.

    Raises:
        InputError: a format cannot express the result, or a file cannot be written.
    """
    given = _options(options)
    for text in options.export:
        found = _target(text)
        found.write(report, **{n: v for n, v in given.items() if n in found.options})


def _target(text: str) -> ExportTarget:
    """Return the file and the format of ``FORMAT:FILE`` or ``FILE``."""
    stated = FORMAT_BEFORE_FILE.fullmatch(text)
    if stated is None:
        return export_target(Path(text))
    try:
        return export_target(Path(stated["file"]), stated["format"])
    except InputError as error:
        raise InputError([replace(p, where=p.where or text) for p in error.problems]) from None


def _options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of the formats; InputError for one that no exported format has."""
    given = parsed_settings(options.writing, "--with")
    if given and not options.export:
        raise InputError(Problem("--with belongs to --export"))
    valid = sorted({n for text in options.export for n in _target(text).options})
    has = f"valid: {known(valid)}" if valid else "they have none"
    problems = [
        Problem(f"no exported format has the option {n!r}; {has}{similar(n, valid)}", "--with")
        for n in given
        if n not in valid
    ]
    if problems:
        raise InputError(problems)
    return given


def run_description(options: argparse.Namespace, project: Project | None = None) -> Run:
    """Return file, date and options of a run.

    Args:
        options: options of the command, with all that was ``typed``.
        project: the project, whose own options are reported where they are not the usual ones.
    """
    named = options.project if isinstance(options.project, list) else [options.project]
    typed = options.typed[1:]
    for name in named:
        typed.remove(name)
    said = [shlex.join(typed) or "none", *_own(project)]
    return Run(", ".join(named), _date(options.date), "; ".join(said))


def _date(stated: str | None) -> str:
    if stated is not None:
        return "" if stated == "none" else stated
    return datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %z")


def _own(project: Project | None) -> list[str]:
    """Return the options of a project that are not the usual ones."""
    if project is None:
        return []
    usual, stated = AdjustOptions(), project.options
    each = ((f.name, getattr(stated, f.name), getattr(usual, f.name)) for f in fields(usual))
    said = [f"{name} {value}" for name, value, default in each if value != default]
    return [f"of the project: {', '.join(said)}"] if said else []


def requested_lines(
    options: argparse.Namespace, network: Network
) -> list[tuple[Place, Place]] | Literal["observed"] | None:
    """Return the pairs of places whose lines are wanted; None without an option for them.

    Raises:
        InputError: an option names no two places of the network.
    """
    if options.between is None:
        return "observed" if options.relative else None
    if options.relative:
        raise InputError("--relative lists all pairs that observations join, --between one pair")
    problems: list[Problem] = []
    pairs = [_pair(text, network, problems) for text in options.between]
    if problems:
        raise InputError(problems)
    return [pair for pair in pairs if pair is not None]


def _pair(text: str, network: Network, problems: list[Problem]) -> tuple[Place, Place] | None:
    """Return the two places of A,B; names may have commas of their own."""
    commas = [i for i, c in enumerate(text) if c == ","]
    for i in commas:
        a, b = (_place(part.strip(), network) for part in (text[:i], text[i + 1 :]))
        if a is not None and b is not None and a != b:
            return a, b
    names = [*network.points, *network.photos]
    what = "needs two places of the network, such as A,B"
    if len(commas) == 1:
        wrong = [p.strip() for p in text.split(",") if _place(p.strip(), network) is None]
        what = f"unknown {wrong[0]!r}" if wrong else "needs two different places"
    problems.append(Problem(f"{what}; known: {known(names)}", f"--between {text}"))
    return None


def _place(name: str, network: Network) -> Place | None:
    if name in network.points:
        return name
    return ("pose", name) if name in network.photos else None


def add_leave_out(parser: argparse._ActionsContainer) -> None:
    """Add the option."""
    parser.add_argument(
        "--leave-out-undetermined",
        action="store_true",
        help="leave out points, photos, sets and frames that the observations do not determine, "
        "with their observations, and list them; without it they stop the adjustment",
    )


def adjust_determined(
    project: Project, attempt: Callable[[Network], AdjustmentResult], *, leave_out: bool
) -> tuple[Project, AdjustmentResult]:
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
        print_warnings(project.warnings)
        return project, attempt(project.network)
    try:
        network, found = largest_determined_part(project.network, attempt)
    except AdjustmentError:
        refuse_problems(project, leaving_out=True)
        print_warnings(project.warnings)
        raise
    project = replace(project, network=network)
    refuse_problems(project)
    print_warnings(project.warnings)
    return project, found


def add_adjustment(parser: argparse.ArgumentParser) -> None:
    """Add the options of the adjustment."""
    how = parser.add_argument_group("how to adjust")
    how.add_argument("--datum", choices=("given", "free"), help="instead of the project's")
    how.add_argument(
        "--variance",
        choices=("a-priori", "a-posteriori"),
        help="scale of standard deviations, instead of the project's",
    )
    how.add_argument(
        "--max-iterations", type=positive_count, metavar="N", help="instead of the project's"
    )
    how.add_argument(
        "--solver",
        choices=("direct", "conjugate-gradients"),
        default="direct",
        help="elimination in fronts, or conjugate gradients for blocks of photos that do not fit "
        "in memory, without covariances of all unknowns (direct)",
    )
    add_leave_out(how)
    how.add_argument(
        "--variance-components",
        nargs="?",
        const="kind",
        choices=get_args(GroupRule),
        metavar="GROUPS",
        help="estimate σ of groups: kind (default), camera, photo, instrument or frame; after "
        "--snoop",
    )
    errors = parser.add_argument_group("gross errors")
    errors.add_argument(
        "--snoop", action="store_true", help="find gross errors, reject them, adjust again"
    )
    errors.add_argument(
        "--robust",
        choices=ESTIMATORS,
        help="start with this M-estimator, for many gross errors; implies --snoop",
    )
    errors.add_argument(
        "--test",
        choices=("baarda", "pope"),
        help="w, for which σ0 = 1, or τ with the estimated one (w, τ if a posteriori)",
    )
    add_probabilities(errors)
    errors.add_argument(
        "--sidak", action="store_true", help="--alpha is that of all tests of --snoop together"
    )


def add_probabilities(parser: argparse._ActionsContainer) -> None:
    """Add α and the power of a test."""
    parser.add_argument(
        "--alpha", type=probability, default=0.001, metavar="P", help="of one test (0.001)"
    )
    parser.add_argument(
        "--power",
        type=probability,
        default=0.80,
        metavar="P",
        help="with which an error of the smallest detectable size is found (0.80)",
    )


def problems_of_outputs(options: argparse.Namespace) -> Iterator[Problem]:
    """Iterate over the outputs for which there can be no folder; missing folders are made."""
    out = getattr(options, "out", None)
    if out is not None and Path(out).exists() and not Path(out).is_dir():
        yield Problem("--out must be a folder", out)
    elif out is not None and (why := folder_objection(Path(out))):
        yield Problem(why, out)
    files = [getattr(options, name, None) for name in ("report", "plot")]
    for text in getattr(options, "export", ()) or ():
        with suppress(InputError):  # `refuse_exports` names unknown formats with what else is wrong
            files.append(str(_target(text).path))
    for file in files:
        if file is not None and (why := folder_objection(Path(file).parent)):
            yield Problem(why, file)


def problems_of_report_options(options: argparse.Namespace) -> Iterator[Problem]:
    """Iterate over the problems of ``--report`` and ``--language``.

    Raises:
        InputError: the extra of reports is not installed.
    """
    if options.report is None:
        if options.language is not None:
            yield Problem("--language belongs to --report")
        return
    require_report_packages()
    if Path(options.report).is_dir():
        yield Problem("--report must be a file, not a folder", options.report)
    elif Path(options.report).suffix.lower() not in REPORT_SUFFIXES:
        what = "--report has no valid suffix; valid: .html (a browser prints it as PDF)"
        yield Problem(what, options.report)


def positive_count(text: str) -> int:
    """Read a whole number ≥ 1."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1")
    return int(text)


def probability(text: str) -> float:
    """Read a probability between 0 and 1."""
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0 < value < 1:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a probability between 0 and 1, such as 0.95"
        )
    return value


def check_sigma(text: str) -> float | tuple[float, float]:
    """Read σ of the survey of check points: one of each axis, or horizontal and vertical."""
    try:
        values = [float(v) for v in text.split(",")]
    except ValueError:
        values = []
    if len(values) not in (1, 2) or not all(0 <= v < float("inf") for v in values):
        raise argparse.ArgumentTypeError(
            f"{text!r} is not σ ≥ 0 in metres, or horizontal and vertical σ, such as 0.01,0.02"
        )
    return values[0] if len(values) == 1 else (values[0], values[1])
