"""Estimated variance components of groups, and the adjustment with their weights.

Group g has the covariance f_g² Σ_g with known Σ_g and one unknown factor f_g. At the estimates,
the weighted square sum of the residuals of each group equals its expectation,

    v_gᵀP_g v_g = r_g   for all g at once, with P_g = Σ_g⁻¹/f_g².

This is the maximum of the restricted likelihood, and the limit of Förstner's iteration
f² ← f² v_gᵀP_g v_g / r_g and of Helmert's S f² = q (Förstner 1979, AVN 86, 446–453; Koch 1999,
§ 3.6; Patterson & Thompson 1971, Biometrika 58, 545–554; Amiri-Simkooei 2007).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from ..adjustment import adjust
from ..blas_threads import with_one_thread
from ..errors import InputError, known, taking, unknown_name
from ..network.network import DatumChoice, Network
from ..result_display import Rows, Shown
from ..solve.added_factors import ExtraFactors
from ..solve.given_state import solution_after_step
from ..solve.minimum import readjust
from ..solve.solution import Solution
from ..start.start_values import Start
from ..statistical_tests import (
    CONFIDENCE_OF_REGION,
    chi2_lower_probability,
    chi2_quantile,
    chi2_upper_probability,
)
from ..types import Array
from .component_iteration import ComponentIteration, ComponentState
from .observation_groups import (
    MAX_WEIGHT_LOG_CHANGE,
    GroupChoice,
    GroupRedundancy,
    ObservationGroups,
    group_redundancy,
    observation_groups,
    sharpened_redundancy,
)

DEFAULT_TOLERANCE_OF_COMPONENTS = 1e-3
"""Bound on the last change of every component, relative to its own σ."""
DEFAULT_MAX_ADJUSTMENTS = 50
"""Largest number of sets of weights."""
MIN_CERTAIN_FREEDOM = 10.0
"""Degrees of freedom below which an estimate is called uncertain: the standard deviation of its
factor is more than 1/√20, 22 %."""
LAST_CHANGE_FACTOR = 30.0
"""Multiple of the tolerance below which a change of the components is likely to be the last but
one; the network is then adjusted to the end with the changed weights."""
MAX_UNPREDICTED_SHARE = 0.1
"""Excess of vᵀPv over the prediction of the linear model, relative to the prediction, above which
a single step does not count as an adjustment."""
MAX_SEPARABLE_CORRELATION = 0.9
"""Correlation of two estimates above which their groups are called inseparable."""


@dataclass(frozen=True)
class VarianceComponent:
    """The estimated precision of one group of observations."""

    name: str
    """Name of the group."""
    factor: float
    """Factor f = σ / a-priori σ."""
    sigma: float
    """Standard deviation of the factor, f √((S⁻¹)_gg / 2); NaN for a factor that is not estimated,
    infinite for a group that is completely inseparable from others."""
    redundancy: float
    """Redundancy r_g with the estimated weights."""
    n: int
    """Number of scalar observations."""
    state: ComponentState
    """State of the estimate."""
    note: str
    """Reason of the state, in words; may be empty."""

    @property
    def estimated(self) -> bool:
        """Whether the factor comes from the observations."""
        return self.state in ("estimated", "uncertain", "not separable")

    @property
    def freedom(self) -> float:
        """Degrees of freedom ν = 1 / (S⁻¹)_gg ≤ r_g of the χ² distribution of the estimate."""
        return 0.5 * (self.factor / self.sigma) ** 2 if np.isfinite(self.sigma) else 0.0

    @property
    def p_value(self) -> float:
        """Probability of a factor at least as far from 1, if the a-priori σ is right.

        The value is two-sided, for ν f² distributed as χ² with ν degrees of freedom, which is exact
        for a single group. It is NaN for a factor that is not estimated.
        """
        if not self.freedom > 0:
            return np.nan
        x = self.freedom * self.factor**2
        return float(
            min(
                1.0,
                2.0
                * min(
                    chi2_lower_probability(x, self.freedom), chi2_upper_probability(x, self.freedom)
                ),
            )
        )

    def interval(self, *, confidence: float = CONFIDENCE_OF_REGION) -> tuple[float, float]:
        """Return the bounds of the true factor, f √(ν/χ²); 0 and infinite without an estimate.

        Raises:
            InputError: the confidence is not between 0 and 1.
        """
        if not 0 < confidence < 1:
            raise InputError(f"the confidence must lie between 0 and 1, not {confidence}")
        nu, tail = self.freedom, (1.0 - confidence) / 2.0
        if not nu > 0:
            return 0.0, float("inf")
        low, high = (chi2_quantile(p, nu) for p in (1.0 - tail, tail))
        upper = self.factor * (nu / high) ** 0.5 if high > 0 else float("inf")
        return self.factor * (nu / low) ** 0.5, upper


@dataclass(frozen=True, eq=False, repr=False)
class VarianceComponents(Shown):
    """Estimated variance components of a network, and the adjustment with their weights."""

    components: tuple[VarianceComponent, ...]
    """Component of each group."""
    correlation: Array
    """Correlations of the estimates (k, k); zero with groups that are not estimated."""
    solution: Solution
    """The network, adjusted with the estimated weights: σ̂0 is near 1."""
    groups: ObservationGroups
    """Group of each row of ``solution.observations``."""
    iterations: int
    """Number of sets of weights with which the network was adjusted, the a-priori ones included;
    on the way an adjustment is one Gauss-Newton step."""
    converged: bool
    """Whether the components converged."""
    reason: str
    """Reason why the iteration ended."""
    exact: bool
    """Whether standard deviations are exact; otherwise stochastic traces give them to a few per
    cent."""

    def headline(self) -> str:
        """Return how many groups there are, and how the estimation ended."""
        ended = "converged" if self.converged else f"NOT CONVERGED: {self.reason}"
        return f"VarianceComponents: {len(self.components)} groups, {ended}"

    def first_rows(self) -> Rows:
        """Return the groups."""
        return Rows(
            ("group", "σ / σ a-priori", "its σ", "redundancy", "state"),
            ((c.name, c.factor, c.sigma, c.redundancy, c.state) for c in self.components),
            len(self.components),
        )

    def __getitem__(self, name: str) -> VarianceComponent:
        """Return the component of a group."""
        found = {c.name: c for c in self.components}
        if name not in found:
            raise InputError(unknown_name("group", name, found))
        return found[name]

    @cached_property
    def factors(self) -> Array:
        """Factor of the standard deviation of every scalar observation, 1 without group, (n,)."""
        return np.append([c.factor for c in self.components], 1.0)[self.groups.of_row]


@taking(Network)
@with_one_thread
def estimate_variance_components(
    network: Network,
    *,
    groups: GroupChoice = "kind",
    datum: DatumChoice | None = None,
    tolerance: float = DEFAULT_TOLERANCE_OF_COMPONENTS,
    max_iterations: int = DEFAULT_MAX_ADJUSTMENTS,
    seed: int = 0,
    start: Solution | Start | None = None,
    extra_factors: ExtraFactors = (),
) -> VarianceComponents:
    """Estimate one factor of the standard deviations of each group of observations.

    Each iteration compares v_gᵀP_g v_g with r_g, changes the weights, and takes one Gauss-Newton
    step with them, until the components converge. The network is then adjusted to the end with the
    estimated weights, and the comparison is made again. cov(ln f²) = 2 S⁻¹, see `group_redundancy`.
    A group with r_g < 1 keeps its a-priori σ. If the residuals of a group are too small for every
    σ, its iteration ends as r_g falls below 1, because the component cannot be distinguished from
    zero (other estimators give a negative variance component). The notes of the components report
    both cases, and warn of estimates with less than 10 degrees of freedom and of inseparable
    groups.

    Weighted unknowns and control are observations and have groups like all others. A mapping or a
    function as ``groups`` can leave these or other observations at their a-priori weights.

    Args:
        network: the network.
        groups: ``kind``; ``camera`` or ``photo`` (image coordinates by camera or photo, all else
            by kind); ``instrument`` (distances by the instrument they name, image coordinates
            by camera, all else by kind); ``frame`` (observations in frames by kind and frame, all
            else by kind); a mapping from names of groups to ids; or a function that returns the
            group of an `ObservationRecord`, or None.
        datum: as for `adjust`.
        tolerance: bound on the last change of every component, relative to its own σ.
        max_iterations: maximum number of adjustments; then the result has ``converged`` false.
        seed: seed of the stochastic traces for large networks.
        start: as for `adjust`.
        extra_factors: as for `adjust`; they keep their weights.

    Raises:
        InputError: unknown groups or ids, an observation in two groups, correlated observations
            in different groups, by name; errors of `adjust`.
    """
    if max_iterations < 1 or not tolerance > 0:
        raise InputError("max_iterations must be at least 1, and tolerance greater than 0")
    solution = adjust(network, datum=datum, start=start, extra_factors=extra_factors)
    found = observation_groups(solution, groups)
    return _iterated(solution, found, datum, tolerance, max_iterations=max_iterations, seed=seed)


@with_one_thread
def components_of_trial(start: Solution, groups: GroupChoice) -> VarianceComponents:
    """Estimate variance components near a solution, of which the factors alone are needed.

    Points stay on the sides of their stations on which the solution has them: an adjustment from
    the other side of each of them with every set of weights takes long, and the solution was chosen
    among the sides. The adjustment of the result has no sentences on second places.

    Args:
        start: the solution.
        groups: as for `estimate_variance_components`.

    Raises:
        InputError: as `estimate_variance_components`.
    """
    solution = adjust(start.network, start=start)
    return _iterated(solution, observation_groups(solution, groups), other_sides=False)


def _iterated(
    solution: Solution,
    found: ObservationGroups,
    datum: DatumChoice | None = None,
    tolerance: float = DEFAULT_TOLERANCE_OF_COMPONENTS,
    *,
    max_iterations: int = DEFAULT_MAX_ADJUSTMENTS,
    seed: int = 0,
    other_sides: bool = True,
) -> VarianceComponents:
    """Iterate from the adjustment with the a-priori weights, see `estimate_variance_components`."""
    search = ComponentIteration(len(found.names))
    iterations, whole, near = 1, True, False
    logarithms = search.logarithms.copy()
    at: GroupRedundancy | None = None
    while True:
        at = group_redundancy(solution, found, seed=seed, earlier=at, probe=near)
        changed = search.judge(at)
        proposal = search.proposal(at)
        if not changed and proposal.bound < tolerance:
            changed = search.release(at)
        at_rest = not changed and proposal.bound < tolerance
        if whole:
            if solution.converged and at_rest:
                reason = f"no component moves by more than {tolerance:.0e} of its own σ"
                if not search.estimated.any():
                    reason = "no group has residuals that its precision can be estimated from"
                break
            if not solution.converged:
                reason = f"the adjustment with these weights: {solution.reason}"
                break
            if iterations == max_iterations:
                reason = (
                    f"stopped after {iterations} adjustments: the last change of a component "
                    f"was up to {proposal.bound:.2g} of its σ"
                )
                break
        if not at_rest:
            search.step(at, search.proposal(at) if changed else proposal)
            near = float(np.abs(search.logarithms - logarithms).max()) <= MAX_WEIGHT_LOG_CHANGE
            logarithms = search.logarithms.copy()
            iterations += 1
        weights = np.append(np.exp(-logarithms), 1.0)[found.of_row]
        last = proposal.bound < LAST_CHANGE_FACTOR * tolerance or iterations == max_iterations
        solution, whole = _reweighted(
            solution, at, weights, datum, whole=last, other_sides=other_sides
        )
    at = sharpened_redundancy(at, solution, found, seed=seed)
    converged = at_rest and solution.converged
    components, correlation = _results(search, at, found, np.exp(logarithms / 2.0))
    return VarianceComponents(
        components, correlation, solution, found, iterations, converged, reason, at.exact
    )


def _reweighted(
    solution: Solution,
    at: GroupRedundancy,
    weights: Array,
    datum: DatumChoice | None,
    *,
    whole: bool,
    other_sides: bool,
) -> tuple[Solution, bool]:
    """Return the network with other weights, adjusted to the end or after one step.

    The estimates move little when weights change, and one step usually leads to the minimum. If the
    sum vᵀPv after the step is not the one that the linear model predicts, the network is adjusted
    to the end. ``other_sides`` is that of `readjust`.

    Returns:
        The solution, and whether it is adjusted to the end.
    """
    again = partial(readjust, datum=datum, other_sides=other_sides)
    if not whole:
        before = 1.0 if solution.weights is None else solution.weights
        n = solution.equations.n_rows
        predicted = float(np.square(at.residuals[:n]) @ (weights / before))
        predicted += float(at.residuals[n:] @ at.residuals[n:])
        try:
            step = solution_after_step(solution, at.movement, weights)
        except InputError:
            return again(solution, weights), True
        if step.vtpv <= (1.0 + MAX_UNPREDICTED_SHARE) * predicted:
            return step, False
    return again(solution, weights), True


def _results(
    search: ComponentIteration, at: GroupRedundancy, groups: ObservationGroups, factors: Array
) -> tuple[tuple[VarianceComponent, ...], Array]:
    """Return the components and the correlations of their estimates."""
    cofactors, lost = search.cofactors(at)
    root = np.sqrt(np.diag(cofactors))
    safe = np.where(root > 0, root, 1.0)
    correlation = cofactors / np.outer(safe, safe)
    sigmas = np.where(lost, np.inf, factors * root / np.sqrt(2.0))
    close = (np.abs(correlation) > MAX_SEPARABLE_CORRELATION) | np.outer(lost, lost)
    np.fill_diagonal(close, False)
    components = []
    for i, name in enumerate(groups.names):
        c = VarianceComponent(
            name,
            float(factors[i]),
            float(sigmas[i]) if search.estimated[i] else np.nan,
            float(at.redundancy[i]),
            int(groups.sizes[i]),
            search.states[i],
            search.notes[i],
        )
        if search.estimated[i]:
            c = _commented(c, [groups.names[j] for j in np.flatnonzero(close[i])])
        components.append(c)
    return tuple(components), correlation


def _commented(c: VarianceComponent, inseparable: list[str]) -> VarianceComponent:
    """Return an estimated component with its state and note."""
    if inseparable:
        how = "at all: only a combination of them is estimated" if np.isinf(c.sigma) else "well"
        what = (
            f"its errors cannot be distinguished from those of {known(inseparable)} {how}; "
            "put them into one group"
        )
        return replace(c, state="not separable", note=what)
    if c.freedom < MIN_CERTAIN_FREEDOM:
        what = (
            f"only {c.freedom:.1f} degrees of freedom (redundancy {c.redundancy:.1f}): the factor "
            f"is uncertain by {100 * c.sigma / c.factor:.0f} %"
        )
        return replace(c, state="uncertain", note=what)
    return c
