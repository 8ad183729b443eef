"""Lists of problems in which one that repeats is summed up: the first, and where the others are.

A wrong unit or a shifted column gives the same problem in every row of a file. Problems are the
same where they ask for the same remedy and stand in the same file, whatever their numbers and
names.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from ..errors import known

MANY = 10
"""Largest number of problems of one kind that are listed one by one."""
FIRST = 3
"""Number of problems that are listed of a kind with more than `MANY`."""
NAMED = 6
"""Largest number of places of the others that are listed."""

_LIST = re.compile(r"; (?:valid|known|it takes):.*", re.DOTALL)
_ANY = re.compile(r"'[^']*'|\"[^\"]*\"|[-+]?\d[\d.,]*(?:e[-+]?\d+)?")
_PLACE = re.compile(r"([^\s:(]+\.\w+):(\d+)")
_LABEL = re.compile(_PLACE.pattern + r":(?: [^\s:;,]+)*")
_QUOTED = re.compile(r"'[^']*'")


def kind_of(problem: object) -> tuple[str, str]:
    """Return what problems that are the same have in common: their file, and their text.

    Args:
        problem: a finding with a remedy, which tells its kind, or a problem with a text.
    """
    text = str(problem)
    place = _PLACE.search(text)
    said = _LABEL.sub("", _LIST.sub("", str(getattr(problem, "what", text))))
    remedy = getattr(problem, "remedy", "")
    return (place[1] if place else "", _ANY.sub("#", f"{said}; {remedy}"))


def summed_up(problems: Sequence[object]) -> list[str]:
    """Return the lines of a list of problems in its order; those that repeat are summed up.

    Args:
        problems: findings or problems.
    """
    groups: dict[tuple[str, str], list[object]] = {}
    for p in problems:
        groups.setdefault(kind_of(p), []).append(p)
    out = []
    for own in groups.values():
        most = len(own) if len(own) <= MANY else FIRST
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
    return f" ({known(names, most=NAMED)})" if len(names) > 1 else ""


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
    shown = [str(a) if a == b else f"{a} to {b}" for a, b in ranges[:NAMED]]
    more = f", … {lines[-1]}" if len(ranges) > NAMED else ""
    return f": {found[0][1]}, line{'s' * (len(lines) > 1)} {', '.join(shown)}{more}"
