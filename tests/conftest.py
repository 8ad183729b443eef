"""What pytest has to know before it imports a test."""

from __future__ import annotations

import pytest

pytest.register_assert_rewrite("tests.networks", "tests.support")
