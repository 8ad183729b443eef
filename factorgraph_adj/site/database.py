"""Database of a site: SQLite in WAL mode, or PostgreSQL; its migrations and transactions.

A transaction is on the disk when it ends (``synchronous = FULL`` in SQLite; PostgreSQL by its own
default): what was acknowledged after that survives a loss of power. One process serves a database
at a time; a second one is refused. In PostgreSQL it writes on the connection that holds the
database: where that was lost and another process has taken the database, nothing is written.
"""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import AdjustmentError, InputError, Problem, system_reason

if sys.platform != "win32":
    import fcntl
if TYPE_CHECKING:
    from sqlalchemy import Connection, Engine

EXTRA_MISSING = "the service of a site needs further packages: pip install 'factorgraph_adj[serve]'"
"""Message where the extra is missing."""
BUSY_SECONDS = 10.0
"""Time to wait for another program that locks tables or the file, seconds."""
MIGRATIONS = Path(__file__).parent / "migrations"
"""Folder of the migrations."""
CONNECT_SECONDS = 5
"""Time after which a server of PostgreSQL that does not answer is away, seconds."""
ADVISORY_LOCK = 0x66_67_61_73
"""Number of the lock by which a service holds a database of PostgreSQL."""


class DatabaseAway(AdjustmentError):
    """The database cannot be read or written at present."""


