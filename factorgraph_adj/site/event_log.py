"""The log of events of a site, which browsers follow by server-sent events.

Every reader takes the events from the database at its own pace, so that a slow one costs no memory
and one that comes back goes on where it was (``Last-Event-ID``).
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Mapping, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

from .database import Database

PAGE = 200
"""Events that a reader takes at once."""
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


class EventLog:
    """The events of a site, and those who wait for them."""

    def __init__(self, database: Database) -> None:
        """Take the database."""
        self._database = database
        self._loop: asyncio.AbstractEventLoop | None = None
        self._waiting: set[asyncio.Event] = set()

    def changed(self) -> None:
        """Tell all readers that there are new events; any thread may call this."""
        loop = self._loop
        if loop is not None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._wake)

    def _wake(self) -> None:
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
        from sqlalchemy import or_, select

        from .tables import events

        wanted = select(events).where(events.c.id > number).order_by(events.c.id).limit(PAGE)
        if networks is not None:
            wanted = wanted.where(or_(events.c.network.is_(None), events.c.network.in_(networks)))
        with self._database.reading() as connection:
            rows = connection.execute(wanted).all()
        return [Event(r.id, r.network, r.at, r.kind, json.loads(r.data)) for r in rows]

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
        self, last: int | None, networks: Sequence[int] | None = None
    ) -> AsyncIterator[Event | None]:
        """Yield events as they come; None is a beat.

        Args:
            last: number of the last event that the reader has; None: it begins with the next one.
                Where later ones are not in the log any more, at the begin or because it has read
                too slowly, an event ``hello`` comes, after which the reader must read everything
                again.
            networks: as in `after`.
        """
        self._loop = asyncio.get_running_loop()
        waiting = asyncio.Event()
        self._waiting.add(waiting)
        try:
            oldest, newest = await asyncio.to_thread(self.bounds)
            known = newest if last is None else last
            lost = last is not None and (last > newest or last + 1 < oldest)
            if last is None or lost:
                known = newest
                yield Event(newest, None, 0.0, "hello", {"lost": lost})
            while True:
                waiting.clear()
                found = await asyncio.to_thread(self.after, known, networks)
                # What a slow reader has not read yet may leave meanwhile.
                if found and found[0].id > known + 1:
                    oldest, newest = await asyncio.to_thread(self.bounds)
                    if oldest > known + 1:
                        known = newest
                        yield Event(newest, None, 0.0, "hello", {"lost": True})
                        continue
                for event in found:
                    known = event.id
                    yield event
                if found:
                    continue
                try:
                    await asyncio.wait_for(waiting.wait(), HEARTBEAT_SECONDS)
                except TimeoutError:
                    yield None
        finally:
            self._waiting.discard(waiting)
