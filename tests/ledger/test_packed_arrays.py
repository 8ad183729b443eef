"""Arrays as text have as many digits as they say."""

from __future__ import annotations

from itertools import permutations

import numpy as np
import pytest

from factorgraph_adj.ledger.journal_entries import (
    packed,
    packed_symmetric,
    unpacked,
    unpacked_symmetric,
)


@pytest.mark.parametrize("shape", [(0, 3), (1, 1), (4, 5)])
def test_numbers_come_back_with_seven_digits(shape):
    a = np.random.default_rng(1).normal(size=shape) * 1e-9
    assert unpacked(packed(a), *shape) == pytest.approx(a, rel=1e-7)


@pytest.mark.parametrize("k", [0, 1, 4])
@pytest.mark.parametrize("size", [0.0, 1e-12, 1e9])
def test_a_symmetric_tensor_comes_back_with_three_digits_of_its_largest_number(k, size):
    one = np.random.default_rng(2).normal(size=(k, k, k))
    tensor = size * sum(np.transpose(one, order) for order in permutations(range(3)))
    most, text = packed_symmetric(tensor)
    again = unpacked_symmetric(most, text, k)
    assert again.shape == (k, k, k)
    assert np.abs(again - tensor).max(initial=0.0) <= 1e-3 * most
