"""How far the linear forms of a base hold where everything is by now.

With v and A of the observations of the base at the present state, and v₀ + A₀ dx their linear
forms,

    g = Aᵀv − A₀ᵀ(v₀ + A₀ dx)      what the linear forms miss of the gradient
    dx' = −Q g                     the step that is left
    t = ‖Q^½ (AᵀA − A₀ᵀA₀) Q^½‖    largest relative error of a variance, by power iteration.

A look costs a few linearisations. Between two looks both are predicted from the length
‖dx‖ = √(dxᵀN dx) of the movement: the step, relative to σ, grows at most with the square of the
length, as its part from the residuals v₀ grows with the length, and t grows with the length. What
moves after a look is mostly elsewhere. Step and t of both are composed as the lengths are, with the
cosine of their angle in the metric of N; where what they miss has one direction all the same, these
laws allow twice the step that is predicted, and √2 times t. Along combinations of unknowns that
hardly any observation determines, t grows with the square too.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..types import NO_ROWS, Array, Index
from .factor import Factor
from .linear import LinearisedEquations

SEED = 1
"""Seed of the first vector of the power iteration."""
POWER = 4
"""Number of steps of the power iteration at the first look. A later look makes one step, from the
vector at which the look before it ended."""
FARTHER = 2.0
"""Length, relative to the one that a look saw, from which on its prediction is enlarged."""
GAINED = 4.0
"""Factor by which ``gained`` may grow since a look."""


@dataclass(frozen=True, eq=False)
class Drift:
    """A look at the linear forms, and what it predicts."""

    weights: Array
    """D⁻¹v of the update at that moment, (k,)."""
    left: float
    """Largest step that was left, relative to its own σ."""
    turned: float
    """Largest relative error of a variance, t."""
    length: float
    """Length of the movement from the base, ‖dx‖."""
    curvature: float
    """Step that is left, relative to σ, for the square of the length of the movement."""
    rate: float
    """Relative error of a variance for the length of the movement."""
    reach: float
    """Length of the movement at which curvature and rate were seen."""
    gained: float
    """Largest factor by which rows that joined had made a variance smaller."""
    direction: Array | None
    """The last vector of the power iteration, (n_columns,); none: there was none."""

    def predicted(self, ahead: float, gained: float, inner: float = np.inf) -> tuple[float, float]:
        """Return bounds of left step and t after a movement since the look.

        Both are infinite where a row has determined something that was known far less before: the
        movement along it tells nothing of the curvature there. Where the movement is longer than
        `FARTHER` times the one that was seen, both are multiplied by the square of what it is
        longer by.

        Args:
            ahead: length of the movement.
            gained: largest factor by which rows that joined make a variance smaller.
            inner: dxᵀN dx' of the movements before the look and since; infinite: they have one
                direction.
        """
        if gained > GAINED * self.gained or (ahead > 0 and not self.reach > 0):
            return np.inf, np.inf
        most = self.length * ahead
        along = min(max(inner / most, 0.0), 1.0) if most > 0 else 1.0
        left = self.left + self.curvature * (2.0 * along * most + ahead**2)
        left = max(left, 0.5 * (self.left + self.curvature * (2.0 * most + ahead**2)))
        more = self.rate * ahead
        square = self.turned**2 + 2.0 * along * self.turned * more + more**2
        seen = FARTHER * self.reach
        farther = max(1.0, (self.length + ahead) / seen) ** 2 if seen > 0 else 1.0
        return left * farther, float(np.sqrt(square)) * farther

    def anew(self) -> Drift:
        """Return what is expected of a new base of nearly the same observations."""
        out = replace(self, left=0.0, turned=0.0, length=0.0, gained=1.0)
        return replace(out, weights=self.weights[:0], direction=None)


def missed(
    here: LinearisedEquations, there: LinearisedEquations, movement: Array, apart: Index = NO_ROWS
) -> Array:
    """Return what the linear forms miss of the gradient, (n_columns,).

    Args:
        here: the base, linearised.
        there: the same observations at the present state.
        movement: movement of the unknowns between them, (n_columns,).
        apart: rows that are not looked at.
    """
    linear = here.every_residual + here.times(movement[:, None])[:, 0]
    now = there.every_residual
    linear[apart] = now[apart] = 0.0
    return np.asarray(there.transposed(now[:, None])[:, 0] - here.transposed(linear[:, None])[:, 0])


def turned(
    here: LinearisedEquations,
    there: LinearisedEquations,
    factor: Factor,
    start: Array | None,
    apart: Index = NO_ROWS,
) -> tuple[float, Array]:
    """Return t, and the vector of the power iteration with Q (AᵀA − A₀ᵀA₀).

    Args:
        here: the base, linearised.
        there: the same observations at the present state.
        factor: the factorised base.
        start: the vector of an earlier look; none: there was none.
        apart: rows that are not looked at.
    """
    steps = 1
    if start is None:
        steps = POWER
        noise = np.random.default_rng(SEED).standard_normal((len(here.every_residual), 1))
        start = factor.solve(here.transposed(noise))[:, 0]
    x, size = start[:, None], 0.0
    for _ in range(steps):
        ahead = here.times(x)
        length = float(np.linalg.norm(ahead))
        if not length > 0:
            return 0.0, start
        ahead, now = ahead / length, there.times(x / length)
        ahead[apart] = now[apart] = 0.0
        change = there.transposed(now) - here.transposed(ahead)
        y = factor.solve(change)
        # √(yᵀ N y) of y = Q δN x, with N y = δN x.
        size = float(np.sqrt(max(float(change[:, 0] @ y[:, 0]), 0.0)))
        if not size > 0:
            return 0.0, start
        x = y
    return size, np.asarray(x[:, 0])
