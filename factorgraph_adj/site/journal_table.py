"""Journal of an epoch in the database: the lines of a journal file, written with what they answer.

Lines are collected, and written by the transaction that also records the request, its answer and
the events (`factorgraph_adj.site.live_network`): nothing is acknowledged before that has ended.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem
from ..io.journal_lines import (
    INITIAL_LINK,
    JOURNAL_VERSION,
    ChainLink,
    journal_line,
    whole_lines,
)
from .database import Database


class JournalTable:
    """The journal of one epoch, a `factorgraph_adj.io.journal_lines.JournalStore`."""

    def __init__(self, database: Database, epoch: int, *, folder: Path, where: str) -> None:
        """Take an epoch whose row is in the database.

        Args:
            database: the database.
            epoch: id of the row of the epoch.
            folder: folder of the project, in which its geoid lies.
            where: name of network and epoch, for messages.
        """
        self._database, self._epoch = database, epoch
        self._folder, self._where = folder, where
        self._last: ChainLink = INITIAL_LINK
        self._pending: list[dict[str, Any]] = []

    @property
    def where(self) -> str:
        """Name of network and epoch."""
        return self._where

    @property
    def folder(self) -> Path:
        """Folder of the project."""
        return self._folder

    def begin(self, header: Mapping[str, object]) -> None:
        """Record the first line."""
        if self._last != INITIAL_LINK:
            raise InputError(Problem("the journal has begun already", self._where))
        self._take({"journal": JOURNAL_VERSION, **header})

    def read(self) -> tuple[dict[str, Any], list[dict[str, Any]], str]:
        """Return the header and the entries; nothing is ever torn.

        Raises:
            DatabaseAway: the database cannot be read.
            InputError: lines are missing or were changed.
        """
        from sqlalchemy import select

        from .tables import journal

        wanted = select(journal.c.text).where(journal.c.epoch == self._epoch)
        with self._database.reading() as connection:
            lines = connection.execute(wanted.order_by(journal.c.line)).scalars().all()
        data = "".join(f"{line}\n" for line in lines).encode("utf-8")
        found, torn, _, self._last = whole_lines(data, self._where)
        if torn:
            raise InputError(Problem("the last line was changed: it is no JSON", self._where))
        return found[0], found[1:], ""

    def append(self, entry: Mapping[str, object]) -> None:
        """Collect an entry for the next transaction."""
        self._take(entry)

    def close(self) -> None:
        """Do nothing: the database stays open."""

    def _take(self, entry: Mapping[str, object]) -> None:
        line, self._last = journal_line(entry, self._where, self._last)
        text = line[:-1].decode("utf-8")
        self._pending.append({"epoch": self._epoch, "line": self._last.number, "text": text})

    @property
    def waits(self) -> bool:
        """Whether lines are to be written."""
        return bool(self._pending)

    def pending(self) -> list[dict[str, Any]]:
        """Return the rows that are to be written, and forget them."""
        out, self._pending = self._pending, []
        return out
