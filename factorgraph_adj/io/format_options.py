"""Options of readers and writers from their signatures: names, groups, checked values.

An argument whose default is a dataclass, such as ``accuracies: Accuracies = USUAL``, is a group of
options: each field of the dataclass is an option of its own too.
"""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass, replace
from numbers import Integral, Real
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from ..errors import InputError, Problem, known, similar

NONE_WORD = "none"
"""Word of the command for an option that is None, such as ``refraction=none``."""


def options_of(function: Callable[..., object]) -> tuple[str, ...]:
    """Return the names of the keyword-only arguments of a function, and of the fields of groups."""
    groups = _groups(function)
    inside = (f.name for group in groups.values() for f in fields(group))
    return (*_arguments(function), *inside)


def arguments_of(function: Callable[..., object], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of a function for options, with fields in their groups.

    Args:
        function: the function.
        options: values of its options by name, as `fitting_options` returns them.

    Raises:
        InputError: a group refuses the value of a field.
    """
    out = {n: v for n, v in options.items() if n in _arguments(function)}
    for name, usual in _groups(function).items():
        stated = {f.name: options[f.name] for f in fields(usual) if f.name in options}
        if stated:
            out[name] = replace(out.get(name, usual), **stated)
    return out


def _arguments(function: Callable[..., object]) -> dict[str, Any]:
    """Return the default by name of the keyword-only arguments of a function."""
    found = inspect.signature(function).parameters.values()
    return {p.name: p.default for p in found if p.kind is p.KEYWORD_ONLY}


def _groups(function: Callable[..., object]) -> dict[str, Any]:
    """Return the usual groups of options by the names of their arguments."""
    every = _arguments(function).items()
    return {n: d for n, d in every if is_dataclass(d) and not isinstance(d, type)}


def refuse_unknown_options(
    given: Iterable[str], valid: Sequence[str], *, doing: str, where: str
) -> None:
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


def fitting_options(
    function: Callable[..., object], given: Mapping[str, Any], *, doing: str, where: str
) -> dict[str, Any]:
    """Return options with values that the annotations of a function allow.

    A whole number is taken for a text where only a text is allowed: a name such as 101. ``none`` is
    taken for None where None is allowed and no text.

    Args:
        function: the function; its keyword-only arguments are options.
        given: values by name, all of which the function has.
        doing: what the function does, for messages.
        where: file concerned.

    Raises:
        InputError: values are of another kind, or an option without a default is missing; all are
            listed.
    """
    needed = [
        p.name
        for p in inspect.signature(function).parameters.values()
        if p.kind is p.KEYWORD_ONLY and p.default is p.empty and p.name not in given
    ]
    hints = _kinds(function) if given or needed else {}
    out = dict(given)
    problems = [
        Problem(f"{doing} needs the option {name}: {' or '.join(_words(hints[name]))}", where)
        for name in needed
    ]
    for name, value in given.items():
        hint = hints.get(name, Any)
        if _fits(value, hint):
            continue
        if isinstance(value, str) and value.lower() == NONE_WORD and _fits(None, hint):
            out[name] = None  # TOML, in which the command takes values, has no null
            continue
        as_text = str(value) if isinstance(value, int) and not isinstance(value, bool) else None
        if as_text is not None and _fits(as_text, hint):
            out[name] = as_text
            continue
        what = f"{doing}: option {name} must be {' or '.join(_words(hint))}, not {value!r}"
        problems.append(Problem(what, where))
    if problems:
        raise InputError(problems)
    return out


def option_text(name: str, value: str | Sequence[str]) -> str:
    """Return how an option is given to the function and to the command, for messages.

    >>> option_text("fixed", "A,B")
    'fixed=A,B (--set fixed=A,B)'
    >>> option_text("repeated", "leave out")
    "repeated='leave out' (--set 'repeated=leave out')"
    >>> option_text("sigma_gcp", ("0.01", "0.02"))
    "sigma_gcp=(0.01, 0.02) (--set 'sigma_gcp=[0.01, 0.02]')"
    """
    if not isinstance(value, str):
        inside = ", ".join(value)
        return f"{name}=({inside}) (--set '{name}=[{inside}]')"
    if " " in value:
        return f"{name}={value!r} (--set '{name}={value}')"
    return f"{name}={value} (--set {name}={value})"


def _kinds(function: Callable[..., object]) -> dict[str, Any]:
    """Return the annotations of the options of a function, and of the fields of groups."""
    inside = {n: k for g in _groups(function).values() for n, k in get_type_hints(type(g)).items()}
    # The arguments of a class are those of its __init__, which only a dataclass has as fields.
    is_class = isinstance(function, type)
    made = inspect.getattr_static(function, "__init__") if is_class else function
    return {**inside, **get_type_hints(made)}


def _fits(value: object, hint: Any) -> bool:
    """Return whether a value is of the kind that an annotation says; unknown kinds fit."""
    if hint is Any:
        return True
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return any(_fits(value, one) for one in inner)
    if origin is Literal:
        return any(value == one and type(value) is type(one) for one in inner)
    if hint is None or hint is type(None):
        return value is None
    if isinstance(value, bool) or hint is bool:
        return hint is bool and isinstance(value, bool)
    if hint in (float, int):
        return isinstance(value, Real if hint is float else Integral)
    if isinstance(origin, type):
        return _holds(value, origin, inner)
    return isinstance(value, hint) if isinstance(hint, type) else True


def _holds(value: object, origin: type, inner: tuple[Any, ...]) -> bool:
    """Return whether a value is a table or a list of what an annotation says."""
    if issubclass(origin, Mapping):
        if not isinstance(value, Mapping):
            return False
        return all(_fits(k, inner[0]) and _fits(v, inner[1]) for k, v in value.items())
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        return False
    items = list(value) if isinstance(value, Sequence) or hasattr(value, "__len__") else []
    if issubclass(origin, tuple) and inner[-1] is not ...:
        return len(items) == len(inner) and all(map(_fits, items, inner))
    return all(_fits(item, inner[0]) for item in items)


def _words(hint: Any) -> list[str]:
    """Return what an annotation allows, in words."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        kinds = [one for one in inner if one is not str or Path not in inner]
        return list(dict.fromkeys(word for one in kinds for word in _words(one)))
    if origin is Literal:
        return [repr(one) for one in inner]
    plain = {
        float: "a number",
        int: "a whole number",
        bool: "true or false",
        str: "a text",
        Path: "the name of a file",
        type(None): "nothing",
    }
    if hint in plain:
        return [plain[hint]] if hint is not type(None) else []
    if not isinstance(origin, type):
        return [getattr(hint, "__name__", str(hint))]
    if issubclass(origin, Mapping):
        return ["a table, such as {name = 0.5}" if inner[1] is float else "a table of names"]
    numbers = inner[0] is float
    if issubclass(origin, tuple) and inner[-1] is not ...:
        return [f"a list of {len(inner)} {'numbers' if numbers else 'values'}"]
    return ["a list of numbers" if numbers else 'a list of texts, such as ["a", "b"]']
