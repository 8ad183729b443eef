"""What a site keeps, and for how long, so that its database does not grow without bound.

    [retention]
    journals = "400 d"     # readings of closed epochs; not stated: for ever
    answers = "7 d"        # answers to requests
    events = "30 d"        # what browsers follow

Results of epochs, alarms, messages and decisions are kept for ever. After ``answers`` the answer to
a request is shortened to its verdict, while its name and digest stay: a repetition changes nothing,
however late it comes. After ``journals`` the readings of an epoch leave; its result stays, and late
readings for it are refused with this reason. The present epoch, the last closed one and the
reference epoch keep their readings. SQLite uses the room that becomes free for what comes later;
the file does not become smaller.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

from ..errors import InputError, Problem
from ..instruments.instrument_settings import duration
from ..io.csv_tables import FieldRow, row_of_table

DAY_S = 86400.0
FOR_EVER = "for ever"
"""What is stated for things that are kept without end."""


@dataclass(frozen=True)
class RetentionSettings:
    """For how long things are kept, seconds; None: for ever."""

    journals: float | None = None
    """Readings of closed epochs, from the end of the epoch, by the clock of the network."""
    answers: float | None = 7.0 * DAY_S
    """Whole answers to requests, from when these came; they are shortened then."""
    events: float | None = 30.0 * DAY_S
    """Events, from when they happened."""


def read_retention(table: object, where: str) -> RetentionSettings:
    """Return the settings of a site file.

    Raises:
        InputError: all problems of the table.
    """
    if table is None:
        return RetentionSettings()
    problems: list[Problem] = []
    row = row_of_table(table, "retention", where, problems)
    if row is None:
        raise InputError(problems)
    found = {
        f.name: None if given == FOR_EVER else _time(row, f.name, given)
        for f in fields(RetentionSettings)
        if (given := row.take(f.name)) is not None
    }
    row.refuse_left()
    if problems:
        raise InputError(problems)
    return RetentionSettings(**found)


def _time(row: FieldRow, name: str, given: object) -> float | None:
    """Return seconds; None after a problem, which is noted."""
    try:
        found = duration(given)
    except ValueError as error:
        row.wrong(f"{name} {error}; {FOR_EVER!r} is valid, too")
        return None
    if found <= 0.0:
        row.wrong(f"{name} must be greater than zero, not {given!r}")
    return found
