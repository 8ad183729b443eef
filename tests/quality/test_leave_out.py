"""Items left out one by one, against dense adjustments without them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from factorgraph_adj.quality import group_tests
from factorgraph_adj.quality.group_tests import (
    MIN_CONTROLLED_SHARE,
    LeaveOneOutFigures,
    critical_t2,
)
from factorgraph_adj.types import Array, Index

ROUNDING = 1e-8
"""Relative difference that rounding makes where an eigenvalue of M is 1/100 or more."""
N = 6
"""Number of unknowns that all items share."""
SIZES = (1, 2, 3, 1, 1, 3, 2, 1)
"""Numbers of components of the items: single observations and correlated groups."""


class Adjusted:
    """Items with correlated components in an adjustment, not whitened and whitened."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        ends = np.cumsum(SIZES)
        self.rows = [np.arange(e - k, e) for e, k in zip(ends, SIZES, strict=True)]
        k = int(ends[-1])
        self.raw = [np.linalg.cholesky(_covariance(rng, d)) for d in SIZES]
        """L of each item with Σ = L Lᵀ."""
        self.partials = rng.normal(size=(k, N))
        self.error = rng.normal(size=k)
        """Computed − observed at the approximate values."""
        # Other observations, which are not tested.
        self.others, self.errors = 100.0 * rng.normal(size=(14, N)), 100.0 * rng.normal(size=14)

    def with_unknown(self, column: Array) -> None:
        """Add an unknown that only some tested rows see."""
        self.partials = np.column_stack([self.partials, column])
        self.others = np.column_stack([self.others, np.zeros(len(self.others))])

    def system(self, items: list[int]) -> tuple[Array, Array]:
        """Return whitened partials and residuals of the others and some items."""
        a, v = [self.others], [self.errors]
        for i in items:
            whiten = np.linalg.inv(self.raw[i])
            a.append(whiten @ self.partials[self.rows[i]])
            v.append(whiten @ self.error[self.rows[i]])
        return np.concatenate(a), np.concatenate(v)

    def whole(self) -> tuple[Array, Array]:
        """Return v and M of all items in the adjustment with all of them."""
        a, v = self.system(list(range(len(SIZES))))
        q = np.linalg.inv(a.T @ a)
        m = np.eye(len(a)) - a @ q @ a.T
        first = len(self.others)
        return (m @ v)[first:], m[first:, first:]

    def tested(self) -> group_tests.LeaveOneOutTests:
        """Return the items with the whole of M."""
        v, m = self.whole()
        return group_tests.LeaveOneOutTests(self.rows, v, lambda u: m[:, u])

    def asked(self) -> tuple[group_tests.LeaveOneOutTests, list[Index]]:
        """Return the items with blocks and columns on demand, and the columns asked for."""
        v, m = self.whole()
        asked: list[Index] = []

        def columns(u: Index) -> Array:
            asked.append(u)
            return m[:, u].copy()

        most = max(SIZES)
        # What lies beyond an item's own components is not looked at.
        blocks = np.full((len(SIZES), most, most), np.nan)
        for i, own in enumerate(self.rows):
            blocks[i, : len(own), : len(own)] = m[np.ix_(own, own)]
        return group_tests.LeaveOneOutTests(self.rows, v, columns, blocks), asked

    def predicted(self, i: int, out: list[int]) -> tuple[Array, Array]:
        """Return d and D of an item, predicted without it and without those that are out."""
        a, v = self.system([j for j in range(len(SIZES)) if j != i and j not in out])
        q = np.linalg.inv(a.T @ a)
        own = self.partials[self.rows[i]]
        d = self.error[self.rows[i]] - own @ (q @ (a.T @ v))
        return d, self.raw[i] @ self.raw[i].T + own @ q @ own.T


def _covariance(rng: np.random.Generator, d: int) -> Array:
    root = rng.normal(size=(d, d))
    return 1e-4 * (root @ root.T + 0.3 * np.eye(d))


