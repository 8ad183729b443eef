"""Least-squares similarities of common places: exact, weighted, of known scale, and mirrored."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.models.similarity import Similarity, extent_ratio, fit_similarity
from factorgraph_adj.rotation import exp_rotation, nearest_rotation
from factorgraph_adj.types import Array

ROUNDING = 1e-12


def some(seed: int, n: int = 12) -> tuple[Similarity, Array]:
    rng = np.random.default_rng(seed)
    turn = exp_rotation(rng.normal(0, 1.5, 3))
    true = Similarity(float(rng.uniform(0.1, 20)), turn, rng.normal(0, 100, 3))
    return true, rng.normal(0, 3, (n, 3))


def assert_same(found: Similarity, true: Similarity, tolerance: float = ROUNDING) -> None:
    assert found.scale == pytest.approx(true.scale, rel=tolerance)
    np.testing.assert_allclose(found.rotation, true.rotation, atol=tolerance)
    np.testing.assert_allclose(found.shift, true.shift, atol=tolerance * 100)


@pytest.mark.parametrize("seed", range(5))
def test_places_give_back_the_transformation_whatever_their_weights(seed):
    true, x = some(seed)
    assert_same(fit_similarity(x, true.of(x)), true)
    weights = np.random.default_rng(seed).uniform(0.1, 10.0, len(x))
    assert_same(fit_similarity(x, true.of(x), weights), true)
    assert_same(fit_similarity(x, true.of(x), weights, scale=true.scale), true)


@pytest.mark.parametrize("scale", [None, 1.5])
@pytest.mark.parametrize("mirrored", [False, True])
def test_the_weighted_sum_of_squares_is_least(scale, mirrored):
    true, x = some(7)
    rng = np.random.default_rng(7)
    to = true.of(x * [1.0, 1.0, -1.0 if mirrored else 1.0]) + rng.normal(0, 0.3, x.shape)
    weights = rng.uniform(0.1, 10.0, len(x))

    def cost(by: Similarity) -> float:
        return float(weights @ np.sum((by.of(x) - to) ** 2, axis=1))

    found = fit_similarity(x, to, weights, scale=scale, mirrored=mirrored)
    assert np.linalg.det(found.rotation) == pytest.approx(-1.0 if mirrored else 1.0)
    for p in np.concatenate([np.eye(7), -np.eye(7)]) * 1e-3:
        size = found.scale * np.exp(p[6] if scale is None else 0.0)
        near = Similarity(size, exp_rotation(p[:3]) @ found.rotation, found.shift + p[3:6])
        assert cost(near) >= cost(found)


def test_a_place_without_weight_changes_nothing():
    true, x = some(3)
    to = true.of(x) + np.random.default_rng(3).normal(0, 0.1, x.shape)
    weights = np.ones(len(x))
    weights[0] = 0.0
    assert_same(fit_similarity(x, to, weights), fit_similarity(x[1:], to[1:]))


def test_places_in_the_plane_have_four_parameters():
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    true, x = Similarity(2.5, turn, np.array([3.0, -4.0])), some(1)[1][:, :2]
    assert_same(fit_similarity(x, true.of(x)), true)


def test_places_in_one_place_give_no_scale():
    x, to = np.ones((4, 3)), np.random.default_rng(0).normal(size=(4, 3))
    assert fit_similarity(x, to).scale == fit_similarity(to, x).scale == 0.0


def test_extents_tell_places_off_a_line_from_others():
    line = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    assert extent_ratio(line) < ROUNDING
    assert extent_ratio(np.ones((4, 3))) == extent_ratio(np.eye(3)[:2]) == 0.0
    assert extent_ratio(np.array([[2.0, 1.0], [2.0, -1.0], [-2.0, 1.0], [-2.0, -1.0]])) == 0.5


def test_poses_move_with_their_points():
    true, x = some(3)
    pose = np.concatenate([np.eye(3).ravel(), x[0]])[None]
    moved = true.of_poses(pose)[0]
    before = x[1:] - x[0]
    after = (true.of(x[1:]) - moved[9:]) @ moved[:9].reshape(3, 3)
    np.testing.assert_allclose(after, true.scale * before, atol=ROUNDING * 100)


def test_the_mean_of_rotations_is_between_them():
    w = np.array([0.1, -0.2, 0.3])
    turns = np.array([exp_rotation(w * s) for s in (0.8, 1.2)])
    np.testing.assert_allclose(nearest_rotation(turns.sum(axis=0)), exp_rotation(w), atol=ROUNDING)


def test_nearest_rotations_of_many_are_those_of_each():
    h = np.random.default_rng(5).normal(size=(6, 3, 3))
    each = np.array([nearest_rotation(m) for m in h])
    np.testing.assert_allclose(nearest_rotation(h), each, atol=ROUNDING)
