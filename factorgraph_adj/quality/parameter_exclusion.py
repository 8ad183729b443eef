"""Backward exclusion of additional parameters that are insignificant, or that others explain."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from ..adjustment import adjust
from ..blas_threads import with_one_thread
from ..entities import parameter_name
from ..errors import InputError, known, taking
from ..models.unknown_registry import UNKNOWNS
from ..network.network import DatumChoice, Network
from ..result_display import Rows, Shown
from ..solve.solution import Solution
from ..statistical_tests import ALPHA_OF_MODEL
from .parameter_significance import (
    STRONG_PARAMETER_CORRELATION,
    ParameterLabel,
    Significance,
    TestedParameter,
    correlation_text,
    label_text,
    significance,
)

ExclusionReason = Literal["not significant", "correlated"]
"""Reason of an exclusion."""
T = TypeVar("T")


@dataclass(frozen=True)
class ExcludedParameter:
    """An excluded additional parameter, with its figures before it was held."""

    tested: TestedParameter
    """Test of the parameter in the adjustment before its exclusion; if every photo has its own
    calibration, the test of the photo with the largest |t|."""
    reason: ExclusionReason
    """Reason of the exclusion."""
    partner: ParameterLabel | None
    """Parameter with which it was correlated; None if it was not significant."""
    correlation: float | None
    """Correlation with ``partner``."""
    round: int
    """Number of the adjustment before the exclusion, from 1."""

    def __str__(self) -> str:
        p = self.tested
        what = f"{label_text(p.label)} held at {p.reference:.6g}: |t| = {abs(p.t):.2f}"
        if self.partner is not None and self.correlation is not None:
            other = label_text(self.partner)
            return f"{what}, correlated by {correlation_text(self.correlation)} with {other}"
        return f"{what}, below {p.critical:.2f}"


@dataclass(frozen=True, repr=False)
class Exclusion(Shown):
    """Result of backward exclusion."""

    solution: Solution
    """The last adjustment; its network holds the excluded parameters."""
    excluded: tuple[ExcludedParameter, ...]
    """Excluded parameters, in the order of exclusion."""
    significance: Significance
    """Tests and correlations of the remaining parameters."""
    first: Solution
    """The adjustment with all parameters."""

    def headline(self) -> str:
        """Return how many parameters were excluded."""
        return f"Exclusion: {len(self.excluded)} parameters excluded, σ̂0 {self.solution.sigma0:.4f}"

    def first_rows(self) -> Rows:
        """Return the excluded parameters."""
        return Rows(
            ("parameter", "t", "why", "round"),
            ((label_text(e.tested.label), e.tested.t, e.reason, e.round) for e in self.excluded),
            len(self.excluded),
        )

    @property
    def growth(self) -> float:
        """Increase of vᵀPv by the exclusion.

        If the true values of all excluded parameters are their reference values, the increase is
        distributed as χ² with one degree of freedom for each excluded parameter.
        """
        return self.solution.vtpv - self.first.vtpv


@taking(Network)
@with_one_thread
def exclude_insignificant(
    network: Network,
    *,
    alpha: float = ALPHA_OF_MODEL,
    correlation: float | None = None,
    keep: Iterable[str] = (),
    datum: DatumChoice | None = None,
    variance: Literal["a-priori", "a-posteriori"] = "a-priori",
    max_iterations: int = 100,
) -> Exclusion:
    """Exclude additional parameters one at a time until all remaining ones are needed.

    After an adjustment, the additional parameter with the smallest |t| is held at its reference
    value (see `significance`), and the network is adjusted again, until all are significant. Only
    one parameter is excluded at a time: two highly correlated parameters may both seem
    insignificant although one of them is needed. The parameters c, x0 and y0 are always kept. If
    every photo has its own calibration, a parameter is excluded for all photos together, and only
    if it is insignificant in all of them.

    A high correlation of significant parameters does no harm, but the exclusion of one of them
    does. Therefore correlated parameters are excluded only if ``correlation`` is given.

    Args:
        network: the network; it is not changed.
        alpha: probability that a parameter whose true value is the reference value is called
            significant.
        correlation: smallest correlation of a pair from which, once all parameters are
            significant, the one with the smaller |t| is excluded too, strongest pair first; None:
            no such exclusion.
        keep: components that are not excluded, such as ``k1``.
        datum: as for `adjust`.
        variance: as for `adjust`.
        max_iterations: as for `adjust`.

    Raises:
        InputError: unknown components in ``keep``; errors of `significance`.
        DatumError: the observations do not determine all parameters together, before any
            exclusion; the error names them. Errors of `adjust`.
    """
    kept = frozenset([keep] if isinstance(keep, str) else keep)
    first = adjust(network, datum=datum, variance=variance, max_iterations=max_iterations)
    solution, excluded = first, list[ExcludedParameter]()
    limit = STRONG_PARAMETER_CORRELATION if correlation is None else correlation
    while True:
        test = significance(solution, alpha=alpha, correlation=limit, ties=False)
        components = [p.component for p in test.parameters]
        if not excluded and not kept <= set(components):
            wrong = sorted(kept - set(components))
            there = known(dict.fromkeys(components), meant=wrong[0])
            raise InputError(f"keep names no free parameter: {', '.join(wrong)}; known: {there}")
        candidates = _candidates(test, kept)
        found = _insignificant(candidates)
        if found is None and correlation is not None:
            found = _correlated(test, candidates)
        if found is None:
            test = significance(solution, alpha=alpha, correlation=limit)
            return Exclusion(solution, tuple(excluded), test, first)
        excluded.append(replace(found, round=len(excluded) + 1))
        solution = adjust(
            _with_held(solution.network, found.tested),
            datum=datum,
            variance=variance,
            start=solution,
            max_iterations=max_iterations,
        )


def _entity(label: ParameterLabel) -> ParameterLabel:
    """Return the label of the parameter that can be held: of a camera, for all its photos."""
    kind, name, component = label
    return kind, name.split("@")[0] if kind == "calibration" else name, component


def _candidates(test: Significance, keep: frozenset[str]) -> dict[ParameterLabel, TestedParameter]:
    """Return the parameters that can be excluded, each with its test of the largest |t|."""
    out: dict[ParameterLabel, TestedParameter] = {}
    for p in test.parameters:
        if p.additional and p.component not in keep:
            entity = _entity(p.label)
            if entity not in out or abs(p.t) > abs(out[entity].t):
                out[entity] = p
    return out


def _insignificant(candidates: dict[ParameterLabel, TestedParameter]) -> ExcludedParameter | None:
    weak = [p for p in candidates.values() if not p.significant]
    if not weak:
        return None
    return ExcludedParameter(min(weak, key=lambda p: abs(p.t)), "not significant", None, None, 0)


def _correlated(
    test: Significance, candidates: dict[ParameterLabel, TestedParameter]
) -> ExcludedParameter | None:
    for c in test.correlations:
        pair = [(_entity(c.a), c.b), (_entity(c.b), c.a)]
        if pair[0][0] == pair[1][0]:
            continue  # the same parameter of two photos can be held only for both
        able = [(candidates[e], other) for e, other in pair if e in candidates]
        if able:
            weaker, other = min(able, key=lambda found: abs(found[0].t))
            return ExcludedParameter(weaker, "correlated", other, c.value, 0)
    return None


def _with_held(network: Network, parameter: TestedParameter) -> Network:
    """Return a network that holds a parameter at its reference value."""
    kind, name, component = _entity(parameter.label)
    other = network.copy()
    if kind == "calibration":
        camera = network.cameras[name]
        at = camera.lens.names.index(component)
        values, fixed, sigma = _held(
            camera.values, camera.fixed, camera.sigma, at, parameter.reference
        )
        other.cameras[name] = replace(camera, values=values, fixed=fixed, sigma=sigma)
        return other
    table = other.of_kind(kind)
    key = next(k for k in table if parameter_name(k) == name)
    given, at = table[key], UNKNOWNS[kind].names().index(component)
    values, fixed, sigma = _held(given.values, given.fixed, given.sigma, at, parameter.reference)
    table[key] = replace(given, values=values, fixed=fixed, sigma=sigma)
    return other


def _held(
    values: tuple[float, ...],
    fixed: tuple[bool, ...],
    sigma: tuple[float, ...],
    at: int,
    reference: float,
) -> tuple[tuple[float, ...], tuple[bool, ...], tuple[float, ...]]:
    """Return values, flags and standard deviations with one component held."""
    return _put(values, at, reference), _put(fixed, at, True), _put(sigma, at, np.inf)


def _put(old: tuple[T, ...], at: int, new: T) -> tuple[T, ...]:
    return (*old[:at], new, *old[at + 1 :])
