"""Parameters of a spec: frozen dataclasses with types and ranges, read, checked and varied.

One definition of a field serves three purposes: a table of a TOML file becomes a dataclass, a
dataclass made in Python is checked, and a nested parameter of a spec is changed by its path,
``parts.0.side_overlap``.
"""

from __future__ import annotations

import dataclasses
import math
import types
from collections.abc import Mapping, Sequence
from dataclasses import MISSING, Field, fields, replace
from functools import cache
from numbers import Integral, Real
from typing import Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

from ..errors import Problem, known

T = TypeVar("T")


class Bad:
    """Stand-in for a value that could not be read; further checks skip it."""


BAD = Bad()


@dataclasses.dataclass(frozen=True)
class Parameters:
    """Base of all dataclasses in a spec."""

    kind: ClassVar[str] = ""
    """Value of the key ``kind`` of a table, for places where several classes are possible."""

    def problems(self, where: str) -> list[Problem]:
        """Return the problems of the combination of fields; single fields are checked before."""
        return []


def number(
    default: Any = MISSING,
    *,
    least: float | None = None,
    above: float | None = None,
    most: float | None = None,
    below: float | None = None,
) -> Any:
    """Return a field for one or several numbers within bounds."""
    limits = {"least": least, "above": above, "most": most, "below": below}
    metadata = {k: v for k, v in limits.items() if v is not None}
    return dataclasses.field(default=default, metadata=metadata)


def path_of(where: str, name: str | int) -> str:
    """Return the path of a key: ``parts.0.overlap``, as `Spec.varied` takes it."""
    return f"{where}.{name}" if where else str(name)


def convert(hint: Any, value: Any, where: str, found: list[Problem], of: Field[Any]) -> Any:
    """Return ``value`` converted to the type ``hint`` of a field; add problems to ``found``.

    Args:
        hint: type of the field.
        value: a value of TOML, a dataclass, or the Python equivalent of either.
        where: path of the field.
        found: list to which problems are added.
        of: the field, for its bounds.

    Returns:
        The value; `BAD` if it cannot be used.
    """
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        if value is None:
            return None
        (inner,) = (a for a in arguments if a is not type(None))
        return convert(inner, value, where, found, of)
    if origin is Literal:
        if value not in arguments:
            valid = known(arguments, meant=value, most=40)
            name = next(key for key in reversed(where.split(".")) if not key.isdecimal())
            found.append(Problem(f"unknown {name} {value!r}; valid: {valid}", where))
            return BAD
        return value
    if origin is tuple:
        return _sequence(arguments, value, where, found, of)
    if origin is not None:
        return _mapping(arguments[1], value, where, found, of)
    if dataclasses.is_dataclass(hint):
        return _table(hint, value, where, found)  # type: ignore[arg-type]
    return _scalar(hint, value, where, found, of)


def _sequence(
    arguments: tuple[Any, ...], value: Any, where: str, found: list[Problem], of: Field[Any]
) -> Any:
    if isinstance(value, str) or not isinstance(value, Sequence):
        found.append(Problem(f"must be a list, not {value!r}", where))
        return BAD
    any_length = arguments[-1] is Ellipsis
    if not any_length and len(value) != len(arguments):
        found.append(Problem(f"must have {len(arguments)} values, not {len(value)}", where))
        return BAD
    hints = [arguments[0]] * len(value) if any_length else arguments
    out = tuple(
        convert(h, v, path_of(where, i), found, of)
        for i, (h, v) in enumerate(zip(hints, value, strict=True))
    )
    return BAD if any(v is BAD for v in out) else out


def _mapping(hint: Any, value: Any, where: str, found: list[Problem], of: Field[Any]) -> Any:
    if not isinstance(value, Mapping):
        found.append(Problem(f"must be a table of names and values, not {value!r}", where))
        return BAD
    out = {str(k): convert(hint, v, path_of(where, str(k)), found, of) for k, v in value.items()}
    return BAD if any(v is BAD for v in out.values()) else out


def _scalar(hint: Any, value: Any, where: str, found: list[Problem], of: Field[Any]) -> Any:
    wanted = {float: "a number", int: "a whole number", bool: "true or false", str: "text"}[hint]
    if hint is float and isinstance(value, Real) and not isinstance(value, bool):
        value = float(value)
    elif hint is int and isinstance(value, Integral) and not isinstance(value, bool):
        value = int(value)
    elif not isinstance(value, hint):
        found.append(Problem(f"must be {wanted}, not {value!r}", where))
        return BAD
    if isinstance(value, float) and not math.isfinite(value):
        found.append(Problem(f"must be a finite number, not {value}", where))
        return BAD
    limits = of.metadata
    signs = {"least": "≥", "above": ">", "most": "≤", "below": "<"}
    fits = {
        "least": lambda limit: value >= limit,
        "above": lambda limit: value > limit,
        "most": lambda limit: value <= limit,
        "below": lambda limit: value < limit,
    }
    if not all(fits[k](limits[k]) for k in signs if k in limits):
        valid = " and ".join(f"{signs[k]} {limits[k]:g}" for k in signs if k in limits)
        found.append(Problem(f"is {value:g}, but must be {valid}", where))
        return BAD
    return value


