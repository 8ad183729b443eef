"""Robust estimation by iterative reweighting: Huber, Danish, IGG III and Tukey.

Each observation gets a factor γ ≤ 1 on its weight, which depends on its misfit. The network is
adjusted with these equivalent weights, and the two steps are repeated until the weights converge.
The misfit is

    t = v / (σ √r)

with the redundancy number r of the network at full weights: t also shows an error that leverage
hides in a small residual. (In the reweighted adjustment r rises for some observations and falls for
others; with these r the weights oscillated and did not converge in simulations with 20 % gross
errors.) All components of an observation have the same γ, from the largest |t|/s with a scale s.

    Huber     γ = 1 up to k, k/t beyond                             k = 1.5   (Huber 1964)
    Danish    γ = 1 up to k, exp(1 − (t/k)²) beyond                 k = 2     (Krarup et al. 1980)
    IGG III   γ = 1 up to k, (k/t) ((m − t)/(m − k))², 0 from m     k = 1.5, m = 6  (Yang 1994)
    Tukey     γ = (1 − (t/k)²)², 0 from k                           k = 4.685 (Beaton & Tukey 1974)

Correlated observations keep their correlation (bifactor equivalent weights, Yang et al. 2002).
All estimators start with Huber's criterion, because it is convex and the others have many minima.
Its scale is small at first, so that it is nearly the sum of |t|.

Huber's criterion bounds the effect of an error by 1.5 σ of its own reading: distances with a σ of
micrometres carry a target away that angles with a σ of tenths of a millimetre should hold. Where
the estimation begins at start values at which few observations have very large misfits, these
therefore get the weight γ = 10⁻⁶ (1000/t)², with which an error has the effect of at most 0.001 σ,
until they fit.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..adjustment import adjust
from ..blas_threads import with_one_thread
from ..errors import DatumError, InputError, known, taking
from ..graph.equations import compile_network
from ..graph.listed_points import with_listed_points_apart
from ..network.network import DatumChoice, Network
from ..orientation.choice_of_start import (
    choose_start,
    given_or_image_start,
    image_start,
    misses_minimum,
    with_doubtful_image_points,
)
from ..result_display import Shown
from ..solve.given_state import solution_at_given_values
from ..solve.minimum import DEFAULT_MAX_ITERATIONS
from ..solve.solution import Solution
from ..start.start_values import Start
from ..statistical_tests import SIGMA_PER_MEDIAN_DEVIATION
from ..types import Array, Mask
from .reliability import Reliability, reliability
from .snooping_candidates import RowGroups

Estimator = Literal["huber", "danish", "igg3", "tukey"]
ESTIMATORS: tuple[Estimator, ...] = ("huber", "danish", "igg3", "tukey")

START_REASON = "the approximate values"
"""Reason of a solution that consists of the start values of an estimation."""
MIN_ROBUST_WEIGHT = 1e-6
"""Smallest γ. It keeps every unknown determined; an error of 1000 σ has the effect of 0.001 σ."""
MIN_ROBUST_REDUNDANCY = 0.01
"""Smallest redundancy number r in t; the small residuals of observations with a smaller r depend
mainly on the γ of other observations."""
FAR_OFF_TEST_VALUE = 1000.0
"""Smallest |t| at start values that counts as a very large misfit."""
MAX_FAR_OFF_SHARE = 0.1
"""Largest share of such observations that gross errors explain; where there are more, the start
values are poor."""
START_WEIGHT_TOLERANCE = 0.05
"""Largest change of a γ at which the start with Huber's criterion ends."""
START_SCALE_FACTOR = 0.1
"""Part of the median scale at which Huber's criterion starts if σ0 is unknown."""
INTERMEDIATE_TOLERANCE = 1e-3
"""Step relative to σ below which an intermediate adjustment has converged."""

RobustProgress = Callable[[int, float, float], None]
"""Function called with the iteration, the scale and the largest change of a γ."""


