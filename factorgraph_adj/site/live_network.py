"""A network that lives: epochs as incremental adjustments, one writer, postings in transactions.

A posting is an object of the stream protocol (`factorgraph_adj.service.stream`) with two further
fields: ``time``, when it was measured (seconds since 1970 UTC; where it is absent, now on the clock
of the machine, or on that of the network where it is played), and ``request``, a text of the
sender: the same request is executed once, and answered again with what was answered, marked
``repeated``.

One thread executes the postings of a network in the order in which they came. All that are there at
once share one transaction, which holds the lines of the journal, the requests with their answers,
and the events; after it, and only then, the senders get their answers. Readings among them that
follow each other are one arrival of their epoch: each is tested against everything that is there,
the others too. Where the transaction fails, the state in memory is dropped and read again from the
database.

A posting belongs to the epoch of its time; an epoch ends when the clock of the network says so. A
posting for an epoch that has ended opens it again; its result then has the next revision.
"""

from __future__ import annotations

import queue
import threading
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Any

from ..errors import AdjustmentError, InputError
from ..io.project import Project
from ..service.answers import Answer, refusal
from .alarm_tables import SiteAlarm
from .database import Database, DatabaseAway
from .decisions import accepted_by_people, decision_record, labels_of
from .epoch_results import epoch_result
from .epoch_revision import revise_some
from .epoch_search import SEARCHER, search_again
from .epoch_survey import surveyed
from .live_epochs import LiveEpoch, LiveEpochs
from .measured_sets import refuse_measured_twice, sets_of_epoch
from .monitor_states import read_state
from .network_clock import NetworkClock
from .network_rows import network_row, record_begin
from .posting_transactions import Batch, Task
from .postings import QUERIES, Posting, known_answers, named_ids, passed_over, recorded_requests
from .result_columns import write_result
from .site_file import NetworkSettings
from .surveillance import Surveillance

if TYPE_CHECKING:
    from sqlalchemy import Connection

MAX_BATCH = 250
"""Largest number of postings in one transaction."""
MAX_WAITING_POSTINGS = 5000
"""Number of postings that may wait for a network; further ones are told to come later."""
IDLE_SECONDS = 0.5
"""Time after which the network looks whether its epoch has ended, seconds."""
YIELD_SECONDS = 0.02
"""Time between two steps of a revision, in which those who read get the lock, seconds."""


class Overloaded(AdjustmentError):
    """Too many postings wait."""


