"""Anderson's extrapolation of Gauss-Newton steps that converge slowly.

Where residuals are curved along a weakly determined direction (two photos on a short base), every
Gauss-Newton step leaves the same share ρ of the way; with ρ = 0.85, a hundred steps lead to 1e-7.
The last few steps give an estimate of ρ for each direction in which the iteration is slow.

With the steps fₖ, and the movement dₖ of the unknowns after fₖ, the next movement is

    dₖ = fₖ − Σ γᵢ (dᵢ + fᵢ₊₁ − fᵢ),    γ = argmin ‖fₖ − Σ γᵢ (fᵢ₊₁ − fᵢ)‖²_N

(Anderson 1965; Walker & Ni 2011, eq. 2.1 and 2.2), in the metric of the normal equations, which
does not depend on units: ‖f‖²_N = |A f|².

An extrapolation is taken only where vᵀPv is lower after it than after the step alone. Four limits
bound how long they go on: after `MOST_IN_VAIN` in a row that are not taken only every other step is
extrapolated, only steps below `StoppingRule.still` are, each of them that brings no progress counts
twice towards `StoppingRule.patience`, and every one is an iteration of ``max_iterations``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..types import Array

MEMORY = 6
"""Number of differences of steps that are kept."""
MOST_IN_VAIN = 5
"""Number of extrapolations in a row that are not taken, after which only some steps are
extrapolated: each costs an evaluation of all observations."""
EVERY = 2
"""Every how many steps an extrapolation is tried then."""
RCOND = 1e-8
"""Relative singular value of the matrix of differences of steps below which it counts as zero."""


@dataclass(frozen=True)
class Extrapolated:
    """The extrapolations that an adjustment has taken, and what they gained."""

    count: int = 0
    """Number of iterations that moved the unknowns by an extrapolation of steps."""
    gained: float = 0.0
    """Sum over these iterations of vᵀPv after the step alone less vᵀPv after the extrapolation."""

    def with_one(self, gained: float) -> Extrapolated:
        """Return the record with one more; a difference that is rounding gains nothing."""
        return Extrapolated(self.count + 1, self.gained + max(gained, 0.0))

    def __str__(self) -> str:
        """Return what was gained as a sentence; empty where none was taken."""
        if not self.count:
            return ""
        what = "1 extrapolation" if self.count == 1 else f"{self.count} extrapolations"
        return f"{what} of steps lowered vᵀPv by {self.gained:.3g} more than the steps alone"


NONE_TAKEN = Extrapolated()
"""The record of an adjustment before its first extrapolation."""


class Extrapolation:
    """The last steps of an adjustment and their extrapolation."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all steps: the next step starts a new sequence."""
        self.in_vain = 0
        """Number of steps in a row without an extrapolation that was taken."""
        self._step: Array | None = None
        self._rows: Array = np.zeros(0)
        self._moves: list[Array] = []
        self._bends: list[Array] = []

    def beyond(self, step: Array, rows: Callable[[Array], Array]) -> Array | None:
        """Return the extrapolated movement; none: no earlier step, or too many were in vain.

        Args:
            step: Gauss-Newton step at the present state, (n_columns,).
            rows: function that returns A times a vector, whitened, (n_rows,).
        """
        now = rows(step)
        if self._step is not None:
            # moved() has put the movement after the last step at the end of the list.
            self._moves[-1] = self._moves[-1] + step - self._step
            self._bends.append(now - self._rows)
            del self._moves[:-MEMORY], self._bends[:-MEMORY]
        self._step, self._rows = step, now
        if not self._bends:
            return None
        share, *_ = np.linalg.lstsq(np.stack(self._bends, axis=1), now, rcond=RCOND)
        return step - np.stack(self._moves, axis=1) @ share

    @property
    def promising(self) -> bool:
        """Whether an extrapolation is worth its evaluation at this step."""
        return self.in_vain < MOST_IN_VAIN or self.in_vain % EVERY == 0

    def moved(self, movement: Array) -> None:
        """Note the movement of the unknowns after the last step, (n_columns,)."""
        if self._step is not None:
            self._moves.append(movement)
