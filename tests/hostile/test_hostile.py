"""A seeded part of the campaign: `python -m tests.hostile` runs all of it."""

from __future__ import annotations

import sys
from collections import Counter

import pytest

from .campaign import campaign

pytestmark = pytest.mark.slow(
    "damaged inputs drawn by seed; short tests damage each format in known ways"
)

INPUTS = 300
PARTS = 10
SHORT = (1, 2, 9)
"""Parts of the short tests."""
LONG = pytest.mark.slow("210 damaged inputs more than the 90 of the short tests")


@pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")
@pytest.mark.parametrize(
    "part", [p if p in SHORT else pytest.param(p, marks=LONG) for p in range(PARTS)]
)
def test_damaged_inputs_are_refused_by_name_or_adjusted_rightly(part, tmp_path):
    size = INPUTS // PARTS
    cases = list(campaign(part * size, size, tmp_path))
    faults = [f"{c.seed} {c.source}, {c.done}: {c.outcome.fault}" for c in cases if c.outcome.fault]
    assert not faults
    told = Counter(c.told for c in cases)
    assert told["refused"] > size // 4
