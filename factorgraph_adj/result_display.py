"""How results show themselves: one line in a terminal, a head line and the first rows in HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from itertools import islice

FIRST = 10
"""Number of rows of a result that HTML shows."""


@dataclass(frozen=True)
class Rows:
    """The rows of a result, of which the first are shown."""

    header: Sequence[str]
    """Names of the columns."""
    cells: Iterable[Sequence[object]]
    """Rows; floats are shown with six digits. Only the first `FIRST` rows are asked for."""
    total: int
    """Number of all rows."""


class Shown:
    """Base of results: ``repr`` is one short line, HTML adds a table of the first rows.

    A result defines `headline` and, where it has rows, `first_rows`. The HTML has no script and no
    style sheet, so that every notebook shows it alike.
    """

    def headline(self) -> str:
        """Return one line that says what the result is and how it ended."""
        raise NotImplementedError

    def first_rows(self) -> Rows | None:
        """Return the rows of the result; none where it has none."""
        return None

    def __repr__(self) -> str:
        """Return the headline in angle brackets."""
        return f"<{self.headline()}>"

    def _repr_html_(self) -> str:
        """Return the headline and a table of the first rows as HTML."""
        rows = self.first_rows()
        return html(self.headline(), rows)


def html(headline: str, rows: Rows | None) -> str:
    """Return a head line and the first rows of a table as HTML, all text escaped."""
    out = [f"<div><p><b>{escape(headline)}</b></p>"]
    if rows is not None and rows.total:
        head = "".join(f"<th>{escape(name)}</th>" for name in rows.header)
        out.append(f"<table><thead><tr>{head}</tr></thead><tbody>")
        for row in islice(rows.cells, FIRST):
            out.append("<tr>" + "".join(f"<td>{escape(_text(c))}</td>" for c in row) + "</tr>")
        out.append("</tbody></table>")
        if rows.total > FIRST:
            out.append(f"<p>the first {FIRST} of {rows.total} rows</p>")
    return "".join([*out, "</div>"])


def _text(cell: object) -> str:
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)
