"""Location of a problem of a network: file and line of the source, and the names concerned."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TypeAlias

from ..errors import Problem, known

Sources: TypeAlias = Mapping[tuple[str, str], str]
"""File and line by noun (point, photo) and name."""


def listed(noun: str, names: Sequence[str], at: Sources) -> str:
    """Return file and line of the first name, and the names."""
    source = at.get((noun, names[0]))
    where = "" if source is None else f"{source}: "
    if len(names) == 1:
        return f"{where}{noun} {names[0]!r}"
    return f"{where}{noun}s {known(map(repr, names))}"


def with_lines(problems: Sequence[Problem], at: Sources) -> list[Problem]:
    """Return problems of single unknowns with the file and line that state them, where known."""
    lines = {f"{noun} {name!r}": source for (noun, name), source in at.items()}
    return [
        replace(p, where=f"{lines[p.where]}: {p.where}") if p.where in lines else p
        for p in problems
    ]
