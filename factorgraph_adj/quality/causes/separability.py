"""Separability: errors of readings, and causes shared by readings, that explain a misfit alike.

An error that is tested by T² = uᵀS⁻¹u leaves vᵀPv smaller by T². Of two errors with one component
each, the test values w₁, w₂ have a correlation ρ, and if the first is the true one, T₁² exceeds T₂²
by (1 − ρ²) T₁² on the average. The difference is twice the logarithm of the likelihood ratio.

An error of one reading i and a cause that other readings share with it may explain the same
misfit. With ∇̂_i of the reading alone, and c_i the partials of the reading by the q components of
the cause, the cause would have to be at least ∇ = ∇̂_i c_i / |c_i|² in size. With the reading as an
unknown the other readings of the cause determine it by S_c.i, see `conditional_error_tests`, and an
error of this size in any direction would show there by the noncentrality, on the average of
directions,

    λ = |∇|² tr(S_c.i) / (q σ0²).

They contradict the cause if λ reaches δ0², so that they would have shown the error, and if what
they show is not critical. Where they have not the power, the cause and the reading are inseparable.

A gross error of a position is one of x, y and z together. The test values w of its components each
show a part of it, while a cause of two components that its other readings share, such as the
centring of a target there, may explain more than any of them. So a cause is compared with whole
observations too.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array, csc_array, hstack

from ...types import Array
from ..reliability import Reliability, noncentrality
from .evidence import Cause, VarianceFactor, evidence
from .shared_error_tests import conditional_error_tests, shared_error_tests, whitening_matrix

MIN_T2_DIFFERENCE = 11.0
"""Difference of T² / σ0² below which two causes cannot be distinguished: above it, one of them is
exp(11/2) = 245 times as likely as the other. A wrong one is ahead of the true one by so much with a
probability of at most 1 in 245. This holds for each rival: of k rivals, any is ahead by so much
with a probability of up to k in 245, less where they are like one another."""
MAX_LINEAR_TEST_VALUE = 1000.0
"""Largest test value of an error for which the linear model of the tests holds."""
MIN_SEPARABLE_SHARE = MIN_T2_DIFFERENCE / MAX_LINEAR_TEST_VALUE**2
"""Smallest 1 − ρ² of test values that can separate two errors: with less, even an error of the
size of `MAX_LINEAR_TEST_VALUE` leaves T² of both different by less than `MIN_T2_DIFFERENCE`.
Rounding is smaller by far."""
MAX_WHOLE_OBSERVATIONS = 50
"""Largest number of observations that are tested as a whole: those with the largest Σ w²."""


def separability_tolerance(evidence: float) -> float:
    """Return how much less evidence an error that is not separable from this one may have.

    max(½ `MIN_T2_DIFFERENCE`, `MIN_SEPARABLE_SHARE` · evidence), in the unit of evidence, −ln of a
    probability.

    Evidence is half a T², so it is half of `MIN_T2_DIFFERENCE`. Of errors with one component it is
    reached where (1 − ρ²) T² is, so that it also decides whether two errors are separable at
    all: with a correlation of ±1 their T² differ by rounding alone.
    """
    return max(0.5 * MIN_T2_DIFFERENCE, MIN_SEPARABLE_SHARE * evidence)


def inseparable_causes(found: Iterable[Cause], most: float, likelihood: float) -> list[Cause]:
    """Return the causes that are not separable from one; of a cause at the same readings one place.

    A cause at a station is the same as everywhere, where there is no other station. What is the
    same to all readings cannot be distinguished for its number of unknowns: either the evidence or
    the likelihood, which does not count them, differs by less than `separability_tolerance`.

    Args:
        found: the causes.
        most: evidence of the one.
        likelihood: its likelihood, see `Cause.likelihood`.
    """
    out: list[Cause] = []
    for c in found:
        close = abs(c.evidence - most) < separability_tolerance(most)
        close = close or abs(c.likelihood - likelihood) < separability_tolerance(likelihood)
        if not close:
            continue
        if not any(c.ids and o.cause == c.cause and set(o.ids) == set(c.ids) for o in out):
            out.append(c)
    return out


def rival_causes(
    rel: Reliability, every: Iterable[Cause], row: int, most: float, *, estimated: bool
) -> list[Cause]:
    """Return the causes that are not separable from an error of one row, most probable first.

    Args:
        rel: the reliability.
        every: all causes that were tested, those below their critical values too.
        row: the row.
        most: evidence of its error.
        estimated: whether σ0 is estimated.
    """
    ident = rel.solution.equations.id(row)
    close = inseparable_causes([c for c in every if c.sizes and c.possible], most, most)
    return sorted(
        (
            c
            for c in close
            if ident not in c.ids or not is_contradicted(rel, c, row, estimated=estimated)
        ),
        key=lambda c: -c.evidence,
    )


def is_contradicted(rel: Reliability, c: Cause, row: int, *, estimated: bool) -> bool:
    """Return whether the other readings of a cause contradict that it is behind one of them.

    Args:
        rel: the reliability; its α0 and power are those of the test.
        c: the cause.
        row: the row.
        estimated: whether σ0 is estimated.
    """
    solution = rel.solution
    if c.columns is None:
        return False
    partials = c.columns[[row]].toarray()[0]
    size = float(partials @ partials)
    if not size > 0.0:
        return False
    one = csc_array(coo_array(([1.0], ([row], [0])), shape=(c.columns.shape[0], 1)))
    together = csc_array(whitening_matrix(solution.equations) @ csc_array(hstack([one, c.columns])))
    others = 1 + np.arange(len(partials))
    reading, rest, left = conditional_error_tests(solution, together, np.array([0]), others)
    if not rest.dof:
        return False
    both = reading.t2 + rest.t2
    weight = VarianceFactor.left_by(solution, estimated=estimated, t2=both, dof=1 + rest.dof)
    if rest.t2 / weight.variance > weight.critical(rest.dof, rel.alpha):
        return False
    power = reading.error[0] ** 2 / size * float(np.trace(left)) / (len(others) * weight.variance)
    return bool(power >= noncentrality(rel.alpha, rel.power) ** 2)


def inseparable_readings(rel: Reliability, w: Array, first: int, *, estimated: bool) -> list[int]:
    """Return the rows that are not separable from the one with the largest test value, it first.

    Of row 1 and another row 2, with the correlation ρ of their test values, the test value of 1
    with an error of 2 as an unknown, and the other way round, are

        w₁₂ = (w₁ − ρ w₂) / √(1 − ρ²),   w₂₁ = (w₂ − ρ w₁) / √(1 − ρ²),   w₁² + w₂₁² = w₂² + w₁₂².

    Row 2 belongs to them if its evidence is less by no more than `separability_tolerance` (of a
    known σ0: w₁² − w₂² < `MIN_T2_DIFFERENCE`), and either one explains the other: w₁₂ and w₂₁ are
    not critical. If they are, both are wrong. 1 − ρ² below `MIN_SEPARABLE_SHARE` counts as that.

    Args:
        rel: the reliability.
        w: test values for σ0 = 1, (n,); 0 where nothing controls a row.
        first: row of the largest.
        estimated: whether σ0 is estimated.
    """
    solution, t2 = rel.solution, w * w
    rho = np.nan_to_num(rel.correlations_with(np.array([first]))[:, 0])
    lost = np.maximum(1.0 - rho**2, MIN_SEPARABLE_SHARE)
    one, other = (w[first] - rho * w) ** 2 / lost, (w - rho * w[first]) ** 2 / lost

    def of(value: float) -> float:
        weight = VarianceFactor.left_by(solution, estimated=estimated, t2=value, dof=1)
        return evidence(value / weight.variance, 1, weight.freedom)

    most, out = of(float(t2[first])), [first]
    for row in np.argsort(-t2, kind="stable").tolist():
        if not rel.controlled[row] or most - of(float(t2[row])) >= separability_tolerance(most):
            break
        left = float(max(one[row], other[row]))
        both = float(t2[row] + one[row])
        weight = VarianceFactor.left_by(solution, estimated=estimated, t2=both, dof=2)
        if row != first and not left / weight.variance > weight.critical(1, rel.alpha):
            out.append(row)
    return out


class WholeObservation(NamedTuple):
    """How likely the observation of several components is that explains most."""

    evidence: float = 0.0
    """Its evidence; 0: there is none."""
    likelihood: float = 0.0
    """The same as if T² were of one unknown, see `Cause.likelihood`."""


NO_OBSERVATION = WholeObservation()
"""There is no observation of several components, or none is determined."""


def best_whole_observation(rel: Reliability, w: Array, *, estimated: bool) -> WholeObservation:
    """Return how likely an error of a whole observation is, of the one that explains most.

    Args:
        rel: the reliability.
        w: test values for σ0 = 1, (n,); 0 where nothing controls a row.
        estimated: whether σ0 is estimated.
    """
    solution = rel.solution
    equations = solution.equations
    number = equations.observation_of_row
    observed = np.zeros(len(number), dtype=bool)
    for block in equations.blocks:
        observed[block.rows] = not block.prior
    several = (np.bincount(number[observed], minlength=int(number.max()) + 1) > 1)[number]
    rows = np.flatnonzero(observed & several)
    if not len(rows):
        return NO_OBSERVATION
    size = np.bincount(number[rows], np.square(w[rows]))
    worst = [
        i
        for i in np.argsort(-size, kind="stable")[:MAX_WHOLE_OBSERVATIONS].tolist()
        if size[i] > 0.0
    ]
    parts = [rows[number[rows] == i] for i in worst]
    if not parts:
        return NO_OBSERVATION
    chosen = np.concatenate(parts)
    first = np.cumsum([0, *map(len, parts)])
    ones = coo_array(
        (np.ones(len(chosen)), (chosen, np.arange(len(chosen)))), shape=(len(number), len(chosen))
    )
    columns = csc_array(whitening_matrix(equations) @ csc_array(ones))
    groups = [np.arange(a, b) for a, b in pairwise(first.tolist())]
    out = NO_OBSERVATION
    for found in shared_error_tests(solution, columns, groups):
        if found.dof:
            weight = VarianceFactor.left_by(
                solution, estimated=estimated, t2=found.t2, dof=found.dof
            )
            t2 = found.t2 / weight.variance
            one = WholeObservation(*(evidence(t2, q, weight.freedom) for q in (found.dof, 1)))
            out = max(out, one)
    return out
