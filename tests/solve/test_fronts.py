"""Nested dissection, dense fronts and the selected inverse, against dense matrices."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from factorgraph_adj.errors import SingularError
from factorgraph_adj.solve.block_matrix import BlockMatrix
from factorgraph_adj.solve.fronts import Fronts
from factorgraph_adj.solve.nested_dissection import (
    MAX_LEAF_NODES,
    BlockPattern,
    Front,
    dissect,
    dissect_parts,
)
from factorgraph_adj.types import Array, Index


def near(positions: Array, reach: float) -> Index:
    """Return the pairs of positions that are near each other, (p, 2)."""
    pairs = np.sort(cKDTree(positions).query_pairs(reach, output_type="ndarray"), axis=1)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].astype(np.intp)


def strips() -> tuple[Array, float]:
    """Photos of an aerial block."""
    x, y = np.meshgrid(np.arange(25.0), 2.0 * np.arange(8.0))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1), 3.1


def corridor() -> tuple[Array, float]:
    """Photos along a winding road, which overlap three forward."""
    t = np.arange(220.0)
    return np.stack([t, 12.0 * np.sin(t / 25.0), 0.1 * t], 1), 3.6


def ring() -> tuple[Array, float]:
    """Photos around an object."""
    t = np.linspace(0.0, 2.0 * np.pi, 150, endpoint=False)
    return np.stack([20.0 * np.cos(t), 20.0 * np.sin(t), np.sin(3.0 * t)], 1), 5.0


def everything_sees_everything() -> tuple[Array, float]:
    """An unordered set of photos of one object."""
    return np.random.default_rng(3).normal(size=(90, 3)), 100.0


def one_place() -> tuple[Array, float]:
    """Photos of which nobody knows the position: only the graph tells which are near."""
    return np.zeros((1, 3)), 1.0


def two_parts() -> tuple[Array, float]:
    """Two blocks that share no point."""
    at, reach = strips()
    return np.concatenate([at[:80], at[:80] + np.array([1000.0, 0.0, 0.0])]), reach


def alone() -> tuple[Array, float]:
    """A single photo."""
    return np.zeros((1, 3)), 1.0


SHAPES = (strips, corridor, ring, everything_sees_everything, two_parts, alone)


def random_matrix(pattern: BlockPattern, seed: int = 0) -> BlockMatrix:
    """Return a positive definite matrix of a pattern: its diagonal dominates."""
    rng = np.random.default_rng(seed)
    n, w, k = pattern.n, pattern.width, pattern.side
    pairs = rng.normal(size=(len(pattern.first), w, w))
    side = rng.normal(size=(n, w, k))
    own = rng.normal(size=(n, w, w))
    own = own + own.transpose(0, 2, 1)
    degree = np.bincount(np.concatenate([pattern.first, pattern.second]), minlength=n)
    own[:, np.arange(w), np.arange(w)] = 3.0 * w * (degree[:, None] + 2) + 3.0 * k
    corner = rng.normal(size=(k, k))
    corner = corner + corner.T + np.eye(k) * 20.0 * (w * n + k)
    return BlockMatrix(pattern, own, pairs, side, corner)


def dense(m: BlockMatrix) -> Array:
    """Return the whole matrix."""
    n, w = m.diagonal.shape[:2]
    out = np.zeros((n * w + m.pattern.side,) * 2)
    at = [slice(w * i, w * i + w) for i in range(n)]
    for i in range(n):
        out[at[i], at[i]] = m.diagonal[i]
        out[at[i], n * w :] = m.side[i]
        out[n * w :, at[i]] = m.side[i].T
    for i, j, block in zip(m.pattern.first, m.pattern.second, m.pairs, strict=True):
        out[at[i], at[j]], out[at[j], at[i]] = block, block.T
    out[n * w :, n * w :] = m.corner
    return out


@pytest.mark.slow(
    "every network of the kind is compared with dense algebra or another adjustment; "
    "short tests take single ones"
)
@pytest.mark.parametrize(("width", "side"), [(6, 5), (9, 0), (1, 3)])
@pytest.mark.parametrize("shape", SHAPES)
def test_solution_and_selected_inverse_are_those_of_dense_matrices(shape, width, side) -> None:
    positions, reach = shape()
    pairs = near(positions, reach)
    pattern = BlockPattern(len(positions), width, side, pairs[:, 0], pairs[:, 1])
    m = random_matrix(pattern)
    whole = dense(m)
    inverse = np.linalg.inv(whole)
    fronts = Fronts.of(dissect(pattern, positions), m)
    y = np.random.default_rng(1).normal(size=(len(whole), 3))
    np.testing.assert_allclose(fronts.solve(y), inverse @ y, rtol=0, atol=1e-14)
    found = fronts.inverse()
    np.testing.assert_allclose(found.diagonals, np.diag(inverse), rtol=1e-11)
    stored = dense(BlockMatrix(pattern, *(np.ones_like(x) for x in blocks(found)))) > 0
    assert np.max(np.abs(dense(found) - inverse)[stored]) < 1e-13 * np.max(inverse)
    rows, columns = np.nonzero(stored)
    wanted = dense(found)[stored]
    np.testing.assert_allclose(found.at(rows, columns), wanted, rtol=0, atol=1e-16)


def test_parts_are_separated_by_the_nodes_that_both_halves_have() -> None:
    """Parts on a grid: a line of nodes on the edge between two rows of parts separates them."""
    side, k = 24, 4
    at = np.stack(np.meshgrid(np.arange(k * side + 1), np.arange(k * side + 1)), -1).reshape(-1, 2)
    at = at[(at % side == 0).any(axis=1)]  # edges of parts
    parts = []
    for i in range(k):
        for j in range(k):
            low = np.array([i, j]) * side
            parts.append(np.flatnonzero(((at >= low) & (at <= low + side)).all(axis=1)))
    codes = [np.zeros(0, dtype=np.intp)]
    for p in parts:
        a, b = np.triu_indices(len(p), 1)
        codes.append(p[a] * len(at) + p[b])
    first, second = np.divmod(np.unique(np.concatenate(codes)), len(at))
    pattern = BlockPattern(len(at), 2, 3, first, second)
    positions = np.column_stack([at, np.zeros(len(at))]).astype(float)
    fronts = dissect_parts(pattern, positions, parts)
    assert len(fronts[-1].own) == k * side + 1
    assert max(f.size for f in fronts) < max(f.size for f in dissect(pattern, positions))
    m = random_matrix(pattern)
    y = np.random.default_rng(1).normal(size=(2 * len(at) + 3, 2))
    found = Fronts.of(fronts, m)
    np.testing.assert_allclose(dense(m) @ found.solve(y), y, rtol=0, atol=1e-11)
    inverse = np.linalg.inv(dense(m))
    np.testing.assert_allclose(found.inverse().diagonals, np.diag(inverse), rtol=1e-11)


@pytest.mark.parametrize(("width", "side"), [(6, 5), (3, 0), (1, 3)])
@pytest.mark.parametrize("shape", SHAPES)
def test_kept_columns_are_left_as_the_schur_complement(shape, width, side) -> None:
    positions, reach = shape()
    pairs = near(positions, reach)
    pattern = BlockPattern(len(positions), width, side, pairs[:, 0], pairs[:, 1])
    m = random_matrix(pattern)
    whole = dense(m)
    rng = np.random.default_rng(2)
    last = rng.choice(pattern.n, size=max(pattern.n // 7, 1), replace=False)
    of_nodes = (width * last[:, None] + np.arange(width)).ravel()
    border = pattern.n * width + np.arange(side)
    kept = rng.permutation(np.concatenate([of_nodes[::2], border[::2]]))
    others = np.setdiff1d(np.arange(len(whole)), kept)
    fronts = Fronts.of(dissect(pattern, positions, last), m, kept)
    gain = np.linalg.solve(whole[np.ix_(others, others)], whole[np.ix_(others, kept)])
    left = whole[np.ix_(kept, kept)] - whole[np.ix_(kept, others)] @ gain
    scale = np.abs(left).max()
    np.testing.assert_allclose(fronts.root.left, left, rtol=0, atol=1e-13 * scale)
    y = rng.normal(size=(len(whole), 2))
    remaining = y[kept] - gain.T @ y[others]
    np.testing.assert_allclose(fronts.remaining(y), remaining, rtol=0, atol=1e-12)
    # Other parts add information at the kept columns, and right sides there.
    more = np.diag(rng.uniform(0.0, scale, size=len(kept)))
    together = whole.copy()
    together[np.ix_(kept, kept)] += more
    inverse = np.linalg.inv(together)
    x = inverse @ y
    np.testing.assert_allclose(fronts.solve(y, x[kept]), x, rtol=0, atol=1e-13)
    with pytest.raises(SingularError, match="junctions"):
        fronts.inverse()
    fronts.root.close(np.linalg.inv(left + more))
    np.testing.assert_allclose(fronts.solve(y), x, rtol=0, atol=1e-13)
    found = fronts.inverse()
    stored = dense(BlockMatrix(pattern, *(np.ones_like(b) for b in blocks(found)))) > 0
    assert np.max(np.abs(dense(found) - inverse)[stored]) < 1e-12 * np.max(inverse)


def blocks(m: BlockMatrix) -> tuple[Array, ...]:
    return m.diagonal, m.pairs, m.side, m.corner


@pytest.mark.parametrize("shape", SHAPES)
def test_every_node_is_eliminated_once_and_children_before_their_parents(shape) -> None:
    positions, reach = shape()
    pairs = near(positions, reach)
    fronts = dissect(BlockPattern(len(positions), 6, 0, pairs[:, 0], pairs[:, 1]), positions)
    order = np.concatenate([f.own for f in fronts])
    np.testing.assert_array_equal(np.sort(order), np.arange(len(positions)))
    place = {id(f): i for i, f in enumerate(fronts)}
    assert all(place[id(c)] < place[id(f)] for f in fronts for c in f.children)
    taken = np.concatenate([f.blocks for f in fronts])
    np.testing.assert_array_equal(np.sort(taken), np.arange(len(pairs)))
    assert not len(fronts[-1].border)


def largest(fronts: list[Front]) -> int:
    return max(f.size for f in fronts)


def test_fronts_stay_small_where_photos_see_their_neighbours_only() -> None:
    """A block of 25 by 8 photos is cut across; a road needs a few photos for a cut."""
    sizes = {}
    for shape in (strips, corridor, ring):
        positions, reach = shape()
        pairs = near(positions, reach)
        fronts = dissect(BlockPattern(len(positions), 6, 0, pairs[:, 0], pairs[:, 1]), positions)
        sizes[shape.__name__] = largest(fronts)
    assert sizes["strips"] <= 100
    assert sizes["corridor"] <= MAX_LEAF_NODES + 8
    assert sizes["ring"] <= 60


def test_where_everything_sees_everything_there_is_one_front() -> None:
    positions, reach = everything_sees_everything()
    pairs = near(positions, reach)
    assert len(dissect(BlockPattern(90, 6, 0, pairs[:, 0], pairs[:, 1]), positions)) == 1


def test_without_positions_the_graph_tells_where_to_cut() -> None:
    positions, reach = corridor()
    pairs = near(positions, reach)
    pattern = BlockPattern(len(positions), 6, 0, pairs[:, 0], pairs[:, 1])
    assert largest(dissect(pattern, np.zeros_like(positions))) <= MAX_LEAF_NODES + 8


def test_a_long_tie_lets_separators_grow() -> None:
    """Photos at both ends of a road that see the same tower."""
    positions, reach = corridor()
    pairs = near(positions, reach)
    ties = np.array([[0, 219], [1, 218], [3, 210]])
    every = np.concatenate([pairs, ties])
    every = every[np.lexsort((every[:, 1], every[:, 0]))]
    pattern = BlockPattern(220, 3, 1, every[:, 0], every[:, 1])
    m = random_matrix(pattern)
    fronts = dissect(pattern, positions)
    assert largest(fronts) <= MAX_LEAF_NODES + 20
    found = Fronts.of(fronts, m).inverse()
    np.testing.assert_allclose(found.diagonals, np.diag(np.linalg.inv(dense(m))), rtol=1e-11)


def test_what_is_not_positive_definite_is_refused() -> None:
    positions, reach = corridor()
    pairs = near(positions, reach)
    pattern = BlockPattern(220, 2, 1, pairs[:, 0], pairs[:, 1])
    for place in (0, 100, 219):
        m = random_matrix(pattern)
        m.diagonal[place] -= 2.0 * np.diag(np.diag(m.diagonal[place]))
        with pytest.raises(SingularError):
            Fronts.of(dissect(pattern, positions), m)
    m = random_matrix(pattern)
    m.corner[0, 0] = np.nan
    with pytest.raises(SingularError):
        Fronts.of(dissect(pattern, positions), m)


def test_a_block_that_is_not_stored_is_not_zero_but_an_error() -> None:
    positions, reach = corridor()
    pairs = near(positions, reach)
    pattern = BlockPattern(220, 2, 0, pairs[:, 0], pairs[:, 1])
    found = Fronts.of(dissect(pattern, positions), random_matrix(pattern)).inverse()
    with pytest.raises(IndexError, match="no block"):
        found.at(np.array([0]), np.array([2 * 150]))


def test_pivots_are_those_of_the_order_of_elimination() -> None:
    positions, reach = ring()
    pairs = near(positions, reach)
    pattern = BlockPattern(len(positions), 2, 2, pairs[:, 0], pairs[:, 1])
    m = random_matrix(pattern)
    fronts = dissect(pattern, positions)
    found = Fronts.of(fronts, m)
    places = [2 * f.own[:, None] + np.arange(2) for f in fronts]
    order = np.concatenate([*(p.ravel() for p in places), [300, 301]])
    root = np.linalg.cholesky(dense(m)[np.ix_(order, order)])
    np.testing.assert_allclose(
        (found.pivots * found.diagonal)[order], np.diag(root) ** 2, rtol=1e-12
    )
    assert all(a < b for a, b in pairwise(sorted(order.tolist())))
