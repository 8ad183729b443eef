"""Tests of sites, on both kinds of databases."""

from __future__ import annotations

import pytest

from tests.support.sites import STORES, storing_in


@pytest.fixture(params=STORES)
def store(request):
    """Sites of the test have their databases in this store."""
    with storing_in(request.param):
        yield request.param
