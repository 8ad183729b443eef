"""Repetitions on processes of this machine.

Each process has its own pipe and reports every finished repetition. A process that ends is
replaced; its first unreported repetition is the one that ended it, and all others run normally.
(A `concurrent.futures.ProcessPoolExecutor` breaks as a whole in this case, and does not say which
call was the cause.)
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from ..blas_threads import one_thread_for_children, use_one_thread
from ..errors import InputError, Problem
from .repetition import Outcome, Task, died, failed, not_sent, repeat
from .study import Levels, Trial

AHEAD = 4
"""Number of repetitions that a process is given in advance, so that it does not wait for the
pipe."""
_NEVER_BEGAN = (
    "a worker process ended before it could begin ({}). In a script, the call of run belongs "
    "under `if __name__ == '__main__':`, as every process imports the script once more"
)


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
                worker.feed(waiting, AHEAD if len(waiting) > AHEAD * len(at_work) else 1)
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
