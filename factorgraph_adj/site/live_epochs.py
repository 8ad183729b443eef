"""Epochs of a network in its database and in memory: begun, read from their journals, closed."""

from __future__ import annotations

import json
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import InputError, known
from ..incremental.adjustment import IncrementalAdjustment
from ..io.project import Project
from ..service.stream import Stream
from .database import Database, at_one_moment
from .epoch_network import network_of_epoch
from .journal_table import JournalTable
from .result_columns import read_results
from .site_file import NetworkSettings

MAX_LOADED = 3
"""Number of epochs that are in memory: the present one, and closed ones that were opened again."""
MAX_SHOWN = 6
"""Number of epochs that a message lists."""
DROPPED = "dropped"
"""State of a closed epoch whose readings are kept no longer."""


def no_epoch(network: str, number: int, numbers: Iterable[int]) -> str:
    """Return that a network has no epoch of a number, and which are its latest."""
    return f"network {network} has no epoch {number}; its latest: {known([*numbers][-MAX_SHOWN:])}"


@dataclass
class LiveEpoch:
    """One epoch of a network in memory."""

    id: int
    """Id of its row."""
    number: int
    """Its number."""
    begin: float
    """Begin, seconds UTC."""
    end: float | None
    """End, seconds UTC; None: by hand."""
    state: str
    """``open``, ``closed``, or ``reopened``: closed, with late readings that its result lacks."""
    revision: int
    """Number of the results so far."""
    stream: Stream
    """The adjustment with its protocol."""
    journal: JournalTable
    """Its journal."""

    @property
    def time(self) -> float:
        """Its time, seconds UTC: its middle, and its begin where it ends by hand or by sets."""
        return self.begin if self.end is None else 0.5 * (self.begin + self.end)

    def summary(self) -> dict[str, Any]:
        """Return the fields that an API shows."""
        names = ("number", "begin", "end", "state", "revision")
        return {name: getattr(self, name) for name in names}

    def arrival_time(self, time: float) -> float:
        """Return the time of an arrival with readings of a time, for the retirement window.

        The window never goes back: readings that come late count as those that came last.

        Args:
            time: when the readings were measured, seconds UTC.
        """
        latest = self.stream.adjustment.latest_time
        return time if latest is None else max(time, latest)


