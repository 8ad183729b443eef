"""Instruments of a site: a thread for each, which posts what its lines come to; their health."""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping
from threading import Event, Lock, Thread
from typing import Any

from ..errors import AdjustmentError, InputError, Problem
from ..instruments.distance_corrections import SensorBoard
from ..instruments.instrument import Instrument
from ..instruments.instrument_settings import InstrumentSettings
from ..instruments.readings import Posting
from .database import DatabaseAway
from .live_network import LiveNetwork, Overloaded

POSTED_SECONDS = 120.0
"""Time after which a posting without an answer is tried again, seconds."""
WATCH_SECONDS = 1.0
"""Time between two looks at the health of the instruments, seconds."""
MIN_EVENT_SECONDS = 5.0
"""Least time between two events about counts alone of one instrument, seconds."""
STATES = {"receiving": "ok", "silent": "silent", "stopped": "stopped"}
"""What a page shows of a connection; any other is ``faulty``: there is none."""


def shown_state(connection: str) -> str:
    """Return what a page shows of the state of a connection."""
    return STATES.get(connection, "faulty")


class SiteInstruments:
    """The instruments of a site while it is served."""

    def __init__(
        self,
        settings: list[InstrumentSettings],
        networks: Mapping[str, LiveNetwork],
        told: Callable[[str, dict[str, Any]], None],
        watched: Callable[[dict[str, float]], None] = lambda silence: None,
    ) -> None:
        """Take the instruments; nothing is read yet.

        Args:
            settings: their tables of the site file.
            networks: the networks of the site by name.
            told: takes the network and the health of an instrument whose state has changed.
            watched: takes, about once a second, for how many seconds each instrument is silent.
        """
        board = SensorBoard()
        self._networks, self._told, self._watched = networks, told, watched
        self._instruments = {
            s.name: Instrument(
                s,
                units=networks[s.network].project.units,
                network=networks[s.network].project.network,
                sensors=board,
                refuse_ahead=networks[s.network].clock.refuse_ahead,
            )
            for s in settings
        }
        self._lock = Lock()
        self._stop = Event()
        self._threads = [
            Thread(target=self._run, args=(i,), name=f"instrument {name}", daemon=True)
            for name, i in self._instruments.items()
        ]
        if self._instruments:
            self._threads.append(Thread(target=self._watch, name="instruments", daemon=True))

    def start(self) -> None:
        """Begin to read."""
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        """End; what is complete is posted first."""
        self._stop.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join(10.0)

    def health(self) -> list[dict[str, Any]]:
        """Return the health of all instruments."""
        return [self._shown(i) for i in self._instruments.values()]

    def _shown(self, instrument: Instrument) -> dict[str, Any]:
        """Return the health of an instrument as the API shows it."""
        settings, found = instrument.settings, instrument.health.snapshot()
        own = {"network": settings.network, "grammar": settings.grammar, "source": settings.source}
        own |= {"connection": found["state"], "state": shown_state(found["state"])}
        own |= {"messages": found["lines"], "clock_offset_s": found["clock_offset"]}
        own["lag_s"] = found["lag"]
        return found | own

    def _run(self, instrument: Instrument) -> None:
        """Read until the end; a fault of the program is told, and the reading begins again."""
        while not self._stop.is_set():
            try:
                instrument.run(lambda posting: self._post(instrument, posting), self._stop)
                return  # the source has ended
            except AdjustmentError as error:  # such as a password that is missing
                instrument.health.trouble(str(error), clock.time())
                self._stop.wait(WATCH_SECONDS)
            except Exception as error:
                what = f"a fault of the program: {type(error).__name__}: {error}"
                instrument.health.trouble(what, clock.time())
                self._stop.wait(WATCH_SECONDS)

    def _post(self, instrument: Instrument, posting: Posting) -> None:
        """Post, and return when it is on the disk.

        Raises:
            InputError: the network refuses it.
            ConnectionError: the database is away, or too much waits: it is tried again.
        """
        record = {**posting.record, "time": posting.time, "request": posting.request}
        if posting.measured is not None:
            record["measured"] = posting.measured
        try:
            found = self._networks[posting.network].submit(record, instrument.settings.name)
            answer = found.result(POSTED_SECONDS)
        except (DatabaseAway, Overloaded) as error:
            raise ConnectionError(str(error)) from None
        if not answer["ok"]:
            raise InputError([Problem(e["what"], e["where"]) for e in answer["error"]])
        if not answer.get("repeated"):  # what was recorded before a restart came in time then
            end = posting.time if posting.measured is None else posting.measured["end"]
            instrument.health.lag = clock.time() - end
        self._end_by_sets(instrument)

    def _end_by_sets(self, instrument: Instrument) -> None:
        """End the epoch of a network whose epochs are counted in sets, when the last one came.

        The sets are counted in the database, so that those from before a restart count too.
        """
        name = instrument.settings.network
        network = self._networks[name]
        wanted = network.settings.epochs.sets
        if wanted is None or instrument.settings.post != "sets":
            return
        with self._lock:
            own = [
                i.settings.name
                for i in self._instruments.values()
                if i.settings.network == name and i.settings.post == "sets"
            ]
            number, counts = network.present_sets()
            if min(counts.get(n, 0) for n in own) >= wanted:
                network.close_epoch(instrument.settings.name, number=number).result(POSTED_SECONDS)

    def _watch(self) -> None:
        """Tell changes of health."""
        begun = clock.time()
        last: dict[str, tuple[Any, ...]] = {}
        when: dict[str, float] = {}
        while not self._stop.wait(WATCH_SECONDS):
            now_utc = clock.time()
            self._watched(
                {
                    name: now_utc - max(i.health.last_message or begun, begun)
                    for name, i in self._instruments.items()
                }
            )
            for name, instrument in self._instruments.items():
                shown = self._shown(instrument)
                state = (shown["connection"], shown["problem"], shown["problem_time"])
                key, now = (*state, shown["lines"], shown["postings"]), clock.monotonic()
                if last.get(name) == key:
                    continue
                if (
                    last.get(name, ())[:3] == state
                    and now - when.get(name, 0.0) < MIN_EVENT_SECONDS
                ):
                    continue
                last[name], when[name] = key, now
                shown.pop("events")
                self._told(instrument.settings.network, shown)
