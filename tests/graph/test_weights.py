"""Weights that depend on the lengths of sights, and when they are at rest."""

from __future__ import annotations

from dataclasses import replace

from factorgraph_adj.graph.equations import Equations, compile_network
from tests.networks.small_block import small_block


def changed(equations: Equations, by: float) -> Equations:
    """Return equations whose first block has other standard deviations."""
    first, *others = equations.blocks
    return replace(equations, blocks=(replace(first, sigma=first.sigma * (1.0 + by)), *others))


def test_weights_are_at_rest_when_their_change_moves_nothing() -> None:
    equations = compile_network(small_block())
    assert changed(equations, 5e-8).weighs_as(equations)
    assert not changed(equations, 2e-7).weighs_as(equations)


def test_the_larger_the_residuals_the_more_a_change_of_weights_counts() -> None:
    """A change by ε moves unknowns by the order of ε times the root mean square of v/σ."""
    equations = compile_network(small_block())
    assert not changed(equations, 5e-8).weighs_as(equations, misfit=100.0)
    assert changed(equations, 5e-10).weighs_as(equations, misfit=100.0)
    assert changed(equations, 5e-8).weighs_as(equations, misfit=0.01)
    assert changed(equations, 5e-13).weighs_as(equations, misfit=1e9)
