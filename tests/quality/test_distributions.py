"""Quantiles and probabilities: closed forms where there are any, and those of scipy.stats."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy
from scipy import stats

from factorgraph_adj.statistical_tests import (
    chi2_lower_probability,
    chi2_quantile,
    chi2_upper_probability,
    chi2_upper_quantile,
    fisher_quantile,
    normal_quantile,
    student_quantile,
)

PROBABILITIES = (1e-12, 1e-4, 0.0005, 0.025, 0.2, 0.5, 0.8, 0.95, 0.999, 1 - 1e-9)
FREEDOMS = (1, 2, 3, 7, 30, 121, 4000, 0.3, 12.75)
ROUNDING = 1e-12
"""Relative error of a closed form in double precision, with p as near to 1 as 1e-4."""
BOOST = tuple(map(int, scipy.__version__.split(".")[:2])) >= (1, 17)
STUDENT = ROUNDING if BOOST else 1e-10
"""The same for quantiles of Student's t, which Cephes computed before scipy 1.17: 2e-11 off."""


@pytest.mark.parametrize("p", [0.0005, 0.025, 0.2, 0.8, 0.95, 0.999])
def test_quantiles_are_those_of_the_closed_forms(p):
    for n in (1, 2, 5, 40):
        by_hand = n / 2 * ((1 - p) ** (-2 / n) - 1)
        assert fisher_quantile(p, 2, n) == pytest.approx(by_hand, rel=ROUNDING)
    assert chi2_quantile(p, 2) == pytest.approx(-2 * math.log1p(-p), rel=ROUNDING)
    assert float(chi2_upper_quantile(p, 2)) == pytest.approx(-2 * math.log(p), rel=ROUNDING)
    assert student_quantile(p, 1) == pytest.approx(math.tan(math.pi * (p - 0.5)), rel=STUDENT)
    x = normal_quantile(p)
    assert 0.5 * math.erfc(-x / math.sqrt(2)) == pytest.approx(p, rel=ROUNDING)


@pytest.mark.parametrize("x", [1e-3, 0.7, 5.0, 60.0])
def test_probabilities_are_those_of_the_closed_forms(x):
    assert chi2_upper_probability(x, 2) == pytest.approx(math.exp(-x / 2), rel=ROUNDING)
    assert chi2_lower_probability(x, 2) == pytest.approx(-math.expm1(-x / 2), rel=ROUNDING)


def test_every_figure_is_that_of_scipy_stats_to_the_last_bit():
    for p in PROBABILITIES:
        assert normal_quantile(p) == stats.norm.ppf(p)
        for f in FREEDOMS:
            assert student_quantile(p, f) == stats.t.ppf(p, f)
            assert -student_quantile(p, f) == stats.t.isf(p, f)
            assert chi2_quantile(p, f) == stats.chi2.ppf(p, f)
            assert chi2_lower_probability(100 * p, f) == stats.chi2.cdf(100 * p, f)
            assert chi2_upper_probability(100 * p, f) == stats.chi2.sf(100 * p, f)
            for g in FREEDOMS:
                assert fisher_quantile(p, f, g) == stats.f.ppf(p, f, g)
        upper = chi2_upper_quantile(p, np.array(FREEDOMS))
        assert np.array_equal(upper, stats.chi2.isf(p, np.array(FREEDOMS)))
