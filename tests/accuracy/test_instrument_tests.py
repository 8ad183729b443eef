"""Field tests of ISO 17123 against least squares adjustments of their own, and random readings."""

from __future__ import annotations

import math

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.accuracy.instrument_tests import InstrumentTest

RNG = np.random.default_rng(17123)
MGON = fga.GON / 1000


def least_squares(a, y):
    """Return estimates, s and cofactors of a plain adjustment of equal weights by its rank."""
    q = np.linalg.pinv(a.T @ a)
    x = q @ a.T @ y
    v = a @ x - y
    freedom = len(y) - np.linalg.matrix_rank(a)
    return x, math.sqrt(v @ v / freedom), q, freedom


def directions(sigma=MGON, m=4, n=3, t=5):
    target = np.sort(RNG.uniform(0, 2 * math.pi, t))
    turn = RNG.uniform(0, 2 * math.pi, (m, n, 1))
    first = target + turn + RNG.normal(scale=sigma, size=(m, n, t)) + 0.02 * MGON
    second = target + turn + math.pi + RNG.normal(scale=sigma, size=(m, n, t)) - 0.02 * MGON
    return np.stack([first, second], axis=-1) % (2 * math.pi)


def test_horizontal_directions_are_those_of_an_adjustment_of_sets():
    """Unknown: directions of the targets and an orientation of each set, within each series."""
    readings = directions()
    found = fga.direction_test(readings)
    square = 0.0
    for series in readings:
        two = np.unwrap(series - np.array([0.0, math.pi]), axis=-1)
        mean = two.mean(axis=-1)
        start = mean[0] - mean[0, 0]
        y = mean - mean[:, :1] - start
        y = ((y + math.pi) % (2 * math.pi) - math.pi).ravel()
        n, t = mean.shape
        a = np.zeros((n * t, t + n))
        a[np.arange(n * t), np.tile(np.arange(t), n)] = 1.0
        a[np.arange(n * t), t + np.repeat(np.arange(n), t)] = 1.0
        _, s, _, freedom = least_squares(a, y)
        assert freedom == (n - 1) * (t - 1)
        square += s * s
    assert found.s == pytest.approx(math.sqrt(square / 4), rel=1e-9)
    assert found.freedom == 32
    assert found.agrees_with(MGON)
    assert not found.agrees_with(0.4 * MGON)
    assert len(found.of_series) == 4


def test_zenith_angles_and_their_index_error():
    target = np.array([1.4, 1.5, 1.6, 1.7])
    noise = RNG.normal(scale=MGON, size=(4, 3, 4, 2))
    index = 0.7 * MGON
    readings = np.stack([target + index, 2 * math.pi - target + index], axis=-1) + noise
    found = fga.zenith_test(readings)
    z = (readings[..., 0] - readings[..., 1] + 2 * math.pi) / 2
    square = 0.0
    for series in z:
        a = np.tile(np.eye(4), (3, 1))
        square += least_squares(a, series.ravel())[1] ** 2
    assert found.s == pytest.approx(math.sqrt(square / 4), rel=1e-9)
    assert found.freedom == 32
    (error,) = found.offsets
    assert abs(error.value - index) < 3 * error.sigma
    assert not error.is_zero


def test_a_level_and_the_zeros_of_its_staves():
    """Unknown: the height difference, and twice the difference of the zeros in series 2."""
    n, h, zero = 20, 0.4321, 0.0006
    first = np.column_stack([1.5 + h + RNG.normal(scale=2e-4, size=n), np.full(n, 1.5)])
    second = np.column_stack([1.5 + h - zero + RNG.normal(scale=2e-4, size=n), np.full(n, 1.5)])
    found = fga.level_test(first, second)
    a = np.column_stack([np.ones(2 * n), np.r_[np.ones(n), np.zeros(n)]])
    y = np.r_[first[:, 0] - first[:, 1], second[:, 0] - second[:, 1]]
    x, s, q, freedom = least_squares(a, y)
    assert found.freedom == freedom == 38
    assert found.s == pytest.approx(s * 2.89, rel=2e-3)  # the factor that ISO 17123-2 prints
    (offset,) = found.offsets
    assert (offset.value, offset.sigma) == pytest.approx((x[1], s * math.sqrt(q[1, 1])))
    assert not offset.is_zero


def test_a_distance_meter_and_its_zero_correction():
    """As the network of the same distances with an instrument constant."""
    at = np.array([0.0, 19.0, 57.5, 99.0, 155.0, 231.0, 300.0])
    d = np.triu(at[None, :] - at[:, None]) - 0.003
    d[np.triu_indices(7, 1)] += RNG.normal(scale=0.001, size=21)
    found = fga.distance_meter_test(d)
    network = fga.Network("line")
    for k, x in enumerate(at):
        network.add_point(f"P{k}", (x, 0.0, 0.0), fixed="xyz" if k == 0 else "yz")
    network.set_distance_meter("EDM", free=["zero"])
    for i, j in zip(*np.triu_indices(7, 1), strict=True):
        network.add(
            fga.SlopeDistance(f"P{i}", f"P{j}", float(d[i, j]), sigma=0.001, instrument="EDM")
        )
    solution = fga.adjust(network)
    (zero,) = found.offsets
    constant = solution.distance_meter("EDM")
    assert found.freedom == solution.redundancy == 14
    assert found.s == pytest.approx(0.001 * solution.sigma0, rel=1e-6)
    assert zero.value == pytest.approx(-constant["zero"], abs=1e-9)
    assert zero.sigma == pytest.approx(
        solution.sigma0 * math.sqrt(solution.variable_covariance(("edm", "EDM"))[1, 1]),
        rel=1e-6,
    )
    assert not zero.is_zero


def test_tests_hold_their_probability():
    """Of 2 000 tests with the stated σ, 5 % exceed it; two samples agree in 95 %."""
    s = [fga.direction_test(directions(t=4, n=2)) for _ in range(2000)]
    sigma = MGON / math.sqrt(2)
    assert np.mean([found.agrees_with(sigma) for found in s]) == pytest.approx(0.95, abs=0.015)
    pairs = zip(s[::2], s[1::2], strict=True)
    assert np.mean([a.agrees_with_test(b) for a, b in pairs]) == pytest.approx(0.95, abs=0.02)


def test_what_is_no_test_is_refused():
    with pytest.raises(fga.InputError, match=r"readings: must be finite numbers of the shape"):
        fga.direction_test(np.zeros((4, 3, 5)))
    with pytest.raises(fga.InputError, match=r"first: must be .*, not \(3,\)"):
        fga.level_test(np.zeros(3), np.zeros((3, 2)))
    with pytest.raises(fga.InputError, match="matrix of the distances of 4 points at least"):
        fga.distance_meter_test(np.zeros((3, 3)))
    a = InstrumentTest("ISO 17123-3, zenith angles", 1.0, 32)
    with pytest.raises(fga.InputError, match="is not compared with"):
        a.agrees_with_test(InstrumentTest("ISO 17123-4, distances", 1.0, 14))
