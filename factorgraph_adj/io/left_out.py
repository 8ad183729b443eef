"""Rows of files that readers leave out: gathered by the reason, then counted and named."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from ..errors import LeftOut


@dataclass(frozen=True)
class Reason:
    """Why rows of a sort are left out."""

    what: str
    """The rows, in words."""
    why: str
    """Why they are left out."""
    doubtful: bool = False
    """Whether they were expected to be used: marks of known points."""


ROWS_SWITCHED_OFF = Reason("points and observations", "they are switched off in the file")
DERIVED = Reason("reduced observations", "they are derived: raw readings alone are read")


@dataclass
class RowsLeftOut:
    """The rows that a reader has left out so far."""

    rows: dict[Reason, list[tuple[str, str]]] = field(default_factory=dict)
    """Name and place of each row, by the reason."""

    def add(self, why: Reason, name: str, where: str = "") -> None:
        """Note a row.

        Args:
            why: why it is left out.
            name: name of its photo, of its points, or of itself.
            where: file and line.
        """
        self.rows.setdefault(why, []).append((name, where))

    def told(self) -> dict[Reason, LeftOut]:
        """Return a record for each reason: number of rows, their names, place of the first."""
        return {
            why: LeftOut(
                why.what,
                why.why,
                tuple(dict.fromkeys(name for name, _ in rows)),
                len(rows),
                where=next((where for _, where in rows if where), ""),
                doubtful=why.doubtful,
            )
            for why, rows in self.rows.items()
        }


def all_left_out(parts: Iterable[RowsLeftOut]) -> list[LeftOut]:
    """Return the records of several files together."""
    whole = RowsLeftOut()
    for part in parts:
        for why, rows in part.rows.items():
            whole.rows.setdefault(why, []).extend(rows)
    return list(whole.told().values())
