"""Weighted deflections of the vertical in free networks: their size counts, not their direction."""

from __future__ import annotations

import pytest

import factorgraph_adj as fga
from tests.networks.total_station import total_station
from tests.support.dense import Dense
from tests.support.inner import assert_sigmas, bordered


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("sigma", [1e-6, 1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("stations", [("P0",), ("P0", "P3", "P4")])
@pytest.mark.parametrize("seed", range(4))
def test_a_free_network_with_weighted_deflections_comes_to_rest(sigma, stations, seed):
    """Three shifts and a rotation, with the covariances of dense inner constraints."""
    network = total_station(seed, coarse=0.3)
    for name in stations:
        network.set_vertical(name, sigma=sigma)
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    assert solution.datum_defect == 4
    dense = Dense.at(solution.equations, solution.state)
    assert solution.datum is not None
    assert_sigmas(solution, bordered(solution, solution.datum.motions[dense.free]), rtol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_the_sum_of_squares_is_that_of_any_direction(seed):
    """The same network turned in its approximate coordinates has the same minimum."""
    sums = []
    for turned in (False, True):
        network = total_station(seed, coarse=0.0)
        network.set_vertical("P0", sigma=1e-5)
        if turned:
            for name, p in list(network.points.items()):
                x, y, z = p.coordinates
                network.points[name] = type(p)(name, (-y, x, z))
        solution = fga.adjust(network)
        assert solution.converged, solution.reason
        sums.append(solution.vtpv)
    assert sums[1] == pytest.approx(sums[0], rel=1e-6)


def test_all_verticals_free_and_several_weighted_leave_a_turn_alone():
    """The tilts are told by the weighted ones, the turn about the vertical is not."""
    network = total_station(5, coarse=0.1, verticals=True)
    for name in ("P1", "P2", "P5"):
        network.set_vertical(name, sigma=2e-5)
    solution = fga.adjust(network)
    assert solution.converged, solution.reason
    assert solution.datum_defect == 4
