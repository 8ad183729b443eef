"""Check of the covariances of a factorisation by a few random probes.

With white noise Z of the whitened observations, X = Q Aᵀ Z are estimates whose covariance is
Q N Q = Q, and A X = H Z with H = A Q Aᵀ. H is a projector with every datum, as N Q N = N is
equivalent to H H = H. Rounding in the factorisation changes the eigenvalues 1 of H to 1 − ε. Each ε
is the relative error of the variance of the function of the estimates that belongs to its
eigenvector; no function has a variance with a larger error than the largest |ε|. Each column of
H H Z − H Z contains every ε (1 − ε) times a standard normal number, so that its length shows the
largest. Two columns suffice if they are almost zero; otherwise more columns are used. The probes do
not see a function whose variance is lost almost entirely (ε ≈ 1): small pivots are judged before.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import qr

from ..types import Array, Index
from .datum import FreeDatum
from .factor import Factor
from .linear import LinearisedEquations

FEW = 2
"""Number of probes of the first check. The probability that both show less than ε/1000 is 6e-7."""
CLEAN = 4e-7
"""Largest |H H z − H z| of the first check for which no second check follows. Variances then have
relative errors below 4e-4, and standard deviations half of that, with the probability of `FEW`."""
MANY = 8
"""Number of probes of the second check. The probability that all show less than ε/5 is 4e-7."""
TRUSTED = 1e-4
"""Largest |H H z − H z| of the second check for which covariances are returned. Variances then have
relative errors below 5e-4, with the probability of `MANY`."""
SAMPLES = 4
"""Number of estimates from white noise whose root mean squares approximate standard deviations."""
SEED = 1
"""Seed of the probes: the same network gives the same figures."""
HELD_STILL = 1e-6
"""Standard deviation of an unknown that a datum holds, relative to the standard deviation that it
has if all others are held: below this value only rounding is left."""
WEAKEST = 5
"""Number of unknowns that a refusal names."""


def sample(
    system: LinearisedEquations, factor: Factor, n: int, source: np.random.Generator | None = None
) -> Array:
    """Return n estimates X = Q AᵀZ from white noise of the observations, (n_columns, n).

    Args:
        system: the linearised network.
        factor: its normal equations, factorised, with a minimal datum where it has a defect.
        n: number of estimates.
        source: of the noise; none: one that begins anew.
    """
    rows = system.equations.n_rows + sum(len(e.residual) for e in system.extra)
    source = np.random.default_rng(SEED) if source is None else source
    return factor.solve(system.transposed(source.standard_normal((rows, n))))


def uncertainty(system: LinearisedEquations, factor: Factor) -> float:
    """Return the relative error of variances from a factorisation: the largest |H H z − H z|.

    Covariances may be returned if the error is at most `TRUSTED`. A factorisation without error
    costs two solutions with `FEW` right sides.

    Args:
        system: the linearised network.
        factor: its normal equations, factorised, with a minimal datum where it has a defect.
    """
    found = _error(system, factor, FEW)
    return found if found <= CLEAN else _error(system, factor, MANY)


def _error(system: LinearisedEquations, factor: Factor, n: int) -> float:
    with np.errstate(over="ignore", invalid="ignore"):
        once = system.times(sample(system, factor, n))
        twice = system.times(factor.solve(system.transposed(once)))
        error = np.linalg.norm(twice - once, axis=0).max(initial=0.0)
    return float(error) if np.isfinite(error) else np.inf


def held_well(datum: FreeDatum, steps: Array, diagonal: Array) -> tuple[Index, float]:
    """Choose a minimal datum that enlarges standard deviations little.

    Rounding in Q grows with the squares of the terms that the minimal datum adds to two estimates:
    those on inner constraints over all unknowns in the metric of the diagonal of N, on which
    rounding of N acts, and those on the constraints of the datum, which the S-transformation
    computes as a small difference. Let σ be the smaller of the two standard deviations of each
    unknown. Holding the components h adds −G G_h⁻¹ x_h. If the rows g_i / σ_i of h span the
    largest volume, every element of σ_i⁻¹ g_i G_h⁻¹ σ_h is at most one. Pivoting approximates this
    choice.

    Args:
        datum: the undetermined motions, and the inner constraints.
        steps: estimates from white noise on any minimal datum, (n_columns, k); their root mean
            squares approximate standard deviations.
        diagonal: diagonal of N, (n_columns,).

    Returns:
        The columns to hold (d,), and the largest factor by which the minimal datum of ``steps``
        enlarges a σ.
    """
    candidates = np.flatnonzero(np.any(datum.basis != 0.0, axis=1) & (diagonal > 0.0))
    g, x, root = datum.basis[candidates], steps[candidates], np.sqrt(diagonal[candidates, None])
    over_all, _ = np.linalg.qr(root * g)
    inner = _size(x - over_all @ (over_all.T @ (root * x)) / root)
    on_datum = _size(x - g @ (datum.masked.T @ steps))
    sigma = np.maximum(np.minimum(inner, on_datum), HELD_STILL / root[:, 0])
    spanned, _ = np.linalg.qr(g / sigma[:, None])
    _, _, order = qr(spanned.T, mode="economic", pivoting=True)
    enlarged = float((_size(x) / sigma).max(initial=1.0))
    return np.asarray(candidates[order[: g.shape[1]]], dtype=np.intp), enlarged


def _size(x: Array) -> Array:
    """Return the root mean square of each row."""
    return np.asarray(np.sqrt(np.mean(x**2, axis=1)))


def refusal(system: LinearisedEquations, factor: Factor, diagonal: Array) -> str:
    """Return the reason why covariances are refused, with the most weakly determined unknowns.

    Args:
        system: the linearised network.
        factor: its most precise factorisation, which is not precise enough.
        diagonal: diagonal of N, (n_columns,).
    """
    unknowns = system.unknowns
    weakness = _size(sample(system, factor, SAMPLES)) * np.sqrt(diagonal)
    worst = sorted(
        ((float(weakness[unknowns.columns(k, i)].max()), k, i) for k, i in unknowns.active()),
        key=lambda item: -item[0],
    )
    names = ", ".join(f"{k} {unknowns[k].names[i]!r}" for _, k, i in worst[:WEAKEST])
    return (
        "no covariances: the normal equations are so close to singular that rounding would change"
        f" variances by {factor.uncertainty:.1g} of their value ({TRUSTED:.0e} is allowed); weakest"
        f" are {names}: observe them better (longer bases, more rays, distances), or hold them"
    )
