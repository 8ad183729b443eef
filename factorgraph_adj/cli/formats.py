"""Command ``formats``: a list of the formats that are read and written."""

from __future__ import annotations

import argparse

from ..export.formats import EXPORT_FORMATS
from ..io.readers import READERS
from ..io.writers import WRITERS
from .messages import EXIT_FINE

HEADINGS = (
    "Networks read; --from WORD where the content does not tell the format",
    "Networks written by convert and --export; --to WORD",
    "Results written by --export",
)


def add_formats(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command, of which there are none."""
    parser.set_defaults(run=print_formats)


def print_formats(options: argparse.Namespace) -> int:
    """Print the word, the suffixes and the description of every format."""
    tables = (
        [(r.name, r.description, r.suffixes) for r in READERS.entries],
        [(w.name, w.description, w.suffixes) for w in WRITERS.entries],
        [(e.name, e.description, e.suffixes) for e in EXPORT_FORMATS],
    )
    for heading, rows in zip(HEADINGS, tables, strict=True):
        width = max(len(name) for name, _, _ in rows)
        print(heading)
        for name, description, suffixes in sorted(rows):
            print(f"  {name:<{width}}  {description}: {', '.join(suffixes) or 'folder'}")
        print()
    return EXIT_FINE
