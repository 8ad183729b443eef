"""Alarms in the database: raised, acknowledged, silenced, cleared; messages that are to be sent.

An alarm stands from when it is raised until it is cleared, whatever people do: who acknowledges it
says that he knows, who silences it stops its messages for a time. One that was cleared before
anybody knew of it wants attention (``ended``) until it is acknowledged.
"""

from __future__ import annotations

import json
import time as clock
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from ..control_characters import one_line
from ..errors import InputError
from .database import Database

if TYPE_CHECKING:
    from sqlalchemy import Connection

WITHDRAWN = '"withdrawn": true'
"""How the data of an alarm in the database say that it was withdrawn."""
SILENCED_BY = "silenced_by"
"""Field of what an alarm says: who has silenced it."""
MAX_SILENCE_HOURS = 24.0 * 31.0
"""Longest time for which an alarm can be silenced, hours."""
MAX_LETTERS_OF_REMARK = 500
"""Largest number of characters of what somebody remarks about an alarm."""
STATES = ("standing", "ended", "all")
"""Lists of alarms: those that are not cleared, those that were before anybody acknowledged them."""
MAX_LISTED = 500
"""Largest number of alarms in a list."""

EPOCH_SECONDS = "epoch_seconds"
"""Field of alarms that epochs raise: length of an epoch, seconds; null: they end by hand or by
sets."""

Answer = dict[str, Any]


@dataclass(frozen=True)
class Raised:
    """An alarm that stands, by its rule."""

    rule: str
    """Name of the rule."""
    subject: str
    """The point or the instrument; nothing for the reference points of a network."""
    data: Answer
    """What it says: ``test``, ``value``, ``limit``, ``size_mm``, ``epoch``, ``text``; those of the
    epoch that raised it stay, those of the last one are its ``latest``."""
    notify: tuple[str, ...] = ()
    """Addresses that are told."""
    tested: int | None = None
    """Number of the epoch that was tested last; None: no epoch tells."""
    since: float = 0.0
    """Time of the epoch that raised it, seconds UTC."""
    until: float | None = None
    """Time of the epoch that cleared it; None: it stands."""
    latest: Answer | None = None
    """What its last epoch says; None: it has no other."""

    def is_at(self, begin: float, end: float | None) -> bool:
        """Return whether it stood at some time of an interval, which ends where ``end`` is None."""
        ends = self.until is not None and self.until < begin
        return not ends and (end is None or self.since <= end)


@dataclass
class AlarmChanges:
    """What a comparison of standing alarms with the database has changed."""

    events: list[Answer] = field(default_factory=list)
    """Alarms that were raised or cleared, as the API shows them."""


def reconcile(
    connection: Connection,
    network: int | None,
    name: str | None,
    rules: Iterable[str],
    standing: Sequence[Raised],
    at: float,
) -> AlarmChanges:
    """Make the open alarms of some rules those that stand, in a transaction.

    Args:
        connection: connection of the transaction.
        network: id of the network; None: of the site.
        name: its name.
        rules: names of all rules that were examined.
        standing: the alarms that stand.
        at: time of the change, seconds UTC.
    """
    from sqlalchemy import insert, select, update

    from .tables import alarms

    wanted = select(alarms).where(
        alarms.c.cleared.is_(None), alarms.c.network == network, alarms.c.rule.in_([*rules])
    )
    there = {(r.rule, r.subject): r for r in connection.execute(wanted)}
    out, now = AlarmChanges(), {(s.rule, s.subject): s for s in standing}
    for key, row in there.items():
        if key in now:
            tested = {} if now[key].tested is None else {"epoch": now[key].tested}
            latest = json.dumps(json.loads(row.data) | {"latest": now[key].data | tested})
            connection.execute(update(alarms).where(alarms.c.id == row.id).values(data=latest))
            continue
        data = json.loads(row.data)
        # What its own epoch clears when that is computed again never was.
        data |= withdrawal(data, row.rule) if at <= row.raised else {}
        values = {"cleared": at, "data": json.dumps(data)}
        connection.execute(update(alarms).where(alarms.c.id == row.id).values(**values))
        out.events.append(shown(dict(row._mapping) | values, name))
        addresses = data.get("notify", [])
        if row.silenced_until is None or row.silenced_until <= at:
            _tell(connection, row.id, addresses, out.events[-1])
    for key, found in now.items():
        if key in there:
            continue
        data = {**found.data, "notify": list(found.notify)}
        values = {"network": network, "rule": found.rule, "subject": found.subject, "raised": at}
        made = connection.execute(insert(alarms).values(**values, data=json.dumps(data)))
        (number,) = made.inserted_primary_key or (0,)
        row_now = {"id": number, **values, "data": json.dumps(data), "cleared": None}
        row_now |= {"acknowledged": None, "acknowledged_by": None, "silenced_until": None}
        out.events.append(shown(row_now, name))
        _tell(connection, number, found.notify, out.events[-1])
    return out


