"""The smallest networks of the benchmarks of growth, and the block that pycolmap is given too."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.simulation import simulated_blocks
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from tests.benchmarks import colmap
from tests.benchmarks.blocks import OVERLAPS, simulate_photos_alone
from tests.benchmarks.grids import simulate_grid
from tests.benchmarks.growth import GRIDS, GROWTH, exponent

LONG = pytest.mark.slow("blocks with much overlap; short tests take ordinary ones")


def smallest(name: str) -> fga.Network:
    """Return the smallest grid, or the smallest block with the overlap of that name."""
    if name == "grid":
        return simulate_grid(1, points=GRIDS[0]).network
    return simulate_aerial_block(1, image_points=GROWTH[0], overlap=OVERLAPS[name]).network


@pytest.mark.parametrize("name", [*OVERLAPS, "grid"])
def test_the_smallest_network_of_each_kind_is_adjusted(name: str) -> None:
    """σ̂0 within 4 σ of 1, and redundancy numbers whose sum is the redundancy."""
    solution = fga.adjust(smallest(name))
    assert solution.converged
    assert abs(solution.sigma0 - 1.0) < 4.0 / np.sqrt(2.0 * solution.redundancy)
    total = fga.reliability(solution).redundancy_numbers.sum()
    assert total == pytest.approx(solution.redundancy, abs=1e-8)


@LONG
def test_an_overlap_of_80_and_60_doubles_the_rays_of_a_point() -> None:
    """A point of the inner block is seen in 1 / ((1 − p)(1 − q)) photos, 5.6 and 12.5."""
    inside = {}
    for name, overlap in OVERLAPS.items():
        made = simulate_aerial_block(1, image_points=60_000, overlap=overlap)
        point = made.network.images.columns()[1]
        centres = np.array([photo.position for photo in made.truth.photos.values()])
        c = simulated_blocks.AERIAL_CALIBRATION["c"]
        margin = simulated_blocks.HEIGHT / c * np.array(simulated_blocks.AERIAL_SENSOR_MM) / 2
        low, high = centres[:, :2].min(axis=0) + margin, centres[:, :2].max(axis=0) - margin
        ground = np.array(list(made.truth.points.values()))[:, :2]
        inner = np.all((ground > low) & (ground < high), axis=1)
        inside[name] = np.bincount(point)[inner].mean()
        assert inside[name] == pytest.approx(1.0 / np.prod(1.0 - np.array(overlap)), rel=0.1)
    assert inside["80/60"] > 2.0 * inside["70/40"]


@pytest.mark.parametrize("overlap", OVERLAPS)
def test_the_block_given_to_both_has_the_same_sum_of_squares_as_in_pycolmap(overlap: str) -> None:
    """At the start to rounding, at the minimum to what pycolmap's stopping rule leaves."""
    pytest.importorskip("pycolmap", reason="pycolmap is not installed (extra bench)")
    network = simulate_photos_alone(1, image_points=GROWTH[0], overlap=overlap)
    theirs = colmap.solve(network, threads=1, principal_point=False)
    equations = compile_network(network)
    start = equations.residuals(equations.unknowns.start())
    assert theirs.start == pytest.approx(float(start @ start), rel=1e-12)
    solution = fga.adjust(network)
    assert solution.converged
    assert 0.0 <= theirs.vtpv / solution.vtpv - 1.0 < 3.0 * colmap.FUNCTION_TOLERANCE


def test_the_exponent_is_that_of_the_line_through_the_logarithms() -> None:
    sizes = (10.0, 100.0, 3000.0)
    assert exponent(sizes, [7.0 * n**1.5 for n in sizes]) == pytest.approx(1.5, abs=1e-12)
    assert exponent((1.0, 100.0), (1.0, 10.0)) == pytest.approx(0.5, abs=1e-12)
