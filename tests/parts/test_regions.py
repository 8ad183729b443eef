"""The smallest of the simulated networks of the size of a state: for correctness alone."""

from __future__ import annotations

from functools import partial

import pytest

import factorgraph_adj as fga
from tests.benchmarks.regions import photos, states

pytestmark = pytest.mark.slow(
    "parts that a simulation makes; short tests run two parts by the command"
)


@pytest.mark.parametrize(
    ("make", "n"),
    [(partial(states, tiles=(2, 2), side=20), 4), (partial(photos, tiles=(1, 2), sides=(2, 8)), 2)],
    ids=["stations", "photos"],
)
def test_simulated_parts_fit_together(make, n):
    found = fga.adjust_parts([fga.Part(str(k), partial(make, k)) for k in range(n)])
    assert found.converged
    assert found.repeated == ()
    assert found.sum_of_redundancy_numbers == pytest.approx(found.redundancy, abs=1e-6)
    # σ̂0 has the standard deviation 1/√(2 r).
    assert abs(found.sigma0 - 1.0) < 4.0 / (2.0 * found.redundancy) ** 0.5
    again = fga.adjust_parts([fga.Part(str(k), partial(make, k)) for k in reversed(range(n))])
    assert again.vtpv == pytest.approx(found.vtpv, rel=1e-9)
