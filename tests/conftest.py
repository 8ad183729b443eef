"""What pytest has to know before it imports a test."""

from __future__ import annotations

import gc
import os
import signal
from collections.abc import Iterator

import pytest
from hypothesis import HealthCheck, settings

from factorgraph_adj.blas_threads import VARIABLES, use_one_thread

# One thread for each process, and for those that tests start: the blocks are small, and the tests
# share the machine.
use_one_thread()
os.environ.update(dict.fromkeys(VARIABLES, "1"))

pytest.register_assert_rewrite("tests.networks", "tests.support")

# A shell that runs the tests in the background has them ignore Ctrl-C, which some tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples everywhere, and no time within which they must be drawn: machines differ.
untimed = settings(deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.register_profile("tests", untimed, derandomize=True)
# New examples at every run, for hours where they are asked for: see tests/incremental/test_soak.py.
settings.register_profile("soak", untimed, max_examples=500, stateful_step_count=100)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "tests"))


def pytest_addoption(parser: pytest.Parser) -> None:
    """``--studies`` runs what tests leave out."""
    parser.addoption("--studies", action="store_true", help="only the cases that tests leave out")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out studies, or all but them; see `tests.support.studies`."""
    from tests.support.studies import without_studies

    kept, left = without_studies(items)
    if config.getoption("studies"):
        kept, left = left, kept
    config.hook.pytest_deselected(items=left)
    items[:] = kept


def pytest_collection_finish() -> None:
    """Let no search for garbage go through the thousands of tests and modules again."""
    gc.collect()
    gc.freeze()


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say how many tests were skipped for want of real measurements, and how to get these."""
    from tests.support.places import ABSENT, where_data_come_from

    skipped = [r for r in terminalreporter.stats.get("skipped", []) if ABSENT in str(r.longrepr)]
    if skipped:
        terminalreporter.write_line(where_data_come_from(len(skipped)))


@pytest.fixture(autouse=True, scope="module")
def registered_kinds_stay() -> Iterator[None]:
    """Tests that register a kind take it back: other tests may name all that are valid."""
    from factorgraph_adj.models.lens_registry import LENSES
    from factorgraph_adj.models.unknown_registry import UNKNOWNS
    from factorgraph_adj.observations.registry import KINDS

    before = list(KINDS), list(UNKNOWNS), list(LENSES)
    yield
    assert (list(KINDS), list(UNKNOWNS), list(LENSES)) == before
