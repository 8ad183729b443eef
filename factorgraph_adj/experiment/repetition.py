"""One repetition of an experiment on any computer: its figures, or its error."""

from __future__ import annotations

import numbers
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from .study import RESERVED, Levels, Trial

DIED = "WorkerDied"
"""Type of error of a repetition whose process ended while it ran."""


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
