"""Writer of parameters as TOML: nested dataclasses are tables, sequences are lists of tables."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

from ..io.write_toml import value_text
from .parameters import Parameters

BARE = re.compile(r"[A-Za-z0-9_-]+")
"""Pattern of keys that need no quotes."""


def to_toml(value: Any) -> str:
    """Return a dataclass of parameters as TOML.

    Defaults are written too, so that the text does not depend on later changes of defaults. TOML
    cannot express None; keys without a value are written as comments.
    """
    return "\n".join(_table(value, "")).strip() + "\n"


def _table(value: Any, path: str) -> Iterator[str]:
    """Yield the lines of a dataclass or a mapping; keys with tables of their own come last."""
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
