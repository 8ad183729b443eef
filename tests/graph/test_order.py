"""Numbers of photos, points and pairs are sorted by radix as by merging."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.graph.image_blocks import stable_order


@pytest.mark.parametrize("count", [1, 60, 65_536, 65_537, 2**33, 2**40])
def test_equal_numbers_keep_their_order(count: int) -> None:
    rng = np.random.default_rng(3)
    some = rng.integers(0, count, 40)
    numbers = np.append(rng.choice(some, 500), count - 1)
    np.testing.assert_array_equal(stable_order(numbers, count), np.argsort(numbers, kind="stable"))


def test_nothing_has_no_order() -> None:
    assert not len(stable_order(np.zeros(0, dtype=np.intp), 0))
