"""Budgets: the examples of annex H of the GUM to their digits, and shares of an adjustment."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import BudgetInput


def test_gum_h1_gauge_block():
    """JCGM 100:2008, H.1: l = 50 000 838 nm, u = 32 nm, ν_eff = 16, k = 2.92, U_99 = 93 nm."""
    inputs = [
        BudgetInput("standard", 50_000_623.0, 25.0, 18),
        BudgetInput("difference", 215.0, 5.8, 24, "A"),
        BudgetInput("comparator, random", 0.0, 3.9, 5),
        BudgetInput("comparator, systematic", 0.0, 6.7, 8),
        BudgetInput.rectangular("expansion of the standard", 11.5e-6, 2e-6),
        BudgetInput.rectangular("difference of expansions", 0.0, 1e-6, 50),
        BudgetInput.rectangular("difference of temperatures", 0.0, 0.05, 2),
        BudgetInput("mean deviation of temperature", -0.1, 0.2),
        BudgetInput.arcsine("variation of temperature", 0.0, 0.5),
    ]

    def length(ls, d, d1, d2, alpha_s, delta_alpha, delta_theta, mean, variation):
        theta = mean + variation
        return ls + d + d1 + d2 - ls * (delta_alpha * theta + alpha_s * delta_theta)

    found = fga.uncertainty_budget(length, inputs, quantity="l")
    assert found.value == pytest.approx(50_000_838, abs=0.5)
    assert round(found.uncertainty) == 32
    assert math.floor(found.freedom) == 16
    assert found.coverage_factor(0.99) == pytest.approx(2.92, abs=0.005)
    # The standard multiplies rounded numbers, 2.92 · 32 = 93; unrounded: 92.5.
    assert round(2.92 * 32) == 93
    assert found.expanded(0.99) == pytest.approx(92.5, abs=0.1)
    shares = {s.name: s.contribution for s in found.shares}
    assert shares["difference of expansions"] == pytest.approx(2.9, abs=0.05)  # table H.1
    assert shares["difference of temperatures"] == pytest.approx(16.6, abs=0.05)
    assert sum(s.percent for s in found.shares) == pytest.approx(100.0)


V = (5.007, 4.994, 5.005, 4.990, 4.999)
I = (19.663e-3, 19.639e-3, 19.640e-3, 19.685e-3, 19.678e-3)  # noqa: E741  # as in the standard
PHI = (1.0456, 1.0438, 1.0468, 1.0428, 1.0433)


@pytest.mark.parametrize(
    ("function", "value", "uncertainty"),
    [
        (lambda v, i, phi: v / i * math.cos(phi), 127.732, 0.071),
        (lambda v, i, phi: v / i * math.sin(phi), 219.847, 0.295),
        (lambda v, i, phi: v / i, 254.260, 0.236),
    ],
)
def test_gum_h2_resistance_and_reactance(function, value, uncertainty):
    """JCGM 100:2008, H.2, table H.3: inputs that were read together."""
    r = np.corrcoef([V, I, PHI])
    assert np.round(r[0, 1], 2) == -0.36
    inputs = [BudgetInput.observed(n, x) for n, x in (("V", V), ("I", I), ("phi", PHI))]
    correlations = {("V", "I"): r[0, 1], ("V", "phi"): r[0, 2], ("I", "phi"): r[1, 2]}
    found = fga.uncertainty_budget(function, inputs, correlations=correlations)
    assert found.value == pytest.approx(value, abs=6e-4)
    assert found.uncertainty == pytest.approx(uncertainty, abs=6e-4)
    assert found.freedom == 4  # H.2.4: of the five sets of readings


def test_welch_satterthwaite_and_coverage():
    """GUM G.4.3: factors of 0.25, 0.57 and 0.82 %, of 10, 5 and 15 readings: ν_eff 19.0."""
    u = (0.25, 0.57, 0.82)
    given = zip("abc", u, (9, 4, 14), strict=True)
    inputs = [BudgetInput(name, 1.0, x / 100, freedom) for name, x, freedom in given]
    found = fga.uncertainty_budget(lambda a, b, c: a * b * c, inputs)
    assert found.uncertainty == pytest.approx(0.0103, abs=5e-5)
    assert found.freedom == pytest.approx(19.0, abs=0.05)
    assert found.coverage_factor(0.95) == pytest.approx(2.09, abs=0.005)


def test_shares_of_an_adjustment_are_those_of_a_dense_one():
    """Σ a² = gᵀ Q g, and the share of a kind from dense A, P, by Q g."""
    network = fga.Network("a")
    for name, at in (("A", (0, 0, 0)), ("B", (100, 0, 2)), ("C", (40, 90, 5))):
        network.add_point(name, at, fixed="xyz")
    network.add_point("P", (55, 40, 1))
    network.set_distance_meter("EDM", zero=0.001, sigma_zero=0.002)
    for name, d in (("A", 68.02), ("B", 60.22), ("C", 52.36)):
        network.add(fga.SlopeDistance(name, "P", d, sigma=0.003, instrument="EDM"))
        network.add(
            fga.HeightDifference(name, "P", 1.0 - network.points[name].coordinates[2], sigma=0.001)
        )
    solution = fga.adjust(network)
    budget = fga.solution_budget(solution, "P", "x")
    sigma = solution.standard_deviations("P")[0]
    assert budget.uncertainty == pytest.approx(sigma, rel=1e-9)
    p = solution.point("P")
    rows, weights, kinds = [], [], []
    for name in "ABC":
        d = p - np.array(network.points[name].coordinates)
        rows.append([*(d / np.linalg.norm(d)), 1.0])
        rows.append([0.0, 0.0, 1.0, 0.0])
        weights += [1 / 0.003**2, 1 / 0.001**2]
        kinds += ["distance", "height"]
    rows.append([0.0, 0.0, 0.0, 1.0])
    weights.append(1 / 0.002**2)
    kinds.append("constant")
    a, w = np.array(rows), np.array(weights)
    q = np.linalg.inv(a.T * w @ a)
    square = w * (a @ q[:, 0]) ** 2
    expected = {k: square[np.array(kinds) == k].sum() for k in ("distance", "height", "constant")}
    found = {s.name: s for s in budget.shares}
    assert found["slope_distance"].contribution ** 2 == pytest.approx(
        expected["distance"], rel=1e-4
    )
    assert found["height_difference"].contribution ** 2 == pytest.approx(
        expected["height"], rel=1e-4, abs=1e-12
    )
    given = [s for s in budget.shares if s.evaluation == "B"]
    assert sum(s.contribution**2 for s in given) == pytest.approx(expected["constant"], rel=1e-3)
    assert sum(s.percent for s in budget.shares) == pytest.approx(100.0)
    # The budget of the position is the sum of those of the coordinates, in squares.
    whole = fga.solution_budget(solution, "P")
    assert whole.quantity == "position of point 'P'"
    sigmas = solution.standard_deviations("P")
    assert whole.uncertainty == pytest.approx(float(np.linalg.norm(sigmas)), rel=1e-9)
    axes = [fga.solution_budget(solution, "P", axis) for axis in ("x", "y", "z")]
    for share in whole.shares:
        parts = [s.contribution for b in axes for s in b.shares if s.name == share.name]
        assert share.contribution == pytest.approx(float(np.linalg.norm(parts)), abs=1e-12)
    assert "nan" not in whole.headline() and f"u {whole.uncertainty:.4g} m" in whole.headline()


def test_a_budget_is_a_priori_whatever_the_variance_of_the_adjustment():
    network = fga.Network("a")
    network.add_point("A", (0, 0, 0), fixed="xyz")
    network.add_point("P", (0, 0, 1), fixed="xy")
    for value in (1.0, 1.01, 1.02):
        network.add(fga.HeightDifference("A", "P", value, sigma=0.001))
    solution = fga.adjust(network, variance="a-posteriori")
    budget = fga.solution_budget(solution, "P", "z")
    assert budget.uncertainty == pytest.approx(0.001 / np.sqrt(3))
    scaled = solution.sigma0 * budget.uncertainty
    assert scaled == pytest.approx(solution.standard_deviations("P")[2])


def test_the_budget_of_a_distance_has_the_variance_of_the_line():
    from examples.published_blocks.industry_1981 import simulate_industry_block

    solution = fga.adjust(simulate_industry_block(seed=2).network)
    budget = fga.solution_budget(solution, ("P35", "P36"))
    line = fga.distance_precision(solution, "P35", "P36")
    assert budget.uncertainty == pytest.approx(line.sigma, rel=1e-6)
    assert budget.value == pytest.approx(line.distance)
    assert sum(s.percent for s in budget.shares) == pytest.approx(100.0, abs=1e-6)


@pytest.mark.parametrize(
    ("inputs", "correlations", "match"),
    [
        ([], {}, "there are no inputs"),
        ([BudgetInput("a", 1, 1), BudgetInput("a", 1, 1)], {}, "a: is named twice"),
        ([BudgetInput("a", 1, 1)], {("a", "c"): 0.5}, "no input 'c'; valid: a"),
        ([BudgetInput("a", 1, 1), BudgetInput("b", 1, 1)], {("a", "b"): 1.5}, "beyond ±1"),
    ],
)
def test_what_is_no_budget_is_refused(inputs, correlations, match):
    with pytest.raises(fga.InputError, match=match):
        fga.uncertainty_budget(lambda *x: sum(x), inputs, correlations=correlations)
    with pytest.raises(fga.InputError, match="uncertainty must be a number ≥ 0"):
        BudgetInput("a", 1.0, -1.0)