@dataclass(frozen=True, eq=False, repr=False)
class Robust(Shown):
    """A robust adjustment; arrays (n,) like ``solution.observations``."""

    solution: Solution
    """The network adjusted with equivalent weights; its standard deviations σ/√γ, residual sum of
    squares and covariances belong to these weights."""
    estimator: Estimator
    """Name of the M-estimator."""
    weights: Array
    """γ of each scalar observation, from `MIN_ROBUST_WEIGHT` to 1."""
    test_values: Array
    """t = v/(σ √r); NaN for uncontrolled observations."""
    scale: float
    """s, in units of the a-priori standard deviations."""
    iterations: int
    """Number of adjustments."""
    converged: bool
    """Whether the weights converged."""
    reason: str
    """Reason why the iteration ended."""

    def headline(self) -> str:
        """Return which estimator was used, and how the estimation ended."""
        ended = "converged" if self.converged else f"NOT CONVERGED: {self.reason}"
        return (
            f"Robust: {self.estimator}, {self.iterations} adjustments, scale {self.scale:.4f}, "
            f"{ended}"
        )


@taking(Network)
@with_one_thread
def robust_adjust(
    network: Network,
    *,
    estimator: Estimator = "huber",
    scale: Literal["a-priori", "median"] = "a-priori",
    datum: DatumChoice | None = None,
    start: Solution | Start | None = None,
    from_start: bool = False,
    tolerance: float = 0.01,
    max_iterations: int = 50,
    iterations_each: int = DEFAULT_MAX_ITERATIONS,
    progress: RobustProgress | None = None,
) -> Robust:
    """Adjust a network so that a minority of gross errors does little harm.

    Args:
        network: the network; it is not changed.
        estimator: name of the M-estimator, see the formulas of the module.
        scale: ``a-priori``: s = 1 for trusted standard deviations, but larger as long as 1.4826
            median |t| is larger; ``median``: s = 1.4826 median |t|.
        datum: as for `adjust`.
        start: as for `adjust`.
        from_start: whether the first misfits are those of the start values; otherwise those of a
            plain adjustment, which very large errors may distort, if it has a minimum.
        tolerance: largest change of a γ at which the weights have converged.
        max_iterations: maximum number of adjustments; then the result has ``converged`` false.
        iterations_each: largest number of iterations of each adjustment.
        progress: called after each adjustment; an exception in it ends the estimation.

    Raises:
        InputError: an unknown choice; errors of `adjust`.
        DatumError, ApproximationError: as `adjust`.
        AdjustmentError: as `reliability`.
    """
    if estimator not in ESTIMATORS:
        raise InputError(
            f"unknown estimator {estimator!r}; valid: {known(ESTIMATORS, meant=estimator)}"
        )
    if scale not in ("a-priori", "median"):
        raise InputError(
            f"unknown scale {scale!r}; valid: {known(('a-priori', 'median'), meant=scale)}"
        )
    network = with_listed_points_apart(network)
    solution = _first_solution(network, datum, start, from_start, iterations_each)
    size = _spread(reliability(solution))
    trusted = scale == "a-priori"
    gamma = np.ones(len(size))
    starting, s = True, np.inf
    far: Mask = np.zeros(len(size), dtype=bool)
    for iteration in range(1, max_iterations + 1):
        t = solution.equations.residuals(solution.state, whitened=False) / size
        s = _next_scale(t, s, estimator, starting=starting, known=trusted)
        largest = _largest(solution, t / s)
        far = largest > FAR_OFF_TEST_VALUE if iteration == 1 and _unbent(solution) else far
        far = far & (largest > FAR_OFF_TEST_VALUE) & (np.mean(far) <= MAX_FAR_OFF_SHARE)
        last, gamma = gamma, _weights("huber" if starting else estimator, largest)
        gamma = np.where(
            far,
            MIN_ROBUST_WEIGHT
            * np.square(FAR_OFF_TEST_VALUE / np.maximum(largest, FAR_OFF_TEST_VALUE)),
            gamma,
        )
        change = float(np.max(np.abs(gamma - last), initial=0.0))
        if progress is not None:
            progress(iteration, s, change)
        if not starting and change < tolerance:
            reason = f"no weight changes by more than {tolerance:g} of the full one"
            return Robust(solution, estimator, last, t, s, iteration, True, reason)
        if starting and change < START_WEIGHT_TOLERANCE:
            starting, s = False, np.inf
        solution = adjust(
            network,
            datum=datum,
            start=solution,
            weights=gamma,
            tolerance=INTERMEDIATE_TOLERANCE,
            max_iterations=iterations_each,
        )
    reason = f"stopped after {max_iterations} adjustments: weights still change by {change:.2g}"
    return Robust(solution, estimator, gamma, t, s, max_iterations, False, reason)


