"""Low-rank updates against dense inverses of everything at once."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

import factorgraph_adj as fga
from factorgraph_adj.simulation.simulated_blocks import simulate_geocentric_block
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.solve.low_rank_update import (
    UPDATE_LIMITS,
    SolvedCofactors,
    Update,
    covariance_whitener,
    innovation_statistics,
)

ROUNDING = 1e-9
"""Relative difference that rounding makes in systems of these sizes and conditions."""


class System:
    """Rows A with residuals v at the minimum of vᵀv, and rows that may join."""

    def __init__(self, seed: int, n: int = 6, rows: int = 14, more: int = 4) -> None:
        rng = np.random.default_rng(seed)
        self.a = rng.normal(size=(rows, n))
        observed = rng.normal(size=rows)
        self.q = np.linalg.inv(self.a.T @ self.a)
        self.v = self.a @ (self.q @ self.a.T @ observed) - observed
        self.b = rng.normal(size=(more, n))
        self.new = rng.normal(size=more)
        self.at = np.arange(n)

    def minimum(self, a, v):
        """Return the step to the minimum of |v + A dx|², the cofactors there, and vᵀv there."""
        q = np.linalg.inv(a.T @ a)
        dx = -q @ a.T @ v
        return dx, q, float(np.sum((v + a @ dx) ** 2))

    def changed(self, leaving: list[int]):
        """Return A and v with the new rows and without some of the others."""
        stay = np.delete(np.arange(len(self.a)), leaving)
        return np.vstack([self.a[stay], self.b]), np.append(self.v[stay], self.new)


seeds = st.integers(0, 10_000)


@given(seed=seeds, leaving=st.sets(st.integers(0, 13), max_size=4), first=st.booleans())
def test_rows_that_join_and_leave_give_the_minimum_and_the_cofactors_of_what_is_left(
    seed, leaving, first
):
    s = System(seed)
    out = sorted(leaving)
    update = Update.of(s.q)
    for joins in (first, not first):  # in any order
        if joins:
            update = update.with_rows(s.at, s.b, s.new)
        else:
            update = update.with_rows(s.at, s.a[out], s.v[out], sign=-1)
    dx, q, vtv = s.minimum(*s.changed(out))
    scale = np.abs(q).max()
    assert update.solve(np.eye(6)) == pytest.approx(q, abs=ROUNDING * scale)
    assert update.step == pytest.approx(dx, abs=ROUNDING * np.sqrt(scale))
    assert update.vtpv == pytest.approx(vtv - float(s.v @ s.v), abs=ROUNDING * (1 + vtv))
    f = np.random.default_rng(seed).normal(size=(2, 3))
    at = np.array([1, 4, 5])
    expected = f @ q[np.ix_(at, at)] @ f.T
    assert update.variance(at, f) == pytest.approx(expected, abs=ROUNDING * scale)
    lost = s.q - q
    assert update.loss(update.spread) == pytest.approx(lost, abs=ROUNDING * scale)
    assert update.losses(update.spread) == pytest.approx(np.diag(lost), abs=ROUNDING * scale)
    assert update.loss(update.spread[:2], update.spread[3:]) == pytest.approx(
        lost[:2, 3:], abs=ROUNDING * scale
    )


@given(seed=seeds)
def test_rows_one_by_one_are_rows_at_once(seed):
    s = System(seed)
    at_once = Update.of(s.q).with_rows(s.at, s.b, s.new)
    each = Update.of(s.q)
    for row, v in zip(s.b, s.new, strict=True):
        each = each.with_rows(s.at, row[None], np.array([v]))
    assert each.step == pytest.approx(at_once.step, abs=ROUNDING)
    assert each.inverse == pytest.approx(at_once.inverse, abs=ROUNDING)
    upon = Update.of(Update.of(s.q).with_rows(s.at, s.b[:2])).with_rows(s.at, s.b[2:])
    assert upon.solve(np.eye(6)) == pytest.approx(each.solve(np.eye(6)), abs=ROUNDING)


@given(seed=seeds, kept=st.lists(st.integers(0, 6), unique=True))
def test_some_rows_of_an_update_are_an_update_with_these_rows_alone(seed, kept):
    """Of four rows that join and three that leave, in any order."""
    s = System(seed)
    out = [3, 8, 10]
    b, v = np.vstack([s.b, s.a[out]]), np.append(s.new, s.v[out])
    update = Update.of(s.q).with_rows(s.at, s.b, s.new)
    found = update.with_rows(s.at, s.a[out], s.v[out], sign=-1).only(np.array(kept, dtype=np.intp))
    expected = Update.of(s.q)
    for i in kept:
        expected = expected.with_rows(s.at, b[[i]], v[[i]], sign=1.0 if i < 4 else -1.0)
    for name in ("spread", "inner", "signs", "residuals"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), abs=ROUNDING)
    joined = [i for i in kept if i < 4]
    stay = np.delete(np.arange(14), [out[i - 4] for i in kept if i >= 4])
    a, w = np.vstack([s.a[stay], b[joined]]), np.append(s.v[stay], v[joined])
    dx, q, vtv = s.minimum(a, w)
    scale = np.abs(q).max()
    assert found.solve(np.eye(6)) == pytest.approx(q, abs=ROUNDING * scale)
    assert found.step == pytest.approx(dx, abs=ROUNDING * np.sqrt(scale))
    assert found.vtpv == pytest.approx(vtv - float(s.v @ s.v), abs=ROUNDING * (1 + vtv))
    # Further rows join what is left.
    again = found.with_rows(s.at, s.b[:1] + s.b[1:2])
    q = np.linalg.inv(np.linalg.inv(q) + np.outer(s.b[0] + s.b[1], s.b[0] + s.b[1]))
    assert again.solve(np.eye(6)) == pytest.approx(q, abs=ROUNDING * scale)


def test_an_update_is_a_value():
    s = System(1)
    update = Update.of(s.q).with_rows(s.at, s.b[:1], s.new[:1])
    before = update.step.copy(), update.solve(np.eye(6)), s.q.copy()
    update.with_rows(s.at, s.b[1:], s.new[1:])
    update.with_rows(s.at, s.a[:2], s.v[:2], sign=-1)
    update.only(np.zeros(0, dtype=np.intp))
    for old, new in zip(before, (update.step, update.solve(np.eye(6)), s.q), strict=True):
        assert np.array_equal(old, new)


def test_no_rows_change_nothing():
    s = System(1)
    update = Update.of(s.q)
    assert np.array_equal(update.solve(np.eye(6)), s.q)
    assert not update.step.any()
    assert (update.condition, update.gained, update.vtpv, update.trusted) == (1.0, 1.0, 0.0, True)


@given(seed=seeds)
def test_rows_that_hold_are_met_without_error(seed):
    s = System(seed)
    update = Update.of(s.q).with_rows(s.at, s.b[:2], s.new[:2], sign=0)
    assert s.b[:2] @ update.step == pytest.approx(-s.new[:2], abs=ROUNDING)
    assert s.b[:2] @ update.solve(np.eye(6)) == pytest.approx(np.zeros((2, 6)), abs=ROUNDING)
    normal = np.block([[s.a.T @ s.a, s.b[:2].T], [s.b[:2], np.zeros((2, 2))]])
    q = np.linalg.inv(normal)[:6, :6]
    assert update.solve(np.eye(6)) == pytest.approx(q, abs=ROUNDING)
    # With rows of the other sorts beside them.
    mixed = update.with_rows(s.at, s.b[2:]).with_rows(s.at, s.a[:1], sign=-1)
    normal[:6, :6] += s.b[2:].T @ s.b[2:] - s.a[:1].T @ s.a[:1]
    q = np.linalg.inv(normal)[:6, :6]
    assert mixed.condition > UPDATE_LIMITS.least_left
    assert mixed.solve(np.eye(6)) == pytest.approx(q, abs=ROUNDING * np.abs(q).max())


# -- tests ----------------------------------------------------------------------------------------


@given(seed=seeds, u=st.sets(st.integers(0, 3), min_size=1))
def test_rows_that_joined_are_tested_against_everything_else(seed, u):
    s = System(seed)
    u = sorted(u)
    update = Update.of(s.q).with_rows(s.at, s.b, s.new)
    found, dof = update.test(np.array(u))
    rest = np.delete(np.arange(4), u)
    a, v = np.vstack([s.a, s.b[rest]]), np.append(s.v, s.new[rest])
    dx, q, _ = s.minimum(a, v)
    d = s.new[u] + s.b[u] @ dx
    covariance = np.eye(len(u)) + s.b[u] @ q @ s.b[u].T
    expected = innovation_statistics(d, covariance, np.eye(len(u)))
    assert dof == len(u)
    assert found.t2 == pytest.approx(expected.t2, rel=ROUNDING)
    assert found.t2 == pytest.approx(d @ np.linalg.solve(covariance, d), rel=ROUNDING)
    assert found.w == pytest.approx(expected.w, abs=ROUNDING)
    # They are those of the adjustment with all rows.
    dx, q, _ = s.minimum(np.vstack([s.a, s.b]), np.append(s.v, s.new))
    r = 1 - np.einsum("ij,jk,ik->i", s.b, q, s.b)[u]
    assert found.redundancy_numbers == pytest.approx(r, abs=ROUNDING)
    assert found.w == pytest.approx((s.new[u] + s.b[u] @ dx) / np.sqrt(r), abs=ROUNDING)


@given(seed=seeds)
def test_rows_that_left_are_tested_as_they_were_and_as_they_would_be_predicted(seed):
    s = System(seed)
    out = [2, 5, 11]
    found, dof = Update.of(s.q).with_rows(s.at, s.a[out], s.v[out], sign=-1).test()
    m = np.eye(3) - s.a[out] @ s.q @ s.a[out].T
    assert dof == 3
    assert found.t2 == pytest.approx(s.v[out] @ np.linalg.solve(m, s.v[out]), rel=ROUNDING)
    assert found.w == pytest.approx(s.v[out] / np.sqrt(np.diag(m)), abs=ROUNDING)
    assert found.redundancy_numbers == pytest.approx(np.diag(m), abs=ROUNDING)
    stay = np.delete(np.arange(14), out)
    dx, q, _ = s.minimum(s.a[stay], s.v[stay])
    covariance = np.eye(3) + s.a[out] @ q @ s.a[out].T
    expected = innovation_statistics(s.v[out] + s.a[out] @ dx, covariance, np.eye(3))
    assert found.t2 == pytest.approx(expected.t2, rel=ROUNDING)


def test_correlated_observations_are_tested_by_their_joint_covariance():
    rng = np.random.default_rng(4)
    root = rng.normal(size=(2, 3, 3))
    own = root @ root.transpose(0, 2, 1)
    a, q = rng.normal(size=(2, 3, 6)), System(4).q
    d = rng.normal(size=(2, 3))
    covariance = own + a @ q @ a.transpose(0, 2, 1)
    found = innovation_statistics(d, covariance, own)
    for i in range(2):
        # Whitened, an observation with its covariance is a row of an update.
        w = covariance_whitener(own[i])
        same, _ = Update.of(q).with_rows(np.arange(6), w @ a[i], w @ d[i]).test()
        assert found.t2[i] == pytest.approx(float(same.t2), rel=ROUNDING)
        each = [
            innovation_statistics(d[i, [j]], covariance[i][[j]][:, [j]], own[i][[j]][:, [j]])
            for j in (0, 1)
        ]
        inverse = np.linalg.inv(covariance[i])
        assert found.w[i] == pytest.approx((inverse @ d[i]) / np.sqrt(np.diag(inverse)))
        assert [float(e.t2) for e in each] == pytest.approx(
            d[i, :2] ** 2 / np.diag(covariance[i])[:2]
        )
        assert found.redundancy_numbers[i] == pytest.approx(np.diag(own[i] @ inverse))


def test_rows_of_both_signs_are_not_tested_together():
    s = System(1)
    update = Update.of(s.q).with_rows(s.at, s.b[:1]).with_rows(s.at, s.a[:1], sign=-1)
    with pytest.raises(ValueError, match="all join, or all leave"):
        update.test()
    assert update.test(update.signs > 0)[1] == update.test(update.signs < 0)[1] == 1


# -- when it must not be trusted ------------------------------------------------------------------


@given(seed=seeds, leaving=st.sets(st.integers(0, 13), min_size=7, max_size=12))
def test_the_condition_tells_whether_anything_is_undetermined_without_rows(seed, leaving):
    """Ten unknowns, 14 + 4 rows of which 7 to 12 go: with ten or more left all are determined."""
    s = System(seed, n=10)
    out = sorted(leaving)
    update = Update.of(s.q).with_rows(s.at, s.a[out], s.v[out], sign=-1)
    update = update.with_rows(s.at, s.b, s.new)
    a, _ = s.changed(out)
    if len(a) < 10:
        assert abs(update.condition) < ROUNDING
        assert not update.trusted
        return
    # M = I − B Q Bᵀ of the leaving rows in the system with all others.
    whole = np.linalg.inv(s.a.T @ s.a + s.b.T @ s.b)
    left = np.linalg.eigvalsh(np.eye(len(out)) - s.a[out] @ whole @ s.a[out].T)[0]
    assert left > 0
    scale = max(1.0, float(np.linalg.eigvalsh(s.a[out] @ s.q @ s.a[out].T)[-1]))
    assert scale == pytest.approx(1.0)
    assert update.condition == pytest.approx(left, abs=ROUNDING)
    assert update.trusted == (update.condition > UPDATE_LIMITS.least_left)


def test_a_row_that_alone_determines_something_cannot_leave():
    """A chain 0 → x₀ → x₁: without the second row nothing tells x₁."""
    a = np.array([[1.0, 0.0], [-1.0, 1.0]])
    q = np.linalg.inv(a.T @ a)
    update = Update.of(q).with_rows(np.arange(2), a[1:], np.zeros(1), sign=-1)
    assert update.condition == pytest.approx(0.0, abs=1e-15)
    assert not update.trusted
    found, dof = update.test()
    assert (dof, float(found.t2), float(found.redundancy_numbers[0])) == (0, 0.0, 0.0)
    assert np.isnan(found.w[0])
    # What the row alone determines is left as it is.
    assert np.array_equal(update.solve(np.eye(2)), q)
    # A row that says the same may take its place.
    update = update.with_rows(np.array([1]), np.array([[1.0]]), np.zeros(1))
    assert update.condition == pytest.approx(1.0 / 3.0)
    assert update.solve(np.eye(2)) == pytest.approx(np.eye(2))


def test_the_same_row_twice_is_more_than_there_is():
    s = System(3)
    row = 3.0 * s.a[:1]
    update = Update.of(s.q).with_rows(s.at, row, sign=-1)
    n = s.a.T @ s.a - row.T @ row
    assert np.linalg.eigvalsh(n)[0] < 0
    assert update.condition < 0
    assert not update.trusted


@given(seed=seeds)
def test_a_row_that_leaves_again_has_never_been_there(seed):
    s = System(seed)
    update = Update.of(s.q).with_rows(s.at, s.b[:1], s.new[:1])
    again = update.with_rows(s.at, s.b[:1], s.new[:1], sign=-1)
    assert again.trusted
    assert again.solve(np.eye(6)) == pytest.approx(s.q, abs=ROUNDING)
    assert again.step == pytest.approx(np.zeros(6), abs=ROUNDING)


def test_rows_that_say_far_more_than_all_before_are_not_trusted_to_a_difference():
    """σ from 1 km to 1 mm: of the 16 digits of the variance four are left."""
    q = np.diag([1e6, 1.0])
    row = np.array([[1e3, 0.0]])
    update = Update.of(q).with_rows(np.arange(2), row)
    assert update.gained == pytest.approx(1e12)
    assert update.condition == 1.0
    assert not update.trusted
    assert Update.of(q).with_rows(np.arange(2), 1e-3 * row).trusted
    # As it joined it must not leave: nothing would be left of the digits.
    both = Update.of(q).with_rows(np.arange(2), row).with_rows(np.arange(2), row, sign=-1)
    assert both.condition < UPDATE_LIMITS.least_left


def test_a_constraint_that_is_already_held_adds_nothing():
    s = System(5)
    twice = np.vstack([s.b[:1], s.b[:1]])
    update = Update.of(s.q).with_rows(s.at, twice, sign=0)
    once = Update.of(s.q).with_rows(s.at, s.b[:1], sign=0)
    assert update.condition == pytest.approx(0.0, abs=1e-12)
    assert not update.trusted
    assert update.solve(np.eye(6)) == pytest.approx(once.solve(np.eye(6)), abs=ROUNDING)


# -- a whole network ------------------------------------------------------------------------------


def test_observations_leave_a_factorised_network():
    """Against the same network without them, linearised at the same place."""
    network = simulate_geocentric_block(5).network
    solution = fga.adjust(network)
    ids = [o.id for o in solution.observations if o.kind == "slope_distance"][:3]
    rows = [solution.observations.row(i) for i in ids]
    system = solution.normal().system
    size = system.unknowns.n_columns
    a = system.times(np.eye(size))[rows]
    at = np.flatnonzero(np.any(a != 0, axis=0))
    update = Update.of(SolvedCofactors(solution.factor, size))
    update = update.with_rows(at, a[:, at], system.residual[rows], sign=-1)
    assert update.trusted
    fewer = fga.adjust(fga.without(network, ids), start=solution, max_iterations=0)
    there = LinearisedEquations(fewer.equations, solution.state)
    dense, free = there.times(np.eye(size)), there.unknowns.free
    q = np.zeros((size, size))
    q[np.ix_(free, free)] = np.linalg.inv(dense[:, free].T @ dense[:, free])
    sigma = np.sqrt(np.diag(q))
    dx = -q @ dense.T @ there.residual
    assert np.all(np.abs(update.step - dx) <= 1e-6 * sigma)
    assert np.abs(update.step).max() > 0
    touched = at[free[at]]
    unit, own = np.eye(len(touched)), np.outer(sigma[touched], sigma[touched])
    found = update.variance(touched, unit) / own
    assert found == pytest.approx(q[np.ix_(touched, touched)] / own, abs=1e-6)


@given(seed=seeds, leaving=st.sets(st.integers(0, 13), max_size=3), new=st.integers(1, 4))
def test_new_unknowns_are_those_of_the_whole(seed, leaving, new):
    s = System(seed, rows=16, more=9)
    rng = np.random.default_rng(seed + 1)
    c = np.vstack([np.zeros((2, new)), rng.normal(size=(7, new))])
    out, n = sorted(leaving), len(s.at)
    at = np.arange(n + new)
    rows = np.hstack([s.b, c])
    update = (
        Update.of(s.q)
        .with_rows(s.at, s.b[:2], s.new[:2])
        .with_unknowns(new)
        .with_rows(at, rows[2:5], s.new[2:5])
        .with_rows(s.at, s.a[out], s.v[out], sign=-1)
        .with_rows(at, rows[5:], s.new[5:])
    )
    assume(update.trusted and update.condition > 1e-2 and update.determined > 1e-3)
    a, v = s.changed(out)
    a = np.hstack([a, np.zeros((len(a), new))])
    a[-len(rows) :, n:] = c
    dx, q, vtv = s.minimum(a, v)
    scale = np.abs(q).max()
    assert np.allclose(update.solve(np.eye(n + new)), q, rtol=0, atol=1e-9 * scale)
    assert np.allclose(
        update.between(at, np.eye(len(at)), at, np.eye(len(at))), q, atol=1e-9 * scale
    )
    assert np.allclose(update.step, dx, rtol=1e-8, atol=1e-8 * np.abs(dx).max())
    assert float(np.sum(s.v**2)) + update.vtpv == pytest.approx(vtv, rel=1e-9, abs=1e-9)
    joined = update.signs > 0
    gain = update.gain(at, np.eye(len(at)))[:, joined]
    assert np.allclose(gain, q @ rows.T, atol=1e-9 * scale * np.abs(rows).max())
    m = np.eye(len(rows)) - rows @ q @ rows.T
    assert np.allclose(update.inverse[np.ix_(joined, joined)], m, atol=1e-8)


def test_new_unknowns_that_rows_do_not_determine_are_not_trusted():
    s = System(3)
    at = np.arange(len(s.at) + 2)
    rows = np.hstack([s.b, np.array([[1.0, 2.0], [2.0, 4.0], [0.5, 1.0], [0.0, 0.0]])])
    update = Update.of(s.q).with_unknowns(2).with_rows(at, rows, s.new)
    assert update.determined < 1e-12 and not update.trusted
    assert not Update.of(s.q).with_unknowns(1).trusted
