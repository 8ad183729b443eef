"""Sets of instruments: when each was measured; what one cannot have measured is refused.

A posting may say which set it is: ``measured`` with ``instrument``, ``begin`` and ``end`` (seconds
UTC), and ``round``, its number where several rounds of readings make one pass. An instrument
measures one pass at a time. A set whose time overlaps that of another pass of the same instrument
was therefore not measured then: the instrument, or its simulation, was started again, or its clock
was set back. It is refused, and its sender told. Sets of an outage that come late lie between
those that are there, and enter.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ..control_characters import has_control_characters
from ..errors import InputError, Problem
from ..instruments.instrument_settings import MAX_READINGS
from ..instruments.message_rules import iso
from .database import Database

FIELDS = ("instrument", "begin", "end", "round")
"""Fields of ``measured``."""


@dataclass(frozen=True)
class MeasuredSet:
    """When an instrument measured a set."""

    instrument: str
    """Name of the instrument."""
    begin: float
    """First sight of its pass, seconds UTC."""
    end: float
    """Last sight of its pass, seconds UTC."""
    round: int = 1
    """Number of the round of readings in the pass, from 1."""

    @classmethod
    def of(cls, record: dict[str, Any]) -> MeasuredSet | None:
        """Take what a posting says of its set out of its record; None: it says nothing.

        Raises:
            InputError: a field is missing, unknown or no value of its kind.
        """
        given = record.pop("measured", None)
        if given is None:
            return None
        try:
            begin, end = (float(given[name]) for name in ("begin", "end"))
            name, number = given["instrument"], given.get("round", 1)
            of = cls(name, begin, end, number)
            right = isinstance(name, str) and 0 < len(name) <= 100 and set(given) <= {*FIELDS}
            right &= not has_control_characters(name)
            right &= (
                type(number) is int and 0 < number <= MAX_READINGS and 0.0 <= begin <= end < 1e11
            )
        except (TypeError, ValueError, OverflowError, KeyError, AttributeError):
            right = False
        if not right:
            what = (
                "must be an object with instrument, a name, begin and end, seconds UTC, and round, "
            )
            raise InputError(Problem(f"{what}a whole number from 1 to {MAX_READINGS}", "measured"))
        return of

    def excludes(self, other: MeasuredSet) -> bool:
        """Return whether an instrument that measured this set cannot have measured another one."""
        if self.instrument != other.instrument:
            return False
        if (self.begin, self.end) == (other.begin, other.end):  # the same pass
            return self.round == other.round
        return self.begin < other.end and other.begin < self.end

    def row(self, network: int, epoch: int) -> dict[str, Any]:
        """Return the row of the set in the database."""
        return {"network": network, "epoch": epoch, **asdict(self)}


def refuse_measured_twice(
    database: Database, network: int, new: MeasuredSet, pending: Sequence[Mapping[str, Any]]
) -> None:
    """Refuse a set that the instrument cannot have measured.

    Args:
        database: the database.
        network: id of the network.
        new: the set.
        pending: rows of sets that the database does not have yet.

    Raises:
        InputError: another set of the instrument was measured at that time.
    """
    from sqlalchemy import select

    from .tables import measured_sets as sets

    # Passes that are there do not overlap: only the first that ends later can overlap the new one.
    later = select(sets).where(
        *(sets.c.network == network, sets.c.instrument == new.instrument),
        sets.c.end >= new.begin,
    )
    first = later.order_by(sets.c.end).limit(2 * MAX_READINGS)
    with database.reading() as connection:
        rows = [dict(r._mapping) for r in connection.execute(first)]
    for row in [*rows, *pending]:
        there = MeasuredSet(**{name: row[name] for name in FIELDS})
        if there.excludes(new):
            raise InputError(
                Problem(
                    f"{new.instrument} cannot have measured a set from {iso(new.begin)} to "
                    f"{iso(new.end)}: it measured one from {iso(there.begin)} to "
                    f"{iso(there.end)}, which is here already. It was started again, or its clock "
                    "was set back",
                    "measured",
                )
            )


def sets_of_epoch(database: Database, network: int, epoch: int) -> dict[str, int]:
    """Return how many sets each instrument has in an epoch."""
    from sqlalchemy import func, select

    from .tables import measured_sets as sets

    counted = select(sets.c.instrument, func.count()).where(
        sets.c.network == network, sets.c.epoch == epoch
    )
    with database.reading() as connection:
        rows = connection.execute(counted.group_by(sets.c.instrument)).all()
    return {name: int(number) for name, number in rows}