def _first_solution(
    network: Network,
    datum: DatumChoice | None,
    start: Solution | Start | None,
    from_start: bool,
    max_iterations: int,
) -> Solution:
    """Return the solution where the estimation begins: the plain adjustment, or the start values.

    Very large errors distort a plain adjustment until it has no minimum, or none where all is
    determined. At the start values their misfits are large all the same, and those of others are
    not.
    """
    choice = network.datum if datum is None else datum
    given, start = start, given_or_image_start(network, datum, start)
    if isinstance(start, Start) and start.doubtful:
        return _solution_from_images(network, choice, start, max_iterations)
    if not from_start or choice == "free":
        # A network that does not determine its unknowns is a DatumError here.
        solution: Solution | None = None
        failure: InputError | DatumError | None = None
        try:
            solution = adjust(network, datum=datum, start=start, max_iterations=max_iterations)
        except (InputError, DatumError) as error:
            failure = error
        lost = given is None and (solution is None or misses_minimum(solution))
        if lost and (anew := image_start(network, datum)) is not None:
            return _solution_from_images(network, choice, anew, max_iterations)
        if failure is not None:
            raise failure
        assert solution is not None
        if solution.converged or choice == "free":
            return solution
    equations = compile_network(network)
    begin = choose_start(equations, choice, start)
    return solution_at_given_values(equations, begin, None, reason=START_REASON, doubt=START_REASON)


def _solution_from_images(
    network: Network, datum: DatumChoice, start: Start, max_iterations: int
) -> Solution:
    """Return the plain adjustment of a block that begins from images, if it has a minimum.

    Otherwise the image points that do not agree with the start hardly count.
    """
    with suppress(InputError, DatumError):
        solution = adjust(network, datum=datum, start=start, max_iterations=max_iterations)
        if solution.converged:
            return solution
    equations = compile_network(network)
    gamma = np.ones(equations.n_rows)
    gamma[np.concatenate(equations.find(list(start.doubtful)))] = MIN_ROBUST_WEIGHT
    try:
        return adjust(
            network, datum=datum, start=start, weights=gamma, max_iterations=max_iterations
        )
    except (InputError, DatumError) as error:
        raise with_doubtful_image_points(start, error) from None


def _unbent(solution: Solution) -> bool:
    """Return whether very large errors have not distorted the solution yet."""
    return solution.reason == START_REASON or solution.weights is not None


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
    """Return σ √r (n,), the denominator of t; NaN for uncontrolled observations."""
    r = np.clip(rel.redundancy_numbers, MIN_ROBUST_REDUNDANCY, 1.0)
    return np.where(rel.controlled, rel.solution.equations.sigmas() * np.sqrt(r), np.nan)


def _next_scale(t: Array, s: float, estimator: Estimator, *, starting: bool, known: bool) -> float:
    """Return the scale of the next weights.

    Huber's criterion converges at any scale; its median scale may only decrease, because a larger
    scale would maintain itself.
    """
    median = _scale(t)
    if starting:
        return 1.0 if known else START_SCALE_FACTOR * median
    if estimator == "huber":
        return 1.0 if known else min(s, median)
    return max(1.0, median) if known else median


def _scale(t: Array) -> float:
    """Return 1.4826 median |t|; 1 if all observations are uncontrolled."""
    size = np.abs(t[~np.isnan(t)])
    return (SIGMA_PER_MEDIAN_DEVIATION * float(np.median(size)) if len(size) else 0.0) or 1.0


def _largest(solution: Solution, t: Array) -> Array:
    """Return the largest scaled |t| of all components of an observation for each of them, (n,)."""
    rows = RowGroups.of(solution.equations)
    return np.asarray(rows.largest(t)[rows.number])


def _weights(estimator: Estimator, t: Array) -> Array:
    """Return γ (n,) for scaled |t| (n,), with the lower limit."""
    return np.maximum(equivalent_weights(estimator, t), MIN_ROBUST_WEIGHT)
