"""When an adjustment is at rest, when a step is taken, and when going on is in vain.

Two criteria, free of units, decide. Near the minimum the bound of a step says how far every unknown
is from it relative to its own σ. vᵀPv says whether a step leads downhill, as long as it can: it is
a sum whose rounding hides decreases below 10⁻¹² of it. From there on steps are taken while they
shrink, and the smallest one counts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from ..graph.variables import State
from .step import Attempt


@dataclass(frozen=True)
class StoppingRule:
    """What counts as small, as slow and as nothing."""

    worthwhile: float = 1e-3
    """Part of the predicted decrease of vᵀPv that a step must bring to be taken."""
    unchanged: float = 1e-6
    """Part of 1 + vᵀPv that is no change of it: it may be more by that after the last step."""
    rounding: float = 1e-12
    """Decrease relative to vᵀPv that vᵀPv cannot tell any more: a sum of thousands of squares has
    rounding errors of that size."""
    blind: float = 1e-9
    """Change relative to vᵀPv that may still be rounding of a thousand such decreases: less does
    not show that vᵀPv can tell after all."""
    still: float = 1.0
    """Step relative to σ from which on nothing is at rest, whether vᵀPv can tell or not."""
    fast: float = 0.1
    """Ratio of a step to the last one below which convergence is fast: it is quadratic there, and
    what is left after a step b that follows one of a is b²/a."""
    close: float = 0.1
    """Step relative to σ below which fast convergence is believed."""
    slow: float = 1e-6
    """Relative decrease of vᵀPv by a step below which the step does not count as progress."""
    patience: int = 20
    """Number of steps in a row without progress after which the iteration ends."""
    shrinking: float = 0.8
    """Ratio of a step to the last one below which steps still converge."""
    in_vain: int = 10
    """Number of steps in a row, where vᵀPv cannot tell, that do not shrink before the iteration
    ends: rounding is all that is left of them."""


STOPPING = StoppingRule()
"""The rule that `Stop` follows."""


def no_worse(after: float, before: float) -> bool:
    """Return whether vᵀPv has not grown by more than rounding; false where it is not a number."""
    return after <= before + STOPPING.unchanged * (1.0 + before)


def no_higher(after: float, before: float) -> bool:
    """Return whether vᵀPv has grown by no more than it may where it cannot tell any more."""
    return after <= before * (1.0 + STOPPING.blind)


def cannot_tell(bound: float, decrease: float, vtpv: float) -> bool:
    """Return whether a step and its decrease are too small to be seen in vᵀPv."""
    return decrease < STOPPING.rounding * max(vtpv, STOPPING.rounding) and bound < STOPPING.still


def at_rest(left: float, tolerance: float) -> str:
    """Say why an adjustment that is at rest ended."""
    if left < tolerance:
        return f"at rest: no unknown is further than {tolerance:.0e} of its σ from the minimum"
    return f"at rest: vᵀPv cannot tell any more; the last step was at most {left:.1g} σ"


@dataclass(frozen=True)
class Judgement:
    """What a attempt is worth."""

    gain: float
    """Part of the predicted decrease of vᵀPv that came true."""
    left: float
    """Bound of what is left of the way after the step, relative to σ."""
    small: bool
    """Whether the step is one of the last: as small as asked, or as vᵀPv can tell."""
    accepted: bool
    """Whether the step is taken."""
    done: bool
    """Whether the adjustment is at rest after it."""


@dataclass(frozen=True)
class Rest:
    """The smallest step where vᵀPv cannot tell any more: steps are taken while they shrink."""

    bound: float = np.inf
    """Bound of the smallest step so far, relative to σ."""
    state: State | None = field(default=None, repr=False)
    """The state after it; none before the first."""
    in_vain: int = 0
    """Number of steps since that did not shrink."""

    @property
    def exhausted(self) -> bool:
        """Whether steps do not shrink any more."""
        return self.in_vain >= STOPPING.in_vain

    def with_step(self, bound: float, state: State) -> Rest:
        """Return the rest after one more step."""
        shrinks = self.state is None or bound < STOPPING.shrinking * self.bound
        in_vain = 0 if shrinks else self.in_vain + 1
        if self.state is None or bound < self.bound:
            return Rest(bound, state, in_vain)
        return replace(self, in_vain=in_vain)


@dataclass(frozen=True)
class Stop:
    """What the steps so far say of the next one; every change is another value."""

    tolerance: float
    """Bound on the last step, relative to σ."""
    last: float = np.inf
    """Bound of the last step."""
    plain: bool = True
    """Whether the unknowns moved by that step, and not by an extrapolation of several."""
    slow: int = 0
    """Number of steps in a row without progress."""
    rest: Rest = field(default_factory=Rest)
    """The steps where vᵀPv cannot tell any more."""

    def judge(self, attempt: Attempt, before: float, *, damped: bool) -> Judgement:
        """Judge a step by where it leads.

        Args:
            attempt: the step.
            before: vᵀPv before it.
            damped: whether it was damped: then it may be small without anything being at rest.
        """
        bound, decrease, after = attempt.step.bound, attempt.step.decrease, attempt.vtpv
        gain = (before - after) / decrease if decrease > 0 else 0.0
        hidden = cannot_tell(bound, decrease, before) and no_higher(after, before)
        left = self._left(bound)
        small = not damped and (hidden or (left < self.tolerance and no_worse(after, before)))
        accepted = attempt.state is not None and (small or gain > STOPPING.worthwhile)
        return Judgement(gain, left, small, accepted, small and left < self.tolerance)

    def _left(self, bound: float) -> float:
        """Return what is left after a step, by the rate of convergence so far."""
        fast = self.plain and np.isfinite(self.last)
        if fast and bound < STOPPING.fast * self.last and bound < STOPPING.close:
            return bound * bound / self.last
        return bound

    def slows_down(self, bound: float) -> bool:
        """Return whether a step shrinks so slowly that extrapolating pays."""
        return bound > STOPPING.fast * self.last

    def noted(self, attempt: Attempt, judged: Judgement, before: float) -> Stop:
        """Return the same once a step is to be taken."""
        rest = self.rest
        if attempt.vtpv < before - STOPPING.blind * (1.0 + before):  # vᵀPv could tell, after all
            rest = Rest()
        if judged.small and not judged.done:
            assert attempt.state is not None
            rest = rest.with_step(attempt.step.bound, attempt.state)
        return replace(self, rest=rest)

    def moved(self, bound: float, before: float, after: float, *, plain: bool) -> Stop:
        """Return the same after the unknowns were moved.

        Args:
            bound: of the step.
            before: vᵀPv before it.
            after: vᵀPv where the unknowns are now.
            plain: whether they moved by the step alone.
        """
        no_progress = before - after < STOPPING.slow * before
        slow = self.slow + 1 if no_progress and bound > STOPPING.shrinking * self.last else 0
        return replace(self, last=bound, plain=plain, slow=slow)

    @property
    def in_vain(self) -> bool:
        """Whether the iteration gets nowhere."""
        return self.slow >= STOPPING.patience

    def near_enough(self, left: float, vtpv: float) -> bool:
        """Return whether an undamped step from here is as small as asked, or as vᵀPv can tell."""
        return left < self.tolerance or cannot_tell(left, left * left, vtpv)