def revise(
    connection: Connection,
    network: int,
    name: str,
    rules: Iterable[str],
    episodes: Sequence[Raised],
    at: float,
    by: int,
) -> AlarmChanges:
    """Make the alarms of a network since an epoch those that its late readings leave.

    Each alarm that is recorded is that of the episode which stood at the same time. One without an
    episode is withdrawn, an episode without an alarm is recorded; both are told.

    Args:
        connection: connection of the transaction.
        network: id of the network.
        name: its name.
        rules: names of all rules that were examined.
        episodes: all alarms of the network, as its epochs are now.
        at: time of the epoch, seconds UTC.
        by: its number.
    """
    from sqlalchemy import insert, select, update

    from .tables import alarms

    why = f"revised after late readings of epoch {by}, or decisions about it"
    wanted = select(alarms).where(alarms.c.network == network, alarms.c.rule.in_([*rules]))
    rows = [dict(r._mapping) for r in connection.execute(wanted.order_by(alarms.c.raised))]
    out, left = AlarmChanges(), list(episodes)

    def change(row: dict[str, Any], data: Answer, *, tells: bool, **values: object) -> None:
        values["data"] = json.dumps(data | {"revised": why})
        connection.execute(update(alarms).where(alarms.c.id == row["id"]).values(**values))
        out.events.append(shown(row | values, name))
        silenced = row["silenced_until"] is not None and row["silenced_until"] > clock.time()
        if tells and not silenced:
            _tell(connection, row["id"], data.get("notify", []), out.events[-1])

    for row in rows:
        data, key = json.loads(row["data"]), (row["rule"], row["subject"])
        stood = row["raised"], row["cleared"]
        same = [e for e in left if (e.rule, e.subject) == key and e.is_at(*stood)]
        if same:
            left.remove(same[0])
            own = {k: v for k, v in data.items() if k != "withdrawn"} | same[0].data
            # What an older service did not record is no change of the alarm.
            differs = any(own.get(name) != value for name, value in data.items())
            if (same[0].since, same[0].until) != stood or differs:
                own |= {} if same[0].latest is None else {"latest": same[0].latest}
                tells = (row["cleared"] is None) != (same[0].until is None)
                change(row, own, tells=tells, raised=same[0].since, cleared=same[0].until)
        elif (row["cleared"] is None or row["cleared"] >= at) and not data.get("withdrawn"):
            until, said = row["cleared"] or row["raised"], withdrawal(data, row["rule"])
            change(row, data | said, tells=row["cleared"] is None, cleared=until)
    for found in (e for e in left if e.is_at(at, None)):
        latest = {} if found.latest is None else {"latest": found.latest}
        data = {**found.data, **latest, "notify": list(found.notify), "revised": why}
        row = {"network": network, "rule": found.rule, "subject": found.subject}
        row |= {"raised": found.since, "cleared": found.until, "data": json.dumps(data)}
        made = connection.execute(insert(alarms).values(**row))
        (number,) = made.inserted_primary_key or (0,)
        nobody = dict.fromkeys(("acknowledged", "acknowledged_by", "silenced_until"))
        out.events.append(shown({"id": number, **row, **nobody}, name))
        _tell(connection, number, found.notify, out.events[-1])
    return out


def withdrawal(data: Mapping[str, Any], rule: str) -> Answer:
    """Return what an alarm says that never was: its epoch has other observations now.

    Args:
        data: what it has said.
        rule: name of its rule.
    """
    return {"text": f"withdrawn: {data.get('text', rule)}", "withdrawn": True}


def _tell(connection: Connection, alarm: int, addresses: Sequence[str], said: Answer) -> None:
    """Note the messages that are to be sent."""
    from sqlalchemy import insert

    from .tables import notices

    now, text = clock.time(), json.dumps(said)
    rows = [
        {"alarm": alarm, "target": a, "created": now, "due": now, "tries": 0, "data": text}
        for a in addresses
    ]
    if rows:
        connection.execute(insert(notices), rows)


def shown(row: Mapping[str, Any], network: str | None) -> Answer:
    """Return an alarm as the API shows it.

    ``by`` acknowledged it, ``silenced_by`` silenced it; who did neither is None. ``since`` and
    ``until`` are times of epochs, which are their middles; ``epoch_begin`` and
    ``epoch_end`` are the bounds of the epoch that raised it, where its epochs have a length. Where
    epochs end by hand or by sets, ``since`` and ``until`` are their begins.

    Args:
        row: its row.
        network: name of its network.
    """
    data: Answer = json.loads(row["data"])
    data.pop("notify", None)
    silenced = row["silenced_until"]
    state = "open" if row["acknowledged"] is None else "acknowledged"
    if silenced is not None and silenced > clock.time():
        state = "silenced"
    if row["cleared"] is not None:
        state = "closed"
    own: Answer = {"id": row["id"], "rule": row["rule"], "network": network, "state": state}
    own |= {"points": [row["subject"]] if row["subject"] else []}
    known = None if row["acknowledged"] is None else row["acknowledged_by"]
    own |= {"since": row["raised"], "until": row["cleared"], "by": known}
    # Older rows have who silenced it where who acknowledged it stands, if nobody did.
    silencer = data.pop(SILENCED_BY, row["acknowledged_by"] if known is None else None)
    own |= {SILENCED_BY: None if silenced is None else silencer}
    if half := 0.5 * (data.get(EPOCH_SECONDS) or 0.0):
        own |= {"epoch_begin": row["raised"] - half, "epoch_end": row["raised"] + half}
    return data | own | {"acknowledged": row["acknowledged"], "silenced_until": silenced}


