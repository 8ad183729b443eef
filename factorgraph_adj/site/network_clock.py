"""The clock of a network of a site: by it epochs end; readings that are ahead of it are refused.

A reading of a time that is still to come (a wrong clock, a wrong time zone or daylight saving time,
a typing error, a wrong week of a receiver) would end the present epoch and begin one that stays
empty. It is refused where it is later than the reference by more than ``max_ahead`` of the network.
The reference is the clock of this machine; where the site file says that the network is played
(``clock = "readings"``), it is the time of the latest posting plus the time since it came. A
posting that states no time has that of the reference.
"""

from __future__ import annotations

import json
import time

from ..errors import InputError, Problem
from ..instruments.message_rules import iso
from .database import Database
from .site_file import NetworkSettings

MAX_READ = 200
"""Number of the last arrivals from which a service that begins again reads the clock."""


class NetworkClock:
    """The time of the latest posting plus the time that has passed since that came.

    Epochs of a simulation that runs fast, or of instruments whose clocks differ from that of this
    machine, then end as epochs of a real day do. Without a posting it is the clock of the machine.
    """

    def __init__(self, settings: NetworkSettings, latest: float = 0.0, came: float = 0.0) -> None:
        """Take the latest posting.

        Args:
            settings: what the site file says of the network.
            latest: its time, seconds UTC; 0: there was none.
            came: when it came, seconds UTC of this machine.
        """
        self._settings, self.latest = settings, latest
        """Time of the latest posting, seconds UTC; 0: there was none."""
        self._came = time.monotonic() - max(time.time() - came, 0.0)

    @classmethod
    def recorded(cls, settings: NetworkSettings, database: Database, network: int) -> NetworkClock:
        """Return the clock as the arrivals in a database say.

        Args:
            settings: what the site file says of the network.
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
        # Decisions are no readings, and some readings may be late ones.
        came = ((float(data["time"]), at) for data, at in told if data.get("do", "add") == "add")
        return cls(settings, *max(came, default=()))

    def posted(self, at: float) -> None:
        """Note that a posting of a time has come, seconds UTC."""
        if at > self.latest:
            self.latest, self._came = at, time.monotonic()

    def now(self) -> float:
        """Return the time, seconds UTC."""
        return self.latest + time.monotonic() - self._came if self.latest else time.time()

    @property
    def is_played(self) -> bool:
        """Whether the site file says that the time of the network is that of its readings."""
        return self._settings.clock == "readings"

    def reference(self, received: float) -> float:
        """Return the time of what came now: that of a posting that states none, seconds UTC.

        Args:
            received: when it was received, seconds UTC of this machine.
        """
        return self.now() if self.is_played else received

    def refuse_ahead(self, at: float, received: float, what: str = "") -> None:
        """Refuse a time that is still to come.

        Args:
            at: the time, seconds UTC.
            received: when it was received, seconds UTC of this machine.
            what: what was measured then, for the message.

        Raises:
            InputError: it is later than the reference by more than ``max_ahead``.
        """
        reference = self.reference(received)
        ahead, most = at - reference, self._settings.max_ahead
        if ahead <= most:
            return
        of = "the latest reading of the network" if self.is_played else "the clock of this machine"
        raise InputError(
            Problem(
                f"{what}{': ' * bool(what)}its time {iso(at)} is {_length(ahead)} ahead of {of}. "
                f"Valid: until {iso(reference + most)} (max_ahead, {_length(most)}). A clock or a "
                "time zone is wrong, there or here",
                "time",
            )
        )


def _length(seconds: float) -> str:
    """Return a length of time in words: ``1 h 3 min``."""
    minutes = round(seconds / 60.0)
    for unit, of, part, of_part in (("d", 1440, "h", 60), ("h", 60, "min", 1)):
        if minutes >= of:
            whole, rest = divmod(round(minutes / of_part), of // of_part)
            return f"{whole} {unit}" + (f" {rest} {part}" if rest else "")
    return f"{seconds / 60.0:.2g} min"