def assert_predicted(
    figures: LeaveOneOutFigures, at: int, d: Array, covariance: Array, raw: Array
) -> None:
    """Compare all figures of an item with those of its innovation d and its covariance D."""
    k = len(d)
    m = np.linalg.inv(covariance)
    close = {"rel": ROUNDING, "abs": ROUNDING}
    assert figures.innovation[at, :k] == pytest.approx(d, **close)
    assert figures.sigma[at, :k] == pytest.approx(np.sqrt(np.diag(covariance)), **close)
    assert figures.w[at, :k] == pytest.approx((m @ d) / np.sqrt(np.diag(m)), **close)
    assert figures.redundancy_numbers[at, :k] == pytest.approx(np.diag(raw @ raw.T @ m), **close)
    assert figures.t2[at] == pytest.approx(d @ m @ d, **close)
    assert figures.dof[at] == k


def padding(figures: LeaveOneOutFigures, at: int, k: int) -> list[Array]:
    rest = (figures.innovation, figures.sigma, figures.w, figures.redundancy_numbers)
    return [x[at, k:] for x in rest]


seeds = st.integers(0, 10_000)
few = settings(max_examples=20)


@few
@given(seed=seeds, on_demand=st.booleans())
def test_figures_are_those_of_the_adjustment_without_the_item(seed, on_demand):
    s = Adjusted(seed)
    tested = s.asked()[0] if on_demand else s.tested()
    figures = tested.figures(s.raw, np.arange(len(SIZES)))
    for i, own in enumerate(s.rows):
        assert_predicted(figures, i, *s.predicted(i, []), s.raw[i])
        innovation, sigma, w, r = padding(figures, i, len(own))
        assert np.isnan(innovation).all() and np.isinf(sigma).all() and np.isnan(w).all()
        assert not r.any()
    single = [i for i, own in enumerate(s.rows) if len(own) == 1]
    v, m = s.whole()
    at = [int(s.rows[i][0]) for i in single]
    assert figures.w[single, 0] == pytest.approx(v[at] / np.sqrt(np.diag(m)[at]), rel=ROUNDING)
    assert figures.redundancy_numbers[single, 0] == pytest.approx(np.diag(m)[at], rel=ROUNDING)


@few
@given(
    seed=seeds,
    out=st.lists(st.integers(0, len(SIZES) - 1), min_size=1, max_size=4, unique=True),
    on_demand=st.booleans(),
)
def test_items_leave_one_after_the_other(seed, out, on_demand):
    """The figures of the others are those of adjustments without all that have left."""
    s = Adjusted(seed)
    tested = s.asked()[0] if on_demand else s.tested()
    for number, i in enumerate(out):
        tested.leave_out(i)
        rest = [j for j in range(len(SIZES)) if j not in out[: number + 1]]
        figures = tested.figures(s.raw, np.array(rest))
        t2, dof = tested.statistics()
        ratios = tested.ratios(0.001)
        for at, j in enumerate(rest):
            d, covariance = s.predicted(j, out[: number + 1])
            assert_predicted(figures, at, d, covariance, s.raw[j])
            assert (t2[j], dof[j]) == (figures.t2[at], figures.dof[at])
            assert ratios[j] == pytest.approx(t2[j] / chi2.isf(0.001, dof[j]), rel=1e-9)
            whitened = s.raw[j].T @ np.linalg.inv(covariance) @ s.raw[j]
            assert tested.block(j) == pytest.approx(whitened, abs=ROUNDING)


@few
@given(seed=seeds, out=st.permutations(range(len(SIZES))))
def test_nothing_is_left_of_items_that_have_left(seed, out):
    s = Adjusted(seed)
    tested = s.tested()
    gone: list[int] = []
    for i in out[:4]:
        tested.leave_out(i)
        gone.append(i)
        t2, dof = tested.statistics()
        assert not t2[gone].any() and not dof[gone].any()
        assert not tested.ratios(0.01)[gone].any()
        assert not tested.residual()[gone].any()
        assert not tested.blocks[gone].any()


