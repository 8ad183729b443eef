"""Convergence: acceptance of steps, rate, rounding, and the reasons with which an iteration ends.

Two criteria without units decide. Near the minimum, the bound of a step is the distance of every
unknown from the minimum relative to its own σ. The sum vᵀPv shows whether a step descends, unless
its decrease is smaller than the rounding of vᵀPv, 10⁻¹¹ of its value. Below this limit steps are
taken while they shrink, and the smallest step counts. Below the resolution of the coordinates, the
distance between two neighbouring floating-point numbers, they are taken likewise.

The rate of convergence predicts what a step leaves. A prediction may be wrong: the step before may
have been long in directions that are nearly linear, and this one short in another that is not.
Where the step itself is not below the tolerance, the prediction is verified at the next state, by
the step from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Generic

import numpy as np

from .gauss_newton_steps import Attempt, S


@dataclass(frozen=True)
class StoppingRule:
    """Limits by which steps are judged."""

    worthwhile: float = 1e-3
    """Smallest part of the predicted decrease of vᵀPv that a step must bring to be taken."""
    unchanged: float = 1e-6
    """Growth of vᵀPv, relative to 1 + vᵀPv, up to which the last step leaves vᵀPv unchanged."""
    rounding: float = 1e-11
    """Decrease relative to vᵀPv that its rounding hides: a sum of thousands of squares of residuals
    that are rounded themselves has rounding errors of this size."""
    blind: float = 1e-9
    """Largest change relative to vᵀPv that may still be the rounding of a thousand steps; a larger
    decrease shows that vᵀPv resolves steps again."""
    coarse: float = 1e-4
    """Largest noise relative to vᵀPv, by the last digits of the unknowns, up to which a step may be
    taken whose decrease vᵀPv does not resolve."""
    still: float = 1.0
    """Step relative to σ from which unknowns have never converged, even if vᵀPv does not resolve
    it."""
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
    """Number of consecutive steps that do not shrink, where vᵀPv does not resolve them, after which
    the iteration ends: such steps are only rounding."""
    rounded: int = 5
    """As many steps in vain as one counts that does not shrink below the resolution of the
    coordinates: the next one is as short by chance alone."""
    creeping: float = 0.03
    """Ratio of a step to the last one above which the distance from the minimum is computed with
    second derivatives: a direction in which steps shrink slowly may hide behind the others."""
    recent: int = 10
    """Number of last steps whose shrinking an end without success reports."""
    foreseeable: float = 10.0
    """Ratio of the iterations that are still needed to those that were taken, above which the rate
    of the last steps predicts nothing."""
    divergent: float = 0.9
    """Largest ratio of a step to the last one with which the remaining way b r/(1 − r) is
    estimated."""


STOPPING = StoppingRule()
"""The rule that `StepRecord` follows."""


def no_worse(after: float, before: float) -> bool:
    """Return whether vᵀPv has not grown by more than rounding; false where it is not a number."""
    return after <= before + STOPPING.unchanged * (1.0 + before)


def no_higher(after: float, before: float) -> bool:
    """Return whether vᵀPv has grown by no more than the rounding of many steps."""
    return after <= before * (1.0 + STOPPING.blind)


def is_hidden_by_rounding(bound: float, decrease: float, vtpv: float) -> bool:
    """Return whether a step is small and the rounding of vᵀPv hides its decrease."""
    return decrease < STOPPING.rounding * max(vtpv, STOPPING.rounding) and bound < STOPPING.still


def convergence_reason(left: float, tolerance: float, resolution: float = 0.0) -> str:
    """Return the reason of an adjustment that converged.

    Args:
        left: bound of the distance from the minimum, relative to σ.
        tolerance: the requested bound.
        resolution: bound of a movement by one unit in the last digit of every value.
    """
    if left < tolerance:
        return f"no unknown is further than {tolerance:.0e} of its σ from the minimum"
    rounded = left < resolution
    why = "the coordinates have no more digits" if rounded else "vᵀPv is at its resolution"
    return f"{why}; no unknown is further than {left:.2g} of its σ from the minimum"


def iteration_limit_reason(iterations: int, bounds: Sequence[float], tolerance: float) -> str:
    """Return the reason of an adjustment whose iterations were used up.

    Args:
        iterations: number of iterations.
        bounds: bounds of the steps, relative to σ.
        tolerance: the requested bound.
    """
    last = bounds[-1] if len(bounds) else np.inf
    reason = f"stopped after {iterations} iterations: the last step was {last:.2g} σ"
    n = STOPPING.recent
    if len(bounds) <= n:
        return reason
    ratio = (last / bounds[-1 - n]) ** (1.0 / n)
    if ratio < 1.0:
        more = int(np.ceil(np.log(tolerance / last) / np.log(ratio)))
        if more <= STOPPING.foreseeable * iterations:
            return (
                f"{reason}, and each of the last {n} was {ratio:.3g} times as long as the one "
                f"before: about {max(more, 1)} more iterations are needed (max_iterations)"
            )
    return (
        f"{reason}, and the last {n} steps hardly shrank ({ratio:.3g} times each): more iterations "
        "(max_iterations) alone do not help, better approximate values may"
    )


@dataclass(frozen=True)
class Judgement:
    """The judgement of an attempted step."""

    gain: float
    """Ratio of the decrease of vᵀPv to the predicted decrease."""
    left: float
    """Bound of the remaining way after the step, relative to σ."""
    small: bool
    """Whether the remaining way is below the tolerance, or the step is below rounding."""
    accepted: bool
    """Whether the step is taken."""
    done: bool
    """Whether the adjustment has converged after it."""
    expected: bool = False
    """Whether it is expected to have converged after it; the step from there verifies it."""
    arrived: bool = False
    """Whether the adjustment had converged before the step, which is not taken."""


@dataclass(frozen=True)
class SmallestStep(Generic[S]):
    """The smallest of the steps whose decrease rounding hides."""

    bound: float = np.inf
    """Bound of the smallest step so far, relative to σ."""
    state: S | None = field(default=None, repr=False)
    """The state from which the smallest step leads; None before the first step."""
    in_vain: int = 0
    """Number of consecutive steps that did not shrink."""

    @property
    def exhausted(self) -> bool:
        """Whether steps do not shrink any more."""
        return self.in_vain >= STOPPING.in_vain

    def with_step(self, bound: float, state: S, resolution: float) -> SmallestStep[S]:
        """Return the rest after one more step.

        Args:
            bound: bound of the step.
            state: the state from which it leads.
            resolution: bound of a movement by one unit in the last digit of every value.
        """
        shrinks = self.state is None or bound < STOPPING.shrinking * self.bound
        more = STOPPING.rounded if bound < resolution else 1
        in_vain = 0 if shrinks else self.in_vain + more
        if self.state is None or bound < self.bound:
            return SmallestStep(bound, state, in_vain)
        return replace(self, in_vain=in_vain)


@dataclass(frozen=True)
class StepRecord(Generic[S]):
    """Record of the steps so far, which judges the next one; every change returns a new value."""

    tolerance: float
    """Bound on the last step, relative to σ."""
    last: float = np.inf
    """Bound of the last step."""
    plain: bool = True
    """Whether the unknowns moved by the last step alone; false: by an extrapolation of several."""
    slow: int = 0
    """Number of consecutive steps without progress."""
    rest: SmallestStep[S] = field(default_factory=SmallestStep)
    """The smallest of the steps whose decrease rounding hides."""
    resolution: float = 0.0
    """Bound of a movement by one unit in the last digit of every value, relative to σ."""
    expecting: bool = False
    """Whether the last step is expected to have converged."""
    creeping: bool = False
    """Whether a step near the minimum was not much shorter than the one before it."""
    trusting: bool = False
    """Whether the expectation ends the iteration, because the next stage verifies it anyway."""

    def judge(self, attempt: Attempt[S], before: float, *, damped: bool) -> Judgement:
        """Judge a step by the state after it.

        Args:
            attempt: the step and the state after it.
            before: vᵀPv before the step.
            damped: whether the step was damped; a damped step may be small far from the minimum.
        """
        bound, decrease, after = attempt.step.bound, attempt.step.decrease, attempt.vtpv
        if self.arrived(bound, damped=damped):
            return Judgement(0.0, self.ahead(bound), True, True, True, arrived=True)
        gain = (before - after) / decrease if decrease > 0 else 0.0
        blind = is_hidden_by_rounding(bound, decrease, before) or bound < self.resolution
        hidden = blind and no_higher(after, before)
        # Units δ in the last digits of the values change vᵀPv by 2 vᵀPAδ ≤ 2 √vᵀPv √δᵀNδ.
        noise = 2.0 * np.sqrt(before) * self.resolution
        lost = decrease < noise < STOPPING.coarse * before and after <= before + noise
        if lost and gain <= STOPPING.worthwhile and bound < STOPPING.still:
            hidden = True
        left = self._left(bound)
        near = not damped and left < self.tolerance
        at_end = near and no_worse(after, before)
        small = at_end or (not damped and hidden)
        accepted = attempt.state is not None and (small or gain > STOPPING.worthwhile)
        done = at_end and (bound < self.tolerance or self.trusting)
        return Judgement(gain, left, small, accepted, done, at_end and not done)

    def _left(self, bound: float) -> float:
        """Return the remaining way after a step, from the rate r of convergence so far.

        It is b r where r decreases in proportion to the step, and b r/(1 − r) where it stays.
        """
        if not self.plain or not np.isfinite(self.last) or not self.last:
            return bound
        rate = min(bound / self.last, STOPPING.divergent)
        if rate < STOPPING.fast:
            return bound * rate if bound < STOPPING.close else bound
        return bound * rate / (1.0 - rate)

    def arrived(self, bound: float, *, damped: bool) -> bool:
        """Return whether a step shows that the state from which it leads has converged.

        Where convergence of a state is expected, the iteration ends there without the step; so it
        does where the step is below the resolution of the coordinates.
        """
        there = self.expecting or self.resolution > self.tolerance
        near = bound if self.resolution > self.tolerance else self.ahead(bound)
        return there and not damped and near < self.tolerance

    def ahead(self, bound: float) -> float:
        """Return the distance of a state from the minimum, from the bound of the step from it."""
        rate = bound / self.last if self.last else 0.0
        return bound / (1.0 - min(rate, STOPPING.divergent))

    def slows_down(self, bound: float) -> bool:
        """Return whether the step shrinks so slowly that an extrapolation may help."""
        return bound > STOPPING.fast * self.last

    def noted(
        self, attempt: Attempt[S], judged: Judgement, before: float, state: S
    ) -> StepRecord[S]:
        """Return the record with a step that is to be taken from a state."""
        rest = self.rest
        if attempt.vtpv < before - STOPPING.blind * (1.0 + before):  # vᵀPv resolves steps again
            rest = SmallestStep()
        if judged.small and not judged.done:
            rest = rest.with_step(attempt.step.bound, state, self.resolution)
        return replace(self, rest=rest, expecting=judged.expected)

    def moved(self, bound: float, before: float, after: float, *, plain: bool) -> StepRecord[S]:
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
        resolved = self.resolution < bound < STOPPING.still
        creeps = resolved and (not plain or bound > STOPPING.creeping * self.last)
        creeping = self.creeping or creeps
        return replace(self, last=bound, plain=plain, slow=slow, creeping=creeping)

    @property
    def in_vain(self) -> bool:
        """Whether too many consecutive steps made no progress."""
        return self.slow >= STOPPING.patience

    def near_enough(self, left: float, vtpv: float) -> bool:
        """Return whether an undamped step is below the tolerance, or below rounding."""
        return left < max(self.tolerance, self.resolution) or is_hidden_by_rounding(
            left, left * left, vtpv
        )
