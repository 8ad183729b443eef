"""The aerial block of IGN with auxiliary data of heights and attitudes: FRAMES 6.4, simulated.

The geometry, the topocentric frame and the strips are those of the block; images and auxiliary
data are simulated, as no public block has measured ones.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

import factorgraph_adj as fga
from factorgraph_adj.simulation.measurement import measure
from tests.loaders.borea import Block, read_borea
from tests.networks.aerial_heights import errors, unknown_values
from tests.networks.borea_heights import plan_of
from tests.support.places import data_dir

pytestmark = [
    pytest.mark.published,
    pytest.mark.slow("a real flight with statoscope heights; short tests take simulated ones"),
]


@pytest.fixture(scope="module")
def block() -> Block:
    return read_borea(data_dir("borea"))


def test_statoscopes_recorders_a_lake_and_mounts_come_back(block: Block) -> None:
    plan = plan_of(block)
    solution = fga.adjust(unknown_values(measure(plan, seed=1)))
    assert solution.converged
    assert solution.sigma0 == pytest.approx(1.0, abs=3 / np.sqrt(2 * solution.redundancy))
    found: dict[str, float] = {}
    for kind in ("profile", "level", "mount"):
        found |= errors(solution, plan, kind)
    assert len(found) == 5 * 4 + 1 + 5
    z = np.array([*found.values()])
    # At most one in eighty is beyond 2.5 σ.
    assert np.sum(np.abs(z) > 2.5) <= 1
    assert 1e-3 < stats.chi2(len(z)).cdf(z @ z) < 1 - 1e-3
