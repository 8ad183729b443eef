"""The command ``factorgraph-adj convert``: read a network in one format, write it in another."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..io.writers import WRITERS
from .exit_codes import FINE
from .input import add_project, read_input, settings
from .messages import warn


def add_convert(parser: argparse.ArgumentParser) -> None:
    """Add the arguments."""
    add_project(parser)
    add_writing(parser)
    parser.set_defaults(run=_convert)


def add_writing(parser: argparse.ArgumentParser) -> None:
    """Add the file to write, its format and options."""
    parser.add_argument("out", metavar="OUT", help=f"a file: {WRITERS}")
    parser.add_argument(
        "--to",
        choices=[w.name for w in WRITERS.entries],
        metavar="FORMAT",
        help="the format to write, where the suffix does not tell it: "
        + ", ".join(w.name for w in WRITERS.entries),
    )
    parser.add_argument(
        "--with",
        dest="writing",
        metavar="KEY=VALUE",
        action="append",
        default=[],
        help="an option of the writer of the format; may be repeated",
    )


def _convert(options: argparse.Namespace) -> int:
    writing = settings(options.writing, "--with")
    writer = WRITERS.of(Path(options.out), options.to)  # before a long reading
    project = read_input(options)
    warn(project.warnings)
    WRITERS.write(project.network, options.out, format=options.to, options=writing)
    network = project.network
    if writer.alone:
        print(f"{options.out}: {writer.alone} of {options.project}, and nothing else of it")
        return FINE
    print(
        f"{options.out}: {len(network.points)} points, {len(network.photos)} photos, "
        f"{network.n_image_points} image points and {len(network.observations)} other "
        f"observations of {options.project}"
    )
    return FINE
