"""Metaclass whose constructors say which arguments are missing, unknown or too many."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from inspect import Parameter, Signature, signature
from typing import Any, TypeVar

from .errors import InputError, Problem, known

_T = TypeVar("_T")

MAX_SHOWN_CHARACTERS = 40
"""Largest length of an argument that a message shows."""


class ChecksArguments(type):
    """Class of classes whose constructors say which arguments are missing, unknown or too many."""

    @property
    def __signature__(cls) -> Signature:
        """Arguments of the constructor, which ``help`` and editors show."""
        own = signature(cls.__init__)  # type: ignore[misc]
        return own.replace(parameters=list(own.parameters.values())[1:])

    def __call__(cls: type[_T], *values: Any, **named: Any) -> _T:
        """Return an instance.

        Raises:
            InputError: what is wrong with the arguments, and which there are.
        """
        try:
            return type.__call__(cls, *values, **named)  # type: ignore[no-any-return]
        except TypeError:
            if problems := argument_problems(cls, values, named):
                raise InputError(problems) from None
            raise


def argument_problems(
    of: type, values: Sequence[object], named: Mapping[str, object]
) -> list[Problem]:
    """Return what is wrong with the arguments of a constructor, all at once.

    Args:
        of: the class.
        values: arguments without names.
        named: arguments with names.
    """
    every = list(signature(of.__init__).parameters.values())[1:]  # type: ignore[misc]
    if any(p.kind in (Parameter.VAR_POSITIONAL, Parameter.VAR_KEYWORD) for p in every):
        return []
    names = [p.name for p in every]
    plain = [p.name for p in every if p.kind is Parameter.POSITIONAL_OR_KEYWORD]
    taken = plain[: len(values)]
    required = [p.name for p in every if p.default is Parameter.empty]
    told = [
        f"unknown argument {n!r}; valid: {known(names, meant=n, most=len(names))}"
        for n in named
        if n not in names
    ]
    told += [f"{n!r} is stated twice, with and without its name" for n in taken if n in named]
    if len(values) > len(plain):
        told.append(
            f"has {len(values)} arguments without names, and takes {len(plain)}: "
            f"{', '.join(plain)}; state the others by name"
        )
    if missing := [n for n in required if n not in taken and n not in named]:
        others = [n for n in names if n not in required]
        told.append(
            f"lacks {', '.join(missing)}; required: "
            f"{', '.join(required)}{'; optional: ' + ', '.join(others) if others else ''}"
        )
    shown = ", ".join(_shown(v) for v in values[:2]) + ", …" * (len(values) > 2)
    return [Problem(what, f"{of.__name__}({shown})") for what in told]


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= MAX_SHOWN_CHARACTERS else text[: MAX_SHOWN_CHARACTERS - 1] + "…"
