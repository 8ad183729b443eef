"""Geodesic acceleration: the second-order part of a step along a curved valley of vᵀPv.

A block that observations place weakly, on control far away or on imprecise positions, moves almost
freely as a whole, while image points hold its shape to parts of a pixel. Its scale, turn and shift
are curves in the space of the unknowns; a straight step along their tangent leaves the valley after
a short way, so that damping holds the steps short, and hundreds are needed. The residuals along a
step dx change by A dx + r″/2 with the second directional derivative r″; the correction

    a = −½ (N + λD)⁻¹ AᵀP r″

removes what of r″ the unknowns can remove, and dx + a follows the curve to second order
(Transtrum & Sethna 2012, Improvements to the Levenberg-Marquardt algorithm for nonlinear least-
squares minimization). r″ is a difference of residuals at one more state; the factor is that of dx.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..types import Array
from .normal import NormalEquations
from .run import Run
from .step import Factorised, Step


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


def accelerated(run: Run, normal: NormalEquations, factor: Factorised, step: Step) -> Array | None:
    """Return dx + a, (n_columns,); none: the second-order part is too long, or not computable.

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
