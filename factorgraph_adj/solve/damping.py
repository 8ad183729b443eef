"""Damping of Gauss-Newton steps: how much of the diagonal of N is added to N, and when.

Steps are tried without damping, λ = 0. Where a step fails, λ D with D = diag(N) makes the next
step shorter and turns it towards the steepest descent (Levenberg 1944, Marquardt 1963). λ follows
Nielsen's rule (Nielsen 1999): λ grows faster and faster while steps fail, and shrinks smoothly
with the part of the predicted decrease that a step brought.
"""

from __future__ import annotations

from dataclasses import dataclass


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
