"""Iteration for variance components: steps of Helmert and Newton, and groups left out.

Near the greatest likelihood a step solves Newton's equations by conjugate gradients, for a matrix
that is known by its products (Hestenes & Stiefel 1952).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from ..statistical_tests import chi2_upper_quantile
from ..types import Array, Mask
from .observation_groups import GroupRedundancy

MIN_GROUP_REDUNDANCY = 1.0
"""Redundancy of a group below which its a-priori standard deviations are kept."""
ROUNDING_REDUNDANCY = 1e-9
"""Redundancy of a group up to which the redundancy is only rounding error."""
MIN_RESIDUAL_PROBABILITY = 1e-3
"""Probability of the residuals of a group below which its weights are judged too large."""
MIN_SIGMA_FACTOR = 1e-4
"""Smallest factor on the a-priori σ of a group; a group that reaches it is driven to zero."""
SINGULAR_INFORMATION_EIGENVALUE = 1e-6
"""Eigenvalue up to which S, scaled to a diagonal of ones, counts as singular."""
MAX_VARIANCE_FACTOR = 4.0
"""Largest factor by which one step of Helmert's equations changes a variance. A larger quotient q/r
of Förstner, which is never negative, replaces this limit for an increase."""
MAX_NEWTON_CHANGE = 0.5
"""Largest relative change of the variances for which the likelihood is treated as a parabola."""
MIN_NEWTON_CURVATURE = 0.25
"""Smallest curvature of the likelihood, relative to its expectation, with which a Newton step is
taken."""
NEWTON_RESIDUAL_TOLERANCE = 1e-3
"""Residual of the equations of a Newton step, relative to their right side, at which they count as
solved: the next step corrects the rest."""
MAX_REVERSE_SLOPE = 0.5
"""Reverse slope of the likelihood at the end of a step, relative to the slope at its beginning,
above which the next steps are halved."""
ComponentState: TypeAlias = Literal[
    "estimated", "uncertain", "not separable", "driven to zero", "held"
]
"""State of a component; components "driven to zero" or "held" are not estimated."""


def conjugate_gradients(
    times: Callable[[Array], Array],
    preconditioner: Array,
    right: Array,
    *,
    relative: float,
    least: float,
) -> Array | None:
    """Solve M x = b in at most k steps; return x (k,).

    Args:
        times: function that returns M p (k,) for p (k,), with M symmetric.
        preconditioner: an approximation C of M⁻¹, symmetric and positive semidefinite, (k, k); the
            solution is in its range.
        right: b, (k,).
        relative: length √(sᵀCs) of the residual s = b − M x, relative to that of b, at which the
            equations count as solved.
        least: smallest curvature pᵀMp along a direction p, relative to its expectation pᵀC⁻¹p.

    Returns:
        The solution; none, if the curvature along a direction is smaller.
    """
    x, left = np.zeros_like(right), right
    along, expected = preconditioner @ left, left
    first = square = float(left @ along)
    for _ in range(len(right)):
        if square <= relative**2 * first:
            break
        turned = times(along)
        curvature = float(along @ turned)
        if curvature < least * float(along @ expected):
            return None
        x = x + square / curvature * along
        left = left - square / curvature * turned
        ahead = preconditioner @ left
        before, square = square, float(left @ ahead)
        along, expected = ahead + square / before * along, left + square / before * expected
    return x


class VarianceStep(NamedTuple):
    """A change of the variances of all groups."""

    change: Array
    """Δ, relative to the variances, (k,)."""
    newton: bool
    """Whether Δ is a Newton step; false: by Helmert's equations."""
    bound: float
    """Bound √(ΔᵀSΔ/2) on the change of any component, relative to its own σ: Cauchy-Schwarz for
    cov(ln f²) = 2 S⁻¹."""


