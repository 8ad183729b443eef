"""Newton's steps at the end of an adjustment that converged slowly.

The bound of a Gauss-Newton step f is the distance from the minimum where partial derivatives hardly
change. Where residuals are curved it is not: with the second derivatives H of vᵀPv/2, the way left
is e = −H⁻¹ AᵀPv, and f = −N⁻¹ AᵀPv has only the share 1 − ρ of it in a direction in which steps
shrink by ρ each. Neither the last ratio of steps nor an extrapolation tells ρ of every direction.

e comes from conjugate gradients with N as preconditioner (Nocedal & Wright, Numerical Optimization,
2nd ed., algorithms 5.3 and 7.1). A product H p is the difference of AᵀPv at two states. As many
products are needed as there are directions in which the steps shrink slowly.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..types import Array
from .normal import NormalEquations
from .run import Run
from .singular import SingularError


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
    """Smallest curvature relative to N that differences can tell from none."""
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


def newton_step(run: Run, normal: NormalEquations) -> NewtonStep | None:
    """Return the way from a state to its minimum; none: it cannot be computed beside the state.

    Args:
        run: the adjustment.
        normal: its normal equations at the state.
    """
    try:
        factor = normal.factorise(run.constraint, keep=True)
        return _conjugate(run, normal, lambda r: factor.solve(r[:, None])[:, 0])
    except (SingularError, InputError):
        return None


def _conjugate(run: Run, normal: NormalEquations, solve: Callable[[Array], Array]) -> NewtonStep:
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


def _length(run: Run, normal: NormalEquations, p: Array) -> float:
    """Return √(pᵀ N p), N with the minimal datum of a free network."""
    moved = normal.system.times(p[:, None])[:, 0]
    return float(np.sqrt(moved @ moved + p @ (run.constraint * p)))
