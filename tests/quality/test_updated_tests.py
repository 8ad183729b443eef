"""Test values by a low-rank update are those of the adjustment without the observations."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from factorgraph_adj.adjustment import adjust
from factorgraph_adj.graph.observation_selection import without
from factorgraph_adj.quality.reliability import Reliability, reliability
from factorgraph_adj.quality.snooping_candidates import RowGroups, choose_outliers
from factorgraph_adj.quality.snooping_state import UpdatedTests
from factorgraph_adj.simulation.simulated_blocks import simulate_geocentric_block
from factorgraph_adj.types import Index
from tests.benchmarks.grids import simulate_grid
from tests.networks.simulated import free_block
from tests.networks.small_block import small_block

LONG = pytest.mark.slow(
    "each published network without each observation; short tests leave out one"
)


NETWORKS = {
    "grid": lambda: simulate_grid(3, points=100).network,
    "small block": lambda: small_block(seed=2),
    "free small block": partial(free_block, 2),
    "geocentric block": lambda: simulate_geocentric_block(11).network,
}
AT_REST = 1e-5
"""Tolerance of `adjust`, relative to σ."""


def some(rel: Reliability, n: int) -> list[int]:
    """Return observations that all others control well, none in a cluster."""
    units = RowGroups.of(rel.solution.equations)
    joint = [r for c in rel.solution.equations.clusters for r in c.rows.tolist()]
    fine = rel.redundancy_numbers > 0.4
    fine[joint] = False
    good = np.flatnonzero(np.minimum.reduceat(fine, units.first))
    return np.random.default_rng(4).choice(good, n, replace=False).tolist()


def rows_of(rel: Reliability, units: list[int]) -> Index:
    every = RowGroups.of(rel.solution.equations)
    return np.concatenate([every.rows(u) for u in units])


@LONG
@pytest.mark.parametrize("name", NETWORKS)
def test_they_are_those_of_the_adjustment_without_the_observations(name: str) -> None:
    rel = reliability(adjust(NETWORKS[name]()))
    chosen = some(rel, 6)
    first = UpdatedTests.of(rel).without(rows_of(rel, chosen[:4]))
    assert first is not None
    found = first.without(rows_of(rel, chosen[4:]))
    assert found is not None
    assert set(found.gone) == set(rows_of(rel, chosen))
    assert 0 < found.left_out < 0.05
    s = rel.solution
    gone = sorted({s.equations.id(int(r)) for r in found.gone})
    expected = reliability(adjust(without(s.network, gone), start=s))
    there = {(o.id, o.component): i for i, o in enumerate(expected.solution.observations)}
    pairs = [
        (i, there[o.id, o.component])
        for i, o in enumerate(s.observations)
        if (o.id, o.component) in there
    ]
    mine, other = np.array(pairs).T
    near = found.left_out + 1e-3  # partials change with the state
    np.testing.assert_allclose(found.w[mine], expected.w[other], atol=2 * found.left_out + AT_REST)
    np.testing.assert_allclose(found.precision[mine], expected.precision[other], rtol=near)
    assert np.array_equal(found.controlled[mine], expected.controlled[other])
    assert np.all(np.isnan(found.w[found.gone]))
    assert not found.controlled[found.gone].any()
    assert found.vtpv == pytest.approx(expected.solution.vtpv, rel=near)
    at = np.argsort(-np.abs(np.nan_to_num(found.w)))[:5]
    place = dict(pairs)
    rho = found.correlations_with(at)
    same = expected.correlations_with(np.array([place[int(i)] for i in at]))
    np.testing.assert_allclose(rho[mine], same[other], atol=near)


def test_what_makes_something_undetermined_has_no_update() -> None:
    s = adjust(simulate_grid(3, points=25).network)
    rel = reliability(s)
    station = [i for i in range(s.equations.n_rows) if "2-2" in s.equations.label(i)]
    assert len(station) > 10
    assert UpdatedTests.of(rel).without(np.array(station)) is None


def test_a_choice_knows_how_near_it_was() -> None:
    """A choice is another one as soon as the limit passes the test value that was the nearest."""
    network = simulate_grid(3, points=100).network
    ids = list(network.observations)
    for i in range(0, len(ids), 40):
        o = network.observations[ids[i]]
        network.observations[ids[i]] = replace(o, value=o.value + (5.0 + i / 40) * o.sigma)
    rel = reliability(adjust(network))

    def chosen(critical: float) -> tuple[set[int], float]:
        choice = choose_outliers(rel, rel.w, scale=1.0, critical=critical, share=0.1)
        return {c.unit for c in choice.chosen}, choice.margin

    critical = rel.critical_w
    before, margin = chosen(critical)
    assert len(before) > 5
    assert 0 < margin < 0.1
    for factor in (1 - 0.5 * margin, 1 + 0.5 * margin):
        assert chosen(factor * critical)[0] == before
    # At the test value of an observation there is no margin.
    size = RowGroups.of(rel.solution.equations).largest(rel.w)
    assert chosen(float(np.sort(size)[-20]))[1] < 1e-12
    for unit in before:
        assert size[unit] > critical
