"""Does the covariance say how estimates scatter? Thirty seeded repetitions of every kind.

They show a variance that is wrong by a factor of two and a half; ``python -m
tests.benchmarks.scatter`` repeats more often and shows one that is wrong by a third.
"""

from __future__ import annotations

import pytest

from factorgraph_adj import observations as o
from tests.support.scatter import (
    DISTINCT,
    NETWORKS,
    assert_estimates_scatter_as_their_covariance_says,
    assert_the_variance_of_unit_weight_follows_its_distribution,
    few,
)

SLOW = pytest.mark.slow(
    "thirty seeded repetitions of each kind of observation; "
    "short tests compare each kind with dense algebra"
)


def test_every_kind_of_observation_is_here() -> None:
    assert set(o.KINDS) <= NETWORKS.keys()
    for kind in o.KINDS:
        network = NETWORKS[kind]()
        kinds = {x.kind for x in network.observations.values()}
        assert kind in kinds or (kind == "image" and network.n_image_points)


@SLOW
@pytest.mark.parametrize("name", DISTINCT)
def test_estimates_scatter_as_their_covariance_says(name: str) -> None:
    assert_estimates_scatter_as_their_covariance_says(few(name))


@SLOW
@pytest.mark.parametrize("name", DISTINCT)
def test_the_variance_of_unit_weight_follows_its_distribution(name: str) -> None:
    assert_the_variance_of_unit_weight_follows_its_distribution(few(name))
