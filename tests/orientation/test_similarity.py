"""Similarity transformations of parts: exact, with wrong coordinates, and from some components."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.models.similarity import Similarity
from factorgraph_adj.orientation.robust_similarity import (
    in_one_line,
    robust_similarity,
    similarity_from_components,
    similarity_with_rotation,
)
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array

ROUNDING = 1e-9


def some(seed: int, n: int = 12) -> tuple[Similarity, Array]:
    rng = np.random.default_rng(seed)
    turn = exp_rotation(rng.normal(0, 1.5, 3))
    return Similarity(float(rng.uniform(0.1, 20)), turn, rng.normal(0, 100, 3)), rng.normal(
        0, 3, (n, 3)
    )


def assert_same(found: Similarity | None, true: Similarity, tolerance: float = ROUNDING) -> None:
    assert found is not None
    assert found.scale == pytest.approx(true.scale, rel=tolerance)
    np.testing.assert_allclose(found.rotation, true.rotation, atol=tolerance)
    np.testing.assert_allclose(found.shift, true.shift, atol=tolerance * 100)


@pytest.mark.parametrize("seed", range(5))
def test_a_third_of_wrong_coordinates_does_no_harm(seed):
    true, x = some(seed)
    known = true.of(x)
    known[:4] += np.random.default_rng(seed).normal(0, 50, (4, 3))
    found = robust_similarity(x, known)
    assert found is not None
    assert_same(found[0], true)
    assert not found[1][:4].any() and found[1][4:].all()


def test_points_in_one_line_give_no_rotation():
    true, _ = some(0)
    x = np.outer(np.arange(5.0), [1.0, 2.0, 3.0])
    assert in_one_line(x)
    assert robust_similarity(x, true.of(x)) is None


@pytest.mark.parametrize("seed", range(5))
def test_plan_of_two_and_heights_of_three_points_give_everything(seed):
    """Ground control of a block of photos as it used to be: seven coordinates and one to spare."""
    true, x = some(seed, 6)
    known = np.full((6, 3), np.nan)
    y = true.of(x)
    known[:2], known[2:5, 2] = y[:2], y[2:5, 2]
    known[3, 0] = y[3, 0]
    found = similarity_from_components(x[:5], known[:5])
    assert found is not None
    there = np.isfinite(known[:5])
    np.testing.assert_allclose(found.of(x[:5])[there], known[:5][there], atol=1e-5)


def test_six_coordinates_are_not_enough():
    true, x = some(1, 2)
    assert similarity_from_components(x, true.of(x)) is None


@pytest.mark.parametrize("seed", range(5))
def test_a_known_rotation_leaves_scale_and_shift_to_any_components(seed):
    true, x = some(seed, 4)
    known = np.full((4, 3), np.nan)
    y = true.of(x)
    known[0], known[1, 0] = y[0], y[1, 0]
    assert_same(similarity_with_rotation(x, known, true.rotation), true, 1e-8)


def test_one_point_gives_no_scale_to_a_known_rotation():
    true, x = some(2, 1)
    assert similarity_with_rotation(x, true.of(x), true.rotation) is None
