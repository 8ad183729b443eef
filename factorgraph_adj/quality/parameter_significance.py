"""Significance of calibration and all additional parameters; multiple and pair correlations.

Each parameter of interior orientation, lens distortion, distance meters and refraction is tested
against its value without a systematic error, and strong correlations with other unknowns are
listed. A parameter that is not significant, or that others explain, weakens the network without
improving its model: the network is overparametrised.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from scipy.sparse import block_diag

from ..blas_threads import with_one_thread
from ..errors import AdjustmentError, InputError, SingularError, known, taking
from ..models.unknown_registry import UNKNOWNS, VariableKind
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_MODEL, normal_quantile, student_quantile
from ..types import Array, Index, Mask
from .parameter_correlations import (
    NO_CORRELATION_PARTNERS,
    StrongestCorrelation,
    photo_partners,
    point_partners,
)

INTERIOR_ORIENTATION = ("c", "x0", "y0")
"""Calibration parameters of every camera; all others are additional parameters."""
STRONG_PARAMETER_CORRELATION = 0.95
"""Correlation from which on two quantities count as inseparable."""

ParameterLabel: TypeAlias = tuple[VariableKind, str, str]
"""Kind, name and component of a parameter, such as ``("calibration", "P31", "k1")``."""
MIN_PARTIAL_CORRELATION = 0.5
"""Partial correlation from which a parameter takes part in explaining another one."""


@dataclass(frozen=True)
class TestedParameter:
    """One tested calibration or additional parameter."""

    kind: VariableKind
    """``calibration``, ``edm`` or ``refraction``."""
    name: str
    """Name of the camera (``camera@photo`` for calibrations of single photos), distance meter or
    refraction group."""
    component: str
    """Name of the parameter, such as ``k1``, ``scale`` or ``kappa``."""
    additional: bool
    """Whether the parameter is an additional one; false for c, x0, y0."""
    weighted: bool
    """Whether the parameter has a given value with a standard deviation."""
    value: float
    """Estimate, SI or image units."""
    reference: float
    """Reference value of the test: the given value for c, x0, y0, coefficients of refraction and
    weighted parameters; 0 for all others."""
    sigma: float
    """Standard deviation of the estimate."""
    critical: float
    """Critical value of |t|."""
    variance_inflation: float
    """Ratio of the variance of the estimate to its variance with known other parameters of the
    same camera, or distance meter: Σ_ii (Σ⁻¹)_ii ≥ 1."""
    orientation: StrongestCorrelation | None
    """Strongest correlation with the exterior orientation of a photo of the same camera; None
    without a free photo, or with ``ties`` false."""
    point: StrongestCorrelation | None
    """Strongest correlation with an object point; None without a free point, or with ``ties``
    false."""
    explained_by_all: float = 0.0
    """Squared multiple correlation with all other parameters of the network, 0 to 1."""
    partners: tuple[ParameterLabel, ...] = ()
    """Parameters that explain it together, where ``explained_by_all`` says that they do: those with
    a partial correlation of at least one half, strongest first."""

    @property
    def label(self) -> ParameterLabel:
        """Kind, name and component of the parameter."""
        return self.kind, self.name, self.component

    @property
    def t(self) -> float:
        """(value − reference) / sigma."""
        return (self.value - self.reference) / self.sigma

    @property
    def significant(self) -> bool:
        """Whether the estimate differs from its reference value: |t| above the critical value.

        The weight of a weighted parameter pulls the estimate towards its reference value; a
        significant weighted parameter would also be significant without the weight.
        """
        return abs(self.t) > self.critical

    @property
    def explained(self) -> float:
        """Squared multiple correlation with the other parameters of the same camera, 0 to 1.

        It equals 1 − 1/variance_inflation.
        """
        return 1.0 - 1.0 / self.variance_inflation

    def __str__(self) -> str:
        if self.additional:
            verdict = "significant" if self.significant else "not significant"
        else:
            verdict = "differs from" if self.significant else "agrees with"
            verdict += " its given value"
        return (
            f"{label_text(self.label)} = {self.value:.6g} ± {self.sigma:.2g}: "
            f"|t| = {abs(self.t):.2f} from {self.reference:.6g}, {verdict} "
            f"(limit {self.critical:.2f})"
        )


@dataclass(frozen=True)
class Correlation:
    """A strong correlation of two parameters."""

    a: ParameterLabel
    """First parameter."""
    b: ParameterLabel
    """Second parameter."""
    value: float
    """Correlation of the two parameters."""


@dataclass(frozen=True, repr=False)
class Significance(Shown):
    """Tests and correlations of calibration and additional parameters."""

    parameters: tuple[TestedParameter, ...]
    """All free or weighted parameters, in the order of the network."""
    correlations: tuple[Correlation, ...]
    """Pairs of parameters with a correlation of at least ``limit``, strongest first."""
    alpha: float
    """Probability that a parameter with the true value ``reference`` is called significant."""
    limit: float
    """Correlation from which on two quantities count as inseparable."""
    critical: float
    """Critical value of |t|: of the normal distribution, or, in an a-posteriori solution, of
    Student's with the redundancy as degrees of freedom."""

    def headline(self) -> str:
        """Return how many parameters were tested, and how many are not significant."""
        return (
            f"Significance: {len(self.parameters)} parameters tested, {len(self.insignificant)} "
            f"not significant, {len(self.overparametrised)} pairs not distinguishable"
        )

    def first_rows(self) -> Rows:
        """Return the tested parameters."""
        return Rows(
            ("parameter", "value", "σ", "t", "significant"),
            ((label_text(p.label), p.value, p.sigma, p.t, p.significant) for p in self.parameters),
            len(self.parameters),
        )

    def __getitem__(self, label: tuple[str, str]) -> TestedParameter:
        """Return a parameter by name and component, such as ``("P31", "k1")``."""
        for p in self.parameters:
            if (p.name, p.component) == label:
                return p
        every = [f"({p.name!r}, {p.component!r})" for p in self.parameters]
        names = known(every, meant=f"({label[0]!r}, {label[1]!r})")
        raise InputError(f"no tested parameter {label}; known: {names}")

    @property
    def insignificant(self) -> tuple[TestedParameter, ...]:
        """Additional parameters that are not significant, smallest |t| first."""
        found = [p for p in self.parameters if p.additional and not p.significant]
        return tuple(sorted(found, key=lambda p: abs(p.t)))

    @cached_property
    def overparametrised(self) -> tuple[str, ...]:
        """Sentences that name inseparable parameters; empty if all parameters are separable.

        They name pairs of correlated parameters, parameters without such a pair that all others of
        the camera together explain, and correlations with the exterior orientation of photos and
        with object points.
        """
        out = []
        paired = {label for c in self.correlations for label in (c.a, c.b)}
        for c in self.correlations:
            same = c.a[:2] == c.b[:2]
            other = c.b[2] if same else label_text(c.b)
            out.append(
                f"{label_text(c.a)} and {other} are correlated by {correlation_text(c.value)}"
            )
        for p in self.parameters:
            if p.label not in paired and p.explained >= self.limit**2:
                out.append(
                    f"{label_text(p.label)} is explained to {100 * p.explained:.1f} % by the other "
                    f"parameters of the same {UNKNOWNS[p.kind].title}"
                )
        told: set[ParameterLabel] = {
            p.label for p in self.parameters if p.explained >= self.limit**2
        }
        for p in self.parameters:
            new = p.label not in paired | told and p.partners
            if new and p.explained_by_all >= self.limit**2:
                others = known([label_text(label) for label in p.partners])
                told |= {p.label, *p.partners}
                out.append(
                    f"{label_text(p.label)} is explained to {100 * p.explained_by_all:.1f} % by "
                    f"{others}{' together' * (len(p.partners) > 1)}"
                )
        for p in self.parameters:
            for tie, one, many in (
                (p.orientation, "photo", "photos"),
                (p.point, "point", "points"),
            ):
                if tie is not None and abs(tie.correlation) >= self.limit:
                    count = f"; {tie.count} {many} in all" if tie.count > 1 else ""
                    out.append(
                        f"{label_text(p.label)} and {tie.component} of {one} {tie.name!r} are "
                        f"correlated by {correlation_text(tie.correlation)}{count}"
                    )
        return tuple(out)