def kinds_of(base: type[Parameters]) -> dict[str, type[Parameters]]:
    """Return the subclasses that may replace ``base``, by kind; empty if only ``base`` exists."""
    found: dict[str, type[Parameters]] = {}
    for cls in base.__subclasses__():
        found |= {cls.kind: cls} if cls.kind else {}
        found |= kinds_of(cls)
    return found


@cache
def _hints(cls: type[Parameters]) -> dict[str, Any]:
    return get_type_hints(cls)


def _table(cls: type[Parameters], value: Any, where: str, found: list[Problem]) -> Any:
    """Return a checked dataclass from a table or another dataclass."""
    if isinstance(value, cls):
        cls = type(value)
        record: dict[str, Any] = {f.name: getattr(value, f.name) for f in fields(value)}
    elif isinstance(value, Mapping):
        record = dict(value)
        kinds = kinds_of(cls)
        if kinds:
            kind = record.pop("kind", None)
            if not isinstance(kind, str) or kind not in kinds:
                what = "has no kind" if kind is None else f"unknown kind {kind!r}"
                what += f"; valid: {known(kinds, meant=kind, most=40)}"
                found.append(Problem(what, path_of(where, "kind")))
                return BAD
            cls = kinds[kind]
    else:
        found.append(Problem(f"must be a table, not {value!r}", where))
        return BAD
    return from_record(cls, record, where, found)


def from_record(
    cls: type[T], record: Mapping[str, Any], where: str, found: list[Problem]
) -> T | Bad:
    """Return a dataclass of parameters from the keys of a table.

    Args:
        cls: the dataclass.
        record: values by key; absent keys have their defaults.
        where: path of the table.
        found: list to which problems are added: unknown keys, wrong types, values out of range,
            and invalid combinations of fields.
    """
    known_fields = {f.name: f for f in fields(cls)}  # type: ignore[arg-type]
    for key in record:
        if key not in known_fields:
            what = f"unknown key; valid: {known(known_fields, meant=key, most=40)}"
            found.append(Problem(what, path_of(where, key)))
    hints = _hints(cls)  # type: ignore[arg-type]
    values: dict[str, Any] = {}
    for name, f in known_fields.items():
        if name in record:
            value = _completed(f, record[name])
            values[name] = convert(hints[name], value, path_of(where, name), found, f)
        elif f.default is MISSING and f.default_factory is MISSING:
            found.append(Problem("is missing", path_of(where, name)))
            values[name] = BAD
    if any(v is BAD for v in values.values()):
        return BAD
    made = cls(**values)
    if isinstance(made, Parameters):
        found += made.problems(where)
    return made


def _completed(f: Field[Any], value: Any) -> Any:
    """Return a table completed by the default of its field.

    For example, if a table states only the principal distance, the rest of the camera is the
    default camera of the part.
    """
    if not isinstance(value, Mapping) or f.default_factory is MISSING:
        return value
    return _merged(f.default_factory(), value)


def _merged(default: Any, table: Mapping[str, Any]) -> Mapping[str, Any]:
    if not isinstance(default, Parameters):
        return table
    record = {f.name: getattr(default, f.name) for f in fields(default)}
    for key, value in table.items():
        inner = isinstance(value, Mapping)
        record[key] = _merged(record.get(key), value) if inner else value
    return record


def changed(value: Any, path: Sequence[str], level: Any, where: str, found: list[Problem]) -> Any:
    """Return ``value`` with the element at ``path`` replaced by ``level``.

    Args:
        value: a dataclass, a tuple or a mapping.
        path: keys and numbers.
        level: the new value.
        where: path from the root to ``value``, for messages.
        found: list to which an unknown key or number is added as a problem.
    """
    if not path:
        return level
    key, rest = path[0], path[1:]
    if isinstance(value, tuple):
        if not key.isdecimal() or int(key) >= len(value):
            valid = f"0 to {len(value) - 1}" if value else "none, it is empty"
            found.append(Problem(f"unknown number {key!r}; valid: {valid}", where))
            return value
        i = int(key)
        new = changed(value[i], rest, level, path_of(where, i), found)
        return (*value[:i], new, *value[i + 1 :])
    if isinstance(value, Mapping):
        return {**value, key: changed(value.get(key), rest, level, path_of(where, key), found)}
    if not dataclasses.is_dataclass(value) or isinstance(value, type):
        if value is None:
            what = f"is not there, so it has no {key!r} to change; give all of it at once, as "
            what += f"{{{where!r}: {{{'.'.join(path)!r}: {level!r}}}}}, or put it into the spec"
        else:
            what = f"is {value!r}, which has no {key!r}"
        found.append(Problem(what, where))
        return value
    names = [f.name for f in fields(value)]
    if key not in names:
        found.append(
            Problem(f"unknown key; valid: {known(names, meant=key, most=40)}", path_of(where, key))
        )
        return value
    new = changed(getattr(value, key), rest, level, path_of(where, key), found)
    return replace(value, **{key: new})
