"""The log of events of a site, which browsers follow by server-sent events.

Every reader takes the events from the database at its own pace, so that a slow one costs no memory
and one that comes back goes on where it was (``Last-Event-ID``). Readers that wait for the same
events share one reading and one text of them.
"""

from __future__ import annotations

import asyncio
import json
import time as clock
from collections import OrderedDict
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from .database import Database

PAGE = 200
"""Events that a reader takes at once."""
MAX_PAGES = 4
"""Number of pages that are in memory for several readers."""
PIECE_BYTES = 1 << 15
"""Size of what is handed to a connection at once, unless one event is longer, bytes."""
HEARTBEAT_SECONDS = 10.0
"""Time without events after which a beat shows that the connection lives, seconds."""


class Event(NamedTuple):
    """One event."""

    id: int
    """Number in the log."""
    network: int | None
    """Id of the network; None: of the site."""
    at: float
    """When it was recorded, seconds UTC."""
    kind: str
    """Kind, such as ``arrival``."""
    data: dict[str, Any]
    """Its content."""

    def shown(self, names: Mapping[int, str]) -> dict[str, Any]:
        """Return what a reader gets.

        Args:
            names: names of networks by id.
        """
        return {"network": names.get(self.network or 0), "at": self.at} | self.data


class EventPage(NamedTuple):
    """Events that readers take at once, as server-sent events."""

    first: int
    """Number of the first event; 0: there is none."""
    last: int
    """Number of the last event."""
    pieces: tuple[bytes, ...]
    """Their text."""

    @classmethod
    def of(cls, rows: Sequence[Any], names: Mapping[int, str]) -> EventPage:
        """Write events, whose data stay the text that the database has.

        Args:
            rows: rows of the table of events.
            names: names of networks by id.
        """
        pieces: list[bytes] = []
        waiting: list[str] = []
        size = 0
        for row in rows:
            about = json.dumps({"network": names.get(row.network or 0), "at": row.at})
            data = about if row.data == "{}" else f"{about[:-1]}, {row.data[1:]}"
            waiting.append(f"id: {row.id}\nevent: {row.kind}\ndata: {data}\n\n")
            size += len(data)
            if size > PIECE_BYTES:
                pieces.append("".join(waiting).encode())
                waiting, size = [], 0
        if waiting:
            pieces.append("".join(waiting).encode())
        return cls(rows[0].id if rows else 0, rows[-1].id if rows else 0, tuple(pieces))


class EventRow(NamedTuple):
    """An event that is in no database."""

    id: int
    network: int | None
    at: float
    kind: str
    data: str


