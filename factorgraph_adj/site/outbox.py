"""Outbox of a sender: postings on its disk until the site has acknowledged them, in order.

What is put in is on the disk before `Outbox.put` returns, with a request of its own and, where it
states no time, with when it was put in, so that an outage of a day changes neither when a reading
counts nor how often.
"""

from __future__ import annotations

import json
import sqlite3
import threading
import time as clock
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import InputError, Problem

TABLES = """\
create table if not exists postings
    (id integer primary key autoincrement, network text not null, record text not null);
create table if not exists refused
    (id integer primary key, network text not null, record text not null, answer text not null);
"""
"""Tables of the file."""


class Kept(NamedTuple):
    """One posting of an outbox."""

    id: int
    """Its number; postings are sent in the order of these."""
    network: str
    """Name of its network."""
    record: dict[str, Any]
    """The posting, with ``request`` and, on a disk, ``time`` or ``kept``."""


def requested(record: Mapping[str, Any], *, kept: float | None = None) -> dict[str, Any]:
    """Return a posting with a request of its own where it has none, and with when it was kept.

    Args:
        record: a posting.
        kept: seconds since 1970 UTC, for a posting that states no time; None: it stays without.
    """
    out = dict(record)
    out.setdefault("request", uuid.uuid4().hex)
    if kept is not None and out.get("time") is None:
        out.setdefault("kept", kept)
    return out


IN_MEMORY = ":memory:"
"""Path of an outbox that keeps nothing on a disk."""


class Outbox:
    """Postings in a file of SQLite; threads may share it."""

    def __init__(self, path: str | Path) -> None:
        """Open a file, or make it.

        Args:
            path: the file; `IN_MEMORY`: none.

        Raises:
            InputError: it cannot be opened, or is no outbox.
        """
        self.path = Path(path)
        self.on_disk = str(path) != IN_MEMORY
        """Whether postings survive the process."""
        self._lock, self._came = threading.Lock(), threading.Event()
        try:
            self._file = sqlite3.connect(self.path, check_same_thread=False, isolation_level=None)
            self._file.execute("pragma journal_mode = wal")
            self._file.execute("pragma synchronous = full")
            self._file.executescript(TABLES)
        except sqlite3.Error as error:
            raise InputError(Problem(f"cannot be used as an outbox: {error}", str(path))) from None

    def put(self, network: str, *records: Mapping[str, Any]) -> None:
        """Keep postings, which are on the disk then.

        Args:
            network: name of their network.
            records: postings; what states no ``time`` was measured now, as its ``kept`` says. Where
                nothing is on a disk, it stays without one: it counts when the site receives it.

        Raises:
            InputError: they cannot be written, on a full disk for example; none of them is kept.
        """
        now = clock.time() if self.on_disk else None
        rows = [(network, json.dumps(requested(r, kept=now))) for r in records]
        with self._writing():
            self._file.executemany("insert into postings (network, record) values (?, ?)", rows)
        self._came.set()

    def wait(self, seconds: float) -> None:
        """Return when postings have come since the last call, or after a time; for one thread."""
        if self._came.wait(seconds):
            self._came.clear()

    def wake(self) -> None:
        """Let `wait` return."""
        self._came.set()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Hold a transaction: all of it is on the disk when it ends, or none."""
        try:
            with self._lock, self._file:
                self._file.execute("begin immediate")
                yield
        except sqlite3.Error as error:
            what = f"the outbox cannot be written: {error}"
            raise InputError(Problem(what, str(self.path))) from None

    def oldest(self, most: int) -> list[Kept]:
        """Return the oldest postings, of all networks."""
        wanted = "select id, network, record from postings order by id limit ?"
        with self._lock:
            rows = self._file.execute(wanted, (most,)).fetchall()
        return [Kept(key, network, json.loads(record)) for key, network, record in rows]

    def first(self, most: int) -> list[Kept]:
        """Return the oldest postings, all of one network."""
        kept = self.oldest(most)
        return list(takewhile(lambda k: k.network == kept[0].network, kept))

    def done(self, sent: Sequence[Kept], answers: Sequence[Mapping[str, Any]]) -> None:
        """Take out what was answered; on a disk, ``refused`` keeps what was refused, and why.

        Raises:
            InputError: this cannot be written; all of them stay, and are sent again.
        """
        refused = [
            (k.id, k.network, json.dumps(k.record), json.dumps(a))
            for k, a in zip(sent, answers, strict=True)
            if self.on_disk and not a.get("ok")
        ]
        with self._writing():
            self._file.executemany("insert or replace into refused values (?, ?, ?, ?)", refused)
            self._file.executemany("delete from postings where id = ?", [(k.id,) for k in sent])

    def __len__(self) -> int:
        """Return how many postings wait."""
        with self._lock:
            return int(self._file.execute("select count(*) from postings").fetchone()[0])

    def refused(self) -> list[tuple[Kept, dict[str, Any]]]:
        """Return the postings that the site refused, with its answers."""
        wanted = "select id, network, record, answer from refused order by id"
        with self._lock:
            rows = self._file.execute(wanted).fetchall()
        return [(Kept(i, n, json.loads(r)), json.loads(a)) for i, n, r, a in rows]

    def close(self) -> None:
        """Close the file."""
        self._file.close()