class Database:
    """An open database, which this process alone serves."""

    def __init__(self, url: str | Path, *, serve: bool = True) -> None:
        """Open a database, and create or upgrade its tables.

        Args:
            url: path of a file for SQLite, or ``postgresql+psycopg://user@host/name``.
            serve: whether this process serves the database, which only one may.

        Raises:
            InputError: the extra is missing, the database cannot be opened, is of a newer version,
                or is served by another process; a password stands in its address.
        """
        try:
            from sqlalchemy import create_engine, event
            from sqlalchemy.engine import make_url
            from sqlalchemy.exc import ArgumentError, SQLAlchemyError
        except ImportError:
            raise InputError(EXTRA_MISSING) from None
        text = str(url)
        self.path = None if "://" in text else Path(text)
        """File of SQLite; None for PostgreSQL."""
        try:
            made = make_url(text if self.path is None else f"sqlite:///{self.path.resolve()}")
        except (ArgumentError, ValueError):  # the text may have a password
            place = f"{text.partition('://')[0]}://…"
            raise InputError(Problem("is no address of a database", place)) from None
        self.where = made.render_as_string(hide_password=True) if self.path is None else text
        """Address for messages, without password."""
        if made.password is not None or "password" in made.query:
            what = (
                "a password does not stand in an address, which files and archives show: set "
                "PGPASSWORD, or state a file as ?passfile=FILE"
            )
            raise InputError(Problem(what, made.set(query={}).render_as_string()))
        self._lock, self._serves = threading.Lock(), serve
        self._held: int | None = None
        self._writer: Connection | None = None
        options: dict[str, Any]
        if self.path is None:
            patience = {
                "connect_timeout": CONNECT_SECONDS,
                "tcp_user_timeout": 2000 * CONNECT_SECONDS,
                "options": f"-c lock_timeout={1000 * BUSY_SECONDS:.0f}",
            }
            options = {"pool_pre_ping": True, "connect_args": patience}
        else:
            options = {"connect_args": {"timeout": BUSY_SECONDS, "check_same_thread": False}}
        try:
            self.engine: Engine = create_engine(made, **options)
        except ImportError as error:
            what = f"needs {error.name}: pip install 'factorgraph_adj[postgresql]'"
            raise InputError(Problem(what, self.where)) from None
        except SQLAlchemyError as error:
            raise InputError(Problem(reason_of(error), self.where)) from None
        """Engine of SQLAlchemy."""
        if self.path is not None:
            event.listen(self.engine, "connect", _prepare_sqlite)
            event.listen(self.engine, "begin", _begin_sqlite)
        try:
            if serve:
                self._hold()
            self._upgrade()
        except BaseException as error:
            self.close()
            if isinstance(error, SQLAlchemyError):
                what = f"cannot be opened as a database of a site: {reason_of(error)}"
                raise InputError(Problem(what, self.where)) from None
            raise

    def _hold(self) -> None:
        """Hold the database for this process.

        Raises:
            InputError: another process holds it.
        """
        taken = "is served by another process already: stop that one first"
        if self.path is None:
            self._writer = self._holding_connection()
            if self._writer is None:
                raise InputError(Problem(taken, self.where))
            return
        try:
            descriptor = os.open(f"{self.path}.lock", os.O_RDWR | os.O_CREAT, 0o600)
        except OSError as error:
            what = f"cannot be opened: {system_reason(error)}"
            raise InputError(Problem(what, f"{self.path}.lock")) from None
        if sys.platform != "win32":
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                os.close(descriptor)
                raise InputError(Problem(taken, self.where)) from None
        self._held = descriptor

    def _holding_connection(self) -> Connection | None:
        """Return a connection that holds a database of PostgreSQL; None where another one does."""
        from sqlalchemy import text

        connection = self.engine.connect()
        wanted = text("select pg_try_advisory_lock(:number)").bindparams(number=ADVISORY_LOCK)
        try:
            got = connection.execute(wanted).scalar()
            connection.commit()
        except BaseException:
            connection.invalidate()
            connection.close()
            raise
        if got:
            return connection
        connection.close()
        return None

    def _upgrade(self) -> None:
        """Bring the tables to this version; only who serves a database changes tables that it has.

        Raises:
            InputError: the database is of a newer version, or of an older one that is not served.
        """
        from .tables import REVISION

        with self._lock, self.engine.connect() as connection:
            there = self.revision(connection)
            if there == REVISION:  # alembic is imported where tables change: its import is slow
                return
            if not self._serves and there is not None:
                what = (
                    f"has tables of revision {there}, not {REVISION}: serve it with this version "
                    "first"
                )
                raise InputError(Problem(what, self.where))
            self._migrate(connection)
            connection.commit()

    def _migrate(self, connection: Connection) -> None:
        """Create the tables, or bring them from an older revision to this one.

        Raises:
            InputError: the database is of a newer version.
        """
        from alembic import command
        from alembic.config import Config
        from alembic.util import CommandError

        config = Config()
        config.set_main_option("script_location", str(MIGRATIONS))
        config.attributes["connection"] = connection
        try:
            command.upgrade(config, "head")
        except CommandError as error:
            what = f"was made by a newer version of this program ({error}): upgrade the program"
            raise InputError(Problem(what, self.where)) from None

    @contextmanager
    def reading(self) -> Iterator[Connection]:
        """Give a connection for reading.

        Raises:
            DatabaseAway: the database cannot be read.
            InputError: something is asked for that no column can hold.
        """
        from sqlalchemy.exc import DataError, SQLAlchemyError

        try:
            with self.engine.connect() as connection:
                yield connection
        except DataError as error:
            what = f"the database holds nothing of the kind: {reason_of(error)}"
            raise InputError(what) from None
        except SQLAlchemyError as error:
            raise DatabaseAway(f"{self.where}: {reason_of(error)}") from None

    @contextmanager
    def writing(self) -> Iterator[Connection]:
        """Give a connection in a transaction; when this ends, all of it is on the disk, or none.

        Raises:
            DatabaseAway: the database cannot be written; nothing was.
        """
        from sqlalchemy.exc import SQLAlchemyError

        try:
            with self._lock, self._writing_connection() as connection, connection.begin():
                yield connection
        except SQLAlchemyError as error:
            raise DatabaseAway(f"{self.where}: {reason_of(error)}") from None

    @contextmanager
    def _writing_connection(self) -> Iterator[Connection]:
        """Give the connection on which transactions are written."""
        if self.path is not None or not self._serves:
            with self.engine.connect() as connection:
                yield connection.execution_options(writes=True)
            return
        if self._writer is None:
            self._writer = self._holding_connection()
        if self._writer is None:
            raise DatabaseAway(f"{self.where}: another process serves it now: stop one of them")
        try:
            yield self._writer
        finally:
            if self._writer.invalidated:
                lost, self._writer = self._writer, None
                with suppress(Exception):
                    lost.close()

    def revision(self, connection: Connection) -> str | None:
        """Return the revision of the tables; None: there are none."""
        from sqlalchemy import inspect, text

        if not inspect(connection).has_table("alembic_version"):
            return None
        found = connection.execute(text("select version_num from alembic_version")).scalar()
        return None if found is None else str(found)

    def number_on(self, connection: Connection) -> None:
        """Let numbers that the database gives go on after those of rows that were written."""
        from sqlalchemy import text

        from .tables import metadata

        if self.path is not None:  # SQLite counts on by itself
            return
        for table in metadata.sorted_tables:
            if "id" in table.c:
                sequence = f"pg_get_serial_sequence('{table.name}', 'id')"
                largest = f"(select max(id) from {table.name})"
                connection.execute(text(f"select setval({sequence}, {largest})"))

    def close(self) -> None:
        """Give the database back."""
        from sqlalchemy import text

        held, self._held = self._held, None
        if held is not None:
            os.close(held)
        writer, self._writer = self._writer, None
        if writer is not None:
            with suppress(Exception):
                # The server notices only later that a connection has ended.
                writer.execute(text("select pg_advisory_unlock_all()"))
                writer.commit()
            with suppress(Exception):
                writer.close()
        self.engine.dispose()


def at_one_moment(connection: Connection) -> None:
    """Let a transaction read all tables as they are when it begins; SQLite always does."""
    from sqlalchemy import text

    if connection.dialect.name == "postgresql":
        connection.execute(text("set transaction isolation level repeatable read"))


def reason_of(error: Exception) -> str:
    """Return the reason of an error of the database, on one line and without the statement."""
    inner = getattr(error, "orig", None) or error
    return " ".join(str(inner).split())[:300]


def _prepare_sqlite(connection: Any, _record: object) -> None:
    """Set up a connection of SQLite; transactions are begun by `_begin_sqlite` alone."""
    connection.isolation_level = None
    cursor = connection.cursor()
    for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _begin_sqlite(connection: Any) -> None:
    """Begin a transaction; one that writes takes its place at once, so that it cannot fail late."""
    writes = connection.get_execution_options().get("writes", False)
    connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")
