"""Damped least-squares fits (Levenberg, Marquardt), and what their observations leave open.

A step δ of residuals v with partials A is (AᵀA + λ diag AᵀA) δ = −Aᵀv; λ falls after a step that
lowers vᵀv, and rises after one that does not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from ..types import Array, Mask

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
        length = np.linalg.norm(a, axis=0)
        length[length == 0] = 1.0
        scaled = a / length
        normal = scaled.T @ scaled + damping * np.eye(len(length))
        if not (np.isfinite(normal).all() and np.isfinite(cost)):
            break
        step = -np.linalg.lstsq(normal, scaled.T @ v, rcond=None)[0] / length
        trial = moved(values, step)
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
