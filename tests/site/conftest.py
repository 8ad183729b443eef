"""Tests of sites: on both kinds of databases; a browser and a canned site for those of the page."""

from __future__ import annotations

import pytest

from tests.support.pages import chromium
from tests.support.sites import STORES, storing_in


@pytest.fixture(params=STORES)
def store(request):
    """Sites of the test have their databases in this store."""
    with storing_in(request.param):
        yield request.param


@pytest.fixture(scope="module")
def browser():
    """A browser, skipping with a reason where there is none."""
    with chromium() as found:
        yield found


@pytest.fixture
def server():
    """A canned site on a port."""
    from tests.site.canned_server import CannedServer  # the extra serve may be missing

    made = CannedServer()
    yield made
    made.stop()


@pytest.fixture
def guarded():
    """A canned site that asks for tokens."""
    from tests.site.canned_server import CannedServer

    made = CannedServer(tokens=True)
    yield made
    made.stop()
