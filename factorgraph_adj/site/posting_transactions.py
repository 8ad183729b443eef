"""Postings that wait, and what the transaction that acknowledges them will hold."""

from __future__ import annotations

import json
import time as clock
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..service.answers import Answer

if TYPE_CHECKING:
    from sqlalchemy import Connection


@dataclass
class Task:
    """A posting that waits for the thread of a network."""

    record: dict[str, Any]
    """Its fields, as they came."""
    who: str
    """Who sent it."""
    received: float
    """When it came, seconds UTC."""
    future: Future[Answer]
    """Takes its answer."""

    @property
    def states_time(self) -> bool:
        """Whether it says when it was measured."""
        return self.record.get("time") is not None

    def action(self, action: str, data: Mapping[str, Any]) -> dict[str, Any]:
        """Return the row that records who did something."""
        data_text = json.dumps(data)
        return {"at": self.received, "who": self.who, "action": action, "data": data_text}


@dataclass
class Batch:
    """What one transaction will hold."""

    answered: list[tuple[Task, Answer]] = field(default_factory=list)
    """Postings with the answers that they get after it."""
    requests: list[dict[str, Any]] = field(default_factory=list)
    """Rows of requests."""
    sets: list[dict[str, Any]] = field(default_factory=list)
    """Rows of sets of instruments."""
    events: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    """Kinds and data of events, in order."""
    actions: list[dict[str, Any]] = field(default_factory=list)
    """Rows of decisions."""
    steps: list[Callable[[Connection], None]] = field(default_factory=list)
    """What is done first in the transaction; steps may add events."""
    results: dict[int, dict[str, Any]] = field(default_factory=dict)
    """Results of epochs that the transaction will record, by numbers."""

    @property
    def has_changes(self) -> bool:
        """Whether there is anything to write beside lines of journals."""
        return bool(self.steps or self.requests or self.sets or self.events or self.actions)

    def write(
        self, connection: Connection, network: int, lines: Sequence[Mapping[str, Any]]
    ) -> None:
        """Write everything into a transaction.

        Args:
            connection: the transaction.
            network: id of the row of the network.
            lines: rows of its journals.
        """
        from sqlalchemy import insert

        from .tables import actions, events, journal, measured_sets, requests

        if lines:
            connection.execute(insert(journal), lines)
        for step in self.steps:
            step(connection)
        at = clock.time()
        happened = [
            {"network": network, "at": at, "kind": kind, "data": json.dumps(data)}
            for kind, data in self.events
        ]
        inserts = (
            *((requests, self.requests), (measured_sets, self.sets)),
            *((events, happened), (actions, self.actions)),
        )
        for table, rows in inserts:
            if rows:
                connection.execute(insert(table), rows)
