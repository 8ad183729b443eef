"""Decisions about observations of an epoch: who accepted, rejected or changed which, and when."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, TypeAlias

from ..errors import InputError
from ..incremental.adjustment import IncrementalAdjustment
from .database import Database
from .epoch_search import SEARCHER
from .postings import named_ids

DECIDING = ("accept", "discard", "revoke", "remove", "replace", "reweight", "snoop")
"""Commands that decide about observations."""
REVOCABLE = ("accept", "discard")
"""Those of them that ``revoke`` takes back, the last one of each observation."""
MAX_LABELS = 200
"""Largest number of observations whose names are recorded with a decision."""

Row = Mapping[str, Any]
Standing: TypeAlias = "Mapping[str, tuple[Decision, ...]]"
"""Decisions about observations that were not taken back, by ids, the last one last."""
NOTHING_STANDS: Standing = {}


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
    """The observations that it names, and those of their groups; none for a search among all."""
    labels: Mapping[str, str]
    """Readable names of the observations, by ids."""

    @classmethod
    def of(cls, row: Row, record: Row) -> Decision:
        """Read a decision.

        Args:
            row: its row of the table ``actions``.
            record: the content of its column ``data``.
        """
        named, labels = named_ids(record).get("ids", ()), record.get("labels", {})
        ids = tuple(dict.fromkeys((*named, *labels)))
        return cls(float(row["at"]), row["who"], row["action"], ids, labels)

    def shown(self, standing: Standing = NOTHING_STANDS) -> dict[str, Any]:
        """Return what the API shows, with those of its ids for which people can take it back."""
        out = {"at": self.at, "by": self.by, "do": self.do, "ids": [*self.ids]}
        own = [i for i in self.ids if self.by != SEARCHER and standing.get(i, ())[-1:] == (self,)]
        return out | {"labels": dict(self.labels), "revocable": own}


def decision_record(
    record: Row, network: str, epoch: int, labels: Mapping[str, str] | None = None
) -> dict[str, Any]:
    """Return what is recorded of a command that decides.

    Args:
        record: its fields.
        network: name of the network.
        epoch: number of the epoch.
        labels: readable names of observations by ids, see `labels_of`; None: none are kept.
    """
    return {**record, "network": network, "epoch": epoch, "labels": labels or {}}


def labels_of(inc: IncrementalAdjustment, record: Row) -> dict[str, str]:
    """Return readable names of the observations that a command is about, as far as they are there.

    Acceptance, rejection and their revocation of one of a correlated group are of all of it.

    Args:
        inc: the adjustment before the command: what it removes has no name afterwards.
        record: the fields of the command, which have not been checked yet.
    """
    out: dict[str, str] = {}
    ids = named_ids(record).get("ids")
    of_groups = record.get("do") in (*REVOCABLE, "revoke")
    for ident in ids[:MAX_LABELS] if isinstance(ids, list) else ():
        with suppress(InputError):
            named = [ident] if isinstance(ident, str) else []
            every = inc.with_groups(named) if of_groups else named
            out |= {i: inc.observation(i).label() for i in every}
    return out


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
    return frozenset(
        ident
        for ident, own in standing_decisions(found).items()
        if any(d.do == "accept" and d.by != SEARCHER for d in own)
    )


def last_decisions(decisions: Sequence[Decision]) -> dict[str, Decision]:
    """Return the last decision about each observation that was not taken back, by ids.

    Args:
        decisions: all decisions about an epoch, the oldest first.
    """
    standing = standing_decisions(decisions)
    last = {ident: decision for decision in decisions for ident in decision.ids}
    left = {i: standing.get(i, ()) if d.do == "revoke" else (d,) for i, d in last.items()}
    return {ident: own[-1] for ident, own in left.items() if own}


def standing_decisions(decisions: Sequence[Decision]) -> Standing:
    """Return the decisions ``accept`` and ``discard`` that no later ``revoke`` has taken back.

    Args:
        decisions: all decisions about an epoch, the oldest first.
    """
    out: dict[str, tuple[Decision, ...]] = {}
    for decision in decisions:
        for ident in decision.ids:
            if decision.do in REVOCABLE:
                out[ident] = (*out.get(ident, ()), decision)
            elif decision.do == "revoke":
                out[ident] = out.get(ident, ())[:-1]
            else:  # it is another observation then, or none
                out.pop(ident, None)
    return out
