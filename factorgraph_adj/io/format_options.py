"""Options of the functions that read and write formats: their keyword-only arguments."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Sequence

from ..errors import InputError, Problem, known, similar


def options_of(function: Callable[..., object]) -> tuple[str, ...]:
    """Return the names of the keyword-only arguments of a function."""
    found = inspect.signature(function).parameters.values()
    return tuple(p.name for p in found if p.kind is p.KEYWORD_ONLY)


def refuse_unknown(given: Iterable[str], valid: Sequence[str], *, doing: str, where: str) -> None:
    """Raise all options that a function does not have.

    Args:
        given: names of the options that are given.
        valid: names of the options that there are.
        doing: what the function does, for messages: ``reading GNU Gama``.
        where: file concerned.

    Raises:
        InputError: some given names are not valid.
    """
    has = f"valid: {known(valid)}" if valid else "it has none"
    problems = [
        Problem(f"{doing} has no option {name!r}; {has}{similar(name, valid)}", where)
        for name in given
        if name not in valid
    ]
    if problems:
        raise InputError(problems)


def refuse_missing(
    given: Iterable[str], function: Callable[..., object], *, doing: str, where: str
) -> None:
    """Raise the options without a default that are not given.

    Args:
        given: names of the options that are given.
        function: function whose keyword-only arguments are the options.
        doing: what the function does, for messages.
        where: file concerned.

    Raises:
        InputError: an option must be given and is not.
    """
    names = set(given)
    problems = [
        Problem(f"{doing} needs the option {p.name!r}: --set {p.name}=… of the command", where)
        for p in inspect.signature(function).parameters.values()
        if p.kind is p.KEYWORD_ONLY and p.default is p.empty and p.name not in names
    ]
    if problems:
        raise InputError(problems)
