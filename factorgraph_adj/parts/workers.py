"""Execution of the tasks of the parts: in this process, or by the workers of a Dask cluster."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

import numpy as np

from ..errors import AdjustmentError, ApproximationError, DatumError, InputError, Problem
from .junctions import PartError, problem_in_part
from .loaded_part import PartJob
from .tasks import forget_run

if TYPE_CHECKING:
    from distributed import Client, Future

R = TypeVar("R", covariant=True)

DASK_MISSING = (
    "a cluster needs Dask, which is not installed: pip install 'factorgraph_adj[cluster]'"
)

CONNECTION_TIMEOUT = "10s"
"""Time after which a scheduler that does not answer is given up."""
RESULT_TIMEOUT_S = 5.0
"""Seconds after which is asked whether the worker of a task is still there."""
MAX_WORKER_DEATHS = 3
"""Number of workers that may die with a task before it is given up, as with Dask itself."""


class Task(Protocol[R]):
    """One of the functions of `factorgraph_adj.parts.tasks`."""

    def __call__(self, job: PartJob, /, *arguments: Any) -> R | PartError:
        """Do the task for a part."""
        ...


@dataclass
class _Call:
    """A task for a part on the cluster."""

    task: Task[Any]
    job: PartJob
    arguments: tuple[Any, ...]
    future: Future | None = None
    home: str | None = None


class Workers:
    """Does tasks for all parts, and counts the bytes that are sent to and fro."""

    sent = 0
    """Bytes of the arrays sent to the parts."""
    received = 0
    """Bytes of the arrays received from the parts."""

    def __init__(self, jobs: Sequence[PartJob], client: Client | None) -> None:
        """Take in the parts; without a client their tasks are done here, one after another."""
        self.jobs, self._client = tuple(jobs), client
        self._homes: dict[int, str] = {}

    def each(self, task: Task[R], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, R]]:
        """Do a task for every part; yield the number of each part with its result, in order.

        Args:
            task: the task.
            arguments: its arguments for each part.

        Raises:
            AdjustmentError: the errors of all parts together, after the last part is done.
        """
        self.sent += sum(_bytes(a) for a in arguments)
        refused: list[tuple[str, PartError]] = []
        for number, result in self._done(task, arguments):
            if isinstance(result, PartError):
                refused.append((self.jobs[number].part.name, result))
                continue
            self.received += _bytes(result)
            yield number, result
        if refused:
            raise _error(refused)

    def all(self, task: Task[R], arguments: Sequence[tuple[Any, ...]]) -> list[R]:
        """Do a task for every part; return all results. Raises as `each` does."""
        return [result for _, result in self.each(task, arguments)]

    def _done(
        self, task: Task[R], arguments: Sequence[tuple[Any, ...]]
    ) -> Iterator[tuple[int, R | PartError]]:
        if self._client is None:
            for number, (job, own) in enumerate(zip(self.jobs, arguments, strict=True)):
                yield number, task(job, *own)
            return
        client = self._client
        calls = [_Call(task, job, own) for job, own in zip(self.jobs, arguments, strict=True)]
        for call in calls:
            self._submit(client, call)
        try:
            for number, call in enumerate(calls):
                yield number, self._result(client, call)
        finally:
            client.cancel([call.future for call in calls if call.future is not None])

    def _submit(self, client: Client, call: _Call) -> None:
        """Submit a task, if possible to the worker that has read the part already."""
        number = call.job.number
        alive = sorted(client.scheduler_info(n_workers=-1)["workers"])
        if self._homes.get(number) not in alive:
            load = dict.fromkeys(alive, 0)
            for other in self._homes.values():
                if other in load:
                    load[other] += 1
            self._homes.pop(number, None)
            if alive:
                self._homes[number] = min(alive, key=lambda address: load[address])
        home = self._homes.get(number)
        where = {} if home is None else {"workers": [home], "allow_other_workers": True}
        call.future = client.submit(call.task, call.job, *call.arguments, pure=False, **where)
        call.home = home

    def _result(self, client: Client, call: _Call) -> Any:
        """Return the result of a task; it is submitted again where its worker has died.

        Dask does that by itself, but not for a task whose preferred worker died while no other
        worker was there.
        """
        from distributed import KilledWorker

        for _ in range(MAX_WORKER_DEATHS + 1):
            try:
                while True:
                    assert call.future is not None
                    try:
                        return call.future.result(timeout=RESULT_TIMEOUT_S)
                    except TimeoutError:
                        alive = client.scheduler_info(n_workers=-1)["workers"]
                        if alive and call.home not in alive:
                            break
            except KilledWorker:
                break
            except CancelledError as error:
                raise AdjustmentError(
                    f"the cluster has stopped ({error}): start it again, and give the same folder "
                    "to go on from the last iteration"
                ) from None
            finally:
                lost, call.future = call.future, None  # or the workers keep the result
            client.cancel([lost])
            self._submit(client, call)
        raise AdjustmentError(
            f"part {call.job.part.name!r}: every worker that computed it died: has it more memory "
            "than a worker may use? Cut the network into more parts, or give the workers more "
            "memory"
        )

    def __enter__(self) -> Workers:
        """Begin."""
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        """Drop the parts from memory; workers of a failed run may hang, and drop them later."""
        run = self.jobs[0].run
        if self._client is None:
            forget_run(run)
        elif kind is None:
            self._client.run(forget_run, run, on_error="ignore")


@contextmanager
def cluster_client(address: str | None) -> Iterator[Client | None]:
    """Connect to a cluster; without an address there is none, and this process computes.

    Raises:
        InputError: Dask is not installed, or there is no scheduler at the address.
    """
    if address is None:
        yield None
        return
    try:
        from distributed import Client
    except ImportError:
        raise InputError(DASK_MISSING) from None
    try:
        client = Client(address, timeout=CONNECTION_TIMEOUT)
    except (OSError, ValueError) as error:
        what = f"no scheduler of a Dask cluster answers ({error}); valid: tcp://host:8786"
        raise InputError(Problem(what, f"cluster {address}")) from None
    with client:
        yield client


def check_client(client: object) -> None:
    """Refuse what is no synchronous client of Dask, or has no workers.

    Raises:
        InputError: it is none, its cluster has no workers, or Dask is not installed.
    """
    try:
        from distributed import Client
    except ImportError:
        raise InputError(DASK_MISSING) from None
    if not isinstance(client, Client) or client.asynchronous:
        raise InputError(
            f"client must be a synchronous distributed.Client of Dask, not {type(client).__name__}"
        )
    if client.status != "running":
        raise InputError(f"the client of the Dask cluster is {client.status}: connect a new one")
    try:
        client.wait_for_workers(1, timeout=CONNECTION_TIMEOUT)
    except TimeoutError:
        where = client.scheduler.address if client.scheduler is not None else "the cluster"
        what = f"no workers after {CONNECTION_TIMEOUT}: start some with dask worker {where}"
        raise InputError(Problem(what, f"cluster {where}")) from None


def _bytes(value: Any) -> int:
    """Return the bytes of the arrays in a message."""
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    if is_dataclass(value):
        return sum(_bytes(getattr(value, f.name)) for f in fields(value))
    if isinstance(value, tuple | list):
        return sum(_bytes(v) for v in value)
    return 0


def _error(refused: Sequence[tuple[str, PartError]]) -> AdjustmentError:
    """Return one error for those of several parts."""
    kinds = {r.kind for _, r in refused}
    problems = [
        problem_in_part(name, where, what) for name, r in refused for where, what in r.lines
    ]
    if kinds == {"ApproximationError"}:
        return ApproximationError(problems)
    if kinds <= {"InputError", "ApproximationError"}:
        return InputError(problems)
    message = "\n".join(str(p) for p in problems)
    if kinds == {"DatumError"}:
        unknowns = [u for _, r in refused for u in r.unknowns]
        names = [name for _, name in unknowns]
        return DatumError(
            message, defect=sum(r.defect for _, r in refused), names=names, unknowns=unknowns
        )
    return AdjustmentError(message)
