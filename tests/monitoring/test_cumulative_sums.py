"""CUSUM: published run lengths of Crosier (1988), and simulated ones."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring import cumulative_sums
from factorgraph_adj.monitoring.cumulative_sums import (
    CusumDesign,
    average_run_length,
    limit_of_run_length,
    next_sum,
)


@pytest.mark.parametrize(("freedom", "limit"), [(2, 5.50), (5, 9.46), (10, 14.90)])
def test_limits_of_crosier(freedom, limit):
    """κ = 0.5 and run lengths of 200: the limits that Crosier (1988) found by simulation."""
    assert average_run_length(freedom, 0.5, limit) == pytest.approx(200.0, rel=0.05)


def test_run_lengths_of_crosier_after_a_shift():
    """Two coordinates, κ = 0.5, H = 5.50: 9.93 epochs after a shift of 1 σ, 4.1 after 2 σ."""
    design = CusumDesign(2, 0.5, 5.50)
    assert design.steady_run_length(1.0) == pytest.approx(9.93, abs=0.1)
    assert design.steady_run_length(2.0) == pytest.approx(4.15, abs=0.1)


@pytest.mark.parametrize("freedom", [1, 2, 3])
@pytest.mark.parametrize("allowance", [0.25, 1.0])
def test_simulated_run_lengths(freedom, allowance):
    limit = limit_of_run_length(freedom, allowance, 100.0)
    assert average_run_length(freedom, allowance, limit) == pytest.approx(100.0, rel=1e-6)
    found = CusumDesign(freedom, allowance, limit).steady_run_length(0.0, trials=5000)
    assert found == pytest.approx(100.0, rel=4 / np.sqrt(5000))


@pytest.mark.parametrize(("allowance", "run_length"), [(0.02, 1e3), (0.1, 1e6), (4.0, 1e3)])
def test_limits_of_small_and_of_large_allowances(allowance, run_length, monkeypatch):
    limit = limit_of_run_length(3, allowance, run_length)
    monkeypatch.setattr(cumulative_sums, "NODES_PER_UNIT", 6.0)
    assert average_run_length(3, allowance, limit) == pytest.approx(run_length, rel=1e-6)


def test_no_direction_differs_from_another():
    rng = np.random.default_rng(2)
    u = rng.standard_normal((30, 3)) + 0.5
    turn = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    s = turned = np.zeros(3)
    for x in u:
        s, turned = next_sum(s, x, 0.5), next_sum(turned, turn @ x, 0.5)
        assert turned == pytest.approx(turn @ s, abs=1e-12)
    assert np.linalg.norm(s) > 1.0


def test_wrong_designs_are_refused():
    with pytest.raises(InputError, match="allowance of a CUSUM must be positive"):
        limit_of_run_length(3, 0.0, 100.0)
    with pytest.raises(InputError, match="one false alarm in 1 epochs"):
        limit_of_run_length(3, 0.5, 1.0)
    with pytest.raises(InputError, match="one false alarm in 370 epochs of a point, or fewer"):
        limit_of_run_length(1, 3.0, 100.0)
    with pytest.raises(InputError, match="a limit above 400 σ: state a larger allowance"):
        limit_of_run_length(3, 0.001, 1e8)
