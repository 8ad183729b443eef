"""Sites for tests: the yard as a site, its networks alive, its API without a socket."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

from factorgraph_adj.site.api import application
from factorgraph_adj.site.live_network import LiveNetwork
from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import read_site
from tests.networks.projects import write
from tests.networks.yard import YARD
from tests.support.postgresql import server

SITE = """\
[site]
name = "Yard"
database = "{database}"
[[network]]
name = "yard"
project = "yard"
policy = "reject"
epochs = "{epochs}"
objects = ["C"]
"""
ADDRESS = "/api/v1/networks/yard"

HOUR = 3600.0
BEGIN = 1_700_002_800.0
"""Time of the first epoch of an hour, seconds UTC."""
ALARM = """
[[alarm]]
name = "wall"
points = ["C"]
false_alarms_per_month = 0.01
notify = ["mailto:chief@example.org"]
[smtp]
host = "127.0.0.1"
port = 9
security = "none"
sender = "site@example.org"
"""
"""An alarm of the yard about C, and a mail server that does not answer."""

STORES = ("sqlite", "postgresql")
"""Databases of sites; tests that take the fixture ``store`` run on each."""
_store = "sqlite"


@contextmanager
def storing_in(store: str) -> Iterator[None]:
    """Let sites that begin meanwhile have their database in this store."""
    global _store
    before, _store = _store, store
    if store == "postgresql":
        server()
    try:
        yield
    finally:
        _store = before


def new_database(folder: Path) -> str:
    """Return what a site file in a folder says of a new database."""
    return server().new_database() if _store == "postgresql" else "site.sqlite"


def yard_site(folder: Path, *, epochs: str = "by hand", more: str = "") -> Path:
    """Write the yard as a site, and return the folder."""
    if not (folder / "site.toml").exists():
        write(folder / "yard", YARD)
        text = SITE.format(epochs=epochs, database=new_database(folder)) + more
        (folder / "site.toml").write_text(text)
    return folder


def database_of(folder: Path) -> str:
    """Return the address of the database of a site, which is made where there is none."""
    return read_site(yard_site(folder)).database


@contextmanager
def site_of(folder: Path, **options: str) -> Iterator[Site]:
    """Give a running site of the yard, which ends with the context."""
    site = Site(read_site(yard_site(folder, **options)))
    site.start()
    try:
        yield site
    finally:
        site.stop()


@contextmanager
def served(folder: Path, **options: str) -> Iterator[TestClient]:
    """Give a client of a running site of the yard."""
    site = Site(read_site(yard_site(folder, **options)))
    with TestClient(application(site)) as client:
        yield client


def yard_of(site: Site) -> LiveNetwork:
    """Return the network of the yard."""
    return site.networks["yard"]


@contextmanager
def served_project(
    folder: Path, name: str, *, objects: Sequence[str] = (), policy: str = "reject"
) -> Iterator[TestClient]:
    """Give a client of a running site whose only network is the project in ``folder/project``."""
    lines = ["[site]", f'database = "{new_database(folder)}"', "[[network]]", f'name = "{name}"']
    lines += ['project = "project"', f'policy = "{policy}"', f"objects = {json.dumps([*objects])}"]
    (folder / "site.toml").write_text("\n".join(lines) + "\n")
    with TestClient(application(Site(read_site(folder)))) as client:
        yield client


def readings(hour: int, rise: float = 0.0, seed: int = 0) -> list[dict[str, Any]]:
    """One epoch: levelled differences, distances and directions to C, which has risen by metres."""
    rng = np.random.default_rng([seed, hour])
    time = BEGIN + HOUR * hour + 600.0
    out: list[dict[str, Any]] = [
        {
            "kind": "height_difference",
            "station": a,
            "target": "C",
            "value": round(z + rise + rng.normal(0.0, 0.0005), 6),
        }
        for a, z in (("A", 1.4996), ("A", 1.4996), ("B", 0.4996))
    ]
    out += [
        {
            "kind": "slope_distance",
            "station": a,
            "target": "C",
            "value": round(s + rng.normal(0.0, 0.002), 6),
        }
        for a, s in (("A", 58.3268), ("B", 70.7141), ("A", 58.3268))
    ]
    out += [
        {
            "kind": "direction",
            "station": "A",
            "target": target,
            "value": round((angle + rng.normal(0.0, 0.001)) % 400.0, 6),
        }
        for target, angle in (("B", 0.0), ("C", 334.4035))
    ]
    return [{**o, "time": time} for o in out]


def until(happens: Callable[[], Any], seconds: float = 20.0) -> Any:
    """Wait until something happens, and return what it gives."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if found := happens():
            return found
        time.sleep(0.05)
    raise AssertionError(f"did not happen in {seconds} s")
