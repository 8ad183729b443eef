"""Relative poses: published unit values, the exact composition of a rig, and its inverse."""

from __future__ import annotations

import numpy as np
import pytest

from factorgraph_adj.frames import LocalFrame
from factorgraph_adj.models.relative_poses import (
    moved_with,
    relative_position,
    relative_rotation,
    turned,
    turned_with,
)
from factorgraph_adj.models.unknown_registry import UNKNOWNS
from factorgraph_adj.rotation import TURN_ABOUT_X as TURN
from factorgraph_adj.rotation import exp_rotation
from factorgraph_adj.types import Array
from tests.networks.rigs import MOUNTS, on_mount

EPS = 1e-12
NO_MOUNT = UNKNOWNS["mount"].store(np.zeros((1, 6)))
ABOUT_Y = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
"""Rotation by 90° about y, as printed in the source."""


def stored(from_world: Array, translation: Array) -> Array:
    """Return a stored pose (1, 12) of p = R X + t, axes x right, y down, z forward."""
    return np.concatenate([from_world.T.ravel(), -from_world.T @ translation])[None]


def colmap(i: Array, j: Array, j_from_i: Array) -> Array:
    """Return the residuals of COLMAP from ours, (6,).

    COLMAP's are log(i_R_w w_R_j j_R_i) and i_t_w + i_R_w w_R_j (j_t_i − j_t_w), in axes of i, for
    the prior j_from_i = (I, j_t_i). Ours with photo j and photo2 i are Log(j_R_iᵀ j_R_w w_R_i),
    its inverse, and R_jᵀ (X_i − X_j) − j_t_i in axes of j.
    """
    frame, odometer = LocalFrame(), np.zeros((1, 2))
    turn = relative_rotation(frame, j, i, NO_MOUNT, observed=np.zeros((1, 3))).residual[0]
    base = TURN @ j_from_i
    step = relative_position(frame, j, i, NO_MOUNT, odometer, observed=base[None]).residual[0]
    i_from_j = i[0, :9].reshape(3, 3).T @ j[0, :9].reshape(3, 3)
    return np.concatenate([-TURN @ turn, -i_from_j @ (TURN @ step)])


@pytest.mark.parametrize(
    ("i", "j", "residuals"),
    [
        (((0, 0, 0), np.eye(3)), ((0, 0, 1), np.eye(3)), (0, 0, 0, 0, 0, 0)),
        (((0, 0, 4), np.eye(3)), ((0, 0, 1), np.eye(3)), (0, 0, 0, 0, 0, 4)),
        (((0, 0, 4), np.eye(3)), ((2, 0, 1), np.eye(3)), (0, 0, 0, -2, 0, 4)),
        (((0, 0, 4), np.eye(3)), ((2, 0, 1), ABOUT_Y), (0, -np.pi / 2, 0, 0, 0, 2)),
    ],
)
def test_the_unit_values_of_colmap(
    i: tuple[tuple[float, ...], Array], j: tuple[tuple[float, ...], Array], residuals: Array
) -> None:
    """RelativePosePriorCostFunctor, Nominal (colmap, cost_functions/pose_prior_test.cc, BSD-3).

    The prior is i_from_j = (I, (0, 0, −1)), hence j_from_i = (I, (0, 0, 1)).
    """
    poses = [stored(rotation, np.array(t, dtype=float)) for t, rotation in (i, j)]
    assert np.allclose(colmap(*poses, np.array([0.0, 0.0, 1.0])), residuals, atol=1e-6)


def pair() -> tuple[Array, Array, Array]:
    """Return a carrier, a member that sits exactly on its mount, and the mount."""
    rotation = exp_rotation(np.array([0.4, -1.1, 0.7]))
    centre = np.array([4e5, 5e6, 300.0])
    turned_by, at = on_mount(rotation, centre, MOUNTS["left"])
    mount = UNKNOWNS["mount"].store(np.array([MOUNTS["left"]]))
    carrier = np.concatenate([rotation.ravel(), centre])[None]
    return carrier, np.concatenate([turned_by.ravel(), at])[None], mount


def test_a_member_on_its_mount_has_no_residuals() -> None:
    carrier, member, mount = pair()
    none = np.zeros((1, 3))
    turn = relative_rotation(LocalFrame(), carrier, member, mount, observed=none)
    step = relative_position(LocalFrame(), carrier, member, mount, np.zeros((1, 2)), observed=none)
    assert np.abs(turn.residual).max() < EPS
    assert np.abs(step.residual).max() < 2e-9  # the rounding of coordinates of 5000 km


def test_the_scale_of_an_odometer_multiplies_the_whole_vector() -> None:
    carrier, member, _ = pair()
    observed, odometer = np.array([[0.1, 0.2, 0.3]]), np.array([[-0.5, 0.0]])
    args = (LocalFrame(), carrier, member, NO_MOUNT)
    whole = relative_position(*args, np.zeros((1, 2)), observed=np.zeros((1, 3))).residual
    half = relative_position(*args, odometer, observed=observed).residual
    assert np.allclose(half, 0.5 * whole - observed, rtol=0, atol=EPS)


@pytest.mark.parametrize("size", [0.0, 1e-9, 0.1, 2.5])
def test_a_member_is_placed_where_its_residuals_are_as_promised(size: float) -> None:
    carrier, member, mount = pair()
    observed, v = np.array([[0.3, -0.2, 0.5]]), size * np.array([[0.6, -0.64, 0.48]])
    odometer = np.array([[0.02, 0.0]])
    placed = turned_with(v, carrier, member, mount, observed=observed)
    placed = moved_with(v, carrier, placed, mount, odometer, observed=observed)
    turn = relative_rotation(LocalFrame(), carrier, placed, mount, observed=observed)
    step = relative_position(LocalFrame(), carrier, placed, mount, odometer, observed=observed)
    assert np.allclose(turn.residual, v, rtol=0, atol=1e-9)
    assert np.allclose(step.residual, v, rtol=0, atol=1e-8)


def test_the_error_of_a_rotation_is_a_turn() -> None:
    observed, error = np.array([[1.2, -0.7, 0.4]]), np.array([[0.01, 0.02, -0.03]])
    carrier, member, mount = pair()
    before = relative_rotation(LocalFrame(), carrier, member, mount, observed=observed)
    true = turned(observed, before.residual)
    found = relative_rotation(LocalFrame(), carrier, member, mount, observed=turned(true, error))
    assert np.allclose(found.residual, -error, rtol=0, atol=EPS)
    true = turned(
        observed,
        relative_rotation(LocalFrame(), carrier, member, NO_MOUNT, observed=observed).residual,
    )
    reading = turned(true, error)
    found = relative_rotation(LocalFrame(), carrier, member, NO_MOUNT, observed=reading)
    assert np.allclose(found.residual, -error, rtol=0, atol=EPS)
    assert not np.allclose(reading, true + error, rtol=0, atol=1e-4)