def label_text(label: ParameterLabel) -> str:
    """Return the name of a parameter in messages: ``k1 of camera 'P31'``."""
    kind, name, component = label
    if not name:
        return f"{component} of the {UNKNOWNS[kind].title} of the network"
    return f"{component} of {UNKNOWNS[kind].title} {name!r}"


def correlation_text(value: float) -> str:
    """Return a correlation with three digits, or with six if three digits round to one."""
    text = f"{value:+.3f}"
    return text if "1.000" not in text else f"{value:+.6f}"


@taking(Solution)
@with_one_thread
def significance(
    solution: Solution,
    *,
    alpha: float = ALPHA_OF_MODEL,
    correlation: float = STRONG_PARAMETER_CORRELATION,
    ties: bool = True,
) -> Significance:
    """Test calibration and additional parameters of an adjustment, and search for correlations.

    The free or weighted calibrations of cameras, scales and zero constants of distance meters and
    coefficients of refraction are tested. t = (x̂ − x_ref)/σ_x̂ is compared with the quantile
    1 − α/2 of the normal distribution, or, if σ̂0² scales the covariances, of Student's distribution
    with r degrees of freedom. With a parameter held at x_ref, vᵀPv would increase by t² (by t² σ̂0²
    a posteriori).

    Args:
        solution: result of `adjust`.
        alpha: probability that a parameter with the true value x_ref is called significant.
        correlation: correlation from which on two quantities count as inseparable.
        ties: whether correlations with photos and points are computed too.

    Raises:
        InputError: alpha or correlation are not between 0 and 1.
        AdjustmentError: the normal equations are singular at the solution.
    """
    if not 0 < alpha < 1:
        raise InputError(f"alpha must lie between 0 and 1, not {alpha}")
    if not 0 < correlation <= 1:
        raise InputError(f"correlation must lie above 0 and be 1 at most, not {correlation}")
    if solution.reference is not None:
        # Parameters are independent of the datum; their ties refer to the given datum.
        solution = replace(solution, reference=None)
    posterior = solution.variance == "a-posteriori" and solution.redundancy > 0
    quantile = 1.0 - alpha / 2.0
    if posterior:
        critical = student_quantile(quantile, solution.redundancy)
    else:
        critical = normal_quantile(quantile)
    try:
        variables = list(_variables(solution))
    except SingularError as error:
        raise AdjustmentError(f"no tests of parameters: {error}") from None
    photos = photo_partners(solution) if ties else {}
    points = point_partners(solution) if ties else NO_CORRELATION_PARTNERS
    parameters: list[TestedParameter] = []
    among: list[Array] = []
    tested = np.concatenate([np.zeros(0, np.intp), *(v.columns for v in variables)])
    by_steps: Any = block_diag([v.by_step for v in variables], format="csr") if variables else None
    for v in variables:
        unit = np.zeros((solution.equations.unknowns.n_columns, len(v.columns)))
        unit[v.columns] = v.by_step.T
        covariance = solution.cofactor_times(unit) * solution.variance_factor
        among.append(by_steps @ covariance[tested])
        own = (
            photos.get(v.name, NO_CORRELATION_PARTNERS)
            if v.kind == "calibration"
            else NO_CORRELATION_PARTNERS
        )
        with_photos = own.ties(covariance, v.sigma, correlation)
        with_points = points.ties(covariance, v.sigma, correlation)
        for i, component in enumerate(v.components):
            parameters.append(
                TestedParameter(
                    v.kind,
                    v.name,
                    component,
                    not (v.kind == "calibration" and component in INTERIOR_ORIENTATION),
                    bool(v.weighted[i]),
                    float(v.values[i]),
                    float(v.reference[i]),
                    float(v.sigma[i]),
                    critical,
                    float(v.inflation[i]),
                    with_photos[i],
                    with_points[i],
                )
            )
    pairs = tuple(_strong(variables, among, correlation))
    together = tuple(_explained(parameters, among, correlation))
    return Significance(together, pairs, alpha, correlation, critical)


