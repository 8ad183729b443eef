"""A site while it is served: its networks, its database, its log of events, who may do what."""

from __future__ import annotations

import json
import time as clock
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

from ..errors import InputError, Problem, known
from ..io.project import Project
from ..io.readers import READERS
from ..version import __version__
from .access import Access
from .alarm_log import AlarmLog, Raised, reconcile
from .alarm_notices import AlarmNotices
from .alarm_tables import SilenceRule
from .database import Database, DatabaseAway
from .event_log import EventLog
from .live_network import LiveNetwork
from .retention import Retention
from .site_file import SiteSettings
from .site_instruments import SiteInstruments
from .unknown_points import unknown_points


class NoSuchThing(InputError):
    """The address names a network, an epoch or a point that does not exist."""


class Site:
    """The networks of a site, ready to take postings."""

    def __init__(self, settings: SiteSettings, *, allow_outside: bool = False) -> None:
        """Open the database, and read or begin all networks.

        Args:
            settings: what the site file says.
            allow_outside: whether projects may name files outside their folders.

        Raises:
            InputError: a project or the database cannot be opened.
        """
        self.settings = settings
        instruments, alarms = settings.instruments, settings.alarms
        self._silence = [a for a in alarms if isinstance(a.rule, SilenceRule)]
        self._silent: set[tuple[str, str]] | None = None
        self._instrument_networks = {i.name: i.network for i in instruments}
        projects: list[Project] = [
            READERS.load(str(n.project), allow_outside=allow_outside, options={})
            for n in settings.networks
        ]
        self.database = Database(settings.database)
        try:
            self.events = EventLog(self.database)
            self.access = Access(self.database)
            self.networks: dict[str, LiveNetwork] = {
                n.name: LiveNetwork(
                    n, project, self.database, changed=self.events.changed, alarms=alarms
                )
                for n, project in zip(settings.networks, projects, strict=True)
            }
            self.retention = Retention(settings.retention, self.database, self.networks.values())
            names = {live.id: name for name, live in self.networks.items()}
            self.alarms = AlarmLog(self.database, names)
            folder = settings.path.parent
            self.notices = AlarmNotices(
                *(self.database, settings.name, settings.mail_server),
                folder=folder,
                told=self._tell_problem,
            )
            self.instruments = SiteInstruments(
                list(instruments), self.networks, self._tell_health, self._watch_silence
            )
        except BaseException:
            self.database.close()
            raise

    def unknown_points(self) -> list[Problem]:
        """Return names and patterns of the site file that match nothing that is there."""
        points: dict[str, list[str]] = {}
        for name, network in self.networks.items():
            with network.reading() as epoch:
                points[name] = list(epoch.stream.adjustment.entities.points)
        return unknown_points(self.settings, points)

    def start(self) -> None:
        """Begin to take postings."""
        for problem in self.unknown_points():
            self._tell_problem(str(problem))
        for network in self.networks.values():
            network.start()
        self.instruments.start()
        self.notices.start()
        self.retention.start()

    def stop(self) -> None:
        """Execute what waits, and close the database."""
        self.instruments.stop()
        self.notices.stop()
        self.retention.stop()
        for network in self.networks.values():
            network.stop()
        self.database.close()

    def _tell_problem(self, what: str) -> None:
        """Record a problem of the site."""
        with suppress(DatabaseAway):
            self.events.record("problem", {"what": what}, at=clock.time(), network=None)

    def _watch_silence(self, silence: dict[str, float]) -> None:
        """Raise and clear alarms about instruments that are silent.

        Args:
            silence: for how many seconds each instrument has sent nothing.
        """
        standing = []
        for alarm in self._silence:
            assert isinstance(alarm.rule, SilenceRule)
            for name, seconds in silence.items():
                of_network = alarm.network in ("", self._instrument_networks[name])
                if of_network and alarm.rule.covers(name) and seconds > alarm.rule.after:
                    said = f"{name} has sent nothing for more than {alarm.rule.after:g} s"
                    data = {"test": "silence", "limit": alarm.rule.after, "unit": "s", "text": said}
                    standing.append(Raised(alarm.rule.name, name, data, alarm.notify))
        now = {(s.rule, s.subject) for s in standing}
        if now == self._silent:
            return
        rules = [a.rule.name for a in self._silence]
        try:
            with self.database.writing() as connection:
                changes = reconcile(connection, None, None, rules, standing, clock.time())
            for alarm_shown in changes.events:
                self.events.record("alarm", {"alarm": alarm_shown}, at=clock.time(), network=None)
        except DatabaseAway:
            return  # it is compared again in a second
        self._silent = now

    def _tell_health(self, network: str, health: dict[str, Any]) -> None:
        """Record that the health of an instrument has changed."""
        with suppress(DatabaseAway):  # it is told with the next change
            self.events.record(
                "instrument",
                {"instrument": health},
                at=clock.time(),
                network=self.network(network).id,
            )

    def record_action(self, who: str, action: str, data: dict[str, Any]) -> None:
        """Record who did what."""
        from sqlalchemy import insert

        from .tables import actions

        row = {"at": clock.time(), "who": who, "action": action, "data": json.dumps(data)}
        with self.database.writing() as connection:
            connection.execute(insert(actions).values(**row))

    def network(self, name: str) -> LiveNetwork:
        """Return a network.

        Raises:
            NoSuchThing: there is none of this name.
        """
        if name not in self.networks:
            raise NoSuchThing(f"no network {name!r}; known: {known(self.networks, meant=name)}")
        return self.networks[name]

    def ids(self, names: Iterable[str]) -> list[int]:
        """Return ids of networks."""
        return [self.network(name).id for name in names]

    def summary(self) -> dict[str, Any]:
        """Return name and version."""
        return {"name": self.settings.name, "version": __version__}

    def health(self) -> dict[str, Any]:
        """Return whether everything runs, and how many postings wait."""
        away = {n: x.away for n, x in self.networks.items() if x.away}
        waiting = {n: x.waiting_postings for n, x in self.networks.items()}
        return {"ok": not away, "database": away, "waiting_postings": waiting}