class LiveEpochs:
    """The epochs of one network."""

    def __init__(
        self,
        settings: NetworkSettings,
        project: Project,
        database: Database,
        network: int,
    ) -> None:
        """Take a network.

        Args:
            settings: what the site file says of it.
            project: its project.
            database: the database.
            network: id of its row.
        """
        self.settings, self.project, self._database = settings, project, database
        self._network = network
        self._loaded: OrderedDict[int, LiveEpoch] = OrderedDict()
        self._rows: list[dict[str, Any]] | None = None

    def rows(self) -> list[dict[str, Any]]:
        """Return the rows of the epochs in order, without their results."""
        if self._rows is None:
            self._rows = self.read_rows()
        return self._rows

    def read_rows(
        self,
        *,
        results: bool = False,
        summaries: bool = False,
        number: int | None = None,
        after: int | None = None,
        most: int | None = None,
    ) -> list[dict[str, Any]]:
        """Return the rows as the database has them.

        Args:
            results: whether with ``result``, the last one of each epoch.
            summaries: whether with ``summary``, what lists show of it.
            number: only that of the epoch of this number.
            after: only those of epochs after this number that have a result.
            most: only so many of them, the first ones.
        """
        from sqlalchemy import select

        from .tables import epochs

        names = ["id", "number", "begin", "end", "state", "revision"]
        names += [*(["summary"] * (summaries or results)), *(["result"] * results)]
        columns = [epochs.c[name] for name in names]
        wanted = select(*columns).where(epochs.c.network == self._network)
        wanted = wanted.order_by(epochs.c.number)
        if number is not None:
            wanted = wanted.where(epochs.c.number == number)
        if after is not None:
            wanted = wanted.where(epochs.c.number > after, epochs.c.result.is_not(None))
        wanted = wanted if most is None else wanted.limit(most)
        with self._database.reading() as connection:
            at_one_moment(connection)
            found = [dict(r._mapping) for r in connection.execute(wanted)]
            if results:
                ids = wanted.with_only_columns(epochs.c.id)
                for row, result in zip(found, read_results(connection, found, ids), strict=True):
                    row["result"] = result
                    del row["summary"]
        for row in found if summaries else ():
            row["summary"] = None if row["summary"] is None else json.loads(row["summary"])
        return found

    @property
    def present(self) -> LiveEpoch:
        """The last open epoch, or where there is none, the last one."""
        rows = self.rows()
        open_ = [row["number"] for row in rows if row["state"] == "open"]
        return self.epoch((open_ or [row["number"] for row in rows])[-1])

    def epoch(self, number: int) -> LiveEpoch:
        """Return an epoch, from its journal where it is not in memory."""
        if number in self._loaded:
            self._loaded.move_to_end(number)
            return self._loaded[number]
        rows = {row["number"]: row for row in self.rows()}
        if number not in rows:
            raise InputError(no_epoch(self.settings.name, number, rows))
        row = rows[number]
        if row["state"] == DROPPED:
            raise InputError(
                f"the readings of epoch {number} were dropped, as [retention] says: its result "
                "stays, and it takes no late readings"
            )
        journal = self._journal_of(row["id"], number)
        if self._begun(row["id"]):
            adjustment = IncrementalAdjustment.resume(
                journal, geoids=self._geoids(), allow_outside=True
            )
        else:  # the process ended between the row and the first line
            adjustment = self._begun_adjustment(number, journal)
        return self._keep(row, adjustment, journal)

    def _keep(
        self, row: Mapping[str, Any], adjustment: IncrementalAdjustment, journal: JournalTable
    ) -> LiveEpoch:
        stream = Stream(adjustment, context=self.project.context, power=self.settings.power)
        names = ("id", "number", "begin", "end", "state", "revision")
        epoch = LiveEpoch(**{n: row[n] for n in names}, stream=stream, journal=journal)
        self._loaded[epoch.number] = epoch
        written = [n for n, e in self._loaded.items() if e is not epoch and not e.journal.waits]
        for oldest in written[: max(len(self._loaded) - MAX_LOADED, 0)]:
            del self._loaded[oldest]
        return epoch

    def _journal_of(self, key: int, number: int) -> JournalTable:
        path = self.project.path
        folder = path if path.is_dir() else path.parent
        where = f"{self.settings.name}, epoch {number}"
        return JournalTable(self._database, key, folder=folder, where=where)

    def _geoids(self) -> list[str]:
        crs = self.project.network.crs
        return [crs.geoid] if crs is not None and isinstance(crs.geoid, str) else []

    def _begun(self, key: int) -> bool:
        from sqlalchemy import func, select

        from .tables import journal

        wanted = select(func.count()).select_from(journal).where(journal.c.epoch == key)
        with self._database.reading() as connection:
            return bool(connection.execute(wanted).scalar())

    def _begun_adjustment(self, number: int, journal: JournalTable) -> IncrementalAdjustment:
        """Return the adjustment of an epoch at its begin, whose first line is on the disk."""
        network = self.project.network
        if number > 0:
            before = [row["number"] for row in self.rows() if row["number"] < number]
            last = self.epoch(before[-1]).stream.adjustment if before else None
            network = network_of_epoch(network, last)
        keep = self.settings.keep_seconds
        adjustment = IncrementalAdjustment(
            network,
            policy=self.settings.policy,
            alpha=self.settings.alpha,
            keep_seconds=keep,
            journal=journal,
        )
        self._write_lines(journal.pending())
        return adjustment

    def _write_lines(self, rows: list[dict[str, Any]]) -> None:
        from sqlalchemy import insert

        from .tables import journal

        with self._database.writing() as connection:
            connection.execute(insert(journal), rows)

    def new(self, number: int, bounds: tuple[float, float | None]) -> LiveEpoch:
        """Begin an epoch.

        Args:
            number: its number.
            bounds: its begin and end, seconds UTC; no end: it ends by hand.
        """
        from sqlalchemy import insert

        from .tables import epochs

        row: dict[str, Any] = {"network": self._network, "number": number}
        row |= {"begin": bounds[0], "end": bounds[1]}
        row |= {"state": "open", "revision": 0}
        # The rows in memory have states that are not written yet: they are not read again.
        rows = self.rows()
        with self._database.writing() as connection:
            made = connection.execute(insert(epochs).values(**row))
            (key,) = made.inserted_primary_key or (0,)
        self._rows = sorted([*rows, {"id": int(key), **row}], key=lambda r: r["number"])
        journal = self._journal_of(int(key), number)
        adjustment = self._begun_adjustment(number, journal)
        return self._keep({"id": int(key), **row}, adjustment, journal)

    def forget(self, epoch: LiveEpoch) -> None:
        """Take out an epoch that has no reading: the one that began it was refused."""
        from sqlalchemy import delete

        from .tables import epochs, journal

        with self._database.writing() as connection:
            connection.execute(delete(journal).where(journal.c.epoch == epoch.id))
            connection.execute(delete(epochs).where(epochs.c.id == epoch.id))
        self._loaded.pop(epoch.number, None)
        self._rows = [row for row in self.rows() if row["number"] != epoch.number]

    # -- writing ----------------------------------------------------------------------------------

    def pending_lines(self) -> list[dict[str, Any]]:
        """Return the lines of all journals that are to be written, and forget them."""
        return [row for epoch in self._loaded.values() for row in epoch.journal.pending()]

    def turned(self, epoch: LiveEpoch, state: str) -> None:
        """Note the state of an epoch, and the number of its results."""
        epoch.state = state
        for row in self.rows():
            if row["number"] == epoch.number:
                row |= {"state": epoch.state, "revision": epoch.revision}

    def drop_readings(self, before: float, kept: Collection[int | None]) -> list[int]:
        """Take out the readings of closed epochs, each in a transaction; return their numbers.

        Args:
            before: those that ended before this time, seconds UTC.
            kept: numbers of epochs that keep their readings; the last two keep them too.
        """
        from sqlalchemy import delete, update

        from .tables import epochs, journal

        rows = self.rows()
        last = {row["number"] for row in rows[-2:]}
        out = []
        for row in rows:
            number, end = row["number"], row["end"]
            if row["state"] != "closed" or number in last or number in kept:
                continue
            if (row["begin"] if end is None else end) >= before:
                continue
            with self._database.writing() as connection:
                connection.execute(delete(journal).where(journal.c.epoch == row["id"]))
                change = update(epochs).where(epochs.c.id == row["id"])
                connection.execute(change.values(state=DROPPED))
            self._loaded.pop(number, None)
            row["state"] = DROPPED
            out.append(number)
        return out

    def drop(self) -> None:
        """Forget what is in memory; it is read again from the database."""
        self._loaded.clear()
        self._rows = None
