"""Errors that cannot be told from one another: readings, and causes that several readings share.

An error of one reading i and a cause that other readings share with it may explain the same
misfit. With ∇̂_i of the reading alone, and c_i the partials of the reading by the q components of
the cause, the cause would have to be at least ∇ = ∇̂_i c_i / |c_i|² in size. With the reading as an
unknown the other readings of the cause tell of it by S_c.i, see `columns.beside`, and an error of
this size in any direction would show there by the noncentrality, on the average of directions,

    λ = |∇|² tr(S_c.i) / (q σ0²).

They contradict the cause if λ reaches δ0², so that they would have shown the error, and if what
they show is not critical. Where they have not the power, nothing tells the cause from the reading.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy.sparse import coo_array, csc_array, hstack

from ...types import Array
from ..reliability import Reliability, noncentrality
from .cause import Cause
from .columns import beside, whitening
from .evidence import VarianceFactor, evidence
from .separable import SEPARABLE, separability_tolerance


def alike(found: Iterable[Cause], most: float, likelihood: float) -> list[Cause]:
    """Return the causes that cannot be told from one; of a cause at the same readings one place.

    A cause at a station is the same as everywhere, where there is no other station. What is the
    same to all readings cannot be told apart for its number of unknowns: either the evidence or
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


def rivals(
    rel: Reliability, every: Iterable[Cause], row: int, most: float, *, estimated: bool
) -> list[Cause]:
    """Return the causes that cannot be told from an error of one row, the likeliest first.

    Args:
        rel: the reliability.
        every: all causes that were tested, those below their critical values too.
        row: the row.
        most: evidence of its error.
        estimated: whether σ0 is estimated.
    """
    ident = rel.solution.equations.id(row)
    close = alike([c for c in every if c.sizes and c.possible], most, most)
    return sorted(
        (
            c
            for c in close
            if ident not in c.ids or not contradicted(rel, c, row, estimated=estimated)
        ),
        key=lambda c: -c.evidence,
    )


def contradicted(rel: Reliability, c: Cause, row: int, *, estimated: bool) -> bool:
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
    together = csc_array(whitening(solution.equations) @ csc_array(hstack([one, c.columns])))
    others = 1 + np.arange(len(partials))
    reading, rest, left = beside(solution, together, np.array([0]), others)
    if not rest.dof:
        return False
    both = reading.t2 + rest.t2
    weight = VarianceFactor.left_by(solution, estimated=estimated, t2=both, dof=1 + rest.dof)
    if rest.t2 / weight.variance > weight.critical(rest.dof, rel.alpha):
        return False
    power = reading.error[0] ** 2 / size * float(np.trace(left)) / (len(others) * weight.variance)
    return bool(power >= noncentrality(rel.alpha, rel.power) ** 2)


def readings_alike(rel: Reliability, w: Array, first: int, *, estimated: bool) -> list[int]:
    """Return the rows that cannot be told from the one with the largest test value, that one first.

    Of row 1 and another row 2, with the correlation ρ of their test values, the test value of 1
    with an error of 2 as an unknown, and the other way round, are

        w₁₂ = (w₁ − ρ w₂) / √(1 − ρ²),   w₂₁ = (w₂ − ρ w₁) / √(1 − ρ²),   w₁² + w₂₁² = w₂² + w₁₂².

    Row 2 belongs to them if its evidence is less by no more than `separability_tolerance` (of a
    known σ0: w₁² − w₂² < `SAME`), and either one explains the other: w₁₂ and w₂₁ are not critical.
    If they are, both are wrong. 1 − ρ² below `SEPARABLE` counts as that.

    Args:
        rel: the reliability.
        w: test values for σ0 = 1, (n,); 0 where nothing controls a row.
        first: row of the largest.
        estimated: whether σ0 is estimated.
    """
    solution, t2 = rel.solution, w * w
    rho = np.nan_to_num(rel.correlations_with(np.array([first]))[:, 0])
    lost = np.maximum(1.0 - rho**2, SEPARABLE)
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
