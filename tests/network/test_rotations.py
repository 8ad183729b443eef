"""Rotation matrices as they are given: with few digits, with errors, mirrored."""

from __future__ import annotations

import numpy as np
import pytest

import factorgraph_adj as fga
from factorgraph_adj.models.lens import NoDistortion
from factorgraph_adj.rotation import exp_rotation


def with_photo(rotation: object) -> fga.Photo:
    network = fga.Network("one photo")
    network.add_camera("cam", NoDistortion(), {"c": 50.0})
    network.add_photo("1", "cam", position=(0.0, 0.0, 0.0), rotation=rotation)
    return network.photos["1"]


@pytest.mark.parametrize("digits", [4, 6, 9, 12])
def test_a_matrix_is_taken_to_its_digits(digits):
    for seed in range(20):
        true = exp_rotation(np.random.default_rng(seed).normal(size=3))
        found = with_photo(np.round(true, digits)).rotation
        assert np.abs(found @ found.T - np.eye(3)).max() < 1e-14
        assert np.abs(found - true).max() < 10.0**-digits


def test_a_rotation_stays_as_it_is():
    true = exp_rotation(np.array([0.3, -0.2, 1.1]))
    assert np.array_equal(with_photo(true).rotation, true)


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: np.round(r, 6) + 0.001 * np.eye(3), r"by 0\.00\d+, more than the 6 decimals"),
        (lambda r: r * 1.0001, "more than the 1[45] decimals of its elements explain"),
        (lambda r: r @ np.diag((1.0, 1.0, -1.0)), "determinant is −1, it mirrors one axis"),
        (lambda r: r[:2], "must be a 3 × 3 rotation matrix"),
        (lambda r: r * np.nan, "must be a 3 × 3 rotation matrix"),
    ],
)
def test_what_is_no_rotation_is_told_by_how_much(spoil, message):
    true = exp_rotation(np.array([0.3, -0.2, 1.1]))
    with pytest.raises(fga.InputError, match=message):
        with_photo(spoil(true))
