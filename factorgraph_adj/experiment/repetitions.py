"""Execution of repetitions with figures or errors: one alone, in processes, or on Dask.

Each process has its own pipe and reports every finished repetition. A process that ends is
replaced; its first unreported repetition is the one that ended it, and all others run normally.
(A `concurrent.futures.ProcessPoolExecutor` breaks as a whole in this case, and does not say which
call was the cause.)
"""

from __future__ import annotations

import contextlib
import multiprocessing
import numbers
import pickle
import signal
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import TYPE_CHECKING, Any

import numpy as np

from ..blas_threads import one_thread_for_children, use_one_thread
from ..errors import InputError, Problem
from .study import RESERVED, Levels, Trial

if TYPE_CHECKING:
    from distributed import Client

DIED = "WorkerDied"
"""Type of error of a repetition whose process ended while it ran."""
REPETITIONS_PER_THREAD = 4
"""Number of repetitions under way for each thread of the cluster, so that no thread waits."""
REPETITIONS_IN_ADVANCE = 4
"""Number of repetitions that a process is given in advance, so that it does not wait for the
pipe."""
MISSING = "a cluster needs Dask, which is not installed: pip install 'factorgraph_adj[cluster]'"
_NEVER_BEGAN = (
    "a worker process ended before it could begin ({}). In a script, the call of run belongs "
    "under `if __name__ == '__main__':`, as every process imports the script once more"
)


@dataclass(frozen=True, slots=True)
class Task:
    """A repetition to run."""

    cell: int
    """Number of the cell among the experiment's combinations."""
    repetition: int
    """Number of the repetition, counted from 0."""
    seed: int
    """Seed that the trial gets."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The outcome of a repetition."""

    figures: Mapping[str, float] = field(default_factory=dict)
    """Figures by name; empty if the repetition failed."""
    error: str = ""
    """Type of the error; empty if the repetition succeeded."""
    message: str = ""
    """Message of the error."""


@dataclass(frozen=True)
class Repetition:
    """One repetition of one cell: a row of the results."""

    levels: Levels
    """Level of every factor."""
    repetition: int
    """Number of the repetition, counted from 0."""
    seed: int
    """Seed of the trial; with this seed the repetition can be run again alone."""
    figures: Mapping[str, float]
    """Figures that the trial returned, by name; empty if the repetition failed."""
    error: str = ""
    """Type of the error; empty if the repetition succeeded."""
    message: str = ""
    """Message of the error."""

    @classmethod
    def of(cls, levels: Levels, task: Task, outcome: Outcome) -> Repetition:
        """Return the row of an outcome."""
        figures, error, message = outcome.figures, outcome.error, outcome.message
        return cls(levels, task.repetition, task.seed, figures, error, message)


def repeat(trial: Trial, seed: int, levels: Levels) -> Outcome:
    """Run a trial once; every error in it is an outcome, except an interruption."""
    try:
        return Outcome(_figures(trial(seed, **levels), levels))
    except (Exception, SystemExit) as error:
        return failed(error)


def failed(error: BaseException) -> Outcome:
    """Return an error as an outcome."""
    try:
        message = str(error)
    except Exception:
        message = "(its message cannot be made)"
    # Characters that UTF-8 cannot encode are written as escapes.
    message = message.encode("utf-8", "backslashreplace").decode("utf-8")
    return Outcome(error=type(error).__name__, message=message)


def not_sent(why: object) -> str:
    """Return the message that a trial cannot be sent to other processes."""
    return (
        f"cannot be sent to other processes ({why}): it must be a function of a module, not a "
        "lambda or a function inside another, nor defined under `if __name__ == '__main__':`"
    )


def died(how: str) -> Outcome:
    """Return the outcome of a repetition whose process ended while it ran."""
    return Outcome(error=DIED, message=f"the process that ran it ended{how}")


