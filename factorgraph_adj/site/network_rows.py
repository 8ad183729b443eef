"""Rows of networks in the database: their ids, and when their first reading was measured."""

from __future__ import annotations

from .database import Database


def network_row(database: Database, name: str) -> tuple[int, float]:
    """Return id and begin of a network, seconds UTC, 0 before its first reading.

    Args:
        database: the database, in which the network gets a row where it has none.
        name: name of the network.
    """
    from sqlalchemy import insert, select

    from .tables import networks

    with database.writing() as connection:
        found = connection.execute(select(networks).where(networks.c.name == name)).first()
        if found is not None:
            return int(found.id), float(found.begun)
        row = {"name": name, "settings": "{}", "begun": 0.0}
        (key,) = connection.execute(insert(networks).values(**row)).inserted_primary_key or (0,)
        return int(key), 0.0


def record_begin(database: Database, network: int, time: float) -> float:
    """Record when the first reading was measured, with which the first epoch begins; return it.

    Args:
        database: the database.
        network: id of the network.
        time: seconds UTC.
    """
    from sqlalchemy import update

    from .tables import networks

    with database.writing() as connection:
        change = update(networks).where(networks.c.id == network)
        connection.execute(change.values(begun=time))
    return time
