"""Parts of pages that follow from the records of kinds: lines with a marker become them.

The reference has the class of every kind of observation, and a row for each kind and each table of
unknowns that no page has described by hand.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from factorgraph_adj.io import observation_fields
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.observations import KINDS

CLASSES = ".. classes of kinds of observations"
COLUMNS = "<!-- columns of other kinds of observations -->"
TABLES = "<!-- tables of other kinds of unknowns -->"


def classes_of_kinds() -> str:
    """Return a description of the class of every kind."""
    return "\n".join(
        f".. autoclass:: factorgraph_adj.observations.{kind.observation.__name__}\n"
        "   :members:\n   :show-inheritance:\n"
        for kind in KINDS.values()
    )


def _code(names: Iterable[str]) -> str:
    return " ".join(f"`{name}`" for name in names)


def columns_of_kinds(page: str) -> str:
    """Return rows of the kinds that a page does not name in the first column of a table."""
    out = []
    for name, kind in KINDS.items():
        if kind.in_image_table or re.search(rf"^\|[^|]*`{name}`", page, re.MULTILINE):
            continue
        names = [n for n in observation_fields.name_fields(name) if n in kind.named]
        values = observation_fields.vector_components(name) or ("value",)
        every = observation_fields.plain_fields(name)
        further = [n for n in every if n not in ("kind", "id", "unit", *names, *values)]
        out.append(f"| `{name}` | {_code(names)} | {_code(values)} | {_code(further)} |\n")
    return "".join(out)


def tables_of_unknowns(page: str) -> str:
    """Return rows of the tables of unknowns that a page does not name."""
    out = []
    for kind in UNKNOWNS.values():
        if kind.table is None or f"| `{kind.table.file}.csv` |" in page:
            continue
        columns = [c.column or c.name for c in kind.components]
        last = "`free`" if kind.table.held_unless_free else "`fixed`"
        out.append(
            f"| `{kind.table.file}.csv` | `name` {_code(columns)} with a unit, σ of each, {last}: "
            f"{kind.noun} |\n"
        )
    return "".join(out)


def with_kinds(text: str) -> str:
    """Return a page with what follows from records in the place of its markers."""
    if CLASSES in text:
        text = text.replace(f"{CLASSES}\n", classes_of_kinds())
    if COLUMNS in text:
        text = text.replace(f"{COLUMNS}\n", columns_of_kinds(text))
    if TABLES in text:
        text = text.replace(f"{TABLES}\n", tables_of_unknowns(text))
    return text


def _read(app: Any, name: str, source: list[str]) -> None:
    source[0] = with_kinds(source[0])


def setup(app: Any) -> dict[str, bool]:
    """Fill pages as they are read."""
    app.connect("source-read", _read)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
