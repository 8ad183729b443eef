"""The way to variance components: the steps, and which groups have to be left out of them."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np

from ..types import Array, Mask
from .distributions import chi2_upper_quantile
from .group_redundancy import GroupRedundancy

State: TypeAlias = Literal["estimated", "uncertain", "not separable", "driven to zero", "held"]
"""How a component was found; the last two are not estimates."""

LEAST_REDUNDANCY = 1.0
"""Redundancy of a group below which its a-priori standard deviations are kept."""
VANISHED = 1e-9
"""Redundancy of a group that is nothing but rounding."""
UNLIKELY = 1e-3
"""Probability of residuals by chance, below which weights are held for too great."""
SMALLEST = 1e-4
"""Factor of σ at which residuals are too small for any."""
SINGULAR = 1e-6
"""Eigenvalue of S, scaled to a diagonal of ones, that counts as zero."""
STRIDE = 4.0
"""Most that a variance is changed by in one step of Helmert's equations, unless Förstner's quotient
q/r, which is never negative, asks for more."""
NEAR = 0.5
"""Relative change of variances within which the likelihood is taken for a parabola."""
CURVED = 0.25
"""Curvature of the likelihood, relative to its expectation, from which on Newton is trusted."""
TOO_FAR = 0.5
"""Slope of the likelihood at the end of a step, back towards its beginning and relative to the
slope there, from which on the next steps are shortened."""


class ComponentSearch:
    """Variance components of k groups on the way."""

    def __init__(self, k: int) -> None:
        """Start with the a-priori variances."""
        self.logarithms = np.zeros(k)
        """ln f² (k,)."""
        self.estimated = np.ones(k, dtype=bool)
        """Which groups are estimated."""
        self.states: list[State] = ["estimated"] * k
        self.notes = [""] * k
        self._back = np.zeros(k, dtype=bool)
        self._share = 1.0
        self._way, self._slope = np.zeros(k), 0.0

    def judge(self, at: GroupRedundancy) -> bool:
        """Stop groups whose residuals can say no more; return whether any weights change by that.

        As the variance of a group goes to zero so does its redundancy, where others do not
        repeat what it observes; with r < 1 it is not told from zero any more.
        """
        small = self.logarithms <= 2.0 * np.log(SMALLEST)
        poor = (at.redundancy < LEAST_REDUNDANCY) & ~self._suppressed(at)
        before = self.logarithms.copy()
        for g in np.flatnonzero(self.estimated & (poor | small)).tolist():
            self.estimated[g] = False
            self._slope = 0.0
            r, factor = at.redundancy[g], np.exp(self.logarithms[g] / 2.0)
            if small[g] or (factor < 1.0 and at.squares[g] < r):
                self.states[g] = "driven to zero"
                self.notes[g] = (
                    f"its residuals are too small for any σ; stopped at {factor:.3g} of the "
                    f"a-priori one, with a redundancy of {r:.2g}: not to be told from zero"
                )
            else:
                self._back[g] |= self.logarithms[g] != 0.0
                self.logarithms[g] = 0.0
                self.states[g] = "held"
                self.notes[g] = (
                    f"its redundancy of {r:.2g} is less than {LEAST_REDUNDANCY:g}: other "
                    "observations hardly check it; a-priori σ kept"
                )
        return bool(np.any(self.logarithms != before))

    def release(self, at: GroupRedundancy) -> bool:
        """Estimate groups after all, once, that the others' weights now let be estimated.

        Returns whether there are any.
        """
        held = np.array([state == "held" for state in self.states])
        back = (at.redundancy >= LEAST_REDUNDANCY) & (held | (at.squares > at.redundancy))
        back = ~self.estimated & ~self._back & (back | (held & self._suppressed(at)))
        self._back |= back
        self.estimated |= back
        for g in np.flatnonzero(back).tolist():
            self.states[g], self.notes[g] = "estimated", ""
            self._slope = 0.0
        return bool(back.any())

    def _suppressed(self, at: GroupRedundancy) -> Mask:
        """Return which groups have little redundancy by their own far too great weights, (k,).

        Errors that such weights force upon others leave a little in the group's own residuals:
        q/r, by nature a χ²_m/m with m = r²/S_gg, is too large for its weight.
        """
        r = np.maximum(at.redundancy, np.finfo(float).tiny)
        m = np.maximum(r * r / np.maximum(np.diag(at.information), np.finfo(float).tiny), 1.0)
        return np.asarray((r > VANISHED) & (at.squares / r > chi2_upper_quantile(UNLIKELY, m) / m))

    def bound(self, at: GroupRedundancy) -> float:
        """Return a bound on the change that is left of any component, relative to its own σ.

        √(ΔᵀSΔ/2) with the change Δ of ln f²: Cauchy-Schwarz, for cov(ln f²) = 2 S⁻¹.
        """
        change = self._newton(at)
        if change is None:
            change = self._helmert(at)
        return float(np.sqrt(max(float(change @ at.information @ change), 0.0) / 2.0))

    def step(self, at: GroupRedundancy) -> None:
        """Move the components: by Newton near the end, else by Helmert, within limits."""
        misfit = self._misfit(at)
        if self._slope > 0:
            # q − r is the slope of twice the likelihood: it tells whether a step went too far.
            ahead = float(misfit @ self._way)
            if ahead < -TOO_FAR * self._slope:
                self._share /= 2.0
            elif ahead > 0:
                self._share = min(1.0, 2.0 * self._share)
        change = self._newton(at)
        if change is not None:
            self._way = np.log1p(change)
        else:
            quotient = at.squares / np.maximum(at.redundancy, VANISHED)
            most = np.maximum(STRIDE, quotient)
            f = np.clip(1.0 + self._helmert(at), 1.0 / STRIDE, most)
            self._way = self._share * np.log(f)
        self._slope = float(misfit @ self._way)
        self.logarithms += self._way

    def _misfit(self, at: GroupRedundancy) -> Array:
        """Return q − r, zero for what is not estimated, (k,)."""
        return np.where(self.estimated, at.squares - at.redundancy, 0.0)

    def _helmert(self, at: GroupRedundancy) -> Array:
        """Return Δ (k,) of S f² = q relative to the weights of now: S Δ = q − r, f² = 1 + Δ."""
        cofactors, _ = self.cofactors(at)
        return np.asarray(cofactors @ self._misfit(at))

    def _newton(self, at: GroupRedundancy) -> Array | None:
        """Return Δ (k,) of (2B − S + diag(r − q)) Δ = q − r near the greatest likelihood.

        None where that is far, or not seen by the curvature: Helmert's expects one.
        """
        g = np.flatnonzero(self.estimated)
        cofactors, lost = self.cofactors(at)
        if not len(g) or lost.any() or np.abs(self._helmert(at)).max() > NEAR:
            return None
        misfit = self._misfit(at)
        curvature = 2.0 * at.average - at.information - np.diag(misfit)
        root = np.linalg.cholesky(cofactors[np.ix_(g, g)])
        relative = root.T @ curvature[np.ix_(g, g)] @ root
        if np.linalg.eigvalsh(relative)[0] < CURVED:
            return None
        out = np.zeros(len(misfit))
        out[g] = root @ np.linalg.solve(relative, root.T @ misfit[g])
        return out if np.abs(out).max() < NEAR else None

    def cofactors(self, at: GroupRedundancy) -> tuple[Array, Mask]:
        """Return S⁻¹ of what is estimated, zero elsewhere, (k, k), and what S leaves open, (k,).

        Where S is singular, combinations that the residuals do not show stay as they are.
        """
        g = np.flatnonzero(self.estimated)
        out, lost = np.zeros_like(at.information), np.zeros(len(self.estimated), dtype=bool)
        if not len(g):
            return out, lost
        s = at.information[np.ix_(g, g)]
        scale = 1.0 / np.sqrt(np.maximum(np.diag(s), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(s * np.outer(scale, scale))
        good = values > SINGULAR
        lost[g] = np.square(vectors[:, ~good]).sum(axis=1) > SINGULAR
        root = vectors[:, good] / np.sqrt(values[good]) * scale[:, None]
        out[np.ix_(g, g)] = root @ root.T
        return out, lost
