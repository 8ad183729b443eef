"""Protection levels against dense equations, linear programmes, trials and real data snooping."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations
from math import comb

import numpy as np
import pytest
from scipy.special import erfc, ndtr
from scipy.stats import binom

import factorgraph_adj as fga
from factorgraph_adj.errors import InputError
from factorgraph_adj.quality import fault_modes
from factorgraph_adj.quality.integrity_risk import (
    length_tail,
    missed_detection,
    protection_level,
    risk_at,
    vector_level,
)
from factorgraph_adj.quality.protection_levels import FIGURES, ProtectionLevels
from factorgraph_adj.types import Array
from tests.benchmarks.protection_levels import DenseModel, of_mode, trials, worst_errors
from tests.support.scatter import NETWORKS, measure

FALSE_ALARM = 1e-4
"""Probability with which a right level fails one count of trials."""
ROUNDING = 1e-6
"""Relative: what the factorisation and the dense inverse differ by."""


@cache
def adjusted(kind: str) -> fga.Solution:
    """Return an adjusted network of one kind of observations."""
    return fga.adjust(measure(NETWORKS[kind](), seed=0))


@pytest.mark.parametrize("risk", [1e-2, 1e-4, 1e-13, 1e-18, 1e-30])
@pytest.mark.parametrize("dof", [1, 3])
def test_a_level_has_the_risk_at_the_worst_size(risk: float, dof: int) -> None:
    slope = np.array([0.0, 0.2, 1.0, 4.0, 40.0])
    level = protection_level(np.full(5, 2.0), slope, risk, 1e-3, dof=dof)
    found = risk_at(level, np.full(5, 2.0), slope, 1e-3, dof=dof)
    assert np.all(found <= risk * (1.0 + 1e-4))
    assert np.all(found >= risk * 0.98)


@pytest.mark.parametrize("risk", [1e-3, 1e-13, 1e-30, 1.1e-60])
@pytest.mark.parametrize("dof", [1, 3])
def test_no_size_of_a_fault_exceeds_the_risk_where_slopes_are_small(risk: float, dof: int) -> None:
    """There the worst size is small, and λ rises like a root with the tail."""
    slopes = np.array([0.002, 0.005, 0.01, 0.02, 0.05, 0.1])
    size = np.linspace(0.0, 6.0, 60_001)
    hidden = missed_detection(size, 1e-3, dof)
    levels = protection_level(np.ones(6), slopes, risk, 1e-3, dof=dof)
    for slope, level in zip(slopes, levels, strict=True):
        found = np.max(hidden * (ndtr(slope * size - level) + ndtr(-slope * size - level)))
        assert 0.97 * risk <= found <= risk * (1.0 + 1e-6)


@pytest.mark.parametrize("risk", [1e-4, 1e-13, 1e-20, 1e-40, 1.1e-60])
def test_a_length_has_the_risk_however_small_it_is(risk: float) -> None:
    """Rayleigh and Maxwell: P(|ε| > t) = exp(−t²/2), and erfc(t/√2) + √(2/π) t exp(−t²/2)."""
    plane, space = (
        float(vector_level(np.ones((1, k)), np.zeros(1), risk, 1e-3)[0]) for k in (2, 3)
    )
    # Without a fault a test fails in α = 0.1 % of the cases, which need no bound.
    assert np.exp(-0.5 * plane**2) == pytest.approx(risk / 0.999, rel=1e-2)
    tail = erfc(space / 2**0.5) + (2.0 / np.pi) ** 0.5 * space * np.exp(-0.5 * space**2)
    assert tail == pytest.approx(risk / 0.999, rel=1e-2)


@pytest.mark.parametrize(("risk", "held"), [(1e-3, np.inf), (0.9995, 0.0)])
def test_what_nothing_controls_has_no_bound_unless_every_level_holds(risk, held) -> None:
    """A test without a fault does not reject in 99.9 %: a larger risk needs no bound."""
    sigma, slope = np.array([1.0, 0.0]), np.full(2, np.inf)
    for level in (
        protection_level(sigma, slope, risk, 1e-3),
        vector_level(np.stack([sigma, sigma], axis=1), slope, risk, 1e-3),
    ):
        assert level.tolist() == [held, 0.0]


def test_a_risk_too_small_to_compute_bounds_nothing() -> None:
    """Many rejected readings have many outcomes, of which each has its share of the risk."""
    for level in (
        protection_level(np.array([1.0, 0.0]), np.zeros(2), 1e-70, 1e-3),
        vector_level(np.array([[1.0, 1.0], [0.0, 0.0]]), np.zeros(2), 1e-70, 1e-3),
    ):
        assert level.tolist() == [np.inf, 0.0]
    with pytest.raises(InputError, match="risk must lie between 1e-60 and 1"):
        fga.protection_levels(adjusted("slope_distance"), risk=1e-70)


def test_a_test_is_missed_as_often_as_its_law_says() -> None:
    rng = np.random.default_rng(3)
    w = rng.standard_normal((200_000, 3)) + np.array([2.0, 1.0, 2.0])
    size = np.array([3.0])
    for dof, statistic in ((1, (w[:, 0] + 1.0) ** 2), (3, np.sum(w**2, axis=1))):
        critical = {1: 3.290527**2, 3: 16.26624}[dof]
        missed = int(np.sum(statistic <= critical))
        p = float(missed_detection(size, 1e-3, dof)[0])
        low, high = binom.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], len(w), p)
        assert low <= missed <= high


def test_lengths_of_vectors_have_their_tail() -> None:
    rng = np.random.default_rng(4)
    for axes in ((1.0, 0.25), (1.0, 0.0), (1.0, 0.5, 0.25), (1.0, 1.0, 1.0)):
        size = np.linalg.norm(rng.standard_normal((200_000, len(axes))) * axes, axis=1)
        for t in (0.5, 2.0, 3.0):
            p = float(length_tail(np.array([t]), np.array(axes))[0])
            low, high = binom.ppf([FALSE_ALARM / 2, 1 - FALSE_ALARM / 2], len(size), p)
            assert low <= np.sum(size > t) <= high


def slopes_by_programming(model: DenseModel, axes: np.ndarray, faults: int) -> float:
    """Return the largest bias that no test sees, by linear programmes of all fault modes."""
    best = 0.0
    for mode in combinations(range(len(model.readings)), faults):
        rows = np.concatenate([model.readings[k] for k in mode])
        best = max(best, float(np.abs(axes @ worst_errors(model, axes, rows)).max()))
    return best


@pytest.mark.parametrize("kind", ["slope_distance", "height_difference", "control", "gnss_vector"])
@pytest.mark.parametrize("faults", [1, 2])
def test_slopes_are_those_of_linear_programmes_of_all_fault_modes(kind: str, faults: int) -> None:
    solution = adjusted(kind)
    levels = fga.protection_levels(solution, faults=faults)
    model = DenseModel(solution, levels.alpha)
    i = int(np.argmax(levels.sigmas[:, 2] > 0))
    axes = model.figure(levels.names[i], "z")
    exact = slopes_by_programming(model, axes, faults)
    # An upper bound, and no larger one than it must be.
    assert levels.slopes[i, 2] == pytest.approx(exact, rel=ROUNDING)


def test_one_fault_has_the_external_reliability_as_its_slope() -> None:
    solution = adjusted("slope_distance")
    rel = fga.reliability(solution)
    levels = fga.protection_levels(rel, faults=1)
    name = levels.names[int(np.argmax(levels.sigmas[:, 0] > 0))]
    effects = [
        abs(rel.effect_on(row, name)[0]) / rel.delta0
        for row in range(len(rel.w))
        if rel.controlled[row]
    ]
    assert levels.slopes[levels.number[name], 0] == pytest.approx(max(effects), rel=ROUNDING)
    mode = levels.weakest(name, "x")
    assert mode is not None
    assert mode.rows == (int(np.argmax(effects)),)


def test_few_pairs_give_no_smaller_level(monkeypatch: pytest.MonkeyPatch) -> None:
    solution = adjusted("direction")
    every = fga.protection_levels(solution)
    monkeypatch.setattr(fault_modes, "DENSE_ROWS", 0)
    some = fga.protection_levels(solution)
    assert np.all(some.levels >= every.levels * (1.0 - ROUNDING))
    assert np.all(some.levels <= every.levels * (1.0 + 2.0 * fault_modes.LEAST_COHERENCE) + 1e-9)


@pytest.mark.parametrize("kind", ["slope_distance", "height_difference", "gnss_vector"])
@pytest.mark.parametrize("faults", [1, 2])
def test_trials_keep_the_risk(kind: str, faults: int) -> None:
    solution, risk, number = adjusted(kind), 1e-2, 20_000
    levels = fga.protection_levels(solution, risk=risk, faults=faults)
    model = DenseModel(solution, levels.alpha)
    limit = binom.ppf(1.0 - FALSE_ALARM, number, risk)
    counts = list(of_mode(kind, model, levels, number, np.random.default_rng(5)))
    assert counts
    for count in counts:
        assert count.exceeded <= limit, str(count)
    if faults == 1 and kind != "gnss_vector":
        # A level is no larger than it must be: the worst fault nearly has the risk.
        assert max(c.exceeded for c in counts) >= 0.5 * risk * number


def test_a_smaller_level_fails() -> None:
    solution, number = adjusted("height_difference"), 50_000
    levels = fga.protection_levels(solution, risk=1e-2, faults=1)
    model = DenseModel(solution, levels.alpha)
    i = int(np.argmax(levels.sigmas[:, 2] > 0))
    name = levels.names[i]
    axes = model.figure(name, "z")
    mode = levels.weakest(name, "z")
    assert mode is not None
    rows = model.readings[solution.equations.reading_of_row[mode.rows[0]]]
    fault = worst_errors(model, axes, rows)
    largest = max(
        int(np.sum(trials(model, axes, s * fault, number, np.random.default_rng(6)) > 0.9 * level))
        for s in (2.5, 3.0, 3.5, 4.0)
        for level in (levels.level(name, "z"),)
    )
    assert largest > binom.ppf(1.0 - FALSE_ALARM, number, 1e-2)


def polar() -> fga.Network:
    """Return a levelling loop with a point that one line determines."""
    network = fga.Network("a loop and a spur")
    network.add_point("A", (0, 0, 100.0), fixed="xyz")
    for name, z in (("B", 101.0), ("C", 102.0), ("S", 103.0)):
        network.add_point(name, (0, 0, z), fixed="xy")
    for a, b, dz in (("A", "B", 1.0), ("B", "C", 1.0), ("A", "C", 2.0), ("C", "S", 1.0)):
        network.add(fga.HeightDifference(a, b, dz, sigma=1e-3))
    network.add(fga.HeightDifference("A", "B", 1.0002, sigma=1e-3))
    network.add(fga.HeightDifference("A", "C", 2.0001, sigma=1e-3))
    return network


def test_an_uncontrolled_observation_makes_the_level_infinite_and_is_named() -> None:
    levels = fga.protection_levels(fga.adjust(polar()), faults=1)
    assert np.isinf(levels.level("S", "z"))
    mode = levels.weakest("S", "z")
    assert mode is not None
    assert "C" in str(mode)
    assert "S" in str(mode)
    assert np.isfinite(levels.level("B", "z"))
    assert levels.level("A") == 0.0
    assert levels.weakest("A") is None
    assert "1 infinite" in levels.headline()


def test_two_inseparable_observations_are_named() -> None:
    network = fga.Network("a loop")
    network.add_point("A", (0, 0, 100.0), fixed="xyz")
    for name, z in (("B", 101.0), ("C", 102.0)):
        network.add_point(name, (0, 0, z), fixed="xy")
    for a, b, dz in (("A", "B", 1.0), ("B", "C", 1.0), ("A", "C", 2.0)):
        network.add(fga.HeightDifference(a, b, dz, sigma=1e-3))
    solution = fga.adjust(network)
    assert np.isfinite(fga.protection_levels(solution, faults=1).level("B", "z"))
    levels = fga.protection_levels(solution)
    assert np.isinf(levels.level("B", "z"))
    mode = levels.weakest("B", "z")
    assert mode is not None
    assert len(mode.ids) == 2
    # Errors of A B and another line that cancel in the loop move B, those of B C and A C do not.
    assert 0 in mode.rows


def test_an_alarm_is_told() -> None:
    network = polar()
    (first, *_) = network.observations
    network.observations[first] = replace(network.observations[first], value=1.05)
    levels = fga.protection_levels(fga.adjust(network))
    assert not levels.accepted
    assert "NOT ACCEPTED" in levels.headline()
    assert fga.protection_levels(fga.adjust(polar())).accepted


def test_after_snooping_the_risk_is_divided_among_the_outcomes() -> None:
    network = measure(NETWORKS["height_difference"](), seed=0)
    found = fga.snoop(network)
    assert not found.rejected
    plain, after = (fga.protection_levels(x, risk=1e-3) for x in (found.solution, found))
    assert after.outcome_risk == pytest.approx(0.5e-3)
    assert np.all(after.levels >= plain.levels)
    first = next(iter(network.observations))
    o = network.observations[first]
    network.observations[first] = replace(o, value=o.value + 0.05)
    found = fga.snoop(network)
    assert found.rejected_ids == (first,)
    levels = fga.protection_levels(found, risk=1e-3)
    n = len(network.observations)
    assert levels.rejected == 1
    assert levels.outcome_risk == pytest.approx(1e-3 / 4 / n)


def test_data_snooping_of_nonlinear_networks_keeps_the_risk() -> None:
    """A tenth of the trials may exceed a level of that risk; gross errors from 0 to 12 σ."""
    plan, risk = NETWORKS["slope_distance"](), 0.1
    true = fga.adjust(measure(plan, seed=0, noise=False))
    rng = np.random.default_rng(7)
    exceeded, number = np.zeros((len(true.network.points), len(FIGURES) - 3), dtype=int), 120
    kept: dict[tuple[str, ...], ProtectionLevels] = {}
    for seed in range(number):
        network = measure(plan, seed=seed)
        ids = list(network.observations)
        for k in rng.choice(len(ids), 2, replace=False).tolist():
            o = network.observations[ids[k]]
            network.observations[ids[k]] = replace(
                o, value=o.value + rng.uniform(-12, 12) * float(true.equations.sigmas()[k])
            )
        found = fga.snoop(network, start=true)
        if found.unresolved:
            continue
        key = tuple(sorted(found.rejected_ids))
        if key not in kept:
            kept[key] = fga.protection_levels(found, risk=risk)
        error = np.abs(found.solution.state["point"] - true.state["point"])
        exceeded += error > kept[key].coordinates + 1e-12
    assert exceeded.max() <= binom.ppf(1.0 - FALSE_ALARM, number, risk)
    assert len(kept) > 1


def quadrangle() -> fga.Network:
    """Return four points with all differences of height between them, twice."""
    network = fga.Network("a quadrangle")
    heights = {"A": 100.0, "B": 101.0, "C": 102.0, "D": 103.0}
    for name, z in heights.items():
        network.add_point(name, (0, 0, z), fixed="xyz" if name == "A" else "xy")
    for a, b in (*combinations(heights, 2), *combinations(heights, 2)):
        network.add(fga.HeightDifference(a, b, heights[b] - heights[a], sigma=1e-3))
    return network


def test_an_incremental_adjustment_that_rejects_keeps_the_risk() -> None:
    """Readings come one by one, two of them wrong by up to 12 σ; a tenth may exceed a level."""
    true, risk, number = quadrangle(), 0.1, 40
    given = list(true.observations.values())
    rng, n = np.random.default_rng(9), len(given)
    exceeded, kept = np.zeros(4, dtype=int), dict[tuple[str, ...], Array]()
    for _ in range(number):
        errors = rng.standard_normal(n)
        errors[rng.choice(n, 2, replace=False)] += rng.uniform(-12, 12, 2)
        plan = quadrangle()
        plan.observations.clear()
        inc = fga.IncrementalAdjustment(plan, policy="reject")
        for k in rng.permutation(n).tolist():
            inc.add(replace(given[k], id=f"h{k}", value=given[k].value + 1e-3 * float(errors[k])))
        solution, m = inc.solution(), len(inc.rejected)
        levels = fga.protection_levels(solution, risk=risk, rejected=m)
        assert levels.outcome_risk == pytest.approx(risk / 2 ** (m + 1) / comb(n, m))
        same = kept.setdefault(tuple(sorted(solution.network.observations)), levels.levels)
        np.testing.assert_allclose(levels.levels, same, rtol=ROUNDING)
        if levels.accepted:  # otherwise the levels do not speak of it
            error = np.abs([solution.point(p)[2] - true.points[p].coordinates[2] for p in "ABCD"])
            exceeded += error > levels.vertical + 1e-12
    assert exceeded.max() <= binom.ppf(1.0 - FALSE_ALARM, number, risk)
    assert {n - len(ids) for ids in kept} >= {0, 1, 2}


def test_what_has_no_level_is_refused() -> None:
    network = polar()
    solution = fga.adjust(network)
    with pytest.raises(InputError, match="risk must lie between 1e-60 and 1"):
        fga.protection_levels(solution, risk=0.0)
    with pytest.raises(InputError, match="faults must be 1 or 2"):
        fga.protection_levels(solution, faults=3)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="rejected is -1"):
        fga.protection_levels(solution, rejected=-1)
    with pytest.raises(InputError, match="knows its own"):
        fga.protection_levels(fga.snoop(network), rejected=1)
    with pytest.raises(InputError, match="unknown point"):
        fga.protection_levels(solution, points=["Q"])
    with pytest.raises(InputError, match="estimated σ0"):
        fga.protection_levels(fga.adjust(network, variance="a-posteriori"))
    levels = fga.protection_levels(solution, points=["B"])
    with pytest.raises(InputError, match="not asked for"):
        levels.level("C")
    with pytest.raises(InputError, match="unknown figure"):
        levels.level("B", "down")  # type: ignore[arg-type]
