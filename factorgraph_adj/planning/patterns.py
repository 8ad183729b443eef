"""Patterns for names of points and observations.

``*`` matches any characters and ``?`` one character; all other characters, also brackets, match
themselves. A single string is one pattern.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from ..errors import known
from ..types import Mask


class Name(str):
    """A literal name, in which ``*`` and ``?`` match only themselves."""

    __slots__ = ()


def patterns_of(given: Any) -> tuple[str, ...]:
    """Return patterns as a tuple; a single string is one pattern."""
    if isinstance(given, str):
        return (given,)
    try:
        return tuple(given)
    except TypeError:
        return (given,)


def matching(names: Sequence[str], patterns: Sequence[str]) -> Mask:
    """Return which names match one of the patterns, (n,)."""
    exact: Collection[str] = {str(p) for p in patterns if _literal(p)}
    parts = [
        "".join({"*": ".*", "?": "."}.get(c, re.escape(c)) for c in p)
        for p in patterns
        if not _literal(p)
    ]
    like = re.compile("|".join(parts), re.DOTALL) if parts else None
    return np.array(
        [n in exact or (like is not None and like.fullmatch(n) is not None) for n in names],
        dtype=bool,
    )


def _literal(pattern: str) -> bool:
    return isinstance(pattern, Name) or not ("*" in pattern or "?" in pattern)


def unlike(what: str, patterns: Sequence[Any], names: Sequence[str]) -> list[str]:
    """Return the errors of patterns: an empty list of patterns, or patterns without a match.

    Args:
        what: "point" or "observation".
        patterns: the patterns.
        names: all existing names; kinds of observations first.
    """
    there = f"; there are: {known(names)}"
    if not patterns:
        return [f"it names no {what}s; '*' stands for all" + there]
    wrong = []
    like = "has an id or kind" if what == "observation" else "is named"
    for p in patterns:
        if not isinstance(p, str):
            wrong.append(f"names of {what}s are strings, not {p!r}")
        elif not matching(names, (p,)).any():
            wrong.append(f"no {what} {like} like {str(p)!r}" + there)
    return wrong
