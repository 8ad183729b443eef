"""Distances from lines in free networks: what they tell of a turn about the line."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import observations as o
from tests.networks.on_shapes import MM, places, posed
from tests.support.dense import Dense
from tests.support.inner import assert_sigmas, bordered, least_noticed


def x_axis(x: np.ndarray) -> np.ndarray:
    """Return the x axis that the frame of the line through points (n, 3) has."""
    network = fga.Network("line")
    network.add_shape("S", "line", origin=(x.mean(axis=0) + np.array([2.0, 1, 3])).round().tolist())
    for i, p in enumerate(x):
        network.add_point(f"P{i}", p, fixed="xyz")
        network.add(o.OnLine("S", f"P{i}", sigma=(MM, MM)))
    return fga.adjust(network).state["frame"][0, :9].reshape(3, 3)[:, 0]


def beside_a_line(
    distances: list[float], seed: int, *, sigma: tuple[float, float] = (MM, MM)
) -> fga.Network:
    """Return points at distances from a line along its x axis, joined by slope distances."""
    rng = np.random.default_rng([seed, 9])
    q = places("line", len(distances), rng)
    x = posed(q, rng)
    x += np.array(distances)[:, None] * x_axis(x)
    around = [[9, 1, 2], [-3, 8, -4], [1, -5, 9.0], [-7, -6, -3]]
    stations = x.mean(axis=0) + np.array(around)
    network = fga.Network("beside a line", datum="free")
    network.add_shape("S", "line", origin=(x.mean(axis=0) + np.array([2.0, 1, 3])).round().tolist())
    at = {f"P{i}": p for i, p in enumerate(x)} | {f"T{i}": p for i, p in enumerate(stations)}
    for name, p in at.items():
        network.add_point(name, p + 2 * MM * rng.normal(size=3))
    names = list(at)
    for i, a in enumerate(names):
        for b in names[max(i + 1, len(x)) :]:
            length = float(np.linalg.norm(at[a] - at[b])) + MM * rng.normal()
            network.add(o.SlopeDistance(a, b, length, sigma=MM))
    for i, d in enumerate(distances):
        network.add(o.OnLine("S", f"P{i}", (d, 0.0), sigma=sigma))
    return network


SIGMAS = ((MM, MM), (MM, 2 * MM))


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("distance", [0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_one_distance_for_all_is_an_offset_of_the_line_and_tells_no_turn(distance, seed, sigma):
    """Dense singular values: five are zero, the sixth is the size of the residuals."""
    solution = fga.adjust(beside_a_line([distance] * 10, seed, sigma=sigma))
    assert solution.converged, solution.reason
    assert solution.datum_defect == 6
    values, _ = least_noticed(solution)
    assert values[5] < 1e-3 * values[6]
    dense = Dense.at(solution.equations, solution.state)
    assert solution.datum is not None
    assert_sigmas(solution, bordered(solution, solution.datum.motions[dense.free]), rtol=1e-4)


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("sigma", SIGMAS)
@pytest.mark.parametrize("distance", [1e-4, 1e-3, 0.3, 1.0])
@pytest.mark.parametrize("seed", range(3))
def test_different_distances_tell_the_turn_where_they_are_long(distance, seed, sigma):
    """The turn has σ/√Σd² of its own: a hundredth of a radian is the limit."""
    each = [distance * (-1) ** i for i in range(10)]
    solution = fga.adjust(beside_a_line(each, seed, sigma=sigma))
    assert solution.converged, solution.reason
    told = sigma[1] / (distance * np.sqrt(10)) < 0.01
    assert solution.datum_defect == (5 if told else 6)
    dense = Dense.at(solution.equations, solution.state)
    assert solution.datum is not None
    ours = solution.datum.motions[dense.free]
    assert_sigmas(solution, bordered(solution, ours), rtol=1e-3)
    _, vectors = least_noticed(solution)
    if told:
        assert_sigmas(solution, bordered(solution, vectors[:, :5]), rtol=1e-3)
