"""Sites for tests: the yard as a site, its networks alive, its API without a socket."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from fastapi.testclient import TestClient

from factorgraph_adj.site.api import application
from factorgraph_adj.site.live_network import LiveNetwork
from factorgraph_adj.site.site import Site
from factorgraph_adj.site.site_file import read_site
from tests.networks.projects import write
from tests.networks.yard import YARD

SITE = """\
[site]
name = "Yard"
[[network]]
name = "yard"
project = "yard"
policy = "reject"
epochs = "{epochs}"
objects = ["C"]
"""
ADDRESS = "/api/v1/networks/yard"


def yard_site(folder: Path, *, epochs: str = "by hand", more: str = "") -> Path:
    """Write the yard as a site, and return the folder."""
    if not (folder / "site.toml").exists():
        write(folder / "yard", YARD)
        (folder / "site.toml").write_text(SITE.format(epochs=epochs) + more)
    return folder


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
