"""Robust estimation: M-estimators by iterative reweighting.

Each observation gets a factor γ ≤ 1 on its weight, which depends on how badly it fits; the
network is adjusted with these equivalent weights, and so on until they rest. What counts is

    t = v / (σ √r)

with the redundancy number r of the network as it is, all at full weight: an error that leverage
hides in a small residual counts for what it is. (With r of the reweighted adjustment, which
rises for the one and falls for the others, weights chase one another: in simulations with 20 %
gross errors they did not come to rest.) One γ for all components of an observation, from the
largest |t|/s; s is a scale.

    Huber     γ = 1 up to k, k/t beyond                             k = 1.5   (Huber 1964)
    Danish    γ = 1 up to k, exp(1 − (t/k)²) beyond                 k = 2     (Krarup et al. 1980)
    IGG III   γ = 1 up to k, (k/t) ((m − t)/(m − k))², 0 from m     k = 1.5, m = 6  (Yang 1994)
    Tukey     γ = (1 − (t/k)²)², 0 from k                           k = 4.685 (Beaton & Tukey 1974)

Correlated observations keep their correlation (bifactor equivalent weights, Yang et al. 2002).
All start with Huber's criterion, which is convex, at a small scale, where it is nearly the sum
of |t|: the others have many minima.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..errors import InputError
from ..network.network import DatumChoice, Network
from ..shown import Shown
from ..solve.batch import adjust
from ..solve.solution import Solution
from ..solve.start import Start
from ..types import Array
from .reliability import Reliability, reliability

Estimator = Literal["huber", "danish", "igg3", "tukey"]
ESTIMATORS: tuple[Estimator, ...] = ("huber", "danish", "igg3", "tukey")

LEAST_WEIGHT = 1e-6
"""Smallest γ: nothing becomes undetermined, and an error of 1000 σ pulls like one of 0.001 σ."""
OF_THE_MEDIAN = 1.4826
"""σ of a normal distribution / its median absolute deviation."""
LEAST_REDUNDANCY = 0.01
"""Redundancy number from which down residuals are not enlarged any more: γ of the others changes
what little they are."""
LOOSE = 0.05
"""Change of γ at which Huber's criterion has led near enough to go on."""
NEARLY_ABSOLUTE = 0.1
"""Part of the median scale at which Huber's criterion starts where σ0 is not known."""
INNER_TOLERANCE = 1e-3
"""Steps relative to σ at which an adjustment on the way is at rest."""

RobustProgress = Callable[[int, float, float], None]
"""Called with iteration, scale and the largest change of a γ."""


@dataclass(frozen=True, eq=False, repr=False)
class Robust(Shown):
    """A robust adjustment; arrays (n,) like ``solution.observations``."""

    solution: Solution
    """The network adjusted with equivalent weights; its σ are those of the equivalent weights,
    σ/√γ, and so are its residual sum of squares and its covariances."""
    estimator: Estimator
    """Which M-estimator."""
    weights: Array
    """γ of each scalar observation, from `LEAST_WEIGHT` to 1."""
    test_values: Array
    """t = v/(σ √r); NaN where it is not controlled."""
    scale: float
    """s, in units of the a-priori standard deviations."""
    iterations: int
    """Number of adjustments."""
    converged: bool
    """Whether the weights came to rest."""
    reason: str
    """Why it ended."""

    def headline(self) -> str:
        """Return which estimator was used, and how the estimation ended."""
        ended = "converged" if self.converged else f"NOT CONVERGED: {self.reason}"
        return (
            f"Robust: {self.estimator}, {self.iterations} adjustments, scale {self.scale:.4f}, "
            f"{ended}"
        )