# -- the parameters -------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Variable:
    """The free components of one tested variable; arrays in the order of the components."""

    kind: VariableKind
    name: str
    components: tuple[str, ...]
    columns: Index
    values: Array
    reference: Array
    weighted: Mask
    sigma: Array
    inflation: Array
    by_step: Array
    """Partials of the values by the columns; turns about the turned axes are no values."""


def _variables(solution: Solution) -> Iterator[_Variable]:
    """Yield the tested variables."""
    unknowns = solution.equations.unknowns
    # Cameras come first, because their parameters interest most readers.
    for kind in reversed([k.name for k in UNKNOWNS.values() if k.additional]):
        table = unknowns[kind]
        for number in np.flatnonzero(table.offset >= 0).tolist():
            name, size = table.names[number], int(table.size[number])
            free = np.flatnonzero(table.free[number, :size])
            names = unknowns.component_names(kind, number)
            components = tuple(names[i] for i in free)
            weighted = np.isfinite(table.sigma[number, free])
            as_given = weighted | np.isin(components, INTERIOR_ORIENTATION)
            as_given = as_given | (UNKNOWNS[kind].reference == "given")
            by_step = unknowns.by_step(solution.state, kind, number)[np.ix_(free, free)]
            tangent = solution.variable_covariance((kind, name))[np.ix_(free, free)]
            covariance = by_step @ tangent @ by_step.T
            sigma = np.sqrt(np.diag(covariance))
            inflation = np.diag(np.linalg.inv(covariance / np.outer(sigma, sigma)))
            yield _Variable(
                kind,
                name,
                components,
                unknowns.columns(kind, number)[free],
                unknowns.given(solution.state, kind, number)[free],
                np.where(as_given, unknowns.given({kind: table.values}, kind, number)[free], 0.0),
                weighted,
                sigma,
                np.maximum(inflation, 1.0),
                by_step,
            )


