"""Decisions about observations of an epoch: who accepted, rejected or changed which, and when."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from .database import Database
from .epoch_search import SEARCHER

DECIDING = ("accept", "discard", "remove", "replace", "reweight", "snoop")
"""Commands that decide about observations."""

Row = Mapping[str, Any]


@dataclass(frozen=True)
class Decision:
    """A command that decided about observations of an epoch."""

    at: float
    """When it was given, seconds UTC."""
    by: str
    """Who gave it; `SEARCHER`: the site itself, when the epoch ended."""
    do: str
    """The command, one of `DECIDING`."""
    ids: tuple[str, ...]
    """The observations that it names; none for a search among all."""

    @classmethod
    def of(cls, row: Row, record: Row) -> Decision:
        """Read a decision.

        Args:
            row: its row of the table ``actions``.
            record: the content of its column ``data``.
        """
        ids = record.get("ids", record.get("id", ()))
        named = (ids,) if isinstance(ids, str) else tuple(ids)
        return cls(float(row["at"]), row["who"], row["action"], named)

    def shown(self) -> dict[str, Any]:
        """Return what the API shows."""
        return {"at": self.at, "by": self.by, "do": self.do, "ids": [*self.ids]}


def epoch_decisions(
    database: Database,
    network: str,
    epoch: int,
    *,
    more: Sequence[Row] = (),
    others: bool = False,
) -> list[Decision]:
    """Return the decisions about observations of an epoch, the oldest first.

    Args:
        database: the database.
        network: name of the network.
        epoch: number of the epoch.
        more: rows of ``actions`` that are not in the database yet.
        others: whether also those of older records, which do not say of which epoch they are.
    """
    from sqlalchemy import select

    from .tables import actions

    wanted = select(actions).where(actions.c.action.in_(DECIDING)).order_by(actions.c.id)
    with database.reading() as connection:
        rows = [dict(r._mapping) for r in connection.execute(wanted)]
    out = []
    for row in [*rows, *(r for r in more if r["action"] in DECIDING)]:
        record = json.loads(row["data"])
        named = record.get("network", network), record.get("epoch", epoch if others else None)
        if named == (network, epoch):
            out.append(Decision.of(row, record))
    return out


def accepted_by_people(
    database: Database, network: str, epoch: int, *, more: Sequence[Row] = ()
) -> frozenset[str]:
    """Return the ids of the observations of an epoch that people have accepted.

    Args:
        database: the database.
        network: name of the network.
        epoch: number of the epoch.
        more: rows of ``actions`` that are not in the database yet.
    """
    found = epoch_decisions(database, network, epoch, more=more, others=True)
    return frozenset(i for d in found if d.do == "accept" and d.by != SEARCHER for i in d.ids)
