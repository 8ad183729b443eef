"""Equations of some observations are those of the network in their rows."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import Correlated, Direction, Observation, SlopeDistance
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from tests.networks.small_block import small_block


@pytest.mark.parametrize("seed", range(3))
def test_equations_of_some_observations_are_those_of_their_rows(seed):
    network = small_block()
    rng = np.random.default_rng(seed)
    names = list(network.points)
    one: dict[str, Observation] = {}
    for i in range(1, 6):
        one[f"d{i}"] = SlopeDistance(names[0], names[i], 10.0, sigma=0.01, id=f"d{i}")
        one[f"r{i}"] = Direction(names[0], names[i], 1.0, sigma=0.01, set="1", id=f"r{i}")
    for ids in (("d1", "r2"), ("d3", "d4", "r1")):
        root = rng.normal(size=(len(ids), len(ids)))
        covariance = 1e-4 * (root @ root.T + np.eye(len(ids)))
        network.add(Correlated([one.pop(i) for i in ids], covariance))
    for o in one.values():
        network.add(o)
    equations = compile_network(network)
    state = equations.unknowns.start()
    state = {k: np.where(np.isnan(x), 0.1, x) for k, x in state.items()}
    whole = LinearisedEquations(equations, state)
    rows = np.concatenate(equations.find(["d1", "r2", "d5", "r4"]))
    rows = np.union1d(rows, equations.touching("point", np.array([len(names) - 1])))
    if seed == 2:
        rows = np.union1d(rows, np.concatenate(equations.find(["d3", "d4", "r1"])))
    some = equations.of_rows(rows)
    part = LinearisedEquations(some, state)
    assert some.n_rows == len(rows)
    assert part.residual == pytest.approx(whole.residual[rows], rel=1e-12)
    a = part.sparse(np.arange(len(rows))).toarray()
    assert a == pytest.approx(whole.sparse(rows).toarray(), rel=1e-12)
