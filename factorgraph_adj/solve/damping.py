"""Damping of Gauss-Newton steps: how much of the diagonal of N is added to it, and when.

Steps are tried without damping, λ = 0. Where one fails, λ D with D = diag(N) makes the next one
shorter and turns it towards the steepest descent (Levenberg 1944, Marquardt 1963), with Nielsen's
rule for λ (Nielsen 1999): it grows faster and faster while steps fail, and shrinks smoothly by
what part of the predicted decrease a step brought.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DampingRule:
    """Between which bounds damping moves, and how fast."""

    first: float = 1e-4
    """Damping of the first step that is tried after an undamped one failed."""
    least: float = 1e-12
    """Damping below which a step is as good as undamped: N itself has errors of this size."""
    most: float = 1e12
    """Damping at which steps are smaller than any rounding: there is no way on."""
    near: float = 1e-4
    """Step relative to σ after which the next one is tried without damping: so near the minimum
    vᵀPv is a parabola."""
    growth: float = 2.0
    """Factor on the damping after a first failure; every further one doubles the factor."""
    relief: float = 0.1
    """Smallest factor on the damping after a step that brought all that was predicted."""


DAMPING = DampingRule()
"""The rule that `Damping` follows."""


@dataclass(frozen=True)
class Damping:
    """How far the next step is damped; every change is another value."""

    value: float = 0.0
    """λ, the share of the diagonal of N that is added; zero: none."""
    resume: float = DAMPING.first
    """λ of the next step if an undamped one fails."""
    growth: float = DAMPING.growth
    """Factor on λ if a damped one fails."""

    @property
    def hopeless(self) -> bool:
        """Whether no damping leads any further."""
        return self.value > DAMPING.most

    def harder(self) -> Damping:
        """Return the damping after a step that failed."""
        value = self.resume if self.value == 0.0 else self.value * self.growth
        return Damping(value, self.resume, 2.0 * self.growth)

    def relaxed(self, gain: float, bound: float) -> Damping:
        """Return the damping after a step that was taken.

        Args:
            gain: part of the predicted decrease of vᵀPv that it brought.
            bound: of the step, relative to σ.
        """
        value = self.value * max(DAMPING.relief, 1.0 - (2.0 * min(gain, 1.0) - 1.0) ** 3)
        if value < DAMPING.least or bound < DAMPING.near:
            return Damping(0.0, max(value, DAMPING.least))
        return Damping(value, self.resume)
