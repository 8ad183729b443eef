"""Elimination of points that only cameras see, against dense elimination."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.graph import image_blocks
from factorgraph_adj.network.network import Network
from tests.networks.eliminated import CASES, ELIMINATED, FIRST_LAYER, Eliminated, eliminated
from tests.support.dense import inverse

FEW_RAYS = 25
"""Largest number of rays of a chunk that cuts photos in two."""


def photos_of_points(case: Eliminated) -> list[list[int]]:
    """Return the photos that see each point of the first layer, one for each ray, sorted."""
    equations, layers = case.solution.equations, case.factor.layers
    out: list[list[int]] = [[] for _ in case.points]
    local = np.cumsum(layers.reduced) - 1
    for block in equations.blocks:
        if block.kind == "image":
            (_, photo), _, (_, point) = block.variables
            for f, p in zip(photo.tolist(), point.tolist(), strict=True):
                if layers.reduced[p]:
                    out[local[p]].append(f)
    return [sorted(photos) for photos in out]


def assert_rays_are_those_of_the_network(case: Eliminated) -> None:
    assert case.factor.points is not None and case.factor.nodes is not None
    rays, photos = case.factor.points.rays, case.factor.nodes.photos
    expected = photos_of_points(case)
    every = [rays.of_point(point) for point in range(len(case.points))]
    for own, seen in zip(every, expected, strict=True):
        assert sorted(photos[rays.node_of_ray[own]].tolist()) == seen
    assert np.array_equal(np.sort(np.concatenate(every)), np.arange(rays.n_rays))
    assert len(rays.node_of_ray) == rays.n_rays == sum(map(len, expected))


@pytest.mark.parametrize("name", FIRST_LAYER)
def test_every_point_has_the_rays_of_the_photos_that_see_it(name):
    assert_rays_are_those_of_the_network(eliminated(name))


def assert_points_follow(case: Eliminated) -> None:
    """C = −N_pp⁻¹ N_po and L⁻ᵀ L⁻¹ = N_pp⁻¹, for the free components of every point."""
    reduction, n, free = case.factor.points, case.dense.matrix, case.dense.free
    assert reduction is not None
    sigma = case.dense.sigma
    for point, own in enumerate(case.points):
        columns, found, half = reduction.carried(point)
        assert len(np.unique(columns)) == len(columns) and not np.isin(columns, own).any()
        q = inverse(n[np.ix_(own, own)], free[own])
        size = np.sqrt(np.where(free[own], np.diag(q), 1.0))
        expected = np.where(free, -q @ n[own], 0.0)
        expected[:, case.points.ravel()] = 0.0
        whole = np.zeros_like(expected)
        whole[:, columns] = found
        error = np.abs(whole - expected) * sigma / size[:, None]
        scale = np.abs(expected * sigma / size[:, None]).max(initial=1.0)
        assert error.max() < case.rounding * scale
        assert np.abs((half @ half.T - q) / np.outer(size, size)).max() < case.rounding
        assert not np.tril(half, -1).any()


@pytest.mark.parametrize("name", FIRST_LAYER)
def test_a_point_follows_the_unknowns_of_its_photos(name):
    assert_points_follow(eliminated(name))


@pytest.mark.parametrize("name", ["photos", "mixed, own cameras"])
def test_chunks_that_cut_photos_change_nothing(name, monkeypatch):
    monkeypatch.setattr(image_blocks, "RAYS", FEW_RAYS)
    network: Network = CASES[name]()
    case = Eliminated(network)
    assert case.factor.points is not None
    parts = case.factor.points.rays.parts
    assert len(parts) > 1 and max(p.rows.stop - p.rows.start for p in parts) <= FEW_RAYS
    assert_rays_are_those_of_the_network(case)
    assert_points_follow(case)


@pytest.mark.parametrize("name", ELIMINATED)
def test_the_reduced_system_is_the_schur_complement(name):
    """S = N_oo − N_op N_pp⁻¹ N_po of the other unknowns o; nothing is added to the points."""
    case = eliminated(name)
    n, free, o, p = case.dense.matrix, case.dense.free, case.others, case.points.ravel()
    q = inverse(n[np.ix_(p, p)], free[p])
    coupling = np.where(np.outer(free[o], free[p]), n[np.ix_(o, p)], 0.0)
    schur = n[np.ix_(o, o)] - coupling @ q @ coupling.T
    y = np.zeros((len(n), 2))
    y[o] = np.random.default_rng(1).normal(size=(len(o), 2)) / case.dense.sigma[o, None]
    expected = inverse(schur, free[o]) @ y[o]
    found = np.zeros_like(y)
    columns = case.factor.reduced_columns
    found[columns] = case.factor.solve_reduced(y[columns])
    size = np.sqrt(np.einsum("ij,ij->j", np.where(free[o], y[o].T, 0.0).T, expected))
    error = np.abs(found[o] - expected) / case.dense.sigma[o, None]
    # Elimination in two steps rounds twice.
    assert np.all(error < 2.0 * case.rounding * size)
    assert not found[p].any() and not found[~free].any()
    # S⁻¹ is the part of the inverse of the whole.
    whole = case.dense.q[np.ix_(o, o)] @ y[o]
    assert np.all(np.abs(found[o] - whole) / case.dense.sigma[o, None] < case.rounding * size)
