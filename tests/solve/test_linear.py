"""Some rows of the linearised equations, against all of them as a dense matrix."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.graph import image_blocks
from factorgraph_adj.graph.equations import compile_network
from factorgraph_adj.observations import (
    Correlated,
    GnssPosition,
    GnssVector,
    HeightDifference,
    SlopeDistance,
)
from factorgraph_adj.solve.linearised_equations import LinearisedEquations
from factorgraph_adj.types import Array, Index
from tests.networks.simulated import NETWORKS
from tests.networks.small_block import small_block
from tests.support.differences import whitened_system

ROUNDING = 1e-13
"""Rounding error of a whitened partial, relative to the largest one of its row."""


def correlated_block() -> fga.Network:
    """Photos and total stations with a group of four kinds, at held points and a held height."""
    network = small_block(4)
    network.points["P9"] = replace(network.points["P9"], fixed=(False, False, True))
    root = np.random.default_rng(2).normal(size=(8, 8))
    group = (
        HeightDifference("P9", "P3", 0.1, sigma=1.0),
        GnssVector("P9", "P2", (1.0, 2.0, 3.0), sigma=(1.0, 1.0, 1.0)),
        SlopeDistance("S1", "P9", 12.0, sigma=1.0),
        GnssPosition("P3", (3.0, 2.0, 1.0), sigma=(1.0, 1.0, 1.0)),
    )
    network.add(Correlated(group, root @ root.T * 1e-6 + 1e-8 * np.eye(8)))
    return network


CASES: dict[str, Callable[[], fga.Network]] = {
    "correlated block": correlated_block,
    **{
        n: NETWORKS[n]
        for n in ("gnss", "geocentric block", "aerial block", "own cameras", "held photo")
    },
}
every_case = pytest.mark.parametrize("name", CASES)


def linearised(name: str) -> tuple[LinearisedEquations, Array]:
    """Return a network linearised at its approximate values, and the dense partials."""
    equations = compile_network(CASES[name]())
    state = equations.unknowns.start()
    system = LinearisedEquations(equations.weighted_at(state), state)
    a = whitened_system(system.equations, state)[0]
    return system, np.where(equations.unknowns.free, a, 0.0)


case = cache(linearised)


def assert_rows_are(system: LinearisedEquations, a: Array, rows: Index) -> None:
    found = system.sparse(rows)
    assert found.shape == (len(rows), system.unknowns.n_columns)
    scale = np.abs(a[rows]).max(axis=1, keepdims=True, initial=1e-300)
    assert np.all(np.abs(found.toarray() - a[rows]) <= ROUNDING * scale)


@every_case
def test_rows_in_any_order_are_those_of_the_whole_matrix(name):
    system, a = case(name)
    whole = system.times(np.eye(a.shape[1]))
    scale = np.abs(a).max(axis=1, keepdims=True)
    assert np.all(np.abs(whole - a) <= ROUNDING * scale)
    n = len(a)
    rng = np.random.default_rng(1)
    for rows in (np.arange(n), *(rng.permutation(n)[:k] for k in (n // 2, n // 9, 1)), [], [n - 1]):
        assert_rows_are(system, a, np.asarray(rows, dtype=np.intp))


@pytest.mark.parametrize("name", ["correlated block", "gnss", "geocentric block"])
def test_rows_of_a_group_are_whitened_with_those_that_are_left_out(name):
    system, a = case(name)
    clusters = system.equations.clusters
    rng = np.random.default_rng(2)
    others = np.setdiff1d(np.arange(len(a)), np.concatenate([c.rows for c in clusters]))
    for c in clusters:
        assert_rows_are(system, a, c.rows[::-1])
        assert_rows_are(system, a, c.rows[1:2])
        some = np.concatenate([c.rows[::2], others[:3], clusters[0].rows[1::2]])
        assert_rows_are(system, a, rng.permutation(np.unique(some)))


@every_case
def test_held_unknowns_are_not_among_the_columns(name):
    """Nothing but the zeros of a group's common columns may stand at a held unknown."""
    system, a = case(name)
    alone = np.setdiff1d(
        np.arange(len(a)), np.concatenate([[], *(c.rows for c in system.equations.clusters)])
    )
    held = np.flatnonzero(~system.unknowns.free)
    assert len(held) or name in ("gnss",)
    assert not np.isin(system.sparse(alone.astype(np.intp)).indices, held).any()
    assert not system.sparse(np.arange(len(a)))[:, held].toarray().any()


@every_case
@pytest.mark.parametrize("kinds", [("point",), ("pose", "calibration"), ("orientation",)])
def test_kinds_that_are_held_have_no_partials(name, kinds):
    system, a = case(name)
    kept = np.zeros(a.shape[1], dtype=bool)
    for kind, number in system.unknowns.active():
        if kind in kinds:
            kept[system.unknowns.columns(kind, number)] = True
    rows = np.random.default_rng(3).permutation(len(a))[: len(a) // 2]
    assert_rows_are(system.only(kinds), np.where(kept, a, 0.0), rows)


def test_rows_of_photos_in_several_chunks(monkeypatch):
    monkeypatch.setattr(image_blocks, "RAYS", 25)
    system, a = linearised("aerial block")
    assert any(len(chunks.chunks) > 1 for chunks in system.equations.rays.values())
    for seed in range(3):
        rows = np.random.default_rng(seed).permutation(len(a))[: len(a) // 3]
        assert_rows_are(system, a, rows)
