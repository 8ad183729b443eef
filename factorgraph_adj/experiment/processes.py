"""Repetitions on processes of this machine.

Each process has a pipe of its own and reports every repetition when it is finished. One that
ends is replaced, and the first repetition that it had not reported is the one it ended with:
all others run as if nothing had happened. (A `concurrent.futures.ProcessPoolExecutor` breaks as
a whole then, and does not say with which call.)
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

from ..errors import InputError, Problem
from .blas import one_thread_for_children, use_one_blas_thread
from .repetition import Outcome, Task, died, failed, not_sent, repeat
from .study import Levels, Trial

AHEAD = 4
"""Repetitions that a process has at hand, so that short ones do not wait for the pipe."""
_NEVER_BEGAN = (
    "a worker process ended before it could begin ({}). In a script, the call of run belongs "
    "under `if __name__ == '__main__':`, as every process imports the script once more"
)


def in_processes(
    trial: Trial, cells: Sequence[Levels], tasks: Sequence[Task], *, processes: int
) -> Iterator[tuple[Task, Outcome]]:
    """Run repetitions, and give each with its outcome when it is finished.

    Raises:
        InputError: a process cannot begin, or cannot import the trial.
    """
    # Levels go there once, tasks are a few bytes: sending one never waits for its receiver.
    payload = pickle.dumps((trial, tuple(cells)))
    waiting = deque(tasks)
    at_work: dict[Connection, _Worker] = {}
    try:
        while waiting or at_work:
            # All begin at once; later this replaces those that have ended.
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
                # Near the end nobody takes what another process could begin at once.
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
    """A process, the pipe to it, and what it has to do."""

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
            theirs.close()  # or the end of the process would not end the pipe
        self.pending: deque[Task] = deque()
        """Repetitions that it has and has not reported, in their order."""
        self.began = False
        self.ended = False

    def read(self) -> tuple[Task, Outcome] | None:
        """Return what it reports: a repetition that is finished, or with which it ended."""
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
        """Give it tasks until it has ``most``."""
        while waiting and len(self.pending) < most:
            try:
                self.connection.send(waiting[0])
            except OSError:  # it has ended; where it has anything, the next reading finds out
                return
            self.pending.append(waiting.popleft())

    def stop(self) -> None:
        """Close the pipe, which lets the process end, and wait for that."""
        self.connection.close()
        self.process.join()
        self.code = self.process.exitcode or 0
        self.process.close()


def _serve(connection: Connection, payload: bytes) -> None:
    """Be a worker: say whether the trial is there, then run what arrives until nothing does."""
    # Ctrl-C reaches every process of a terminal; the one that asked for the run decides.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    use_one_blas_thread()
    with contextlib.suppress(EOFError, OSError):  # the one that asked is gone
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
