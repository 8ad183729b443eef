"""Matrices to which columns are added."""

from __future__ import annotations

import numpy as np

from factorgraph_adj.solve.growing_matrix import INITIAL_COLUMNS, GrowingMatrix


def test_columns_are_added_to_a_value_that_stays_what_it_was():
    rng = np.random.default_rng(1)
    parts = [rng.normal(size=(4, k)) for k in (3, 0, INITIAL_COLUMNS, 5, 1)]
    found, every = GrowingMatrix(4), []
    for part in parts:
        every.append(found)
        found = found.with_columns(part)
    assert (found.array == np.hstack(parts)).all()
    for n, before in enumerate(every):
        assert (before.array == np.hstack([np.zeros((4, 0)), *parts[:n]])).all()


def test_values_that_go_different_ways_do_not_share_their_columns():
    begun = GrowingMatrix(2).with_columns(np.ones((2, 1)))
    one, other = (begun.with_columns(np.full((2, 2), x)) for x in (2.0, 3.0))
    assert (one.array == [[1, 2, 2]] * 2).all()
    assert (other.array == [[1, 3, 3]] * 2).all()
    assert (one.with_columns(np.zeros((2, 1))).array == [[1, 2, 2, 0]] * 2).all()
