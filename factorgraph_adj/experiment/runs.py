"""Run an experiment: every repetition of every cell, on whatever computes it.

>>> results = run(Experiment("distances", trial, {"distances": [24, 28, 60]}, 1986), 500,
...               out="distances.jsonl", processes=2)                      # doctest: +SKIP
>>> print(results.summary())                                               # doctest: +SKIP
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError, Problem
from .blas import one_blas_thread
from .cluster import is_client, on_cluster
from .finished import Done, open_file, record
from .processes import in_processes
from .repetition import Outcome, Repetition, Task, not_sent, repeat
from .results import Results
from .study import Experiment, Levels, Trial

if TYPE_CHECKING:
    from distributed import Client

__all__ = ["Experiment", "run"]


def run(
    experiment: Experiment,
    repetitions: int,
    *,
    out: str | Path | None = None,
    processes: int = 1,
    client: Client | None = None,
    retry: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> Results:
    """Run an experiment, or what is left of it.

    The results are the same bit for bit whoever computes them and in whatever order: seeds do
    not depend on it, BLAS gets one thread everywhere (another number of threads gives other last
    digits), and rows are in the order of cells and repetitions. On a cluster this holds for
    processors of one kind and one version of all libraries. The trial must do its part: what is
    random in it follows from its seed alone, and it depends on nothing that the program has set
    (warnings turned into errors, `numpy.seterr`), which other processes do not know.

    With ``out``, every finished repetition is in the file at once. After an interruption
    (Ctrl-C, a killed process, a cluster that is gone) the same call goes on where it stopped;
    with more levels or repetitions it adds those. A failed repetition is a result too: it has
    its seed, the type of its error and what that says.

    The file knows the names of experiment and trial, the seed, and the levels of each repetition:
    another name, trial or seed is refused. It does not know the code of the trial, nor specs and
    other files that the trial reads: after a change of these give another ``out``, or results of
    both stand side by side.

    Args:
        experiment: what is repeated.
        repetitions: number of repetitions of each cell. More in the file stay there and are
            left out of the results.
        out: file of finished repetitions (JSON Lines), its folder made if it is not there; none
            keeps them in memory only.
        processes: processes of this machine, each with one BLAS thread. With 1 the trial runs in
            this process; a trial that ends its process is then the end of this one too.
        client: client of a Dask cluster to compute on instead (extra ``cluster``), best with
            one thread for each worker.
        retry: run failed repetitions of the file again.
        progress: is called with the numbers of finished and of all repetitions: at the start, and
            after each repetition.

    Returns:
        The results, sorted by cell and repetition.

    Raises:
        InputError: bad arguments; a trial that other processes cannot import; the file is of
            another experiment, is in use or cannot be written; worker processes or the cluster
            cannot work. What is finished stays in the file.
    """
    _check(experiment, repetitions, processes, client)
    cells = experiment.combinations
    with ExitStack() as stack:
        journal, done = None, Done()
        if out is not None:
            journal, done = open_file(out, experiment)
            stack.enter_context(journal)
        every = [
            Task(cell, k, experiment.seed_of(levels, k))
            for cell, levels in enumerate(cells)
            for k in range(repetitions)
        ]
        tasks = [t for t in every if _is_left(done.get((t.cell, t.repetition)), retry)]
        total, finished = len(every), len(every) - len(tasks)
        if progress is not None:
            progress(finished, total)
        outcomes = _outcomes(experiment.trial, cells, tasks, processes, client)
        # Whatever happens here, what is under way is stopped before the file is closed.
        stack.enter_context(closing(outcomes))
        for task, outcome in outcomes:
            if journal is not None:
                journal.append(record(experiment, task, outcome))
            done[task.cell, task.repetition] = outcome
            finished += 1
            if progress is not None:
                progress(finished, total)
    rows = (Repetition.of(cells[t.cell], t, done[t.cell, t.repetition]) for t in every)
    return Results(experiment.name, experiment.names, tuple(rows))


def _is_left(outcome: Outcome | None, retry: bool) -> bool:
    return outcome is None or (retry and outcome.error != "")


def _outcomes(
    trial: Trial,
    cells: Sequence[Levels],
    tasks: Sequence[Task],
    processes: int,
    client: Client | None,
) -> Generator[tuple[Task, Outcome], None, None]:
    """Give repetitions as they are finished."""
    if not tasks:
        return
    if client is not None:
        yield from on_cluster(client, trial, cells, tasks)
    elif processes > 1:
        yield from in_processes(trial, cells, tasks, processes=processes)
    else:
        for task in tasks:
            with one_blas_thread():  # not for those who look at the outcome
                outcome = repeat(trial, task.seed, cells[task.cell])
            yield task, outcome


def _check(
    experiment: Experiment, repetitions: object, processes: object, client: object | None
) -> None:
    problems = [
        Problem(f"must be a whole number ≥ 1, not {number!r}", name)
        for name, number in (("repetitions", repetitions), ("processes", processes))
        if not isinstance(number, int | np.integer) or isinstance(number, bool) or number < 1
    ]
    if client is not None and processes != 1:
        problems.append(Problem("give processes or a client, not both", "client"))
    if client is not None and not is_client(client):
        what = f"must be a distributed.Client (not an asynchronous one), not {client!r}"
        problems.append(Problem(what, "client"))
    if client is not None or processes != 1:
        try:
            pickle.dumps(experiment.trial)
        except Exception as error:
            problems.append(Problem(not_sent(error), f"trial {experiment.trial_name()}"))
    if problems:
        raise InputError(problems)
