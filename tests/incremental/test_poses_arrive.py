"""Poses of photos that arrive with their odometry, asked for while they arrive."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj import Correlated, IncrementalAdjustment, adjust
from factorgraph_adj.factor_graph.linear_isam2 import IndeterminateError, LinearISAM2
from factorgraph_adj.ledger.command_input import Engine
from factorgraph_adj.linear_system.isam2_system import ISAM2System
from factorgraph_adj.network.network import Network
from factorgraph_adj.simulation.measurement import measure
from tests.networks.odometry import odometry
from tests.support.arrivals import bare, difference, items


def _chain() -> Network:
    return measure(odometry(8, joint=False), seed=3)


@pytest.mark.parametrize("engine", ["isam2", "fronts"])
def test_the_pose_of_a_photo_is_that_of_the_batch_and_adjusts_nothing(engine: Engine):
    network = _chain()
    inc = IncrementalAdjustment(bare(network), engine=engine)
    for item in items(network):
        inc.add(item)
    found = {name: inc.pose(name) for name in ("F1", "F4", "F7")}
    system = inc._state.system
    assert isinstance(system, ISAM2System) is (engine == "isam2")
    assert "fronts" not in vars(system)
    batch = adjust(network)
    for name, pose in found.items():
        there = batch.pose(name)
        assert np.all(np.abs(pose.position - there.position) < 1e-2 * there.sigmas[3:])
        assert pose.sigmas == pytest.approx(there.sigmas, rel=1e-2)
        covariance, expected = inc.pose_covariance(name), batch.pose_covariance(name)
        scale = np.outer(there.sigmas, there.sigmas)
        np.testing.assert_allclose(covariance / scale, expected / scale, atol=2e-2)


def test_fronts_take_what_breaks_the_tree_while_it_is_relinearised(monkeypatch: pytest.MonkeyPatch):
    network = _chain()
    inc = IncrementalAdjustment(bare(network), engine="isam2")
    *first, last = items(network)
    for item in first:
        inc.add(item)
    assert isinstance(inc._state.system, ISAM2System)

    def follow(tree: LinearISAM2, *_: object, **__: object) -> int:
        raise IndeterminateError("Indeterminate linear system")

    monkeypatch.setattr(LinearISAM2, "follow", follow)
    arrival = inc.add(last)
    assert [v.verdict for v in arrival.verdicts] == ["accepted"]
    batch = adjust(network)
    off = inc.pose("F7").position - batch.pose("F7").position
    assert np.all(np.abs(off) < 1e-2 * batch.pose("F7").sigmas[3:])


def test_a_graph_in_plan_is_alive_from_its_first_edge_and_ends_at_the_batch() -> None:
    """The first 30 poses of w100.graph, whose edges have σ of 1 m on steps of 1 m, and 1 rad."""
    whole = fga.read(gtsam.findExampleDataFile("w100.graph"))
    network = bare(whole)
    for name in list(network.points)[30:]:
        del network.points[name], network.of_kind("heading")[name]
    edges = [e for e in items(whole) if isinstance(e, Correlated)]
    inc = IncrementalAdjustment(network)
    n = 0
    for edge in edges:
        if all(p in network.points for o in edge.observations for p in o.points()):
            verdicts = inc.add(edge).verdicts
            assert {v.verdict for v in verdicts} == {"accepted"}
            n += 1
    assert n > 50 and len(inc) == 2 * n
    inc.settle()
    found = difference(inc.solution(), adjust(inc.network()))
    assert max(found.estimates, found.sigmas) < 1e-6
