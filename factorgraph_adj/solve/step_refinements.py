"""Refinements of a step: geodesic acceleration, Newton's steps, inner iterations.

Geodesic acceleration. A block that observations place weakly, on control far away or on imprecise
positions, moves almost freely as a whole, while image points hold its shape to parts of a pixel.
Its scale, turn and shift are curves in the space of the unknowns; a straight step along their
tangent leaves the valley after a short way, so that damping holds the steps short, and hundreds are
needed. The residuals along a step dx change by A dx + r″/2 with the second directional derivative
r″; the correction a = −½ (N + λD)⁻¹ AᵀP r″ removes what of r″ the unknowns can remove, and dx + a
follows the curve to second order (Transtrum & Sethna 2012, Improvements to the Levenberg-Marquardt
algorithm for nonlinear least-squares minimization). r″ is a difference of residuals at one more
state; the factor is that of dx.

Newton's steps at the end of an adjustment that converged slowly. The bound of a Gauss-Newton step f
is the distance from the minimum where partial derivatives hardly change. Where residuals are curved
it is not: with the second derivatives H of vᵀPv/2, the way left is e = −H⁻¹ AᵀPv, and f = −N⁻¹ AᵀPv
has only the share 1 − ρ of it in a direction in which steps shrink by ρ each. Neither the last
ratio of steps nor an extrapolation gives ρ of every direction. e comes from conjugate gradients
with N as preconditioner (Nocedal & Wright, Numerical Optimization, 2nd ed., algorithms 5.3 and
7.1). A product H p is the difference of AᵀPv at two states. As many products are needed as there
are directions in which the steps shrink slowly.

Inner iterations. One point near a camera, or far away, can spoil a step that is good for all other
points, and damping would then slow the whole block down. With the cameras held, every point is a
problem of three unknowns with its own damping; all points are solved at once (inner iterations of
Ceres, after Ruhe & Wedin's separable least squares).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError, SingularError
from ..graph.blocks import Block
from ..graph.equations import Equations
from ..graph.variables import State
from ..models.image import in_front
from ..types import Array, Mask
from .adjustment_run import AdjustmentRun
from .elimination_layers import Layers, first_point
from .gauss_newton_steps import Factorised, Step
from .normal_equations import NormalEquations

INNER_STEPS = 2
"""Number of inner steps of each point."""


@dataclass(frozen=True)
class AccelerationRule:
    """Limits of the acceleration of a step."""

    straight: float = 0.9
    """Part of the predicted decrease from which a step counts as straight: so much is left of it
    where the correction is a tenth of the step."""
    short: float = 0.01
    """Step relative to σ below which none is accelerated: rounding would spoil the difference, and
    so near the minimum extrapolations do the same."""
    ahead: float = 0.1
    """Part of the step after which residuals are computed for the second derivative."""
    most: float = 0.75
    """Largest length of 2a relative to dx, both in units of the diagonal of N, with which the
    series counts as convergent (Transtrum & Sethna 2012)."""


ACCELERATION = AccelerationRule()
"""The rule of all accelerated steps."""


def accelerated_movement(
    run: AdjustmentRun, normal: NormalEquations, factor: Factorised, step: Step
) -> Array | None:
    """Return dx + a, (n_columns,); None: the second-order part is too long, or not computable.

    Args:
        run: the adjustment.
        normal: its normal equations at the state from which the step leads.
        factor: N + λD, factorised, from which the step was solved.
        step: the step.
    """
    h, dx, system = ACCELERATION.ahead, step.movement, normal.system
    try:
        ahead = run.whitened(run.equations.unknowns.retract(normal.state, h * dx))
    except InputError:
        return None
    with np.errstate(over="ignore", invalid="ignore"):
        chord = (ahead - system.every_residual) / h
        second = 2.0 / h * (chord - system.times(dx[:, None])[:, 0])
        if not np.isfinite(second).all():
            return None
        a = -0.5 * factor.solve(system.transposed(second[:, None]))[:, 0]
        scale = np.sqrt(normal.eased)
        length, along = np.linalg.norm(scale * a), np.linalg.norm(scale * dx)
    return dx + a if 2.0 * length <= ACCELERATION.most * along else None


def state_after_inner_iterations(
    equations: Equations, layers: Layers, before: State, moved: State
) -> State:
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
    for _ in range(INNER_STEPS):
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
    """Return the place of the points of the first layer among the variables; None: it has none."""
    target = first_point(block)
    return target if target is not None and on[block.variables[target][1]].any() else None


@dataclass(frozen=True)
class NewtonRule:
    """Limits of Newton's steps."""

    far: float = 0.01
    """Length relative to σ of the movement between the two states of a difference: derivatives
    change little over it."""
    rounded: float = 30.0
    """Smallest length of that movement in units of the resolution of the coordinates."""
    rest: float = 0.25
    """Part of the way that may be left out: the bound contains it."""
    flat: float = 1e-3
    """Smallest curvature relative to N that differences can distinguish from zero."""
    products: int = 40
    """Largest number of products for one step."""
    steps: int = 4
    """Largest number of Newton's steps."""
    shrinking: float = 0.5
    """Ratio of a way to the one before above which another step brings nothing."""


NEWTON = NewtonRule()
"""The rule of `newton_step`, and of those who take it."""


@dataclass(frozen=True, eq=False)
class NewtonStep:
    """The way to the minimum."""

    movement: Array
    """e, (n_columns,)."""
    bound: float
    """Bound √(eᵀ N e) of its length relative to σ, with what is left out of it."""


def newton_step(run: AdjustmentRun, normal: NormalEquations) -> NewtonStep | None:
    """Return the way from a state to its minimum; None: it cannot be computed beside the state.

    Args:
        run: the adjustment.
        normal: its normal equations at the state.
    """
    try:
        factor = normal.factorise(run.constraint, keep=True)
        return _conjugate(run, normal, lambda r: factor.solve(r[:, None])[:, 0])
    except (SingularError, InputError):
        return None


def _conjugate(
    run: AdjustmentRun, normal: NormalEquations, solve: Callable[[Array], Array]
) -> NewtonStep:
    """Solve H e = −AᵀPv by conjugate gradients, N⁻¹ being known."""
    far = max(NEWTON.far, NEWTON.rounded * normal.resolution)
    unknowns, state = run.equations.unknowns, normal.state
    r = -normal.gradient
    z = solve(r)
    e, p, rz, softest = np.zeros_like(r), z, float(r @ z), 1.0
    for _ in range(NEWTON.products):
        length = _length(run, normal, p)
        if not length > 0.0:
            break
        there = unknowns.retract(state, (far / length) * p)
        hp = (run.gradient_at(there) - normal.gradient) * (length / far) + run.constraint * p
        curvature = max(float(p @ hp) / length**2, NEWTON.flat)
        softest = min(softest, curvature)
        a = rz / (curvature * length**2)
        e, r = e + a * p, r - a * hp
        z = solve(r)
        before, rz = rz, float(r @ z)
        way, left = _length(run, normal, e), np.sqrt(max(rz, 0.0)) / softest
        if left <= NEWTON.rest * way or curvature == NEWTON.flat:
            break
        p = z + (rz / before) * p
    left = np.sqrt(max(rz, 0.0)) / softest
    return NewtonStep(e, _length(run, normal, e) + float(left))


def _length(run: AdjustmentRun, normal: NormalEquations, p: Array) -> float:
    """Return √(pᵀ N p), N with the minimal datum of a free network."""
    moved = normal.system.times(p[:, None])[:, 0]
    return float(np.sqrt(moved @ moved + p @ (run.constraint * p)))
