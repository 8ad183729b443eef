"""A Gauss-Newton step, the rule of its damping λ, and the extrapolation of several steps.

Steps are tried without damping, λ = 0. Where a step fails, λ D with D = diag(N) makes the next
step shorter and turns it towards the steepest descent (Levenberg 1944, Marquardt 1963). λ follows
Nielsen's rule (Nielsen 1999): λ grows faster and faster while steps fail, and shrinks smoothly
with the part of the predicted decrease that a step brought.

Where residuals are curved along a weakly determined direction (two photos on a short base), every
Gauss-Newton step leaves the same share ρ of the way; with ρ = 0.85, a hundred steps lead to 1e-7.
The last few steps give an estimate of ρ for each direction in which the iteration is slow. With the
steps fₖ, and the movement dₖ of the unknowns after fₖ, the next movement is

    dₖ = fₖ − Σ γᵢ (dᵢ + fᵢ₊₁ − fᵢ),    γ = argmin ‖fₖ − Σ γᵢ (fᵢ₊₁ − fᵢ)‖²_N

(Anderson 1965; Walker & Ni 2011, eq. 2.1 and 2.2), in the metric of the normal equations, which
does not depend on units: ‖f‖²_N = |A f|².

An extrapolation is taken only where vᵀPv is lower after it than after the step alone. Four limits
bound their number: after `MAX_VAIN_EXTRAPOLATIONS` in a row that are not taken only every other
step is extrapolated, only steps below `StoppingRule.still` are, each of them that brings no
progress counts twice towards `StoppingRule.patience`, and every one is an iteration of
``max_iterations``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from ..types import Array

MAX_STEP_DIFFERENCES = 6
"""Number of differences of steps that are kept."""
MAX_VAIN_EXTRAPOLATIONS = 5
"""Number of extrapolations in a row that are not taken, after which only some steps are
extrapolated: each costs an evaluation of all observations."""
STEPS_PER_TRIAL = 2
"""Number of steps from one extrapolation to the next one then."""
MIN_SINGULAR_VALUE_RATIO = 1e-8
"""Relative singular value of the matrix of differences of steps below which it counts as zero."""
S = TypeVar("S")
"""A state: the values themselves, or a reference to them."""


@dataclass(frozen=True)
class DampingRule:
    """Bounds of the damping λ, and how fast λ changes."""

    first: float = 1e-4
    """Damping of the first step that is tried after an undamped step failed."""
    least: float = 1e-12
    """Damping below which a step counts as undamped: N itself has errors of this size."""
    most: float = 1e12
    """Largest damping that is tried: beyond it steps are smaller than rounding."""
    near: float = 1e-4
    """Step relative to σ below which the next step is tried without damping: so near the minimum
    vᵀPv is a parabola."""
    growth: float = 2.0
    """Factor on the damping after a first failure; every further failure doubles the factor."""
    relief: float = 0.1
    """Smallest factor on the damping, after a step that brought all of the predicted decrease."""


DAMPING = DampingRule()
"""The rule that `Damping` follows."""


@dataclass(frozen=True)
class Damping:
    """The damping of the next step; every change returns a new value."""

    value: float = 0.0
    """λ, the share of the diagonal of N that is added; zero is an undamped step."""
    resume: float = DAMPING.first
    """λ of the next step if an undamped step fails."""
    growth: float = DAMPING.growth
    """Factor on λ if a damped step fails."""

    @property
    def hopeless(self) -> bool:
        """Whether the damping has passed its largest value, so that the iteration must end."""
        return self.value > DAMPING.most

    def harder(self) -> Damping:
        """Return the damping after a step that failed."""
        value = self.resume if self.value == 0.0 else self.value * self.growth
        return Damping(value, self.resume, 2.0 * self.growth)

    def relaxed(self, gain: float, bound: float) -> Damping:
        """Return the damping after a step that was taken.

        Args:
            gain: part of the predicted decrease of vᵀPv that the step brought.
            bound: size of the step relative to σ.
        """
        value = self.value * max(DAMPING.relief, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
        if value < DAMPING.least or bound < DAMPING.near:
            return Damping(0.0, max(value, DAMPING.least))
        return Damping(value, self.resume)


@dataclass(frozen=True)
class ExtrapolationRecord:
    """The extrapolations that an adjustment has taken, and their gain."""

    count: int = 0
    """Number of iterations that moved the unknowns by an extrapolation of steps."""
    gained: float = 0.0
    """Sum over these iterations of vᵀPv after the step alone less vᵀPv after the extrapolation."""

    def with_one(self, gained: float) -> ExtrapolationRecord:
        """Return the record with one more; a difference that is rounding gains nothing."""
        return ExtrapolationRecord(self.count + 1, self.gained + max(gained, 0.0))

    def __str__(self) -> str:
        """Return what was gained as a sentence; empty where none was taken."""
        if not self.count:
            return ""
        what = "1 extrapolation" if self.count == 1 else f"{self.count} extrapolations"
        return f"{what} of steps lowered vᵀPv by {self.gained:.3g} more than the steps alone"


NO_EXTRAPOLATIONS = ExtrapolationRecord()
"""The record of an adjustment before its first extrapolation."""


class Extrapolation:
    """The last steps of an adjustment and their extrapolation."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Delete all steps: the next step starts a new sequence."""
        self.in_vain = 0
        """Number of steps in a row without an extrapolation that was taken."""
        self._step: Array | None = None
        self._rows: Array = np.zeros(0)
        self._moves: list[Array] = []
        self._bends: list[Array] = []

    def beyond(self, step: Array, rows: Callable[[Array], Array]) -> Array | None:
        """Return the extrapolated movement; None: no earlier step, or too many were in vain.

        Args:
            step: Gauss-Newton step at the present state, (n_columns,).
            rows: function that returns A times a vector, whitened, (n_rows,).
        """
        now = rows(step)
        if self._step is not None:
            # moved() has put the movement after the last step at the end of the list.
            self._moves[-1] = self._moves[-1] + step - self._step
            self._bends.append(now - self._rows)
            del self._moves[:-MAX_STEP_DIFFERENCES], self._bends[:-MAX_STEP_DIFFERENCES]
        self._step, self._rows = step, now
        if not self._bends:
            return None
        share, *_ = np.linalg.lstsq(
            np.stack(self._bends, axis=1), now, rcond=MIN_SINGULAR_VALUE_RATIO
        )
        return step - np.stack(self._moves, axis=1) @ share

    @property
    def promising(self) -> bool:
        """Whether an extrapolation is worth its evaluation at this step."""
        return self.in_vain < MAX_VAIN_EXTRAPOLATIONS or self.in_vain % STEPS_PER_TRIAL == 0

    def moved(self, movement: Array) -> None:
        """Note the movement of the unknowns after the last step, (n_columns,)."""
        if self._step is not None:
            self._moves.append(movement)


