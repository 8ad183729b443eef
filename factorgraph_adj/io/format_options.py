"""Options of the functions that read and write formats: their keyword-only arguments.

An argument whose default is a dataclass, such as ``accuracies: Accuracies = USUAL``, is a group of
options: each field of the dataclass is an option of its own too.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any

from ..errors import InputError, Problem, known, similar


def options_of(function: Callable[..., object]) -> tuple[str, ...]:
    """Return the names of the keyword-only arguments of a function, and of the fields of groups."""
    groups = _groups(function)
    inside = (f.name for group in groups.values() for f in fields(group))
    return (*_arguments(function), *inside)


def arguments_of(function: Callable[..., object], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of a function for options, with fields in their groups.

    Args:
        function: the function.
        options: values of its options by name, as `options_of` lists them.

    Raises:
        InputError: a group refuses the value of a field, or is given as something else.
    """
    out = {n: v for n, v in options.items() if n in _arguments(function)}
    for name, usual in _groups(function).items():
        stated = {f.name: options[f.name] for f in fields(usual) if f.name in options}
        group = out.get(name, usual)
        if not isinstance(group, type(usual)):
            valid = known([f.name for f in fields(usual)], most=20)
            what = f"must be {type(usual).__name__}(…), not {group!r}; or give its fields: {valid}"
            raise InputError(Problem(what, name))
        if stated:
            out[name] = replace(group, **stated)
    return out


def _arguments(function: Callable[..., object]) -> dict[str, Any]:
    """Return the default by name of the keyword-only arguments of a function."""
    found = inspect.signature(function).parameters.values()
    return {p.name: p.default for p in found if p.kind is p.KEYWORD_ONLY}


def _groups(function: Callable[..., object]) -> dict[str, Any]:
    """Return the usual groups of options by the names of their arguments."""
    every = _arguments(function).items()
    return {n: d for n, d in every if is_dataclass(d) and not isinstance(d, type)}


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