def _explained(
    parameters: list[TestedParameter], covariances: list[Array], limit: float
) -> Iterator[TestedParameter]:
    """Yield the parameters with their multiple correlations with all others.

    With the correlations C of all parameters and P = C⁻¹, R² = 1 − 1/P_ii, and the partial
    correlation of two is −P_ij / √(P_ii P_jj). Shift, arm and principal distance of one flying
    height explain each other without any strong correlation of two.
    """
    if not parameters:
        return
    covariance = np.concatenate(covariances, axis=1)
    sigma = np.sqrt(np.diag(covariance))
    correlation = covariance / np.outer(sigma, sigma)
    inverse = np.linalg.pinv(0.5 * (correlation + correlation.T), hermitian=True)
    inflation = np.maximum(np.diag(inverse), 1.0)
    partial = np.abs(inverse) / np.sqrt(np.outer(inflation, inflation))
    for i, p in enumerate(parameters):
        explained = float(1.0 - 1.0 / inflation[i])
        strong = [
            parameters[j].label
            for j in np.argsort(-partial[i], kind="stable").tolist()
            if j != i and partial[i, j] >= MIN_PARTIAL_CORRELATION
        ]
        yield replace(
            p,
            explained_by_all=explained,
            partners=tuple(strong) if explained >= limit**2 else (),
        )


def _strong(
    variables: list[_Variable], covariances: Iterable[Array], limit: float
) -> list[Correlation]:
    """Return the pairs of parameters with a correlation of at least ``limit``, strongest first.

    Args:
        variables: all tested variables.
        covariances: covariances of all parameters with the p parameters of each variable,
            (parameters, p) each.
        limit: smallest correlation that is listed.
    """
    labels = [(v.kind, v.name, component) for v in variables for component in v.components]
    sigma = np.concatenate([np.zeros(0), *(v.sigma for v in variables)])
    found: list[Correlation] = []
    first = 0
    for v, covariance in zip(variables, covariances, strict=True):
        rho = covariance / np.outer(sigma, v.sigma)
        before = np.arange(len(sigma))[:, None] < first + np.arange(len(v.sigma))
        for i, j in zip(*np.nonzero(before & (np.abs(rho) >= limit)), strict=True):
            found.append(Correlation(labels[i], labels[first + j], float(rho[i, j])))
        first += len(v.sigma)
    return sorted(found, key=lambda c: -abs(c.value))
