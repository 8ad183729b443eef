"""State of the monitor of a network in the database, so that a restart replays no epochs.

The state is written with the result of the epoch that it has seen last, in one transaction. It
belongs to rules and settings, of which it has a digest: where the site file states others, or an
older program has kept none, the monitor is made again from the estimates of all epochs, once.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from .database import Database

if TYPE_CHECKING:
    from sqlalchemy import Connection

State = dict[str, Any]
STATE_VERSION = 2
"""Version of the states that this program writes; others are made again."""


def state_digest(*settings: object) -> str:
    """Return the digest of what a state depends on beside the epochs."""
    return hashlib.sha256(repr((STATE_VERSION, *settings)).encode()).hexdigest()


def read_state(database: Database, network: int, digest: str) -> State | None:
    """Return the state of the monitor of a network; None: there is none of this digest.

    Args:
        database: the database.
        network: id of the network.
        digest: that of the settings now.

    Raises:
        DatabaseAway: the database cannot be read.
    """
    from sqlalchemy import select

    from .tables import monitors

    wanted = select(monitors.c.data).where(
        monitors.c.network == network, monitors.c.digest == digest
    )
    with database.reading() as connection:
        found = connection.execute(wanted).scalar()
    return None if found is None else dict(json.loads(found))


def write_state(connection: Connection, network: int, digest: str, state: State | None) -> None:
    """Write the state of the monitor of a network in a transaction; None: it has none.

    Args:
        connection: connection of the transaction.
        network: id of the network.
        digest: that of the settings.
        state: the state.
    """
    from sqlalchemy import delete, insert

    from .tables import monitors

    connection.execute(delete(monitors).where(monitors.c.network == network))
    if state is not None:
        row = {"network": network, "digest": digest, "data": json.dumps(state)}
        connection.execute(insert(monitors).values(**row))
