"""Parameters written as TOML: tables in tables, lists of tables for what there are several of."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from ..io.write_toml import value_text
from .parameters import Parameters

BARE = re.compile(r"[A-Za-z0-9_-]+")
"""Keys that need no quotes."""


def to_toml(value: Any) -> str:
    """Return a dataclass of parameters as TOML, defaults too: what is written stays as it is.

    TOML has no word for what is not set; such keys are comments, so that they are seen.
    """
    return "\n".join(_table(value, "")).strip() + "\n"


def _table(value: Any, path: str) -> Iterator[str]:
    """Yield the keys of a dataclass or a mapping, those without a table of their own first."""
    if isinstance(value, Mapping):
        items = list(value.items())
    else:
        items = [(f.name, getattr(value, f.name)) for f in fields(value)]
        if isinstance(value, Parameters) and value.kind:
            items.insert(0, ("kind", value.kind))
    tables = []
    for key, inner in items:
        if _is_table(inner) or (isinstance(inner, tuple) and any(map(_is_table, inner))):
            tables.append((key, inner))
        elif inner is None:
            yield f"# {_key(key)} = …  (not set)"
        else:
            yield f"{_key(key)} = {value_text(inner)}"
    for key, inner in tables:
        name = f"{path}.{_key(key)}" if path else _key(key)
        if isinstance(inner, tuple):
            for one in inner:
                yield from ("", f"[[{name}]]", *_table(one, name))
        elif isinstance(inner, Mapping) and not inner:
            yield from ("", f"# [{name}]  (empty)")
        else:
            yield from ("", f"[{name}]", *_table(inner, name))


def _is_table(value: Any) -> bool:
    return isinstance(value, Mapping) or dataclasses.is_dataclass(value)


def _key(name: str) -> str:
    return name if BARE.fullmatch(name) else value_text(name)
