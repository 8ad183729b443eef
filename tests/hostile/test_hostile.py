"""A seeded part of the campaign: `python -m tests.hostile` runs all of it."""

from __future__ import annotations

import sys
from collections import Counter

import pytest

from tests.support.studies import cases

from .campaign import campaign

pytestmark = pytest.mark.slow(
    "damaged inputs drawn by seed; short tests damage each format in known ways"
)

INPUTS = 300
PARTS = 10
TESTED = (0, 1, 2, 3, 4, 5, 6, 8, 9)
"""Parts without the one of which an input alone is snooped for 40 s."""


@pytest.mark.skipif(sys.platform == "win32", reason="processes are forked")
@pytest.mark.parametrize("part", cases(range(PARTS), TESTED))
def test_damaged_inputs_are_refused_by_name_or_adjusted_rightly(part, tmp_path):
    size = INPUTS // PARTS
    made = list(campaign(part * size, size, tmp_path))
    faults = [f"{c.seed} {c.source}, {c.done}: {c.outcome.fault}" for c in made if c.outcome.fault]
    assert not faults
    told = Counter(c.told for c in made)
    assert told["refused"] > size // 4
