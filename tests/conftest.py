"""What pytest has to know before it imports a test."""

from __future__ import annotations

import os

import pytest
from hypothesis import settings

pytest.register_assert_rewrite("tests.networks", "tests.support")

# The same examples everywhere, and no deadline: machines differ.
settings.register_profile("tests", deadline=None, derandomize=True)
# New examples at every run, for hours where they are asked for: see tests/incremental/test_soak.py.
settings.register_profile("soak", deadline=None, max_examples=500, stateful_step_count=100)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "tests"))
