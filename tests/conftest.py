"""What pytest has to know before it imports a test."""

from __future__ import annotations

import os
import signal

import pytest
from hypothesis import settings

from factorgraph_adj.blas import VARIABLES, use_one_blas_thread

# One thread for each process, and for those that tests start: the blocks are small, and the tests
# share the machine.
use_one_blas_thread()
os.environ.update(dict.fromkeys(VARIABLES, "1"))

pytest.register_assert_rewrite("tests.networks", "tests.support")

# A shell that runs the tests in the background has them ignore Ctrl-C, which some tests send.
signal.signal(signal.SIGINT, signal.default_int_handler)

# The same examples everywhere, and no deadline: machines differ.
settings.register_profile("tests", deadline=None, derandomize=True)
# New examples at every run, for hours where they are asked for: see tests/incremental/test_soak.py.
settings.register_profile("soak", deadline=None, max_examples=500, stateful_step_count=100)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "tests"))
