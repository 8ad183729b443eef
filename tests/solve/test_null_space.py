"""The search for null vectors where many combinations are hardly determined."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import HeightDifference
from factorgraph_adj.solve import undetermined_unknowns
from factorgraph_adj.solve.linearised_equations import LinearisedEquations

PAIRS = 10
"""Number of pairs of heights that hang on one weak reading: more than are searched first."""


def heights(open_pairs: int) -> fga.Network:
    """Return pairs of heights with a difference of 1 µm; a benchmark is 1 m near most of them."""
    network = fga.Network("pairs of heights")
    network.add_point("benchmark", (0.0, 0.0, 0.0), fixed="xyz")
    for k in range(PAIRS + open_pairs):
        for name in (f"A{k}", f"B{k}"):
            network.add_point(name, (float(k), 0.0, 0.0), fixed="xy")
        network.add(HeightDifference(f"A{k}", f"B{k}", 0.0, sigma=1e-6))
        if k < PAIRS:
            network.add(HeightDifference("benchmark", f"A{k}", 0.0, sigma=1.0))
    return network


@pytest.mark.parametrize("open_pairs", [0, 1, 5])
def test_weak_combinations_hide_no_null_vector_of_a_large_network(
    open_pairs: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert min(undetermined_unknowns.FIRST_NULL_VECTORS) < PAIRS
    monkeypatch.setattr(undetermined_unknowns, "MIN_LARGE_NETWORK_COLUMNS", 2)
    equations = compile_network(heights(open_pairs))
    system = LinearisedEquations(equations, equations.unknowns.start())
    z = undetermined_unknowns.null_space(system, system.diagonal())
    assert z.shape[1] == open_pairs
    share = np.sum(z**2, axis=1)
    unknowns = equations.unknowns
    loose = {
        unknowns[kind].names[number]
        for kind, number in unknowns.active()
        if share[unknowns.columns(kind, number)].sum() > 0.1
    }
    assert loose == {f"{side}{PAIRS + k}" for side in "AB" for k in range(open_pairs)}
