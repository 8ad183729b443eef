"""Tables of the HTML report: columns of text with what they mean, and how they go into the page."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

Head: TypeAlias = tuple[str, bool] | tuple[str, bool, str]
"""Title of a column, whether it is numeric, and where needed its help."""
PAGE = 25
"""Number of rows that a table shows at a time, and has in a page whose script does not run."""
LONG, MOST_LOOKED_AT = 30, 1000
"""Number of letters from which a text is long, and number of cells that are looked at."""
NONE = "–"
"""What stands for a figure that there is not."""


@dataclass(frozen=True)
class Column:
    """One column of a table."""

    title: str
    """Its heading, with the unit in brackets."""
    values: Sequence[str]
    """Its cells."""
    numeric: bool = False
    """Whether it is sorted as numbers and set flush right."""
    help: str = ""
    """What the heading means, in a sentence; empty where it says so itself."""
    english: bool = False
    """Whether its cells are words of the adjustment itself, English in every language."""

    @property
    def look(self) -> str:
        """Class of its cells in the style sheet: ``number``, ``long`` for long texts, or none."""
        if self.numeric:
            return "number"
        return "long" if any(len(v) > LONG for v in self.values[:MOST_LOOKED_AT]) else ""


@dataclass(frozen=True)
class Sheet:
    """One table of the report."""

    id: str
    """Name of the table in the page."""
    caption: str
    """What the rows are."""
    columns: Sequence[Column]
    """The columns, all of the same length."""
    notes: Sequence[str] = field(default_factory=tuple)
    """Sentences below the table."""
    order: str = ""
    """How the rows are ordered at first, for the caption; empty: as in the network."""

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.columns[0].values) if self.columns else 0

    @property
    def first(self) -> Iterator[tuple[str, ...]]:
        """Rows that stand in the page before its script has run."""
        return zip(*(c.values[:PAGE] for c in self.columns), strict=True)

    @property
    def data(self) -> dict[str, Any]:
        """What the script of the page needs."""
        return {
            "looks": [c.look for c in self.columns],
            "english": [c.english for c in self.columns],
            "columns": [list(c.values) for c in self.columns],
        }


def sheet(
    ident: str,
    caption: str,
    columns: Iterable[Column],
    *,
    notes: Sequence[str] = (),
    order: str = "",
) -> Sheet | None:
    """Return a table without the columns that no row fills; None for a table without rows."""
    kept = [c for c in columns if any(v not in ("", NONE) for v in c.values)]
    if not kept:
        return None
    return Sheet(ident, caption, kept, tuple(n for n in notes if n), order)


def columns_of(
    heads: Sequence[Head], rows: Sequence[Sequence[str]], *, english: Collection[str] = ()
) -> list[Column]:
    """Return columns from rows of cells.

    Args:
        heads: title, whether the column is numeric, and its help, of each column.
        rows: the cells, row by row.
        english: titles of the columns whose cells are words of the adjustment itself.
    """
    cells = list(zip(*rows, strict=True)) if rows else [()] * len(heads)
    return [
        Column(head[0], values, head[1], head[2] if len(head) == 3 else "", head[0] in english)
        for head, values in zip(heads, cells, strict=True)
    ]