class AlarmLog:
    """The alarms of a site, for those who read them and decide."""

    def __init__(self, database: Database, names: Mapping[int, str]) -> None:
        """Take the database, and names of networks by id."""
        self._database, self._names = database, names

    def listed(
        self, *, state: str = "standing", network: int | None = None, point: str = ""
    ) -> list[Answer]:
        """Return alarms, the latest first.

        Args:
            state: ``standing`` (all that are not cleared), ``ended`` (cleared, and acknowledged by
                nobody, but not withdrawn) or ``all``.
            network: id of a network; None: of all.
            point: only those of this point; with ``standing``, all that it has had.

        Raises:
            InputError: unknown state.
        """
        from sqlalchemy import select

        from .tables import alarms

        if state not in STATES:
            raise InputError(f"unknown state {state!r}; valid: {', '.join(STATES)}")
        wanted = select(alarms).order_by(alarms.c.raised.desc(), alarms.c.id.desc())
        if state == "ended":
            wanted = wanted.where(alarms.c.cleared.is_not(None), alarms.c.acknowledged.is_(None))
            wanted = wanted.where(alarms.c.data.not_like(f"%{WITHDRAWN}%"))
        elif state == "standing" and not point:
            wanted = wanted.where(alarms.c.cleared.is_(None))
        if network is not None:
            wanted = wanted.where(alarms.c.network == network)
        if point:
            wanted = wanted.where(alarms.c.subject == point)
        with self._database.reading() as connection:
            rows = connection.execute(wanted.limit(MAX_LISTED)).all()
        return [self._shown(r) for r in rows]

    def acknowledge(self, number: int, who: str, remark: str = "") -> Answer:
        """Note that somebody knows of an alarm, which stands or has been cleared.

        Args:
            number: its id.
            who: who knows of it.
            remark: what he remarks; empty: nothing.

        Raises:
            InputError: there is no such alarm, somebody else has acknowledged it, or it was cleared
                and acknowledged before; the remark is too long.
        """
        said = {"remark": text} if (text := one_line(remark).strip()) else {}
        if len(text) > MAX_LETTERS_OF_REMARK:
            raise InputError(f"remark has more than {MAX_LETTERS_OF_REMARK} characters")
        return self._change(number, said, acknowledged=clock.time(), acknowledged_by=who)

    def silence(self, number: int, who: str, hours: float) -> Answer:
        """Send no messages about an alarm for a time.

        Raises:
            InputError: there is no such alarm, it is cleared, or the time is too long.
        """
        if not 0.0 <= hours <= MAX_SILENCE_HOURS:
            raise InputError(f"hours must be 0 to {MAX_SILENCE_HOURS:g}, not {hours:g}")
        until = clock.time() + 3600.0 * hours
        return self._change(number, {SILENCED_BY: who}, silenced_until=until)

    def _change(self, number: int, said: Answer, **values: object) -> Answer:
        """Change the row of an alarm, and add to what it says; return it as it is then."""
        from sqlalchemy import select, update

        from .tables import alarms

        with self._database.writing() as connection:
            row = connection.execute(select(alarms).where(alarms.c.id == number)).first()
            if row is None:
                raise InputError(f"no alarm {number}")
            if row.cleared is not None and "acknowledged" not in values:
                raise InputError(f"alarm {number} is cleared")
            if row.cleared is not None and row.acknowledged is not None:
                raise InputError(f"alarm {number} is cleared, and was acknowledged")
            if "acknowledged" in values and row.acknowledged is not None:
                if row.acknowledged_by != values["acknowledged_by"]:
                    raise InputError(f"alarm {number} was acknowledged by {row.acknowledged_by}")
                values["acknowledged"] = row.acknowledged
            if said:
                values["data"] = json.dumps(json.loads(row.data) | said)
            connection.execute(update(alarms).where(alarms.c.id == number).values(**values))
            row = connection.execute(select(alarms).where(alarms.c.id == number)).one()
        return self._shown(row)

    def _shown(self, row: Any) -> Answer:
        return shown(dict(row._mapping), self._names.get(row.network or 0))