class EventLog:
    """The events of a site, and those who wait for them."""

    def __init__(self, database: Database) -> None:
        """Take the database."""
        self._database = database
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiting: set[asyncio.Event] = set()
        self._pages: OrderedDict[tuple[Any, ...], asyncio.Task[EventPage]] = OrderedDict()

    def changed(self) -> None:
        """Tell all readers that there are new events; any thread may call this."""
        loop = self._loop
        if loop is not None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
        self._pages.clear()
        for waiting in self._waiting:
            waiting.set()

    def bounds(self) -> tuple[int, int]:
        """Return the first and the last number in the log; zeros where it is empty."""
        from sqlalchemy import func, select

        from .tables import events

        # Each by itself is one look at the index; both in one aggregate would read all rows.
        first_id = select(func.min(events.c.id)).scalar_subquery()
        wanted = select(first_id, select(func.max(events.c.id)).scalar_subquery())
        with self._database.reading() as connection:
            first, last = connection.execute(wanted).one()
        return int(first or 0), int(last or 0)

    def after(self, number: int, networks: Sequence[int] | None = None) -> list[Event]:
        """Return the next events after a number, at most `PAGE`.

        Args:
            number: number of the last event that is known.
            networks: ids of networks; events of the site itself come too. None: all.
        """
        rows = self._rows_after(number, networks)
        return [Event(r.id, r.network, r.at, r.kind, json.loads(r.data)) for r in rows]

    def _rows_after(self, number: int, networks: Sequence[int] | None) -> Sequence[Any]:
        from sqlalchemy import or_, select

        from .tables import events

        wanted = select(events).where(events.c.id > number).order_by(events.c.id).limit(PAGE)
        if networks is not None:
            wanted = wanted.where(or_(events.c.network.is_(None), events.c.network.in_(networks)))
        with self._database.reading() as connection:
            return connection.execute(wanted).all()

    async def _page(
        self, number: int, networks: tuple[int, ...] | None, names: Mapping[int, str]
    ) -> EventPage:
        """Return the next events after a number, which are read once for all who ask for them."""
        key = number, networks
        page = self._pages.get(key)
        if page is None or (page.done() and page.exception() is not None):

            def read() -> EventPage:
                return EventPage.of(self._rows_after(number, networks), names)

            page = self._pages[key] = asyncio.create_task(asyncio.to_thread(read))
            while len(self._pages) > MAX_PAGES:
                self._pages.popitem(last=False)
        return await asyncio.shield(page)  # a reader that leaves does not take it from the others

    def latest(self, network: int, most: int) -> list[Event]:
        """Return the latest events of a network, the oldest first.

        Args:
            network: id of the network.
            most: number of events.
        """
        from sqlalchemy import select

        from .tables import events

        wanted = select(events).where(events.c.network == network).order_by(events.c.id.desc())
        with self._database.reading() as connection:
            rows = connection.execute(wanted.limit(most)).all()
        return [Event(r.id, r.network, r.at, r.kind, json.loads(r.data)) for r in rows[::-1]]

    def record(self, kind: str, data: dict[str, Any], *, at: float, network: int | None) -> None:
        """Record an event that belongs to no transaction of a network."""
        from sqlalchemy import insert

        from .tables import events

        row = {"network": network, "at": at, "kind": kind, "data": json.dumps(data)}
        with self._database.writing() as connection:
            connection.execute(insert(events).values(**row))
        self.changed()

    async def follow(
        self,
        last: int | None,
        networks: Sequence[int] | None = None,
        *,
        names: Mapping[int, str],
    ) -> AsyncIterator[bytes]:
        """Yield server-sent events as they come, and a ``beat`` where none do.

        Args:
            last: number of the last event that the reader has; None: it begins with the next one.
                Where later ones are not in the log any more, at the begin or because it has read
                too slowly, an event ``hello`` comes, after which the reader must read everything
                again.
            networks: as in `after`.
            names: names of networks by id.
        """
        wanted = None if networks is None else tuple(networks)
        loop = asyncio.get_running_loop()
        if loop is not self._loop:
            self._loop = loop
            self._pages.clear()
        waiting = asyncio.Event()
        self._waiting.add(waiting)

        def hello(lost: bool) -> EventPage:
            row = EventRow(newest, None, 0.0, "hello", json.dumps({"lost": lost}))
            return EventPage.of([row], names)

        try:
            oldest, newest = await asyncio.to_thread(self.bounds)
            known = newest if last is None else last
            lost = last is not None and (last > newest or last + 1 < oldest)
            if last is None or lost:
                known = newest
                yield hello(lost).pieces[0]
            while True:
                waiting.clear()
                page = await self._page(known, wanted, names)
                # What a slow reader has not read yet may leave meanwhile.
                if page.first > known + 1:
                    oldest, newest = await asyncio.to_thread(self.bounds)
                    if oldest > known + 1:
                        known = newest
                        yield hello(True).pieces[0]
                        continue
                for piece in page.pieces:
                    yield piece
                if page.pieces:
                    known = page.last
                    continue
                try:
                    await asyncio.wait_for(waiting.wait(), HEARTBEAT_SECONDS)
                except TimeoutError:
                    self._pages.clear()  # another process may have recorded events
                    yield f"event: beat\ndata: {json.dumps({'at': clock.time()})}\n\n".encode()
        finally:
            self._waiting.discard(waiting)
