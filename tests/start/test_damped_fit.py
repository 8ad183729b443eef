"""Damped fits reach the minimum from far away; open combinations name their unknowns."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.start.damped_fit import damped_fit, damped_fits, open_columns
from factorgraph_adj.types import Array

PLACES = np.array([[0.0, 0.0], [10.0, 0.0], [3.0, 8.0], [-4.0, 5.0]])


def lengths(x: Array, observed: Array) -> tuple[Array, Array]:
    sight = x - PLACES
    size = np.linalg.norm(sight, axis=1)
    if not size.all():
        return np.full(len(size), np.inf), np.zeros((len(size), 2))
    return size - observed, sight / size[:, None]


@pytest.mark.parametrize("start", [(1.0, 1.0), (300.0, -200.0), (4.0, 90.0)])
def test_a_place_by_lengths_is_where_the_gradient_is_zero(start):
    rng = np.random.default_rng(4)
    observed = np.linalg.norm(np.array([2.0, 3.0]) - PLACES, axis=1) + rng.normal(0, 0.05, 4)
    end = damped_fit(np.array(start), lambda x: lengths(x, observed), np.add, 60)
    v, a = lengths(end.values, observed)
    assert end.cost == v @ v
    np.testing.assert_allclose(a.T @ v, 0.0, atol=1e-6)
    np.testing.assert_allclose(end.values, [2.0, 3.0], atol=0.2)


def test_a_start_without_residuals_has_an_infinite_cost():
    end = damped_fit(PLACES[0], lambda x: lengths(x, np.ones(4)), np.add, 60)
    assert end.cost == np.inf


def test_several_starts_lead_where_each_leads_alone():
    """A start without residuals, on a place, stays there and holds up no other one."""
    rng = np.random.default_rng(4)
    observed = np.linalg.norm(np.array([2.0, 3.0]) - PLACES, axis=1) + rng.normal(0, 0.05, 4)
    starts = np.array([(1.0, 1.0), PLACES[0], (300.0, -200.0), (4.0, 90.0)])

    def system(x: Array, numbers: Array) -> tuple[Array, Array]:
        assert len(numbers) == len(x)
        v, a = zip(*(lengths(one, observed) for one in x), strict=True)
        return np.array(v), np.array(a)

    ends = damped_fits(starts, system, 60)
    for start, end in zip(starts, ends, strict=True):
        alone = damped_fit(start, lambda x: lengths(x, observed), np.add, 60)
        np.testing.assert_array_equal(end.values, alone.values)
        assert end.cost == pytest.approx(alone.cost)
    assert np.isinf(ends[1].cost)


def test_a_bound_takes_a_gross_error_out_of_the_fit():
    """Soft L1: the gradient of Σ 2c² (√(1 + (v/c)²) − 1) is zero at the end."""
    observed = np.random.default_rng(4).normal(0.0, 1e-3, 9)
    observed[2] += 0.5

    def system(x: Array, numbers: Array) -> tuple[Array, Array]:
        return x - observed, np.ones((len(numbers), len(observed), 1))

    off = []
    for bound in (np.inf, 1e-3):
        (end,) = damped_fits(np.array([[7.0]]), system, 200, bound=bound)
        v = end.values - observed
        assert np.sum(v / np.sqrt(1.0 + (v / bound) ** 2)) == pytest.approx(0.0, abs=1e-6)
        off.append(abs(float(end.values[0])))
    assert off[1] < 0.05 * off[0]


def test_unknowns_of_an_open_combination_are_open():
    rng = np.random.default_rng(2)
    a = rng.normal(size=(9, 4))
    assert not open_columns(a, 1e-6).any()
    a[:, 3] = 2.0 * a[:, 1]
    assert open_columns(a, 1e-6).tolist() == [False, True, False, True]
    a[:, 0] = 0.0
    assert open_columns(a, 1e-6).tolist() == [True, True, False, True]
    assert open_columns(a[:2, 1:], 1e-6).tolist() == [True, False, True]
