"""Rates of alarms against simulation, and against what is known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, chi2, ncx2

from factorgraph_adj.errors import InputError
from factorgraph_adj.monitoring.raise_rates import AlarmLife, RaiseRate, level_of_rate
from factorgraph_adj.monitoring.velocity_rates import raisings

LIVES = {
    "one": AlarmLife(),
    "two of three": AlarmLife(2, 3, clear_after=3),
    "three of five": AlarmLife(3, 5, release=0.9, clear_after=6),
}


def simulated_values(rng, freedom, share, trials, epochs, shift=0.0):
    """Return T of points whose epochs share the error of a reference, (trials, epochs)."""
    w = np.sqrt(share) * rng.standard_normal((trials, 1, freedom))
    u = w + np.sqrt(1 - share) * rng.standard_normal((trials, epochs, freedom))
    u[..., 0] += shift
    return (u**2).sum(axis=2)


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5])
@pytest.mark.parametrize("freedom", [1, 3])
@pytest.mark.parametrize("life", LIVES.values(), ids=LIVES)
def test_raisings_of_simulated_points(life, freedom, share):
    rng = np.random.default_rng([freedom, int(10 * share), life.n])
    epochs, trials = 60, 20_000
    level = level_of_rate(0.2, freedom, (share,), life, epochs)
    t = simulated_values(rng, freedom, share, trials, epochs)
    n = raisings(t, chi2.isf(level, freedom), life).sum(axis=1)
    assert n.mean() == pytest.approx(0.2, abs=3.5 * n.std() / np.sqrt(trials))


def test_epochs_without_a_common_reference():
    """One epoch of independent ones raises, and clears at once with a release value of its own."""
    rate = RaiseRate(2, 0.0, AlarmLife(1, 1, release=1.0, clear_after=1))
    # In half of the pairs of raised and clear epochs: n p (1 − p) + …, to first order n p.
    assert rate.expected_raisings(1e-6, 1000) == pytest.approx(1e-3, rel=1e-4)


def test_points_add_up():
    one = level_of_rate(0.01, 3, (0.1,), AlarmLife(), 100)
    twelve = level_of_rate(0.12, 3, (0.1,) * 12, AlarmLife(), 100)
    assert one == pytest.approx(twelve, rel=1e-3)


def test_power_without_a_common_reference_is_binomial():
    life = LIVES["two of three"]
    p = ncx2.sf(chi2.isf(0.01, 3), 3, 9.0)
    assert RaiseRate(3, 0.0, life).power(0.01, 3.0) == pytest.approx(binom.sf(1, 3, p), rel=1e-9)


@pytest.mark.parametrize("share", [0.1, 0.5])
@pytest.mark.parametrize("freedom", [1, 3])
def test_power_and_time_to_detection_of_simulated_displacements(freedom, share):
    life, level = LIVES["two of three"], 0.005
    rate = RaiseRate(freedom, share, life)
    size = rate.detectable(level, 0.8)
    assert rate.power(level, size) == pytest.approx(0.8, abs=1e-5)
    trials = 40_000
    t = simulated_values(np.random.default_rng(3), freedom, share, trials, 60, size)
    begun = raisings(t, chi2.isf(level, freedom), life)
    assert begun[:, :3].any(axis=1).mean() == pytest.approx(0.8, abs=3.5 * 0.4 / np.sqrt(trials))
    first = np.where(begun.any(axis=1), begun.argmax(axis=1) + 1, 60)
    assert rate.time_to_detection(level, size) == np.median(first)


@pytest.mark.parametrize("share", [0.9, 0.99, 0.999])
def test_a_reference_that_is_worse_than_the_epochs(share):
    """Probabilities that change within a small part of the error of the reference."""
    rate, level = RaiseRate(3, share, AlarmLife()), 1e-3
    t = simulated_values(np.random.default_rng(5), 3, share, 200_000, 2, 3.0)[:, 0]
    power = (t > chi2.isf(level, 3)).mean()
    assert rate.power(level, 3.0) == pytest.approx(ncx2.sf(chi2.isf(level, 3), 3, 9.0), rel=1e-3)
    assert power == pytest.approx(rate.power(level, 3.0), abs=0.004)
    # One epoch raises with the probability of the test, whatever its error is made of.
    assert rate.expected_raisings(1e-5, 1) == pytest.approx(1e-5, rel=1e-3)


def test_a_small_displacement_is_found_late():
    """Without a common reference the number of epochs until an alarm is geometric."""
    p = ncx2.sf(chi2.isf(1e-4, 3), 3, 1.0)
    median = np.ceil(np.log(0.5) / np.log1p(-p))
    assert median > 500
    assert RaiseRate(3, 0.0, AlarmLife()).time_to_detection(1e-4, 1.0) == median
    # With one, it soon raises the alarms of references that are far off, and late all others.
    t = np.zeros(2000)
    rng, rate = np.random.default_rng(8), RaiseRate(3, 0.5, AlarmLife())
    w = np.sqrt(0.5) * rng.standard_normal((len(t), 3)) + np.array([2.0, 0.0, 0.0])
    own = ncx2.sf(2 * chi2.isf(1e-4, 3), 3, 2 * (w**2).sum(axis=1))
    t = np.ceil(np.log(rng.uniform(size=len(t))) / np.log1p(-own))
    assert rate.time_to_detection(1e-4, 2.0) == pytest.approx(np.median(t), rel=0.25)
    assert rate.time_to_detection(1e-9, 0.5) == np.inf


def test_what_cannot_be_kept_is_refused():
    with pytest.raises(InputError, match="k of n epochs"):
        AlarmLife(3, 2)
    with pytest.raises(InputError, match="clear_after must be at least n = 4"):
        AlarmLife(1, 4)
    with pytest.raises(InputError, match="share of the reference"):
        RaiseRate(3, 1.0, AlarmLife())
    with pytest.raises(InputError, match="50 false alarms in 60 epochs of 1 points"):
        level_of_rate(50.0, 3, (0.1,), AlarmLife(), 60)
