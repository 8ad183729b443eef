"""Poses from rays with mismatches."""

from __future__ import annotations

import builtins
import sys

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.orientation.robust_poses import (
    absolute_pose,
    epipolar_misses,
    ray_misses,
    relative_pose,
    shared_principal_distance,
)
from factorgraph_adj.rotation import exp_rotation, log_rotation
from factorgraph_adj.types import Array
from tests.networks.image_blocks import ring

NOISE = 1e-4
"""Standard deviation of a tangent."""


def scene(seed: int, n: int = 200) -> tuple[Array, Array, Array]:
    """Return points in front of two photos, and rotation and base of the second."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (n, 3)) + np.array([0, 0, 5.0])
    turn = exp_rotation(rng.normal(0, 0.15, 3))
    base = rng.normal(0, 1, 3) * [1.0, 1.0, 0.3]
    return x, turn, base / np.linalg.norm(base)


def tangents(x: Array, turn: Array, centre: Array) -> Array:
    p = (x - centre) @ turn
    return np.stack([p[:, 0] / p[:, 2], -p[:, 1] / p[:, 2]], 1)


@pytest.mark.parametrize("seed", range(6))
def test_a_pair_with_a_third_of_mismatches_is_oriented(seed):
    x, turn, base = scene(seed)
    rng = np.random.default_rng(seed)
    first, second = tangents(x, np.eye(3), np.zeros(3)), tangents(x, turn, base)
    second[:66] = rng.permutation(second[:66])
    first, second = (t + rng.normal(0, NOISE, t.shape) for t in (first, second))
    found = relative_pose(first, second, wide=4e-3, least=3 * NOISE)
    assert found is not None
    assert np.linalg.norm(log_rotation((turn.T @ found.rotation)[None])) < 100 * NOISE
    assert found.base @ base > np.cos(200 * NOISE * 5)
    assert found.fits[66:].mean() > 0.97
    assert 0.3 * NOISE < found.spread < 2 * NOISE


def test_true_rays_have_no_epipolar_misses():
    x, turn, base = scene(0)
    first, second = tangents(x, np.eye(3), np.zeros(3)), tangents(x, turn, base)
    assert epipolar_misses(turn, base, first, second).max() < 1e-14


def test_a_small_shift_across_the_epipolar_line_is_its_miss():
    """Two photos side by side: y is across the lines, and half of a shift is in either photo."""
    x, _, _ = scene(1)
    base = np.array([1.0, 0.0, 0.0])
    first, second = tangents(x, np.eye(3), np.zeros(3)), tangents(x, np.eye(3), base)
    miss = epipolar_misses(np.eye(3), base, first, second + np.array([0.3, 1e-3]))
    np.testing.assert_allclose(miss, 1e-3 / np.sqrt(2), rtol=1e-9)


@pytest.mark.parametrize("seed", range(6))
def test_a_photo_with_a_third_of_mismatches_is_resected(seed):
    x, turn, base = scene(seed)
    rng = np.random.default_rng(seed)
    t = tangents(x, turn, base)
    t[:66] = rng.permutation(t[:66])
    t += rng.normal(0, NOISE, t.shape)
    found = absolute_pose(t, x, limit=6 * NOISE)
    assert found is not None
    rotation, centre, fits = found
    assert np.linalg.norm(log_rotation((turn.T @ rotation)[None])) < 20 * NOISE
    assert np.linalg.norm(centre - base) < 100 * NOISE
    assert fits[66:].all()


def test_points_behind_a_photo_miss_infinitely():
    miss = ray_misses(
        np.eye(3)[None], np.zeros((1, 3)), np.array([[0.0, 0, -2], [0, 0, 2]]), np.zeros((2, 2))
    )
    assert np.isinf(miss[0]) and miss[1] == 0.0


def test_three_points_and_seven_common_points_are_too_few():
    x, turn, base = scene(0)
    t = tangents(x, turn, base)
    assert absolute_pose(t[:3], x[:3], limit=1.0) is None
    assert relative_pose(t[:7], t[:7], wide=1.0, least=1.0) is None


@pytest.mark.parametrize("seed", range(3))
def test_two_photos_tell_their_principal_distance(seed):
    rng = np.random.default_rng(seed)
    x, _, _ = scene(seed)
    turn = exp_rotation(np.array([0.05, -0.5, 0.3]))
    base = np.array([2.2, 0.3, 0.6])
    c = 0.8
    xy = [c * tangents(x, r, b) for r, b in ((np.eye(3), np.zeros(3)), (turn, base))]
    xy = [p + rng.normal(0, 2e-5, p.shape) for p in xy]
    found = shared_principal_distance(*xy, limit=2e-3)
    assert found == pytest.approx(c, rel=0.02)


def test_without_the_extra_the_error_says_what_to_install(monkeypatch):
    plain = builtins.__import__

    def refusing(name, *args, **kwargs):
        if name == "poselib":
            raise ImportError(name)
        return plain(name, *args, **kwargs)

    monkeypatch.delitem(sys.modules, "poselib", raising=False)
    monkeypatch.setattr(builtins, "__import__", refusing)
    network = ring(0, photos=4).network
    with pytest.raises(fga.InputError, match=r"pip install 'factorgraph_adj\[images\]'"):
        fga.orient(network)
    free = ring(0, photos=4, control=0).network
    with pytest.raises(fga.ApproximationError, match=r"pip install 'factorgraph_adj\[images\]'"):
        fga.adjust(free)
