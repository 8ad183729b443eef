"""One centring error for all rounds of a set-up: a point of the set-up, tied to the mark."""

from __future__ import annotations

import numpy as np

import factorgraph_adj as fga

TARGETS = {"A": (0.0, 0.0), "B": (100.0, 5.0), "C": (40.0, 90.0)}
MARK = np.array([45.0, 35.0])
READING, CENTRING, ROUNDS = 0.001, 0.002, 4


def set_up(rng: np.random.Generator | None = None, *, shared: bool = True) -> fga.Network:
    """Return rounds of distances from one tripod; ``shared``: one centring error for all."""
    at = MARK if rng is None else MARK + rng.normal(0.0, CENTRING, 2)
    network = fga.Network("rounds")
    for name, xy in TARGETS.items():
        network.add_point(name, (*xy, 0.0), fixed="xyz")
    network.add_point("S", (*MARK, 0.0), fixed="z")
    station, sigma = "S", fga.StandardDeviation(READING, centring_instrument=CENTRING)
    if shared:
        station, sigma = "S, set-up 1", fga.StandardDeviation(READING)
        network.add_point(station, (*MARK, 0.0), fixed="z")
        tie = fga.CoordinateDifference("S", station, (0.0, 0.0), axes="xy", sigma=CENTRING)
        network.add(tie)
    for _ in range(ROUNDS):
        for name, xy in TARGETS.items():
            length = float(np.hypot(*(np.array(xy) - at)))
            length += 0.0 if rng is None else rng.normal(0.0, READING)
            network.add(fga.SlopeDistance(station, name, length, sigma=sigma))
    return network


def test_a_tied_point_is_the_covariance_that_a_common_centring_gives_the_readings() -> None:
    """Dense: Q_ll = s² I + c² J Jᵀ with the partials J of all readings by the centring."""
    away = np.array([MARK - xy for xy in TARGETS.values()] * ROUNDS)
    j = away / np.linalg.norm(away, axis=1, keepdims=True)
    q = READING**2 * np.eye(len(j)) + CENTRING**2 * j @ j.T
    expected = np.linalg.inv(j.T @ np.linalg.solve(q, j))
    found = fga.adjust(set_up()).covariance("S")[:2, :2]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    independent = fga.adjust(set_up(shared=False)).covariance("S")[:2, :2]
    assert np.trace(independent) < 0.5 * np.trace(expected)  # rounds do not reduce a centring


def test_regions_of_a_shared_centring_cover_the_mark_as_often_as_stated() -> None:
    """95 % of 300 regions cover the mark; those of centrings that count in each round do not."""
    rng = np.random.default_rng(7)
    covered = {True: 0, False: 0}
    for _ in range(300):
        seed = int(rng.integers(1 << 30))
        for shared in covered:
            solution = fga.adjust(set_up(np.random.default_rng(seed), shared=shared))
            d = solution.point("S")[:2] - MARK
            t2 = float(d @ np.linalg.solve(solution.covariance("S")[:2, :2], d))
            covered[shared] += t2 < 5.991  # χ², 2 degrees of freedom, 95 %
    assert 272 <= covered[True] <= 296  # 285 ± 3 × 3.8
    assert covered[False] < 260
