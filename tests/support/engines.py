"""A fixture that runs every test of a folder on both engines."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

import pytest

from factorgraph_adj import IncrementalAdjustment
from tests.support.studies import ENGINES


@pytest.fixture(autouse=True, scope="module", params=ENGINES)
def engine(request: pytest.FixtureRequest) -> Iterator[str]:
    """The engine of an incremental adjustment for which a test names none."""
    options = inspect.unwrap(IncrementalAdjustment.__init__).__kwdefaults__
    before, options["engine"] = options["engine"], request.param
    yield request.param
    options["engine"] = before
