"""The clock of a network of a site: by it epochs end whose time has passed."""

from __future__ import annotations

import json
import time

from .database import Database

MAX_READ = 200
"""Number of the last arrivals from which a service that begins again reads the clock."""


class NetworkClock:
    """The time of the latest posting plus the time that has passed since that came.

    Epochs of a simulation that runs fast, or of instruments whose clocks differ from that of this
    machine, then end as epochs of a real day do. Without a posting it is the clock of the machine.
    """

    def __init__(self, latest: float = 0.0, came: float = 0.0) -> None:
        """Take the latest posting.

        Args:
            latest: its time, seconds UTC; 0: there was none.
            came: when it came, seconds UTC of this machine.
        """
        self.latest = latest
        """Time of the latest posting, seconds UTC; 0: there was none."""
        self._came = time.monotonic() - max(time.time() - came, 0.0)

    @classmethod
    def recorded(cls, database: Database, network: int) -> NetworkClock:
        """Return the clock as the arrivals in a database say.

        Args:
            database: the database.
            network: id of the network.
        """
        from sqlalchemy import select

        from .tables import events

        wanted = select(events.c.at, events.c.data).order_by(events.c.id.desc())
        wanted = wanted.where(events.c.network == network, events.c.kind == "arrival")
        with database.reading() as connection:
            rows = connection.execute(wanted.limit(MAX_READ)).all()
        told = [(json.loads(r.data), r.at) for r in rows]
        # Decisions have the time of this machine; some readings may be late ones.
        came = ((float(data["time"]), at) for data, at in told if data.get("do", "add") == "add")
        return cls(*max(came, default=()))

    def posted(self, at: float) -> None:
        """Note that a posting of a time has come, seconds UTC."""
        if at > self.latest:
            self.latest, self._came = at, time.monotonic()

    def now(self) -> float:
        """Return the time, seconds UTC."""
        return self.latest + time.monotonic() - self._came if self.latest else time.time()
