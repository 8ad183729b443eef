"""The option ``--export``: results of an adjustment in formats of other programs."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem, known, similar
from ..export.exports import EXPORTS, Target, formats, target
from ..files import refuse_replacing
from ..io.writers import WRITERS
from ..network.network import Network
from ..report.context import Report
from ..report.epochs.context import EpochsReport
from .input import settings

NAMES = (*(e.name for e in EXPORTS), *(w.name for w in WRITERS.entries))
"""Words for the formats that may stand before a file."""


def add_exports(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument(
        "--export",
        metavar="[FORMAT:]FILE",
        action="append",
        default=[],
        help=f"write the result for other programs, by the suffix: {formats()}; may be repeated",
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


def _target(text: str) -> Target:
    """Return the file and the format of ``FORMAT:FILE`` or ``FILE``."""
    name, colon, file = text.partition(":")
    if colon and name in NAMES and file:
        return target(Path(file), name)
    return target(Path(text))


def _options(options: argparse.Namespace) -> dict[str, Any]:
    """Return the options of the formats; InputError for one that no exported format has."""
    given = settings(options.writing, "--with")
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
