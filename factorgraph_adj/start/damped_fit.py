"""Damped least-squares fits (Levenberg, Marquardt), and what their observations leave open.

A step δ of residuals v with partials A is (AᵀA + λ diag AᵀA) δ = −Aᵀv; λ falls after a step that
lowers vᵀv, and rises after one that does not. Combinations of unknowns that nothing determines do
not move. Many fits from different starts go on side by side, so that the models see arrays.

With a bound c, residuals count as by the function soft L1, Σ 2c² (√(1 + (v/c)²) − 1) in place of
vᵀv: rows of v and A are multiplied by the roots of the weights (1 + (v/c)²)^−½.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from ..types import Array, Index, Mask

FIRST_DAMPING, MAX_DAMPING = 1e-3, 1e8
"""Damping of the first step, and the largest one."""
DAMPING_AFTER_SUCCESS, DAMPING_AFTER_FAILURE = 0.2, 10.0
"""Factors of the damping after a step that lowers vᵀv, and after one that does not."""
MIN_GAIN_RATIO = 1e-12
"""Smallest part of vᵀv by which a step lowers it before the fit ends."""
MIN_NAMED_PART = 0.2
"""Part of a component in an open combination from which on it is named."""

Values = TypeVar("Values")


@dataclass(frozen=True, eq=False)
class DampedFit(Generic[Values]):
    """The end of a fit."""

    values: Values
    """What was fitted."""
    cost: float
    """vᵀv; infinite where a fit from this start is impossible."""
    partials: Array
    """A, (n, u)."""


def damped_fit(
    start: Values,
    system: Callable[[Values], tuple[Array, Array]],
    moved: Callable[[Values, Array], Values],
    max_steps: int,
) -> DampedFit[Values]:
    """Return where damped Gauss–Newton steps lead from a start.

    Args:
        start: the first values.
        system: values → residuals (n,), infinite where there are none, and partials (n, u).
        moved: values and a step (u,) → other values.
        max_steps: largest number of steps.
    """
    values, damping = start, FIRST_DAMPING
    v, a = system(values)
    cost = float(v @ v)
    for _ in range(max_steps):
        if not (np.isfinite(a).all() and np.isfinite(cost)):
            break
        trial = moved(values, _step(v, a, damping))
        v_trial, a_trial = system(trial)
        cost_trial = float(v_trial @ v_trial)
        if cost_trial <= cost:
            gain, before = cost - cost_trial, cost
            values, v, a, cost = trial, v_trial, a_trial, cost_trial
            damping *= DAMPING_AFTER_SUCCESS
            if gain <= MIN_GAIN_RATIO * before:
                break
        else:
            damping *= DAMPING_AFTER_FAILURE
            if damping > MAX_DAMPING:
                break
    return DampedFit(values, cost, a)


def _step(v: Array, a: Array, damping: float) -> Array:
    """Return the damped step (u,), the shortest of equally good ones."""
    length = np.linalg.norm(a, axis=0)
    length[length == 0] = 1.0
    scaled = a / length
    normal = scaled.T @ scaled + damping * np.eye(len(length))
    return np.asarray(-np.linalg.lstsq(normal, scaled.T @ v, rcond=None)[0] / length)


def damped_fits(
    starts: Array,
    system: Callable[[Array, Index], tuple[Array, Array]],
    max_steps: int,
    *,
    bound: float = np.inf,
) -> list[DampedFit[Array]]:
    """Return where damped Gauss–Newton steps lead from each of several starts.

    Args:
        starts: first values, (k, u).
        system: values (m, u) and the numbers (m,) of their starts → residuals (m, n), infinite
            where there are none, and partials (m, n, u).
        max_steps: largest number of steps.
        bound: c of the function soft L1.

    Returns:
        One for each start; its cost and partials are those with weights.
    """
    values, damping = starts.copy(), np.full(len(starts), FIRST_DAMPING)
    going = np.arange(len(starts))
    cost, v, a = _weighted(*system(values, going), bound)
    going = going[np.isfinite(cost)]
    for _ in range(max_steps):
        if not len(going):
            break
        steps = [_step(v[i], a[i], damping[i]) for i in going.tolist()]
        trial = values[going] + np.array(steps)
        cost_trial, v_trial, a_trial = _weighted(*system(trial, going), bound)
        before = cost[going]
        better = cost_trial <= before
        to = going[better]
        values[to], v[to], a[to] = trial[better], v_trial[better], a_trial[better]
        cost[to] = cost_trial[better]
        damping[going] *= np.where(better, DAMPING_AFTER_SUCCESS, DAMPING_AFTER_FAILURE)
        gained = before - cost[going] > MIN_GAIN_RATIO * before
        going = going[np.where(better, gained, damping[going] <= MAX_DAMPING)]
    return [DampedFit(*end) for end in zip(values, cost.tolist(), a, strict=True)]


def _weighted(v: Array, a: Array, bound: float) -> tuple[Array, Array, Array]:
    """Return costs (k,), and residuals and partials with weights; infinite: nothing is there."""
    there: Mask = np.asarray(np.isfinite(v).all(axis=1))
    there &= np.asarray(np.isfinite(a).all(axis=(1, 2)))
    v, a = np.where(there[:, None], v, 0.0), np.where(there[:, None, None], a, 0.0)
    stretch = np.sqrt(1.0 + (v / bound) ** 2)
    cost = np.where(there, np.sum(2.0 * v**2 / (1.0 + stretch), axis=1), np.inf)
    root = 1.0 / np.sqrt(stretch)
    return cost, root * v, root[:, :, None] * a


def open_columns(partials: Array, ratio: float) -> Mask:
    """Return which unknowns take part in combinations that observations leave open, (u,).

    Args:
        partials: A, (n, u), in comparable units.
        ratio: ratio of singular values to the largest one up to which a combination is open.
    """
    if not partials.shape[1]:
        return np.zeros(0, dtype=bool)
    _, values, vt = np.linalg.svd(partials, full_matrices=True)
    values = np.concatenate([values, np.zeros(len(vt) - len(values))])
    rows = vt[values <= ratio * values[0]]
    return np.asarray(np.linalg.norm(rows, axis=0) > MIN_NAMED_PART)
