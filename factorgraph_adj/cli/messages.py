"""Messages of the commands on stderr: lists of problems, and progress on a terminal."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeAlias

from ..control_characters import escaped
from ..errors import Problem
from .repeats import summed_up

Show: TypeAlias = Callable[[str], None]
"""Function that replaces the line of progress by a text."""
MOST_PROBLEMS = 200
"""Largest number of lines of problems."""


def listed(problems: Sequence[object], *, every: bool = False) -> list[str]:
    """Return the lines of a list of problems, indented.

    Args:
        problems: the problems.
        every: whether each has a line; otherwise those that repeat are summed up, and at most
            `MOST_PROBLEMS` lines are returned.
    """
    lines = [str(p) for p in problems] if every else summed_up(problems)
    lines = [escaped(line) for line in lines]
    shown = lines if every else lines[:MOST_PROBLEMS]
    out = [f"  {line}".replace("\n", "\n    ") for line in shown]
    if len(lines) > len(shown):
        out.append(f"  … and {len(lines) - len(shown)} more (check --all lists them)")
    return out


def complain(problems: Sequence[Problem], *, every: bool = False) -> None:
    """List problems on stderr.

    Args:
        problems: the problems.
        every: whether those that repeat are listed one by one.
    """
    n = len(problems)
    print(f"{n} problem{'s' * (n != 1)}:", file=sys.stderr)
    for line in listed(problems, every=every):
        print(line, file=sys.stderr)


def warn(warnings: Sequence[Problem]) -> None:
    """Print warnings on stderr, one in each line."""
    for warning in warnings:
        print(f"warning: {escaped(str(warning))}", file=sys.stderr)


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
    terminal = getattr(sys.stderr, "direct", sys.stderr)
    with Console(file=terminal).status(f"{name}: reading and approximate values") as status:
        yield lambda text: status.update(f"{name}: {text}")


def iteration(number: int, vtpv: float, step: float) -> str:
    """Return the line of progress of one iteration."""
    return f"iteration {number:3d}   vᵀPv {vtpv:12.6g}   largest step {step:9.2g} σ"
