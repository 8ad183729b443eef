"""Tables of the database of a site, the same in SQLite and PostgreSQL.

Times are seconds since 1970-01-01 UTC. Texts named ``data``, ``settings``, ``result`` and
``answer`` are JSON. The migrations in ``migrations/versions`` create and change the tables; tests
compare them with these definitions, and `REVISION` with the newest of them.
"""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    Column,
    Float,
    ForeignKey,
    Index,
    Integer,
    MetaData,
    String,
    Table,
    Text,
    UniqueConstraint,
)

REVISION = "0004"
"""Revision of these tables: that of the newest migration."""
MAX_LETTERS_OF_NAME = 200
"""Largest number of characters of names and of requests."""

NAMES = {
    "ix": "ix_%(table_name)s_%(column_0_N_name)s",
    "uq": "uq_%(table_name)s_%(column_0_N_name)s",
    "fk": "fk_%(table_name)s_%(column_0_N_name)s",
    "pk": "pk_%(table_name)s",
}
"""Names of constraints, which migrations need."""
metadata = MetaData(naming_convention=NAMES)
"""All tables."""
Number = BigInteger().with_variant(Integer, "sqlite")
"""Type of numbers that the database gives, which SQLite only does for INTEGER."""
Name = String(MAX_LETTERS_OF_NAME)
"""Type of names."""

networks = Table(
    "networks",
    metadata,
    Column("id", Number, primary_key=True),
    Column("name", Name, nullable=False, unique=True),
    Column("settings", Text, nullable=False),
    Column("begun", Float(53), nullable=False),
)
"""The networks of the site."""

epochs = Table(
    "epochs",
    metadata,
    Column("id", Number, primary_key=True),
    Column("network", Number, ForeignKey("networks.id"), nullable=False),
    Column("number", Integer, nullable=False),
    Column("begin", Float(53), nullable=False),
    Column("end", Float(53)),
    Column("state", String(20), nullable=False),
    Column("revision", Integer, nullable=False, default=0),
    Column("summary", Text),
    Column("result", Text),
    UniqueConstraint("network", "number"),
)
"""The epochs of a network: ``state`` is open, closed, or reopened (late readings came, and their
result is not there yet). ``summary``, ``result`` and the rows of ``point_results`` are together the
result of the last revision, see `factorgraph_adj.site.result_columns`."""

point_results = Table(
    "point_results",
    metadata,
    Column("epoch", Number, ForeignKey("epochs.id"), primary_key=True),
    Column("point", Text, primary_key=True),
    Column("data", Text, nullable=False),
)
"""What the results of epochs say of each point."""

journal = Table(
    "journal",
    metadata,
    Column("epoch", Number, ForeignKey("epochs.id"), primary_key=True),
    Column("line", Integer, primary_key=True),
    Column("text", Text, nullable=False),
)
"""Lines of the journals of all epochs, as in a journal file."""

requests = Table(
    "requests",
    metadata,
    Column("id", Number, primary_key=True),
    Column("network", Number, ForeignKey("networks.id"), nullable=False),
    Column("request", Name, nullable=False),
    Column("digest", String(64), nullable=False),
    Column("at", Float(53), nullable=False),
    Column("answer", Text, nullable=False),
    UniqueConstraint("network", "request"),
    Index("ix_requests_at", "at"),
)
"""What was asked and answered, so that a repeated request changes nothing."""

measured_sets = Table(
    "measured_sets",
    metadata,
    Column("id", Number, primary_key=True),
    Column("network", Number, ForeignKey("networks.id"), nullable=False),
    Column("epoch", Integer, nullable=False),
    Column("instrument", Name, nullable=False),
    Column("begin", Float(53), nullable=False),
    Column("end", Float(53), nullable=False),
    Column("round", Integer, nullable=False),
    Index("ix_measured_sets_end", "network", "instrument", "end"),
    Index("ix_measured_sets_epoch", "network", "epoch"),
)
"""Sets of instruments: when each was measured, and the number of its epoch."""

monitors = Table(
    "monitors",
    metadata,
    Column("network", Number, ForeignKey("networks.id"), primary_key=True),
    Column("digest", String(64), nullable=False),
    Column("data", Text, nullable=False),
)
"""State of the monitor of a network after the last epoch that it has seen, and the digest of the
settings to which it belongs."""

events = Table(
    "events",
    metadata,
    Column("id", Number, primary_key=True),
    Column("network", Number, ForeignKey("networks.id")),
    Column("at", Float(53), nullable=False),
    Column("kind", String(40), nullable=False),
    Column("data", Text, nullable=False),
    Index("ix_events_at", "at"),
    sqlite_autoincrement=True,
)
"""What happened, in order; browsers follow it."""

alarms = Table(
    "alarms",
    metadata,
    Column("id", Number, primary_key=True),
    Column("network", Number, ForeignKey("networks.id")),
    Column("rule", Name, nullable=False),
    Column("subject", Name, nullable=False),
    Column("raised", Float(53), nullable=False),
    Column("cleared", Float(53)),
    Column("acknowledged", Float(53)),
    Column("acknowledged_by", Name),
    Column("silenced_until", Float(53)),
    Column("data", Text, nullable=False),
    Index("ix_alarms_rule_subject", "rule", "subject"),
)
"""Alarms: by which rule, about which point, network or instrument."""

notices = Table(
    "notices",
    metadata,
    Column("id", Number, primary_key=True),
    Column("alarm", Number, ForeignKey("alarms.id"), nullable=False),
    Column("target", Text, nullable=False),
    Column("created", Float(53), nullable=False),
    Column("due", Float(53)),
    Column("tries", Integer, nullable=False, default=0),
    Column("sent", Float(53)),
    Column("problem", Text),
    Column("data", Text, nullable=False),
    Index("ix_notices_sent_due", "sent", "due"),
)
"""Messages about alarms: sent, due, or given up where nothing is due."""

tokens = Table(
    "tokens",
    metadata,
    Column("id", Number, primary_key=True),
    Column("name", Name, nullable=False, unique=True),
    Column("role", String(20), nullable=False),
    Column("digest", String(64), nullable=False, unique=True),
    Column("created", Float(53), nullable=False),
    Column("expires", Float(53)),
    Column("revoked", Float(53)),
)
"""Tokens of access; only their digests are kept."""

actions = Table(
    "actions",
    metadata,
    Column("id", Number, primary_key=True),
    Column("at", Float(53), nullable=False),
    Column("who", Name, nullable=False),
    Column("action", Name, nullable=False),
    Column("data", Text, nullable=False),
    Index("ix_actions_at", "at"),
)
"""Who did what: accepted an observation, acknowledged an alarm, made a token."""
