"""Reliability of each observation: redundancy, w and τ, smallest errors, effects; stiff ties.

With P the weight matrix, Q the cofactors of the unknowns and Q_vv = P⁻¹ − A Q Aᵀ those of the
residuals v = computed − observed (Baarda 1968; El-Hakim 1986, eqs. 3 to 8):

    redundancy number        r_i = (Q_vv P)_ii,   Σ r_i = redundancy,   r + e1 + e2 + e12 = 1
    test of Baarda           w_i = (Pv)_i / √(P Q_vv P)_ii              = v_i / (σ_i √r_i)
    test of Pope             τ_i = w_i / σ̂0
    smallest detectable      ∇_i = δ0 / √(P Q_vv P)_ii                  = δ0 σ_i / √r_i
    its effect on unknowns   ∇x  = Q AᵀP e_i ∇_i
    external reliability     δ̄_i = √(∇xᵀ N ∇x)                          = δ0 √((1 − r_i)/r_i)

The right column is valid for uncorrelated observations, the left column for all.

Stiff ties are observations that state a property of the model, so stiff that nothing controls
them. A member of a rig is tied to its carrier by a relative pose with a play of a micrometre; a
condition between shapes may have as small a standard deviation. Their redundancy numbers are near
zero, as the tie gives way by r of any error in it. That is their purpose, and no weakness of a
measurement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module

import numpy as np

from ..blas_threads import with_one_thread
from ..columns import Columns
from ..errors import AdjustmentError, InputError, SingularError, taking, unknown_name
from ..result_display import FIRST, Rows, Shown
from ..solve.leverages import Leverages, STransform, leverages, point_leverages
from ..solve.solution import Solution, datum_cross
from ..statistical_tests import (
    ALPHA_OF_OBSERVATION,
    POWER_OF_TEST,
    descending,
    normal_quantile,
    student_quantile,
)
from ..types import Array, Index, Mask
from .causes.shared_error_tests import GivenValue, given_values
from .error_effects import (
    Effect,
    UnknownName,
    effect_on_unknowns,
    largest_point_shift,
    residual_response,
    share_diagonal,
    weight_diagonal,
    weighted_diagonal,
    weighted_rows,
)
from .group_tests import (
    FactorReliability,
    GroupReliability,
    factor_reliability,
    group_reliabilities,
    least_share,
)

ROUNDING_EFFECT_M = 1e-12
"""Effect of an error of one σ on a point, metres, below which the effect is rounding error."""
MAX_REDUNDANCY_SUM_ERROR = 1e-3
"""Largest difference between Σr and the redundancy with which the figures are accepted."""
MAX_STIFF_REDUNDANCY = 1e-4
"""Redundancy number below which a stated observation counts as a stiff tie: an error of 10 µm in it
moves its residual by a nanometre."""


@dataclass(frozen=True, eq=False, repr=False)
class Reliability(Shown):
    """Reliability of every scalar observation; arrays (n,) like ``solution.observations``.

    Residuals, errors and σ are in SI or image units. An observation that no other controls (r = 0)
    has NaN test values and an infinite smallest detectable error.
    """

    solution: Solution
    """The adjustment."""
    alpha: float
    """Probability α0 of a false alarm of one test."""
    power: float
    """Probability 1 − β0 with which an error of the smallest detectable size is found."""
    redundancy_numbers: Array
    """r, from 0 to 1 for uncorrelated observations; Σr over all observations = redundancy."""
    e1: Array
    """Part of an error that goes into all unknowns except object points (El-Hakim 1986, eq. 6).
    In a free network e1 and e12 depend on the datum; r, e2 and e1 + e12 are independent of it."""
    w: Array
    """Test values of Baarda, a-priori σ0 = 1, with the sign of the residual."""
    mdb: Array
    """Smallest detectable error ∇ > 0, for σ0 = 1, or σ̂0 in an a-posteriori solution."""
    delta_bar: Array
    """External reliability δ̄: ∇ changes a function of the unknowns by at most δ̄ times the standard
    deviation of that function."""
    largest_effect: Array
    """Largest shift of one of the observation's own points by ∇, metres: the length of the vector,
    which does not depend on the axes; NaN for an observation without unknown points."""
    estimated_errors: Array
    """Estimated error observed − true = −(Pv)_i / (P Q_vv P)_ii if only this observation is
    wrong; NaN for an uncontrolled observation."""
    controlled: Mask
    """Whether other observations control the observation."""
    redundancy_of_extra_factors: float
    """Σr of the factors that the user added, which completes the redundancy."""
    precision: Array
    """(P Q_vv P)_ii, the inverse variance of an estimated error; 1/unit²."""
    leverages: Leverages
    """Leverages of all observations."""

    def headline(self) -> str:
        """Say how much is controlled, and how well."""
        r, n = self.redundancy_numbers, len(self.w)
        largest = float(np.nanmax(np.abs(self.w))) if self.controlled.any() else np.nan
        return (
            f"Reliability: {n} observations, Σr {float(r.sum()):.3f}, mean r "
            f"{float(r.mean()):.2f}, {n - int(self.controlled.sum())} not controlled, largest |w| "
            f"{largest:.2f} (critical {self.critical_w:.2f})"
        )

    @with_one_thread
    def first_rows(self) -> Rows:
        """Return the observations with the largest test values."""
        rows = [s.row for s in self.suspects(FIRST)]
        return replace(self._columns(rows).first_rows(), total=len(self.w))

    # -- parts --------------------------------------------------------------------------------

    @property
    def delta0(self) -> float:
        """δ0 = Φ⁻¹(1 − α0/2) + Φ⁻¹(power); 4.13 for 0.1 % and 80 %."""
        return noncentrality(self.alpha, self.power)

    @property
    def critical_w(self) -> float:
        """Critical value of |w|."""
        return normal_quantile(1.0 - self.alpha / 2.0)

    @property
    def critical_tau(self) -> float:
        """Critical value of |τ|; NaN with less than two redundant observations."""
        return critical_tau(self.alpha, self.solution.redundancy)

    @cached_property
    def tau(self) -> Array:
        """Test values of Pope, (n,); |τ| ≤ √redundancy. NaN where vᵀPv vanishes."""
        sigma0 = self.solution.sigma0
        return self.w / sigma0 if sigma0 > 0 else np.full(len(self.w), np.nan)

    @cached_property
    @with_one_thread
    def e2(self) -> Array:
        """Part of an error that goes into the object points, with others held (eq. 6), (n,)."""
        s = self.solution
        system = s.normal().system
        blocks, clusters = point_leverages(system, s.factor, s.datum)
        return share_diagonal(s.equations, blocks, clusters)

    @cached_property
    @with_one_thread
    def e12(self) -> Array:
        """Interaction of e1 and e2: the rest of A Q AᵀP (eq. 4), (n,)."""
        return 1.0 - self.redundancy_numbers - self.e1 - self.e2

    @cached_property
    @with_one_thread
    def given_values(self) -> tuple[GivenValue, ...]:
        """Tests of held values, each as if it had been given with σ → ∞."""
        return given_values(self.solution)

    @cached_property
    @with_one_thread
    def factors(self) -> tuple[FactorReliability, ...]:
        """Tests of the factors that the user added, in their order."""
        sigma0 = float(np.sqrt(self.solution.variance_factor))
        rows, least = self.solution.normal().system.extra, least_share(self.solution)
        return tuple(
            factor_reliability(e, found, self.alpha, self.delta0, sigma0, least)
            for e, found in zip(rows, self.leverages.extra, strict=True)
        )

    def factor(self, name: str) -> FactorReliability:
        """Return the tests of a factor that the user added, by its name.

        Raises:
            InputError: no such factor.
        """
        by_name = {f.name: f for f in self.factors}
        if name not in by_name:
            raise InputError(unknown_name("factor", name, by_name))
        return by_name[name]

    @cached_property
    @with_one_thread
    def groups(self) -> tuple[GroupReliability, ...]:
        """Tests of correlated groups as a whole: observations with a covariance, clusters."""
        return group_reliabilities(
            self.solution,
            self.leverages.hats,
            (self.alpha, self.power),
            np.sqrt(self.solution.variance_factor),
        )

    def table(self) -> Columns:
        """Return the figures of all observations as columns, SI or image units."""
        return self._columns()

    def _columns(self, rows: Sequence[int] | None = None) -> Columns:
        """Return the figures of some observations, or of all."""
        # The table of observations, and all reports, are above this module.
        reports = import_module("factorgraph_adj.report.adjusted_observations")
        found: Columns = reports.observation_frame(self, rows)
        return found

    # -- of single observations ---------------------------------------------------------------

    def row(self, observation: int | str, component: str | None = None) -> int:
        """Return the row of an observation by its id, and by its component if it has several.

        Raises:
            InputError: unknown or ambiguous id or component.
        """
        table = self.solution.observations
        if not isinstance(observation, str):
            if not -len(table) <= observation < len(table):
                raise InputError(f"row {observation} is not one of {len(table)} observations")
            return int(observation) % len(table)
        return table.row(observation, component)

    @with_one_thread
    def effect_on(
        self,
        observation: int | str,
        unknowns: UnknownName | Sequence[UnknownName] | None = None,
        *,
        component: str | None = None,
        error: float | None = None,
    ) -> Array | tuple[Effect, ...]:
        """Return the effect ∇x = Q AᵀP e_i ∇ of an error of one observation on unknowns.

        Args:
            observation: row, or id.
            unknowns: name of a point, or kind and name such as ``("pose", "12")``, or a list
                of such names; None: all unknowns.
            component: component of the observation, if it has several.
            error: ∇, SI or image units; by default the smallest detectable error.

        Returns:
            For a single unknown the effects on its k components, (k,): metres, radians, image
            units (poses: rotations about the camera's axes, then X0, Y0, Z0). For several unknowns
            an `Effect` for each.

        Raises:
            InputError: unknown names; no ``error`` for an observation that is not controlled.
        """
        row = self.row(observation, component)
        size = float(self.mdb[row]) if error is None else float(error)
        if not np.isfinite(size):
            raise InputError(
                f"{self.solution.equations.label(row)} is controlled by no other observation: "
                "its smallest detectable error is infinite; give error="
            )
        return effect_on_unknowns(self.solution, row, unknowns, size)

    def correlation(self, rows: Sequence[int] | Index) -> Array:
        """Return the correlations (k, k) of the test values of k observations.

        ρ_ij = (P Q_vv P)_ij / √((P Q_vv P)_ii (P Q_vv P)_jj). With |ρ| near 1, errors of the two
        observations cannot be distinguished (Förstner 1983).
        """
        at = np.asarray(rows, dtype=np.intp)
        return self.correlations_with(at)[at]

    @with_one_thread
    def suspects(
        self, most: int = 10, *, inseparable: float = 0.9, critical: float | None = None
    ) -> tuple[Suspect, ...]:
        """Return the observations with the largest |w|, each with its inseparable observations.

        Args:
            most: maximum number of observations.
            inseparable: correlation of test values from which two observations are inseparable.
            critical: limit that |w| must exceed.
        """
        size = np.where(self.controlled, np.abs(self.w), 0.0)
        order = descending(size)[:most]
        rows = order[size[order] > (critical or 0.0)]
        if not len(rows):
            return ()
        rho = self.correlations_with(rows)
        out = []
        for j, row in enumerate(rows.tolist()):
            close = np.flatnonzero(np.abs(rho[:, j]) >= inseparable)
            close = close[descending(np.abs(rho[close, j]))]
            partners = tuple((int(i), float(rho[i, j])) for i in close if i != row)
            label = self.solution.equations.label(row)
            out.append(Suspect(row, label, float(self.w[row]), partners))
        return tuple(out)

    @with_one_thread
    def correlations_with(self, rows: Index) -> Array:
        """Return the correlations of all test values with those of ``rows``, (n, k)."""
        pqp = residual_response(self.solution, rows)
        return correlations_of_tests(pqp, rows, self.precision, self.controlled)


@dataclass(frozen=True)
class Suspect:
    """An observation with a large test value."""

    row: int
    """Row of the observation."""
    label: str
    """Readable name of the observation, with the source."""
    value: float
    """Test value w."""
    inseparable: tuple[tuple[int, float], ...]
    """Rows of inseparable observations, with the correlations of the test values; the error may
    be in any of these observations."""


@taking(Solution)
@with_one_thread
def reliability(
    solution: Solution, *, alpha: float = ALPHA_OF_OBSERVATION, power: float = POWER_OF_TEST
) -> Reliability:
    """Compute the reliability of every observation of an adjustment.

    All figures come from one pass over the factorised normal equations (selected inverse), by the
    formulas of the module.

    Args:
        solution: result of `adjust`; held unknowns, free networks and correlated observations
            are allowed. Weighted unknowns count as observations.
        alpha: probability α0 of a false alarm of one test.
        power: probability with which an error of the smallest detectable size is found.

    Raises:
        InputError: probabilities outside (0, 1), or α0 ≥ power.
        AdjustmentError: the normal equations are singular at the solution, or so nearly singular
            that Σr differs from the redundancy.
    """
    check_probabilities(alpha, power)
    try:
        system, factor = solution.normal().system, solution.factor
        found = leverages(system, factor, _transform(solution))
    except SingularError as error:
        raise AdjustmentError(f"no reliability: {error}") from None
    equations = solution.equations
    blocks, clusters = found.hats
    r = 1.0 - share_diagonal(equations, blocks, clusters)
    extra = sum(len(c.hat) - float(np.trace(c.hat)) for c in found.extra)
    extra += solution.extra.n_rows - sum(len(c.hat) for c in found.extra)  # rows that are constants
    total = float(r.sum()) + extra
    wanted = solution.sum_of_redundancy_numbers
    if wanted is not None and not abs(total - wanted) < MAX_REDUNDANCY_SUM_ERROR:
        raise AdjustmentError(
            f"no reliability: the redundancy numbers sum to {total:.9g}, the redundancy is "
            f"{wanted}: the network is too weak to compute them ({solution.reason})"
        )
    weight = weight_diagonal(equations)
    lost = weighted_diagonal(equations, blocks, clusters)
    precision = weight - lost
    controlled = precision > least_share(solution) * weight
    root = np.sqrt(np.where(controlled, precision, np.nan))
    delta0 = noncentrality(alpha, power)
    pv = weighted_rows(equations, system.residual[:, None])[:, 0]
    mdb = np.where(controlled, delta0 * np.sqrt(solution.variance_factor) / root, np.inf)
    lost = np.maximum(lost, 0.0)
    return Reliability(
        solution=solution,
        alpha=alpha,
        power=power,
        redundancy_numbers=r,
        e1=share_diagonal(
            equations, [b.others for b in found.blocks], [c.others for c in found.clusters]
        ),
        w=pv / root,
        mdb=mdb,
        delta_bar=np.where(controlled, delta0 * np.sqrt(lost) / root, np.inf),
        largest_effect=_largest_effects(largest_point_shift(equations, found), mdb, weight),
        estimated_errors=-pv / root**2,
        controlled=controlled,
        redundancy_of_extra_factors=extra,
        precision=precision,
        leverages=found,
    )


def _largest_effects(shift: Array, mdb: Array, weight: Array) -> Array:
    """Return shift · ∇; a shift below `ROUNDING_EFFECT_M` gives 0, even for an infinite ∇."""
    still = shift * np.sqrt(1.0 / weight) < ROUNDING_EFFECT_M
    return np.where(still, 0.0, np.where(still, 1.0, shift) * np.where(still, 1.0, mdb))


def check_probabilities(alpha: float, power: float) -> None:
    """Raise InputError if α0 or power is outside (0, 1), or α0 ≥ power."""
    if not 0 < alpha < 1 or not 0 < power < 1 or alpha >= power:
        raise InputError(
            f"alpha and power must lie between 0 and 1, alpha below power: {alpha}, {power}"
        )


def noncentrality(alpha: float, power: float) -> float:
    """Return δ0 = Φ⁻¹(1 − α0/2) + Φ⁻¹(power)."""
    return normal_quantile(1.0 - alpha / 2.0) + normal_quantile(power)


def critical_tau(alpha: float, redundancy: int) -> float:
    """Return the critical value of Pope's |τ| = t √f / √(f − 1 + t²), t of f − 1, f = redundancy.

    NaN for f < 2: with f = 1, |τ| = 1 for every error.
    """
    f = redundancy
    if f < 2:
        return float("nan")
    t = student_quantile(1.0 - alpha / 2.0, f - 1)
    return float(t * np.sqrt(f) / np.sqrt(f - 1 + t * t))


def correlations_of_tests(pqp: Array, rows: Index, precision: Array, controlled: Mask) -> Array:
    """Return the correlations of all test values with those of ``rows`` (k,), (n, k).

    Args:
        pqp: columns of P Q_vv P at the rows, (n, k).
        rows: the rows.
        precision: diagonal of P Q_vv P, (n,).
        controlled: whether a row has a test value, (n,).
    """
    scale = np.sqrt(np.where(controlled, precision, np.inf))
    out = pqp / scale[:, None] / scale[rows]
    out[rows, np.arange(len(rows))] = np.where(controlled[rows], 1.0, np.nan)
    return np.asarray(out)


def _transform(solution: Solution) -> STransform | None:
    """Return the S-transformation from the minimal datum of the solver to the solution's datum."""
    cross = datum_cross(solution)
    if solution.datum is None or cross is None:
        return None
    return STransform(solution.datum.basis, *cross)


@dataclass(frozen=True, eq=False)
class PointRedundancy:
    """Redundancy of the observations of each point, arrays over all points (n,)."""

    rows: Index
    """Number of scalar observations of the point."""
    uncontrolled: Index
    """Number of these observations that no other observation controls."""
    redundancy: Array
    """Sum of their redundancy numbers."""

    @property
    def mean(self) -> Array:
        """Mean redundancy number of each point, at least 0; NaN without observations."""
        return np.asarray(np.maximum(self.redundancy, 0.0) / np.where(self.rows, self.rows, np.nan))


def point_redundancy(rel: Reliability) -> PointRedundancy:
    """Return the number of observations and the redundancy of each point."""
    equations = rel.solution.equations
    n = len(equations.unknowns["point"].names)
    out = PointRedundancy(np.zeros(n, np.intp), np.zeros(n, np.intp), np.zeros(n))
    for block in equations.blocks:
        shape = block.observed.shape
        r = rel.redundancy_numbers[block.rows].reshape(shape).sum(axis=1)
        open_rows = np.sum(~rel.controlled[block.rows].reshape(shape), axis=1)
        for kind, index in block.variables:
            if kind == "point":
                np.add.at(out.rows, index, block.dimension)
                np.add.at(out.uncontrolled, index, open_rows)
                np.add.at(out.redundancy, index, r)
    return out


def stiff_ties(rel: Reliability) -> Mask:
    """Return which rows belong to stiff ties of the model, (n_rows,).

    An observation is one if it was stated and not measured, see `Observation.is_constraint`, and
    none of its redundancy numbers reaches `MAX_STIFF_REDUNDANCY`.
    """
    out = np.zeros(len(rel.redundancy_numbers), dtype=bool)
    observations = rel.solution.network.observations
    for block in rel.solution.equations.blocks:
        if block.prior or block.by_axis or not block.named:
            continue
        numbers = np.arange(block.rows.start, block.rows.stop).reshape(block.observed.shape)
        for i in np.flatnonzero(
            (rel.redundancy_numbers[numbers] < MAX_STIFF_REDUNDANCY).all(axis=1)
        ).tolist():
            found = observations.get(block.ids[i])
            out[numbers[i]] = found is not None and found.is_constraint
    return out
