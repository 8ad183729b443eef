"""Run an experiment: every repetition of every cell, in this process, in others or on a cluster.

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

from ..blas_threads import one_thread
from ..errors import InputError, Problem
from .repetitions import (
    Outcome,
    Repetition,
    Task,
    in_processes,
    is_client,
    not_sent,
    on_cluster,
    repeat,
)
from .results import Done, Results, open_file, record
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
    """Run an experiment, or its unfinished repetitions.

    The results are bitwise identical for every number of processes, every cluster and every order:
    seeds do not depend on these, BLAS uses one thread everywhere (another number of threads changes
    the last digits), and rows are in the order of cells and repetitions. On a cluster this holds
    for processors of one kind and one version of all libraries. It requires that all random numbers
    of the trial follow from its seed alone, and that the trial does not depend on settings of the
    program (warnings turned into errors, `numpy.seterr`), which other processes do not have.

    With ``out``, every finished repetition is in the file at once. After an interruption
    (Ctrl-C, a killed process, a lost cluster) the same call continues; a call with more levels or
    repetitions adds these. A failed repetition is a result too, with its seed, and the type and
    message of its error.

    The file contains the names of experiment and trial, the seed, and the levels of each
    repetition: another name, trial or seed is refused. The file contains neither the code of the
    trial nor the specs and other files that the trial reads. After a change of these, give another
    ``out``; otherwise the file mixes results from before and after the change.

    Args:
        experiment: the experiment.
        repetitions: number of repetitions of each cell. Further repetitions of the file stay in
            the file and are left out of the results.
        out: file of finished repetitions (JSON Lines), whose folder is created if absent; none:
            repetitions are kept in memory only.
        processes: number of processes of this machine, each with one BLAS thread. With 1 the trial
            runs in this process, and a trial that ends its process ends the program.
        client: client of a Dask cluster to compute on instead (extra ``cluster``), best with
            one thread for each worker.
        retry: whether failed repetitions of the file are run again.
        progress: is called with the numbers of finished and of all repetitions: at the start, and
            after each repetition.

    Returns:
        The results, sorted by cell and repetition.

    Raises:
        InputError: arguments are invalid; other processes cannot import the trial; the file
            belongs to another experiment, is in use or cannot be written; or worker processes or
            the cluster do not work. Finished repetitions stay in the file.
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
        # In every case, repetitions under way are stopped before the file is closed.
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
    """Yield repetitions with their outcomes as they are finished."""
    if not tasks:
        return
    if client is not None:
        yield from on_cluster(client, trial, cells, tasks)
    elif processes > 1:
        yield from in_processes(trial, cells, tasks, processes=processes)
    else:
        for task in tasks:
            with one_thread:  # only for the trial, not for the caller between two outcomes
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