def robust_adjust(
    network: Network,
    *,
    estimator: Estimator = "huber",
    scale: Literal["a-priori", "median"] = "a-priori",
    datum: DatumChoice | None = None,
    start: Solution | Start | None = None,
    tolerance: float = 0.01,
    max_iterations: int = 50,
    progress: RobustProgress | None = None,
) -> Robust:
    """Adjust a network so that a minority of gross errors does little harm.

    Args:
        network: what was measured; it is not changed.
        estimator: which M-estimator, see above.
        scale: ``a-priori``: s = 1 where the standard deviations are trusted, but more as long as
            the median of all |t| asks for it; ``median``: s = 1.4826 median |t|.
        datum: as for `adjust`.
        start: as for `adjust`.
        tolerance: change of every γ at which the weights are at rest.
        max_iterations: adjustments after which the result says that it has not converged.
        progress: called after each adjustment; an exception in it ends the estimation.

    Raises:
        InputError: an unknown choice; what `adjust` raises.
        DatumError, ApproximationError: as `adjust`.
        AdjustmentError: as `reliability`.
    """
    if estimator not in ESTIMATORS:
        raise InputError(f"unknown estimator {estimator!r}; valid: {', '.join(ESTIMATORS)}")
    if scale not in ("a-priori", "median"):
        raise InputError(f"unknown scale {scale!r}; valid: a-priori, median")
    solution = adjust(network, datum=datum, start=start)
    size = _spread(reliability(solution))
    known = scale == "a-priori"
    gamma = np.ones(len(size))
    starting, s = True, np.inf
    for iteration in range(1, max_iterations + 1):
        t = solution.equations.residuals(solution.state, whitened=False) / size
        s = _next_scale(t, s, estimator, starting=starting, known=known)
        last, gamma = gamma, _of_observations(solution, t / s, "huber" if starting else estimator)
        change = float(np.max(np.abs(gamma - last), initial=0.0))
        if progress is not None:
            progress(iteration, s, change)
        if not starting and change < tolerance:
            reason = f"at rest: no weight changes by more than {tolerance:g} of the full one"
            return Robust(solution, estimator, last, t, s, iteration, True, reason)
        if starting and change < LOOSE:
            starting, s = False, np.inf
        solution = adjust(
            network, datum=datum, start=solution, weights=gamma, tolerance=INNER_TOLERANCE
        )
    reason = f"weights not at rest after {max_iterations} adjustments: they change by {change:.2g}"
    return Robust(solution, estimator, gamma, t, s, max_iterations, False, reason)


def equivalent_weights(estimator: Estimator, t: Array) -> Array:
    """Return γ for scaled test values |t| (n,), without the lower limit."""
    t = np.abs(t)
    safe = np.maximum(t, 1e-300)
    if estimator == "huber":
        return np.minimum(1.0, 1.5 / safe)
    if estimator == "danish":
        return np.where(t <= 2.0, 1.0, np.exp(1.0 - (t / 2.0) ** 2))
    if estimator == "tukey":
        return np.asarray(np.maximum(1.0 - (t / 4.685) ** 2, 0.0) ** 2)
    k, m = 1.5, 6.0
    falling = k / safe * (np.maximum(m - t, 0.0) / (m - k)) ** 2
    return np.where(t <= k, 1.0, falling)


def _spread(rel: Reliability) -> Array:
    """Return σ √r (n,), which residuals are measured by; NaN where nothing controls them."""
    r = np.clip(rel.redundancy_numbers, LEAST_REDUNDANCY, 1.0)
    return np.where(rel.controlled, rel.solution.equations.sigmas() * np.sqrt(r), np.nan)


def _next_scale(t: Array, s: float, estimator: Estimator, *, starting: bool, known: bool) -> float:
    """Return the scale of the next weights.

    Huber's criterion supports any scale: its own may fall, but not rise to where it would stay.
    """
    median = _scale(t)
    if starting:
        return 1.0 if known else NEARLY_ABSOLUTE * median
    if estimator == "huber":
        return 1.0 if known else min(s, median)
    return max(1.0, median) if known else median


def _scale(t: Array) -> float:
    """Return 1.4826 median |t|; 1 where nothing is controlled."""
    size = np.abs(t[~np.isnan(t)])
    return (OF_THE_MEDIAN * float(np.median(size)) if len(size) else 0.0) or 1.0


def _of_observations(solution: Solution, t: Array, estimator: Estimator) -> Array:
    """Return γ (n,), the same for all components of an observation, for scaled t (n,)."""
    number = solution.equations.observation_of_row
    first = np.flatnonzero(np.diff(number, prepend=-1))
    largest = np.maximum.reduceat(np.nan_to_num(np.abs(t)), first)
    return np.maximum(equivalent_weights(estimator, largest), LEAST_WEIGHT)[number]
