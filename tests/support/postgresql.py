"""A PostgreSQL server that the tests start for themselves, where the machine has its programs."""

from __future__ import annotations

import atexit
import itertools
import os
import pwd
import shutil
import subprocess
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

import pytest

USER = "fga"
"""Owner of the databases of the tests."""
USERS = ("postgres", "nobody")
"""Users as whom the server may run where the tests are root's, which PostgreSQL refuses."""
OPTIONS = {"listen_addresses": "''", "fsync": "off", "max_connections": "60"}
"""Of the server: it listens on a socket in its folder alone; no test cuts the power."""


class PostgresServer:
    """A server in a folder of its own, with a database for every site that asks."""

    def __init__(self, programs: Path) -> None:
        self.programs = programs
        self.folder = Path(tempfile.mkdtemp(prefix="fga-pg-"))
        self._as: dict[str, Any] = {}
        if os.name == "posix" and os.getuid() == 0:
            found = next(pwd.getpwnam(u) for u in USERS if _there(u))
            shutil.chown(self.folder, found.pw_uid, found.pw_gid)
            self._as = {"user": found.pw_uid, "group": found.pw_gid, "extra_groups": []}
        self._names = itertools.count(1)
        self._run("initdb", "-A", "trust", "-U", USER, "-E", "UTF8", "--no-sync", "-N")
        options = [f"{k} = {v}\n" for k, v in OPTIONS.items()]
        with (self.folder / "data" / "postgresql.conf").open("a") as conf:
            conf.writelines([*options, f"unix_socket_directories = '{self.folder}'\n"])
        atexit.register(self._end)
        self.start()

    def _run(self, program: str, *arguments: str) -> None:
        made = [str(self.programs / program), "-D", str(self.folder / "data"), *arguments]
        environment = {**os.environ, "LC_ALL": "C"}
        done = subprocess.run(
            *(made,),
            **self._as,
            env=environment,
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=120,
        )
        assert done.returncode == 0, done.stderr.decode()

    def start(self) -> None:
        """Start the server, which takes connections then."""
        log = str(self.folder / "log")
        self._run("pg_ctl", "-w", "-s", "-l", log, "start")

    def stop(self, mode: str = "fast") -> None:
        """Stop the server; ``immediate``: as a crash does."""
        self._run("pg_ctl", "-w", "-s", "-m", mode, "stop")

    def _end(self) -> None:
        if (self.folder / "data" / "postmaster.pid").exists():
            self.stop("immediate")
        shutil.rmtree(self.folder, ignore_errors=True)

    def address(self, name: str) -> str:
        """Return the address of a database."""
        return f"postgresql+psycopg://{USER}@/{name}?host={self.folder}"

    def new_database(self) -> str:
        """Make an empty database, and return its address."""
        import psycopg

        name = f"site{next(self._names)}"
        with psycopg.connect(
            f"user={USER} host={self.folder} dbname=postgres", autocommit=True
        ) as connection:
            connection.execute(f"create database {name}")
        return self.address(name)


def _there(user: str) -> bool:
    try:
        pwd.getpwnam(user)
    except KeyError:
        return False
    return True


def programs() -> Path | None:
    """Return the folder of the programs of the newest PostgreSQL of this machine."""
    known = [*Path("/usr/lib/postgresql").glob("*/bin"), *Path("/usr/local/pgsql").glob("bin")]
    known.sort(key=lambda p: [int(n) for n in p.parent.name.split(".") if n.isdigit()])
    if found := shutil.which("pg_ctl"):
        known.append(Path(found).resolve().parent)
    whole = [p for p in known if all((p / n).exists() for n in ("initdb", "pg_ctl", "postgres"))]
    return whole[-1] if whole else None


@cache
def _started() -> PostgresServer | None:
    found = programs()
    return None if found is None else PostgresServer(found)


def server() -> PostgresServer:
    """Return the server of this process of tests, or skip the test."""
    pytest.importorskip("psycopg")
    started = _started()
    if started is None:
        pytest.skip("no PostgreSQL on this machine: initdb, pg_ctl and postgres are not there")
    return started
