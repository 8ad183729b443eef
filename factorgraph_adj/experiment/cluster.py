"""Repetitions on a Dask cluster; Dask is imported when its client is given."""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from ..blas_threads import use_one_thread
from ..errors import InputError
from .repetition import Outcome, Task, died, failed, repeat
from .study import Levels, Trial

if TYPE_CHECKING:
    from distributed import Client

MISSING = "a cluster needs Dask, which is not installed: pip install 'factorgraph_adj[cluster]'"
AHEAD = 4
"""Number of repetitions under way for each thread of the cluster, so that no thread waits."""


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
            most = AHEAD * max(sum(self._client.nthreads().values()), 1)
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
