"""The verdict on an arriving observation is its prediction from the batch adjustment, at any time.

Test values, √T², redundancy numbers, innovations and their σ are those of `predict` on the batch
adjustment of what is there. Estimates are within 1 % of their σ between two looks (`accuracy`), and
what they miss is in the innovation: it may miss as much of its own σ. Nearly all miss less than a
thousandth. In states at rest the figures are exact, see ``test_statistics``.

These are the quick ones of ``python -m tests.benchmarks verdicts``.
"""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from tests.networks.arriving import CASES
from tests.networks.random_small import random_network
from tests.support.predicted import BOUND, Compared, verdicts_of_drawn, verdicts_of_network

LONG = pytest.mark.slow("verdicts in published networks; short tests take simulated ones")

ACCURACY = 0.01
"""What is promised of estimates between two looks, relative to σ."""
SELDOM = 0.05
"""Part of the verdicts that may miss more than `BOUND`."""
RANDOM = (0, 1, 3, 10, 11, 15, 17, 24, 25, 30, 33, 37, 41)
"""Seeds of random networks."""
PUBLISHED = (
    "Ghilani 21.1",
    "Niemeier_DistanceDirection_fix",
    "Caspary",
    "2020-barta-phase_1-1TK",
    "MMVII, TopoMini",
)


def assert_predicted(found: list[Compared], least: int) -> None:
    assert len(found) >= least
    beyond = [c for c in found if not c.largest <= BOUND]
    assert len(beyond) <= SELDOM * len(found), "\n".join(map(str, beyond))
    assert all(c.largest <= ACCURACY for c in found), "\n".join(map(str, beyond))


@pytest.mark.slow("random networks of every kind; short tests take one network of each")
def test_verdicts_in_random_networks_are_predictions_of_the_batch() -> None:
    found = [c for seed in RANDOM for c in verdicts_of_drawn(random_network(seed), 6)]
    assert_predicted(found, 30)


@LONG
@pytest.mark.parametrize("name", PUBLISHED)
def test_verdicts_in_published_networks_are_predictions_of_the_batch(name: str) -> None:
    assert_predicted(list(verdicts_of_network(name, CASES[name].make(), 1, 6)), 2)


@pytest.mark.slow("a large free network; short tests of inner constraints take small ones")
def test_a_free_network_whose_place_is_hardly_known_stands_on_its_inner_constraints() -> None:
    """GNSS vectors and zenith angles tell the place to 500 m, and notice a motion of metres."""
    drawn = random_network(101, more=False)
    inc = fga.IncrementalAdjustment(drawn.bare, policy="accept")
    order = np.random.default_rng([101, 11]).permutation(len(drawn.items)).tolist()
    half = len(order) // 2
    inc.add([drawn.items[i] for i in order[:half]])
    for i in order[half:]:
        inc.add(drawn.items[i])
        assert not inc.determined("P0") or inc.solution().converged, inc.solution().reason
    found, batch = inc.solution(), fga.adjust(inc.network())
    assert found.datum_defect == batch.datum_defect == 2
    off = np.abs(found.point("P0") - batch.point("P0"))
    assert np.all(off < ACCURACY * batch.standard_deviations("P0"))
