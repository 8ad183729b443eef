"""The lock of Uelzen, two epochs in one free adjustment, against the report of HANNA.

The report prints the observations with digits of 0.01 mgon and 0.1 mm: an observation may differ
from the printed one by half a digit. What that does to residuals follows from v = −R l.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.stats import norm

import factorgraph_adj as fga
from factorgraph_adj.planning.candidates import partials
from tests.loaders.hanna import MGON, MM, Hanna, read_hanna
from tests.support.places import data_dir

pytestmark = pytest.mark.published

DIRECTIONS = 94
"""Number of directions, which come before the distances."""


@dataclass(frozen=True, eq=False)
class Lock:
    """The report, our adjustment, and what half a digit does."""

    found: Hanna
    solution: fga.Solution
    reliability: fga.Reliability
    whitened: np.ndarray
    """v/σ of the observations, (304,)."""
    by_digit: np.ndarray
    """Change of v/σ by half a digit of each observation, (304, 304)."""


@pytest.fixture(scope="module")
def lock():
    found = read_hanna(data_dir("hanna_lock") / "avdgem.out")
    solution = fga.adjust(found.network)
    sigma = solution.observations.sigmas
    n = len(sigma)
    a = partials(solution.normal().system)[:n].toarray()
    r = np.eye(n) - a @ solution.cofactor_times(a.T)
    half = np.where(np.arange(n) < DIRECTIONS, 0.005 * MGON, 0.05 * MM)
    whitened = solution.observations.residuals / sigma
    return Lock(found, solution, fga.reliability(solution), whitened, -r * (half / sigma))


def test_the_lock_has_its_figures(lock):
    found, solution = lock.found, lock.solution
    assert (solution.redundancy, solution.datum_defect) == (244, 3)
    # Uniform errors of ± half a digit have the variance 1/3; the printed sum has four digits.
    sigma = np.linalg.norm(2 * lock.whitened @ lock.by_digit) / np.sqrt(3)
    assert abs(solution.vtpv - 255.838) < 2 * sigma
    assert sigma < 0.5
    for name, (y, x) in found.coordinates.items():
        assert solution.point(name)[:2] == pytest.approx([y, x], abs=1.5e-4)
    names = list(found.coordinates)
    plan = [3 * i + j for i in range(len(names)) for j in (0, 1)]
    q = 1e6 * solution.covariance(names)[np.ix_(plan, plan)]
    assert np.trace(q) == pytest.approx(26.25746, abs=5e-4)
    assert np.linalg.eigvalsh(q)[-1] == pytest.approx(4.745514, abs=3e-4)
    assert q == pytest.approx(found.cofactor, abs=5e-4)


def test_redundancy_numbers_of_the_lock(lock):
    r = lock.reliability.redundancy_numbers
    assert r.sum() == pytest.approx(244.0, abs=1e-9)
    assert r == pytest.approx([p.r for p in lock.found.printed], abs=2e-4)


def test_w_of_the_lock_differ_by_no_more_than_the_digits_of_the_observations(lock):
    """w = |v|/(σ √r) with σ0 = 1: 304 differences have the size that rounding makes."""
    printed = np.array([p.w for p in lock.found.printed])
    root = np.sqrt(lock.reliability.redundancy_numbers)
    w, by_digit = lock.whitened / root, lock.by_digit / root[:, None]
    assert np.abs(lock.reliability.w) == pytest.approx(np.abs(w), abs=1e-12)
    off = np.abs(w) - printed
    assert np.abs(off).max() < 0.031
    sigma = np.sqrt((by_digit**2).sum(axis=1) / 3 + 0.005**2 / 3)
    assert sigma.max() < 0.016
    assert np.sqrt(np.mean((off / sigma) ** 2)) == pytest.approx(1.0, abs=0.1)
    assert np.abs(off / sigma).max() < 3.5  # 1 of 7 such sets has one above
    # With σ̂0 = 1.02 in w, the large ones would be off by 2 %.
    large = printed > 1
    assert np.median(np.abs(w[large]) / printed[large]) == pytest.approx(1.0, abs=0.003)


def test_observations_within_half_a_digit_have_all_printed_w(lock):
    """Some unrounded observations give all 304 w and v as they are printed, digit for digit."""
    printed = lock.found.printed
    root = np.sqrt(lock.reliability.redundancy_numbers)
    sigma = lock.solution.observations.sigmas
    sign = np.sign(lock.whitened)[:, None]
    of_w = sign * lock.by_digit / root[:, None]
    of_v = sign * lock.by_digit * sigma[:, None]
    last_v = np.where(np.arange(len(sigma)) < DIRECTIONS, 0.05 * MGON, 0.05 * MM)
    size = np.abs(lock.whitened)
    rows = np.vstack([of_w / 0.005, of_v / last_v[:, None]])
    off = np.concatenate(
        [
            (size / root - [p.w for p in printed]) / 0.005,
            (size * sigma - np.abs([p.v for p in printed])) / last_v,
        ]
    )
    # The least largest share t of half a digit, |e| ≤ t, with |rows e + off| ≤ 1.
    n = len(sigma)
    e, one = np.eye(n), np.ones((n, 1))
    left = np.vstack(
        [
            np.hstack([np.vstack([rows, -rows]), np.zeros((2 * len(rows), 1))]),
            np.hstack([np.vstack([e, -e]), np.vstack([-one, -one])]),
        ]
    )
    right = np.concatenate([1 - off, 1 + off, np.zeros(2 * n)])
    found = linprog(np.eye(n + 1)[-1], left, right, bounds=[(None, None)] * n + [(0, None)])
    assert found.status == 0
    assert found.fun <= 1.0


def test_nabla_of_the_lock_are_the_critical_value_times_the_standard_deviation(lock):
    """∇ = k σ/√r with the k of data snooping, printed 3.66: HANNA's ∇ has no share for a power."""
    printed = lock.found.printed
    scale = lock.solution.observations.sigmas / np.sqrt(lock.reliability.redundancy_numbers)
    last = np.where(np.arange(len(scale)) < DIRECTIONS, 0.05 * MGON, 0.05 * MM)
    nabla = np.array([p.nabla for p in printed])
    # One k gives all 304 figures as they are printed.
    low, high = ((nabla - last) / scale).max(), ((nabla + last) / scale).min()
    assert low < high
    assert 3.657 < low < high < 3.658
    assert round(low, 2) == lock.found.critical == 3.66
    # Ours with a power of 50 % are the same figures.
    ours = fga.reliability(lock.solution, alpha=2 * norm.sf((low + high) / 2), power=0.5)
    assert (np.abs(ours.mdb - nabla) <= 1.01 * last).all()


