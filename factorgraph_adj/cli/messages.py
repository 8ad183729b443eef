"""Exit codes; messages on stderr: repeated problems summed up, warnings, progress of iterations.

A wrong unit or a shifted column gives the same problem in every row of a file. Problems are the
same where they ask for the same remedy and are in the same file, whatever their numbers and names:
a list has the first of them, and where the others are.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TypeAlias

from ..control_characters import escaped
from ..errors import Problem, known

EXIT_FINE = 0
"""The command succeeded."""
EXIT_DOUBTFUL = 1
"""The result has not converged, fails the global test, has gross errors or misses a target; or
readings do not agree before any adjustment."""
EXIT_BAD_INPUT = 2
"""Options or files are wrong, or the observations do not determine the unknowns."""
EXIT_FAULT = 3
"""The program itself failed."""
EXIT_INTERRUPTED = 130
"""The user interrupted the command: 128 + the number of SIGINT, the convention of shells."""

FURTHER_EXIT_CODES = "2 bad input; 3 a fault of the program; 130 interrupted"
"""The exit codes that all commands have in common, for their help."""
EXIT_CODES = (
    "exit codes: 0 fine; 1 not converged, global test failed, or gross errors left; "
    f"{FURTHER_EXIT_CODES}"
)
"""The exit codes of adjustments, for the help."""

MAX_PROBLEMS_OF_KIND = 10
"""Largest number of problems of one kind that are listed one by one."""
PROBLEMS_OF_REPEATED_KIND = 3
"""Number of problems that are listed of a kind with more than `MAX_PROBLEMS_OF_KIND`."""
MAX_PLACES_NAMED = 6
"""Largest number of places of the others that are listed."""

_LIST = re.compile(r"; (?:valid|known|it takes):.*", re.DOTALL)
_ANY = re.compile(r"'[^']*'|\"[^\"]*\"|[-+]?\d[\d.,]*(?:e[-+]?\d+)?")
_PLACE = re.compile(r"([^\s:(]+\.\w+):(\d+)")
_LABEL = re.compile(_PLACE.pattern + r":(?: [^\s:;,]+)*")
_QUOTED = re.compile(r"'[^']*'")
MAX_PROBLEM_LINES = 200
"""Largest number of lines of problems."""
ShowProgress: TypeAlias = Callable[[str], None]
"""Function that replaces the line of progress by a text."""
ALL_HELP = (
    "list problems one by one; by default those of one kind are summarised if there are more than "
    f"{MAX_PROBLEMS_OF_KIND}, and at most {MAX_PROBLEM_LINES} lines are printed"
)
"""Help of ``--all``."""


def kind_of_problem(problem: object) -> tuple[str, str]:
    """Return what problems that are the same have in common: their file, and their text.

    Args:
        problem: a finding with a remedy, which tells its kind, or a problem with a text.
    """
    text = str(problem)
    place = _PLACE.search(text)
    said = _LABEL.sub("", _LIST.sub("", str(getattr(problem, "what", text))))
    remedy = getattr(problem, "remedy", "")
    return (place[1] if place else "", _ANY.sub("#", f"{said}; {remedy}"))


def summarised_problems(problems: Sequence[object]) -> list[str]:
    """Return the lines of a list of problems in its order; those that repeat are summed up.

    Args:
        problems: findings or problems.
    """
    groups: dict[tuple[str, str], list[object]] = {}
    for p in problems:
        groups.setdefault(kind_of_problem(p), []).append(p)
    out = []
    for own in groups.values():
        most = len(own) if len(own) <= MAX_PROBLEMS_OF_KIND else PROBLEMS_OF_REPEATED_KIND
        out += [str(p) for p in own[:most]]
        if len(own) > most:
            out.append(
                f"and {len(own) - most} more of this kind{_names(own[most:])}{_places(own[most:])}"
            )
    return out


def _names(problems: Sequence[object]) -> str:
    """Return what problems name first, such as unknown points, each once; empty: all the same."""
    found = [m[0] for p in problems if (m := _QUOTED.search(_LIST.sub("", str(p))))]
    names = list(dict.fromkeys(found))
    return f" ({known(names, most=MAX_PLACES_NAMED)})" if len(names) > 1 else ""


def _places(problems: Iterable[object]) -> str:
    """Return where problems are: lines of a file as ranges; empty if they do not say."""
    found = [m for p in problems if (m := _PLACE.search(str(p)))]
    if not found:
        return ""
    lines = sorted({int(m[2]) for m in found})
    ranges: list[list[int]] = []
    for line in lines:
        if ranges and line == ranges[-1][1] + 1:
            ranges[-1][1] = line
        else:
            ranges.append([line, line])
    shown = [str(a) if a == b else f"{a} to {b}" for a, b in ranges[:MAX_PLACES_NAMED]]
    more = f", … {lines[-1]}" if len(ranges) > MAX_PLACES_NAMED else ""
    return f": {found[0][1]}, line{'s' * (len(lines) > 1)} {', '.join(shown)}{more}"


def problem_lines(problems: Sequence[object], *, every: bool = False) -> list[str]:
    """Return the lines of a list of problems, indented.

    Args:
        problems: the problems.
        every: whether each has a line; otherwise those that repeat are summed up, and at most
            `MAX_PROBLEM_LINES` lines are returned.
    """
    lines = [str(p) for p in problems] if every else summarised_problems(problems)
    lines = [escaped(line) for line in lines]
    shown = lines if every else lines[:MAX_PROBLEM_LINES]
    out = [f"  {line}".replace("\n", "\n    ") for line in shown]
    if len(lines) > len(shown):
        out.append(f"  … and {len(lines) - len(shown)} more (check --all lists them)")
    return out


def print_problems(problems: Sequence[Problem], *, every: bool = False) -> None:
    """List problems on stderr.

    Args:
        problems: the problems.
        every: whether those that repeat are listed one by one.
    """
    n = len(problems)
    print(f"{n} problem{'s' * (n != 1)}:", file=sys.stderr)
    for line in problem_lines(problems, every=every):
        print(line, file=sys.stderr)


def print_warnings(warnings: Sequence[Problem]) -> None:
    """Print warnings on stderr, one in each line."""
    for warning in warnings:
        print(f"warning: {escaped(str(warning))}", file=sys.stderr)


@contextmanager
def progress_display(name: str) -> Iterator[ShowProgress | None]:
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


def iteration_line(number: int, vtpv: float, step: float) -> str:
    """Return the line of progress of one iteration."""
    return f"iteration {number:3d}   vᵀPv {vtpv:12.6g}   largest step {step:9.2g} σ"
