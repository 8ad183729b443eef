"""Inner iterations: each point of the first layer follows a step of the cameras on its own.

One point near a camera, or far away, can spoil a step that is good for all other points, and
damping would then slow the whole block down. With the cameras held, every point is a problem of
three unknowns with its own damping; all points are solved at once. (Inner iterations of Ceres,
after Ruhe & Wedin's separable least squares.)
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.image import in_front
from ..types import Array, Mask
from .elimination import Layers, first_point

STEPS = 2
"""Number of inner steps of each point."""


def follow(equations: Equations, layers: Layers, before: State, moved: State) -> State:
    """Return ``moved`` with the points of the first layer improved where their vᵀPv decreases.

    Args:
        equations: the network.
        layers: the layers; the points of the first one are moved.
        before: the state before the step; its points are candidates too.
        moved: the state after the step.
    """
    on = layers.reduced
    if not on.any():
        return moved
    free = equations.unknowns["point"].free.astype(float)
    start = _costs(equations, on, moved)
    state: State = {**moved, "point": before["point"].copy()}
    cost = _costs(equations, on, state)
    better = on & (start < cost)
    state["point"][better | ~on] = moved["point"][better | ~on]
    cost = np.where(better, start, cost)
    if np.isinf(cost[on]).all():  # a point in a focal plane has no image, and there are no normals
        return moved
    damping = np.full(len(cost), 1e-4)
    for _ in range(STEPS):
        h, g = _normals(equations, on, state)
        g *= free
        diagonal = np.einsum("pii->pi", h)
        safe = np.maximum(diagonal, 1e-300)
        a = h * (free[:, :, None] * free[:, None, :])
        index = np.arange(3)
        a[:, index, index] += damping[:, None] * safe + (1.0 - free) * safe
        a[~on] = np.eye(3)
        step = -np.linalg.solve(a, g[:, :, None])[:, :, 0]
        step[~on] = 0.0
        trial: State = {**state, "point": state["point"] + step}
        after = _costs(equations, on, trial)
        better = on & (after < cost)
        state["point"][better] = trial["point"][better]
        cost = np.where(better, after, cost)
        damping = np.where(better, damping * 0.1, np.minimum(damping * 100.0, 1e6))
    return state


def _costs(equations: Equations, on: Mask, state: State) -> Array:
    """Return vᵀPv of the rows of each point; infinite where the point lies behind a camera."""
    n = len(state["point"])
    out = np.zeros(n)
    for block in equations.blocks:
        target = _of_points(block, on)
        if target is None:
            continue
        point = block.variables[target][1]
        try:
            v = block.evaluate(equations.network.frame, state, jacobians=False).residual
        except InputError:
            return np.full(n, np.inf)
        w = block.whiten(v)
        out += np.bincount(point, weights=np.sum(w * w, axis=1), minlength=n)
        if block.lens is not None:
            z = in_front(state["pose"][block.variables[0][1]], state["point"][point], block.lens)
            out[point[z <= 0]] = np.inf
    return np.where(np.isnan(out), np.inf, out)


def _normals(equations: Equations, on: Mask, state: State) -> tuple[Array, Array]:
    """Return the normal matrices (n, 3, 3) and gradients (n, 3) of the points."""
    n = len(state["point"])
    h, g = np.zeros((n, 3, 3)), np.zeros((n, 3))
    for block in equations.blocks:
        target = _of_points(block, on)
        if target is None:
            continue
        point = block.variables[target][1]
        linear = block.evaluate(equations.network.frame, state)
        w, a = block.whiten(linear.residual), block.whiten(linear.jacobians[target])
        for i in range(3):
            weights = np.sum(a[:, :, i] * w, axis=1)
            g[:, i] += np.bincount(point, weights=weights, minlength=n)
            for j in range(i, 3):
                weights = np.sum(a[:, :, i] * a[:, :, j], axis=1)
                h[:, i, j] += np.bincount(point, weights=weights, minlength=n)
    h[:, 1, 0], h[:, 2, 0], h[:, 2, 1] = h[:, 0, 1], h[:, 0, 2], h[:, 1, 2]
    return h, g


def _of_points(block: Block, on: Mask) -> int | None:
    """Return the place of the points of the first layer among the variables; none: it has none."""
    target = first_point(block)
    return target if target is not None and on[block.variables[target][1]].any() else None
