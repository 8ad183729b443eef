"""Rates of alarms of velocities: counted once more, and with the filter itself."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2, kstest

from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.motion_filter import DAY_S, Motion, MotionModel
from factorgraph_adj.monitoring.raise_rates import AlarmLife
from factorgraph_adj.monitoring.velocity_rates import VelocityRate, raisings

LIFE = AlarmLife(2, 3, clear_after=3)


def rate(noise=0.1, freedom=2):
    return VelocityRate(freedom, 0.25, 0.001, DAY_S, MotionModel(noise=noise))


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_simulated_values_are_those_of_the_filter(noise):
    """T of 300 points has χ² in every epoch, in the simulation and in the filter of matrices."""
    one = rate(noise)
    t = one.simulated(4000, 20, np.random.default_rng(1))
    rng = np.random.default_rng(2)
    mine = []
    for _ in range(300):
        b = 0.001 / np.sqrt(3.0) * rng.standard_normal(2)
        state = Motion.at(0.0, 1e-6 / 3.0 * np.eye(2), one.model)
        for i in range(1, 21):
            y = b + 0.001 * rng.standard_normal(2)
            state = state.updated(i * DAY_S, y, 1e-6 * np.eye(2))
        mine.append(state.velocity_test())
    assert kstest(mine, chi2(2).cdf).pvalue > 1e-3
    for i in (0, 1, 9, 19):
        assert kstest(t[:, i], chi2(2).cdf).pvalue > 1e-4


@pytest.mark.parametrize("life", [AlarmLife(), LIFE])
def test_another_simulation_counts_the_stated_number(life):
    one, epochs, number = rate(), 30, 0.1
    found = one.level(number, life, epochs)
    assert 0.02 < found.relative_error < 0.08
    t = one.simulated(20_000, epochs, np.random.default_rng(99))
    n = raisings(t, chi2.isf(found.level, 2), life).sum(axis=1)
    sigma = np.hypot(n.std() / np.sqrt(len(n)), found.relative_error * number)
    assert n.mean() == pytest.approx(number, abs=3.5 * sigma)


def test_detection_grows_with_time_and_speed():
    one = rate(0.0)
    level = one.level(0.1, LIFE, 30).level
    slow, fast = (
        one.detection(level, LIFE, v * 1e-3 / DAY_S, 5, 25, trials=4000) for v in (0.05, 0.3)
    )
    assert (np.diff(slow) >= 0).all()
    assert (fast >= slow).all()
    assert fast[-1] > 0.99 > slow[-1]
    still = one.detection(level, LIFE, 0.0, 5, 25, trials=4000)
    assert still[-1] < 0.11


def test_rates_that_cannot_be_simulated_are_refused():
    with pytest.raises(InputError, match="too few to simulate"):
        rate().level(1e-6, LIFE, 30)
    with pytest.raises(InputError, match="more than its test can raise"):
        rate().level(20.0, LIFE, 30)