def test_variance_components_of_the_lock(lock):
    """Twelve groups: vᵀPv, redundancy, and s = σ √(vᵀPv/r), HANNA's first step."""
    printed, sigma = lock.found.printed, lock.solution.observations.sigmas
    observed = np.array([o.observed for o in lock.solution.observations])
    r = lock.reliability.redundancy_numbers
    assert len(lock.found.components) == 12
    covered = np.zeros(len(sigma), dtype=int)
    for c in lock.found.components:
        own = np.array([p.group == c.group for p in printed])
        if np.isfinite(c.reach[1]):
            own &= (c.reach[0] <= observed) & (observed < c.reach[1])
        covered += own
        unit = MM if c.group[0] == 3 else MGON
        assert own.sum() == c.n
        assert r[own].sum() == pytest.approx(c.redundancy, abs=6e-4)
        assert sigma[own].mean() == pytest.approx(c.given, abs=0.01 * unit)
        v = lock.whitened[own]
        # First and second order of what half a digit does to vᵀPv.
        by_digit = lock.by_digit[own]
        error = np.linalg.norm(2 * v @ by_digit) / np.sqrt(3) + (by_digit**2).sum() / 3
        assert abs(v @ v - c.vtpv) < 3 * error
        s = sigma[own].mean() * np.sqrt(v @ v / r[own].sum())
        tolerance = 1.5 * s * error / (v @ v) + 0.005 * unit
        assert abs(s - c.estimated) < tolerance
    assert (covered == 1).all()


def test_the_lock_moved(lock):
    pairs = {n[1:]: n for n in ("0101", "0102", "0103", "0104")}
    found = fga.congruence(lock.solution, pairs=pairs)
    # Displacements and F as computed from the printed coordinates and cofactors, σ̂0 = 1.02.
    expected = {
        "101": ((-1.9, -3.8), 5.95),
        "102": ((-8.4, -7.4), 71.06),
        "103": ((4.1, -7.4), 18.97),
        "104": ((-1.0, -6.3), 8.96),
    }
    for name, (vector, value) in expected.items():
        x = found.displacement(name)
        assert 1000 * x.vector[:2] == pytest.approx(vector, abs=0.15)
        assert x.test.value == pytest.approx(value, rel=0.04)
        assert x.moved
    q, d = found.differences.cofactor, found.differences.d
    joint = d @ np.linalg.solve(q, d) / (8 * found.scale.variance)
    assert joint == pytest.approx(25.65, rel=0.03)
    rigid = fga.block_motion(found, list(pairs))
    assert rigid.motion.value > rigid.motion.critical
