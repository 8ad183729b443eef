"""Comparison of published and computed tables, as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan

from factorgraph_adj.errors import InputError
from factorgraph_adj.report import layout


@dataclass(frozen=True)
class Compared:
    """One row of published and computed figures, column by column; NaN for missing figures."""

    label: str
    """Name of the row."""
    printed: tuple[float, ...]
    """Published figures."""
    ours: tuple[float, ...]
    """Computed figures."""


@dataclass(frozen=True)
class Comparison:
    """A published table beside a computed one.

    Raises:
        InputError: the number of figures in a row differs from the number of columns.
    """

    title: str
    """Title of the table."""
    columns: tuple[str, ...]
    """Names of the figures, with their units."""
    rows: tuple[Compared, ...]
    """The rows."""
    digits: int = 2
    """Number of digits after the decimal point."""
    note: str = ""
    """Assumptions of the computation, and differences from the publication."""

    def __post_init__(self) -> None:
        """Check the number of figures of every row."""
        for row in self.rows:
            if not len(row.printed) == len(row.ours) == len(self.columns):
                what = f"row {row.label!r} of {self.title!r} has {len(row.printed)} printed and "
                raise InputError(f"{what}{len(row.ours)} own figures; columns: {len(self.columns)}")

    @property
    def has_printed(self) -> bool:
        """Whether any figure was published."""
        return any(f == f for row in self.rows for f in row.printed)

    def __str__(self) -> str:
        """Return plain text with each published figure followed by the computed one."""
        both = self.has_printed
        header = [""]
        for c in self.columns:
            header += [c, "ours"] if both else [c]
        lines = []
        for row in self.rows:
            cells = [row.label]
            for printed, ours in zip(row.printed, row.ours, strict=True):
                cells += [self._cell(printed), self._cell(ours)] if both else [self._cell(ours)]
            lines.append(cells)
        said = ["", *layout.paragraph(self.note)] if self.note else []
        return "\n".join([*layout.title(self.title), *layout.table(header, lines), *said])

    def _cell(self, value: float) -> str:
        # Adding 0.0 avoids −0.00.
        return "–" if value != value else f"{round(value, self.digits) + 0.0:.{self.digits}f}"


def compared(label: str, printed: Sequence[float] | None, ours: Sequence[float]) -> Compared:
    """Return a row; NaN replaces the published figures if ``printed`` is None."""
    own = tuple(float(f) for f in ours)
    return Compared(label, (nan,) * len(own) if printed is None else tuple(printed), own)