class ComponentIteration:
    """State of the iteration for the variance components of k groups."""

    def __init__(self, k: int) -> None:
        """Start with the a-priori variances."""
        self.logarithms = np.zeros(k)
        """ln f² (k,)."""
        self.estimated = np.ones(k, dtype=bool)
        """Mask of the groups that are estimated, (k,)."""
        self.states: list[ComponentState] = ["estimated"] * k
        self.notes = [""] * k
        self._back = np.zeros(k, dtype=bool)
        self._share = 1.0
        self._way, self._slope = np.zeros(k), 0.0

    def judge(self, at: GroupRedundancy) -> bool:
        """Stop the estimation of groups with too little redundancy or too small a variance.

        The redundancy of a group goes to zero with its variance, unless other observations repeat
        the group's; a variance with r < 1 cannot be distinguished from zero.

        Returns:
            Whether the weights of any group change.
        """
        small = self.logarithms <= 2.0 * np.log(MIN_SIGMA_FACTOR)
        poor = (at.redundancy < MIN_GROUP_REDUNDANCY) & ~self._suppressed(at)
        before = self.logarithms.copy()
        for g in np.flatnonzero(self.estimated & (poor | small)).tolist():
            self.estimated[g] = False
            self._slope = 0.0
            r, factor = at.redundancy[g], np.exp(self.logarithms[g] / 2.0)
            if small[g] or (factor < 1.0 and at.squares[g] < r):
                self.states[g] = "driven to zero"
                self.notes[g] = (
                    f"its residuals are too small for any σ; stopped at {factor:.3g} of the "
                    f"a-priori one, with a redundancy of {r:.2g}: not distinguishable from zero"
                )
            else:
                self._back[g] |= self.logarithms[g] != 0.0
                self.logarithms[g] = 0.0
                self.states[g] = "held"
                self.notes[g] = (
                    f"its redundancy of {r:.2g} is less than {MIN_GROUP_REDUNDANCY:g}: other "
                    "observations hardly check it; a-priori σ kept"
                )
        return bool(np.any(self.logarithms != before))

    def release(self, at: GroupRedundancy) -> bool:
        """Resume, once for each group, the estimation of groups that now have enough redundancy.

        Returns:
            Whether any group is resumed.
        """
        held = np.array([state == "held" for state in self.states])
        back = (at.redundancy >= MIN_GROUP_REDUNDANCY) & (held | (at.squares > at.redundancy))
        back = ~self.estimated & ~self._back & (back | (held & self._suppressed(at)))
        self._back |= back
        self.estimated |= back
        for g in np.flatnonzero(back).tolist():
            self.states[g], self.notes[g] = "estimated", ""
            self._slope = 0.0
        return bool(back.any())

    def _suppressed(self, at: GroupRedundancy) -> Mask:
        """Return which groups have little redundancy because their own weights are too large, (k,).

        Such weights force the errors of a group upon other observations. The small rest in the
        group's own residuals makes q/r too large; with right weights q/r is distributed as χ²_m/m
        with m = r²/S_gg.
        """
        r = np.maximum(at.redundancy, np.finfo(float).tiny)
        m = np.maximum(r * r / np.maximum(np.diag(at.information), np.finfo(float).tiny), 1.0)
        return np.asarray(
            (r > ROUNDING_REDUNDANCY)
            & (at.squares / r > chi2_upper_quantile(MIN_RESIDUAL_PROBABILITY, m) / m)
        )

    def proposal(self, at: GroupRedundancy) -> VarianceStep:
        """Return the next change of the variances: by Newton near the end, else by Helmert."""
        change, newton = self._newton(at), True
        if change is None:
            change, newton = self._helmert(at), False
        bound = np.sqrt(max(float(change @ at.information @ change), 0.0) / 2.0)
        return VarianceStep(change, newton, float(bound))

    def step(self, at: GroupRedundancy, proposal: VarianceStep) -> None:
        """Move the components as proposed, within limits."""
        misfit = self._misfit(at)
        if self._slope > 0:
            # q − r is the slope of twice the likelihood: it shows whether a step went too far.
            ahead = float(misfit @ self._way)
            if ahead < -MAX_REVERSE_SLOPE * self._slope:
                self._share /= 2.0
            elif ahead > 0:
                self._share = min(1.0, 2.0 * self._share)
        if proposal.newton:
            self._way = np.log1p(proposal.change)
        else:
            quotient = at.squares / np.maximum(at.redundancy, ROUNDING_REDUNDANCY)
            most = np.maximum(MAX_VARIANCE_FACTOR, quotient)
            f = np.clip(1.0 + proposal.change, 1.0 / MAX_VARIANCE_FACTOR, most)
            self._way = self._share * np.log(f)
        self._slope = float(misfit @ self._way)
        self.logarithms += self._way

    def _misfit(self, at: GroupRedundancy) -> Array:
        """Return q − r, (k,); zero for groups that are not estimated."""
        return np.where(self.estimated, at.squares - at.redundancy, 0.0)

    def _helmert(self, at: GroupRedundancy) -> Array:
        """Solve S f² = q for f² = 1 + Δ relative to the current weights: S Δ = q − r, Δ (k,)."""
        cofactors, _ = self.cofactors(at)
        return np.asarray(cofactors @ self._misfit(at))

    def _newton(self, at: GroupRedundancy) -> Array | None:
        """Return Δ (k,) of (2B − S + diag(r − q)) Δ = q − r near the greatest likelihood.

        As long as S has not been probed, B with residuals scaled to q = r replaces S in Helmert's
        equations, for E(B) = S. None far from the maximum, or with a curvature too small for a
        Newton step; Helmert's equations use the expected curvature instead.
        """
        cofactors, lost = self.cofactors(at)
        if (
            not self.estimated.any()
            or lost.any()
            or np.abs(self._helmert(at)).max() > MAX_NEWTON_CHANGE
        ):
            return None
        misfit = self._misfit(at)
        if at.unprobed:
            scale = np.sqrt(at.redundancy / np.maximum(at.squares, np.finfo(float).tiny))

            def curved(x: Array) -> Array:
                return np.where(self.estimated, scale * at.average_times(scale * x), 0.0)

            out = conjugate_gradients(
                curved,
                cofactors,
                misfit,
                relative=NEWTON_RESIDUAL_TOLERANCE,
                least=SINGULAR_INFORMATION_EIGENVALUE,
            )
        else:

            def curved(x: Array) -> Array:
                product = 2.0 * at.average_times(x) - at.information @ x - misfit * x
                return np.where(self.estimated, product, 0.0)

            out = conjugate_gradients(
                curved,
                cofactors,
                misfit,
                relative=NEWTON_RESIDUAL_TOLERANCE,
                least=MIN_NEWTON_CURVATURE,
            )
        return None if out is None or np.abs(out).max() > MAX_NEWTON_CHANGE else out

    def cofactors(self, at: GroupRedundancy) -> tuple[Array, Mask]:
        """Return S⁻¹ of the estimated groups, zero elsewhere, (k, k), and a mask (k,).

        The mask marks groups in combinations that the residuals do not determine because S is
        singular. Such combinations keep their value.
        """
        g = np.flatnonzero(self.estimated)
        out, lost = np.zeros_like(at.information), np.zeros(len(self.estimated), dtype=bool)
        if not len(g):
            return out, lost
        s = at.information[np.ix_(g, g)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(s), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(s * np.outer(scale, scale))
        good = values > SINGULAR_INFORMATION_EIGENVALUE
        lost[g] = np.square(vectors[:, ~good]).sum(axis=1) > SINGULAR_INFORMATION_EIGENVALUE
        root = vectors[:, good] / np.sqrt(values[good]) * scale[:, None]
        out[np.ix_(g, g)] = root @ root.T
        return out, lost
