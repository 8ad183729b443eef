"""Messages of the commands on stderr: lists of problems, and progress on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeAlias

from ..errors import Problem

Show: TypeAlias = Callable[[str], None]
"""Function that replaces the line of progress by a text."""
MOST_PROBLEMS = 200
"""Largest number of listed problems; a shifted column gives a problem in every line of a file."""


def complain(problems: Sequence[Problem]) -> None:
    """List problems on stderr, one in each line."""
    n = len(problems)
    print(f"{n} problem{'s' * (n != 1)}:", file=sys.stderr)
    for problem in problems[:MOST_PROBLEMS]:
        print(f"  {problem}".replace("\n", "\n    "), file=sys.stderr)
    if n > MOST_PROBLEMS:
        print(f"  … and {n - MOST_PROBLEMS} more", file=sys.stderr)


def warn(warnings: Sequence[Problem]) -> None:
    """Print warnings on stderr, one in each line."""
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)


@contextmanager
def progress(name: str) -> Iterator[Show | None]:
    """Show the progress of a command on a terminal, with rich if it is installed.

    Args:
        name: name of the network, which begins each text.

    Yields:
        The function that shows a text; None if stderr is not a terminal.
    """
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


def iteration(number: int, vtpv: float, step: float) -> str:
    """Return the line of progress of one iteration."""
    return f"iteration {number:3d}   vᵀPv {vtpv:12.6g}   largest step {step:9.2g} σ"
