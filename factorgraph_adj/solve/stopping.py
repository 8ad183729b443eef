"""When an adjustment is at rest, when a step is taken, and when the iteration ends without success.

Two criteria without units decide. Near the minimum, the bound of a step is the distance of every
unknown from the minimum relative to its own σ. The sum vᵀPv tells whether a step descends, unless
its decrease is smaller than the rounding of vᵀPv, 10⁻¹² of its value. Below this limit steps are
taken while they shrink, and the smallest step counts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from .step import Attempt, S


@dataclass(frozen=True)
class StoppingRule:
    """Limits by which steps are judged."""

    worthwhile: float = 1e-3
    """Smallest part of the predicted decrease of vᵀPv that a step must bring to be taken."""
    unchanged: float = 1e-6
    """Growth of vᵀPv, relative to 1 + vᵀPv, up to which the last step leaves vᵀPv unchanged."""
    rounding: float = 1e-12
    """Decrease relative to vᵀPv that its rounding hides: a sum of thousands of squares has rounding
    errors of this size."""
    blind: float = 1e-9
    """Largest change relative to vᵀPv that may still be the rounding of a thousand steps; a larger
    decrease shows that vᵀPv can tell again."""
    still: float = 1.0
    """Step relative to σ from which the unknowns are never at rest, even if vᵀPv cannot tell."""
    fast: float = 0.1
    """Ratio of a step to the last one below which convergence counts as quadratic: after a step b
    that follows a step a, the remaining way is b²/a."""
    close: float = 0.1
    """Step relative to σ below which quadratic convergence is assumed."""
    slow: float = 1e-6
    """Relative decrease of vᵀPv by a step below which the step does not count as progress."""
    patience: int = 20
    """Number of consecutive steps without progress after which the iteration ends. Steps below
    `still`, which are extrapolated, count twice."""
    shrinking: float = 0.8
    """Ratio of a step to the last one below which steps still converge."""
    in_vain: int = 10
    """Number of consecutive steps that do not shrink, where vᵀPv cannot tell, after which the
    iteration ends: such steps are only rounding."""


STOPPING = StoppingRule()
"""The rule that `Stop` follows."""


def no_worse(after: float, before: float) -> bool:
    """Return whether vᵀPv has not grown by more than rounding; false where it is not a number."""
    return after <= before + STOPPING.unchanged * (1.0 + before)


def no_higher(after: float, before: float) -> bool:
    """Return whether vᵀPv has grown by no more than the rounding of many steps."""
    return after <= before * (1.0 + STOPPING.blind)


def cannot_tell(bound: float, decrease: float, vtpv: float) -> bool:
    """Return whether a step is small and the rounding of vᵀPv hides its decrease."""
    return decrease < STOPPING.rounding * max(vtpv, STOPPING.rounding) and bound < STOPPING.still


def at_rest(left: float, tolerance: float) -> str:
    """Return the reason of an adjustment that ended at rest."""
    if left < tolerance:
        return f"at rest: no unknown is further than {tolerance:.0e} of its σ from the minimum"
    return f"at rest: vᵀPv cannot tell any more; the last step was at most {left:.1g} σ"


@dataclass(frozen=True)
class Judgement:
    """The judgement of an attempted step."""

    gain: float
    """Ratio of the decrease of vᵀPv to the predicted decrease."""
    left: float
    """Bound of the remaining way after the step, relative to σ."""
    small: bool
    """Whether the step is below the tolerance, or below the rounding of vᵀPv."""
    accepted: bool
    """Whether the step is taken."""
    done: bool
    """Whether the adjustment is at rest after it."""


@dataclass(frozen=True)
class Rest(Generic[S]):
    """The smallest of the steps whose decrease the rounding of vᵀPv hides."""

    bound: float = np.inf
    """Bound of the smallest step so far, relative to σ."""
    state: S | None = field(default=None, repr=False)
    """The state after the smallest step; none before the first step."""
    in_vain: int = 0
    """Number of consecutive steps that did not shrink."""

    @property
    def exhausted(self) -> bool:
        """Whether steps do not shrink any more."""
        return self.in_vain >= STOPPING.in_vain

    def with_step(self, bound: float, state: S) -> Rest[S]:
        """Return the rest after one more step."""
        shrinks = self.state is None or bound < STOPPING.shrinking * self.bound
        in_vain = 0 if shrinks else self.in_vain + 1
        if self.state is None or bound < self.bound:
            return Rest(bound, state, in_vain)
        return replace(self, in_vain=in_vain)


@dataclass(frozen=True)
class Stop(Generic[S]):
    """Record of the steps so far, which judges the next one; every change returns a new value."""

    tolerance: float
    """Bound on the last step, relative to σ."""
    last: float = np.inf
    """Bound of the last step."""
    plain: bool = True
    """Whether the unknowns moved by the last step alone; false: by an extrapolation of several."""
    slow: int = 0
    """Number of consecutive steps without progress."""
    rest: Rest[S] = field(default_factory=Rest)
    """The smallest of the steps whose decrease the rounding of vᵀPv hides."""

    def judge(self, attempt: Attempt[S], before: float, *, damped: bool) -> Judgement:
        """Judge a step by the state after it.

        Args:
            attempt: the step and the state after it.
            before: vᵀPv before the step.
            damped: whether the step was damped; a damped step may be small far from the minimum.
        """
        bound, decrease, after = attempt.step.bound, attempt.step.decrease, attempt.vtpv
        gain = (before - after) / decrease if decrease > 0 else 0.0
        hidden = cannot_tell(bound, decrease, before) and no_higher(after, before)
        left = self._left(bound)
        small = not damped and (hidden or (left < self.tolerance and no_worse(after, before)))
        accepted = attempt.state is not None and (small or gain > STOPPING.worthwhile)
        return Judgement(gain, left, small, accepted, small and left < self.tolerance)

    def _left(self, bound: float) -> float:
        """Return the remaining way after a step, from the rate of convergence so far."""
        fast = self.plain and np.isfinite(self.last)
        if fast and bound < STOPPING.fast * self.last and bound < STOPPING.close:
            return bound * bound / self.last
        return bound

    def slows_down(self, bound: float) -> bool:
        """Return whether the step shrinks so slowly that an extrapolation may help."""
        return bound > STOPPING.fast * self.last

    def noted(self, attempt: Attempt[S], judged: Judgement, before: float) -> Stop[S]:
        """Return the record with a step that is to be taken."""
        rest = self.rest
        if attempt.vtpv < before - STOPPING.blind * (1.0 + before):  # vᵀPv can tell again
            rest = Rest()
        if judged.small and not judged.done:
            assert attempt.state is not None
            rest = rest.with_step(attempt.step.bound, attempt.state)
        return replace(self, rest=rest)

    def moved(self, bound: float, before: float, after: float, *, plain: bool) -> Stop[S]:
        """Return the record after the unknowns have moved.

        Args:
            bound: bound of the step relative to σ.
            before: vᵀPv before the movement.
            after: vᵀPv after the movement.
            plain: whether the unknowns moved by the step alone.
        """
        no_progress = before - after < STOPPING.slow * before
        extrapolated = bound < STOPPING.still
        more = 2 if extrapolated else 1
        slow = self.slow + more if no_progress and bound > STOPPING.shrinking * self.last else 0
        return replace(self, last=bound, plain=plain, slow=slow)

    @property
    def in_vain(self) -> bool:
        """Whether too many consecutive steps made no progress."""
        return self.slow >= STOPPING.patience

    def near_enough(self, left: float, vtpv: float) -> bool:
        """Return whether an undamped step is below the tolerance, or below the rounding of vᵀPv."""
        return left < self.tolerance or cannot_tell(left, left * left, vtpv)
