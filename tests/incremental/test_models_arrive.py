"""Models arrive with their covariance, and leave; coordinates that share a deformation arrive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.simulation.measurement import measure
from factorgraph_adj.triangulation.independent_models import as_models
from tests.networks.deformed_models import deformed_block
from tests.networks.strip_of_photos import measured_strip, strip_plan

PERCENT = 0.01
"""Share of a standard deviation within which an incremental adjustment is at the minimum."""


def assert_at_the_minimum(inc: fga.IncrementalAdjustment, network: fga.Network) -> None:
    batch, found = fga.adjust(network), inc.solution()
    assert found.redundancy == batch.redundancy
    assert found.vtpv == pytest.approx(batch.vtpv, rel=1e-4)
    for name in network.points:
        sigma = batch.standard_deviations(name)
        off = np.abs(found.point(name) - batch.point(name))
        assert (off <= PERCENT * sigma + 1e-12).all()


def test_a_model_arrives_with_its_covariance_and_leaves() -> None:
    network = measured_strip(strip_plan(5, overlap=0.6), seed=2)
    block = as_models(network)
    last = block.models[-1]
    begun = block.network.copy()
    ids = begun.clusters[-1][0]
    begun.clusters = begun.clusters[:-1]
    begun.observations = {i: o for i, o in begun.observations.items() if i not in ids}
    inc = fga.IncrementalAdjustment(begun, policy="accept")
    inc.add(last.observations())
    inc.settle()
    assert not inc.waiting
    assert_at_the_minimum(inc, block.network)


def test_coordinates_with_a_deformation_arrive_in_any_order() -> None:
    network = measure(deformed_block(), seed=3)
    begun = network.copy()
    begun.observations = {}
    inc = fga.IncrementalAdjustment(begun, policy="accept")
    order = np.random.default_rng(4).permutation(list(network.observations)).tolist()
    for first in range(0, len(order), 40):
        inc.add([replace(network.observations[i], id=i) for i in order[first : first + 40]])
    inc.settle()
    assert not inc.waiting
    assert_at_the_minimum(inc, network)
    gone = [i for i in order if network.observations[i].point in ("1-1", "2+1", "3-2")][:3]
    inc.remove(gone)
    assert_at_the_minimum(inc, fga.without(network, gone))
