"""The evidence of errors, with σ0 known and estimated, and the readings that it does not divide."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from scipy import special, stats

import factorgraph_adj as fga
from factorgraph_adj.observations import HeightDifference
from factorgraph_adj.quality.causes.cause_search import Cause, ordered_causes, sized_causes
from factorgraph_adj.quality.causes.evidence import VarianceFactor, evidence
from factorgraph_adj.quality.causes.separability import MIN_T2_DIFFERENCE, separability_tolerance
from tests.benchmarks.causes import adjusted
from tests.networks.building_site import site

LONG = pytest.mark.slow(
    "frequencies in simulated networks; short tests compute the evidence itself"
)

SIGMA = 0.001
"""Standard deviation of a levelled difference of heights, metres."""


@pytest.mark.parametrize("dof", [1, 2, 3])
@pytest.mark.parametrize("t2", [0.3, 12.0, 90.0])
def test_evidence_is_minus_the_logarithm_of_the_tail(dof: int, t2: float) -> None:
    assert evidence(t2, dof) == pytest.approx(-stats.chi2.logsf(t2, dof), rel=1e-9)
    for freedom in (1, 4, 30):
        tail = stats.f.sf(t2 / dof, dof, freedom)
        assert evidence(t2, dof, freedom) == pytest.approx(-np.log(tail), rel=1e-9)
    assert evidence(t2, dof, 1e9) == pytest.approx(evidence(t2, dof), rel=1e-5)
    assert evidence(t2, dof, 0) == 0.0


@pytest.mark.parametrize("t2", [1e3, 2e3, 1e5, 1e9])
def test_evidence_goes_on_where_probabilities_underflow(t2: float) -> None:
    """Of two components it is exact: ½ T², and ½ f ln(1 + T²/f); of one that of a normal value."""
    assert evidence(t2, 2) == pytest.approx(0.5 * t2, rel=1e-9)
    for freedom in (40.0, 4000.0):
        exact = 0.5 * freedom * np.log1p(t2 / freedom)
        assert evidence(t2, 2, freedom) == pytest.approx(exact, rel=1e-9)
    exact = -np.log(2.0) - special.log_ndtr(-np.sqrt(t2))
    assert evidence(t2, 1) == pytest.approx(exact, rel=1e-3)


@pytest.mark.parametrize("dof", [1, 3])
def test_evidence_has_no_step_where_probabilities_underflow(dof: int) -> None:
    for freedom in (900.0, np.inf):
        found = [evidence(t2, dof, freedom) for t2 in np.linspace(1000.0, 6000.0, 400).tolist()]
        slope = np.diff(found)
        assert (slope > 0).all()
        assert np.abs(np.diff(slope)).max() < 0.01 * slope[0]


def test_an_estimated_sigma0_is_what_the_error_leaves_of_vtpv() -> None:
    solution = fga.adjust(_levelling(3, 0.02), variance="a-posteriori")
    r, vtpv = solution.redundancy, solution.vtpv
    weight = VarianceFactor.left_by(solution, estimated=True, t2=0.75 * vtpv, dof=1)
    assert weight.variance == pytest.approx(0.25 * vtpv / (r - 1))
    assert weight.freedom == r - 1
    assert VarianceFactor.left_by(solution, estimated=False, t2=1.0, dof=1) == VarianceFactor()
    for dof in (r, r + 1):
        nothing = VarianceFactor.left_by(solution, estimated=True, t2=0.0, dof=dof)
        assert nothing.critical(dof, 0.001) == np.inf
        assert nothing.limit(dof, 0.001) == 0.0


def test_indifference_is_half_a_difference_of_t2() -> None:
    assert separability_tolerance(100.0) == MIN_T2_DIFFERENCE / 2
    assert separability_tolerance(1e7) > MIN_T2_DIFFERENCE / 2


@pytest.mark.parametrize("estimated", [False, True])
def test_evidence_of_good_readings_has_an_exponential_distribution(estimated: bool) -> None:
    """−ln of a tail probability: half of them are below ln 2, one in twenty above ln 20."""
    found = []
    for seed in range(4):
        solution = fga.adjust(adjusted(*site(300 + seed)[:2]))
        for c in sized_causes(solution):
            if c.dof:
                weight = VarianceFactor.left_by(solution, estimated=estimated, t2=c.t2, dof=c.dof)
                found.append(evidence(c.t2 / weight.variance, c.dof, weight.freedom))
    assert len(found) > 300
    assert 0.4 < np.mean(np.array(found) < np.log(2.0)) < 0.6
    assert 0.01 < np.mean(np.array(found) > np.log(20.0)) < 0.1


@pytest.mark.parametrize("metres", [0.02, 0.3, 30.0])
@pytest.mark.parametrize("variance", ["a-priori", "a-posteriori"])
def test_a_wrong_given_height_is_named_whatever_sigma0_is(metres: float, variance: str) -> None:
    """T² r / vᵀPv cannot exceed r, here 9, however wrong the height is."""
    found = fga.snoop(
        _levelling(3, metres),
        variance=variance,  # type: ignore[arg-type]
        test="pope" if variance == "a-posteriori" else "baarda",
    ).causes
    assert found is not None
    assert found.most_probable is not None
    assert found.most_probable.where == "of point 'A'"
    assert abs(found.most_probable.error[0] - metres) < 4.0 * found.most_probable.sigma[0]


def test_good_heights_are_not_named_with_an_estimated_sigma0() -> None:
    """Levelling lines with σ that are ten times too small: nothing is wrong with any of them."""
    named = 0
    for seed in range(40):
        solution = fga.adjust(_levelling(seed, 0.0, times=10.0), variance="a-posteriori")
        named += bool(fga.causes(fga.reliability(solution)).more_probable)
    assert named <= 2


@LONG
def test_the_wrong_reading_is_on_the_list_where_several_may_be_it() -> None:
    """Levelling of low redundancy, one gross error: the true one need not be the largest."""
    several = 0
    for seed in range(120):
        network, wrong = _loops(seed)
        solution = fga.adjust(network)
        rel = fga.reliability(solution)
        found = fga.causes(rel)
        row = int(np.flatnonzero([solution.equations.id(i) == wrong for i in range(len(rel.w))])[0])
        if not found.readings or not rel.controlled[row]:
            continue
        several += len(found.readings) > 1
        assert solution.equations.label(row) in found.readings
    assert several > 40


@LONG
@pytest.mark.parametrize(("estimated", "times"), [(False, 7.0), (True, 100.0)])
def test_readings_are_alike_that_explain_one_another(estimated: bool, times: float) -> None:
    """Against two adjustments with one of the two withdrawn, and one with both."""
    checked = 0
    for seed in range(12):
        network, _ = _loops(seed, times=times, more=2 * estimated)
        variance = "a-posteriori" if estimated else "a-priori"
        solution = fga.adjust(network, variance=variance)  # type: ignore[arg-type]
        rel = fga.reliability(solution)
        found = fga.causes(rel)
        if not found.readings:
            continue
        ids, r = [o.id for o in network.observations.values()], solution.redundancy
        first = ids[int(np.argmax(np.where(rel.controlled, np.abs(rel.w), 0.0)))]

        def left(*gone: str | None, network: fga.Network = network) -> float:
            other = network.copy()
            for i in gone:
                other.observations[i] = replace(other.observations[i], sigma=1e3)  # type: ignore[index, call-arg]
            return fga.adjust(other).vtpv

        def said(t2: float, dof: int, rest: float, freedom: int) -> float:
            return evidence(t2 * freedom / rest, dof, freedom) if estimated else evidence(t2, dof)

        most = said(solution.vtpv - left(first), 1, left(first), r - 1)
        alike = {first}
        for row, i in enumerate(ids):
            if i == first or not rel.controlled[row]:
                continue
            both = left(first, i)
            tests = [left(x) - both for x in (first, i)]
            enough = max(said(t, 1, both, r - 2) if r > 2 else 0.0 for t in tests)
            own = said(solution.vtpv - left(i), 1, left(i), r - 1)
            near = min(abs(enough + np.log(rel.alpha)), abs(most - own - 5.5)) < 0.01
            if (enough <= -np.log(rel.alpha) and most - own < 5.5) or near:
                alike.add(i)
        labels = {solution.equations.label(row) for row, i in enumerate(ids) if i in alike}
        assert set(found.readings) == labels
        checked += 1
    assert checked > 5


def _levelling(seed: int, metres: float, *, times: float = 1.0) -> fga.Network:
    """Return heights between six points, three of them given, A wrong by some metres."""
    rng = np.random.default_rng([seed, 77])
    network = fga.Network("levelling")
    true = dict(zip("ABCDEF", rng.uniform(90.0, 110.0, 6).tolist(), strict=True))
    for name, height in true.items():
        given = height + (metres if name == "A" else 0.0)
        network.add_point(name, (0.0, 0.0, given), fixed="xyz" if name in "ABC" else "xy")
    pairs = [p for p in combinations(true, 2) if set(p) & set("DEF")]
    for a, b in pairs:
        value = true[b] - true[a] + times * SIGMA * rng.normal()
        network.add(HeightDifference(a, b, value, sigma=SIGMA))
    return network


def _loops(seed: int, *, times: float = 12.0, more: int = 0) -> tuple[fga.Network, str]:
    """Return levelled loops of redundancy 2 or 3, or more, with one wrong reading, and its id."""
    rng = np.random.default_rng([seed, 78])
    n = int(rng.integers(4, 7))
    true = rng.uniform(90.0, 110.0, n)
    network = fga.Network("loops")
    for i in range(n):
        at = (0.0, 0.0, float(true[i]))
        network.add_point(f"B{i}", at, fixed="xy" if i else "xyz")
    pairs = [(i, (i + 1) % n) for i in range(n)]
    pairs += [(0, 2), (1, 3), (0, 3), (2, 1)][: more + int(rng.integers(1, 3))]
    wrong = int(rng.integers(len(pairs)))
    for number, (a, b) in enumerate(pairs):
        error = times * (number == wrong) + rng.normal()
        value = float(true[b] - true[a] + SIGMA * error)
        network.add(HeightDifference(f"B{a}", f"B{b}", value, sigma=SIGMA, id=f"r{number}"))
    return network, f"r{wrong}"


@pytest.mark.parametrize("t2", [1e17, 1e25, np.inf])
def test_causes_are_ordered_whatever_their_size(t2: float) -> None:
    """Of a large number nothing is left of the difference that counts."""
    none = np.zeros(0)
    kinds = [
        Cause(f"cause {n}", "", (), (), none, none, size, 1, 0.0, (), rank=2 - n)
        for n, size in enumerate((1.0, t2, t2))
    ]
    assert [c.cause for c in ordered_causes(kinds)] == ["cause 2", "cause 1", "cause 0"]
