"""JSON with an indent of one space, as `json.dumps` writes it, for members with many numbers.

`json.dumps` with an indent calls Python for every number; without one it does not. Lists and
objects of numbers and texts alone are therefore written without an indent, with a separator that
has the line break and the indent in it.
"""

from __future__ import annotations

from functools import cache
from json import JSONEncoder, dumps
from math import isfinite
from typing import Any

SIMPLE = frozenset({str, float, int, bool, type(None)})
"""Types that are written without members of their own."""


def json_text(value: Any, level: int = 0) -> str:
    """Return a value as ``json.dumps(value, indent=1, ensure_ascii=False)`` does.

    Args:
        value: objects with texts as keys, lists, tuples, texts, numbers, truth values, None.
        level: number of spaces before the end of the value.
    """
    if not isinstance(value, dict | list | tuple) or not value:
        return dumps(value, ensure_ascii=False)
    members = value.values() if isinstance(value, dict) else value
    inner, end = "\n" + " " * (level + 1), "\n" + " " * level
    if SIMPLE.issuperset(map(type, members)):
        flat = _encoder(level + 1).encode(value)
        return f"{flat[0]}{inner}{flat[1:-1]}{end}{flat[-1]}"
    if isinstance(value, dict):
        parts = (
            f"{dumps(k, ensure_ascii=False)}: {json_text(v, level + 1)}" for k, v in value.items()
        )
        return "{" + inner + f",{inner}".join(parts) + end + "}"
    return "[" + inner + f",{inner}".join(json_text(v, level + 1) for v in value) + end + "]"


@cache
def _encoder(level: int) -> JSONEncoder:
    """Return an encoder whose separator of members is a line break with an indent."""
    return JSONEncoder(ensure_ascii=False, separators=(",\n" + " " * level, ": "))


def finite(value: Any) -> Any:
    """Return a JSON value with null for numbers that are not finite, and 0 for −0."""
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        types = set(map(type, value))
        if types == {float}:
            return [v + 0.0 if isfinite(v) else None for v in value]
        if float not in types and SIMPLE.issuperset(types):
            return list(value)
        return [finite(v) for v in value]
    if isinstance(value, float):
        return value + 0.0 if isfinite(value) else None
    return value
