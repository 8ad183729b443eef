"""Options that several commands share: project, kind of adjustment, probabilities of tests."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

from ..errors import Problem
from ..quality.observation_groups import Rule
from ..quality.robust import ESTIMATORS
from ..report.html.libraries import refuse_missing
from .undetermined import add_leave_out

PAGES = (".html", ".htm")
"""Suffixes of a report."""


def add_adjustment(parser: argparse.ArgumentParser) -> None:
    """Add the options of the adjustment."""
    how = parser.add_argument_group("how to adjust")
    how.add_argument("--datum", choices=("given", "free"), help="instead of the project's")
    how.add_argument(
        "--variance",
        choices=("a-priori", "a-posteriori"),
        help="scale of standard deviations, instead of the project's",
    )
    how.add_argument("--max-iterations", type=count, metavar="N", help="instead of the project's")
    add_leave_out(how)
    how.add_argument(
        "--variance-components",
        nargs="?",
        const="kind",
        choices=get_args(Rule),
        metavar="GROUPS",
        help="estimate σ of groups: kind (default), camera, photo, instrument or frame; after "
        "--snoop",
    )
    errors = parser.add_argument_group("gross errors")
    errors.add_argument(
        "--snoop", action="store_true", help="find gross errors, set them aside, adjust again"
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


def problems_of_report(options: argparse.Namespace) -> Iterator[Problem]:
    """Iterate over the problems of ``--report`` and ``--language``.

    Raises:
        InputError: the extra of reports is not installed.
    """
    if options.report is None:
        if options.language is not None:
            yield Problem("--language belongs to --report")
        return
    refuse_missing()
    if Path(options.report).is_dir():
        yield Problem("--report must be a file, not a folder", options.report)
    elif Path(options.report).suffix.lower() not in PAGES:
        what = "--report has no valid suffix; valid: .html (a browser prints it as PDF)"
        yield Problem(what, options.report)


def count(text: str) -> int:
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
