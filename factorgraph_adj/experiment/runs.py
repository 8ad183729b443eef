"""Run of an experiment, resumed from its file of repetitions; results as tables and arrays.

>>> results = run(Experiment("distances", trial, {"distances": [24, 28, 60]}, 1986), 500,
...               out="distances.jsonl", processes=2)                      # doctest: +SKIP
>>> print(results.summary())                                               # doctest: +SKIP

The header of the file identifies the experiment; every further line is one repetition: its levels,
number, seed, and figures or error. A repetition with two lines was tried again; the last line
counts. Figures have all their digits; NaN and the infinities, which JSON does not have, are texts.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..blas_threads import one_thread
from ..columns import data_frame, polars_frame
from ..errors import InputError, Problem, known, system_reason, unknown_name
from ..io.csv_tables import write_all_columns
from ..io.file_transaction import write_files
from ..io.journal import Journal
from ..result_display import Shown
from ..statistical_tests import CONFIDENCE_OF_REGION
from ..types import Array
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
from .study import Experiment, Level, Levels, Trial, encoded, key, said, written
from .summary import Summary, summarise

if TYPE_CHECKING:
    import pandas
    import polars
    from distributed import Client

KIND = "repetitions of an experiment"
"""Kind of journal that the header states."""

Done = dict[tuple[int, int], Outcome]
"""Outcomes by number of the cell and of the repetition."""


def open_file(path: str | Path, experiment: Experiment) -> tuple[Journal, Done]:
    """Start the file of an experiment, or continue it.

    An incomplete last line of a killed process is dropped. A crash of the process loses nothing
    else; a crash of the computer may lose lines that its system has not yet written to the disk.

    Args:
        path: the file; it may be absent or empty. Its folder is created if absent.
        experiment: the experiment of the file.

    Returns:
        The open file, and its finished repetitions.

    Raises:
        InputError: the file belongs to another experiment, is in use or cannot be read or
            written. The file is left unchanged.
    """
    path = Path(path)
    header = _header(experiment)
    if not path.exists() or (path.is_file() and path.stat().st_size == 0):
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            what = f"its folder cannot be made: {system_reason(error)}"
            raise InputError(Problem(what, str(path))) from None
        return Journal.create(path, header, durable=False), {}
    journal, there, lines, _ = Journal.open(path, durable=False)
    try:
        _compare(there, header, path)
        return journal, _read(lines, experiment, path)
    except BaseException:
        journal.close()
        raise


def record(experiment: Experiment, task: Task, outcome: Outcome) -> dict[str, object]:
    """Return the line of a repetition."""
    line: dict[str, object] = {
        "levels": encoded(experiment.combinations[task.cell]),
        "repetition": task.repetition,
        "seed": task.seed,
    }
    if outcome.error:
        return line | {"error": outcome.error, "message": outcome.message}
    return line | {"figures": {name: _number(v) for name, v in outcome.figures.items()}}


def _number(value: float) -> float | str:
    return value if abs(value) < float("inf") else repr(value)


def _header(experiment: Experiment) -> dict[str, object]:
    return {
        "kind": KIND,
        "name": experiment.name,
        "trial": experiment.trial_name(),
        "seed": experiment.seed,
        "common": experiment.common,
        "factors": list(experiment.names),
    }


def _compare(there: Mapping[str, Any], own: Mapping[str, Any], path: Path) -> None:
    """Refuse the file of another experiment, with a list of all differences."""
    if there.get("kind") != KIND:
        raise InputError(Problem("is a journal, but not of an experiment's repetitions", str(path)))
    factors = there.get("factors")
    if isinstance(factors, list) and sorted(map(str, factors)) == sorted(own["factors"]):
        there = {**there, "factors": own["factors"]}  # their order makes no difference
    other = [name for name in own if there.get(name) != own[name]]
    if other:
        raise InputError(
            Problem(
                f"is the file of another experiment: its {name} is {there.get(name)!r}, "
                f"not {own[name]!r}; choose another file",
                str(path),
            )
            for name in other
        )


def _read(lines: list[dict[str, Any]], experiment: Experiment, path: Path) -> Done:
    numbers = {key(levels): i for i, levels in enumerate(experiment.combinations)}
    done: Done = {}
    strangers: dict[str, Problem] = {}
    problems: list[Problem] = []
    for number, line in enumerate(lines, start=2):
        where = f"{path}:{number}"
        try:
            levels, repetition, seed = line["levels"], line["repetition"], line["seed"]
            cell = numbers.get(key_of_line := key(levels))
            outcome = _outcome(line)
        except (KeyError, TypeError, ValueError, AttributeError):
            problems.append(Problem("is not the line of a repetition", where))
            continue
        if cell is None:
            strangers.setdefault(key_of_line, Problem(_stranger(levels, experiment), where))
        elif seed != experiment.seed_of(experiment.combinations[cell], repetition):
            what = f"has seed {seed} for repetition {repetition}, which is not the experiment's"
            problems.append(Problem(what, where))
        else:
            done[cell, repetition] = outcome
    if strangers or problems:
        raise InputError([*strangers.values(), *problems])
    return done


def _stranger(levels: Mapping[str, Any], experiment: Experiment) -> str:
    """Say which level the experiment lacks; levels of a file may be added, but not removed."""
    for name in experiment.names:
        own = {written(cell[name]): cell[name] for cell in experiment.combinations}
        if key({name: levels.get(name)}) not in {key({name: level}) for level in own.values()}:
            return (
                f"has {name} = {levels.get(name)!r}, which is no level of this experiment; "
                f"levels: {known(own)}. Levels may be added to a file, not taken away"
            )
    return f"is of a cell that this experiment does not have: {said(levels)}"


def _outcome(line: Mapping[str, Any]) -> Outcome:
    if "error" in line:
        return Outcome(error=str(line["error"]), message=str(line["message"]))
    return Outcome({str(name): float(value) for name, value in line["figures"].items()})


@dataclass(frozen=True, repr=False)
class Results(Shown):
    """All repetitions of an experiment, sorted by cell and repetition."""

    name: str
    """Name of the experiment."""
    factors: tuple[str, ...]
    """Names of the factors."""
    rows: tuple[Repetition, ...]
    """Every repetition, including failed ones."""

    def headline(self) -> str:
        """Return the numbers of repetitions and of failed ones."""
        failed = len(self.failed)
        return f"Results of {self.name!r}: {len(self.rows)} repetitions, {failed} failed"

    @property
    def failed(self) -> tuple[Repetition, ...]:
        """The repetitions that failed, with their seeds and errors."""
        return tuple(row for row in self.rows if row.error)

    @property
    def figures(self) -> tuple[str, ...]:
        """Names of the figures, in the order in which they first appear."""
        return tuple(dict.fromkeys(name for row in self.rows for name in row.figures))

    def values(self, figure: str, /, **levels: Level) -> Array:
        """Return a figure of every repetition at some levels, (n,) in the order of rows.

        Args:
            figure: name of the figure.
            **levels: levels of the wanted cells; without levels, all cells.

        Returns:
            The values; NaN where a repetition failed or lacks the figure.

        Raises:
            InputError: the figure, factor or level is unknown.
        """
        if figure not in self.figures:
            what = unknown_name("figure", figure, self.figures)
            raise InputError(what)
        self._check(levels)
        want = encoded(levels)
        return np.array(
            [
                row.figures.get(figure, np.nan)
                for row in self.rows
                if encoded({name: row.levels[name] for name in levels}) == want
            ]
        )

    def _check(self, levels: Levels) -> None:
        problems = []
        for name, level in levels.items():
            if name not in self.factors:
                what = unknown_name("factor", name, self.factors)
                problems.append(Problem(what))
                continue
            there = {written(row.levels[name]): row.levels[name] for row in self.rows}
            if encoded({"": level}) not in [encoded({"": other}) for other in there.values()]:
                what = unknown_name("level", level, there)
                problems.append(Problem(what, f"factor {name!r}"))
        if problems:
            raise InputError(problems)

    def table(self) -> str:
        """Return all rows as CSV: factors, repetition, seed, figures, error, message.

        Floats have all their digits (``repr``). The entry of a figure is empty if the repetition
        failed or lacks the figure; ``nan`` is a figure that is not a number.
        """
        rows = self.rows
        columns = {n: [written(r.levels[n]) for r in rows] for n in self.factors}
        columns["repetition"] = [str(r.repetition) for r in rows]
        columns["seed"] = [str(r.seed) for r in rows]
        for n in self.figures:
            columns[n] = [repr(r.figures[n]) if n in r.figures else "" for r in rows]
        columns["error"] = [r.error for r in rows]
        columns["message"] = [r.message for r in rows]
        return write_all_columns(columns)

    def write(self, path: str | Path) -> None:
        """Write the whole table to a file.

        Raises:
            InputError: the file cannot be written; an existing file is left unchanged.
        """
        path = Path(path)
        write_files(path.parent, {path.name: self.table()})

    def to_pandas(self) -> pandas.DataFrame:
        """Return a data frame with the columns of `table`; NaN where a figure is missing.

        Raises:
            InputError: pandas is not installed (extra ``table``).
        """
        return data_frame(self._columns())

    def to_polars(self) -> polars.DataFrame:
        """Return a data frame of polars with the columns of `to_pandas`.

        Raises:
            InputError: polars is not installed (extra ``polars``).
        """
        return polars_frame(self._columns())

    def _columns(self) -> dict[str, object]:
        rows = self.rows
        columns: dict[str, object] = {
            name: [row.levels[name] for row in rows] for name in self.factors
        }
        columns["repetition"] = [row.repetition for row in rows]
        columns["seed"] = [row.seed for row in rows]
        columns |= {name: self.values(name) for name in self.figures}
        columns["error"] = [row.error for row in rows]
        columns["message"] = [row.message for row in rows]
        return columns

    def summary(self, *, confidence: float = CONFIDENCE_OF_REGION) -> Summary:
        """Return mean, standard deviation and RMS of each figure in each cell, with intervals.

        Args:
            confidence: confidence level of each interval, between 0 and 1: the share of such
                experiments whose interval contains the true value, for normally distributed
                figures.

        Raises:
            InputError: the confidence is not between 0 and 1.
        """
        return summarise(
            name=self.name,
            factors=self.factors,
            figures=self.figures,
            rows=self.rows,
            confidence=confidence,
        )


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
