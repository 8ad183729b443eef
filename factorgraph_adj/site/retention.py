"""Takes out what a site keeps no longer, as `factorgraph_adj.site.retention_settings` states it."""

from __future__ import annotations

import json
import time as clock
from collections.abc import Iterable
from threading import Event, Thread
from typing import Any

from .database import Database, DatabaseAway
from .live_network import LiveNetwork
from .retention_settings import RetentionSettings

FIRST_SECONDS, EVERY_SECONDS = 60.0, 600.0
"""Time until the first look, and between two looks, seconds."""
ROWS_AT_ONCE = 1000
"""Rows that one transaction changes, so that writers wait for it only shortly."""
KEPT_OF_ANSWERS = ("line", "ok", "epoch", "id", "verdict", "do")
"""What is kept of an answer that is shortened."""


class Retention:
    """Takes out what is kept no longer, in a thread of its own."""

    def __init__(
        self, settings: RetentionSettings, database: Database, networks: Iterable[LiveNetwork]
    ) -> None:
        """Take the settings.

        Args:
            settings: for how long things are kept.
            database: the database.
            networks: the networks of the site.
        """
        self.settings, self._database, self._networks = settings, database, list(networks)
        self._stop = Event()
        self._thread = Thread(target=self._run, name="retention", daemon=True)

    def start(self) -> None:
        """Begin to look."""
        self._thread.start()

    def stop(self) -> None:
        """End."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join()

    def _run(self) -> None:
        wait = FIRST_SECONDS
        while not self._stop.wait(wait):
            wait = EVERY_SECONDS
            try:
                self.apply(clock.time())
            except DatabaseAway:
                wait = FIRST_SECONDS

    def apply(self, now: float) -> dict[str, int]:
        """Take out what is kept no longer, and return numbers of rows.

        Args:
            now: seconds UTC; epochs are compared with the clock of their network.

        Raises:
            DatabaseAway: the database cannot be written.
        """
        keep, out = self.settings, {"events": 0, "answers": 0, "epochs": 0}
        if keep.events is not None:
            out["events"] = self._drop_events(now - keep.events)
        if keep.answers is not None:
            out["answers"] = self._shorten_answers(now - keep.answers)
        if keep.journals is not None:
            for network in self._networks:
                out["epochs"] += len(network.drop_readings(network.clock.now() - keep.journals))
        return out

    def _drop_events(self, before: float) -> int:
        """Take out events; the last one stays, so that numbers go on."""
        from sqlalchemy import delete, func, select

        from .tables import events

        total = 0
        while not self._stop.is_set():
            with self._database.writing() as connection:
                last = connection.execute(select(func.max(events.c.id))).scalar() or 0
                old = select(events.c.id).where(events.c.at < before, events.c.id < last)
                chosen = connection.execute(old.limit(ROWS_AT_ONCE)).scalars().all()
                if chosen:
                    connection.execute(delete(events).where(events.c.id.in_(chosen)))
            total += len(chosen)
            if len(chosen) < ROWS_AT_ONCE:
                break
        return total

    def _shorten_answers(self, before: float) -> int:
        """Shorten answers to requests."""
        from sqlalchemy import bindparam, func, select, update

        from .tables import requests

        total, longest = 0, 200
        change = update(requests).where(requests.c.id == bindparam("key"))
        while not self._stop.is_set():
            old = select(requests.c.id, requests.c.answer).where(
                requests.c.at < before, func.length(requests.c.answer) > longest
            )
            with self._database.writing() as connection:
                chosen = connection.execute(old.limit(ROWS_AT_ONCE)).all()
                rows = [{"key": r.id, "text": shortened(r.answer, longest)} for r in chosen]
                if rows:
                    connection.execute(change.values(answer=bindparam("text")), rows)
            total += len(rows)
            if len(rows) < ROWS_AT_ONCE:
                break
        return total


def shortened(answer: str, longest: int) -> str:
    """Return what is kept of an answer, at most ``longest`` characters."""
    full: dict[str, Any] = json.loads(answer)
    kept = {k: full[k] for k in KEPT_OF_ANSWERS if k in full} | {"shortened": True}
    text = json.dumps(kept)
    return text if len(text) <= longest else json.dumps({"ok": full["ok"], "shortened": True})
