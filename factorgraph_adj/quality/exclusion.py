"""Backward exclusion: leave out additional parameters until those that are left are needed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal, TypeVar

import numpy as np

from ..errors import InputError, known
from ..models.variables import UNKNOWNS
from ..network.entities import Parameter, parameter_name
from ..network.network import DatumChoice, Network
from ..shown import Rows, Shown
from ..solve.batch import adjust
from ..solve.solution import Solution
from .levels import ALPHA_OF_MODEL
from .systematic import (
    STRONG,
    Label,
    Significance,
    TestedParameter,
    correlation_text,
    describe,
    significance,
)

Reason = Literal["not significant", "correlated"]
"""Why a parameter was excluded."""
T = TypeVar("T")


@dataclass(frozen=True)
class ExcludedParameter:
    """An additional parameter that was held at its reference value, as it stood before."""

    tested: TestedParameter
    """Its test in the adjustment that excluded it; where every photo has a calibration of its own,
    that of the photo with the largest |t|."""
    reason: Reason
    """Why."""
    partner: Label | None
    """What it was correlated with, where that is the reason."""
    correlation: float | None
    """How strongly."""
    round: int
    """Number of the adjustment that excluded it, from 1."""

    def __str__(self) -> str:
        p = self.tested
        what = f"{describe(p.label)} held at {p.reference:.6g}: |t| = {abs(p.t):.2f}"
        if self.partner is not None and self.correlation is not None:
            other = describe(self.partner)
            return f"{what}, correlated by {correlation_text(self.correlation)} with {other}"
        return f"{what}, below {p.critical:.2f}"


@dataclass(frozen=True, repr=False)
class Exclusion(Shown):
    """What backward exclusion came to."""

    solution: Solution
    """The last adjustment; its network holds what was excluded."""
    excluded: tuple[ExcludedParameter, ...]
    """What was excluded, in order."""
    significance: Significance
    """Tests and correlations of what is left."""
    first: Solution
    """The adjustment with all parameters."""

    def headline(self) -> str:
        """Return how many parameters were excluded."""
        return f"Exclusion: {len(self.excluded)} parameters excluded, σ̂0 {self.solution.sigma0:.4f}"

    def first_rows(self) -> Rows:
        """Return the excluded parameters."""
        return Rows(
            ("parameter", "t", "why", "round"),
            ((describe(e.tested.label), e.tested.t, e.reason, e.round) for e in self.excluded),
            len(self.excluded),
        )

    @property
    def growth(self) -> float:
        """By how much vᵀPv grew.

        χ² with as many degrees of freedom as parameters were excluded, if none of them was real.
        """
        return self.solution.vtpv - self.first.vtpv


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
    """Exclude additional parameters one at a time until all that are left are needed.

    Adjust; hold the additional parameter with the least |t| at its reference value (see
    `significance`) and adjust again, until all are significant. One at a time: of two parameters
    that are highly correlated both may look insignificant while one of them is needed. Never
    excluded are c, x0 and y0. Where every photo has a calibration of its own, a parameter is
    excluded for all of them, if it is insignificant in all of them.

    A high correlation of parameters that are significant all the same does no harm, and leaving
    one of them out does: so nothing is excluded for it unless ``correlation`` says so.

    Args:
        network: what was measured; it stays as it is.
        alpha: probability that a parameter which is not real is called significant.
        correlation: once all are significant, of every pair that is correlated from this on,
            strongest first, exclude the one with the smaller |t| too; none: no such exclusion.
        keep: components that are not excluded, such as ``k1``.
        datum: as of `adjust`.
        variance: as of `adjust`.
        max_iterations: as of `adjust`.

    Raises:
        InputError: unknown components in ``keep``, and as `significance`.
        DatumError: the observations do not determine all parameters at once, even before any is
            excluded; it names them. Errors of `adjust`.
    """
    kept = frozenset([keep] if isinstance(keep, str) else keep)
    first = adjust(network, datum=datum, variance=variance, max_iterations=max_iterations)
    solution, excluded = first, list[ExcludedParameter]()
    limit = STRONG if correlation is None else correlation
    while True:
        test = significance(solution, alpha=alpha, correlation=limit, ties=False)
        components = [p.component for p in test.parameters]
        if not excluded and not kept <= set(components):
            wrong = ", ".join(sorted(kept - set(components)))
            raise InputError(
                f"keep names no free parameter: {wrong}; known: {known(dict.fromkeys(components))}"
            )
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


def _entity(label: Label) -> Label:
    """Return the label of what can be held: a parameter of a camera, for all of its photos."""
    kind, name, component = label
    return kind, name.split("@")[0] if kind == "calibration" else name, component


def _candidates(test: Significance, keep: frozenset[str]) -> dict[Label, TestedParameter]:
    """Return what can be excluded, with the test of the photo that asks for it most."""
    out: dict[Label, TestedParameter] = {}
    for p in test.parameters:
        if p.additional and p.component not in keep:
            entity = _entity(p.label)
            if entity not in out or abs(p.t) > abs(out[entity].t):
                out[entity] = p
    return out


def _insignificant(candidates: dict[Label, TestedParameter]) -> ExcludedParameter | None:
    weak = [p for p in candidates.values() if not p.significant]
    if not weak:
        return None
    return ExcludedParameter(min(weak, key=lambda p: abs(p.t)), "not significant", None, None, 0)


def _correlated(
    test: Significance, candidates: dict[Label, TestedParameter]
) -> ExcludedParameter | None:
    for c in test.correlations:
        pair = [(_entity(c.a), c.b), (_entity(c.b), c.a)]
        if pair[0][0] == pair[1][0]:
            continue  # the same parameter of two photos: none of the two can be held alone
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
    table[key] = Parameter(*_held(given.values, given.fixed, given.sigma, at, parameter.reference))
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