def test_the_residuals_that_were_given_stay_as_they_are():
    s = Adjusted(1)
    v, m = s.whole()
    before = v.copy(), m.copy()
    tested = group_tests.LeaveOneOutTests(s.rows, v, lambda u: m[:, u])
    tested.leave_out(2)
    assert np.array_equal(v, before[0]) and np.array_equal(m, before[1])
    assert not np.array_equal(tested.v, v)


def test_only_the_columns_of_items_that_leave_are_asked_for():
    s = Adjusted(2)
    tested, asked = s.asked()
    tested.figures(s.raw, np.arange(len(SIZES)))
    assert asked == []
    tested.leave_out(5)
    tested.leave_out(0)
    assert [a.tolist() for a in asked] == [s.rows[5].tolist(), s.rows[0].tolist()]
    tested.figures(s.raw, np.arange(len(SIZES)))
    assert len(asked) == 2


@few
@given(seed=seeds)
def test_the_order_in_which_items_leave_does_not_matter(seed):
    s = Adjusted(seed)
    first, second = s.tested(), s.tested()
    for i in (1, 4, 5):
        first.leave_out(i)
    for i in (5, 1, 4):
        second.leave_out(i)
    rest = np.array([0, 2, 3, 6, 7])
    for a, b in zip(
        vars(first.figures(s.raw, rest)).values(),
        vars(second.figures(s.raw, rest)).values(),
        strict=True,
    ):
        np.testing.assert_allclose(a, b, rtol=ROUNDING, atol=ROUNDING)


# -- what nothing else controls -------------------------------------------------------------------


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_row_that_alone_sees_an_unknown_has_no_test(seed):
    s = Adjusted(seed)
    column = np.zeros(sum(SIZES))
    column[s.rows[3]] = 2.0
    s.with_unknown(column)
    tested = s.tested()
    figures = tested.figures(s.raw, np.array([3, 4]))
    assert np.isnan(figures.innovation[0, 0]) and np.isnan(figures.w[0, 0])
    assert np.isinf(figures.sigma[0, 0])
    assert abs(figures.redundancy_numbers[0, 0]) < 1e-12
    assert (figures.t2[0], figures.dof[0]) == (0.0, 0)
    assert tested.ratios(0.01)[3] == 0.0
    # It says nothing about the others, before it leaves and after.
    s.partials, s.others = s.partials[:, :-1], s.others[:, :-1]
    assert_predicted(figures, 1, *s.predicted(4, [3]), s.raw[4])
    tested.leave_out(3)
    assert_predicted(tested.figures(s.raw, np.array([4])), 0, *s.predicted(4, [3]), s.raw[4])


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_components_of_a_group_are_tested_as_far_as_others_control_them(seed):
    """The second component of three alone sees an unknown: the other two have their joint test."""
    s = Adjusted(seed)
    column = np.zeros(sum(SIZES))
    column[s.rows[2][1]] = 0.5
    s.with_unknown(column)
    figures = s.tested().figures(s.raw, np.array([2]))
    s.partials, s.others = s.partials[:, :-1], s.others[:, :-1]
    d, covariance = s.predicted(2, [])
    on = np.array([0, 2])
    d, covariance = d[on], covariance[np.ix_(on, on)]
    m = np.linalg.inv(covariance)
    assert figures.dof[0] == 2
    assert figures.t2[0] == pytest.approx(d @ m @ d, rel=ROUNDING)
    assert figures.w[0, on] == pytest.approx((m @ d) / np.sqrt(np.diag(m)), rel=ROUNDING)
    assert figures.innovation[0, on] == pytest.approx(d, rel=ROUNDING)
    assert figures.sigma[0, on] == pytest.approx(np.sqrt(np.diag(covariance)), rel=ROUNDING)
    assert np.isnan(figures.w[0, 1]) and np.isnan(figures.innovation[0, 1])
    assert np.isinf(figures.sigma[0, 1])
    precision = np.zeros((3, 3))
    precision[np.ix_(on, on)] = m
    expected = np.diag(s.raw[2] @ s.raw[2].T @ precision)
    assert figures.redundancy_numbers[0] == pytest.approx(expected, abs=ROUNDING)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_combination_that_alone_is_controlled_has_its_own_test(seed):
    """Both components of a group see the same unknown: only their difference is controlled."""
    s = Adjusted(seed)
    column = np.zeros(sum(SIZES))
    column[s.rows[1]] = 0.5
    s.with_unknown(column)
    figures = s.tested().figures(s.raw, np.array([1]))
    s.partials, s.others = s.partials[:, :-1], s.others[:, :-1]
    d, covariance = s.predicted(1, [])
    c = np.array([1.0, -1.0])
    gap, variance = c @ d, c @ covariance @ c
    assert figures.dof[0] == 1
    assert figures.t2[0] == pytest.approx(gap**2 / variance, rel=ROUNDING)
    assert figures.w[0, :2] == pytest.approx(c * gap / np.sqrt(variance), rel=ROUNDING)
    own = s.raw[1] @ s.raw[1].T
    share = own @ c / (c @ own @ c)
    assert figures.innovation[0, :2] == pytest.approx(share * gap, rel=ROUNDING)
    assert figures.sigma[0, :2] == pytest.approx(np.abs(share) * np.sqrt(variance), rel=ROUNDING)
    expected = np.diag(own @ np.outer(c, c)) / variance
    assert figures.redundancy_numbers[0, :2] == pytest.approx(expected, abs=ROUNDING)


