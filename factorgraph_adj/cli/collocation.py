"""Command ``collocate``: corrections of points by residuals at known ones, of images by grids."""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np

from ..adjustment import adjust
from ..collocation.covariance_function import CORRELATION_FUNCTIONS, CovarianceFunction
from ..collocation.image_corrections import corrected_bundle
from ..collocation.point_corrections import KnownPoints, StatedCovariance, point_corrections
from ..collocation.trend import TRENDS
from ..errors import InputError
from ..io.file_transaction import one_transaction, write_files
from ..io.project import Project
from ..io.project_writer import write_project
from ..network.network import Network
from ..report.doubtful_results import notes_of_solution
from ..report.point_corrections import (
    CorrectionsReport,
    corrected_points_table,
    known_points_table,
    render_corrections,
    render_image_corrections,
)
from ..report.tables import as_csv
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_MODEL
from .input import add_project, read_input
from .messages import EXIT_CODES, EXIT_DOUBTFUL, EXIT_FINE
from .options import (
    add_leave_out,
    adjust_determined,
    check_sigma,
    positive_count,
    probability,
    problems_of_outputs,
)

IMAGE_ROUNDS = 5
"""Largest number of bundles with correction grids."""
GIVEN_SIGMA_M = 1e-6
"""σ of coordinates that are given without error, where nothing is observed, metres."""
ROWS = 30
"""Number of corrected points that the screen has."""


def add_collocate(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    parser.epilog = EXIT_CODES
    add_project(parser)
    kinds = ", ".join(CORRELATION_FUNCTIONS)
    parser.add_argument(
        "--covariance",
        type=covariance_function,
        default="gaussian",
        metavar="KIND[:SIGMA,LENGTH]|none",
        help=f"covariance function in plan: {kinds}; σ and length, metres, are estimated from the "
        "residuals if they are not stated (gaussian)",
    )
    parser.add_argument(
        "--height",
        type=height_function,
        default="same",
        metavar="KIND[:SIGMA,LENGTH]|none|same",
        help="the same of heights (same: that of the plan)",
    )
    parser.add_argument(
        "--trend", choices=tuple(TRENDS), default="none", help="besides the signal (none)"
    )
    parser.add_argument(
        "--use",
        choices=get_args(KnownPoints),
        default="control",
        help="which known coordinates are compared (control)",
    )
    parser.add_argument(
        "--noise",
        type=check_sigma,
        metavar="S|H,V",
        help="σ of the known coordinates instead of the stated ones, metres: of each axis, or "
        "horizontal and vertical; that of check points is estimated without it",
    )
    parser.add_argument(
        "--alpha",
        type=probability,
        default=ALPHA_OF_MODEL,
        metavar="P",
        help="with which the test finds a signal where there is none (0.05)",
    )
    parser.add_argument(
        "--images",
        nargs="?",
        type=positive_count,
        const=IMAGE_ROUNDS,
        metavar="ROUNDS",
        help="instead filter the residuals of images, and adjust again with a correction grid of "
        f"each camera, until no signal is left or {IMAGE_ROUNDS} (ROUNDS) times; SIGMA and LENGTH "
        "of --covariance are in image units; --out has the project with the grids",
    )
    parser.add_argument(
        "--rows", type=positive_count, default=ROWS, metavar="N", help=f"of points ({ROWS})"
    )
    parser.add_argument("--datum", choices=("given", "free"), help="instead of the project's")
    parser.add_argument(
        "--out", metavar="DIR", help="write collocation.txt, corrections.csv, known_points.csv"
    )
    add_leave_out(parser)
    parser.set_defaults(run=_collocate)


def covariance_function(text: str) -> StatedCovariance:
    """Read KIND, KIND:SIGMA,LENGTH in metres, or none."""
    kind, colon, rest = text.partition(":")
    if text == "none":
        return None
    try:
        if not colon:
            return CovarianceFunction(kind, 1.0, 1.0).kind
        sigma, length = (float(v) for v in rest.split(","))
        return CovarianceFunction(kind, sigma, length)
    except InputError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    except ValueError:
        what = f"{text!r} is not KIND:SIGMA,LENGTH in metres, such as gaussian:0.02,800"
        raise argparse.ArgumentTypeError(what) from None


def height_function(text: str) -> StatedCovariance:
    """Read what `covariance_function` reads, or ``same``."""
    return text if text == "same" else covariance_function(text)


def _collocate(options: argparse.Namespace) -> int:
    if problems := list(problems_of_outputs(options)):
        raise InputError(problems)
    project = read_input(options)
    if options.datum is not None:
        project.network.datum = options.datum
    project = replace(project, network=_with_given_points(project.network))
    project, solution = adjust_determined(project, adjust, leave_out=options.leave_out_undetermined)
    if options.images is not None:
        return _images(options, project, solution)
    noise = options.noise
    found = point_corrections(
        solution,
        covariance=options.covariance,
        height=options.height,
        trend=options.trend,
        use=options.use,
        noise=(noise[0], noise[0], noise[1]) if isinstance(noise, tuple) else noise,
        alpha=options.alpha,
    )
    report = CorrectionsReport(found, project.units)
    if options.out is not None:
        with one_transaction():
            write_files(
                Path(options.out),
                {
                    "collocation.txt": render_corrections(report),
                    "corrections.csv": as_csv(corrected_points_table(report)),
                    "known_points.csv": as_csv(known_points_table(report)),
                },
            )
    print(render_corrections(report, most=options.rows), end="", flush=True)
    for said in notes_of_solution(solution):
        print(said, file=sys.stderr)
    for remark in found.remarks:
        print(remark, file=sys.stderr)
    return EXIT_DOUBTFUL if found.remarks or not solution.converged else EXIT_FINE


def _with_given_points(network: Network) -> Network:
    """Return a network without observations with weights of its coordinates; else itself.

    Its coordinates are results of another adjustment, or a survey, and nothing adjusts them. Those
    without a stated σ count as errorless; held ones have no unknowns, of which an adjustment needs
    one, so that those with check coordinates are weighted instead.
    """
    if network.observations or network.images.photo:
        return network
    out = network.copy()
    for name, p in network.points.items():
        stated = p.sigma if p.sigma is not None else (np.inf,) * 3
        check = p.check if p.check is not None else (np.nan,) * 3
        held = [f and not np.isfinite(c) for f, c in zip(p.fixed, check, strict=True)]
        sigma = [
            np.inf if h or not np.isfinite(x) else s if np.isfinite(s) else GIVEN_SIGMA_M
            for h, s, x in zip(held, stated, p.coordinates, strict=True)
        ]
        out.points[name] = replace(
            p,
            fixed=(held[0], held[1], held[2]),
            sigma=(sigma[0], sigma[1], sigma[2]) if np.isfinite(sigma).any() else None,
        )
    return out


def _images(options: argparse.Namespace, project: Project, solution: Solution) -> int:
    """Adjust again with correction grids of the cameras, print and write them; an exit code."""
    if options.covariance is None:
        raise InputError("--covariance none leaves nothing to filter in images")
    found = corrected_bundle(
        solution, covariance=options.covariance, rounds=options.images, alpha=options.alpha
    )
    text = render_image_corrections(found)
    if options.out is not None:
        with one_transaction():
            write_files(Path(options.out), {"collocation.txt": text})
            write_project(
                found.solution.network, Path(options.out, "project.toml"), units=project.units
            )
    print(text, end="", flush=True)
    for said in notes_of_solution(found.solution):
        print(said, file=sys.stderr)
    corrected = any(c.cameras for c in found.rounds)
    return EXIT_FINE if corrected and found.solution.converged else EXIT_DOUBTFUL