def _figures(returned: object, levels: Levels) -> dict[str, float]:
    """Return the figures of a trial as floats."""
    if not isinstance(returned, Mapping):
        what = f"a trial returns a mapping of names to numbers, not {type(returned).__name__}"
        raise TypeError(what)
    figures = {}
    for name, value in returned.items():
        if not isinstance(name, str) or not name or not name.isprintable():
            raise TypeError(f"the name of a figure is a text that is not empty, not {name!r}")
        if name in levels or name in RESERVED:
            taken = ", ".join([*levels, *RESERVED])
            raise ValueError(f"a figure needs another name than {name!r}; taken: {taken}")
        if not isinstance(value, numbers.Real | np.bool_):
            raise TypeError(f"figure {name!r} is a number, not of type {type(value).__name__}")
        figures[name] = float(value)
    return figures


def is_client(client: object) -> bool:
    """Return whether an object is a synchronous client of Dask.

    Raises:
        InputError: Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(MISSING) from None
    return isinstance(client, Client) and not client.asynchronous


def on_cluster(
    client: Client, trial: Trial, cells: Sequence[Levels], tasks: Sequence[Task]
) -> Iterator[tuple[Task, Outcome]]:
    """Run repetitions, and yield each with its outcome when it is finished.

    When a worker dies, Dask runs its repetitions on other workers; after several deaths it gives
    up all repetitions of the dead workers. The fatal one is found by running each of them alone.

    Raises:
        InputError: the workers cannot import the trial, or the cluster has stopped.
    """
    _probe(client, trial)
    work = _Work(client, trial, cells)
    suspects: list[Task] = []
    try:
        yield from work.through(tasks, suspects)
        for suspect in suspects:
            again: list[Task] = []
            yield from work.through([suspect], again)
            if again:
                yield suspect, died("")
    finally:
        work.cancel()


class _Work:
    """The repetitions under way on a cluster."""

    def __init__(self, client: Client, trial: Trial, cells: Sequence[Levels]) -> None:
        self._client = client
        self._trial = trial
        # As bytes, because Dask searches lists and texts for its own futures and keys.
        self._cells = [pickle.dumps(levels) for levels in cells]
        self._running: dict[Any, Task] = {}

    def through(
        self, tasks: Sequence[Task], suspects: list[Task]
    ) -> Iterator[tuple[Task, Outcome]]:
        """Run tasks; tasks whose workers died are added to ``suspects``."""
        from distributed import KilledWorker, as_completed

        waiting = deque(tasks)
        under_way = as_completed()
        while waiting or self._running:
            most = REPETITIONS_PER_THREAD * max(sum(self._client.nthreads().values()), 1)
            while waiting and len(self._running) < most:
                future = self._submit(waiting[0])
                self._running[future] = waiting.popleft()
                under_way.add(future)
            future = next(under_way)
            task = self._running.pop(future)
            if future.status == "finished":
                yield task, future.result()
            elif future.status in ("lost", "pending"):
                # Its worker has died since; the cluster repeats what was finished there.
                self._running[future] = task
                under_way.add(future)
            elif future.status != "error":
                what = f"the cluster has stopped ({future.status}); what is finished is kept"
                raise InputError(what)
            elif isinstance(error := future.exception(), KilledWorker):
                suspects.append(task)
            else:
                yield task, failed(error)

    def _submit(self, task: Task) -> Any:
        return self._client.submit(
            _repeat, self._trial, task.seed, self._cells[task.cell], pure=False
        )

    def cancel(self) -> None:
        """Cancel the repetitions under way."""
        if self._running:
            self._client.cancel(list(self._running))


def _probe(client: Client, trial: Trial) -> None:
    """Let a worker load the trial."""
    try:
        client.submit(_ready, trial, pure=False).result()
    except Exception as error:
        because = f"{type(error).__name__}: {error}"
        raise InputError(f"the cluster's workers cannot import the trial: {because}") from None


def _ready(trial: Trial) -> bool:
    return callable(trial)


def _repeat(trial: Trial, seed: int, levels: bytes) -> Outcome:
    use_one_thread()
    return repeat(trial, seed, pickle.loads(levels))


def in_processes(
    trial: Trial, cells: Sequence[Levels], tasks: Sequence[Task], *, processes: int
) -> Iterator[tuple[Task, Outcome]]:
    """Run repetitions, and yield each with its outcome when it is finished.

    Raises:
        InputError: a process cannot begin, or cannot import the trial.
    """
    # Levels are sent once. A task has a few bytes, so that sending never waits for the receiver.
    payload = pickle.dumps((trial, tuple(cells)))
    waiting = deque(tasks)
    at_work: dict[Connection, _Worker] = {}
    try:
        while waiting or at_work:
            # All processes begin at once; later passes replace processes that have ended.
            idle = sum(not worker.pending for worker in at_work.values())
            for _ in range(min(processes - len(at_work), len(waiting) - idle)):
                worker = _Worker(payload)
                at_work[worker.connection] = worker
            for ready in wait(list(at_work)):
                worker = at_work[ready]  # type: ignore[index]
                done = worker.read()
                if done is not None:
                    yield done
                if worker.ended:
                    del at_work[worker.connection]
                    waiting.extendleft(reversed(worker.pending))
                    continue
                # Near the end no process reserves a task that another one could begin at once.
                worker.feed(
                    waiting,
                    REPETITIONS_IN_ADVANCE
                    if len(waiting) > REPETITIONS_IN_ADVANCE * len(at_work)
                    else 1,
                )
                if not worker.pending:
                    del at_work[worker.connection]
                    worker.stop()
    finally:
        left = [worker for worker in at_work.values() if not worker.ended]
        for worker in left:
            worker.process.terminate()
        for worker in left:
            worker.stop()


class _Worker:
    """A process, the pipe to it, and its repetitions."""

    def __init__(self, payload: bytes) -> None:
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self.process: SpawnProcess = context.Process(
            target=_serve, args=(theirs, payload), daemon=True
        )
        try:
            with one_thread_for_children():
                self.process.start()
        except BaseException:
            self.connection.close()
            raise
        finally:
            theirs.close()  # otherwise the pipe stays open after the process has ended
        self.pending: deque[Task] = deque()
        """Repetitions that the process has and has not reported, in their order."""
        self.began = False
        self.ended = False

    def read(self) -> tuple[Task, Outcome] | None:
        """Return the repetition that the process has finished, or that ended the process."""
        try:
            said: str | Outcome = self.connection.recv()
        except (EOFError, OSError):
            self.ended = True
            self.stop()
            return self._last()
        if isinstance(said, Outcome):
            return self.pending.popleft(), said
        if said:
            raise InputError(Problem(not_sent(said), "trial"))
        self.began = True
        return None

    def _last(self) -> tuple[Task, Outcome] | None:
        code = self.code
        how = f"signal {-code}" if code < 0 else f"exit code {code}"
        if not self.began:
            raise InputError(_NEVER_BEGAN.format(how))
        return (self.pending.popleft(), died(f" with {how}")) if self.pending else None

    def feed(self, waiting: deque[Task], most: int) -> None:
        """Send tasks to the process until it has ``most``."""
        while waiting and len(self.pending) < most:
            try:
                self.connection.send(waiting[0])
            except OSError:  # the process has ended; the next reading notices its repetitions
                return
            self.pending.append(waiting.popleft())

    def stop(self) -> None:
        """Close the pipe, which ends the process, and wait for its end."""
        self.connection.close()
        self.process.join()
        self.code = self.process.exitcode or 0
        self.process.close()


def _serve(connection: Connection, payload: bytes) -> None:
    """Run a worker: report whether the trial can be loaded, then run tasks until the pipe ends."""
    # Ctrl-C reaches every process of a terminal; the parent process decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_one_thread()
    with contextlib.suppress(EOFError, OSError):  # the parent process has ended
        try:
            trial, cells = pickle.loads(payload)
        except Exception as error:
            outcome = failed(error)
            connection.send(f"{outcome.error}: {outcome.message}")
            return
        connection.send("")
        while True:
            task: Task = connection.recv()
            connection.send(repeat(trial, task.seed, cells[task.cell]))
