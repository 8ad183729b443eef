"""Fields of a posting that the service takes: its time, its request; answers that were given."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..control_characters import has_control_characters, refuse_half_characters, why_refused
from ..errors import AdjustmentError, InputError, Problem, known
from ..instruments.message_rules import iso
from ..service.answers import Answer, refusal
from ..service.requests import adds_observations_alone, shown_value
from .database import Database
from .epoch_schedule import MAX_EPOCH
from .measured_sets import MeasuredSet
from .posting_transactions import Task

MAX_LETTERS_OF_REQUEST = 200
"""Largest number of characters of a request, as its column in the database."""
MAX_READINGS_OF_LOT = 250
"""Largest number of readings that arrive together: verdicts of a larger arrival lack their gains.
"""
COMMANDS_THAT_CHANGE = frozenset(
    (
        *("add", "accept", "discard", "revoke", "remove", "replace", "reweight", "snoop"),
        *("settle", "retire", "close epoch"),
    )
)
"""Commands that the service records: those of the stream protocol that change an epoch, without
``write`` and ``stop``, and ``close epoch``, which ends the present one."""
QUERIES = frozenset(
    (
        *("solution", "estimate", "reliability", "waiting", "suspects", "rejected", "doubts"),
        *("causes", "next_sights"),
    )
)
"""Commands that change nothing."""


class OtherRequest(AdjustmentError):
    """A request with the same name asked something else."""


@dataclass(frozen=True, eq=False)
class Posting:
    """A posting, whose own fields have been read."""

    task: Task
    """What waits for the answer."""
    record: dict[str, Any]
    """What the stream of an epoch takes."""
    do: str
    """Its command; ``add`` where it is a reading."""
    time: float
    """When it was measured, seconds UTC."""
    request: str
    """Its request; empty: none."""
    epoch: int | None
    """Number of the epoch that a command names; None: it names none."""
    digest: str
    """Digest of all its fields."""
    measured: MeasuredSet | None = None
    """The set of an instrument that it is; None: it says nothing of one."""

    @classmethod
    def of(cls, task: Task, now: float) -> Posting:
        """Read what a posting says beside its content.

        Args:
            task: the posting.
            now: its time where it states none, seconds UTC.

        Raises:
            InputError: a bad time, request, epoch or set, or an unknown command.
        """
        text = json.dumps(task.record, sort_keys=True)
        refuse_half_characters(text, task.record, "posting")
        record, do = dict(task.record), task.record.get("do", "add")
        time, request = posting_time(record, task.received, now), posting_request(record)
        epoch = None if do == "add" else named_epoch(record)
        digest = hashlib.sha256(text.encode()).hexdigest()
        commands = COMMANDS_THAT_CHANGE | QUERIES
        if not isinstance(do, str) or do not in commands:
            valid = known(sorted(commands), meant=do, most=len(commands))
            raise InputError(Problem(f"unknown command {shown_value(do)}; valid: {valid}", "do"))
        return cls(task, record, do, time, request, epoch, digest, MeasuredSet.of(record))

    def request_row(self, network: int, answer: Answer) -> dict[str, Any]:
        """Return the row with which the request is not executed again, but answered.

        Args:
            network: id of the row of the network.
            answer: the answer.
        """
        return {
            "network": network,
            "request": self.request,
            "digest": self.digest,
            "at": self.task.received,
            "answer": json.dumps(answer),
        }

    @property
    def latest(self) -> float:
        """The latest time that it states, of the posting or of its set, seconds UTC."""
        return self.time if self.measured is None else max(self.time, self.measured.end)

    @property
    def label(self) -> str:
        """What it is and who sent it, for messages."""
        inner = self.record.get("observations", ())
        several = inner if isinstance(inner, list) else [inner]
        first = several[0] if several and isinstance(several[0], Mapping) else self.record
        named = [str(first[k]) for k in ("station", "target", "point", "photo") if k in first]
        label = " ".join((str(first.get("kind", self.do)), " → ".join(named)))
        label += f" and {len(several) - 1} more" if len(several) > 1 else ""
        whom = self.task.who if self.measured is None else self.measured.instrument
        return label.strip() + (f", from {whom}" if whom else "")

    @property
    def is_reading(self) -> bool:
        """Whether it is observations alone: one, a group, or ``add`` with nothing else."""
        return "do" not in self.record or adds_observations_alone(self.record)

    @property
    def size(self) -> int:
        """Number of observations or groups of a reading."""
        return len(self.record["observations"]) if "do" in self.record else 1

    @property
    def is_of_present(self) -> bool:
        """Whether it is about the present epoch: a question, or a command that states no time."""
        states_none = not self.task.states_time and self.task.record.get("kept") is None
        return self.do in QUERIES or (self.do != "add" and states_none)

    @property
    def key(self) -> str | int:
        """Its request; a number of its own where it has none."""
        return self.request or id(self)

    def joins(self, lot: Mapping[str | int, Posting]) -> bool:
        """Return whether it can arrive together with others.

        All are readings, no request stands twice, no set excludes another one of the lot, which may
        yet be refused, and they are not more than one arrival tells the gains of.

        Args:
            lot: the others by their keys.
        """
        mine, others = self.measured, [*lot.values()]
        if not (self.is_reading and others[0].is_reading) or self.key in lot:
            return False
        if self.size + sum(other.size for other in others) > MAX_READINGS_OF_LOT:
            return False
        return mine is None or not any(
            o.measured is not None and o.measured.excludes(mine) for o in others
        )


def posting_time(record: dict[str, Any], received: float, now: float) -> float:
    """Take the time of a posting out of its record.

    Args:
        record: the posting. Where it states no ``time``, it is now, or earlier by as much as it was
            ``kept`` by its sender before it was received.
        received: when it was received, seconds UTC.
        now: the time then on the clock of its network, seconds UTC.

    Raises:
        InputError: a time is no time.
    """
    given, kept = _time(record, "time"), _time(record, "kept")
    if given is not None:
        return given
    return now if kept is None else kept + (now - received)


def _time(record: dict[str, Any], name: str) -> float | None:
    """Take a time out of a record; None where it states none."""
    given = record.pop(name, None)
    if given is None:
        return None
    if isinstance(given, bool) or not isinstance(given, int | float):
        raise InputError(Problem(f"{name} must be seconds since 1970 UTC, a number", name))
    if not 0.0 <= given < 1e11:
        what = f"{name} {shown_value(given)} is no time in seconds since 1970"
        raise InputError(Problem(what, name))
    return float(given)


def named_epoch(record: dict[str, Any]) -> int | None:
    """Take the number of an epoch out of a command; None where it names none.

    Raises:
        InputError: it is no number.
    """
    given = record.pop("epoch", None)
    if given is None:
        return None
    if isinstance(given, bool) or not isinstance(given, int) or not 0 <= given <= MAX_EPOCH:
        what = f"epoch must be the number of an epoch, from 0 to {MAX_EPOCH}"
        raise InputError(Problem(what, "epoch"))
    return given


def posting_request(record: dict[str, Any]) -> str:
    """Take the request of a posting out of its record; empty where it has none.

    Raises:
        InputError: it is no text, too long, or has control characters.
    """
    given = record.pop("request", None)
    if given is None:
        return ""
    if not isinstance(given, str) or not 0 < len(given) <= MAX_LETTERS_OF_REQUEST:
        what = f"request must be a text of 1 to {MAX_LETTERS_OF_REQUEST} characters"
        raise InputError(Problem(what, "request"))
    if has_control_characters(given):
        raise InputError(Problem(why_refused(given), "request"))
    return given


def recorded_requests(
    database: Database, network: int, requested: Collection[str]
) -> dict[str, dict[str, Any]]:
    """Return the rows of those of some requests that were recorded, by request."""
    from sqlalchemy import select

    from .tables import requests

    if not requested:
        return {}
    asked = requests.c.request.in_(requested)
    wanted = select(requests).where(requests.c.network == network, asked)
    with database.reading() as connection:
        return {row.request: dict(row._mapping) for row in connection.execute(wanted)}


def known_answers(
    lot: Sequence[Posting],
    recorded: Mapping[str, Mapping[str, Any]],
    line: int,
    refuse: Callable[[Posting], None],
) -> dict[int, Answer]:
    """Return the answers to those of some postings that are not executed, by their ``id()``.

    Args:
        lot: the postings.
        recorded: rows of the requests that were executed, by request.
        line: number of the line of the first posting.
        refuse: raises `InputError` where a posting cannot have been measured as it says.
    """
    out: dict[int, Answer] = {}
    for number, posting in enumerate(lot, line):
        row = recorded.get(posting.request)
        try:
            if row is not None:
                out[id(posting)] = repeated_answer(row, posting.digest)
            elif posting.do not in QUERIES:
                refuse(posting)
        except OtherRequest as error:
            out[id(posting)] = refusal(number, error) | {"conflict": True}
        except InputError as error:
            out[id(posting)] = refusal(number, error)
    return out


def repeated_answer(row: Mapping[str, Any], digest: str) -> Answer:
    """Return the answer that a request has had already.

    Args:
        row: its row.
        digest: digest of what is asked now.

    Raises:
        OtherRequest: it asked something else.
    """
    if row["digest"] != digest:
        raise OtherRequest(
            f"the request {row['request']!r} has been recorded with another content: each posting "
            "needs a request of its own"
        )
    return dict(json.loads(row["answer"])) | {"repeated": True}


def named_ids(record: Mapping[str, Any]) -> dict[str, Any]:
    """Return the ids that a command names: an answer does not say what was removed."""
    ids = record.get("ids", record.get("id") if record.get("do") == "replace" else None)
    return {} if ids is None else {"ids": [ids] if isinstance(ids, str) else ids}


def passed_over(
    there: Collection[int], number: int, posting: Posting, told: Sequence[Answer]
) -> list[tuple[str, Answer]]:
    """Return the event that tells of epochs without readings before a new one.

    An instrument was away, or a time is wrong: what comes with right times is late then.

    Args:
        there: numbers of the epochs that were there.
        number: number of the epoch of a lot.
        posting: the first reading of the lot.
        told: the answers to the lot.
    """
    last = max(there, default=number)
    if last < 1 or number <= last + 1 or not any(answer["ok"] for answer in told):
        return []
    one = number == last + 2
    without = f"epoch {last + 1} has" if one else f"epochs {last + 1} to {number - 1} have"
    what = (
        f"{posting.label} of {iso(posting.time)} has begun epoch {number}, and {without} no "
        "readings: instruments were away, or the time of this reading is wrong"
    )
    return [("problem", {"what": what, "epoch": number})]
