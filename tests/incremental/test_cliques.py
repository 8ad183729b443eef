"""Cliques eliminated once more, and the system beside the tree, against dense inverses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.incremental.cliques import cofactor_times, those_above, variances_of
from factorgraph_adj.incremental.engine import Engine
from factorgraph_adj.incremental.network_graph import MANY_KEYS
from factorgraph_adj.incremental.recent import Recent, sparse_rows
from factorgraph_adj.simulation.simulate import measure
from factorgraph_adj.types import Array
from tests.benchmarks.grids import simulate_grid, simulate_mixed
from tests.networks.site import plan


def site() -> fga.Network:
    """Photos, and terrestrial observations between the points: eliminated by COLAMD."""
    return measure(plan(), seed=7)


def block() -> fga.Network:
    """A few hundred variables, by nested dissection."""
    return simulate_mixed(1, points=300).network


def free() -> fga.Network:
    """Without photos, with a minimal datum."""
    network = simulate_grid(1, points=60).network
    network.points = {n: replace(p, fixed=(False,) * 3) for n, p in network.points.items()}
    network.datum = "free"
    return network


LONG = pytest.mark.slow(
    "a tree by nested dissection with many cliques below one another; the other two networks have "
    "small trees"
)


@pytest.fixture(params=[site, pytest.param(block, marks=LONG), free], scope="module")
def inc(request: pytest.FixtureRequest) -> fga.IncrementalAdjustment:
    """One of the networks."""
    return fga.IncrementalAdjustment(request.param(), policy="accept")


def held(engine: Engine) -> list[tuple[int, float]]:
    """Return places and weights of the minimal datum."""
    place = engine.register
    return [(int(place[h.kind].place.view[h.number, h.component]), h.weight) for h in engine.held]


def inverse(engine: Engine) -> Array:
    """Return Q of all rows and the minimal datum, (n_places, n_places)."""
    a = sparse_rows(engine.store).toarray()
    normal = a.T @ a
    for place, weight in held(engine):
        normal[place, place] += weight**2
    scale = 1.0 / np.sqrt(np.diag(normal))
    return np.asarray(np.linalg.inv(normal * np.outer(scale, scale)) * np.outer(scale, scale))


def test_all_variances(inc: fga.IncrementalAdjustment) -> None:
    engine = inc._engine
    q = np.diag(inverse(engine))
    np.testing.assert_allclose(variances_of(engine.cliques(), len(q)), q, rtol=1e-6)


def test_a_part_of_the_tree_tells_as_much_of_its_columns(inc: fga.IncrementalAdjustment) -> None:
    engine = inc._engine
    q = inverse(engine)
    sigma = np.sqrt(np.diag(q))
    rng = np.random.default_rng(4)
    for k in (1, 7, 40):
        places = rng.permutation(len(q))[:k]
        part, columns = those_above(engine.cliques(), places)
        assert len(part) < len(engine.cliques()) or k == 40  # or nothing is left out
        place = {int(c): i for i, c in enumerate(columns)}
        own = np.array([place[int(p)] for p in places])
        y = np.zeros((len(columns), k))
        y[own, np.arange(k)] = 1.0
        found = cofactor_times(part, y)[own]
        s = sigma[places]
        assert np.max(np.abs(found - q[np.ix_(places, places)]) / np.outer(s, s)) < 1e-6
        np.testing.assert_allclose(variances_of(part, len(columns))[own], s**2, rtol=1e-6)


def test_cliques_are_those_of_the_latest_tree(inc: fga.IncrementalAdjustment) -> None:
    engine = inc._engine
    before = engine.cliques()
    assert engine.cliques() is before
    gone = list(inc.network().observations)[5:8]
    inc.remove(gone)
    engine = inc._engine
    q = np.diag(inverse(engine))
    np.testing.assert_allclose(variances_of(engine.cliques(), len(q)), q, rtol=1e-6)


def test_the_order_of_elimination_changes_no_solution(inc: fga.IncrementalAdjustment) -> None:
    engine = inc._engine
    order = engine._order()
    n = engine.register.n_places
    np.testing.assert_array_equal(np.sort(order), np.arange(n))
    b = np.random.default_rng(5).normal(size=(n, 3))
    wanted = inverse(engine) @ b
    size = np.abs(wanted).max(axis=0)
    for some in (None, order, order[::-1].copy()):
        found = Recent(engine.store, held(engine), some).times(b)
        assert np.max(np.abs(found - wanted) / size) < 1e-6


def test_many_rows_are_judged_as_each_alone(inc: fga.IncrementalAdjustment) -> None:
    """Together they go through part of a tree, each alone through iSAM2's joint covariance."""
    engine = inc._engine
    ids = [i for i in engine.store.places if " " not in i or i.startswith("photo")]
    together = engine.trial_of_ids(ids[:600])
    several = len(together.system.keys) > MANY_KEYS
    assert several or len(engine.register.keys) <= MANY_KEYS
    for ident in ids[:600:50]:
        alone = engine.trial_of_ids([ident])
        rows = together.system.rows[ident]
        wanted = alone.judged.m
        found = together.judged.m[np.ix_(rows, rows)]
        np.testing.assert_allclose(found, wanted, rtol=1e-6, atol=1e-7)