class LiveNetwork:
    """A network of a site while it is served."""

    def __init__(
        self,
        settings: NetworkSettings,
        project: Project,
        database: Database,
        *,
        changed: Callable[[], None] = lambda: None,
        alarms: Sequence[SiteAlarm] = (),
    ) -> None:
        """Read the network from the database, or begin it there.

        Args:
            settings: what the site file says of it.
            project: its project.
            database: the database.
            changed: called after each transaction with events.
            alarms: the alarms of the site.
        """
        self.settings, self.project, self._database = settings, project, database
        self._changed = changed
        self._lock = threading.RLock()
        self._tasks: queue.Queue[Task | None] = queue.Queue()
        self._stale: dict[int, float] = {}
        self._lines = 0
        self.last_arrival: float | None = None
        """When the last posting was recorded, seconds UTC; None: none since the service began."""
        self.away = ""
        """Why the database could not be written last; empty where it could."""
        self.id, self.begun = network_row(database, settings.name)
        self.surveillance = Surveillance(settings, alarms, partial(read_state, database, self.id))
        self.clock = NetworkClock.recorded(settings, database, self.id)
        """Clock by which epochs end."""
        self._epochs = LiveEpochs(settings, project, database, self.id)
        self._thread = threading.Thread(target=self._run, name=f"network {settings.name}")
        self._thread.daemon = True
        with self._lock:
            self._begin()
            _ = self._epochs.present  # a journal that cannot be read is told now

    # -- use ------------------------------------------------------------------------------------

    def start(self) -> None:
        """Begin to execute postings."""
        self._thread.start()

    def stop(self) -> None:
        """Execute what waits, and end."""
        if self._thread.is_alive():
            self._tasks.put(None)
            self._thread.join()

    def submit(self, record: Mapping[str, Any], who: str = "") -> Future[Answer]:
        """Hand over a posting; its answer comes when it is on the disk.

        Raises:
            Overloaded: too many postings wait.
        """
        task = Task(dict(record), who, clock.time(), Future())
        return self._submit(task)

    def close_epoch(
        self, who: str = "", request: str | None = None, number: int | None = None
    ) -> Future[Answer]:
        """End the present epoch; the answer has its result.

        Args:
            who: who ends it.
            request: request, with which it is done once, however often it is asked.
            number: its number, where another epoch that has begun meanwhile is not meant.
        """
        return self.submit({"do": "close epoch", "request": request, "epoch": number}, who)

    def present_sets(self) -> tuple[int, dict[str, int]]:
        """Return the number of the present epoch, and how many sets each instrument has there."""
        with self.reading() as epoch:
            return epoch.number, sets_of_epoch(self._database, self.id, epoch.number)

    def drop_readings(self, before: float) -> list[int]:
        """Take out the readings of closed epochs that ended before a time; return their numbers.

        Args:
            before: seconds UTC.

        Raises:
            DatabaseAway: the database cannot be written; nothing has changed then.
        """
        kept = self.settings.reference, self.surveillance.against
        with self._lock:
            if self.surveillance.revise_from is not None:  # the reference may become another one
                return []
            return self._epochs.drop_readings(before, kept)

    def close_stale(self) -> None:
        """Compute now what got late readings, without waiting for more of them."""
        with self._lock:
            self._execute([], ends=True)
            while self.surveillance.revise_from is not None:
                self._execute([], ends=True)

    def _submit(self, task: Task) -> Future[Answer]:
        if self._tasks.qsize() >= MAX_WAITING_POSTINGS:
            raise Overloaded(
                f"{MAX_WAITING_POSTINGS} postings of {self.settings.name} wait: send it later"
            )
        self._tasks.put(task)
        return task.future

    @property
    def waiting_postings(self) -> int:
        """Number of postings that wait for the thread."""
        return self._tasks.qsize()

    @contextmanager
    def reading(self, number: int | None = None) -> Iterator[LiveEpoch]:
        """Give an epoch, which does not change meanwhile.

        Args:
            number: its number; None: the present one.

        Raises:
            InputError: there is no such epoch.
        """
        with self._lock:
            yield self._epochs.present if number is None else self._epochs.epoch(number)

    @property
    def has_solution(self) -> bool:
        """Whether the present epoch determines anything."""
        with self._lock:
            return len(self._epochs.present.stream.adjustment) > 0

    def epochs(self, **wanted: Any) -> list[dict[str, Any]]:
        """Return the rows of epochs as the database has them, see `LiveEpochs.read_rows`."""
        return self._epochs.read_rows(**wanted)

    # -- begin ------------------------------------------------------------------------------------

    def _begin(self) -> None:
        """Begin the first epoch where there is none."""
        if self._epochs.rows():
            return
        network = self.project.network
        measured = bool(network.observations) or network.n_image_points > 0
        timed = self.settings.epochs.length is not None
        self._epochs.new(0 if measured or timed else 1, (clock.time(), None))
        if timed:
            epoch, batch = self._epochs.epoch(0), Batch()
            self._close(epoch, batch)
            self._commit(batch)

    # -- the thread -------------------------------------------------------------------------------

    def _run(self) -> None:
        """Execute tasks until the network stops."""
        while True:
            tasks: list[Task] = []
            ends = False
            try:
                waits = self.surveillance.revise_from is not None
                first = self._tasks.get(timeout=YIELD_SECONDS if waits else IDLE_SECONDS)
                ends = first is None
                tasks += [] if first is None else [first]
                while not ends and len(tasks) < MAX_BATCH:
                    task = self._tasks.get_nowait()
                    ends = task is None
                    tasks += [] if task is None else [task]
            except queue.Empty:
                pass
            try:
                with self._lock:
                    self._execute(tasks, ends=ends)
            except BaseException as error:  # the thread must live, whatever happens
                with self._lock:  # lines of what was not acknowledged must not be written
                    self.surveillance.drop()
                    self._epochs.drop()
                for task in tasks:
                    if not task.future.done():
                        task.future.set_exception(error)
            if ends:
                return

    def _execute(self, tasks: Sequence[Task], *, ends: bool) -> None:
        """Answer tasks, close what has ended, and write it all in one transaction."""
        batch = Batch()
        # Who has given up waiting was not acknowledged anything: it is not executed.
        tasks = [t for t in tasks if t.future.set_running_or_notify_cancel()]
        try:
            if self.away:
                self.surveillance.resume()
            self._answer_all(tasks, batch)
            self._close_what_ended(batch, idle=not tasks, ends=ends)
            if self.surveillance.revise_from is not None and not batch.results:
                revise_some(self.surveillance, self.id, self._rows_after, batch)
            self._commit(batch)
        except DatabaseAway as error:
            self.away = str(error)
            self.surveillance.drop()
            self._epochs.drop()  # what is in memory may be more than what is on the disk
            for task in tasks:
                task.future.set_exception(error)
            return
        for task, answer in batch.answered:
            task.future.set_result(answer)
        if batch.events:
            arrived = any(kind == "arrival" for kind, _ in batch.events)
            self.last_arrival = clock.time() if arrived else self.last_arrival
            self._changed()

    def _answer_all(self, tasks: Sequence[Task], batch: Batch) -> None:
        """Answer postings in order; readings of one epoch in a row arrive together."""
        lot: dict[str | int, Posting] = {}
        for task in tasks:
            last = next(reversed(lot.values()), None)
            if self.clock.is_played and last and last.task.states_time and not task.states_time:
                self._answer_lot(lot, batch)  # the clock goes by what came before
            try:
                posting = Posting.of(task, self.clock.reference(task.received))
            except AdjustmentError as error:
                self._answer_lot(lot, batch)
                self._lines += 1
                batch.answered.append((task, refusal(self._lines, error)))
                continue
            if lot and not (posting.joins(lot) and self._are_of_one_epoch(lot, posting)):
                self._answer_lot(lot, batch)
            lot[posting.key] = posting
        self._answer_lot(lot, batch)

    def _are_of_one_epoch(self, lot: Mapping[str | int, Posting], other: Posting) -> bool:
        schedule, first = self.settings.epochs, next(iter(lot.values()))
        if schedule.length is None:
            return True
        begun = self.begun or first.time
        return schedule.number(first.time, begun) == schedule.number(other.time, begun)

    def _answer_lot(self, together: dict[str | int, Posting], batch: Batch) -> None:
        """Answer and take out postings that arrive together: readings, or one of any kind."""
        lot = [*together.values()]
        together.clear()
        first = self._lines + 1
        self._lines += len(lot)
        recorded = self._recorded(lot, batch)
        answers = known_answers(lot, recorded, first, partial(self._refuse_unmeasured, batch))
        new = [posting for posting in lot if id(posting) not in answers]
        for posting in (p for p in lot if id(p) in answers):
            if not (answer := answers[id(posting)])["ok"] and "conflict" not in answer:
                self._note(posting, self._epochs.present, answer, batch)
        try:
            told = self._told(new, first, batch) if new else []
        except DatabaseAway:
            raise
        except AdjustmentError as error:
            told = [refusal(line, error) for line in range(first, first + len(new))]
        answers |= {id(posting): answer for posting, answer in zip(new, told, strict=True)}
        batch.answered += [(posting.task, answers[id(posting)]) for posting in lot]

    def _told(self, lot: list[Posting], line: int, batch: Batch) -> list[Answer]:
        """Execute postings that arrive together, the first one on a line, and note what follows."""
        task, do, time = lot[0].task, lot[0].do, max(posting.time for posting in lot)
        if do == "close epoch":
            epoch = self._epochs.present
            if epoch.state != "open" or lot[0].epoch not in (None, epoch.number):
                raise InputError(f"epoch {lot[0].epoch or epoch.number} is closed already")
            result = self._close(epoch, batch)
            batch.actions.append(task.action(do, decision_record({}, *self._named(epoch))))
            closed = {"line": line, "ok": True, **epoch.summary(), "result": result}
            if lot[0].request:
                batch.requests.append(lot[0].request_row(self.id, closed))
            return [closed]
        there = {row["number"] for row in self._epochs.rows()}
        epoch = self._epoch_of(lot[0], time)
        at = None if self.settings.keep_seconds is None else epoch.arrival_time(time)
        if lot[0].is_reading:
            records = [posting.record for posting in lot]
            told = epoch.stream.answer_together(records, line, time=at)
        else:
            record = lot[0].record
            labels = {} if do in QUERIES else labels_of(epoch.stream.adjustment, record)
            told = [epoch.stream.answer_record(record, line, time=at)]
            if told[0]["ok"] and do != "add" and do not in QUERIES:
                decided = decision_record(task.record, *self._named(epoch), labels)
                batch.actions.append(task.action(do, decided))
        told = [answer | {"epoch": epoch.number} for answer in told]
        for posting, answer in zip(lot, told, strict=True):
            self._note(posting, epoch, answer, batch)
        batch.events += passed_over(there, epoch.number, lot[0], told)
        if epoch.number not in there and not any(answer["ok"] for answer in told):
            self._epochs.forget(epoch)  # nothing has come for it
        return told

    def _refuse_unmeasured(self, batch: Batch, posting: Posting) -> None:
        """Refuse what was not measured yet, and a set that its instrument cannot have measured."""
        self.clock.refuse_ahead(posting.latest, posting.task.received, posting.label)
        if posting.measured is not None:
            refuse_measured_twice(self._database, self.id, posting.measured, batch.sets)

    def _note(self, posting: Posting, epoch: LiveEpoch, answer: Answer, batch: Batch) -> None:
        """Note what follows from an answer: a request, events, a result that lacks the reading."""
        task, do, time = posting.task, posting.do, posting.time
        about = {"epoch": epoch.number, "time": time, "by": task.who}
        if not answer["ok"]:
            if do == "add":
                batch.events.append(("refused", about | {"answer": answer}))
        elif do not in QUERIES:
            if epoch.state != "open":
                self._stale[epoch.number] = clock.monotonic()
                self._reopen(epoch, batch)
            if posting.request:
                batch.requests.append(posting.request_row(self.id, answer))
            if posting.measured is not None:
                batch.sets.append(posting.measured.row(self.id, epoch.number))
            if do == "add":
                self.clock.posted(time)
            named = named_ids(task.record)
            batch.events.append(("arrival", about | {"do": do} | named | answer))

    def _recorded(self, lot: Sequence[Posting], batch: Batch) -> dict[str, dict[str, Any]]:
        """Return the rows of requests of postings that were executed already, by request."""
        asked = {posting.request for posting in lot if posting.request}
        here = {r["request"]: r for r in batch.requests if r["request"] in asked}
        return recorded_requests(self._database, self.id, asked - here.keys()) | here

    def _named(self, epoch: LiveEpoch) -> tuple[str, int]:
        return self.settings.name, epoch.number

    def _epoch_of(self, posting: Posting, time: float) -> LiveEpoch:
        """Return the epoch that a posting names, the present one, or that of a time."""
        if posting.epoch is not None:
            return self._epochs.epoch(posting.epoch)
        return self._epochs.present if posting.is_of_present else self._epoch_at(time)

    def _epoch_at(self, time: float) -> LiveEpoch:
        """Return the epoch of a time, which begins where there is none."""
        schedule = self.settings.epochs
        if schedule.length is None:
            present = self._epochs.present
            if present.state == "open":
                return present
            return self._epochs.new(present.number + 1, (time, None))
        self.begun = self.begun or record_begin(self._database, self.id, time)
        number = schedule.number_of_reading(time, self.begun)
        if number in {row["number"] for row in self._epochs.rows()}:
            return self._epochs.epoch(number)
        return self._epochs.new(number, schedule.bounds(number, self.begun))

    # -- end of epochs ----------------------------------------------------------------------------

    def _close_what_ended(self, batch: Batch, *, idle: bool, ends: bool) -> None:
        """Close epochs whose time has passed, and compute again what got late readings."""
        schedule, now = self.settings.epochs, self.clock.now()
        if schedule.length is not None:
            for row in self._epochs.rows():
                if row["state"] == "open" and row["end"] and now > row["end"] + schedule.grace:
                    self._close(self._epochs.epoch(row["number"]), batch)
        waited = IDLE_SECONDS if idle else 10.0 * IDLE_SECONDS
        waited = 0.0 if ends else waited
        for row in self._epochs.rows():
            since = self._stale.get(row["number"], 0.0)  # 0: another process took late readings
            if row["state"] == "reopened" and clock.monotonic() - since >= waited:
                self._close(self._epochs.epoch(row["number"]), batch)

    def _reopen(self, epoch: LiveEpoch, batch: Batch) -> None:
        """Record that the result of an epoch lacks late readings, in the transaction of these."""
        from sqlalchemy import update

        from .tables import epochs

        def reopened(connection: Connection) -> None:
            state = update(epochs).where(epochs.c.id == epoch.id).values(state="reopened")
            connection.execute(state)

        if epoch.state == "closed":
            self._epochs.turned(epoch, "reopened")
            batch.steps.append(reopened)
            told = {"epoch": epoch.number, "what": "reopened", **epoch.summary()}
            batch.events.append(("epoch", told))

    def _close(self, epoch: LiveEpoch, batch: Batch) -> dict[str, Any]:
        """Settle an epoch and record its result."""
        inc = epoch.stream.adjustment
        if len(inc):
            inc.settle()
            self._search_again(epoch, batch)
        epoch.revision += 1
        self._epochs.turned(epoch, "closed")
        self._stale.pop(epoch.number, None)
        result = epoch_result(epoch.stream, epoch.number, epoch.time)
        result["findings"] = surveyed(
            *(self.surveillance, self.id, lambda: self._epochs.read_rows(results=True)),
            *(epoch, result, batch),
            ended=sum(row["state"] != "open" for row in self._epochs.rows()),
        )
        batch.results[epoch.number] = result
        batch.steps.append(lambda c: write_result(c, epoch.id, result, revision=epoch.revision))
        what = "closed" if epoch.revision == 1 else "result"
        batch.events.append(("epoch", {"epoch": epoch.number, "what": what, **epoch.summary()}))
        return {k: v for k, v in result.items() if k != "estimate"}

    def _search_again(self, epoch: LiveEpoch, batch: Batch) -> None:
        """Search a settled epoch for gross errors, where correct readings may be out."""
        about = {"epoch": epoch.number, "time": self.clock.now(), "by": SEARCHER}
        of = self._database, *self._named(epoch)
        decided = partial(accepted_by_people, *of, more=batch.actions)
        for record, answer in search_again(epoch.stream, decided):
            if not answer["ok"]:
                batch.events.append(("refused", about | {"answer": answer}))
                continue
            told = {"do": record["do"]} | named_ids(record) | answer
            batch.events.append(("arrival", about | told))
            task = Task(record, SEARCHER, clock.time(), Future())
            record = decision_record(record, *self._named(epoch))
            batch.actions.append(task.action(record["do"], record))

    def _rows_after(self, number: int, most: int) -> list[dict[str, Any]]:
        """Return rows of epochs after a number that have results, at most so many."""
        return self._epochs.read_rows(results=True, after=number, most=most)

    # -- transactions -----------------------------------------------------------------------------

    def _commit(self, batch: Batch) -> None:
        """Write lines, requests and events in one transaction."""
        lines = self._epochs.pending_lines()
        if lines or batch.has_changes:
            with self._database.writing() as connection:
                batch.write(connection, self.id, lines)
        self.away = ""