def test_two_items_control_each_other_until_one_leaves():
    s = Adjusted(4)
    column = np.zeros(sum(SIZES))
    column[s.rows[3]], column[s.rows[7]] = 0.03, 0.04
    s.with_unknown(column)
    tested = s.tested()
    before = tested.figures(s.raw, np.array([3, 7]))
    assert before.dof.tolist() == [1, 1]
    assert abs(before.w[0, 0]) == pytest.approx(abs(before.w[1, 0]), rel=ROUNDING)
    tested.leave_out(3)
    after = tested.figures(s.raw, np.array([7]))
    assert after.dof[0] == 0 and np.isnan(after.w[0, 0]) and np.isinf(after.sigma[0, 0])


def test_control_below_the_bound_counts_as_none():
    """Single rows with M just below and above `UNCONTROLLED`."""
    m = np.diag([0.9 * MIN_CONTROLLED_SHARE, 1.1 * MIN_CONTROLLED_SHARE])
    tested = group_tests.LeaveOneOutTests(
        [np.array([0]), np.array([1])], np.full(2, 1e-6), lambda u: m[:, u]
    )
    figures = tested.figures([np.eye(1)] * 2, np.arange(2))
    assert figures.dof.tolist() == [0, 1]
    assert np.isnan(figures.w[0, 0]) and np.isfinite(figures.w[1, 0])


# -- critical values ------------------------------------------------------------------------------


@pytest.mark.parametrize("alpha", [0.05, 0.001])
@pytest.mark.parametrize("dof", [1, 2, 3, 6])
def test_the_critical_value_is_exceeded_with_the_probability_of_a_false_alarm(alpha, dof):
    assert chi2.sf(critical_t2(alpha, dof), dof) == pytest.approx(alpha, rel=1e-9)


def test_without_degrees_of_freedom_there_is_no_critical_value():
    assert np.isnan(critical_t2(0.01, 0))


@pytest.mark.parametrize("v", [(1e200, 1.0), (np.inf, 1.0)])
def test_a_value_too_far_off_for_its_square_is_beyond_every_critical_value(v):
    m = np.diag([0.5, 0.6])
    tested = group_tests.LeaveOneOutTests([np.arange(2)], np.array(v), lambda u: m[:, u])
    assert tested.ratios(0.01)[0] == np.inf


def test_no_items_have_no_ratios():
    tested = group_tests.LeaveOneOutTests([], np.zeros(0), lambda u: np.zeros((0, len(u))))
    assert tested.ratios(0.01).shape == (0,)
