"""Repeated readings that differ: the same pairs as one by one, with one σ for each reading."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.statistical_tests import TOLERANCE_IN_SIGMAS
from factorgraph_adj.validate import repeated_readings

SIGMA = fga.StandardDeviation(0.001, ppm=2.0, centring_target=0.0005)


def monitored(n: int, *, spread: float) -> fga.Network:
    """Return n readings of each of two distances, of which every tenth is far off."""
    network, rng = fga.Network("monitoring"), np.random.default_rng(2)
    for name in "SAB":
        network.add_point(name, (0.0, 0.0, 0.0))
    for i in range(n):
        off = 5.0 * spread if i % 10 == 3 else 0.0
        for target, length in (("A", 100.0), ("B", 2000.0)):
            value = length + rng.normal(0.0, spread) + off
            network.add(fga.SlopeDistance("S", target, value, sigma=SIGMA))
    return network


@pytest.mark.parametrize("spread", [1e-4, 2e-3, 2e-2])
def test_pairs_and_figures_are_those_of_a_comparison_one_by_one(spread) -> None:
    network = monitored(20, spread=spread)
    expected = []
    for target in "AB":
        group = [o for o in network.observations.values() if o.target == target]
        for a, b in combinations(group, 2):
            s = [repeated_readings.reading_sigma(o, o.value) for o in (a, b)]
            limit = TOLERANCE_IN_SIGMAS * float(np.hypot(*s))
            if abs(a.value - b.value) > limit:
                expected.append((f"{a.label()} and {b.label()} differ", a.value - b.value, limit))
    found = [
        f for f in repeated_readings.differing_repetitions(network) if f.what.endswith("differ")
    ]
    assert bool(expected) == (spread > 1e-3)
    assert [f.what for f in found] == [what for what, _, _ in expected]
    for f, (_, w, limit) in zip(found, expected, strict=True):
        assert (f.size, f.tolerance) == pytest.approx((1e3 * w, 1e3 * limit), rel=1e-9)


def test_each_reading_has_its_sigma_once(monkeypatch) -> None:
    """A day of monitoring has thousands of readings of one target, and millions of pairs."""
    network, calls = monitored(500, spread=1e-4), []
    original = repeated_readings.reading_sigma

    def counted(o, length):
        calls.append(o.id)
        return original(o, length)

    monkeypatch.setattr(repeated_readings, "reading_sigma", counted)
    list(repeated_readings._distances(network))
    assert len(calls) == len(network.observations)


def test_heights_forth_and_back_are_compared_each_with_each() -> None:
    network = fga.Network("forth and back")
    for name in "AB":
        network.add_point(name, (0.0, 0.0, 0.0))
    for a, b, zeniths in (("A", "B", (1.5, 1.5)), ("B", "A", (np.pi - 1.5, np.pi - 1.45))):
        network.add(fga.SlopeDistance(a, b, 100.0, sigma=0.001))
        for z in zeniths:
            network.add(fga.ZenithAngle(a, b, z, sigma=1e-5))
    found = list(repeated_readings._heights(network))
    assert len(found) == 2  # the second back sight with both forth
    for f in found:
        assert abs(f.size) == pytest.approx(1e5 * (np.cos(1.45) - np.cos(1.5)), rel=1e-3)
