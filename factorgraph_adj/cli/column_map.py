"""Command ``guess-columns``: guesses a mapping of the columns of a table, as TOML."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from ..control_characters import escaped
from ..io.survey.proposed_column_map import guessed_mapping
from .messages import EXIT_BAD_INPUT, EXIT_FINE


def add_guess_columns(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.description = (
        "Guess from the header and the cells of a table which column has what, and print the "
        "mapping as TOML: save the output, correct it, pass it as --set mapping=FILE. The exit "
        f"code is {EXIT_BAD_INPUT} where the table leaves something open, which standard error "
        f"names, otherwise {EXIT_FINE}."
    )
    parser.add_argument("table", help="text with separators, or a workbook of Excel (.xlsx)")
    parser.add_argument("--sheet", metavar="NAME", help="sheet of a workbook")
    parser.set_defaults(run=print_mapping)


def print_mapping(options: argparse.Namespace) -> int:
    """Print the mapping, and on standard error what it leaves open."""
    guess = guessed_mapping(Path(options.table), options.sheet)
    print(escaped(guess.toml()), end="")
    if guess.open_keys:
        print(f"to be completed: {', '.join(guess.open_keys)}", file=sys.stderr)
    return EXIT_BAD_INPUT if guess.open_keys else EXIT_FINE
