"""What an adjustment takes is told beforehand, and refused where it is more than there is."""

from __future__ import annotations

import tracemalloc

import pytest

import factorgraph_adj as fga
from factorgraph_adj.simulation.simulated_blocks import simulate_aerial_block
from factorgraph_adj.solve import machine_limits
from tests.benchmarks.grids import simulate_grid
from tests.networks.small_block import small_block

NETWORKS = {
    "photos": lambda: simulate_aerial_block(1, image_points=40_000).network,
    "grid": lambda: simulate_grid(1, points=1600).network,
}


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize("name", NETWORKS)
def test_the_estimate_is_what_is_taken(name: str) -> None:
    """Traced allocations are between a half and all of the estimate, with a tenth to spare."""
    network = NETWORKS[name]()
    fga.adjust(small_block(4))  # modules are loaded
    told = fga.memory_needed(network)
    tracemalloc.start()
    try:
        solution = fga.adjust(network)
        adjusted = tracemalloc.get_traced_memory()[1]
        fga.reliability(solution)
        whole = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert 0.5 * told.adjustment < adjusted < 1.1 * told.adjustment
    assert 0.5 * told.total < whole < 1.1 * told.total


def test_the_estimate_grows_with_what_is_measured() -> None:
    small, large = (
        fga.memory_needed(simulate_aerial_block(1, image_points=n).network)
        for n in (10_000, 20_000)
    )
    once = machine_limits.CHUNK_BYTES  # the temporaries of one chunk
    assert 1.8 < (large.partials - once) / (small.partials - once) < 2.2
    assert large.points > small.points and large.fronts > small.fronts


def test_what_does_not_fit_is_refused_with_both_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    network = NETWORKS["photos"]()
    monkeypatch.setattr(machine_limits, "MIN_BYTES_CHECKED", 0.0)
    monkeypatch.setattr(machine_limits, "free_memory_bytes", lambda: 1e6)
    with pytest.raises(fga.InputError, match=r"takes about 0\.\d\d GB, .* and 0\.00 GB of memory"):
        fga.adjust(network)
    monkeypatch.setattr(machine_limits, "free_memory_bytes", lambda: 1e12)
    assert fga.adjust(network).converged


def test_free_memory_is_known_or_infinite(monkeypatch: pytest.MonkeyPatch) -> None:
    assert machine_limits.free_memory_bytes() > 1e6

    def nothing(*_: object, **__: object) -> None:
        raise OSError

    monkeypatch.setattr("builtins.open", nothing)
    assert machine_limits.free_memory_bytes() == float("inf")
