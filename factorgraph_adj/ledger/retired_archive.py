"""Where retired unknowns are kept: a database of the process, on the disk, beside the memory.

It has the last estimate and covariance of every retired unknown, by name, and what was observed of
them, as a line of the journal that takes them in again. It goes when the adjustment goes: the
journal has the same, and fills another archive when it is resumed.


"""

from __future__ import annotations

import json
import sqlite3
import zlib
from collections.abc import Collection, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from ..graph.dependence import Variable
from ..models.variables import VariableKind
from ..types import Array

TABLES = """
CREATE TABLE retirement (number INTEGER PRIMARY KEY, moment TEXT, line BLOB);
CREATE TABLE unknown (kind TEXT, name TEXT, number INTEGER, value BLOB, covariance BLOB,
    PRIMARY KEY (kind, name)) WITHOUT ROWID;
CREATE TABLE observation (id TEXT PRIMARY KEY, number INTEGER) WITHOUT ROWID;
CREATE INDEX of_unknowns ON unknown (number);
CREATE INDEX of_observations ON observation (number);
"""


class LastEstimate(NamedTuple):
    """What was known of an unknown when it was retired."""

    kind: VariableKind
    """Its kind."""
    name: str
    """Its name."""
    moment: str
    """When it was retired, in words."""
    value: Array | None
    """Its value as in a state; none: it was not determined."""
    covariance: Array | None
    """Covariance of its components, σ0 = 1; none: it was not determined."""


class Archive:
    """The retired unknowns and observations of one adjustment."""

    def __init__(self) -> None:
        """Begin an empty archive."""
        # A name that is empty is that of a file which goes with the connection.
        self._database = sqlite3.connect("", check_same_thread=False, isolation_level=None)
        self._database.executescript(TABLES)

    @property
    def size(self) -> int:
        """Size of the database, bytes."""
        pages, size = (
            self._database.execute(f"PRAGMA {what}").fetchone()[0]
            for what in ("page_count", "page_size")
        )
        return int(pages * size)

    def put(
        self,
        number: int,
        moment: str,
        unknowns: Iterable[LastEstimate],
        ids: Collection[str],
        line: Mapping[str, Any],
    ) -> None:
        """Keep what is retired; what had a number from this one on is forgotten.

        Args:
            number: number of the retirement.
            moment: when it is, in words.
            unknowns: the unknowns.
            ids: ids of their observations, image points apart.
            line: what takes all of it in again.
        """
        run = self._database.execute
        run("BEGIN")
        try:
            for table in ("retirement", "unknown", "observation"):
                run(f"DELETE FROM {table} WHERE number >= ?", (number,))
            packed = zlib.compress(json.dumps(line).encode(), 1)
            run("INSERT INTO retirement VALUES (?, ?, ?)", (number, moment, packed))
            self._database.executemany(
                "INSERT INTO unknown VALUES (?, ?, ?, ?, ?)",
                (
                    (u.kind, u.name, number, _packed(u.value), _packed(u.covariance))
                    for u in unknowns
                ),
            )
            self._database.executemany(
                "INSERT INTO observation VALUES (?, ?)", ((i, number) for i in ids)
            )
        except BaseException:
            run("ROLLBACK")
            raise
        run("COMMIT")

    def find(self, variable: Variable, upto: int) -> LastEstimate | None:
        """Return what was known of an unknown; none where it was not retired.

        Args:
            variable: the unknown.
            upto: number of the last retirement that counts.
        """
        row = self._database.execute(
            "SELECT moment, value, covariance FROM unknown JOIN retirement USING (number) "
            "WHERE kind = ? AND name = ? AND number <= ?",
            (*variable, upto),
        ).fetchone()
        if row is None:
            return None
        value, covariance = (None if x is None else np.frombuffer(x) for x in row[1:])
        if covariance is not None:
            covariance = covariance.reshape(2 * (round(len(covariance) ** 0.5),))
        return LastEstimate(*variable, row[0], value, covariance)

    def moment_of(self, ident: str, upto: int) -> str:
        """Return when an observation that is no image point was retired; empty where it was not."""
        row = self._database.execute(
            "SELECT moment FROM observation JOIN retirement USING (number) "
            "WHERE id = ? AND number <= ?",
            (ident, upto),
        ).fetchone()
        return "" if row is None else str(row[0])

    def lines(self, upto: int) -> Iterator[dict[str, Any]]:
        """Iterate over what takes everything in again, the last retirement first.

        What was retired may name what remained then, and was retired later.
        """
        for (line,) in self._database.execute(
            "SELECT line FROM retirement WHERE number <= ? ORDER BY number DESC", (upto,)
        ):
            yield json.loads(zlib.decompress(line))

    def determined(self, upto: int) -> Iterator[tuple[Variable, Array]]:
        """Iterate over the retired unknowns that were determined, with their last values."""
        for kind, name, value in self._database.execute(
            "SELECT kind, name, value FROM unknown WHERE number <= ? AND value NOT NULL", (upto,)
        ):
            yield (kind, name), np.frombuffer(value)


def _packed(x: Array | None) -> bytes | None:
    return None if x is None else np.ascontiguousarray(x, dtype=float).tobytes()
