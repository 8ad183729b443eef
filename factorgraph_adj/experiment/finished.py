"""The file of finished repetitions: a journal with one line for each, written at once.

The header identifies the experiment; every further line is one repetition: its levels, number,
seed, and figures or error. A repetition with two lines was tried again; the last line counts.
Figures have all their digits; NaN and the infinities, which JSON does not have, are texts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import InputError, Problem, known, system_reason
from ..io.journal import Journal
from .repetition import Outcome, Task
from .study import Experiment, encoded, key, said, written

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