class Factorised(Protocol):
    """A factorised system, such as `factorgraph_adj.solve.factorisation.Factorisation`."""

    def solve(self, y: Array) -> Array:
        """Return Q y for y (n, k)."""
        ...


@dataclass(frozen=True, eq=False)
class Step:
    """The solution dx of (N + λD) dx = −AᵀPv."""

    movement: Array
    """dx, (n_columns,)."""
    decrease: float
    """Decrease of vᵀPv that the linear model predicts."""
    bound: float
    """Bound √(dxᵀ (N + λD) dx): without damping, every unknown and every function of the unknowns
    moves by at most this multiple of its own standard deviation."""

    @classmethod
    def of(cls, factor: Factorised, gradient: Array, damped: Array | float = 0.0) -> Step:
        """Solve for a step.

        Args:
            factor: N + λD, factorised.
            gradient: AᵀPv, (n_columns,).
            damped: the diagonal of λD, (n_columns,).
        """
        dx = factor.solve(-gradient[:, None])[:, 0]
        decrease = float(-gradient @ dx + dx @ (damped * dx))
        return cls(dx, decrease, float(np.sqrt(max(float(-gradient @ dx), 0.0))))


@dataclass(frozen=True, eq=False)
class Attempt(Generic[S]):
    """A step and the state after it."""

    step: Step
    """The step."""
    state: S | None
    """The state after the step; None: the step takes cameras past their points."""
    vtpv: float
    """Value of vᵀPv after the step; infinite where it cannot be computed."""
